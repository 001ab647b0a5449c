"""Views: windows and flattened films as maps into the photo, and the images seen through them."""

import numpy as np
import pytest

from hybrid.backward import BackwardMap, end_point_error
from hybrid.coords import film_centres, film_nodes, pixel_centres
from hybrid.learn.reading.views import (
    film_from_view,
    film_view,
    near_views,
    output_points,
    plane_of,
    square_view,
    view_image,
    whole_view,
)


def ramp(size: tuple[int, int]) -> np.ndarray:
    """A photo whose red is its x and whose green is its y, in photo coordinates, to half a grey level."""
    h, w = size
    xy = pixel_centres(size)
    blue = np.zeros((h, w))
    return np.rint(np.dstack([xy[..., 0] * 250 / w, xy[..., 1] * 250 / h, blue])).astype(np.uint8)


def bent_film() -> BackwardMap:
    uv = film_nodes((17, 17))
    x = 60 + 150 * uv[..., 0] + 12 * np.sin(3 * uv[..., 1])
    y = 50 + 170 * uv[..., 1] + 9 * np.sin(3 * uv[..., 0])
    return BackwardMap(np.stack([x, y], axis=-1))


def test_the_whole_view_covers_the_photo_and_no_more():
    view = whole_view((90, 160))
    np.testing.assert_allclose(
        view.photo_from_film(np.array([[0.0, 0.0], [1.0, 1.0]])), [[0, -35], [160, 125]], atol=1e-9
    )


@pytest.mark.parametrize(
    ("size", "middles"),
    [
        ((1000, 1000), [(350, 350), (650, 350), (350, 650), (650, 650)]),
        ((1000, 2000), [(700, 500), (1300, 500)]),  # as wide as high, or wider: in the middle
        ((2000, 1500), [(700, 700), (800, 700), (700, 1300), (800, 1300)]),
    ],
)
def test_near_views_lie_at_both_ends_and_show_all(size, middles):
    views = near_views(size, 0.7)
    centres = [view.photo_from_film(np.array([0.5, 0.5])) for view in views]
    np.testing.assert_allclose(centres, middles, atol=1e-9)
    corners = np.array([view.photo_from_film(np.array([[0.0, 0.0], [1.0, 1.0]])) for view in views])
    assert (corners.min(axis=(0, 1)) <= 1e-9).all()
    assert (corners.max(axis=(0, 1)) >= np.array(size[::-1]) - 1e-9).all()


def test_a_turned_window_keeps_its_centre_and_side():
    view = square_view((40.0, 30.0), 20.0, turn=np.deg2rad(30))
    corners = view.photo_from_film(np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.5]]))
    np.testing.assert_allclose(corners[2], [40, 30], atol=1e-9)
    along = corners[1] - corners[0]
    np.testing.assert_allclose(along, 20 * np.array([np.cos(np.deg2rad(30)), np.sin(np.deg2rad(30))]), atol=1e-9)


def test_a_film_view_shows_the_film_flat_within_its_margin():
    film, margin = bent_film(), 0.1
    view = film_view(film, margin)
    at = film_centres((24, 24))
    at = at[((at > margin) & (at < 1 - margin)).all(axis=-1)]
    np.testing.assert_allclose(view.photo_from_film(at), film.photo_from_film(film_from_view(at, margin)), atol=0.05)


@pytest.mark.parametrize(("side", "n"), [(200.0, 32), (200.0, 200), (60.0, 96)])
def test_the_image_shows_the_points_that_the_view_names(side, n):
    photo = ramp((256, 256))
    view = square_view((128.0, 120.0), side, turn=0.3)
    image, points = view_image(photo, view, n), view.dense((n, n))
    inside = ((points > 8) & (points < 248)).all(axis=-1)
    seen = image[..., :2].astype(float) * 256 / 250
    assert np.abs(seen - points)[inside].max() < 1.6


def test_beyond_the_photo_its_rim_goes_on():
    photo = np.full((40, 40, 3), 7, np.uint8)
    assert (view_image(photo, square_view((0.0, 0.0), 100.0), 16) == 7).all()


def test_output_points_are_the_means_of_the_pixels_they_stand_for():
    view = square_view((50.0, 40.0), 64.0)
    fine = view.dense((32, 32)).reshape(8, 4, 8, 4, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(output_points(view, 32, 4), fine, atol=1e-4)


def test_the_plane_of_a_plane_sheet_is_itself():
    uv = film_nodes((9, 9))
    depth = 1 + 0.2 * uv[..., :1] + 0.1 * uv[..., 1:]
    plane = BackwardMap((uv * [200, 260] + 30) / depth)
    assert end_point_error(plane_of(plane), plane.nodes).max() < 0.05


def test_the_plane_of_a_bent_sheet_is_near_it():
    film = bent_film()
    error = end_point_error(plane_of(film), film.nodes)
    assert 1 < error.mean() < 12
