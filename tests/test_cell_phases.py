"""What the network says about the cells, as seen through a map of the film."""

from __future__ import annotations

import numpy as np
import pytest
from told_cells import even_grid, told_of

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.records import CoarseMaps
from hybrid.rectify.grid.cells import CellsConfig, read_cells
from hybrid.rectify.grid.lines import GridConfig
from hybrid.rectify.grid.phases import CellPhases

FLAT = BackwardMap(film_nodes((9, 9)) * (400.0, 300.0))


def test_they_agree_with_the_grid_that_they_are_of_and_with_no_other():
    across, down = told_of(FLAT, even_grid(5, 4, 0.02), np.random.default_rng(0)).inside(FLAT).axes()
    for along, cells in ((across, 4), (down, 5)):
        right = 0.96 / cells
        pitch = right * np.array([1.0, 0.5, 2.0, cells / (cells + 1), cells / (cells - 1)])
        agreement = along.agreement(np.full(5, 0.02), pitch)
        assert agreement[0] > 0.9
        assert agreement[1:].max() < 0.5
        half_a_cell_on = along.agreement(np.array([0.02 + right / 2]), np.array([right]))
        assert half_a_cell_on[0] < -0.9
        assert along.pitch(1.05, 0.095) == pytest.approx(right, rel=0.03)


def test_cells_begin_where_the_phases_have_it():
    across, _ = told_of(FLAT, even_grid(5, 4, 0.06), np.random.default_rng(0)).inside(FLAT).axes()
    firsts = across.firsts(0.22, -0.01, 0.3)
    assert np.allclose(firsts, [0.06, 0.28], atol=0.005)
    assert across.firsts(0.22, 0.1, 0.2) == []


def test_the_grids_ends_are_those_within_which_places_are_in_cells():
    across, _ = told_of(FLAT, even_grid(5, 4, 0.1), np.random.default_rng(0)).inside(FLAT).axes()
    first, last = np.array([0.1, 0.0, 0.1, 0.3]), np.array([0.9, 1.0, 0.7, 0.9])
    assert int(across.ends(first, last).argmax()) == 0


def test_maps_without_phases_tell_nothing():
    n = 8
    maps = CoarseMaps(np.ones((n, n)), np.zeros((n, n, 2)), np.zeros((n, n, 3)), np.zeros((n, n)), np.zeros((n, n, 2)))
    assert CellPhases.of(maps) is None
    phases, empty = np.ones((n, n, 2, 2)), np.zeros((n, n))
    assert CellPhases.of(CoarseMaps(empty, maps.uv, maps.xyz, maps.albedo, maps.uv, None, phases, empty)) is None


def test_a_larger_copy_of_the_photo_tells_the_same():
    phases = told_of(FLAT, even_grid(5, 4), np.random.default_rng(0))
    twice = phases.scaled((2.0, 2.0)).inside(FLAT.cropped((0.0, 0.0), (2.0, 2.0)))
    for one, other in zip(phases.inside(FLAT).axes(), twice.axes(), strict=True):
        np.testing.assert_allclose(one.turns, other.turns, atol=1e-9)


@pytest.mark.parametrize(("rows", "cols"), [(5, 4), (3, 6), (7, 5), (2, 2)])
def test_cells_are_read_where_only_the_network_tells_them(rows: int, cols: int):
    """The view shows only noise: the network's phases decide."""
    grey = np.random.default_rng(0).normal(90, 5, (480, 480 * cols // rows if cols < rows else 480)).astype(np.float32)
    aspect = rows / cols
    told = told_of(FLAT, even_grid(rows, cols, 0.01), np.random.default_rng(0)).inside(FLAT).axes()
    reading = read_cells(grey, aspect, ((), ()), told, GridConfig(), CellsConfig())
    assert reading is not None
    assert (reading.rows.cells, reading.columns.cells) == (rows, cols)
    assert np.abs(reading.columns.lines() - np.linspace(0.01, 0.99, cols + 1)).max() < 0.02
