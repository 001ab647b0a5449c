"""What the network predicts in the cells shows how the map gets the sheet's foreshortening wrong."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_film import FilmDrawing, make_photo
from told_cells import bent_along, even_grid, told_of

from hybrid.backward import BackwardMap, end_point_error
from hybrid.coords import film_nodes, node_centres_1d
from hybrid.rectify.coarse.foreshortening import ForeshorteningConfig, bent, even, spacing, turned_away
from hybrid.rectify.edges.outline import edge_sightings
from hybrid.rectify.grid.phases import CellPhases
from hybrid.rectify.refine.config import RefineConfig
from hybrid.rectify.refine.refine import refine
from hybrid.rectify.splines.sightings import Sightings
from hybrid.strips import SIDES

CONFIG = ForeshorteningConfig()
FLAT = BackwardMap(film_nodes((17, 17)) * (400.0, 300.0) + 50.0)


def mean_error(found: BackwardMap, true: BackwardMap) -> float:
    return float(end_point_error(found, true.resized((33, 33)).nodes).mean())


def edges_of(true: BackwardMap, coarse: BackwardMap) -> list[Sightings]:
    """The edges of the film as seen through a map."""
    along = node_centres_1d(33)
    found = []
    for side in SIDES:
        on_edge = side.film_points(along, np.zeros(33))
        seen = coarse.film_near(true.photo_from_film(on_edge), on_edge)
        depth = side.inward * (seen[:, side.axis] - side.edge)
        found.append(edge_sightings(side, seen[:, 1 - side.axis], depth, np.full(33, 1e-3)))
    return found


@pytest.mark.parametrize("bends", [((0.3, 0.0), (0.0, 0.0)), ((-0.3, 0.1), (0.2, -0.1)), ((0.0, 0.2), (-0.35, 0.0))])
@pytest.mark.parametrize(("rows", "cols", "margin"), [(5, 4, 0.0), (4, 6, 0.03), (3, 3, 0.0), (8, 6, 0.05)])
def test_a_map_with_right_edges_and_a_wrong_inside_is_put_right(rows: int, cols: int, margin: float, bends):
    coarse = bent_along(FLAT, *bends)
    phases = told_of(FLAT, even_grid(rows, cols, margin), np.random.default_rng(rows))
    before, after = mean_error(coarse, FLAT), mean_error(even(coarse, phases, edges_of(FLAT, coarse), CONFIG), FLAT)
    assert before > 8
    assert after < 0.55 * before


def test_the_spacing_that_is_found_is_the_one_that_was_made():
    coarse = bent_along(FLAT, (0.2, 0.0), (-0.3, 0.0))
    told = told_of(FLAT, even_grid(5, 4), np.random.default_rng(0)).inside(coarse)
    t = np.linspace(0, 1, 21)
    for along, cells, made in zip(told.axes(), (4, 5), (0.2, -0.3), strict=True):
        found = spacing(along, CONFIG)
        assert found.pitch == pytest.approx(1 / cells, rel=0.03)
        assert np.abs(bent(t, found.bend) - (t + t * (1 - t) * made)).max() < 0.03


def test_each_end_turns_away_in_one_map_of_a_bend():
    """There a tenth of the sheet takes less room than in the flat map, and nothing else changes along its edge."""
    end = np.array([[0.0, 0.5], [0.1, 0.5], [0.9, 0.5], [1.0, 0.5], [0.5, 0.0], [0.5, 0.1], [0.5, 0.9], [0.5, 1.0]])
    shares = []
    for film in turned_away(FLAT, [(0.7, 0.35)]):
        first, last = film.photo_from_film(end)[::2], film.photo_from_film(end)[1::2]
        shares.append(np.linalg.norm(last - first, axis=1) / np.array([40.0, 40.0, 30.0, 30.0]))
        assert np.allclose(film.photo_from_film(np.eye(2)), FLAT.photo_from_film(np.eye(2)))
        assert not film.folds()
    assert sorted(np.argmin(shares, axis=1)) == [0, 1, 2, 3]
    assert np.allclose(np.min(shares, axis=1), 0.5, atol=0.05)
    assert turned_away(FLAT, []) == []


@pytest.mark.parametrize("margin", [0.0, 0.04])
def test_what_is_even_stays_where_it_is(margin: float):
    for rows, cols in ((3, 3), (5, 4), (2, 6)):
        phases = told_of(FLAT, even_grid(rows, cols, margin), np.random.default_rng(0))
        assert mean_error(even(FLAT, phases, edges_of(FLAT, FLAT), CONFIG), FLAT) < 1.0


def test_edges_stay_where_the_map_has_them():
    coarse = bent_along(FLAT, (0.3, 0.1), (-0.2, 0.0))
    told = told_of(FLAT, even_grid(5, 4), np.random.default_rng(1))
    found = even(coarse, told, edges_of(FLAT, coarse), CONFIG)
    apart = np.abs(found.resized((33, 33)).nodes - FLAT.resized((33, 33)).nodes)
    assert max(apart[[0, -1], :, 1].max(), apart[:, [0, -1], 0].max()) < 1.0


def test_edges_that_lie_beside_the_maps_are_left_where_they_are():
    """They are seen through the bent map and must be carried over to the straightened one."""
    coarse = bent_along(FLAT, (0.3, 0.0), (0.0, 0.0))
    beside = BackwardMap(coarse.photo_from_film(0.98 * film_nodes((33, 33)) + 0.01))
    told = told_of(FLAT, even_grid(5, 4), np.random.default_rng(1))
    found = even(beside, told, edges_of(FLAT, beside), CONFIG)
    apart = np.abs(found.resized((33, 33)).nodes - FLAT.resized((33, 33)).nodes)
    assert max(apart[[0, -1], :, 1].max(), apart[:, [0, -1], 0].max()) < 1.0


def test_where_nothing_is_sure_nothing_moves():
    told = told_of(FLAT, even_grid(5, 4), np.random.default_rng(0))
    unsure = CellPhases(told.points, told.near, 0.2 * told.turns, told.in_grid)
    assert mean_error(even(FLAT, unsure, edges_of(FLAT, FLAT), CONFIG), FLAT) < 1e-6
    nowhere = CellPhases(told.points + 1e4, told.near + 30, told.turns, told.in_grid)
    assert even(FLAT, nowhere, edges_of(FLAT, FLAT), CONFIG) is FLAT


@pytest.mark.parametrize("bends", [((-0.35, 0.1), (0.0, 0.0)), ((0.0, 0.0), (-0.35, 0.1))])
def test_refinement_begins_there(bends):
    photo, true = make_photo(FilmDrawing(5, 4, rules=False), np.random.default_rng(3))
    coarse, phases = bent_along(true, *bends), told_of(true, even_grid(5, 4), np.random.default_rng(0))
    start = even(coarse, phases, edges_of(true, coarse), CONFIG)
    assert mean_error(coarse, true) > 15
    assert mean_error(start, true) < 5
    assert mean_error(refine(photo, start, phases, RefineConfig()).backward, true) < 1
