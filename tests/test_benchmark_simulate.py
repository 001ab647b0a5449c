"""The simulation benchmark: its command, its JSON, its picture."""

import json

from benchmarks.scenes.recipe_picture import TILE_PX, contact_sheet, picture_of
from benchmarks.simulate import BOUNDS, broken_bounds, developability, main, recipe_frames, speed


def test_the_command_writes_the_keys_it_promises(tmp_path):
    path = tmp_path / "figures.json"
    assert main(["--json", str(path), "--quick", "--only", "hanging_sheet", "sze", "stress", "--scenes", "3"]) == 0
    figures = json.loads(path.read_text())
    assert figures["hanging_sheet"]["max_strain"] <= 1e-4
    assert figures["hanging_sheet"]["drift_rad"] < 0.01
    assert figures["sze"]["max_error"] < 0.01
    assert figures["stress"]["scenes"] == 3
    assert figures["stress"]["failures"] == 0
    assert "benchmarks.simulate" in figures["run"]["command"]


def test_a_bound_that_is_broken_fails_the_command():
    """All else may be right: every bound counts, but only for checks that were made."""
    right = {
        "hanging_sheet": {"max_strain": 1e-6, "drift_rad": 1e-4},
        "elastica": {"max_error": 1e-3, "falls_with_refinement": True},
        "sze": {"max_error": 1e-3},
        "developability": {"shrinks": True},
        "units": {"max_relative": 1e-12},
        "determinism": {"identical": True},
        "stress": {"failures": 0},
    }
    assert broken_bounds(right) == []
    assert broken_bounds({"determinism": {"identical": True}}) == []
    for check, bounds in BOUNDS.items():
        for name, _ in bounds:
            wrong = {"max_strain": 1.0, "drift_rad": 3.0, "max_error": 0.9, "failures": 1, "max_relative": 0.5}.get(
                name, False
            )
            assert broken_bounds(right | {check: right[check] | {name: wrong}}) == [f"{check}.{name}: {wrong}"]


def test_speed_says_where_the_time_goes():
    figures = speed(9, 3)
    assert figures["fps"] > 1
    assert figures["max_strain"] < 1e-4
    assert 0 < figures["share_of_time"]["factor"] < 1


def test_recipes_are_measured_and_drawn():
    frames = recipe_frames(0, 1, ("flat", "clip", "twisted", "curled"))
    figures = developability(frames)
    assert set(figures["recipes"]) == set(frames)
    tiles = [picture_of(found[0].mesh, name, 620.0) for name, found in frames.items()]
    sheet = contact_sheet(tiles, 3)
    assert sheet.shape == (2 * TILE_PX, 3 * TILE_PX, 3)
    assert sheet[:TILE_PX, :TILE_PX].std() > 10
    assert figures["recipes"]["flat"]["gauss_area_p99_rad"] < 1e-9
