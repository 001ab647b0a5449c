"""The photo seen through a map: what is read is what is there, in photos of any size."""

import numpy as np
import pytest

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d
from hybrid.film_view import MOST_SIDE, view_film


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("at", [0, MOST_SIDE, 2 * MOST_SIDE - 64])
def test_photos_that_opencv_does_not_read_are_seen_all_the_same(at: int, wide: bool):
    """A film of 64 pixels in a photo with a longer side than OpenCV reads: it looks as in a crop of it, except that its
    place (float32) is known only to a hundredth of a pixel."""
    rng = np.random.default_rng(0)
    part = rng.integers(1, 255, (64, 64), np.uint8)
    photo = np.zeros((64, 2 * MOST_SIDE), np.uint8)
    photo[:, at : at + 64] = part
    film = BackwardMap.from_function(lambda uv: uv * [64, 64])
    lattice = film_centres_1d(50)
    near = view_film(part, film, lattice, lattice)
    there = film.cropped((-float(at), 0.0))
    if wide:
        photo, there = photo.T.copy(), BackwardMap(there.nodes[..., ::-1])
    far = view_film(photo, there, lattice, lattice)
    np.testing.assert_array_equal(far.inside, near.inside)
    np.testing.assert_allclose(far.image, near.image, atol=4.0)


def test_what_lies_beyond_such_a_photo_is_not_seen():
    photo = np.full((64, MOST_SIDE + 10), 99, np.uint8)
    lattice = film_centres_1d(8)
    for x in (-500.0, MOST_SIDE + 500.0):
        seen = view_film(photo, BackwardMap.from_function(lambda uv, x=x: uv * 64 + [x, 0]), lattice, lattice)
        assert not seen.inside.any()
        assert not seen.image.any()
