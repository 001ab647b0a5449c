"""The grid of slices: right where rules are printed or cells repeat, none where there is none."""

import numpy as np
import pytest
from synthetic_film import FilmDrawing, draw_print, make_photo

from hybrid.backward import BackwardMap, spline_weights
from hybrid.coords import film_centres_1d, film_nodes
from hybrid.film_view import FilmView, _lattice_xy, view_film
from hybrid.rectify.grid.cells import Reading
from hybrid.rectify.grid.follow import follow_comb
from hybrid.rectify.grid.layout import Layout, find_lines, find_repeating
from hybrid.rectify.grid.lines import Comb, GridConfig, find_comb
from hybrid.rectify.grid.match import MatchConfig, match_cells
from hybrid.rectify.grid.repeat import RepeatConfig, Repeats, cell_agreement, find_repeats

GRID, REPEAT = GridConfig(), RepeatConfig()


def flat_view(drawing: FilmDrawing, seed: int, size: tuple[int, int] = (600, 480)) -> FilmView:
    rng = np.random.default_rng(seed)
    import cv2

    image = cv2.resize(draw_print(drawing, rng), size[::-1], interpolation=cv2.INTER_AREA).astype(np.float32)
    image += rng.normal(0, 1.0, image.shape).astype(np.float32)
    inside = np.ones(size, dtype=bool)
    return FilmView(image[..., None], film_centres_1d(size[1]), film_centres_1d(size[0]), inside)


@pytest.mark.parametrize(("rows", "cols"), [(3, 3), (4, 3), (6, 5), (5, 8)])
@pytest.mark.parametrize("margin", [0.0, 0.03])
def test_printed_rules_are_counted_and_placed(rows, cols, margin):
    view = flat_view(FilmDrawing(rows, cols, texts=False, margin=margin), 1)
    for axis, cells in ((0, cols), (1, rows)):
        comb = find_comb(view.image[..., 0], axis, GRID)
        assert comb is not None
        assert comb.cells == cells
        assert np.abs(comb.lines() - np.linspace(margin, 1 - margin, cells + 1)).max() < 0.006


def test_followed_rules_are_straight_to_a_third_of_a_pixel():
    view = flat_view(FilmDrawing(4, 3, margin=0.03), 2)
    comb = find_comb(view.image[..., 0], 1, GRID)
    assert comb is not None
    sightings = follow_comb(view, comb, GRID)
    assert sightings is not None
    truth = np.linspace(0.03, 0.97, 5)
    error_px = np.abs(sightings.seen[:, 1, None] - truth).min(axis=1) * 600
    assert np.median(error_px) < 0.7  # the drawing's lines lie on whole pixels at twice the size
    assert np.std(sightings.offsets()) * 600 < 1.0


def test_frames_around_each_cell_are_lines_whose_first_and_last_lie_elsewhere():
    """If each cell has its own frame, a line between cells is two rules; the first and the last line are one."""
    image = np.full((600, 480), 40, np.float32)
    for i in range(4):
        for j in range(3):
            top, left = 30 + 135 * i, 24 + 144 * j
            image[top : top + 131, left : left + 140] = 20
            image[top : top + 131, [left, left + 139]] = image[[top, top + 130], left : left + 140] = 150
    image += np.random.default_rng(0).normal(0, 1.0, image.shape).astype(np.float32)
    view = FilmView(image[..., None], film_centres_1d(480), film_centres_1d(600), np.ones(image.shape, bool))
    for axis, px in ((0, 480), (1, 600)):
        comb = find_comb(image, axis, GRID)
        assert comb is not None
        sightings = follow_comb(view, comb, GRID)
        assert sightings is not None
        shared, offsets = sightings.shared, sightings.offsets()
        left_over = offsets - shared @ np.linalg.lstsq(shared, offsets, rcond=None)[0]
        evenly = offsets - shared[:, :2] @ np.linalg.lstsq(shared[:, :2], offsets, rcond=None)[0]
        assert np.abs(left_over).mean() * px < 0.5 < np.abs(evenly).mean() * px


@pytest.mark.parametrize("seed", range(4))
def test_slices_alone_make_no_lines(seed):
    view = flat_view(FilmDrawing(4, 3, rules=False, texts=False), seed)
    for axis in (0, 1):
        comb = find_comb(view.image[..., 0], axis, GRID)
        assert comb is None or follow_comb(view, comb, GRID) is None


def test_noise_has_no_grid():
    noise = np.random.default_rng(3).normal(60, 4, (500, 400)).astype(np.float32)
    for axis in (0, 1):
        assert find_comb(noise, axis, GRID) is None
    assert find_repeats(noise, REPEAT) == (None, None)


@pytest.mark.parametrize(("rows", "cols"), [(3, 3), (4, 3), (6, 5)])
def test_cells_that_repeat_are_counted(rows, cols):
    view = flat_view(FilmDrawing(rows, cols, rules=False), 4)
    columns, rows_found = find_repeats(view.image[..., 0], REPEAT)
    assert columns is not None
    assert rows_found is not None
    assert (rows_found.cells, columns.cells) == (rows, cols)


def test_matches_see_a_moved_cell_and_agreement_falls():
    view = flat_view(FilmDrawing(4, 3, rules=False), 5)
    columns, rows = find_repeats(view.image[..., 0], REPEAT)
    assert columns is not None
    assert rows is not None
    moved = view.image.copy()
    moved[150:300, 160:320] = np.roll(moved[150:300, 160:320], 3, axis=1)
    shifted = FilmView(moved, view.u, view.v, view.inside)
    assert cell_agreement(shifted, columns, rows) < cell_agreement(view, columns, rows)
    u = next(s for s in match_cells(shifted, columns, rows, MatchConfig()) if s.axis == 0)
    cell = (np.floor(u.known * 3) == 1) & (np.floor(u.places()[:, 1] * 4) == 1)
    offsets_px = u.offsets() * 480
    assert np.median(offsets_px[cell]) - np.median(offsets_px[~cell]) == pytest.approx(3.0, abs=0.5)


@pytest.mark.parametrize(
    ("first", "last", "fills"),
    [
        *[(0.0, 1.0, True), (-0.01, 1.01, True), (0.003, 0.997, True), (0.0, 1.01, True)],
        *[(0.02, 0.98, False), (0.003, 1.003, False), (-0.004, 0.997, False)],
    ],
)
def test_a_grid_fills_the_film_unless_its_ends_lie_inside_or_both_to_one_side(first: float, last: float, fills: bool):
    """Otherwise lines left of every cell, as frames have, would shift the whole film by as much."""
    comb = Comb(0, first, (last - first) / 4, 4, np.arange(5), 2, 1, 1.0, np.zeros((5, 1)))
    assert comb.fills_film(GRID) == fills


@pytest.mark.parametrize(("place", "between"), [(0.0, True), (0.92, False)])
def test_lines_count_where_the_cells_were_read_to_meet(place: float, between: bool):
    """Lines of tables under the slices are also straight and repeat as cells do."""
    view = flat_view(FilmDrawing(6, 3, rules=False), 7)
    image = view.image[..., 0].copy()
    for row in range(1 - round(place), 6):
        at = round(600 * (row + place) / 6)
        image[at - 1 : at + 1] = 170.0
    read = Reading(Repeats(0, 0.0, 1 / 3, 3), Repeats(1, 0.0, 1 / 6, 6), 0.99)
    seen = FilmView(image[..., None], view.u, view.v, view.inside)
    for known in (Layout(), Layout(read=read)):
        layout, lines = find_lines(seen, find_repeating(seen, known, REPEAT), True, (None, None), GRID)
        found = between or known.read is None
        assert (layout.combs[1] is not None, lines[1] is not None) == (found, found)


def test_a_view_shows_what_the_map_says():
    photo, true = make_photo(FilmDrawing(), np.random.default_rng(6), size=320)
    u, v = np.linspace(-0.1, 1.1, 13), np.linspace(-0.1, 1.1, 11)
    uu, vv = np.meshgrid(u, v)
    expected = true.photo_from_film(np.stack([uu, vv], axis=-1))
    on_one = (np.abs(uu - 0.5) <= 0.5) | (np.abs(vv - 0.5) <= 0.5)  # beyond corners BackwardMap uses another order
    assert np.abs(np.stack(_lattice_xy(true.nodes, u, v), axis=-1) - expected)[on_one].max() < 0.05  # float32
    assert np.abs(spline_weights(9, u).sum(axis=1) - 1.0).max() < 1e-9
    assert view_film(photo, true, u, v).image.shape == (11, 13, 3)


def test_a_view_shows_all_of_the_photos_outermost_pixels_and_black_beyond():
    photo = np.full((40, 60, 3), 200, np.uint8)
    at = (np.arange(-2.0, 64.0, 0.25) + 0.01) / 60  # of a film that is 60 pixels long and fills the photo
    view = view_film(photo, BackwardMap(film_nodes((9, 9)) * [60.0, 60.0]), at, at)
    within = (at > 0) & (at < 1), (at > 0) & (at < 40 / 60)
    assert (view.inside == within[1][:, None] & within[0]).all()
    assert (view.image[view.inside] == 200).all()
    assert (view.image[~view.inside] == 0).all()
