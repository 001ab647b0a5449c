"""The card: correct figures for known films, charts that show them, and a command that makes the set again."""

import json
import shlex
from dataclasses import asdict

import cv2
import numpy as np
import pytest
import tyro
from simple_samples import SIZE_MM, cylinder

from data_gen.card import LABELS, bend_of, label_values, main, write_card
from data_gen.card_text import _same, command
from data_gen.charts import ticks
from data_gen.generate import GenerateConfig, generate
from data_gen.sample import SampleConfig
from data_gen.sources import SourceConfig
from hybrid.coords import film_nodes
from hybrid.errors import DataError
from hybrid.learn.datasets.shards import open_dataset, read_description
from hybrid.mesh.recipes import BendConfig

SAMPLE = SampleConfig(photos_per_film=4, bend=BendConfig(frames=3, keep_from=1))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("data")
    generate(GenerateConfig(count=4, out=out, seed=2, size=48, map_size=32, workers=0, shard_size=4, sample=SAMPLE))
    return out


def record(world, film):
    return {"grid": {"world": world.tolist(), "film": film.tolist()}, "size_mm": SIZE_MM}


@pytest.mark.parametrize("radius", [200.0, 600.0])
def test_the_bend_of_a_cylinder_is_its_radius_and_half_its_angle(radius):
    film = film_nodes((5, 13))
    slope, curvature = bend_of(record(cylinder(film, radius)[0], film))
    assert slope == pytest.approx(np.rad2deg(SIZE_MM[1] / radius / 2), rel=0.02)
    assert curvature == pytest.approx(1000 / radius, rel=0.03)


def test_a_flat_film_however_it_lies_is_not_bent():
    film = film_nodes((5, 4))
    mm = film * SIZE_MM[::-1]
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    world = np.concatenate([mm, np.zeros((5, 4, 1))], axis=-1) @ turn.T + 50
    np.testing.assert_allclose(bend_of(record(world, film)), 0, atol=1e-3)


def test_the_card_has_its_pictures_and_figures(folder):
    text = (folder / "card.md").read_text()
    assert "4 photos of 1 film: 48 x 48 px, maps 32 x 32" in text
    assert all(label.title in text for label in LABELS if label.unit is not None)
    for name in ("histograms.png", "contact_sheet.jpg"):
        assert f"({name})" in text
        assert cv2.imread(str(folder / name)).std() > 5


def test_a_card_is_the_same_when_made_again(folder):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    write_card(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_labels_of_every_sample_are_known(folder):
    values = label_values(open_dataset(folder))
    for label in LABELS:
        assert len(values[label.title]) == 4
        assert all(isinstance(v, str) if label.unit is None else np.isfinite(v) for v in values[label.title])


@pytest.mark.parametrize("low", [-180.0, 0.0, 0.013])
@pytest.mark.parametrize("span", [0.07, 1.0, 33.0, 360.0])
def test_ticks_are_few_and_within(low, span):
    marks = ticks(low, low + span)
    assert 3 <= len(marks) <= 10
    assert all(low <= mark <= low + span for mark in marks)


def test_the_command_makes_the_same_options(folder):
    """The card's command is parsed to the options that the set was made with."""
    described = read_description(folder)
    described["shard_size"] = 16  # whole films, of 8 photos by default
    described["sources"] |= {"only": ["scan a", "b*"], "leave_out": ["c"], "phantoms": [3, 5], "volumes": ["scan a"]}
    words = shlex.split(command(described).replace("\\\n", " "))[3:]
    config = tyro.cli(GenerateConfig, args=words)
    assert (config.count, config.seed, config.size, config.map_size, config.shard_size) == (4, 2, 48, 32, 16)
    assert config.sources == SourceConfig(
        ct=config.sources.ct, only=("scan a", "b*"), leave_out=("c",), phantoms=(3, 5), real_share=0.6
    )
    assert str(config.sources.ct) == "CT_FOLDER"


def test_options_that_the_command_has_no_words_for_are_named(folder):
    """The set has another number of photos per film than the command's default of eight."""
    described = read_description(folder)
    text = _same(described)
    assert "`photos_per_film`" in text
    assert "`size`" not in text
    usual = json.loads(json.dumps(asdict(SampleConfig(size=48, map_size=32))))
    described["sample"] = {name: value for name, value in usual.items() if name != "sources"}
    assert _same(described) == "The same command gives the same bytes"


def test_dataset_json_names_no_path_of_this_machine(folder):
    assert "/" not in json.dumps(read_description(folder))


def test_a_folder_without_data_set_has_no_card(tmp_path):
    with pytest.raises(DataError, match="no data set"):
        write_card(tmp_path)


def test_the_command_ends_in_one_line(tmp_path, monkeypatch, capsys):
    """This holds if there is no data set, if the system refuses something, or if the command is stopped."""

    def ended():
        with pytest.raises(SystemExit) as end:
            main()
        return end.value.code

    def refused(folder):
        raise PermissionError(13, "Permission denied", str(folder / "card.md"))

    def stopped(folder):
        raise KeyboardInterrupt

    monkeypatch.setattr("sys.argv", ["card", str(tmp_path)])
    assert ended().startswith(f"error: data set ({tmp_path}): got no data set")
    monkeypatch.setattr("data_gen.card.write_card", refused)
    assert ended().startswith(
        f"error: A file cannot be read or written ({tmp_path / 'card.md'}): got Permission denied"
    )
    monkeypatch.setattr("data_gen.card.write_card", stopped)
    assert ended() == 130
    assert capsys.readouterr().err == "stopped; the card is not whole, and the same command makes all of it anew\n"
