"""The camera's pipeline: noise of the stated strength, rising tone curves, clipping, the same bytes for a seed."""

from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from data_gen.camera.develop import Lens, _streak, develop, displayed, tone, vignetting

PLAIN = Lens(0.18, 0.0, 0.0, "srgb", 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1e-4, 96)


def photo(linear, lens, seed=0):
    jpeg = develop(linear, lens, 1.0, np.random.default_rng(seed))
    return np.asarray(Image.open(BytesIO(jpeg))).astype(float)


@pytest.mark.parametrize("name", ["srgb", "filmic", "punchy"])
def test_tone_curves_rise_from_black_to_white(name):
    curve = tone(name)
    assert curve[0] < 0.02
    assert (np.diff(curve) >= -1e-6).all()
    assert curve[-1] == pytest.approx(1, abs=0.02)


def test_grey_stays_grey_and_comes_out_where_the_curve_says():
    grey = photo(np.full((64, 64, 3), 1.0, np.float32), PLAIN)
    assert grey.mean() == pytest.approx(255 * 0.4614, abs=1)  # sRGB of 18 %
    assert np.ptp(grey) <= 3


def test_noise_has_the_stated_variance():
    """Before the blur that demosaicking leaves, read noise has standard deviation lens.noise in linear light."""
    lens = replace(PLAIN, noise=0.02)
    levels = photo(np.full((200, 200, 3), 1.0, np.float32), lens) / 255
    slope = 1.055 / 2.4 * 0.18 ** (1 / 2.4 - 1)
    sigma = np.sqrt(0.02**2 + 0.02 * 0.3 * 0.18) * slope
    assert 0.35 * sigma < levels[..., 1].std() < 0.65 * sigma  # the blur halves it
    assert abs(levels.mean() - 0.4614) < 0.01


def test_displayed_is_what_the_photo_shows_without_blur_and_noise():
    lens = replace(PLAIN, vignette=0.4, temperature=0.3, exposure=0.5)
    linear = np.full((80, 80, 3), 1.0, np.float32)
    place = (np.stack(np.meshgrid(np.arange(80), np.arange(80)), axis=-1) + 1 / 2) / 80
    shown = displayed(linear * vignetting(place, lens), lens, 1.0)
    assert np.abs(photo(linear, lens) / 255 - shown).max() < 0.03
    assert shown[0, 0].sum() < shown[40, 40].sum()


def test_too_much_light_clips_to_white():
    assert displayed(np.full((1, 1, 3), 50.0), PLAIN, 1.0).min() == 1.0


@pytest.mark.parametrize("length", [0.8, 1.0, 2.4, 5.0])
def test_motion_of_any_length_blurs_by_its_length(length: float):
    kernel = _streak(length, 0.0)
    assert kernel.sum() == pytest.approx(1.0, abs=1e-5)
    x = np.arange(kernel.shape[1]) - kernel.shape[1] // 2
    mean, square = (kernel.sum(axis=0) * x).sum(), (kernel.sum(axis=0) * x**2).sum()
    assert mean == pytest.approx(0.0, abs=1e-5)
    assert length**2 / 12 - 1e-3 <= square <= length**2 / 12 + 0.25  # plus what bilinear sampling adds
    np.testing.assert_allclose(_streak(length, np.pi / 2), kernel.T, atol=1e-6)


def test_a_seed_gives_the_same_bytes():
    linear = np.random.default_rng(1).random((40, 40, 3)).astype(np.float32)
    lens = replace(PLAIN, bloom=0.05, defocus_px=20.0, motion_px=60.0, sharpen=0.5)
    first, again, other = (develop(linear, lens, 1.0, np.random.default_rng(s)) for s in (3, 3, 4))
    assert first == again != other
