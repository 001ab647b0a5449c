"""Laws of the single resampling of the photo."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from bent_sheets import bent_sheet

from hybrid.backward import BackwardMap, spline_weights
from hybrid.coords import (
    film_centres,
    film_centres_1d,
    film_nodes,
    opencv_from_photo,
    pixel_centres,
    pixel_from_film,
)
from hybrid.rectify.film.resample import ResampleConfig, _near_rows, index_in_grid, photo_per_film_pixel, rectify_photo


def whole_photo(size: tuple[int, int]) -> BackwardMap:
    """The map of a film that is exactly the photo."""
    return BackwardMap.from_function(lambda uv: pixel_from_film(uv, size))


def pattern(size: tuple[int, int], period_px: float) -> np.ndarray:
    """(h, w, 3) uint8 waves."""
    x, y = pixel_centres(size).transpose(2, 0, 1) * (2 * np.pi / period_px)
    return np.stack([127 + 100 * np.sin(x) * np.sin(y)] * 3, axis=-1).astype(np.uint8)


def test_identity_returns_the_photo():
    photo = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    result = rectify_photo(photo, whole_photo((60, 80)), (60, 80))
    np.testing.assert_allclose(result.image.astype(int), photo, atol=1)
    assert result.valid.all()


def test_pixels_come_from_where_the_map_says():
    """A photo whose colours are its coordinates."""
    photo = np.zeros((256, 256, 3), np.uint8)
    photo[..., 0] = np.arange(256)[None]
    photo[..., 1] = np.arange(256)[:, None]
    sheet = bent_sheet()
    backward = BackwardMap.from_function(lambda uv: sheet(uv) * (256 / 1080))
    image = rectify_photo(photo, backward, (150, 120)).image
    seen = backward.photo_from_film(film_centres((150, 120)))
    # the value of pixel k is k, and its centre lies half a pixel further
    np.testing.assert_allclose(image[..., :2], seen - 0.5, atol=0.6)


@pytest.mark.parametrize("nodes", [5, 33, 200])
def test_of_a_map_of_many_nodes_only_those_near_a_row_are_asked(nodes: int):
    """The film is also the same wherever its strips end."""
    photo, sheet = pattern((400, 400), 40.0), bent_sheet()
    backward = BackwardMap.from_function(lambda uv: sheet(uv) * (400 / 1080), (nodes, nodes))
    image = rectify_photo(photo, backward, (300, 250), ResampleConfig(cubic_below=0.0)).image
    at = opencv_from_photo(backward.dense((300, 250)))
    np.testing.assert_allclose(
        image.astype(int),
        cv2.remap(photo, at[..., 0], at[..., 1], cv2.INTER_LINEAR).astype(int),
        atol=1,
    )
    weights, near = _near_rows(spline_weights(nodes, film_centres_1d(300))[:30].astype(np.float32))
    assert near.stop - near.start <= min(nodes, nodes // 10 + 16)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)


def test_points_outside_the_photo_are_black_and_marked():
    photo = np.full((100, 100, 3), 200, np.uint8)
    backward = BackwardMap.from_function(lambda uv: uv * 100 + np.array([50.0, 0.0]))
    result = rectify_photo(photo, backward, (40, 40))
    assert result.valid[:, :20].all()
    assert not result.valid[:, 20:].any()
    assert (result.image[:, :20] == 200).all()
    assert (result.image[:, 20:] == 0).all()
    beyond = rectify_photo(photo, backward.cropped((1e4, 0.0)), (40, 40))
    assert not beyond.valid.any()


def test_shrinking_averages_instead_of_aliasing():
    photo = pattern((1200, 1200), 2.7)  # finer than the film's pixels: only its mean is left
    image = rectify_photo(photo, whole_photo((1200, 1200)), (300, 300)).image.astype(float)
    assert photo_per_film_pixel(whole_photo((1200, 1200)), (300, 300)) == pytest.approx(4.0)
    assert image.std() < 0.1 * photo.std()
    smooth = pattern((1200, 1200), 200.0)
    expected = cv2.resize(smooth, (300, 300), interpolation=cv2.INTER_AREA)
    got = rectify_photo(smooth, whole_photo((1200, 1200)), (300, 300)).image
    np.testing.assert_allclose(got.astype(int), expected, atol=2)


def test_resampling_commutes_with_cropping_the_photo():
    sheet = bent_sheet()
    backward = BackwardMap.from_function(sheet)
    photo = pattern((1080, 1080), 40.0)
    whole = rectify_photo(photo, backward, (500, 400)).image.astype(int)
    part = rectify_photo(photo[37:, 21:], backward.cropped((21.0, 37.0)), (500, 400)).image
    np.testing.assert_allclose(part, whole, atol=1)


def test_inputs_are_not_modified():
    photo = pattern((200, 200), 30.0)
    copy = photo.copy()
    rectify_photo(photo, whole_photo((200, 200)), (50, 50))
    np.testing.assert_array_equal(photo, copy)


def test_network_maps_are_read_at_their_pixel_centres():
    points = pixel_centres((64, 64)) * 10.0 + np.array([30.0, -20.0])
    column, row = index_in_grid(points, points)
    np.testing.assert_allclose(column, np.arange(64)[None].repeat(64, 0), atol=1e-9)
    np.testing.assert_allclose(row, np.arange(64)[:, None].repeat(64, 1), atol=1e-9)


def test_places_in_a_bent_grid_of_pixels_are_found():
    """As in a view of a flattened film: perspective and a bend, and points some way outside."""
    x, y = np.moveaxis(pixel_centres((32, 32)), -1, 0)
    depth = 1 + 0.008 * x + 0.004 * y
    points = np.dstack([(100 + 20 * x + 15 * np.sin(y / 9)) / depth, (50 + 22 * y) / depth])
    column, row = index_in_grid(points, points[3:-3:2, 4:-4])
    np.testing.assert_allclose(column, np.arange(4, 28)[None].repeat(13, 0), atol=0.01)
    np.testing.assert_allclose(row, np.arange(3, 29, 2)[:, None].repeat(24, 1), atol=0.01)
    beyond = points[0, 0] - 3 * (points[0, 1] - points[0, 0])
    column, row = index_in_grid(points, beyond)
    assert -5 < column < -2  # extrapolated as a plane, without the bend at the rim
    assert row == pytest.approx(0, abs=0.5)


@pytest.mark.parametrize(
    "corners", [[[300, 0], [670, 0], [0, 900], [770, 900]], [[0, 0], [446, 80], [60, 700], [680, 520]]]
)
def test_places_in_a_plane_far_aslant_are_found(corners: list):
    """As in a view of a film that is nearly edge on, its far side half as long as its near one."""
    ends = np.array([[0, 0], [48, 0], [0, 48], [48, 48]], np.float32)
    plane = cv2.getPerspectiveTransform(ends, np.array(corners, np.float32))
    at = pixel_centres((48, 48))
    column, row = index_in_grid(cv2.perspectiveTransform(at, plane), cv2.perspectiveTransform(at, plane))
    np.testing.assert_allclose(column, at[..., 0] - 0.5, atol=1e-3)
    np.testing.assert_allclose(row, at[..., 1] - 0.5, atol=1e-3)


def test_what_halving_leaves_over_of_a_photo_is_not_lost():
    """The photo is read from its quarter-size copy, and four does not divide its width."""
    photo = np.full((800, 1003, 3), 90, np.uint8)
    film = rectify_photo(photo, BackwardMap(film_nodes((5, 5)) * np.array([1003.0, 800.0])), (80, 100))
    assert film.valid.all()
    assert (film.image == 90).all()
