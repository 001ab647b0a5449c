"""Pictures for people: lines lie where the map says, inputs are not changed, contact sheets hold every tile."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.draw import (
    annotated,
    captioned,
    contact_sheet,
    draw_curves,
    fitted,
    grid_curves,
    outline_curve,
    resized,
    rgb_from_film,
    side_by_side,
)
from hybrid.records import RectifyResult, SliceGrid, Status, StatusCode


@pytest.fixture
def photo() -> np.ndarray:
    return np.full((300, 400, 3), 90, dtype=np.uint8)


def square_film(scale: float = 1.0) -> BackwardMap:
    """A film that is seen as the square from (100, 50) to (300, 250)."""
    return BackwardMap.from_function(lambda uv: scale * (np.array([100.0, 50.0]) + 200 * uv), (4, 4))


def grid() -> SliceGrid:
    vertices = film_nodes((3, 3))
    return SliceGrid(2, 2, vertices, np.array([100.0, 50.0]) + 200 * vertices, 1.0)


def test_outline_runs_around_the_film_clockwise() -> None:
    curve = outline_curve(square_film())
    x, y = curve[:, 0], curve[:, 1]
    area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    assert area == pytest.approx(200 * 200)  # positive: clockwise on a screen, where y points down


def test_grid_curves_pass_through_the_vertices() -> None:
    curves = grid_curves(grid(), square_film())
    assert len(curves) == 6
    for vertex in grid().vertices_photo.reshape(-1, 2):
        nearest = [np.linalg.norm(curve - vertex, axis=1).min() for curve in curves]
        assert sum(distance < 1e-6 for distance in nearest) == 2


def test_lines_are_drawn_where_they_belong_and_nowhere_else(photo: np.ndarray) -> None:
    before = photo.copy()
    drawn = draw_curves(photo, [outline_curve(square_film())], (255, 0, 0), closed=True)
    touched = np.argwhere((drawn != photo).any(axis=2))[:, ::-1]  # (x, y)
    distance = np.abs(np.abs(touched - np.array([199.5, 149.5])).max(axis=1) - 100)
    assert distance.max() <= 2
    assert len(touched) >= 800
    assert np.array_equal(photo, before)


def test_a_line_far_outside_is_harmless(photo: np.ndarray) -> None:
    curve = np.array([[-1e12, 10.0], [1e12, 10.0]])
    assert draw_curves(photo, [curve], (255, 0, 0)).shape == photo.shape


def test_annotated_photo_is_bounded_and_scaled(photo: np.ndarray) -> None:
    result = RectifyResult(Status(StatusCode.OK), backward=square_film(), grid=grid())
    assert annotated(photo, result).shape == photo.shape
    small = annotated(photo, result, longer_px=200)
    assert small.shape == (150, 200, 3)
    touched = np.argwhere((small != 90).any(axis=2))[:, ::-1]
    assert np.abs(touched.min(axis=0) - [50, 25]).max() <= 2
    assert np.abs(touched.max(axis=0) - [150, 125]).max() <= 2


def test_a_photo_without_a_film_is_left_plain(photo: np.ndarray) -> None:
    assert np.array_equal(annotated(photo, RectifyResult(Status(StatusCode.NO_FILM))), photo)


def test_film_grey_is_shown_as_grey() -> None:
    shown = rgb_from_film(np.array([[0.0, 0.5, 1.0, -1.0, 2.0]], dtype=np.float32))
    assert shown[0, :, 0].tolist() == [0, 128, 255, 0, 255]
    assert np.ptp(shown, axis=2).max() == 0


def test_pictures_beside_each_other(photo: np.ndarray) -> None:
    row = side_by_side([photo, photo[:, :150]], height=150)
    assert row.shape[0] == 150
    assert row.shape[1] == 200 + 8 + 75
    assert (row[:, :200] == 90).all()


def test_fitted_keeps_the_shape(photo: np.ndarray) -> None:
    canvas = fitted(photo, (100, 100))
    assert (canvas == 90).all(axis=2).sum() == 75 * 100
    assert resized(photo, (30, 40)).shape == (30, 40, 3)


def test_contact_sheet_holds_every_tile() -> None:
    tiles = [np.full((20, 120, 3), 40 + 30 * k, dtype=np.uint8) for k in range(5)]
    sheet = contact_sheet(tiles, [f"tile {k}" for k in range(5)], columns=2)
    for k in range(5):
        assert (sheet == 40 + 30 * k).all(axis=2).sum() >= 20 * 120
    assert sheet.shape[0] == 3 * (captioned(tiles[0], "").shape[0] + 8) + 8
    with pytest.raises(ValueError, match="got 0 tiles"):
        contact_sheet([], [], columns=2)
    with pytest.raises(ValueError, match="allowed: one or more tiles of one shape"):
        contact_sheet([tiles[0], tiles[1][:5]], ["a", "b"], columns=2)
