"""The grid edited by hand (failure 28): a moved corner goes where it is put; undoing restores what was there."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from film_photos import Shot, film_print, photographed
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.backward import BackwardMap
from hybrid.errors import ConfigError
from hybrid.grid_edit import MOST_CELLS, GridEdit
from hybrid.image_io import write_rgb
from hybrid.outputs import save_result
from hybrid.pipeline import Rectifier
from hybrid.records import LeftOut, RectifyResult, Status, StatusCode

IT = photographed(film_print(19), Shot())


@pytest.fixture(scope="module")
def rectifier() -> Rectifier:
    return Rectifier()


@pytest.fixture(scope="module")
def result(rectifier: Rectifier) -> RectifyResult:
    return rectifier(IT.photo)


@pytest.fixture(scope="module")
def edit(result: RectifyResult) -> GridEdit:
    return GridEdit.of(result)


def place(edit: GridEdit, row: int, col: int) -> np.ndarray:
    return edit.grid.vertices_photo[row, col]


def test_a_corner_goes_where_it_is_put_and_the_others_stay(edit: GridEdit):
    to = place(edit, 2, 1) + np.array([5, -3])
    moved = edit.moved(2, 1, to)
    vertices = moved.backward.photo_from_film(moved.grid.vertices)
    before = edit.backward.photo_from_film(edit.grid.vertices)
    np.testing.assert_allclose(place(moved, 2, 1), to)
    np.testing.assert_allclose(vertices[2, 1] - before[2, 1], [5, -3], atol=0.01)
    apart = np.linalg.norm(vertices - before, axis=-1)
    apart[2, 1] = 0
    assert apart.max() < 0.01
    np.testing.assert_array_equal(edit.grid.vertices_photo, edit.start.vertices_photo)


def test_corners_of_many_cells_too(result: RectifyResult):
    """Corners of ten by ten cells lie three nodes of the map apart; one is moved far, its neighbour to where it was."""
    edit = GridEdit.of(result, (10, 10))
    edit = edit.moved(2, 2, place(edit, 2, 2) + np.array([15, 0])).moved(3, 2, place(edit, 3, 2))
    vertices = edit.backward.photo_from_film(edit.grid.vertices)
    np.testing.assert_allclose(vertices, edit.grid.vertices_photo, atol=0.05)


def test_corners_of_as_many_cells_as_may_be_too(result: RectifyResult):
    edit = GridEdit.of(result, (MOST_CELLS, MOST_CELLS))
    at = edit.grid.vertices_photo
    moved = edit.moved(12, 7, at[12, 7] + 0.2 * (at[12, 8] - at[12, 7]))
    found = moved.backward.photo_from_film(edit.start.vertices)
    assert np.abs(found - moved.grid.vertices_photo).max() < 0.05


def test_a_film_that_was_moved_as_a_whole_is_moved_back(result: RectifyResult):
    """All corners are put where they belong in a map that is off: it is right again, inside the grid and around it."""
    assert result.backward is not None
    assert result.grid is not None
    apart = np.array([8.0, -6.0])
    shifted = BackwardMap(result.backward.nodes + apart)
    edit = GridEdit.of(
        replace(result, backward=shifted, grid=replace(result.grid, vertices_photo=result.grid.vertices_photo + apart))
    )
    for row, col in np.ndindex(edit.grid.rows + 1, edit.grid.cols + 1):
        edit = edit.moved(row, col, result.grid.vertices_photo[row, col])
    assert np.abs(edit.backward.nodes - result.backward.nodes).max() < 0.5


@settings(max_examples=30, deadline=None)
@given(steps=st.lists(st.sampled_from(["move", "undo", "redo", "reset"]), max_size=12), data=st.data())
def test_whatever_is_undone_is_as_it_was(edit: GridEdit, steps: list[str], data: st.DataObject):
    """Compared with the plainest history there is: a list of states and a position in it."""
    states, at = [edit], 0
    now = edit
    for step in steps:
        if step == "move":
            row, col = (data.draw(st.integers(0, n)) for n in (edit.grid.rows, edit.grid.cols))
            now = now.moved(row, col, place(edit, row, col) + data.draw(st.integers(-4, 4)))
            states, at = [*states[: at + 1], now], at + 1
        else:
            now = {"undo": now.undo, "redo": now.redo, "reset": now.reset}[step]()
            at = {"undo": max(at - 1, 0), "redo": min(at + 1, len(states) - 1), "reset": 0}[step]
        np.testing.assert_array_equal(now.grid.vertices_photo, states[at].grid.vertices_photo)
        np.testing.assert_array_equal(now.backward.nodes, states[at].backward.nodes)


def test_moves_that_cannot_be_are_refused(edit: GridEdit):
    with pytest.raises(ConfigError, match="rows 0 to"):
        edit.moved(edit.grid.rows + 1, 0, (10.0, 10.0))
    with pytest.raises(ConfigError, match="fold"):
        edit.moved(1, 1, place(edit, 3, 3))
    for no_point in ((np.nan, 10.0), (1.0, 2.0, 3.0), np.zeros((2, 2))):
        with pytest.raises(ConfigError, match="Place of a corner"):
            edit.moved(1, 1, no_point)
    for no_number in ((np.nan, 10.0), (10.0, np.inf)):
        with pytest.raises(ConfigError, match=r"allowed: a photo point \(x, y\)\. Name two numbers"):
            edit.moved(1, 1, no_number)


def test_a_grid_can_be_given(result: RectifyResult):
    edit = GridEdit.of(replace(result, grid=None), cells=(2, 3))
    assert edit.grid.vertices.shape == (3, 4, 2)
    np.testing.assert_allclose(edit.grid.vertices_photo[0, 0], result.backward.nodes[0, 0])
    for wrong in ((0, 3), (2, MOST_CELLS + 1)):
        with pytest.raises(ConfigError, match="rows and columns"):
            GridEdit.of(result, cells=wrong)


def test_what_cannot_be_edited_is_refused(result: RectifyResult):
    with pytest.raises(ConfigError, match="corners"):
        GridEdit.of(RectifyResult(Status(StatusCode.NO_FILM)))
    with pytest.raises(ConfigError, match="rows and columns"):
        GridEdit.of(replace(result, grid=None))


# ---------------------------------------------------------------- the film of an edit


def test_the_film_of_an_edit_is_made_anew(rectifier: Rectifier, result: RectifyResult, edit: GridEdit):
    photo = IT.photo.copy()
    moved = edit.moved(2, 2, place(edit, 2, 2) + np.array([6, 4]))
    film = rectifier.edited(IT.photo, moved)
    np.testing.assert_array_equal(photo, IT.photo)
    assert film.film.shape == result.film.shape
    assert film.status.code is StatusCode.UNSURE
    assert film.status.doubts == ("edited by hand",)
    assert film.expected_error_px is None
    assert film.grid is moved.grid
    assert film.backward is moved.backward
    assert [stage.name for stage in film.stages] == ["read", "resample", "light"]
    apart = np.abs(film.film - result.film)
    h, w = apart.shape
    middle, corner = apart[h // 4 : -h // 4, w // 4 : -w // 4].mean(), apart[: h // 8, : w // 8].mean()
    assert middle > 3 * corner
    assert len(film.slices()) == len(result.slices())


def test_a_fused_film_that_is_edited_is_one_photo_s_and_leaves_the_fused_one_in_place(
    rectifier: Rectifier, result: RectifyResult, tmp_path: Path
):
    photos = [tmp_path / name for name in ("blank.png", "film.png", "other.png")]
    for path in photos:
        write_rgb(path, IT.photo)
    fused = replace(result, photo=1, photos=3, left_out=(LeftOut(0, "no film was found in it"),))
    before = {path: path.read_bytes() for path in save_result(photos, fused, tmp_path / "out")}
    edit = GridEdit.of(fused)
    film = rectifier.edited(photos[fused.photo], edit.moved(2, 2, place(edit, 2, 2) + 3))
    files = save_result(photos[fused.photo], film, tmp_path / "out")
    assert files[-1] == tmp_path / "out" / "film.json"
    assert "left_out" not in json.loads(files[-1].read_text())
    assert {path: path.read_bytes() for path in before} == before


def test_another_photo_is_refused(rectifier: Rectifier, edit: GridEdit):
    moved = edit.moved(2, 2, place(edit, 2, 2) + 3)
    with pytest.raises(ConfigError, match="Another photo: got 300 x 200 pixels"):
        rectifier.edited(np.zeros((200, 300, 3), np.uint8), moved)


def test_what_hides_the_film_does_so_after_an_edit_too(rectifier: Rectifier, result: RectifyResult, edit: GridEdit):
    """What was found to lie in front of the film stays marked and is not trusted."""
    covered = np.zeros_like(result.covered)
    covered[: covered.shape[0] // 4] = True
    hidden = replace(edit, result=replace(result, covered=covered))
    film = rectifier.edited(IT.photo, hidden.moved(2, 2, place(edit, 2, 2) + 3))
    np.testing.assert_array_equal(film.covered, covered)
    assert film.confidence[covered].max() == 0
    assert np.median(film.confidence[~covered]) > 0.5


def test_an_edit_that_was_reset_is_the_result_itself(rectifier: Rectifier, result: RectifyResult, edit: GridEdit):
    moved = edit.moved(1, 2, place(edit, 1, 2) + 3)
    assert rectifier.edited(IT.photo, moved.reset()) is result
    assert rectifier.edited(IT.photo, moved.undo()) is result


def test_moves_are_done_again_in_their_order_and_not_after_another(edit: GridEdit):
    one, two, three = (place(edit, 1, k) + 3 for k in (1, 2, 3))
    both = edit.moved(1, 1, one).moved(1, 2, two)
    back = both.undo().undo()
    assert [move.col for move in back.redo().done] == [1]
    assert back.redo().redo().done == both.done
    assert back.moved(1, 3, three).redo().done == back.moved(1, 3, three).done


def test_a_grid_that_fills_the_sheet_takes_its_corners_along(result: RectifyResult):
    edit = GridEdit.of(result, (4, 5))
    moved = edit.moved(0, 0, place(edit, 0, 0) + np.array([6.0, 4.0]))
    corner = moved.backward.photo_from_film(np.array([[0.0, 0.0]]))[0]
    np.testing.assert_allclose(corner, place(moved, 0, 0), atol=0.01)
