"""Margins that were taken for the ground: found where the sheet goes on, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from test_edges import CONFIG, STEPS, job_of, sheet_photo

import hybrid.pipeline.whole_sheet
from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.effort import RectifyConfig
from hybrid.pipeline.whole_sheet import MOST_MARGINS, whole_sheet
from hybrid.pyramid import Pyramid
from hybrid.records import SliceGrid
from hybrid.rectify.edges.paths import EdgesRead
from hybrid.rectify.grid.cells import CellsConfig
from hybrid.rectify.margins.clear import ClearMarginsConfig, LongerSheet, _together, lengthened, with_margins
from hybrid.rectify.refine.refine import Refinement
from hybrid.stages import Clock
from hybrid.strips import SIDES

MARGINS = ClearMarginsConfig()
DOUBTED = replace(MARGINS, written=1.01, certain=1.01)
"""Options with which edges alone never suffice, however sure they are."""
PHOTO, SHEET = sheet_photo()
"""A dark sheet from 100 to 600 along both axes, on bright ground."""


def part(low=(100, 100), high=(600, 600)) -> BackwardMap:
    """The map of the part of the sheet between two photo points (x, y)."""
    return BackwardMap(np.array(low) + (np.array(high) - low) * film_nodes((9, 9)))


def found(film: BackwardMap, photo=PHOTO, config=MARGINS) -> list[BackwardMap]:
    return [one.read.through for one in with_margins(Pyramid(photo), film, STEPS, CONFIG, config)]


def ends(film: BackwardMap) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest x and y of a map."""
    return film.nodes.min(axis=(0, 1)), film.nodes.max(axis=(0, 1))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("before", "after"), [(60, 60), (80, 0), (0, 50)])
def test_the_sheet_is_found_that_goes_on_beyond_its_map(axis, before, after):
    low, high = np.array([100, 100]), np.array([600, 600])
    low[axis] += before
    high[axis] -= after
    (film,) = found(part(low, high))
    for at, true in zip(ends(film), (100, 600), strict=True):
        np.testing.assert_allclose(at, true, atol=4)


def test_margins_are_told_by_their_place():
    (longer,) = with_margins(Pyramid(PHOTO), part((100, 160)), STEPS, CONFIG, MARGINS)
    told = str(longer)
    assert "% at the top," in told
    assert "bottom" not in told


def test_a_whole_sheet_has_none():
    assert found(SHEET) == []


def test_lines_that_run_on_beyond_the_sheet_are_none_where_nothing_ends_them():
    """Such lines are the edges of a board below the film that is as wide as the film."""
    photo = PHOTO.copy()
    photo[:100, 100:600] = 20
    assert found(part(), photo) == []


def test_one_side_that_goes_on_is_not_enough():
    photo = PHOTO.copy()
    photo[20:100, 100:240] = 20
    assert found(part(), photo) == []


def test_where_none_are_asked_for_nothing_is_read():
    def never(images, inside):
        raise AssertionError

    reader = replace(STEPS, logs=never)
    config = ClearMarginsConfig(beyond=())
    assert not list(with_margins(Pyramid(PHOTO), part((100, 160)), reader, CONFIG, config))


def test_margins_narrower_than_the_least_are_left():
    assert found(part((100, 160)), config=ClearMarginsConfig(least=0.2)) == []


def test_an_end_that_nothing_bears_out_does_not_hide_the_other():
    """A dark strip as wide as the film lies beyond one end, without sheet edges that lead to it."""
    photo = PHOTO.copy()
    photo[20:25, 100:600] = 20
    (film,) = found(part((100, 100), (600, 540)), photo)
    for at, true in zip(ends(film), (100, 600), strict=True):
        np.testing.assert_allclose(at, true, atol=4)


def test_a_longer_map_goes_straight_on():
    film, (top, bottom, left, _) = part((100, 160), (600, 540)), SIDES
    low, high = ends(lengthened(film, {top: 0.25, bottom: 0.5}))
    np.testing.assert_allclose(low, [100, 160 - 0.25 * 380])
    np.testing.assert_allclose(high, [600, 540 + 0.5 * 380])
    low, high = ends(lengthened(film, {bottom: 0.5, left: 0.1}))
    np.testing.assert_allclose(low, [100 - 0.1 * 500, 160])
    np.testing.assert_allclose(high, [600, 540 + 0.5 * 380])


def test_an_end_that_shows_nothing_may_lie_as_far_as_the_one_opposite():
    """Nothing is read beyond the lower end through the map, as the sheet is wider than the map."""
    top, bottom, left, right = SIDES
    tried = [{side.name: off for side, off in one.items()} for one in _together({top: 0.2, left: 0.1, right: 0.15})]
    assert tried[0] == {"top": 0.2, "bottom": 0.2, "left": 0.1, "right": 0.15}
    assert tried[1:] == [{"top": 0.2, "left": 0.1, "right": 0.15}, {"left": 0.1, "right": 0.15}, {"top": 0.2}]
    assert [list(one) for one in _together({left: 0.1, right: 0.2})] == [[left, right], []]
    assert [len(one) for one in _together(dict.fromkeys((top, bottom, left, right), 0.1))] == [4, 2, 2]


def test_margins_on_all_sides_are_found_at_once():
    """The sides show no edge along what is gained at one end until the map is as wide as the sheet."""
    film, *_ = found(part((170, 170), (530, 530)))
    for at, true in zip(ends(film), (100, 600), strict=True):
        np.testing.assert_allclose(at, true, atol=4)


# ---------------------------------------------------------------- which of them are believed


def refined(film: BackwardMap, expected_px=0.5) -> Refinement:
    return Refinement(film, None, (), expected_px=expected_px, stands=True)


def sheet_of(
    before: Refinement, monkeypatch, expected_px=0.5, margins=DOUBTED, grid=None, beside=0.0, photo=PHOTO
) -> tuple[Refinement, list[BackwardMap], bool]:
    """The sheet, all maps from which refinement began (it leaves them unchanged), and whether the stage ran.

    beside: how far from these maps the network sees the film, as a fraction of the film's size."""
    begun: list[BackwardMap] = []

    def exactly(job, phases, read, start):
        begun.append(start)
        assert read.through is start
        return replace(refined(start, expected_px), grid=grid)

    monkeypatch.setattr(hybrid.pipeline.whole_sheet, "refine_once", exactly)
    config, clock = replace(RectifyConfig(), margins=margins), Clock()
    sheet = whole_sheet(job_of(photo, config), None, before, lambda _: beside, clock).refinement
    (report,) = clock.reports
    assert report.name == "margins"
    return sheet, begun, report.ran


def test_a_sheet_with_margins_that_is_seen_as_well_counts(monkeypatch):
    sheet, begun, ran = sheet_of(refined(part((100, 160))), monkeypatch)
    assert ran
    assert len(begun) == 1
    np.testing.assert_allclose(ends(sheet.backward), ends(SHEET), atol=4)
    assert sheet.across is not None
    assert sheet.across.support.min() > MARGINS.least_support


@pytest.mark.parametrize("expected_px", [None, 20.0])
def test_it_does_not_where_its_refinement_expects_a_large_error_or_none(monkeypatch, expected_px):
    before = refined(part((100, 160)))
    sheet, begun, ran = sheet_of(before, monkeypatch, expected_px)
    assert sheet is before
    assert len(begun) == 1
    assert not ran


@pytest.mark.parametrize("before_px", [0.5, None])
def test_nor_where_its_refinement_expects_a_larger_error_than_before(monkeypatch, before_px):
    """The error grows if the sheet takes in part of the film beside it; if none was expected before, any is less."""
    before = refined(part((100, 160)), before_px)
    for grown, counts in ((1.01, before_px is None), (0.99, True)):
        sheet, _, ran = sheet_of(before, monkeypatch, 0.5 * grown * MARGINS.most_growth)
        assert ran is counts
        assert (sheet is before) is not counts


def test_nor_where_its_grid_is_less_probable_than_before(monkeypatch):
    """This happens if another film's panel is taken for a margin, which spoils the cells."""
    at = film_nodes((4, 4))
    before = replace(refined(part((100, 160))), grid=SliceGrid(3, 3, at, at, 0.9))
    for lost, counts in ((1.01, False), (0.99, True), (-0.5, True)):
        grid = SliceGrid(4, 3, film_nodes((5, 4)), film_nodes((5, 4)), 0.9 - lost * MARGINS.grid_changed)
        sheet, _, ran = sheet_of(before, monkeypatch, grid=grid)
        assert ran is counts
        assert (sheet is before) is not counts
    assert sheet_of(before, monkeypatch)[0] is before  # the longer sheet has no grid any more


def test_where_its_grid_is_more_probable_a_larger_error_does_not_count_against_it(monkeypatch):
    """The network's map may lack a row of cells: the rest of the film fits well, too."""
    at = film_nodes((4, 4))
    before = replace(refined(part((100, 160))), grid=SliceGrid(3, 3, at, at, 0.7))
    for gained, counts in ((0.99, False), (1.01, True)):
        grid = SliceGrid(4, 3, film_nodes((5, 4)), film_nodes((5, 4)), 0.7 + gained * MARGINS.grid_changed)
        sheet, _, ran = sheet_of(before, monkeypatch, 2 * 0.5 * MARGINS.most_growth, grid=grid)
        assert ran is counts
        assert (sheet is before) is not counts


@pytest.mark.parametrize(
    ("printed", "lopsided", "before_sure", "sure", "counts"),
    [
        (160, 0.9, 0.99, 1.01, True),
        (160, 0.9, 1.01, 0.5, True),
        (160, 0.9, 1.01, 1.01, False),
        (160, 1.1, 0.99, 0.5, False),
        (100, 0.9, 0.99, 0.5, False),
    ],
)
def test_margins_that_are_blank_and_alike_count_however_the_print_fits(
    monkeypatch, printed, lopsided, before_sure, sure, counts
):
    """Bare margins count beyond edges that are not certain, or up to edges that are. Print there, as of another film,
    is no margin; nor is a sheet below, on which the film may lie anywhere and from which its own edges stand out."""
    photo, rng = PHOTO.copy(), np.random.default_rng(0)
    photo[printed:600, 100:600] += rng.integers(0, 60, (600 - printed, 500, 1), np.uint8)
    film, margins = part((100, 160)), replace(DOUBTED, blank_sure=sure)
    read = EdgesRead(film, (), 0.0, np.full((4, 32), before_sure * RectifyConfig().edges.sure))
    low = np.array([0.0, lopsided * MARGINS.blank_lopsided])
    vertices = low + (1.0 - low) * film_nodes((4, 4))
    grid = SliceGrid(3, 3, vertices, vertices, 1.0)
    before, most_px = replace(refined(film), across=read, grid=grid), 0.5 * MARGINS.most_growth
    sheet, _, ran = sheet_of(before, monkeypatch, 2 * most_px, margins, grid, photo=photo)
    assert ran is counts
    assert (sheet is before) is not counts


@pytest.mark.parametrize("beside", [0.0, 0.03])
def test_a_longer_sheet_that_is_not_believed_leaves_a_doubt_if_the_network_may_see_it(monkeypatch, beside):
    before = refined(part((100, 160)))
    monkeypatch.setattr(hybrid.pipeline.whole_sheet, "refine_once", lambda job, phases, read, start: refined(start))
    config = replace(RectifyConfig(), margins=replace(DOUBTED, sure=1.01))
    left = whole_sheet(job_of(PHOTO, config), None, before, lambda _: beside, Clock())
    assert left.refinement is before
    assert (left.goes_on > MARGINS.likely) == (beside == 0.0)
    assert (left.goes_on == 0.0) == (beside > 0.0)
    believed = whole_sheet(job_of(PHOTO), None, before, lambda _: 0.0, Clock())
    assert believed.refinement is not before
    assert believed.goes_on == 0.0


def test_where_no_grid_is_seen_what_is_gained_tells_whether_margins_are_alike(monkeypatch):
    margins = replace(DOUBTED, blank_sure=0.5)
    for low, high, counts in ((160, 540, True), (160, 580, False), (160, 600, False)):
        photo, rng = PHOTO.copy(), np.random.default_rng(0)
        photo[low:high, 100:600] += rng.integers(0, 60, (high - low, 500, 1), np.uint8)
        before = refined(part((100, low), (600, high)))
        _, _, ran = sheet_of(before, monkeypatch, 2 * 0.5 * MARGINS.most_growth, margins, photo=photo)
        assert ran is counts


def test_detail_is_told_of_the_end_that_shows_most():
    photo, rng = PHOTO.copy(), np.random.default_rng(0)
    photo[200:500, 100:600] += rng.integers(0, 60, (300, 500, 1), np.uint8)
    photo[500:600, 100:600] += rng.integers(0, 30, (100, 500, 1), np.uint8)
    (longer,) = with_margins(Pyramid(PHOTO), part((100, 180), (600, 520)), STEPS, CONFIG, MARGINS)
    top, bottom, *_ = SIDES
    assert set(longer.gained) == {top, bottom}
    assert longer.detail_gained(Pyramid(photo), SHEET, CellsConfig()) == pytest.approx(0.5, abs=0.1)
    assert longer.only(top).detail_gained(Pyramid(photo), SHEET, CellsConfig()) < 0.1
    away = BackwardMap(SHEET.nodes - [0.0, 250.0])
    assert longer.detail_gained(Pyramid(photo), away, CellsConfig()) == np.inf


def test_nor_where_its_print_is_far_from_the_middle(monkeypatch):
    """The sheet goes on by a seventh at one end, and the grid ends where the map did."""
    before = refined(part((100, 160)))
    for low, counts in ((0.146, False), (0.03, True)):
        vertices = np.array([0.0, low]) + np.array([1.0, 1.0 - low]) * film_nodes((4, 4))
        sheet, _, ran = sheet_of(before, monkeypatch, grid=SliceGrid(3, 3, vertices, vertices, 1.0))
        assert ran is counts
        assert (sheet is before) is not counts


@pytest.mark.parametrize("name", ["sure", "least_support"])
def test_nor_where_its_edges_are_not_sure_then(monkeypatch, name):
    before, never = refined(part((100, 160))), replace(DOUBTED, **{name: 1.01})
    sheet, begun, ran = sheet_of(before, monkeypatch, margins=never)
    assert sheet is before
    assert len(begun) == 1
    assert not ran


@pytest.mark.parametrize(
    ("margins", "low", "written", "expected_px", "counts"),
    [
        (MARGINS, 0.146, 100, 2.0, True),
        (MARGINS, 0.07, 160, 2.0, True),
        (MARGINS, 0.146, 160, 2.0, False),
        (MARGINS, 0.146, 100, 20.0, False),
        (DOUBTED, 0.146, 100, 2.0, False),
        (replace(MARGINS, certain=1.01), 0.07, 160, 2.0, False),
        (replace(MARGINS, certain=1.01), 0.146, 100, 2.0, True),
    ],
)
def test_where_its_edges_are_all_likely_margins_count_that_are_alike_or_written_on(
    monkeypatch, margins, low, written, expected_px, counts
):
    """However the print fits: a strip of writing above the cells has no cells. A blank one may be a sheet below."""
    photo, rng = PHOTO.copy(), np.random.default_rng(0)
    photo[written:600, 100:600] += rng.integers(0, 60, (600 - written, 500, 1), np.uint8)
    at = film_nodes((4, 4))
    before = replace(refined(part((100, 160))), grid=SliceGrid(3, 3, at, at, 0.9))
    vertices = np.array([0.0, low]) + np.array([1.0, 1.0 - low]) * at
    grid = SliceGrid(3, 3, vertices, vertices, 0.4)
    sheet, _, ran = sheet_of(before, monkeypatch, expected_px, margins, grid, photo=photo)
    assert ran is counts
    assert (sheet is before) is not counts


@pytest.mark.parametrize("margins", [MARGINS, DOUBTED])
def test_nor_where_the_network_sees_the_film_elsewhere(monkeypatch, margins):
    before = refined(part((100, 160)))
    for beside, counts in ((1.01 * MARGINS.most_beside, False), (0.99 * MARGINS.most_beside, True)):
        sheet, _, ran = sheet_of(before, monkeypatch, margins=margins, beside=beside)
        assert ran is counts
        assert (sheet is before) is not counts


def test_sides_that_the_photo_does_not_show_speak_neither_for_margins_nor_against_them():
    """If a film leaves the photo on one side, the other side decides; if neither shows, nothing speaks for margins."""
    top, left, right = (next(side for side in SIDES if side.name == name) for name in ("top", "left", "right"))
    chances = np.full((4, 64), 0.9)
    read = EdgesRead(SHEET, (), 0.0, chances)
    longer = LongerSheet(read, {top: 0.2})
    assert longer.chance(read) == pytest.approx(0.81)
    chances[SIDES.index(right)] = np.nan
    assert longer.chance(read) == pytest.approx(0.81)
    chances[SIDES.index(left)] = np.nan
    assert longer.chance(read) == 0.0


def test_margins_of_both_axes_are_found_one_after_the_other(monkeypatch):
    """A corner of the sheet: along each axis, the other edge is read once the map is as wide as the sheet."""
    sheet, begun, _ = sheet_of(refined(part((100, 160), (600, 540))), monkeypatch)
    assert 1 <= len(begun) <= MOST_MARGINS
    np.testing.assert_allclose(ends(sheet.backward), ends(SHEET), atol=4)


def test_a_whole_sheet_is_not_refined_again(monkeypatch):
    before = refined(SHEET)
    sheet, begun, ran = sheet_of(before, monkeypatch)
    assert sheet is before
    assert begun == []
    assert not ran
