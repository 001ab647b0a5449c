"""The paper's tables: the truth scores perfect however it is turned, gaps are named, and the report is complete."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.methods import METHODS, Method, path_in, weights_path
from benchmarks.paper_tables import TABLES, table_text
from benchmarks.photos.cases import Case, photo_cases, read_alike, sample_cases, true_shape
from benchmarks.scores import score, summarise
from benchmarks.tables import Options, main, run, score_methods
from hybrid.backward import BackwardMap, Orientation
from hybrid.errors import ConfigError, DataError, PhotoError
from hybrid.image_io import write_rgb
from hybrid.learn.networks.filmnet import FilmNetConfig
from hybrid.learn.networks.weights import packaged_path, save_weights
from hybrid.learn.training.presets import PRESETS, Preset

EXACT_PX = 1e-6


@pytest.fixture(scope="module")
def cases(dataset: Path) -> list[Case]:
    return sample_cases([dataset])


def shifted(case: Case, px: float) -> BackwardMap:
    return case.backward.cropped((-px, 0.0))


def test_the_truth_scores_perfect_from_whatever_side_it_is_read(cases: list[Case]) -> None:
    case = cases[0]
    for index in range(8):
        way = Orientation.from_index(index)
        one = score(Method("truth", lambda photo, way=way: case.backward.turned(way)), case)
        assert one.score is not None
        assert one.score.end_point_px < EXACT_PX
        assert one.score.distortion_px < EXACT_PX
        assert (one.score.paper.raw.psnr, one.score.map.psnr) == (100, 100)
        assert one.score.up == (index == 0)


def test_a_shift_is_measured_for_a_photo_of_1080_px_and_in_parts_of_the_film(cases: list[Case]) -> None:
    case = cases[1]
    one = score(Method("shifted", lambda photo: shifted(case, 1.0)), case)
    assert one.score is not None
    assert one.score.end_point_px == pytest.approx(1080 / 48, rel=1e-6)
    assert one.score.end_point_percent == pytest.approx(100 / np.hypot(*case.backward.mean_film_pixels()), rel=1e-6)
    assert one.score.paper.deshifted.psnr > one.score.paper.raw.psnr + 20


def test_the_turn_that_is_taken_back_is_the_one_that_was_made(cases: list[Case]) -> None:
    true = cases[0].backward
    for way in map(Orientation.from_index, range(8)):
        seen, undone = read_alike(true.turned(way), true)
        np.testing.assert_allclose(seen.nodes, true.nodes, atol=EXACT_PX)
        assert undone == way.inverse


def test_lost_films_are_counted_and_stay_out_of_the_means(cases: list[Case]) -> None:
    calls = []

    def find(photo: np.ndarray) -> BackwardMap | None:
        calls.append(photo)
        if len(calls) == 2:  # the first is the warm-up
            raise PhotoError("no film")
        return None if len(calls) == 3 else shifted(cases[0], 1.0)

    row = score_methods({"some": Method("some", find, says_up=True)}, cases)["some"]
    assert (row["count"], row["lost"], row["up"]) == (4, 2, 0.5)
    assert row["end_point_px"]["mean"] == pytest.approx(1080 / 48, rel=1e-6)
    all_lost = summarise([score(Method("none", lambda photo: None), case) for case in cases], says_up=False)
    assert all_lost["lost"] == 4
    assert "raw" not in all_lost
    assert all_lost["up"] is None


# ---------------------------------------------------------------- networks


def small(name: str) -> Preset:
    """A preset's network at a size for tests."""
    if name == "filmnet":
        return Preset(
            FilmNetConfig(widths=(4, 8, 8, 8), blocks=(1, 1, 1), input_px=64),
            PRESETS[name].build,
            PRESETS[name].losses,
        )
    return PRESETS[name].at_width(0.03).at_input(128)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random weights of all networks but one, with one file where a training run writes it."""
    folder = tmp_path_factory.mktemp("weights")
    (folder / "firenet").mkdir()
    for name in ("filmnet", "dewarpnet_shape", "dewarpnet_bw", "net_bw", "net_uv", "firenet_uv_only"):
        save_weights(folder / f"{name}.safetensors", small(name).network(), small(name).config, {})
    chosen = small("firenet")
    save_weights(folder / "firenet" / "firenet.safetensors", chosen.network(), chosen.config, {})
    return folder


def test_the_report_holds_every_method_and_says_which_are_not_trained(
    dataset: Path, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "made" / "tables.json"
    names = tuple(name for name in METHODS if name != "hybrid")
    run(Options(out, (dataset,), weights, methods=names, count=3), ["python -m benchmarks.tables", f"--json={out}"])
    report = json.loads(out.read_text())
    rows = report["sets"]["samples"]
    assert set(rows) == set(names)
    assert [name for name in names if not rows[name]["trained"]] == ["firenet_multimap"]
    for name in ("dewarpnet", "net_bw"):  # these find a map in any photo
        assert rows[name]["lost"] == 0
        assert np.isfinite([*rows[name]["raw"].values(), *rows[name]["map"].values()]).all()
    assert all(len(row["photos"]) == 3 for row in rows.values() if row["trained"])
    assert {"command", "machine", "threads"} <= set(report["run"])
    assert str(tmp_path) not in out.read_text()
    printed = capsys.readouterr().out
    assert all(table.title in printed for table in TABLES)
    assert "not trained" in printed
    assert "25.30 0.8621 0.9523" in printed


def test_networks_of_3d_maps_are_given_the_true_one(cases: list[Case], tmp_path: Path) -> None:
    shape = true_shape(cases[0], 32)
    on_film = shape.code[0].permute(1, 2, 0).numpy()[shape.mask]
    assert shape.photo_size == (48, 48)
    assert np.linalg.norm(on_film - 0.5, axis=-1).max() < 0.6  # half a diagonal, and the code's centre
    assert not shape.code[0].permute(1, 2, 0).numpy()[~shape.mask].any()
    with pytest.raises(DataError, match="without one"):
        true_shape(Case("photo", tmp_path, cases[0].backward), 32)


def test_photos_with_truth_are_scored_apart(cases: list[Case], weights: Path, tmp_path: Path) -> None:
    (tmp_path / "textures").mkdir()
    print_name = "film_1_2x3_none_m0.png"
    write_rgb(tmp_path / "textures" / print_name, np.zeros((8, 8, 3), np.uint8))
    write_rgb(tmp_path / "a.jpg", cases[0].photo())
    np.savez(tmp_path / "a.npz", lattice=cases[0].backward.nodes, texture=print_name, meta="{}")
    options = Options(tmp_path / "t.json", weights=weights, photos=tmp_path, methods=("dewarpnet", "net_uv"))
    rows = run(options, ["x"])["photos"]
    assert set(rows) == {"dewarpnet"}
    assert photo_cases(tmp_path)[0].name == "a"


def test_packaged_weights_stand_in_and_others_are_not_trained(tmp_path: Path) -> None:
    assert weights_path(None, "filmnet") == weights_path(tmp_path, "filmnet") == packaged_path("filmnet")
    assert path_in(tmp_path, "filmnet") is None
    assert METHODS["net_uv"](tmp_path) is None
    assert METHODS["firenet_uv_only"](None) is None


def test_wrong_options_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ConfigError, match=r"unet.*allowed: filmnet"):
        Options(tmp_path / "t.json", (tmp_path,), methods=("unet",))
    with pytest.raises(ConfigError, match="Give --data or --photos"):
        Options(tmp_path / "t.json")
    with pytest.raises(ConfigError, match="--count"):
        Options(tmp_path / "t.json", (tmp_path,), count=0)
    assert main(["--json", str(tmp_path / "t.json"), "--data", str(tmp_path)]) == 1
    assert "data_gen.generate" in capsys.readouterr().err


def test_a_table_lists_rows_that_were_not_run() -> None:
    text = table_text(TABLES[0], {"firenet": {"trained": False}})
    assert text.count("not trained") == 1
    assert text.count("not asked for") == len(TABLES[0].rows) - 1
