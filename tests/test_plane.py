"""Flat films: found by the lines of their edges, and only where these are straight."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from synthetic_film import FilmDrawing, disturbed, draw_print
from told_cells import even_grid, told_of

from hybrid.backward import BackwardMap, end_point_error
from hybrid.coords import film_nodes, opencv_from_photo, pixel_centres, pixel_from_film
from hybrid.learn.networks.edgenet import strip_reader
from hybrid.learn.networks.inference import ready
from hybrid.learn.networks.weights import packaged_border_net
from hybrid.rectify.coarse.homography import apply_homography
from hybrid.rectify.refine.config import RefineConfig
from hybrid.rectify.refine.glance import glance
from hybrid.rectify.refine.plane import PlaneConfig, edge_line, film_corners, flat_film, plane_by_edges
from hybrid.rectify.splines.sightings import Sightings

HOMOGRAPHY = np.array([[560.0, 60.0, 90.0], [-70.0, 700.0, 110.0], [0.08, -0.05, 1.0]])
REFINE, CONFIG = RefineConfig(), PlaneConfig()


def plane_map() -> BackwardMap:
    return BackwardMap(apply_homography(HOMOGRAPHY, film_nodes((33, 33)).reshape(-1, 2)).reshape(33, 33, 2))


def flat_photo(bow: float = 0.0, printed: np.ndarray | None = None) -> np.ndarray:
    """A drawn film on a brighter ground; ``bow``: the depth of the arc of its sides, in film units."""
    if printed is None:
        printed = draw_print(FilmDrawing(margin=0.03), np.random.default_rng(0))
    points = pixel_centres((1800, 1800)) / 2.0
    uv = apply_homography(np.linalg.inv(HOMOGRAPHY), points.reshape(-1, 2)).reshape(points.shape)
    uv[..., 0] += bow * (1 - 4 * (uv[..., 1] - 0.5) ** 2)
    at = opencv_from_photo(pixel_from_film(uv, printed.shape)).astype(np.float32)
    film = cv2.remap(printed, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    on_film = ((uv >= 0) & (uv <= 1)).all(axis=-1)
    photo = cv2.resize(np.where(on_film, 12.0 + film, 120.0), (900, 900), interpolation=cv2.INTER_AREA)
    photo = photo[..., None] + np.random.default_rng(1).normal(0, 1.5, (900, 900, 3))
    return np.clip(np.rint(photo), 0, 255).astype(np.uint8)


def edges(bend: float = 0.0, shift: float = 0.0) -> list[Sightings]:
    """The four edges, seen shifted, and bowed by ``bend``."""
    along = np.linspace(0.01, 0.99, 80)
    found = []
    for axis, edge in ((1, 0.0), (1, 1.0), (0, 0.0), (0, 1.0)):
        seen = np.empty((80, 2))
        seen[:, 1 - axis], seen[:, axis] = along, edge + shift + bend * np.sin(np.pi * along)
        found.append(Sightings(axis, seen, np.full(80, edge), np.full(80, 3e-4), np.zeros((80, 0)), np.zeros(0)))
    return found


def test_a_flat_film_is_found_to_a_fraction_of_a_pixel_from_a_rough_map():
    true = plane_map()
    found = flat_film(flat_photo(), disturbed(true, 2.0, np.random.default_rng(2)), None, (), REFINE, CONFIG)
    assert found.expected_px is not None, found.stages[0].reason
    assert end_point_error(found.backward, true.nodes).max() < 0.6
    assert found.grid is not None
    assert (found.grid.rows, found.grid.cols) == (4, 3)


@pytest.mark.parametrize("bow", [0.004, -0.008])
def test_a_bowed_film_is_not_called_flat(bow: float):
    coarse = plane_map()
    found = flat_film(flat_photo(bow), coarse, None, (), REFINE, CONFIG)
    assert found.expected_px is None
    assert found.backward is coarse
    assert "not surely flat" in found.stages[0].reason


def test_where_the_map_is_far_from_a_plane_no_edge_is_looked_for():
    u = film_nodes((33, 33))[..., :1]
    bent = BackwardMap(plane_map().nodes + 60 * np.sin(np.pi * u) * [0, 1])
    found = flat_film(flat_photo(), bent, None, (), REFINE, CONFIG)
    assert not found.stages[0].ran
    assert found.expected_px is None


def test_edges_give_back_the_homography_that_they_were_seen_through():
    """Through a plane that is off by 1 %, the edges appear 1 % beside where they should be."""
    true = plane_map()
    found, reason = plane_by_edges([edge_line(edge) for edge in edges(shift=0.01)], true, CONFIG)
    assert found is not None, reason
    np.testing.assert_allclose(found.nodes, true.photo_from_film(film_nodes((33, 33)) + 0.01), atol=0.2)


@pytest.mark.parametrize(
    ("seen", "why"),
    [
        (edges()[:3], "3 of 4"),
        (edges(bend=0.003), "not surely flat"),
        (edges(shift=0.05), "beside"),
        ([edge.subset(edge.seen[:, 1 - edge.axis] < 0.6) for edge in edges()], "5 of 8"),
    ],
)
def test_what_is_not_surely_flat_says_why(seen: list[Sightings], why: str):
    found, reason = plane_by_edges([edge_line(edge) for edge in seen], plane_map(), CONFIG)
    assert found is None
    assert why in reason


def test_a_line_is_found_among_outliers_and_meets_the_others_in_the_corners():
    lines = []
    for edge in edges():
        edge.seen[::9, edge.axis] += 0.02
        edge.seen[:, edge.axis] += 0.01 * edge.seen[:, 1 - edge.axis]
        lines.append(edge_line(edge))
        assert lines[-1].slope == pytest.approx(0.01, abs=1e-6)
        assert lines[-1].bend < 1e-6
    for (u, v), line_v, line_u in zip(film_corners(lines), (0, 0, 1, 1), (2, 3, 2, 3), strict=True):
        assert v == pytest.approx(lines[line_v].at + lines[line_v].slope * u)
        assert u == pytest.approx(lines[line_u].at + lines[line_u].slope * v)


def test_a_glance_leaves_the_map_and_finds_the_grid():
    true = plane_map()
    found = glance(flat_photo(), true, None, 5e-4, REFINE)
    assert found.backward is true
    assert found.grid is not None
    assert (found.grid.rows, found.grid.cols) == (4, 3)
    assert [(stage.name, stage.ran) for stage in found.stages] == [
        ("outline", False),
        ("grid", True),
        ("spline", False),
    ]


def test_a_glance_takes_no_couches_for_lines_between_cells():
    """Each slice shows a couch at the same place, a little above its lower end."""
    true, rows = plane_map(), 5
    printed = draw_print(FilmDrawing(rows, 4, rules=False), np.random.default_rng(0))
    for row in range(rows):
        at = round(len(printed) * (row + 0.955) / rows)
        printed[at - 2 : at + 2] = 190.0
    told = told_of(true, even_grid(rows, 4), np.random.default_rng(1))
    reader = strip_reader(ready(packaged_border_net()))
    off = []
    for borders in (None, reader):
        found = glance(flat_photo(printed=printed), true, replace(told, borders=borders), 5e-4, REFINE)
        assert found.grid is not None
        assert (found.grid.rows, found.grid.cols) == (rows, 4)
        off.append(float(np.abs(found.grid.vertices[1:-1, :, 1] - np.arange(1, rows)[:, None] / rows).max()))
    assert off[1] < 0.003 < 0.006 < off[0]
