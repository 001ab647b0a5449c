"""The sheet's edges: found to a fraction of a pixel where they show, and not found where they do not."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from synthetic_film import FilmDrawing, disturbed, make_photo

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d, film_nodes
from hybrid.rectify.edges.curves import best_paths, smooth_curve_weights
from hybrid.rectify.edges.outline import OutlineConfig, edge_sightings, find_outline
from hybrid.rectify.refine.config import RefineConfig
from hybrid.strips import SIDES

CONFIG = OutlineConfig(band=0.03)
RULE_PX = 2.0
"""Median distance if a rule on the edge is as bright as what lies behind: the step is then the rule's inner side."""
EDGE_PX = 0.5
"""Median distance of edge points from the true edge: noise and blur."""


def distance_from_edge(seen_through: BackwardMap, true: BackwardMap, sightings) -> np.ndarray:
    """Distances of the sightings from the true edge, in photo pixels."""
    xy = seen_through.photo_from_film(sightings.seen)
    t = np.linspace(0, 1, 4000)
    edge = np.full((4000, 2), sightings.known[0])
    edge[:, 1 - sightings.axis] = t
    line = true.photo_from_film(edge)
    return np.linalg.norm(xy[:, None] - line[None], axis=2).min(axis=1)


def test_edges_beside_a_clipped_background_lie_further_out_and_may_shift():
    """The blur of a background too bright to be shown covers the film's rim, the wider the brighter it is."""
    rng = np.random.default_rng(5)
    photo, true = make_photo(FilmDrawing(rules=False), rng, 255)
    as_seen, outline = (find_outline(photo, true, c) for c in (replace(CONFIG, clipped_share=1.0), CONFIG))
    assert len(outline) == 4
    for before, edge in zip(as_seen, outline, strict=True):
        outwards = (before.seen - edge.seen)[:, edge.axis] * (1.0 if edge.known[0] == 0 else -1.0)
        assert outwards.min() > 0
        assert (before.shared.shape[1], edge.shared.shape[1]) == (0, 1)
        assert not edge.has_rule


@pytest.mark.parametrize("rules", [True, False])
@pytest.mark.parametrize("background", [None, 60, 200])
def test_edges_are_found_to_a_fraction_of_a_pixel(rules, background):
    rng = np.random.default_rng(4)
    photo, true = make_photo(FilmDrawing(rules=rules), rng, background)
    coarse = disturbed(true, 4.0, rng)
    outline = find_outline(photo, coarse, CONFIG)
    assert {(s.axis, s.known[0]) for s in outline} == {(0, 0.0), (0, 1.0), (1, 0.0), (1, 1.0)}
    for sightings in outline:
        assert np.median(distance_from_edge(coarse, true, sightings)) < (RULE_PX if rules else EDGE_PX)


def test_a_frame_printed_inside_is_not_the_edge():
    rng = np.random.default_rng(5)
    photo, true = make_photo(FilmDrawing(margin=0.03), rng, 110)
    coarse = disturbed(true, 4.0, rng)
    outline = find_outline(photo, coarse, CONFIG)
    assert len(outline) == 4
    for sightings in outline:
        assert np.median(distance_from_edge(coarse, true, sightings)) < EDGE_PX


def test_a_shadow_beside_the_sheet_is_not_its_edge_where_that_was_read():
    rng = np.random.default_rng(8)
    photo, true = make_photo(FilmDrawing(rules=False), rng, 200)
    left, t = SIDES[2], film_centres_1d(64)
    edge, shadow = (true.photo_from_film(left.film_points(t, np.full(64, depth))) for depth in (0.0, -0.02))
    cv2.fillPoly(photo, [np.rint(np.concatenate([shadow, edge[::-1]])).astype(np.int32)], (70, 70, 70))
    coarse = disturbed(true, 4.0, rng)
    seen = coarse.film_near(edge, left.film_points(t, np.zeros(64)))
    read = edge_sightings(left, seen[:, 1], seen[:, 0], np.full(64, 1e-3))
    off = []
    for edges in ((), (read,)):
        (found,) = [s for s in find_outline(photo, coarse, CONFIG, edges) if (s.axis, s.known[0]) == (0, 0.0)]
        off.append(float(np.median(distance_from_edge(coarse, true, found))))
    assert off[0] > 5
    assert off[1] < 1.5


def test_an_edge_may_be_held_to_where_it_was_read():
    """A far clearer line near the edge that was read is taken for the edge, unless the edge is held."""
    photo = np.full((1100, 1100, 3), 60, np.uint8)
    photo[50:-50, 50:-50], photo[58:-58, 58:-58] = 30, 250
    photo, true = cv2.GaussianBlur(photo, (0, 0), 0.7), BackwardMap(50.0 + 1000 * film_nodes((9, 9)))
    read = read_at(true, true, 0.0, SIDES[2])
    off = []
    for config in (RefineConfig(), RefineConfig().edges_held):
        (found,) = [s for s in find_outline(photo, true, config.outline, [read]) if (s.axis, s.known[0]) == (0, 0.0)]
        off.append(float(np.median(distance_from_edge(true, true, found))))
    assert off[0] > 3
    assert off[1] < 1


def with_frame(photo, true, depth, sides=SIDES):
    """The photo with a bright band along some of the film's edges; depth is its width in film units."""
    photo, t = photo.copy(), np.linspace(0, 1, 200)
    for side in sides:
        outer, inner = (side.film_points(t, np.full(200, d)) for d in (0.0, depth))
        points = true.photo_from_film(np.concatenate([outer, inner[::-1]]))
        cv2.fillPoly(photo, [np.rint(16 * (points - 0.5)).astype(np.int32)], (235, 235, 235), cv2.LINE_AA, 4)
    return cv2.GaussianBlur(photo, (0, 0), 0.7)


def read_at(true, coarse, depth, side):
    """An edge as read at a depth inside the true one, seen through a coarse map."""
    at = side.film_points(film_centres_1d(64), np.full(64, depth))
    seen = coarse.film_near(true.photo_from_film(at), at)
    inside = side.inward * (seen[:, side.axis] - side.edge)
    return edge_sightings(side, seen[:, 1 - side.axis], inside, np.full(64, 1e-3))


@pytest.mark.parametrize(
    ("framed", "read_depth", "has_frame"), [(4, 0.002, True), (4, 0.009, False), (1, 0.002, False)]
)
def test_a_bright_band_at_the_edge_is_the_films_where_the_edge_was_read_so(framed, read_depth, has_frame):
    """A bar beside a film looks like a frame of it: a frame needs two sides and an edge read nearer its outer flank."""
    rng = np.random.default_rng(9)
    photo, true = make_photo(FilmDrawing(rules=False), rng, 90)
    frame = 4.5 / min(true.mean_film_pixels())
    coarse = disturbed(true, 2.0, rng)
    read = [read_at(true, coarse, read_depth, side) for side in SIDES]
    outline = find_outline(with_frame(photo, true, frame, SIDES[:framed]), coarse, OutlineConfig(), read)
    assert len(outline) == 4
    assert [edge.has_frame for edge in outline] == 4 * [has_frame]
    if has_frame:
        assert max(np.median(distance_from_edge(coarse, true, edge)) for edge in outline) < EDGE_PX


def test_black_film_on_black_gives_no_sightings():
    rng = np.random.default_rng(6)
    photo = np.clip(np.rint(20 + rng.normal(0, 1.5, (400, 400, 3))), 0, 255).astype(np.uint8)
    _, true = make_photo(FilmDrawing(), rng, size=400)
    assert find_outline(photo, true, CONFIG) == ()


def test_an_edge_outside_the_photo_is_not_seen():
    rng = np.random.default_rng(7)
    photo, true = make_photo(FilmDrawing(rules=False), rng)
    cut = int(true.nodes[:, 0, 0].max()) + 20
    outline = find_outline(np.ascontiguousarray(photo[:, cut:]), true.cropped((float(cut), 0.0)), CONFIG)
    assert (0, 0.0) not in {(s.axis, s.known[0]) for s in outline}


def test_best_path_is_the_ridge():
    columns = np.arange(60)
    ridge = np.rint(10 + 5 * np.sin(columns / 12)).astype(int)
    score = np.zeros((2, 25, 60))
    score[0, ridge, columns] = 3.0
    score[1, 20 - ridge, columns] = 3.0
    paths = best_paths(score)
    assert (paths[0] == ridge).all()
    assert (paths[1] == 20 - ridge).all()


def test_outliers_from_a_smooth_curve_lose_their_weight():
    rng = np.random.default_rng(8)
    along = np.linspace(0, 1, 80)
    depth = 3 * along**2 + rng.normal(0, 0.1, 80)
    bad = rng.permutation(80)[:16]
    depth[bad] += rng.choice([-1, 1], 16) * rng.uniform(3, 9, 16)
    weights = smooth_curve_weights(along, depth[None], np.ones((1, 80), dtype=bool), np.array([0.3]))[0]
    assert weights[bad].max() < 0.01
    assert np.median(np.delete(weights, bad)) > 0.8
