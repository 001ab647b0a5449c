"""A photo that is the flat film itself: its cells tell, wherever the network sees the film's ends."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from film_photos import film_print
from synthetic_film import FilmDrawing, make_photo

from data_gen.prints.prints import FilmPrint
from hybrid.backward import BackwardMap
from hybrid.pyramid import Pyramid
from hybrid.records import CoarseMaps, SliceGrid
from hybrid.rectify.edges.paths import EdgesRead
from hybrid.rectify.refine.refine import Refinement
from hybrid.rectify.verdict.flat import NEAR_FRAME, NOTHING_ELSE, already_flat, frame_of
from hybrid.rectify.verdict.survey import film_share


@lru_cache(maxsize=1)
def sheet() -> FilmPrint:
    return film_print(4)


def picture() -> np.ndarray:
    """The flat print, uint8 RGB."""
    return np.repeat(np.rint(255 * sheet().image).astype(np.uint8)[..., None], 3, axis=2)


def with_grid(film: BackwardMap) -> Refinement:
    """A map with the print's grid on it."""
    known = sheet()
    grid = SliceGrid(known.rows, known.cols, known.vertices, film.photo_from_film(known.vertices), 1.0)
    return Refinement(film, grid, ())


def unmoved(start: BackwardMap) -> Refinement:
    """Refinement of a true map: the map does not change."""
    return with_grid(start)


def inside(size: tuple[int, ...]) -> BackwardMap:
    """A map well inside the frame of a picture of size (h, w)."""
    return BackwardMap(frame_of((size[0], size[1])).nodes * 0.8 + 0.1 * np.array([size[1], size[0]]))


def test_the_frame_of_a_photo_is_the_map_of_what_fills_it() -> None:
    frame = frame_of((40, 60))
    uv = np.array([[0.0, 0.0], [1.0, 1.0], [0.5, 0.25]])
    assert frame.photo_from_film(uv) == pytest.approx(uv * np.array([60.0, 40.0]))


def test_only_a_film_that_fills_the_photo_can_be_flat_already() -> None:
    photo, true = make_photo(FilmDrawing(), np.random.default_rng(3), 150)
    for coarse, refined in ((true, with_grid(true)), (None, None)):
        found, reason = already_flat(Pyramid(photo), coarse, NOTHING_ELSE - 0.01, refined, unmoved)
        assert found is None
        assert reason == "the film does not fill the photo"


@pytest.mark.parametrize(
    ("right", "edges", "flat"), [(0.96, 2, False), (1.0, 2, True), (1.0, 4, False), (0.96, 1, True)]
)
def test_a_sheet_is_seen_inside_the_photo_by_all_edges_or_by_some_if_all_lie_there(
    right: float, edges: int, flat: bool
) -> None:
    """A scan shows nothing beyond the frame: there nothing speaks for or against an edge."""
    shown = picture()
    size = shown.shape[:2]
    left_top, right_bottom = np.array([0.04, 0.04]), np.array([right, 0.96])
    film = BackwardMap(frame_of(size).nodes * (right_bottom - left_top) + left_top * np.array(size[::-1]))
    across = EdgesRead(film, (), 0.0, np.ones((4, 64), np.float32))
    refined = replace(with_grid(film), expected_px=1.0, edges=edges, across=across)
    found, reason = already_flat(Pyramid(shown), film, NOTHING_ELSE - 0.01, refined, unmoved)
    assert (found is not None) is flat
    assert flat or reason == "the sheet's edges are seen inside the photo"


@pytest.mark.parametrize("seen", [True, False])
def test_where_nothing_but_film_is_seen_its_cells_tell(seen: bool) -> None:
    """The network may see the film's ends elsewhere, or no film at all."""
    shown = picture()
    height, width = shown.shape[:2]
    frame, coarse = frame_of((height, width)), inside(shown.shape) if seen else None
    assert coarse is None or np.abs(coarse.nodes - frame.nodes).max() > NEAR_FRAME * np.hypot(height, width)
    found, _ = already_flat(Pyramid(shown), coarse, NOTHING_ELSE, None, unmoved)
    assert found is not None
    assert np.array_equal(found.backward.nodes, frame.nodes)
    assert found.grid is not None
    assert np.abs(found.grid.vertices_photo - sheet().vertices * np.array([width, height])).max() < 1e-6


def test_what_has_no_cells_that_are_alike_is_no_film() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (600, 800, 1), np.uint8).repeat(3, axis=2)
    found, reason = already_flat(Pyramid(noise), None, 1.0, None, unmoved)
    assert found is None
    assert reason.startswith("cells are alike to")


def test_a_film_that_goes_on_beyond_the_photo_is_not_flat() -> None:
    """The photo cuts through cells: they are less alike through the photo's own frame than through the sheet's map."""
    shown = picture()
    height, width = shown.shape[:2]
    kept = round(0.8 * width)
    cut, whole = np.ascontiguousarray(shown[:, :kept]), frame_of((height, width))
    found, _ = already_flat(Pyramid(cut), whole, 1.0, with_grid(whole), unmoved)
    assert found is None


def test_a_photo_too_narrow_for_the_network_s_lattice_shows_no_film() -> None:
    points = np.stack(np.meshgrid(np.linspace(-2400.0, 2464.0, 48), np.linspace(50.0, 4950.0, 48)), axis=-1)
    whole, zeros = np.ones((48, 48), np.float32), np.zeros((48, 48, 3), np.float32)
    maps = CoarseMaps(whole, zeros[..., :2], zeros, whole, points.astype(np.float32))
    assert not ((points[..., 0] >= 0) & (points[..., 0] <= 64)).any()
    assert film_share(maps, (5000, 64)) == 0.0
    assert film_share(maps, (5000, 5000)) == 1.0
