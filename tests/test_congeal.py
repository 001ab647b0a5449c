"""Cells registered to their template: shifts are recovered, covered cells do not count, anatomy counts little."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from hybrid.coords import film_centres_1d
from hybrid.film_view import FilmView
from hybrid.rectify.grid.congeal import CongealConfig, block_shifts, median_image, register_cells
from hybrid.rectify.grid.layout import Layout
from hybrid.rectify.grid.lines import Comb
from hybrid.rectify.grid.repeat import Repeats
from hybrid.rectify.grid.rim import RimConfig, without_background
from hybrid.rectify.splines.displacement import SplineConfig, fit_displacement
from hybrid.rectify.splines.sightings import ANATOMY_VARIANCE, Sightings, group_noise

CONFIG = CongealConfig()
SIDE = 96


def texture(rng: np.random.Generator, size: tuple[int, int], blur: float = 2.0) -> np.ndarray:
    smooth = cv2.GaussianBlur(rng.normal(size=size), (0, 0), blur)
    return 20.0 * smooth / smooth.std()


def moved(image: np.ndarray, xy: tuple[float, float]) -> np.ndarray:
    shift = np.array([[1.0, 0.0, xy[0]], [0.0, 1.0, xy[1]]])
    return cv2.warpAffine(image, shift, image.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


STEP = 0.07
"""Pixels by which one linear step may miss a shift of half a pixel; the rounds repeat the step."""


def test_one_step_finds_the_shift_of_a_dim_cell():
    rng = np.random.default_rng(0)
    same = texture(rng, (SIDE, SIDE))
    cells = np.stack([same] * 9)
    cells[4] = 0.6 * moved(same, (0.4, -0.3))
    cells = cells + rng.normal(0, 0.5, cells.shape)
    shifts = block_shifts(cells, 1.0, CONFIG)
    inner = shifts.shift[:, 1:-1, 1:-1]
    assert shifts.good.mean() > 0.9
    assert np.abs(np.median(inner[4], axis=(0, 1)) - [0.4, -0.3]).max() < STEP
    assert np.abs(np.median(np.delete(inner, 4, axis=0), axis=(0, 1, 2))).max() < 0.05


def print_of_cells(rng: np.random.Generator, spread: float) -> tuple[FilmView, np.ndarray]:
    """A film of 4 x 4 cells that show the same letters, each shifted, and the shifts (x, y) in pixels."""
    letters = np.zeros((SIDE, SIDE), np.uint8)
    for row in range(3):
        cv2.putText(letters, "IMA 41 SE7", (4, 24 + 28 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 90, 1, cv2.LINE_AA)
    by = rng.uniform(-spread, spread, (16, 2))
    cells = [moved(letters.astype(np.float32), xy) for xy in by]
    film = np.vstack([np.hstack(cells[4 * row : 4 * row + 4]) for row in range(4)])[..., None]
    at = film_centres_1d(4 * SIDE)
    return FilmView(film + rng.normal(0, 1.0, film.shape).astype(np.float32), at, at, np.ones(film.shape[:2], bool)), by


def test_later_steps_find_what_the_first_template_blurs():
    """The letters of different cells lie two strokes apart."""
    view, by = print_of_cells(np.random.default_rng(5), 1.6)
    columns, rows = Repeats(0, 0.0, 0.25, 4), Repeats(1, 0.0, 0.25, 4)

    def error(steps: int) -> float:
        apart = []
        for s in register_cells(view, columns, rows, 1.0, replace(CONFIG, steps=steps)):
            cell = np.floor(4.0 * s.places()).astype(int) @ [1, 4]
            shift = 4.0 * SIDE * s.offsets()
            found = np.array([np.median(shift[cell == k]) for k in range(16)])
            apart.append((found - found.mean()) - (by[:, s.axis] - by[:, s.axis].mean()))
        assert len(apart) == 2
        return float(np.sqrt(np.mean(np.square(apart))))

    assert error(2) < 0.6 * error(1)
    assert error(4) < 0.15


def test_a_covered_or_empty_cell_does_not_count():
    rng = np.random.default_rng(1)
    cells = np.stack([texture(np.random.default_rng(2), (SIDE, SIDE))] * 9) + rng.normal(0, 0.5, (9, SIDE, SIDE))
    cells[3] = rng.normal(0, 0.5, (SIDE, SIDE))
    cells[5] = texture(rng, (SIDE, SIDE))
    good = block_shifts(cells, 1.0, CONFIG).good
    assert good[[3, 5]].mean() < 0.2
    assert good[[0, 1, 2, 4, 6, 7, 8]].mean() > 0.95


@pytest.mark.parametrize("cells", [1, 3])
def test_too_few_cells_share_nothing(cells):
    view = FilmView(
        np.zeros((64, 64, 1), np.float32), film_centres_1d(64), film_centres_1d(64), np.ones((64, 64), bool)
    )
    columns, rows = Repeats(0, 0.0, 1.0 / cells, cells), Repeats(1, 0.0, 1.0, 1)
    assert register_cells(view, columns, rows, 1.0, CONFIG) == ()


def test_a_blank_film_gives_no_sightings():
    blank = FilmView(
        np.full((300, 300, 1), 9.0, np.float32), film_centres_1d(300), film_centres_1d(300), np.ones((300, 300), bool)
    )
    assert register_cells(blank, Repeats(0, 0.0, 1 / 3, 3), Repeats(1, 0.0, 1 / 3, 3), 1.0, CONFIG) == ()


def test_what_agrees_outweighs_what_does_not():
    """Two things are seen all over the film: one exact, the other (anatomy) scattered and biased, with equal sigmas."""
    rng = np.random.default_rng(3)
    place = rng.uniform(0, 1, (400, 2))
    number = np.arange(400) % 2
    seen = place.copy()
    seen[:, 0] += np.where(number == 0, rng.normal(0, 3e-4, 400), 0.004 + rng.normal(0, 6e-3, 400))
    sigma, nothing = np.full(400, 5e-4), (np.zeros((400, 0)), np.zeros(0))

    def error(group) -> float:
        fit = fit_displacement([Sightings(0, seen, place[:, 0].copy(), sigma, *nothing, group)], SplineConfig())
        return float(np.abs(fit.displacement.values[:, 0]).mean())

    assert error(number) < 3e-4
    assert error(number) < 0.7 * error(None)


def test_anatomy_counts_less_than_its_spread_tells_and_texts_do_not():
    rng = np.random.default_rng(4)
    text = np.tile([True, False], 180)
    groups, stated = np.tile(np.arange(12), 30), np.full(360, 2e-4)
    residual = np.where(text, 1e-4, 1e-3) * rng.normal(size=360)

    def noise(text_sigma: float) -> np.ndarray:
        return group_noise(stated, groups, residual, text_sigma)

    np.testing.assert_array_equal(noise(3e-4)[text], noise(np.inf)[text])
    np.testing.assert_allclose(noise(0.0), np.sqrt(ANATOMY_VARIANCE) * noise(np.inf))
    assert np.all(noise(3e-4)[~text] > 1.4 * noise(np.inf)[~text])
    np.testing.assert_array_equal(group_noise(stated, np.full(360, -1), residual, 3e-4), stated)


@pytest.mark.parametrize("n", [1, 2, 3, 7, 20, 33])
def test_the_median_image_is_the_median_of_each_pixel(n):
    images = np.random.default_rng(n).normal(size=(n, 9, 11)).astype(np.float32)
    kept = images.copy()
    np.testing.assert_array_equal(median_image(images), np.median(images, axis=0))
    np.testing.assert_array_equal(images, kept)


QUARTERS = tuple(Repeats(axis, 0.0, 0.25, 4) for axis in (0, 1))


def before_a_bright_ground(view: FilmView) -> FilmView:
    """The film as a photo shows it on a bright ground, which bleeds into its outermost pixels."""
    image = cv2.copyMakeBorder(view.image[..., 0], 8, 8, 8, 8, cv2.BORDER_CONSTANT, value=200.0)
    return replace(view, image=cv2.GaussianBlur(image, (0, 0), 0.8)[8:-8, 8:-8, None])


def shift_of_the_first_column(view: FilmView) -> float:
    """Pixels by which the texts nearest to the sheet's left edge seem to lie right of those of other cells."""
    columns, rows = QUARTERS
    across, _ = register_cells(view, columns, rows, 1.0, CONFIG)
    first = np.abs(across.known % 0.25) < 24 / (4 * SIDE)
    at_edge = across.known < 0.25
    offsets = across.offsets() * 4 * SIDE
    return float(np.median(offsets[first & at_edge]) - np.median(offsets[first & ~at_edge]))


def test_a_bright_ground_does_not_shift_what_is_printed_beside_it():
    view, _ = print_of_cells(np.random.default_rng(5), 0.0)
    seen = before_a_bright_ground(view)
    cleaned = without_background(seen, Layout(repeats=QUARTERS), RimConfig())
    assert abs(shift_of_the_first_column(view)) < 0.05
    assert abs(shift_of_the_first_column(seen)) > 0.1, "the ground does not show: this film tells nothing"
    assert abs(shift_of_the_first_column(cleaned)) < 0.5 * abs(shift_of_the_first_column(seen))


def test_only_the_rim_is_put_right_and_the_view_stays():
    view, _ = print_of_cells(np.random.default_rng(5), 0.0)
    seen = before_a_bright_ground(view)
    before = seen.image.copy()
    cleaned = without_background(seen, Layout(repeats=QUARTERS), RimConfig(width_px=3))
    assert np.array_equal(seen.image, before)
    assert np.array_equal(cleaned.image[3:-3, 3:-3], before[3:-3, 3:-3])
    assert np.array_equal(cleaned.image[100, :3], np.repeat(before[100, 3:4], 3, axis=0))
    assert without_background(seen, Layout(repeats=QUARTERS), RimConfig(width_px=0)) is seen
    assert without_background(seen, Layout(), RimConfig()) is seen


@pytest.mark.parametrize("known", [False, True], ids=["seen", "known"])
def test_half_a_rule_along_the_edge_stays(known: bool):
    """A rule between the cells: seen, or so faint that it was only found elsewhere."""
    view, _ = print_of_cells(np.random.default_rng(5), 0.0)
    combs: tuple[Comb | None, Comb | None] = (None, None)
    if known:
        rule = Comb(0, 0.0, 0.25, 4, np.arange(5), 1, 1, 1.0, np.zeros((5, 1)))
        combs = (rule, replace(rule, axis=1))
    else:
        for at in range(0, 4 * SIDE + 1, SIDE):
            view.image[max(at - 1, 0) : at + 1] = view.image[:, max(at - 1, 0) : at + 1] = 60.0
    layout = Layout(combs=combs, repeats=QUARTERS)
    assert without_background(view, layout, RimConfig()) is view
