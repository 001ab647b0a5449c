"""Laws of the correction of a flat film's outermost pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from hybrid.backward import BackwardMap
from hybrid.coords import linear_from_srgb, pixel_from_film, srgb_from_linear
from hybrid.errors import ConfigError
from hybrid.rectify.film.resample import ResampleConfig, read_film
from hybrid.rectify.film.spill import SpillConfig

LEFT_TOP = np.array([50.5, 40.5])
"""Where the film's corner lies in the photo: its edges run through the middles of pixels."""
SIZE = (120, 160)
AS_READ = ResampleConfig(spill=SpillConfig(contrast=255.0))


def seen(film: np.ndarray | int, ground: int, blur_px: float = 0.6) -> tuple[np.ndarray, BackwardMap]:
    """A photo, blurred as light is, of a film ((h, w) grey, or one grey) on even ground, and the film's true map."""
    fine = np.full((800, 1040), ground, np.uint8)
    left, top = (round(4 * one) for one in LEFT_TOP)
    fine[top : top + 4 * SIZE[0], left : left + 4 * SIZE[1]] = np.broadcast_to(film, SIZE).repeat(4, 0).repeat(4, 1)
    light = cv2.GaussianBlur(linear_from_srgb(fine / 255.0), (0, 0), 4 * blur_px)
    shown = srgb_from_linear(cv2.resize(light, (260, 200), interpolation=cv2.INTER_AREA))
    photo = np.rint(255 * np.repeat(shown[..., None], 3, axis=-1)).astype(np.uint8)
    return photo, BackwardMap.from_function(lambda uv: pixel_from_film(uv, SIZE) + LEFT_TOP)


def rim(image: np.ndarray) -> np.ndarray:
    """The outermost pixels, once around."""
    return np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]]).astype(int)


def printed(seed: int = 0) -> np.ndarray:
    """A print with something in it up to its edges."""
    noise = np.random.default_rng(seed).uniform(20, 220, (12, 16)).astype(np.float32)
    return cv2.resize(noise, SIZE[::-1], interpolation=cv2.INTER_CUBIC).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize(("film", "ground"), [(20, 220), (20, 90), (200, 30)])
def test_an_even_film_is_even_to_its_edge(film: int, ground: int):
    photo, backward = seen(film, ground)
    before = read_film(photo, backward, SIZE, AS_READ).image
    after = read_film(photo, backward, SIZE).image
    assert np.abs(rim(before) - film).max() > 0.15 * abs(ground - film)
    assert np.abs(rim(after) - film).mean() <= 0.035 * abs(ground - film)
    assert np.abs(rim(after) - film).max() <= 0.07 * abs(ground - film)  # at the corners, where it shines in twice
    np.testing.assert_array_equal(after[3:-3, 3:-3], before[3:-3, 3:-3])


@pytest.mark.parametrize(("blur_px", "times"), [(0.4, 1), (0.4, 2), (0.8, 1), (0.8, 2), (1.2, 1), (1.2, 2), (1.8, 1)])
def test_the_correction_is_as_deep_as_the_blur(blur_px: float, times: int):
    photo, backward = seen(20, 220, blur_px)
    after = read_film(photo, backward, (times * SIZE[0], times * SIZE[1])).image.astype(int)
    for edge in (after[0], after[-1], after[:, 0], after[:, -1]):
        assert np.abs(edge[8:-8] - 20).max() <= 20


def ruled(width: int) -> np.ndarray:
    """A dark film with a bright rule along its edge."""
    film = np.full(SIZE, 190, np.uint8)
    film[width:-width, width:-width] = 20
    return film


@pytest.mark.parametrize("ground", [0, 15, 120, 255])
@pytest.mark.parametrize("width", [1, 2])
def test_a_narrow_rule_along_the_edge_stays_as_it_was_read(width: int, ground: int):
    """It has a step of its own towards the film, which no ground explains."""
    photo, backward = seen(ruled(width), ground)
    before, after = (read_film(photo, backward, SIZE, config).image for config in (AS_READ, ResampleConfig()))
    for beside_corners in (np.s_[:, 4:-4], np.s_[4:-4]):  # in a corner lies the other side's rule
        np.testing.assert_array_equal(after[beside_corners], before[beside_corners])


@pytest.mark.parametrize("ground", [0, 60, 255])
def test_a_wide_rule_is_as_bright_at_the_edge_as_inside(ground: int):
    photo, backward = seen(ruled(5), ground)
    before, after = (read_film(photo, backward, SIZE, config).image for config in (AS_READ, ResampleConfig()))
    assert np.abs(rim(after) - 190).mean() <= 0.5 * np.abs(rim(before) - 190).mean()


@pytest.mark.parametrize("ground", [10, 128, 245])
def test_no_print_is_further_from_the_truth_than_before(ground: int):
    film = printed()
    photo, backward = seen(film, ground)
    before, after = (
        np.abs(rim(read_film(photo, backward, SIZE, config).image[..., :1]) - rim(film[..., None]))
        for config in (AS_READ, ResampleConfig())
    )
    assert after.mean() <= before.mean()
    assert (after > before + 10).mean() < 0.02


def test_a_film_as_bright_as_its_ground_is_as_it_was_read():
    photo, backward = seen(100, 108)
    before, after = (read_film(photo, backward, SIZE, config).image for config in (AS_READ, ResampleConfig()))
    np.testing.assert_array_equal(after, before)


def test_a_film_that_fills_the_photo_has_no_ground():
    photo = np.repeat(printed()[..., None], 3, axis=-1)
    whole = BackwardMap.from_function(lambda uv: pixel_from_film(uv, SIZE))
    np.testing.assert_array_equal(read_film(photo, whole, SIZE, AS_READ).image, photo)
    np.testing.assert_array_equal(read_film(photo, whole, SIZE).image, photo)


def test_what_lies_outside_the_photo_stays_black():
    photo, backward = seen(60, 220)
    cut = read_film(photo[60:], backward.cropped((0.0, 60.0)), SIZE)
    assert not cut.valid[0].any()
    assert (cut.image[~cut.valid] == 0).all()
    for edge in (cut.image[-1], cut.image[-60:, 0], cut.image[-60:, -1]):  # within the photo it is corrected
        assert np.abs(edge.astype(int) - 60).max() <= 12


@pytest.mark.parametrize("wrong", [{"contrast": -1.0}, {"contrast": 256.0}, {"odd": 1.5}, {"even": float("nan")}])
def test_impossible_options_are_refused(wrong: dict):
    from hybrid.effort import RectifyConfig

    with pytest.raises(ConfigError):
        RectifyConfig(resample=ResampleConfig(spill=SpillConfig(**wrong)))
