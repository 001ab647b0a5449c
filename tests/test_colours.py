"""Colour changes in training: brightness falls, noise grows, geometry stays."""

import cv2
import numpy as np
import pytest

from hybrid.learn.datasets import colours


@pytest.fixture
def photo():
    """A smooth ramp with a black square in its middle."""
    ramp = np.linspace(40, 220, 128)[None, :, None] * np.array([1.0, 0.9, 0.8])
    image = np.broadcast_to(ramp, (128, 128, 3)).round().astype(np.uint8).copy()
    image[48:80, 48:80] = 5
    return image


def middle(image):
    """The position of the darkest thing in a picture, in pixels."""
    grey = cv2.GaussianBlur(image.astype(np.float32).mean(axis=-1), (0, 0), 3)
    weight = grey / cv2.GaussianBlur(grey, (0, 0), 25)
    rows, columns = np.nonzero(weight < np.percentile(weight, 2))
    return np.array([columns.mean(), rows.mean()])


def test_little_light_darkens_and_is_noisy(photo, monkeypatch):
    monkeypatch.setattr(colours, "DIM_STOPS", (3.0, 3.0))
    monkeypatch.setattr(colours, "LIFTED", 0.0)
    dim = colours.in_little_light(photo, np.random.default_rng(1))
    assert dim.shape == photo.shape
    assert dim.dtype == np.uint8
    expected = 255 * ((photo / 255.0) ** 2.2 / 8) ** (1 / 2.2)
    bright = photo > 100
    assert np.median(dim[bright] / expected[bright]) == pytest.approx(1.0, abs=0.1)
    assert np.std(dim[bright] / expected[bright]) > 0.02


def test_light_that_is_made_up_for_leaves_the_noise(photo, monkeypatch):
    monkeypatch.setattr(colours, "DIM_STOPS", (3.0, 3.0))
    rng = np.random.default_rng(2)
    brightest = []
    for lifted in (0.0, 1.0):
        monkeypatch.setattr(colours, "LIFTED", lifted)
        brightest.append(max((colours.in_little_light(photo, rng) for _ in range(12)), key=np.mean))
    dark, bright = brightest
    assert bright.mean() > 1.3 * dark.mean()
    assert bright[:20, :10].std() > dark[:20, :10].std()


def test_compression_is_coarser_at_lower_quality(photo):
    off = [np.abs(colours.compressed(photo, q).astype(float) - photo).mean() for q in (8, 60, 95)]
    assert off[0] > off[1] > off[2] > 0
    assert off[0] < 12


def test_most_photos_are_taken_as_they_are(photo):
    rng = np.random.default_rng(3)
    same = np.mean([colours.taken_badly(photo, rng) is photo for _ in range(300)])
    left = (1 - colours.DIM_SHARE) * (1 - colours.SHARPENED_SHARE) * (1 - colours.COMPRESSED_SHARE)
    assert same == pytest.approx(left, abs=0.08)


@pytest.mark.parametrize("change", [colours.taken_badly, colours.disturbed])
def test_things_stay_where_they_are(photo, change):
    """This holds even with all changes made at once: motion blurs to both sides alike."""
    rng = np.random.default_rng(4)
    before = middle(photo)
    for _ in range(40):
        assert np.abs(middle(change(photo, rng)) - before).max() < 3


@pytest.mark.parametrize("length", [2.0, 4.7, 7.0])
@pytest.mark.parametrize("direction", [0.0, 0.6, np.pi / 2])
def test_motion_keeps_light_and_place(length, direction):
    """The kernel's weights add up to 1, are centred on the pixel, and reach as far as the motion."""
    weights = colours._trace(length, direction)
    reach = len(weights) // 2
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    assert weights.sum() == pytest.approx(1.0, abs=1e-5)
    assert [(weights * z).sum() for z in (x, y)] == pytest.approx([0.0, 0.0], abs=1e-5)
    along = np.cos(direction) * x + np.sin(direction) * y
    spread = np.sqrt((weights * along**2).sum())
    assert spread == pytest.approx(length / np.sqrt(12), rel=0.35)


def test_one_seed_gives_one_picture(photo):
    first, second = (colours.disturbed(colours.taken_badly(photo, rng), rng)
                     for rng in (np.random.default_rng(9), np.random.default_rng(9)))  # fmt: skip
    assert (first == second).all()
