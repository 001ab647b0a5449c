"""The cells of a film are read from all evidence at once, with a probability."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float

from hybrid.rectify.grid.cells import CellsConfig, read_cells, weighed_counts
from hybrid.rectify.grid.lines import GridConfig

NO_PITCH = ((), ())


def film_of(rows: int, cols: int, margin: float = 0.0, rules: bool = False, seed: int = 0) -> Float[np.ndarray, "h w"]:
    """A dark film of square cells: each has an off-centre disc and a text in two corners; rules are optional.

    margin: empty film around the grid, as a fraction of the film.
    """
    rng, cell = np.random.default_rng(seed), 480 // max(rows, cols)
    h, w = cell * rows, cell * cols
    film = 30.0 + rng.normal(0, 1.5, (h, w))
    text = rng.random((2, 10, 24)) < 0.4
    y, x = np.mgrid[:h, :w] + 0.5
    down, across = h * (1 - 2 * margin) / rows, w * (1 - 2 * margin) / cols
    for i in range(rows):
        for j in range(cols):
            top, left = h * margin + i * down, w * margin + j * across
            radius = rng.uniform(0.2, 0.3) * min(down, across)
            middle_y, middle_x = (1 + rng.uniform(-0.15, 0.15, 2)) * np.array([down, across]) / 2
            film[np.hypot(y - top - middle_y, x - left - middle_x) < radius] += rng.uniform(60, 120)
            for patch, (r, c) in zip(text, ((top + 4, left + 4), (top + down - 14, left + across - 28)), strict=True):
                film[int(r) : int(r) + 10, int(c) : int(c) + 24][patch] = 160
    if rules:
        for k in range(rows + 1):
            film[np.clip(int(h * margin + k * down), 0, h - 1), int(w * margin) : int(w - w * margin)] = 140
        for k in range(cols + 1):
            film[int(h * margin) : int(h - h * margin), np.clip(int(w * margin + k * across), 0, w - 1)] = 140
    return film.astype(np.float32)


@pytest.mark.parametrize(("rows", "cols"), [(3, 3), (4, 3), (3, 4), (5, 4), (4, 5)])
@pytest.mark.parametrize(("rules", "margin"), [(False, 0.0), (False, 0.02), (True, 0.0), (True, 0.04), (True, 0.12)])
def test_cells_are_counted_and_placed(rows: int, cols: int, rules: bool, margin: float):
    grey = film_of(rows, cols, margin, rules)
    reading = read_cells(grey, grey.shape[0] / grey.shape[1], NO_PITCH, None, GridConfig(), CellsConfig())
    assert reading is not None
    assert (reading.rows.cells, reading.columns.cells) == (rows, cols)
    for along, cells in ((reading.rows, rows), (reading.columns, cols)):
        true = margin + (1 - 2 * margin) / cells * np.arange(cells + 1)
        assert np.abs(along.lines() - true).max() < (0.01 if rules else 0.04)  # only rules tell the place exactly


def test_a_known_pitch_is_no_more_than_a_hint():
    grey = film_of(5, 4)
    wrong = ((0.23, 0.31), (0.27,))
    reading = read_cells(grey, grey.shape[0] / grey.shape[1], wrong, None, GridConfig(), CellsConfig())
    assert reading is not None
    assert (reading.rows.cells, reading.columns.cells) == (5, 4)


def test_what_is_seen_turned_is_read_turned():
    grey = film_of(5, 3, margin=0.03)
    upright = read_cells(grey, grey.shape[0] / grey.shape[1], NO_PITCH, None, GridConfig(), CellsConfig())
    turned = read_cells(
        np.ascontiguousarray(grey.T), grey.shape[1] / grey.shape[0], NO_PITCH, None, GridConfig(), CellsConfig()
    )
    assert upright is not None
    assert turned is not None
    assert (turned.rows.cells, turned.columns.cells) == (upright.columns.cells, upright.rows.cells)
    assert turned.rows.lines() == pytest.approx(upright.columns.lines(), abs=1e-6)


def test_a_print_says_more_than_noise():
    rng = np.random.default_rng(1)
    noise = rng.normal(100, 20, (480, 420)).astype(np.float32)
    of_noise = read_cells(noise, 480 / 420, NO_PITCH, None, GridConfig(), CellsConfig())
    of_print = read_cells(film_of(5, 4, rules=True), 5 / 4, NO_PITCH, None, GridConfig(), CellsConfig())
    assert of_noise is not None
    assert of_print is not None
    assert of_print.probability > 0.9 > of_noise.probability
    assert of_print.probability <= 1.0 + 1e-9


@pytest.mark.parametrize("grey", [np.zeros((480, 420)), np.full((300, 300), 255.0)], ids=["black", "white"])
def test_a_blank_film_has_a_reading_that_is_not_sure(grey: np.ndarray):
    reading = read_cells(grey.astype(np.float32), 1.1, NO_PITCH, None, GridConfig(), CellsConfig())
    assert reading is not None
    assert np.isfinite(reading.probability)
    assert reading.probability < 0.9


def test_views_that_are_too_small_are_not_read():
    assert read_cells(np.zeros((30, 400), np.float32), 0.1, NO_PITCH, None, GridConfig(), CellsConfig()) is None


def test_other_numbers_of_cells_can_be_taken_for_granted():
    grey = film_of(4, 4)
    usual, other, unheard_of = (
        read_cells(grey, 1.0, NO_PITCH, None, GridConfig(), CellsConfig(counts=counts))
        for counts in ((0, 0), (2, 4), (1000, 4))
    )
    assert usual is not None
    assert other is not None
    assert (other.columns.cells, other.rows.cells) == (2, 4)
    weighed = weighed_counts(grey, 1.0, None, GridConfig(), CellsConfig(counts=(2, 4)))
    assert [counts for counts, chance in weighed if chance > 0] == [(2, 4)]
    assert unheard_of is not None
    assert (unheard_of.columns, unheard_of.rows) == (usual.columns, usual.rows)  # nothing speaks for them
    assert unheard_of.probability == usual.probability


def test_the_most_probable_numbers_of_cells_are_told():
    grey = film_of(4, 4)
    reading = read_cells(grey, 1.0, NO_PITCH, None, GridConfig(), CellsConfig())
    assert reading is not None
    (counts, probability), *_ = weighed = weighed_counts(grey, 1.0, None, GridConfig(), CellsConfig())
    assert counts == (reading.columns.cells, reading.rows.cells) == (4, 4)
    assert probability >= reading.probability - 1e-6
    told = [p for _, p in weighed]
    assert told == sorted(told, reverse=True)
    assert sum(told) == pytest.approx(1.0)
    assert weighed_counts(grey[:20, :20], 1.0, None, GridConfig(), CellsConfig()) == []
