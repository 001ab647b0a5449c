"""The trainer's honesty: averages, several processes, samples shown, one sample learnt by heart."""

from __future__ import annotations

import csv
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from contextlib import nullcontext
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from simple_samples import simple_dataset

from data_gen.generate import GenerateConfig, generate
from data_gen.sample import SampleConfig
from hybrid.errors import ConfigError, DataError
from hybrid.image_io import read_photo
from hybrid.learn.datasets.film import batch_of, training_view
from hybrid.learn.datasets.samples import film_of, photo_of
from hybrid.learn.datasets.shards import FILM_MAPS, data_digest
from hybrid.learn.networks.edgenet import EdgeNet, EdgeNetConfig
from hybrid.learn.networks.filmnet import FilmNet, FilmNetConfig
from hybrid.learn.networks.losses import masked_mean
from hybrid.learn.networks.weights import images_shown, load_weights, notes_of, save_weights
from hybrid.learn.paper.dewarpnet import DewarpNetConfig, ShapeNet
from hybrid.learn.paper.firenet import FiReNet, FiReNetConfig
from hybrid.learn.training import state as state_module
from hybrid.learn.training import train as train_module
from hybrid.learn.training.curves import append_row, cut_rows
from hybrid.learn.training.feeds.feed import Feed
from hybrid.learn.training.feeds.film import FILM_FEED
from hybrid.learn.training.plan import Plan, TrainConfig
from hybrid.learn.training.presets import PRESETS
from hybrid.learn.training.state import Rank, State, load_start
from hybrid.learn.training.train import train

ROOT = Path(__file__).parents[1]
TINY = FilmNetConfig(widths=(4, 8, 8, 8), blocks=(1, 1, 1), input_px=64)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Twelve samples of rolled sheets."""
    return simple_dataset(tmp_path_factory.mktemp("data"), count=12, shard_size=6)


@pytest.fixture
def tiny(monkeypatch):
    """FilmNet's preset, small enough for tests."""
    monkeypatch.setitem(PRESETS, "filmnet", replace(PRESETS["filmnet"], config=TINY, batch=4))


def quick_run(dataset: Path, out: Path, **options) -> TrainConfig:
    short = {"passes": 16, "held_out": 2, "loaders": 0, "steps_per_test": 4, "minutes_per_save": 0.0}
    return TrainConfig(**{"data": (dataset,), "out": out} | short | options)


# ---------------------------------------------------------------- tests on the way


@pytest.mark.usefixtures("tiny")
def test_every_test_shows_samples(dataset, tmp_path):
    train(quick_run(dataset, tmp_path, held_out=9))
    assert read_photo(tmp_path / "samples.png").std() > 10


@pytest.mark.parametrize("name", ["firenet_uv_only", "dewarpnet_shape", "net_bw"])
def test_the_papers_networks_show_samples(dataset, name):
    chosen = PRESETS[name].at_width(0.03).at_input(128)
    feed = chosen.feed
    assert feed.picture is not None
    picture = feed.picture(chosen.network().eval(), feed.open([dataset])[:3], 128, "cpu")
    assert picture.std() > 10


def test_the_network_of_edges_learns_from_the_same_samples(dataset, tmp_path):
    train(quick_run(dataset, tmp_path, preset="edges", passes=8, batch=2, steps_per_test=2))
    rows = list(csv.DictReader((tmp_path / "curves.csv").read_text().splitlines()))
    assert [row["passes"] for row in rows] == ["4", "8"]
    for row in rows:
        assert 0 < float(row["test_percent"]) < 10
        assert 0 <= float(row["test_shown"]) <= 1
    load_weights(tmp_path / "edges.safetensors", EdgeNet, EdgeNetConfig)


@pytest.mark.usefixtures("tiny")
def test_a_training_without_held_out_samples_is_not_tested(dataset, tmp_path):
    train(quick_run(dataset, tmp_path, held_out=0))
    assert "test_" not in (tmp_path / "curves.csv").read_text()
    assert (tmp_path / "filmnet.safetensors").exists()


@pytest.mark.usefixtures("tiny")
def test_a_run_goes_on_only_with_the_options_that_it_began_with(dataset, tmp_path):
    train(quick_run(dataset, tmp_path))
    weights = (tmp_path / "filmnet.safetensors").read_bytes()
    for other, told in ({"seed": 3}, "got seed 3; allowed: "), ({"learning_rate": 0.5}, "got learning_rate 0.5"):
        with pytest.raises(ConfigError, match=told):
            train(quick_run(dataset, tmp_path, **other))
    assert (tmp_path / "filmnet.safetensors").read_bytes() == weights


@pytest.mark.usefixtures("tiny")
def test_a_run_goes_on_only_with_the_data_that_it_began_with(dataset, tmp_path):
    """Twelve samples each time, in another order or in other shards; where they lie does not matter."""
    first, second = (simple_dataset(tmp_path / name, 4 * k, 4 * k) for k, name in ((1, "a"), (2, "b")))
    run = tmp_path / "run"
    train(quick_run(dataset, run, data=(first, second)))
    for data in (second, first), (dataset,):
        with pytest.raises(ConfigError, match=r"got data \w+; allowed: \w+, as the run.*with the data, in the order"):
            train(quick_run(dataset, run, data=data))
    moved = first.rename(tmp_path / "moved")
    train(quick_run(dataset, run, data=(moved, second), passes=20))


@pytest.mark.usefixtures("tiny")
def test_a_run_goes_on_only_in_the_precision_that_it_began_with(dataset, tmp_path, monkeypatch):
    train(quick_run(dataset, tmp_path))
    had = state_module.fast_bfloat16("cpu")
    monkeypatch.setattr(state_module, "fast_bfloat16", lambda device: not had)
    with pytest.raises(ConfigError, match=r"got precision (bfloat16|float32); allowed: .*kind of processor"):
        train(quick_run(dataset, tmp_path))


@pytest.mark.parametrize("lacks", ["data", None])
@pytest.mark.usefixtures("tiny")
def test_checkpoints_of_earlier_versions_are_refused_in_a_line(dataset, tmp_path, lacks):
    """None: they did not record at all how they began."""
    train(quick_run(dataset, tmp_path))
    path = tmp_path / "checkpoint.pt"
    stored = torch.load(path, weights_only=True)
    stored.pop("began") if lacks is None else stored["began"].pop(lacks)
    torch.save(stored, path)
    with pytest.raises(ConfigError, match=r"does not say its \w+, made by an earlier version.*another --out.*--start"):
        train(quick_run(dataset, tmp_path))


@pytest.mark.usefixtures("tiny")
def test_damaged_checkpoints_are_told_with_what_to_do(dataset, tmp_path):
    """Cut off, overwritten, of something else, or of a network of another shape."""
    train(quick_run(dataset, tmp_path))
    path, curves = tmp_path / "checkpoint.pt", (tmp_path / "curves.csv").read_bytes()
    whole, stored = path.read_bytes(), torch.load(path, weights_only=True)
    rng = np.random.default_rng(0)
    damaged = [whole[: int(share * len(whole))] for share in (0, 0.001, 0.5, 0.999)]
    damaged += [b"no checkpoint", rng.bytes(5000), whole[:3000] + rng.bytes(3000) + whole[6000:]]
    for other in (torch.zeros(3), {**stored, "network": {}}, {k: v for k, v in stored.items() if k != "optimiser"}):
        torch.save(other, path)
        damaged.append(path.read_bytes())
    told = rf"{re.escape(str(path))}\): got no whole checkpoint \(.*Delete it, or choose another --out; .*--start"
    for data in damaged:
        path.write_bytes(data)
        with pytest.raises(DataError, match=told):
            train(quick_run(dataset, tmp_path, passes=20))
        assert (tmp_path / "curves.csv").read_bytes() == curves
    path.write_bytes(whole)
    train(quick_run(dataset, tmp_path, passes=20))


def test_the_digest_of_data_tells_numbered_files_apart(tmp_path):
    """Flat prints and lit films are such files, and have no manifest."""
    folders = [tmp_path / name for name in ("a", "b")]
    for k, folder in enumerate(folders):
        folder.mkdir()
        (folder / "dataset.json").write_text(f'{{"seed": {k}}}')
        (folder / "000000.npz").write_bytes(b"12345")
    both = data_digest(folders)
    assert both != data_digest(folders[::-1])
    assert data_digest(folders[:1]) != data_digest(folders[1:])
    (folders[1] / "000000.npz").write_bytes(b"123456")
    assert both != data_digest(folders)


def test_the_digest_of_data_tells_other_maps_of_film_net_apart(dataset, tmp_path):
    copied, digests = Path(shutil.copytree(dataset, tmp_path / "copied")), []
    for maps in (None, b"these", b"those"):
        if maps is not None:
            (copied / FILM_MAPS).write_bytes(maps)
        digests.append(data_digest([copied]))
    assert digests[0] == data_digest([dataset])
    assert len(set(digests)) == 3


def test_curves_of_steps_that_come_again_are_left_out(tmp_path):
    path = tmp_path / "curves.csv"
    path.write_text("passes,loss\n100,3\n200,2\n300,1\n")
    cut_rows(path, 200)
    assert path.read_text() == "passes,loss\n100,3\n200,2\n"


def test_an_empty_file_of_curves_stops_no_run(tmp_path):
    path = tmp_path / "curves.csv"
    path.write_text("")
    cut_rows(path, 200)
    append_row(path, {"passes": 1, "loss": 2})
    assert path.read_text().split() == ["passes,loss", "1,2"]


@pytest.mark.usefixtures("tiny")
def test_a_complete_run_gives_its_weights_again(dataset, tmp_path):
    train(quick_run(dataset, tmp_path))
    path = tmp_path / "filmnet.safetensors"
    weights = load_weights(path, FilmNet, FilmNetConfig).state_dict()
    path.unlink()
    train(quick_run(dataset, tmp_path))
    again = load_weights(path, FilmNet, FilmNetConfig).state_dict()
    assert all(torch.equal(value, again[name]) for name, value in weights.items())


@pytest.mark.usefixtures("tiny")
def test_a_run_goes_on_without_the_file_that_it_started_from(dataset, tmp_path):
    train(quick_run(dataset, tmp_path / "first"))
    start = tmp_path / "first" / "filmnet.safetensors"
    train(quick_run(dataset, tmp_path / "second", passes=8, start=(start,)))
    start.unlink()
    train(quick_run(dataset, tmp_path / "second", passes=16, start=(start,)))
    assert len((tmp_path / "second" / "curves.csv").read_text().split()) == 3
    again = tmp_path / "second" / "filmnet.safetensors"
    assert (notes_of(again)["passes"], notes_of(again)["before"]) == (16, 16)
    train(quick_run(dataset, tmp_path / "third", passes=8, start=(again,)))
    assert images_shown(notes_of(tmp_path / "third" / "filmnet.safetensors")) == 40


@pytest.mark.parametrize("loaders", [0, 1])
@pytest.mark.usefixtures("tiny")
def test_data_that_cannot_be_used_is_told_in_a_line(dataset, tmp_path, monkeypatch, loaders):
    def refuse(*_):
        raise DataError("these photos will not do")

    feed = replace(PRESETS["filmnet"].feed, batch=refuse)
    monkeypatch.setitem(PRESETS, "filmnet", replace(PRESETS["filmnet"], own_feed=feed))
    with pytest.raises(DataError) as told:
        train(quick_run(dataset, tmp_path, loaders=loaders))
    assert str(told.value) == "these photos will not do"


@pytest.mark.usefixtures("tiny")
def test_ctrl_c_amid_a_test_loses_none_of_its_figures(dataset, tmp_path, monkeypatch):
    def interrupted(*arguments):
        signal.raise_signal(signal.SIGINT)
        return FILM_FEED.test(*arguments)

    feed = replace(PRESETS["filmnet"].feed, test=interrupted)
    monkeypatch.setitem(PRESETS, "filmnet", replace(PRESETS["filmnet"], own_feed=feed))
    with pytest.raises(KeyboardInterrupt):
        train(quick_run(dataset, tmp_path))
    monkeypatch.setitem(PRESETS, "filmnet", replace(PRESETS["filmnet"], own_feed=FILM_FEED))
    train(quick_run(dataset, tmp_path))
    rows = list(csv.DictReader((tmp_path / "curves.csv").read_text().splitlines()))
    assert [row["passes"] for row in rows] == ["16"]


def test_dewarpnet_starts_from_its_stages(tmp_path):
    chosen = {name: PRESETS[name].at_width(0.03) for name in ("dewarpnet", "dewarpnet_shape", "dewarpnet_bw")}
    files = []
    for name in ("dewarpnet_shape", "dewarpnet_bw"):
        files.append(tmp_path / f"{name}.safetensors")
        save_weights(files[-1], chosen[name].network(), chosen[name].config, {})
    network = chosen["dewarpnet"].network()
    load_start(network, tuple(files))
    shape = load_weights(files[0], ShapeNet, DewarpNetConfig)
    for name, value in network.shape_net.state_dict().items():
        torch.testing.assert_close(value, shape.state_dict()[name], rtol=0, atol=1e-2)
    with pytest.raises(ConfigError, match="--start"):
        load_start(shape, tuple(files))


@pytest.mark.usefixtures("tiny")
def test_curves_of_a_run_that_ended_before_its_first_checkpoint_are_begun_anew(dataset, tmp_path):
    train(quick_run(dataset, tmp_path, passes=8, steps_per_test=1))
    curves = (tmp_path / "curves.csv").read_text()
    (tmp_path / "checkpoint.pt").unlink()
    train(quick_run(dataset, tmp_path, passes=8, steps_per_test=1))
    assert (tmp_path / "curves.csv").read_text() == curves


# ---------------------------------------------------------------- learning rate and input size of a step


def test_the_learning_rate_warms_up_and_falls_by_half_a_cosine(tmp_path):
    config = TrainConfig((tmp_path,), tmp_path, passes=4000, batch=4, learning_rate=0.8)
    plan = Plan.of(config)
    assert plan.steps == 1000
    rates = np.array([plan.rate_at(step) for step in range(1000)])
    np.testing.assert_allclose(rates[:20], 0.8 * np.arange(1, 21) / 20)
    assert rates.argmax() in (19, 20)
    assert rates[20 + 490] == pytest.approx(0.4)
    np.testing.assert_allclose(rates[20:] + rates[20:][::-1], 0.8, atol=2e-3)
    assert 0 < rates[-1] < 1e-5
    assert np.diff(rates[20:]).max() < 0


def test_the_coarse_part_comes_first(tmp_path):
    plan = Plan.of(TrainConfig((tmp_path,), tmp_path, passes=400, batch=4, coarse_share=0.25, coarse_px=64))
    own = plan.preset.config.input_px
    assert [plan.px_at(step) for step in (0, 24, 25, 99)] == [64, 64, own, own]


# ---------------------------------------------------------------- averaged weights


@pytest.mark.usefixtures("tiny")
def test_the_saved_weights_are_the_average_over_the_steps(dataset, tmp_path, monkeypatch):
    """a_k = d a_(k-1) + (1 - d) w_k with d = min(ema, (1 + k) / (10 + k)), from a_0 = w_0."""
    original, states = State.update, []

    def recorded(self, images, targets):
        if not states:
            states.append(self.network.head.weight.detach().clone())
        terms = original(self, images, targets)
        states.append(self.network.head.weight.detach().clone())
        return terms

    monkeypatch.setattr(State, "update", recorded)
    train(quick_run(dataset, tmp_path, passes=24, ema=0.3))
    average = states[0]
    for k, weights in enumerate(states[1:], start=1):
        decay = min(0.3, (1 + k) / (10 + k))
        average = decay * average + (1 - decay) * weights
    saved = load_weights(tmp_path / "filmnet.safetensors", FilmNet, FilmNetConfig).head.weight
    torch.testing.assert_close(saved, average, atol=1e-4, rtol=1e-3)  # stored in half precision


# ---------------------------------------------------------------- several processes


def in_two_processes(dataset: Path, out: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """``hybrid train`` of a tiny network under torchrun on this machine."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    launcher = ["torch.distributed.run", "--nproc-per-node=2", "--master-addr=127.0.0.1", f"--master-port={port}"]
    network = ["--preset", "firenet_uv_only", "--width", "0.03", "--input-px", "64", "--held-out", "2"]
    speed = ["--loaders", "0", "--steps-per-test", "2", "--minutes-per-save", "0"]
    command = ["hybrid.cli", "train", "--data", str(dataset), "--out", str(out), *network, *speed, *options]
    return subprocess.run(
        [sys.executable, "-m", *launcher, "-m", *command],
        env=os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), "GLOO_SOCKET_IFNAME": "lo"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def test_two_processes_train_one_network_and_resume(dataset, tmp_path):
    for passes, rows in ((8, 1), (16, 2)):
        done = in_two_processes(dataset, tmp_path, "--batch", "4", "--passes", str(passes))
        assert done.returncode == 0, done.stderr[-3000:]
        assert {path.name for path in tmp_path.iterdir()} == {
            "checkpoint.pt",
            "curves.csv",
            "firenet_uv_only.safetensors",
            "samples.png",
        }
        assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["step"] == passes // 4
        assert len((tmp_path / "curves.csv").read_text().splitlines()) == 1 + rows
        network = load_weights(tmp_path / "firenet_uv_only.safetensors", FiReNet, FiReNetConfig)
        assert all(bool(torch.isfinite(value).all()) for value in network.state_dict().values())


@pytest.mark.usefixtures("tiny")
def test_a_loss_that_is_no_number_ends_the_run_and_spoils_nothing(dataset, tmp_path, monkeypatch):
    train(quick_run(dataset, tmp_path, passes=16))
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    losses = PRESETS["filmnet"].losses
    broken = replace(PRESETS["filmnet"], losses=lambda *seen: {k: x * torch.nan for k, x in losses(*seen).items()})
    monkeypatch.setitem(PRESETS, "filmnet", broken)
    with pytest.raises(DataError, match=r"no number, in step 5.*from before"):
        train(quick_run(dataset, tmp_path, passes=32))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == kept


def test_weights_that_are_no_numbers_are_not_written(tmp_path):
    network = EdgeNet(EdgeNetConfig())
    next(iter(network.parameters())).data.view(-1)[0] = 1e5  # more than half precision holds
    with pytest.raises(DataError, match="no finite number"):
        save_weights(tmp_path / "edges.safetensors", network, EdgeNetConfig(), {})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["dewarpnet", "dewarpnet_bw"])
def test_a_batch_too_small_to_be_normalised_is_refused(dataset, tmp_path, name):
    with pytest.raises(ConfigError, match=r"batch: got 1; allowed: >= 2 for each of 1 processes"):
        train(quick_run(dataset, tmp_path, preset=name, width=0.05, input_px=128, batch=1))
    train(quick_run(dataset, tmp_path, preset=name, width=0.05, input_px=128, batch=2, passes=2))


@pytest.mark.usefixtures("tiny")
def test_a_batch_that_the_processes_cannot_share_is_refused(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(train_module, "_processes", lambda device: nullcontext(Rank(0, 3)))
    with pytest.raises(ConfigError, match="multiples of the 3 processes"):
        train(quick_run(dataset, tmp_path))


# ---------------------------------------------------------------- one sample by heart


STEPS = 2000


@pytest.mark.slow
def test_one_sample_can_be_learnt_by_heart(tmp_path, monkeypatch):
    """FilmNet at its own widths, on one view of 128 px: the mean distance between predicted and true film points.

    In film units, times the film's mean side in the view, scaled from 128 to 1080: it falls below 0.3 px of a 1080 px
    photo. Normalised by the view's own statistics, as in training: over the 16 pixels at 1/32 of the view, the running
    variance (divided by 15) is 7 % larger than the one used in training (divided by 16).
    """
    px, one_view = 128, None

    def same(places, px, rng):
        return batch_of([one_view])

    def error(network, places, px, device):
        images, targets = same(places, px, None)
        with torch.inference_mode():
            distance = (deepcopy(network).train()(images).uv - targets.uv).norm(dim=1)
        mean = float(masked_mean(distance, targets.mask))
        return {"test_px": mean * film_side * 1080 / px}

    data, sample = tmp_path / "data", SampleConfig(photos_per_film=4)
    generate(GenerateConfig(count=4, out=data, seed=7, size=px, map_size=px, workers=0, shard_size=4, sample=sample))
    place = FILM_FEED.open([data])[0]
    one_view = training_view(place, px, np.random.default_rng(0), None)
    film_side = float(np.mean(film_of(place).mean_film_pixels())) * px / max(photo_of(place).shape)
    chosen = replace(PRESETS["filmnet"], own_feed=Feed(FILM_FEED.open, same, error), batch=1).at_input(px)
    monkeypatch.setitem(PRESETS, "filmnet", chosen)
    train(quick_run(data, tmp_path, passes=STEPS, steps_per_test=STEPS // 8, minutes_per_save=9.0))
    with (tmp_path / "curves.csv").open() as file:
        errors = [float(row["test_px"]) for row in csv.DictReader(file)]
    print("px of 1080 after each eighth of the steps:", errors)
    assert errors[-1] < 0.3
