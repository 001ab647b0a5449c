"""Laws of the search for a sheet's round corners."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from hybrid.backward import BackwardMap, Orientation
from hybrid.coords import FILM_CORNERS, film_centres, linear_from_srgb, srgb_from_linear
from hybrid.errors import ConfigError
from hybrid.rectify.film.resample import ResampleConfig, read_film
from hybrid.rectify.film.rounding import RoundingConfig, blank_beyond, find_round_corners
from hybrid.round_corners import RoundCorners

SIZE = (700, 560)
ASPECT = SIZE[0] / SIZE[1]


def seen(film: np.ndarray | int, ground: int, radius: float = 0.0) -> tuple[np.ndarray, BackwardMap]:
    """A photo of a flat film ((h, w) grey, or one grey) on even ground, with corners of this radius (in parts of its
    width), and its true map."""
    picture = np.array(np.broadcast_to(film, SIZE), np.float64)
    if radius:
        picture[RoundCorners(radius, radius / ASPECT).cut(film_centres(SIZE))] = ground
    light = linear_from_srgb(cv2.resize(picture, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST) / 255.0)
    shown = np.array([[150, 120], [720, 90], [780, 830], [110, 780]], np.float64)  # the film's corners
    corners = FILM_CORNERS * np.array(light.shape[::-1])
    plane = cv2.getPerspectiveTransform(corners.astype(np.float32), 2 * shown.astype(np.float32))
    plane = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]]) @ plane @ np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    border = float(linear_from_srgb(np.array(ground / 255.0)))
    twice = cv2.warpPerspective(light, plane, (1800, 1800), borderMode=cv2.BORDER_CONSTANT, borderValue=border)
    blurred = cv2.resize(cv2.GaussianBlur(twice, (0, 0), 1.2), (900, 900), interpolation=cv2.INTER_AREA)
    photo = np.rint(255 * np.repeat(srgb_from_linear(blurred)[..., None], 3, axis=-1)).astype(np.uint8)
    seen_from = cv2.getPerspectiveTransform(FILM_CORNERS.astype(np.float32), shown.astype(np.float32))
    return photo, BackwardMap.from_function(lambda uv: cv2.perspectiveTransform(uv[None], seen_from)[0])


def found(photo: np.ndarray, backward: BackwardMap) -> RoundCorners | None:
    return find_round_corners(photo, backward, ASPECT, RoundingConfig())


def printed() -> np.ndarray:
    """A print with something in it up to its edges."""
    noise = np.random.default_rng(0).uniform(20, 200, (14, 11)).astype(np.float32)
    return cv2.resize(noise, SIZE[::-1], interpolation=cv2.INTER_CUBIC).clip(0, 255)


@pytest.mark.parametrize(("film", "ground"), [(15, 220), (15, 80), (170, 30)])
@pytest.mark.parametrize("radius", [0.025, 0.04, 0.06])
def test_round_corners_are_found(film: int, ground: int, radius: float):
    corners = found(*seen(film, ground, radius))
    assert corners is not None
    assert corners.u == pytest.approx(radius, abs=0.007)
    assert corners.v == pytest.approx(corners.u / ASPECT)


@pytest.mark.parametrize("ground", [0, 60, 230])
def test_square_corners_are_left_alone(ground: int):
    assert found(*seen(15, ground)) is None
    assert found(*seen(printed(), ground)) is None
    ruled = np.full(SIZE, 190.0)
    ruled[3:-3, 3:-3] = 15
    assert found(*seen(ruled, ground)) is None


def test_what_cannot_be_told_from_its_ground_is_left_alone():
    assert found(*seen(20, 30, 0.05)) is None


def test_a_film_that_fills_the_photo_shows_no_ground():
    photo, _ = seen(15, 220, 0.05)
    whole = BackwardMap.from_function(lambda uv: uv * np.array(photo.shape[1::-1]))
    assert found(photo, whole) is None


def test_the_ground_beyond_the_arcs_is_not_valid():
    photo, backward = seen(15, 220, 0.04)
    flat = read_film(photo, backward, SIZE)
    beyond = RoundCorners(0.04, 0.04 / ASPECT).cut(film_centres(SIZE))
    assert not flat.valid[beyond].any()
    assert (flat.image[~flat.valid] == 0).all()
    assert (~flat.valid).sum() < 1.6 * beyond.sum()
    kept = read_film(photo, backward, SIZE, ResampleConfig(rounding=RoundingConfig(contrast=255.0)))
    assert kept.valid.all()
    assert (flat.image > 60).sum() < 0.1 * (kept.image > 60).sum()
    assert kept.corners is None
    assert str(kept) == "560 x 700 pixels"
    assert flat.corners is not None
    assert str(flat) == f"560 x 700 pixels, its corners rounded by {flat.corners.u:.1%} of its width"
    assert flat.turned(Orientation(1, True)).corners == RoundCorners(flat.corners.v, flat.corners.u)


def test_pixels_beyond_the_arcs_are_those_that_are_blanked():
    corners = RoundCorners(0.06, 0.03)
    picture, mask = np.full((90, 70, 3), 7, np.uint8), np.ones((90, 70), bool)
    blank_beyond(corners, picture, mask)
    beyond = corners.cut(film_centres((90, 70)))
    assert beyond.any()
    np.testing.assert_array_equal(mask, ~beyond)
    np.testing.assert_array_equal(picture == 0, np.repeat(beyond[..., None], 3, axis=-1))


@pytest.mark.parametrize(
    "wrong", [{"smallest": 0.0}, {"largest": 0.02}, {"largest": 0.5}, {"agreed": 2.0}, {"step": -1.0}]
)
def test_impossible_options_are_refused(wrong: dict):
    from hybrid.effort import RectifyConfig

    with pytest.raises(ConfigError):
        RectifyConfig(resample=ResampleConfig(rounding=RoundingConfig(**wrong)))
