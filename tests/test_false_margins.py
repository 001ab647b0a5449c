"""Ground that was taken for margins: cut off where the sheet's edges are seen around its print, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from test_edges import CONFIG, STEPS, job_of, sheet_photo

import hybrid.pipeline.whole_sheet
from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.effort import RectifyConfig
from hybrid.pipeline.whole_sheet import whole_sheet
from hybrid.pyramid import Pyramid
from hybrid.records import SliceGrid
from hybrid.rectify.edges.paths import look_across
from hybrid.rectify.margins.ground import (
    FalseMarginsConfig,
    ShorterSheet,
    ends_inside,
    ends_of_print,
    without_margins,
)
from hybrid.rectify.refine.refine import Refinement
from hybrid.stages import Clock

OPTIONS = FalseMarginsConfig()
ALIKE = {"left": 60, "right": 60}
"""By how many pixels a shadow may stick out that looks like margins."""
SHADOW = 60
"""The grey of the sheet's shadow, which is brighter than the sheet and darker than the ground."""


def before_its_shadow(right: int = 0, below: int = 0, left: int = 0, above: int = 0) -> tuple[np.ndarray, BackwardMap]:
    """A dark sheet from 100 to 600 along both axes before a shadow that sticks out by so many pixels, and the map of
    both together."""
    photo, _ = sheet_photo()
    low, high = np.array([100 - left, 100 - above]), np.array([600 + right, 600 + below])
    shadow = photo[low[1] : high[1], low[0] : high[0]]
    shadow[shadow > SHADOW] = SHADOW
    return photo, BackwardMap(low + (high - low) * film_nodes((9, 9)))


def print_in(film: BackwardMap, low=(110, 110), high=(590, 590)) -> SliceGrid:
    """The grid of a print between two photo points (x, y), through a map of an upright sheet."""
    photo_points = np.array(low) + (np.array(high) - low) * film_nodes((5, 4))
    first, last = film.nodes[0, 0], film.nodes[-1, -1]
    return SliceGrid(4, 3, (photo_points - first) / (last - first), photo_points, 0.9)


def shorter(photo: np.ndarray, film: BackwardMap, grid: SliceGrid, config=OPTIONS) -> ShorterSheet | None:
    return without_margins(Pyramid(photo), film, ends_of_print(grid, config), STEPS, CONFIG, config)


@pytest.mark.parametrize(
    ("out", "lost"),
    [
        ({"below": 70}, {"bottom"}),
        ({"right": 60, "below": 80}, {"right", "bottom"}),
        ({"left": 60, "right": 120, "above": 70}, {"left", "right", "top"}),
        (ALIKE, {"left", "right"}),
    ],
)
def test_the_sheet_is_found_that_ends_before_its_map(out, lost):
    photo, film = before_its_shadow(**out)
    found = shorter(photo, film, print_in(film))
    assert found is not None
    np.testing.assert_allclose(found.read.through.nodes[0, 0], 100, atol=4)
    np.testing.assert_allclose(found.read.through.nodes[-1, -1], 600, atol=4)
    assert {side.name for side in found.lost} == lost
    for side, length in found.lost.items():
        pixels = out[{"bottom": "below", "top": "above"}.get(side.name, side.name)]
        assert length == pytest.approx(pixels / np.ptp(film.nodes[..., side.axis]), abs=0.01)
        assert side.name in str(found)
    assert (found.unlike > OPTIONS.unlike) is (out != ALIKE)


def test_a_sheet_with_more_room_on_one_side_keeps_its_margin():
    """As below a header: nothing within the sheet looks like its edge."""
    photo, film = sheet_photo()
    assert shorter(photo, film, print_in(film, low=(110, 180))) is None


def test_margins_narrower_than_the_least_are_kept():
    photo, film = before_its_shadow(below=70)
    assert shorter(photo, film, print_in(film), replace(OPTIONS, least=0.2)) is None


def test_edges_inside_are_noticed_where_the_sheet_ends_before_its_map():
    for out, where in (({"below": 70}, {"bottom"}), ({"left": 60, "right": 120}, {"left", "right"}), ({}, set())):
        photo, film = before_its_shadow(**out)
        inside = ends_inside(Pyramid(photo), film, STEPS, CONFIG, OPTIONS)
        assert {side.name for side in inside} == where
        for side, length in inside.items():
            pixels = out[{"bottom": "below"}.get(side.name, side.name)]
            assert -length == pytest.approx(pixels / np.ptp(film.nodes[..., side.axis]), abs=0.01)


# ---------------------------------------------------------------- which of them are believed


SURE = replace(OPTIONS, sure=0.8)


def sheet_of(
    monkeypatch, out=None, printed=((110, 110), (590, 590)), config=SURE, gained=0.0, seen=True
) -> tuple[bool, bool, str]:
    """Whether the sheet before a shadow counts, whether the stage ran, and what it reports.

    Refinement leaves maps as they are, and finds a print between two photo points, whose grid is more probable than the
    one before by ``gained``. seen: whether the longer map ends where the shadow does."""
    photo, film = before_its_shadow(**(out or {"below": 70}))
    if not seen:
        film = BackwardMap(film.photo_from_film(np.array([0.0, -0.06]) + np.array([1.0, 1.12]) * film_nodes((9, 9))))
    across = look_across(Pyramid(photo), film, STEPS, CONFIG)
    grid = replace(print_in(film), confidence=0.4)
    before = Refinement(film, grid, (), expected_px=0.5, stands=True, across=across)

    def exact(job, start, clock):
        assert start.edges.through is start.film
        assert np.ptp(start.film.nodes[..., 1]) < 510
        grid = replace(print_in(start.film, *printed), confidence=0.4 + gained) if printed else None
        return Refinement(start.film, grid, (), expected_px=0.5, stands=True)

    monkeypatch.setattr(hybrid.pipeline.whole_sheet, "exact", exact)
    options = replace(RectifyConfig(), false_margins=config, margins=replace(RectifyConfig().margins, beyond=()))
    clock = Clock()
    after = whole_sheet(job_of(photo, options), None, before, lambda _: 0.0, clock).refinement
    (report,) = clock.reports
    return after.backward is not film, report.ran, report.reason


def test_a_shorter_sheet_counts_where_its_edges_are_sure_and_its_print_in_the_middle(monkeypatch):
    counts, ran, reason = sheet_of(monkeypatch)
    assert counts
    assert ran
    assert "ends before its map: 12% at the bottom" in reason


@pytest.mark.parametrize("printed", [((110, 110), (590, 570)), None])
def test_it_does_not_where_its_print_is_not_in_the_middle_or_gone(monkeypatch, printed):
    assert sheet_of(monkeypatch, printed=printed)[:2] == (False, False)


def test_nor_where_its_edges_are_not_sure(monkeypatch):
    assert sheet_of(monkeypatch, config=replace(OPTIONS, sure=1.0))[:2] == (False, False)


@pytest.mark.parametrize(
    ("gained", "seen", "counts"),
    [
        (0.0, True, False),
        (0.9 * OPTIONS.grid_gained, True, False),
        (1.1 * OPTIONS.grid_gained, True, True),
        (0.0, False, True),
    ],
)
def test_margins_alike_are_ground_only_if_the_grid_or_the_edges_say_so(monkeypatch, gained, seen, counts):
    assert sheet_of(monkeypatch, ALIKE, gained=gained, seen=seen)[0] is counts


def cut_without_a_margin(monkeypatch, written: int, width: int = 480, config=SURE) -> Refinement | None:
    """The shorter sheet, if it counts, of a grid that fills the map of sheet and shadow together. written: grey levels
    of what stands in the shadow, on so many pixels of its width of 500."""
    photo, film = before_its_shadow(below=70)
    low, high = film.nodes[0, 0], film.nodes[-1, -1]
    rng = np.random.default_rng(0)
    photo[150:550, 150:550] += rng.integers(0, 20, (400, 400, 1), np.uint8)
    photo[610:660, 110 : 110 + width] += rng.integers(0, written + 1, (50, width, 1), np.uint8)
    before = Refinement(film, replace(print_in(film, low, high), confidence=0.9), (), expected_px=0.5, stands=True)

    def exact(job, start, clock):
        return Refinement(start.film, print_in(start.film), (), expected_px=0.5, stands=True)

    monkeypatch.setattr(hybrid.pipeline.whole_sheet, "exact", exact)
    options = replace(RectifyConfig(), false_margins=config, margins=replace(RectifyConfig().margins, beyond=()))
    after = whole_sheet(job_of(photo, options), None, before, lambda _: 0.0, Clock()).refinement
    return None if after is before else after


@pytest.mark.parametrize(("written", "counts"), [(0, True), (20, False)])
def test_what_no_margin_of_the_grid_tells_of_is_cut_off_only_if_it_is_blank(monkeypatch, written, counts):
    """Through a map that is wrong, a grid may be seen that fills it. But a row of cells may end like a sheet."""
    after = cut_without_a_margin(monkeypatch, written)
    assert (after is not None) is counts
    if after is not None:
        np.testing.assert_allclose(after.backward.nodes[-1, -1], 600, atol=4)


@pytest.mark.parametrize(("blank", "counts"), [(OPTIONS.blank_certain, False), (OPTIONS.blank, True)])
def test_a_row_of_cells_that_are_mostly_empty_stays_where_it_ends_in_a_certain_edge(monkeypatch, blank, counts):
    after = cut_without_a_margin(monkeypatch, 20, 60, replace(SURE, blank_certain=blank))
    assert (after is not None) is counts


def test_where_no_grid_is_seen_nothing_is_cut_off():
    photo, film = before_its_shadow(below=70)
    before = Refinement(film, None, (), expected_px=0.5, stands=True)
    after = whole_sheet(job_of(photo), None, before, lambda _: 0.0, Clock()).refinement
    assert after is before


@pytest.mark.parametrize(("out", "confidence", "looks"), [(ALIKE, 0.6, 0), (ALIKE, 0.4, 1), ({"below": 70}, 0.6, 1)])
def test_nothing_is_read_where_nothing_could_tell_what_is_cut_off_from_a_margin(monkeypatch, out, confidence, looks):
    photo, film = before_its_shadow(**out)
    before = Refinement(film, replace(print_in(film), confidence=confidence), (), expected_px=0.5, stands=True)
    asked: list[BackwardMap] = []
    monkeypatch.setattr(
        hybrid.pipeline.whole_sheet, "without_margins", lambda pyramid, film, *others: asked.append(film)
    )
    whole_sheet(job_of(photo), None, before, lambda _: 0.0, Clock())
    assert len(asked) == looks
