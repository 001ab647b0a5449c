"""The sheet's edges as EdgeNet reads them: strips, paths through its readings, and maps put onto the edges."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import torch
from synthetic_film import FilmDrawing, make_photo

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.effort import RectifyConfig
from hybrid.learn.datasets.edges import true_rows
from hybrid.learn.networks.edgenet import EdgeNet, EdgeNetConfig, EdgeTargets, edge_losses, strip_reader
from hybrid.learn.networks.inference import ready
from hybrid.learn.networks.weights import packaged_edge_net, parameter_count
from hybrid.pipeline import geometry
from hybrid.pipeline.geometry import reread
from hybrid.pipeline.job import Job, Readers
from hybrid.pyramid import Pyramid
from hybrid.rectify.edges.paths import EdgeConfig, look_across, put_on_edges, read_edges, read_paths
from hybrid.rectify.refine.refine import Refinement
from hybrid.rectify.verdict.trust import TrustConfig
from hybrid.stages import Report
from hybrid.strips import StripConfig, StripReader, edge_strips, strip_copy

STRIP = StripConfig()
CONFIG = EdgeConfig()
COLUMNS = STRIP.columns // 2


def moved_edges(film: BackwardMap, outwards: float) -> BackwardMap:
    """The map of a film with its edges moved outwards from the true ones by a fraction of the film."""
    return BackwardMap(film.photo_from_film((film_nodes((17, 17)) - 0.5) * (1 + 2 * outwards) + 0.5))


def sheet_photo(size: int = 700, black: int = 20, ground: int = 170) -> tuple[np.ndarray, BackwardMap]:
    """A dark sheet without print, upright in the middle of a bright ground."""
    photo = np.full((size, size, 3), ground, np.uint8)
    photo[100:-100, 100:-100] = black
    return photo, BackwardMap(100.0 + (size - 200) * film_nodes((9, 9)))


def step_reader(images: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Log-probabilities from how steeply grey falls from bright to dark, for the sheet above."""
    grey = images.astype(float).mean(axis=3).reshape(*images.shape[:2], -1, 2).mean(axis=3)
    fall = np.zeros_like(grey)
    fall[:, 1:-1] = grey[:, :-2] - grey[:, 2:]
    logits = np.concatenate([0.2 * fall, np.full((len(grey), 1, grey.shape[2]), 4.0)], axis=1)
    return logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))


STEPS = StripReader(STRIP, step_reader)


def job_of(photo: np.ndarray, config: RectifyConfig | None = None) -> Job:
    """A photo to rectify, whose edges ``STEPS`` reads."""
    return Job(Pyramid(photo), replace(packaged_readers(), edges=STEPS), config or RectifyConfig())


@cache
def packaged_readers() -> Readers:
    return Readers.packaged()


def support_of(pyramid: Pyramid, film: BackwardMap, reader: StripReader = STEPS) -> np.ndarray:
    """How probable the edges of a map are."""
    return look_across(pyramid, film, reader, CONFIG).support


@pytest.fixture(scope="module")
def reader() -> StripReader:
    return strip_reader(ready(packaged_edge_net()))


# ---------------------------------------------------------------- strips


def test_rows_are_depths_and_back():
    rows = np.array([0.0, 12.25, 95.0])
    np.testing.assert_allclose(STRIP.row_of(STRIP.depth_of(rows)), rows, atol=1e-9)
    np.testing.assert_allclose(STRIP.depth_of(np.array([47.5])), 0.0, atol=1e-12)


def test_strips_are_outside_first_and_the_predicted_edge_is_their_middle():
    photo, film = sheet_photo()
    images, inside = edge_strips(photo, film, STRIP)
    assert inside.all()
    assert (images[:, : STRIP.rows // 2 - 1] > 150).all()
    assert (images[:, STRIP.rows // 2 + 1 :, 2:-2] < 40).all()


def test_what_the_photo_does_not_cover_is_said():
    photo, film = sheet_photo()
    cut = np.ascontiguousarray(photo[:, 90:])
    _, inside = edge_strips(cut, film.cropped((90.0, 0.0)), STRIP)
    assert not inside[2, : STRIP.rows // 2 - 12].any()
    assert inside[2, STRIP.rows // 2 :].all()


def test_large_photos_are_read_on_a_smaller_copy():
    photo, film = sheet_photo(2600)
    copy, on_copy = strip_copy(Pyramid(photo), film, STRIP)
    np.testing.assert_allclose(on_copy.nodes * 4, film.nodes)
    assert copy.shape[0] == photo.shape[0] // 4


def test_true_rows_are_where_the_edge_is_and_nan_where_it_is_not_shown():
    _, film = sheet_photo()
    mask = np.ones((80, 80), bool)
    rows = true_rows(film, moved_edges(film, 0.02), (700, 700), mask, STRIP)
    np.testing.assert_allclose(rows[:, 2:-2], STRIP.row_of(np.array([0.02 / 1.04]))[0], atol=0.02)
    assert np.isnan(true_rows(film, moved_edges(film, 0.2), (700, 700), mask, STRIP)).all()
    cut = true_rows(film.cropped((101.0, 0.0)), film.cropped((101.0, 0.0)), (700, 599), mask, STRIP)
    assert np.isnan(cut[2]).all()
    assert not np.isnan(cut[3]).any()


def test_an_edge_behind_a_hand_is_not_shown():
    _, film = sheet_photo()
    mask = np.ones((70, 70), bool)
    mask[:, 35:] = False
    rows = true_rows(film, film, (700, 700), mask, STRIP)
    assert np.isnan(rows[3]).all()
    assert not np.isnan(rows[2]).any()
    shown = ~np.isnan(rows[:2])
    assert shown[:, : COLUMNS // 2 - 2].all()
    assert not shown[:, COLUMNS // 2 + 2 :].any()


def test_corners_that_show_no_edge_do_not_count_against_a_side():
    photo, film = sheet_photo()

    def rounded(images, inside, columns):
        logs = step_reader(images, inside)
        for k in [*range(columns), *range(-columns, 0)]:
            logs[:, :-1, k], logs[:, -1, k] = -20.0, 0.0
        return logs

    pyramid, ends = Pyramid(photo), int(0.04 * COLUMNS)
    support = support_of(pyramid, film)
    assert support.min() > 0.9
    for columns, share in ((ends, 1.0), (COLUMNS // 4, 0.6)):
        reader = StripReader(STRIP, partial(rounded, columns=columns))
        np.testing.assert_allclose(support_of(pyramid, film, reader), share * support, atol=0.08 * (share < 1))


# ---------------------------------------------------------------- paths


def test_a_path_bridges_columns_that_say_something_else():
    logs = np.full((4, STRIP.rows + 1, COLUMNS), np.log(1e-3))
    logs[:, 40] = np.log(0.8)
    logs[:, 40, 10:13], logs[:, 80, 10:13] = np.log(1e-3), np.log(0.8)
    paths = read_paths(logs, CONFIG.paths)
    np.testing.assert_allclose(paths.row, 40, atol=0.5)
    assert (paths.mass[:, :9] > 0.7).all()
    assert (paths.mass[:, 10:13] < 0.1).all()


@pytest.mark.parametrize("outwards", [-0.03, 0.004, 0.05])
def test_a_map_is_put_onto_the_edges_that_are_read(outwards):
    photo, film = sheet_photo()
    start = moved_edges(film, outwards)
    read = read_edges(Pyramid(photo), start, STEPS, CONFIG)
    assert len(read.sightings) == 4
    assert abs(read.off - abs(outwards) / (1 + 2 * outwards)) < 0.002
    off = np.linalg.norm(put_on_edges(start, read, CONFIG).photo_from_film(film_nodes((9, 9))) - film.nodes, axis=2)
    assert off.max() < 1.5


def test_what_was_read_through_one_map_holds_for_another():
    photo, film = sheet_photo()
    read = read_edges(Pyramid(photo), moved_edges(film, 0.012), STEPS, CONFIG)
    other = put_on_edges(moved_edges(film, -0.015), read, CONFIG)
    off = np.linalg.norm(other.photo_from_film(film_nodes((9, 9))) - film.nodes, axis=2)
    assert off.max() < 1.5


def test_a_map_stays_where_no_edge_is_read():
    photo, film = sheet_photo(black=90, ground=90)
    read = read_edges(Pyramid(photo), film, STEPS, CONFIG)
    assert (read.sightings, read.off) == ((), 0.0)
    assert put_on_edges(film, read, CONFIG) is film


def test_support_tells_edges_that_are_right_from_others():
    photo, film = sheet_photo()
    pyramid = Pyramid(photo)
    assert (support_of(pyramid, film) > 0.8).all()
    assert (support_of(pyramid, moved_edges(film, 0.02)) < 0.1).all()


def test_edges_far_beside_are_read_once_more_from_where_they_were_found():
    photo, film = sheet_photo()
    for outwards, again in ((0.03, True), (0.005, False)):
        start = moved_edges(film, outwards)
        read = read_edges(Pyramid(photo), start, STEPS, CONFIG)
        assert (read.off > CONFIG.far) is again  # how far off the edges were at first
        assert (read.through is not start) is again
        moved = put_on_edges(read.through, read, CONFIG)
        off = np.linalg.norm(moved.photo_from_film(film_nodes((9, 9))) - film.nodes, axis=2)
        assert off.max() < 1.5


def test_a_refinement_with_a_wrong_edge_starts_once_more_from_where_edges_are_read():
    photo, film = sheet_photo()
    reports = []
    for outwards in (-0.02, 0.0):
        first = Refinement(moved_edges(film, outwards), None, (), expected_px=1.0)
        report = Report()
        found = reread(job_of(photo), None, first, report)
        off = np.linalg.norm(found.backward.photo_from_film(film_nodes((9, 9))) - film.nodes, axis=2)
        assert off.max() < 1.5
        assert found.across is not None
        assert (found.across.support > 0.8).all()
        reports.append(report)
    assert [report.ran for report in reports] == [True, False]


def test_an_edge_that_the_photo_does_not_show_is_no_doubt():
    """The sheet leaves the photo on one side: nothing is read of that edge, so nothing speaks against it."""
    photo, film = sheet_photo()
    cut = round(float(film.nodes[:, -1, 0].min())) - 40
    support = support_of(Pyramid(photo[:, :cut].copy()), film)
    assert (support > 0.8).all()


def test_a_second_refinement_counts_only_if_its_edges_are_surer():
    """Two more refinements are tried and edges are surer in neither: the first refinement stays."""
    photo, film = sheet_photo()
    first = Refinement(moved_edges(film, -0.02), None, (), expected_px=1.0)
    never = replace(RectifyConfig().edges, surer=1.0)
    found = reread(job_of(photo, replace(RectifyConfig(), edges=never)), None, first, Report())
    np.testing.assert_array_equal(found.backward.nodes, first.backward.nodes)
    assert found.expected_px == 1.0


@pytest.mark.parametrize(("sure", "counts"), [(0.95, True), (1.0, False)])
def test_print_that_moves_edges_is_left_free_where_that_makes_them_sure(monkeypatch, sure, counts):
    photo, film = sheet_photo()
    tried = []

    def exactly(job, _phases, _read, _start):
        tried.append(job.config.refine)
        outwards = 0.0 if job.config.refine.grid.snug == 0.0 else -0.02
        return Refinement(moved_edges(film, outwards), None, (), expected_px=2.0, stands=True)

    monkeypatch.setattr(geometry, "refine_once", exactly)
    config = RectifyConfig(edges=replace(CONFIG, sure=sure))
    first = Refinement(moved_edges(film, -0.02), None, (), expected_px=1.0)
    found = reread(job_of(photo, config), None, first, Report())
    assert tried == [config.refine.edges_held, config.refine.edges_held.print_free]
    assert (found.expected_px == 2.0) is counts
    assert bool(support_of(Pyramid(photo), found.backward).min() > 0.9) is counts


# ---------------------------------------------------------------- the network


def test_the_loss_prefers_the_true_row_and_knows_of_edges_that_are_not_shown():
    rows, columns = 96, 32
    truth = EdgeTargets(torch.full((1, columns), 30.0))
    none = EdgeTargets(torch.full((1, columns), torch.nan))
    at, beside, unseen = (torch.zeros(1, rows + 1, columns) for _ in range(3))
    at[:, 30], beside[:, 40], unseen[:, -1] = 9.0, 9.0, 9.0
    assert edge_losses(at, truth)["row"] < edge_losses(beside, truth)["row"] - 5
    assert edge_losses(unseen, none)["row"] < 0.1 < edge_losses(at, none)["row"]


def test_the_network_gives_every_row_and_half_of_the_columns():
    network = EdgeNet(EdgeNetConfig()).eval()
    logits = network(torch.rand(8, 4, STRIP.rows, STRIP.columns))
    assert logits.shape == (8, STRIP.rows + 1, COLUMNS)
    assert parameter_count(network) < 500_000


@torch.inference_mode()
def test_the_strips_of_a_film_are_read_together_and_films_apart():
    network, strips = ready(packaged_edge_net()), torch.rand(8, 4, STRIP.rows, STRIP.columns)
    before = network(strips)
    strips[5] = torch.rand(strips[5].shape)  # one side of the second film
    moved = (network(strips) - before).abs().amax(dim=(1, 2))
    assert (moved[:4] < 1e-4).all()
    assert (moved[4:] > 1e-3).all()


@pytest.mark.parametrize("ground", [None, 60, 200])
def test_the_packaged_network_reads_a_drawn_film(reader, ground):
    photo, film = make_photo(FilmDrawing(rules=False), np.random.default_rng(4), ground)
    read = read_edges(Pyramid(photo), start := moved_edges(film, 0.02), reader, CONFIG)
    assert len(read.sightings) == 4
    points = film_nodes((17, 17))
    off = np.linalg.norm(
        put_on_edges(start, read, CONFIG).photo_from_film(points) - film.photo_from_film(points), axis=2
    )
    assert off.mean() < 0.005 * max(film.mean_film_pixels())


def test_blank_photos_neither_support_a_map_nor_move_it(reader):
    _, film = sheet_photo()
    for grey in (0, 255):
        read = read_edges(Pyramid(np.full((700, 700, 3), grey, np.uint8)), film, reader, CONFIG)
        assert read.support.max() < TrustConfig().min_support
        moved = put_on_edges(film, read, CONFIG)
        assert np.abs(moved.lattice((9, 9)) - film.nodes).max() < 0.004 * max(film.mean_film_pixels())
