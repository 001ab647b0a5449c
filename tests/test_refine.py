"""Refinement: a better map where the photo shows how, the same map where it does not, never a worse one."""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from synthetic_film import FilmDrawing, disturbed, make_photo

from hybrid.backward import BackwardMap, end_point_error
from hybrid.coords import film_centres_1d, film_nodes
from hybrid.rectify.edges.outline import edge_sightings
from hybrid.rectify.grid.layout import Layout
from hybrid.rectify.grid.lines import Comb
from hybrid.rectify.margins.placing import PlacedPrint
from hybrid.rectify.refine.config import RefineConfig
from hybrid.rectify.refine.course import Course, Progress, unstretched
from hybrid.rectify.refine.refine import _apart, _better, _likelier, refine
from hybrid.rectify.refine.scene import half_view, scene_of, view_of
from hybrid.rectify.sheet.fit import FittedSheet, fit_sheet
from hybrid.rectify.splines.displacement import (
    Displacement,
    SplineConfig,
    fit_displacement,
    highest_near,
    no_displacement,
)
from hybrid.rectify.splines.sightings import Sightings, group_medians
from hybrid.stages import Stopwatch
from hybrid.strips import SIDES

CONFIG = RefineConfig()


def mean_error(predicted: BackwardMap, true: BackwardMap) -> float:
    return float(end_point_error(predicted, true.nodes).mean())


def scattered_sightings(axis: int, wanted, rng: np.random.Generator, n: int = 150) -> Sightings:
    """Sightings of a displacement ``wanted(uv)`` along one axis."""
    place = rng.uniform(0, 1, (n, 2))
    seen = place.copy()
    seen[:, axis] += wanted(place)
    return Sightings(axis, seen, place[:, axis].copy(), np.full(n, 3e-4), np.zeros((n, 0)), np.zeros(0))


def test_one_sided_sightings_give_back_a_smooth_displacement_despite_outliers():
    rng = np.random.default_rng(0)

    def wanted(uv):
        return 0.01 * np.sin(3 * uv[:, 0]) * np.cos(2 * uv[:, 1])

    sightings = [scattered_sightings(axis, wanted, rng) for axis in (0, 1)]
    sightings[0].seen[::7, 0] += 0.05
    uv = rng.uniform(0.05, 0.95, (100, 2))
    found = fit_displacement(sightings, SplineConfig()).displacement(uv) - uv
    apart = np.abs(found - wanted(uv)[:, None])
    assert np.median(apart) < 5e-5
    assert apart.max() < 1.5e-3


def test_an_axis_without_sightings_stays_where_it_is():
    rng = np.random.default_rng(1)
    fit = fit_displacement([scattered_sightings(1, lambda uv: 0.01 * uv[:, 0], rng)], SplineConfig())
    assert np.abs(fit.displacement.values[:, 0]).max() == 0.0
    assert np.abs(fit.displacement.values[:, 1]).max() > 0.005


def test_a_constant_that_all_share_is_not_taken_for_displacement():
    rng = np.random.default_rng(2)
    edges = scattered_sightings(0, lambda uv: np.zeros(len(uv)), rng)
    shifted = scattered_sightings(0, lambda uv: np.full(len(uv), 0.01), rng)
    shared = Sightings(0, shifted.seen, shifted.known, shifted.sigma, np.ones((len(shifted), 1)), np.array([0.02]))
    fit = fit_displacement([edges, shared], SplineConfig())
    assert np.abs(fit.displacement.values).max() < 5e-4
    assert fit.constants[1][0] == pytest.approx(0.01, abs=5e-4)


@pytest.mark.parametrize("background", [None, 70])
def test_rules_and_outline_bring_the_typical_error_below_a_pixel_and_no_error_up(background):
    before, after = [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        photo, true = make_photo(FilmDrawing(margin=0.03), rng, background)
        coarse = disturbed(true, 4.0, rng)
        refined = refine(photo, coarse, None, CONFIG)
        assert refined.grid is not None
        assert (refined.grid.rows, refined.grid.cols) == (4, 3)
        assert [s.name for s in refined.stages] == ["outline", "grid", "sheet", "spline"]
        before.append(mean_error(coarse, true))
        after.append(mean_error(refined.backward, true))
    assert np.median(after) < 1.0 < min(before)
    assert (np.array(after) < np.array(before)).all()


@pytest.mark.parametrize("seed", range(2))
def test_texts_that_repeat_lower_the_error(seed):
    rng = np.random.default_rng(10 + seed)
    photo, true = make_photo(FilmDrawing(5, 4, rules=False), rng)
    coarse = disturbed(true, 4.0, rng)
    refined = refine(photo, coarse, None, CONFIG)
    assert mean_error(refined.backward, true) < 0.9 * mean_error(coarse, true)
    assert refined.grid is not None
    assert (refined.grid.rows, refined.grid.cols) == (5, 4)


@pytest.mark.parametrize("level", [0, 30, 255])
def test_nothing_seen_changes_nothing(level):
    _, true = make_photo(FilmDrawing(), np.random.default_rng(3))
    photo = np.full((640, 640, 3), level, np.uint8)
    refined = refine(photo, true, None, CONFIG)
    assert refined.backward is true
    assert refined.grid is None
    assert not any(s.ran for s in refined.stages)


@pytest.mark.parametrize("rules", [True, False])
def test_a_right_map_stays_right(rules):
    """To half a pixel."""
    photo, true = make_photo(FilmDrawing(rules=rules, margin=0.03), np.random.default_rng(4))
    assert mean_error(refine(photo, true, None, CONFIG).backward, true) < 0.5


def test_the_farther_apart_the_two_ends_the_more_error_is_expected(monkeypatch):
    rng = np.random.default_rng(0)
    photo, true = make_photo(FilmDrawing(margin=0.03), rng)
    coarse, expected = disturbed(true, 4.0, rng), []
    for apart in (1e-3, 1e-2):
        monkeypatch.setattr("hybrid.rectify.refine.refine._apart", lambda *_, apart=apart: apart)
        expected.append(refine(photo, coarse, None, CONFIG).expected_px)
    assert expected[1] > 5 * expected[0]


def test_ends_that_a_shift_parts_are_not_apart():
    coarse, still = BackwardMap(film_nodes((9, 9)) * 400.0 + 50.0), no_displacement(CONFIG.spline)
    scene = scene_of(np.zeros((500, 500, 3), np.uint8), coarse)

    def end(values: np.ndarray) -> Course:
        return Course(scene, replace(still, values=values), Layout(), (), 0.0, 0.0, True, None, "")

    unmoved, shifted = end(still.values), end(np.full_like(still.values, 0.01))
    assert _apart(unmoved, shifted) == pytest.approx(0.0, abs=1e-6)
    assert _apart(unmoved, end(0.02 * (still.lattice.nodes - 0.5))) == pytest.approx(0.008, abs=0.001)


@pytest.mark.parametrize(
    ("residuals", "alike", "sheet_counts"),
    [
        ((1.0, 1.0), (0.5, 0.5), True),
        ((1.0, 1.05), (0.5, 0.5), True),  # hardly more doubtful
        ((1.0, 1.5), (0.5, 0.5), False),
        ((1.0, 1.0), (0.5, 0.4), False),
        ((1.0, 1.5), (0.5, 0.7), True),
        ((1.0, 1.0), (0.0, 0.0), True),  # no cells
    ],
)
def test_the_less_doubtful_end_counts(monkeypatch, residuals, alike, sheet_counts):
    coarse, still = BackwardMap(film_nodes((9, 9)) * 400.0 + 50.0), no_displacement(CONFIG.spline)
    scene = scene_of(np.zeros((500, 500, 3), np.uint8), coarse)
    free, bound = (Course(scene, still, Layout(), (), 0.0, after, True, None, "") for after in residuals)
    monkeypatch.setattr("hybrid.rectify.refine.refine.agreement", lambda course, _: alike[course is bound])
    assert (_better(free, bound, CONFIG, Stopwatch()) is bound) == sheet_counts
    assert _better(free, replace(bound, believed=False), CONFIG, Stopwatch()) is free


@pytest.mark.parametrize(
    ("held_out", "beside", "usual_counts"),
    [((1.0, 1.0), (0.5, 0.5), True), ((1.0, 1.2), (0.5, 0.5), False), ((1.0, 1.2), (0.5, 0.4), True)],
)
def test_usual_margins_count_where_they_end_no_more_doubtful(monkeypatch, held_out, beside, usual_counts):
    coarse, still = BackwardMap(film_nodes((9, 9)) * 400.0 + 50.0), no_displacement(CONFIG.spline)
    scene = scene_of(np.zeros((500, 500, 3), np.uint8), coarse)
    before, usual = (
        Course(scene, still, Layout(), (), 0.0, after, True, a_sheet(coarse, residual), "")
        for after, residual in zip(held_out, beside, strict=True)
    )
    monkeypatch.setattr("hybrid.rectify.refine.refine.agreement", lambda *_: 0.5)
    assert (_likelier(before, usual, CONFIG, Stopwatch()) is usual) == usual_counts
    assert _likelier(before, replace(usual, believed=False), CONFIG, Stopwatch()) is before


def a_sheet(film: BackwardMap, residual: float) -> FittedSheet:
    """A sheet beside which things are seen by as much, in standard deviations."""
    edges = [edge_sightings(side, film_centres_1d(9), np.zeros(9), np.full(9, 1e-3)) for side in SIDES]
    sheet = fit_sheet(film, film, (500, 500), edges, CONFIG.sheet)
    assert sheet is not None
    return replace(sheet, state=replace(sheet.state, cost=np.square(residual) * sum(map(len, edges))))


@pytest.mark.parametrize("usual_counts", [True, False])
def test_two_sheets_are_followed_where_margins_may_be_usual(monkeypatch, usual_counts):
    """The print's middle lies beside the film's: that it is in the middle only seems possible."""
    photo, true = make_photo(FilmDrawing(margin=0.05), np.random.default_rng(6))
    ends: list[Course] = []

    def compared(bound: Course, usual: Course, *_: object) -> Course:
        ends.extend([bound, usual])
        return usual if usual_counts else bound

    margins = replace(CONFIG.margins, costs=-0.5, narrow_costs=-0.5)  # none is adopted at once
    config = replace(CONFIG, margins=margins, settled_sheet=0.0)
    monkeypatch.setattr("hybrid.rectify.refine.refine._likelier", compared)
    monkeypatch.setattr("hybrid.rectify.refine.refine._better", lambda _, bound, *__: bound)
    refined = refine(photo, disturbed(true, 4.0, np.random.default_rng(6)), None, config)
    bound, usual = ends
    centred = [[e.source.centred for e in end.evidence if isinstance(e.source, Comb)] for end in ends]
    assert not any(centred[0])
    assert all(centred[1])
    counts = usual if usual_counts else bound
    assert np.allclose(refined.backward.nodes, counts.displacement.composed(counts.scene.coarse, (33, 33)).nodes)


def test_a_sheet_counts_though_a_further_one_fails(monkeypatch):
    photo, true = make_photo(FilmDrawing(margin=0.03), np.random.default_rng(6))
    fitted: list[Progress | None] = []

    def once(progress: Progress, placed: PlacedPrint, config: RefineConfig, watch: Stopwatch) -> Progress | None:
        fitted.append(None if fitted else unstretched(progress, placed, config, watch))
        return fitted[-1]

    monkeypatch.setattr("hybrid.rectify.refine.refine.unstretched", once)
    monkeypatch.setattr("hybrid.rectify.refine.refine._better", lambda free, bound, *_: bound)
    refined = refine(photo, disturbed(true, 4.0, np.random.default_rng(6)), None, CONFIG)
    assert len(fitted) == 2
    assert refined.aspect is not None


@pytest.mark.parametrize(("settled_end", "most"), [(1.0, 2), (0.0, 3)])
def test_a_sheet_that_hardly_moves_the_film_is_the_last(monkeypatch, settled_end, most):
    photo, true = make_photo(FilmDrawing(margin=0.03), np.random.default_rng(6))
    fitted: list[Progress | None] = []

    def counted(progress: Progress, placed: PlacedPrint, config: RefineConfig, watch: Stopwatch) -> Progress | None:
        fitted.append(unstretched(progress, placed, config, watch))
        return fitted[-1]

    monkeypatch.setattr("hybrid.rectify.refine.refine.unstretched", counted)
    config = replace(CONFIG, settled_sheet=0.0, settled_end=settled_end)
    refine(photo, disturbed(true, 4.0, np.random.default_rng(6)), None, config)
    assert len(fitted) == most


def test_lifted_sightings_are_the_same_points_of_the_photo():
    """Both coordinates follow the displacement, as a sheet is fitted to points of the photo; the place of a thing along
    its edge or line is known as well as before."""
    rng = np.random.default_rng(4)
    lattice = no_displacement(SplineConfig()).lattice
    moved = Displacement(lattice, 0.01 * rng.normal(size=(len(lattice.nodes), 2)))
    coarse = BackwardMap(900 * film_nodes((9, 9)))
    for axis in (0, 1):
        seen = scattered_sightings(axis, lambda uv: 0.01 * uv[:, 1], rng)
        lifted = moved.lift(seen)
        np.testing.assert_allclose(coarse.photo_from_film(lifted.seen), 900 * moved(seen.seen), atol=1e-6)
        np.testing.assert_array_equal(lifted.places(), seen.places())
        np.testing.assert_array_equal(lifted.subset(np.arange(5)).places(), seen.places()[:5])


def test_no_displacement_leaves_maps_and_sightings_as_they_are():
    still, rng = no_displacement(CONFIG.spline), np.random.default_rng(8)
    coarse = disturbed(BackwardMap(film_nodes((9, 9)) * 400.0 + 50.0), 4.0, rng)
    assert np.abs(still.composed(coarse).nodes - coarse.photo_from_film(film_nodes((33, 33)))).max() < 1e-9
    seen = scattered_sightings(0, lambda uv: 0.01 * uv[:, 1], rng)
    assert (still.lift(seen).seen == seen.seen).all()


@pytest.mark.parametrize("start", range(5))
def test_the_highest_is_found_uphill_and_few_values_are_computed(start):
    asked: list[int] = []

    def value(k: int) -> float:
        asked.append(k)
        return -abs(k - 1.4)

    assert highest_near(start, [partial(value, k) for k in range(5)]) == 1
    assert len(asked) == len(set(asked))
    assert highest_near(0, [partial(float, 7)]) == 0


def test_medians_of_groups_of_any_size():
    values, group = np.array([3.0, 1.0, 2.0, 8.0, 4.0, 7.0]), np.array([0, 0, 0, 2, 2, 4])
    assert group_medians(values, group).tolist() == [2.0, 0.0, 6.0, 0.0, 7.0]
    assert group_medians(np.zeros(0), np.zeros(0, int)).tolist() == []


def test_both_views_of_a_photo_of_odd_size_show_the_same_film():
    x, y = np.meshgrid(np.arange(401.0), np.arange(301.0))
    photo = np.repeat((120 + 60 * np.sin(x / 30) * np.cos(y / 25)).astype(np.uint8)[..., None], 3, axis=2)
    scene = scene_of(photo, BackwardMap(film_nodes((9, 9)) * [307.0, 211.0] + [40.0, 30.0]))
    full, half = view_of(scene, scene.coarse).image[..., 0], half_view(scene, scene.coarse).image[..., 0]
    assert full.shape == (216, 312)  # near the film's size, and divisible by two, three and eight
    assert np.abs(full.reshape(108, 2, 156, 2).mean(axis=(1, 3)) - half).max() < 1.5
    assert scene.aspect == pytest.approx(211 / 307)


def test_refining_twice_gives_the_same_bits():
    rng = np.random.default_rng(5)
    photo, true = make_photo(FilmDrawing(), rng)
    coarse = disturbed(true, 3.0, rng)
    first, second = (refine(photo, coarse, None, CONFIG).backward.nodes for _ in range(2))
    assert (first == second).all()


def test_real_renders_are_not_made_worse():
    folder = os.environ.get("HYBRID_SHARED_DATA")
    if not folder or not (Path(folder) / "photos").is_dir():
        pytest.skip("HYBRID_SHARED_DATA does not name a folder with photos/ in it")
    import cv2

    from hybrid.coords import rgb_from_bgr

    for name in ("film_005", "film_006", "film_001"):
        photo = rgb_from_bgr(cv2.imread(str(Path(folder) / "photos" / f"{name}.jpg")))
        true = BackwardMap(np.load(Path(folder) / "photos" / f"{name}.npz")["lattice"]).resized((33, 33))
        coarse = disturbed(true, 6.0, np.random.default_rng(6))
        assert mean_error(refine(photo, coarse, None, CONFIG).backward, true) < 0.5 * mean_error(coarse, true)
