"""Laws of light removal, on films with a known print under known light."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from light_reader import without_light
from scipy.stats import spearmanr

from hybrid.backward import BackwardMap
from hybrid.coords import (
    film_centres,
    linear_from_srgb,
    rgb_from_bgr,
    srgb_from_linear,
)
from hybrid.rectify.film.deilluminate import find_clipped
from hybrid.rectify.film.resample import rectify_photo

SIZE = (600, 480)


def print_of_cells(rows: int = 5, cols: int = 4) -> np.ndarray:
    """(h, w) display grey: black surround, a skull-like ring with a grey ramp inside, and white text, in each cell."""
    film = np.full(SIZE, 0.05)
    height, width = SIZE[0] // rows, SIZE[1] // cols
    ramp = np.linspace(0.2, 0.7, width)[None].repeat(height, 0)
    for i in range(rows):
        for j in range(cols):
            cell = film[i * height : (i + 1) * height, j * width : (j + 1) * width]
            inner = cv2.ellipse(np.zeros((height, width)), ((width / 2, height / 2), (70, 80), 0), 1.0, -1)
            ring = cv2.ellipse(np.zeros((height, width)), ((width / 2, height / 2), (70, 80), 0), 1.0, 5)
            cell[inner > 0] = ramp[inner > 0]
            cell[ring > 0] = 1.0
            text = cv2.putText(np.zeros((height, width), np.uint8), "IM 12", (4, 14), 0, 0.4, 255, 1)
            np.maximum(cell, text / 255.0, out=cell)
    return film


def light(gain: np.ndarray | float = 0.5, veil: np.ndarray | float = 0.0, cast: tuple = (1.0, 1.0, 1.0)) -> np.ndarray:
    """(h, w, 3) uint8 photo of the flat print under gain and veil in linear light."""
    linear = (print_of_cells() ** 1.6 * gain + veil)[..., None] * np.array(cast)
    return np.rint(255 * srgb_from_linear(linear)).astype(np.uint8)


def everywhere() -> np.ndarray:
    return np.ones(SIZE, bool)


def psnr_after_affine(film: np.ndarray, truth: np.ndarray) -> float:
    slope, offset = np.polyfit(film.ravel().astype(np.float64), truth.ravel(), 1)
    assert slope > 0
    return float(-10 * np.log10(np.mean((slope * film + offset - truth) ** 2)))


def uneven() -> tuple[np.ndarray, np.ndarray]:
    """A gain that falls to a half, and a broad reflection."""
    u, v = film_centres(SIZE).transpose(2, 0, 1)
    return 0.55 - 0.25 * u, 0.12 * np.exp(-((u - 0.3) ** 2 + (v - 0.6) ** 2) / 0.08)


def test_even_light_leaves_the_film_as_it_was_up_to_one_monotone_curve():
    photo = light(0.6)
    result = without_light(photo, everywhere())
    grey = photo[..., 1].astype(float) / 255
    level = [result.film[photo[..., 1] == k] for k in np.unique(photo[..., 1])]
    assert max(float(np.ptp(x)) for x in level) < 0.04  # equal stays equal
    assert spearmanr(grey.ravel(), result.film.ravel()).statistic > 0.98
    assert psnr_after_affine(result.film, print_of_cells()) > 28


def test_light_is_removed():
    gain, veil = uneven()
    photo, truth = light(gain, veil), print_of_cells()
    before = psnr_after_affine(photo.mean(axis=-1) / 255, truth)
    result = without_light(photo, everywhere())
    assert result.ran
    assert psnr_after_affine(result.film, truth) > before + 4


def test_doubled_light_changes_nothing():
    gain, veil = uneven()
    once = without_light(light(0.5 * gain, 0.5 * veil), everywhere()).film
    twice = without_light(light(gain, veil), everywhere()).film
    assert np.abs(once - twice).mean() < 0.01
    assert np.quantile(np.abs(once - twice), 0.99) < 0.05  # rounding to eight bits in the darker photo


def test_a_grey_ramp_comes_out_monotone():
    gain, veil = uneven()
    film = without_light(light(gain, veil), everywhere()).film
    for i in range(5):
        for j in range(4):
            row = film[i * 120 + 60, j * 120 + 32 : j * 120 + 88]
            smooth = cv2.blur(row[None], (9, 1))[0][4:-4]
            assert (np.diff(smooth) > -0.002).all()


def test_black_stays_black_and_white_white():
    gain, veil = uneven()
    film, truth = without_light(light(gain, veil), everywhere()).film, print_of_cells()
    assert film[truth < 0.06].mean() < 0.12
    assert np.median(film[truth > 0.99]) > 0.75
    assert film.min() >= 0.0
    assert film.max() <= 1.0


def test_a_colour_cast_vanishes():
    gain, veil = uneven()
    white = without_light(light(gain, veil), everywhere()).film
    warm = without_light(light(gain, veil, cast=(1.2, 1.0, 0.5)), everywhere()).film
    assert np.abs(white - warm).mean() < 0.02


def test_noise_is_not_blown_up_where_the_light_was_poor():
    u = film_centres(SIZE)[..., 0]
    photo = light(0.6 * np.clip(1.05 - 1.2 * u, 0.02, 1)).astype(float)
    noisy = np.clip(photo + np.random.default_rng(0).normal(0, 2, photo.shape), 0, 255).astype(np.uint8)
    film = without_light(noisy, everywhere()).film
    dark = film[:, -60:][print_of_cells()[:, -60:] < 0.06]
    assert dark.std() < 0.08


def test_glare_of_known_extent_is_marked_and_not_trusted():
    u, v = film_centres(SIZE).transpose(2, 0, 1)
    spot = (u - 0.5) ** 2 + (v - 0.4) ** 2 < 0.1**2
    photo = light(0.4, np.where(spot, 2.0, 0.0))
    result = without_light(photo, everywhere())
    union = np.count_nonzero(result.glare | spot)
    assert np.count_nonzero(result.glare & spot) / union > 0.9
    assert (result.confidence[result.glare] == 0).all()
    assert result.confidence[~result.glare].mean() > 0.7


def test_what_one_channel_still_shows_is_not_glare():
    """The reflection is white or warm: red and green clip in both, but in the warm one blue tells black from white."""
    u, v = film_centres(SIZE).transpose(2, 0, 1)
    spot = (u - 0.5) ** 2 + (v - 0.4) ** 2 < 0.1**2
    linear = (0.5 * print_of_cells() ** 1.6)[..., None]
    for blue, lost in ((2.0, True), (0.2, False)):
        veil = np.where(spot[..., None], [2.0, 2.0, blue], 0.0)
        photo = np.rint(255 * srgb_from_linear(np.minimum(linear + veil, 1))).astype(np.uint8)
        glare = without_light(photo, everywhere()).glare[spot]
        assert glare.mean() > 0.95 if lost else glare.mean() < 0.05


def test_thin_white_strokes_at_the_limit_are_print():
    photo = light(0.9)
    photo[200:202, 20:400] = 255
    assert not find_clipped(photo)[195:207, 20:400].any()


def test_pixels_outside_the_photo_stay_black_and_do_not_disturb_the_rest():
    gain, veil = uneven()
    photo, valid = light(gain, veil), everywhere()
    whole = without_light(photo, valid).film
    valid[:, 420:] = False
    photo[~valid] = 0
    result = without_light(photo, valid)
    assert (result.film[~valid] == 0).all()
    assert (result.confidence[~valid] == 0).all()
    assert np.abs(result.film - whole)[:, :400].mean() < 0.05


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_film_on_which_nothing_is_told_apart_is_lost_as_a_whole(value: int):
    result = without_light(np.full((*SIZE, 3), value, np.uint8), everywhere())
    assert np.isfinite(result.film).all()
    assert result.glare.all()
    assert (result.confidence == 0).all()
    nowhere = without_light(np.zeros((*SIZE, 3), np.uint8), np.zeros(SIZE, bool))
    assert (nowhere.film == 0).all()


def test_inputs_are_not_modified():
    photo, valid = light(*uneven()), everywhere()
    copies = photo.copy(), valid.copy()
    without_light(photo, valid)
    np.testing.assert_array_equal(photo, copies[0])
    np.testing.assert_array_equal(valid, copies[1])


def test_linear_light_is_where_the_model_holds():
    """A check of the test films themselves: gain and veil act on linear light."""
    photo = light(0.5, 0.1)
    seen = linear_from_srgb(photo[..., 1] / 255.0)
    np.testing.assert_allclose(seen, 0.5 * print_of_cells() ** 1.6 + 0.1, atol=0.01)


def test_cells_without_a_slice_stay_black():
    gain, veil = uneven()
    empty = np.zeros(SIZE, bool)
    empty[480:, 240:] = True
    truth = np.where(empty, 0.05, print_of_cells())
    linear = (truth**1.6 * gain + veil)[..., None].repeat(3, axis=2)
    film = without_light(np.rint(255 * srgb_from_linear(linear)).astype(np.uint8), everywhere()).film
    assert film[empty].max() < 0.2
    assert psnr_after_affine(film, truth) > 24


def test_a_window_reflected_across_slices_is_removed_with_its_edges():
    u, v = film_centres(SIZE).transpose(2, 0, 1)
    window = (abs(u - 0.5) < 0.07) & (abs(v - 0.41) < 0.12)
    photo, truth = light(0.5, np.where(window, 0.15, 0.0)), print_of_cells()
    film = without_light(photo, everywhere()).film
    black = window & (truth < 0.06)
    assert film[black].mean() < (photo[..., 1][black] / 255).mean() / 2
    assert psnr_after_affine(film, truth) > psnr_after_affine(photo[..., 1] / 255, truth) + 3


def test_print_within_one_slice_is_no_reflection():
    """A scout view, bright where all other slices are black, keeps its printed brightness relative to the rest."""
    truth = print_of_cells()
    truth[20:100, 15:105] = 0.4
    linear = (truth**1.6 * 0.5)[..., None].repeat(3, axis=2)
    film = without_light(np.rint(255 * srgb_from_linear(linear)).astype(np.uint8), everywhere()).film
    alike = film[(abs(truth - 0.4) < 0.02) & (np.arange(SIZE[0])[:, None] > 130)]
    assert film[30:90, 25:95].mean() > 0.75 * alike.mean()


def print_of_wedges() -> tuple[np.ndarray, np.ndarray]:
    """Cells with a step wedge each: display grey (h, w) and step numbers (0: none), 10 of 255 levels apart."""
    film, step = np.full(SIZE, 0.05), np.zeros(SIZE, int)
    for i in range(5):
        for j in range(4):
            for k in range(24):
                y, x = i * 120 + 24 + 20 * (k // 6), j * 120 + 15 + 15 * (k % 6)
                film[y : y + 20, x : x + 15] = (13 + 10 * k) / 255
                step[y + 4 : y + 16, x + 3 : x + 12] = k + 1
            text = cv2.putText(np.zeros((120, 120), np.uint8), "IM 12", (4, 14), 0, 0.4, 255, 1) / 255.0
            cell = film[i * 120 : (i + 1) * 120, j * 120 : (j + 1) * 120]
            np.maximum(cell, text, out=cell)
    return film, step


def test_contrast_between_close_greys_is_the_same_over_the_sheet():
    """Contrast of steps 10 of 255 levels apart (median of each cell) is within 20 % of that elsewhere on the sheet."""
    gain, veil = uneven()
    film, step = print_of_wedges()
    linear = (film**1.6 * gain + veil)[..., None].repeat(3, axis=2)
    photo = np.rint(255 * srgb_from_linear(linear)).astype(np.uint8)
    contrasts = {}
    pictures = {
        "lit": photo[..., 1] / 255.0,
        "film": without_light(photo, everywhere()).film,
    }
    for name, picture in pictures.items():
        means = np.array(
            [
                [picture[i : i + 120, j : j + 120][step[i : i + 120, j : j + 120] == k].mean() for k in range(1, 25)]
                for i in range(0, 600, 120)
                for j in range(0, 480, 120)
            ]
        )
        of_cell = np.diff(means, axis=1)
        contrasts[name] = np.median(of_cell / np.median(of_cell, axis=0), axis=1)
    assert np.abs(contrasts["film"] - 1).max() < 0.2
    assert np.abs(contrasts["lit"] - 1).max() > 0.4  # before the light is removed


def test_applied_twice_it_changes_nothing_but_the_tone_curve():
    once = without_light(light(*uneven()), everywhere()).film
    level = np.rint(255 * once).astype(np.uint8)
    twice = without_light(level[..., None].repeat(3, axis=2), everywhere()).film
    spread = [float(twice[level == k].std()) for k in np.unique(level) if np.count_nonzero(level == k) > 50]
    assert max(spread) < 0.03


@pytest.mark.skipif("HYBRID_SHARED_DATA" not in os.environ, reason="HYBRID_SHARED_DATA names no folder of photos")
def test_rendered_photos_come_closer_to_their_print():
    folder = Path(os.environ["HYBRID_SHARED_DATA"], "photos")
    gains = []
    for path in sorted(folder.glob("*.npz"))[::3]:
        with np.load(path) as data:
            backward = BackwardMap(data["lattice"].astype(np.float64)).resized((33, 33))
            truth = cv2.imread(str(folder / "textures" / str(data["texture"])), cv2.IMREAD_GRAYSCALE)
        photo = rgb_from_bgr(cv2.imread(str(path.with_suffix(".jpg"))))
        flat = rectify_photo(photo, backward, (512, 512))
        small = cv2.resize(truth, (512, 512), interpolation=cv2.INTER_AREA) / 255.0
        before = psnr_after_affine(flat.image.mean(axis=-1), small)
        gains.append(psnr_after_affine(without_light(flat.image, flat.valid).film, small) - before)
    assert np.median(gains) > 0.5
