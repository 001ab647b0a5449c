"""The copies of a photo: what they show, where, and how large they are."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.coords import pixel_centres
from hybrid.pyramid import Pyramid


def ramp(size: tuple[int, int]) -> np.ndarray:
    """A photo whose red is its x and whose green is its y, in photo coordinates."""
    x, y = np.moveaxis(pixel_centres(size), -1, 0)
    return np.dstack([x, y, 0 * x]).astype(np.uint8)


def test_a_copy_is_the_mean_of_the_pixels_it_stands_for():
    photo = np.random.default_rng(0).integers(0, 256, (64, 96, 3), dtype=np.uint8)
    copy, factor = Pyramid(photo).reduced(4.0)
    assert (factor, copy.shape) == (4, (16, 24, 3))
    means = photo.reshape(16, 4, 24, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(copy, means, atol=1.01)  # rounded twice


@pytest.mark.parametrize(("most", "factor"), [(0.3, 1), (1.9, 1), (2.0, 2), (7.9, 4), (8.0, 8)])
def test_the_factor_is_the_largest_power_of_two_that_is_allowed(most: float, factor: int):
    assert Pyramid(np.zeros((200, 300, 3), np.uint8)).reduced(most)[1] == factor


def test_the_photo_itself_is_no_copy_and_stays_as_it_is():
    photo = ramp((50, 60))
    before = photo.copy()
    pyramid = Pyramid(photo)
    assert pyramid.reduced(1.0)[0] is photo
    assert pyramid.scaled(1.0)[0] is photo
    pyramid.scaled(0.2)
    np.testing.assert_array_equal(photo, before)


@pytest.mark.parametrize("scale", [0.9, 0.7, 0.5, 0.37, 0.26, 0.11])
def test_scaled_points_are_where_the_scale_says(scale: float):
    """Sizes are odd and even, so that rows are left out; copies are never more than 15 % larger than asked for."""
    copy, (x, y) = Pyramid(ramp((201, 250))).scaled(scale)
    assert 0.97 * scale <= min(x, y)
    assert max(x, y) <= 1.15 * scale + 1e-9
    h, w = copy.shape[:2]
    shown = pixel_centres((h, w)) / [x, y]
    np.testing.assert_allclose(copy[..., :2], shown, atol=1.6)


def test_even_a_photo_of_one_row_has_copies():
    assert Pyramid(np.zeros((1, 500, 3), np.uint8)).reduced(64.0)[1] == 1
