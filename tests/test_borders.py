"""The borders between cells as BorderNet reads them: strips, training views, and the sightings made from them."""

from dataclasses import replace

import numpy as np
import pytest
from simple_samples import simple_dataset
from synthetic_film import FilmDrawing, make_photo
from test_foreshortening import edges_of, even_grid, told_of

from hybrid.backward import BackwardMap
from hybrid.borders import GROUP, INSIDE, REACH, border_strips, inner_lines, strip_across
from hybrid.coords import film_centres_1d, film_nodes
from hybrid.film_view import view_film
from hybrid.learn.datasets.borders import BorderAugment, border_view, open_borders
from hybrid.learn.networks.edgenet import strip_reader
from hybrid.learn.networks.inference import ready
from hybrid.learn.networks.weights import packaged_border_net
from hybrid.pyramid import Pyramid
from hybrid.records import SliceGrid
from hybrid.rectify.grid.borders import BorderConfig, borders_shown, held_to, places_along, read_borders
from hybrid.rectify.grid.cells import Reading
from hybrid.rectify.grid.layout import Layout, find_lines
from hybrid.rectify.grid.lines import Borders, Comb, GridConfig
from hybrid.rectify.grid.repeat import Repeats
from hybrid.rectify.refine import course
from hybrid.rectify.refine.config import RefineConfig
from hybrid.rectify.refine.refine import refine
from hybrid.rectify.splines.displacement import SplineConfig, fit_displacement
from hybrid.strips import StripConfig, StripReader

STRIP = StripConfig()
CONFIG, GRID, CONFIGURED = BorderConfig(), GridConfig(), RefineConfig()
COLUMNS = STRIP.columns // 2
PLACED = BorderAugment(
    found_share=0.0, plane_error=(1e-9, 1e-8), bend_error=(1e-9, 1e-8), place_error=0.0, far_share=0.0
)


def ruled_photo(columns: int = 4, rows: int = 5, size: int = 600) -> tuple[np.ndarray, BackwardMap]:
    """A dark film that fills the middle of the photo, with bright lines between its cells."""
    photo = np.full((size + 100, size + 100, 3), 20, np.uint8)
    for k in range(columns + 1):
        x = 50 + round(k * size / columns)
        photo[50:-50, x - 1 : x + 1] = 220
    for k in range(rows + 1):
        y = 50 + round(k * size / rows)
        photo[y - 1 : y + 1, 50:-50] = 220
    return photo, BackwardMap(50.0 + size * film_nodes((9, 9)))


def known(columns: int = 4, rows: int = 5, off: float = 0.0) -> Layout:
    """A layout that was read, with its grid offset from the film's."""
    along = [Repeats(axis, off, 1.0 / n, n) for axis, n in ((0, columns), (1, rows))]
    return Layout(repeats=(along[0], along[1]), read=Reading(along[0], along[1], 0.99))


def bright_reader(images: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Log-probabilities that grow with the brightness of rows."""
    grey = images.astype(float).mean(axis=3).reshape(*images.shape[:2], -1, 2).mean(axis=3)
    logits = np.concatenate([0.1 * grey, np.full((len(grey), 1, grey.shape[2]), 8.0)], axis=1)
    return logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))


BRIGHT = StripReader(STRIP, bright_reader)


# ---------------------------------------------------------------- strips


def test_edges_of_the_sheet_are_no_borders_and_ends_of_a_grid_within_it_are():
    lines, number = inner_lines(0.0, 0.25, 4)
    np.testing.assert_allclose(lines, [0.25, 0.5, 0.75])
    np.testing.assert_allclose(number, [-1, 0, 1])
    lines, number = inner_lines(0.1, 0.2, 4)
    np.testing.assert_allclose(lines, [0.1, 0.3, 0.5, 0.7, 0.9])
    np.testing.assert_allclose(number, [-2, -1, 0, 1, 2])
    assert len(inner_lines(INSIDE / 2, 0.3, 3)[0]) == 3


def test_strips_end_before_the_next_border():
    assert strip_across(0.5, STRIP).reach == STRIP.reach
    assert strip_across(0.1, STRIP).reach == pytest.approx(0.1 * REACH)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_border_lies_in_the_middle_of_its_strip_and_the_first_row_before_it(axis):
    photo, film = ruled_photo()
    pitch = 1 / (4, 5)[axis]
    lines, strip = pitch * np.arange(1, 1 / pitch) - 0.01, strip_across(pitch, STRIP)  # 0.01 before those of the film
    images, inside = border_strips(photo, film, axis, lines, strip)
    assert inside.all()
    brightest = images.mean(axis=(2, 3)).argmax(axis=1)
    np.testing.assert_allclose(brightest, strip.row_of(np.array([0.01]))[0], atol=1.5)


# ---------------------------------------------------------------- sightings


@pytest.mark.parametrize("off", [0.0, 0.012])
def test_borders_that_are_read_are_sighted_where_they_are(off):
    photo, film = ruled_photo()
    found = read_borders(photo, film, known(off=off), BRIGHT, GRID, CONFIG)
    assert [e.sightings.axis for e in found] == [0, 1]
    for e, n in zip(found, (4, 5), strict=True):
        s = e.sightings
        assert isinstance(e.source, Borders)
        true = np.round(n * s.seen[:, s.axis]) / n
        np.testing.assert_allclose(s.seen[:, s.axis], true, atol=0.0025)
        np.testing.assert_allclose(s.known, true, atol=1e-9)  # of a grid centred on the film
        assert len(s) > 0.9 * (n - 1) * COLUMNS


def shown(rows: int, columns: int, photo: np.ndarray, film: BackwardMap, margin: float = 0.0) -> float:
    """The probability that borders of an even grid on the film show."""
    vertices = margin + (1.0 - 2.0 * margin) * film_nodes((rows + 1, columns + 1))
    grid = SliceGrid(rows, columns, vertices, film.photo_from_film(vertices), 1.0)
    return borders_shown(Pyramid(photo), film, grid, BRIGHT, CONFIG)


def test_borders_show_where_the_grid_is_right_and_the_photo_is_not_blank():
    photo, film = ruled_photo()
    assert shown(5, 4, photo, film) > 0.95
    assert shown(5, 1, photo, film) > 0.95  # there are none along one axis
    assert shown(5, 4, np.full_like(photo, 20), film) < 0.1
    assert shown(5, 4, photo, film, margin=0.1) < 0.6  # what lies farther from a border than its strip reaches
    assert shown(1, 1, photo, film) == 0.0


def test_what_lies_beside_the_grid_is_shared_and_what_bends_is_displacement():
    photo, film = ruled_photo()
    bent = BackwardMap.from_function(
        lambda uv: film.photo_from_film(uv + 0.01 * np.sin(np.pi * uv[..., :1]) * np.sin(2 * np.pi * uv[..., 1:]))
    )
    found = read_borders(photo, bent, known(), BRIGHT, GRID, CONFIG)
    fit = fit_displacement([e.sightings for e in found], SplineConfig())
    points = film_nodes((7, 7))[1:-1, 1:-1]
    off = np.linalg.norm(fit.displacement.composed(bent).photo_from_film(points) - film.photo_from_film(points), axis=2)
    before = np.linalg.norm(bent.photo_from_film(points) - film.photo_from_film(points), axis=2)
    assert off.mean() < 0.3 * before.mean()


def test_nothing_is_read_of_an_axis_of_which_nothing_is_known():
    photo, film = ruled_photo()
    layout = known()
    assert not read_borders(photo, film, Layout(), BRIGHT, GRID, CONFIG)
    assert not read_borders(photo, film, replace(layout, read=None), BRIGHT, GRID, CONFIG)
    columns, rows = layout.repeats
    assert columns is not None
    one = replace(layout, repeats=(columns, None))
    assert [e.sightings.axis for e in read_borders(photo, film, one, BRIGHT, GRID, CONFIG)] == [0]
    other = replace(layout, repeats=(replace(columns, cells=3), rows))
    assert [e.sightings.axis for e in read_borders(photo, film, other, BRIGHT, GRID, CONFIG)] == [1]


@pytest.mark.parametrize(("columns", "rows"), [(4, 5), (2, 3)])
def test_places_of_borders_are_where_they_were_read(columns, rows):
    photo, film = ruled_photo(columns, rows)
    found = read_borders(photo, film, known(columns, rows, 0.012), BRIGHT, GRID, CONFIG)
    for read, n in zip(places_along(found), (columns, rows), strict=True):
        np.testing.assert_allclose(read, np.arange(1, n) / n, atol=0.0025)
    assert places_along(found[1:])[0] is None


def test_ends_of_the_print_are_no_borders_between_cells():
    photo, film = ruled_photo()
    short = Repeats(1, 0.2, 0.2, 3)
    inside = replace(known(), repeats=(known().repeats[0], short), read=Reading(known().read.columns, short, 0.99))
    _, rows = read_borders(photo, film, inside, BRIGHT, GRID, CONFIG)
    assert len(np.unique(rows.sightings.shared[:, 1])) == 4
    np.testing.assert_allclose(places_along([rows])[1], [0.4, 0.6], atol=0.0025)


@pytest.mark.parametrize("beside", [0.0, 0.01, 0.035, -0.035])
def test_lines_beside_borders_that_were_read_are_none_between_cells(beside):
    """Such lines are couches and texts, which each slice shows at the same place."""
    photo, film = ruled_photo()
    at = film_centres_1d(600)
    view = view_film(photo[..., 0], film, at, at)
    borders = [(np.arange(1, n) + beside) / n for n in (4, 5)]
    layout, lines = find_lines(view, known(), True, (borders[0], borders[1]), GRID)
    for comb, followed in zip(layout.combs, lines, strict=True):
        assert (comb is None) == (followed is None) == (abs(beside) > GRID.beside_read)
    unread, _ = find_lines(view, known(), True, (None, None), GRID)
    assert all(unread.combs)
    before = Borders(0, beside / 4, 0.25, 4)
    fitted, _ = find_lines(view, replace(known(), borders=(before, None)), True, (None, None), GRID)
    assert (fitted.combs[0] is None) == (layout.combs[0] is None)
    assert fitted.combs[1] is not None


def test_a_blank_film_shows_no_borders():
    photo, film = ruled_photo()
    assert not read_borders(np.full_like(photo, 60), film, known(), BRIGHT, GRID, CONFIG)


@pytest.mark.parametrize(("columns", "groups"), [(2, 1), (5, 1), (6, 2), (9, 2)])
def test_borders_are_read_at_once_in_groups_of_four(columns, groups):
    photo, film = ruled_photo(columns)
    sizes = []

    def counted(images: np.ndarray, inside: np.ndarray) -> np.ndarray:
        sizes.append(len(images))
        return bright_reader(images, inside)

    layout = known(columns)
    layout = replace(layout, repeats=(layout.repeats[0], None))
    (found,) = read_borders(photo, film, layout, StripReader(STRIP, counted), GRID, CONFIG)
    assert sizes == [GROUP * groups]
    assert len(np.unique(np.round(columns * found.sightings.seen[:, 0]))) == columns - 1


def test_borders_that_were_read_are_held_to_the_grid_as_it_is_known_now():
    photo, film = ruled_photo()
    (read, _) = read_borders(photo, film, known(), BRIGHT, GRID, CONFIG)
    wider = replace(known(), borders=(Borders(0, -0.02, 0.26, 4), None))
    held = held_to(wider, read, GRID)
    assert held.source is wider.borders[0]
    number = np.round(4 * read.sightings.seen[:, 0]) - 2
    np.testing.assert_allclose(held.sightings.known, 0.5 + 0.26 * number)
    np.testing.assert_array_equal(held.sightings.seen, read.sightings.seen)
    np.testing.assert_array_equal(held.sightings.shared_sigma[2:], read.sightings.shared_sigma[2:])
    same = held_to(known(), read, GRID)  # nothing was fitted to them yet
    assert same.source is read.source


def test_borders_end_with_the_film_only_if_that_was_tried():
    assert not Borders(0, 0.0, 0.25, 4).fills_film(GRID)
    assert Borders(0, 0.0, 0.25, 4, filling=True).fills_film(GRID)


def test_borders_are_not_read_where_lines_are_followed():
    photo, film = ruled_photo()
    comb = Comb(0, 0.0, 0.25, 4, np.arange(1, 4), 2, 1, 1.0, np.zeros((3, 4)))
    (found,) = read_borders(photo, film, replace(known(), combs=(comb, None)), BRIGHT, GRID, CONFIG)
    assert found.sightings.axis == 1


def test_borders_count_between_the_ends_of_the_grid_only():
    photo, film = ruled_photo()
    narrow = known()
    short = Repeats(1, 0.2, 0.2, 3)
    narrow = replace(narrow, repeats=(narrow.repeats[0], short), read=Reading(known().read.columns, short, 0.99))
    columns, _ = read_borders(photo, film, narrow, BRIGHT, GRID, CONFIG)
    along = columns.sightings.seen[:, 1]
    assert 0.2 < along.min() < 0.24
    assert 0.76 < along.max() < 0.8


def test_borders_are_read_from_the_start_and_from_the_first_sheet_only(monkeypatch):
    photo, true = make_photo(FilmDrawing(5, 4, rules=False), np.random.default_rng(3))
    phases = told_of(true, even_grid(5, 4), np.random.default_rng(0))
    read = []

    def counted(*args: object) -> list:
        read.append(args)
        return read_borders(*args)

    monkeypatch.setattr(course, "read_borders", counted)
    edges = edges_of(true, true)
    refined = refine(
        photo, true, replace(phases, borders=strip_reader(ready(packaged_border_net()))), CONFIGURED, edges
    )
    assert len(read) == 2
    assert refined.grid is not None
    read.clear()
    refine(photo, true, phases, CONFIGURED, edges)
    assert not read


# ---------------------------------------------------------------- what is learnt


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    return open_borders([simple_dataset(tmp_path_factory.mktemp("data"), count=6, shard_size=6)])


def test_true_rows_are_the_middle_where_map_and_grid_are_true(samples):
    assert len(samples) == 6
    for sample in samples:
        for seed in range(3):
            images, inside, rows = border_view(sample, STRIP, np.random.default_rng(seed), PLACED)
            assert images.shape == (GROUP, STRIP.rows, STRIP.columns, 3)
            assert inside.shape == images.shape[:3]
            shown = ~np.isnan(rows)
            assert shown.mean() > 0.3
            np.testing.assert_allclose(rows[shown], STRIP.rows / 2 - 0.5, atol=0.2)


def test_true_rows_follow_a_map_that_errs(samples):
    errs = replace(PLACED, plane_error=(0.004, 0.0041), colours=False)
    off = []
    for seed in range(8):
        _, _, rows = border_view(samples[seed % len(samples)], STRIP, np.random.default_rng(seed), errs)
        off.append(rows[~np.isnan(rows)] - (STRIP.rows / 2 - 0.5))
    spread = np.concatenate(off).std() * STRIP.pitch  # narrow strips have finer rows
    assert 0.001 < spread < 0.02


def test_true_rows_follow_a_grid_that_lies_far_beside(samples):
    placed = replace(PLACED, colours=False)
    far, found = replace(placed, far_share=1.0, far=0.3), []
    for seed in range(12):
        sample = samples[seed % len(samples)]
        one, other = (border_view(sample, STRIP, np.random.default_rng(seed), augment)[2] for augment in (placed, far))
        beside = (other - one)[~np.isnan(other - one)]
        if len(beside):
            assert np.ptp(beside) < 1.0  # the same for all borders
            found.append(np.abs(beside).max() / STRIP.rows)
    assert 0.1 < max(found) < 0.5


def test_views_are_of_their_random_numbers_alone(samples):
    first, second = (border_view(samples[1], STRIP, np.random.default_rng(5), BorderAugment()) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("rules", [True, False])
def test_the_packaged_network_reads_the_borders_of_a_drawn_film(rules):
    photo, film = make_photo(FilmDrawing(rules=rules), np.random.default_rng(4))
    reader = strip_reader(ready(packaged_border_net()))
    found = read_borders(photo, film, known(3, 4, off=0.006), reader, GRID, CONFIG)
    assert len(found) == 2
    for e, n in zip(found, (3, 4), strict=True):
        s = e.sightings
        off = s.seen[:, s.axis] - np.round(n * s.seen[:, s.axis]) / n
        assert np.median(np.abs(off - np.median(off))) < 0.0015
        if rules:  # texts alone do not tell the network where cells end in a print it has not learnt
            assert np.median(np.abs(off)) < 0.0015
