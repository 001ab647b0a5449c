"""The order of a film's slices: which way the film reads."""

import numpy as np
import pytest

from data_gen.ct.phantom import head_phantom
from data_gen.prints.prints import PrintConfig, make_print
from hybrid.coords import film_nodes
from hybrid.learn.networks.uprightnet import WAYS
from hybrid.learn.reading.slice_order import LEAST_CELLS, UNORDERED, order_chances, order_signs

ROWS, COLS = 5, 4
PX = 16


def series(count: int, shape: tuple[int, int] = (ROWS, COLS)) -> np.ndarray:
    """Cells with a disc that grows from one to the next, as a head does; those beyond ``count`` are empty."""
    radius = np.linalg.norm(film_nodes((PX, PX)) - 0.5, axis=-1)
    sizes = np.linspace(0.1, 0.45, count)
    cells = [np.where(radius < size, 200, 20) for size in sizes] + [np.full((PX, PX), 20)] * (
        shape[0] * shape[1] - count
    )
    return np.array(cells, np.uint8).reshape(*shape, PX, PX)


def signs_of(cells: np.ndarray) -> np.ndarray:
    return order_signs(np.ascontiguousarray(cells).reshape(-1, PX, PX), (cells.shape[0], cells.shape[1]))


@pytest.mark.parametrize("way", WAYS, ids=str)
def test_slices_follow_each_other_in_the_way_that_reads_right(way):
    """Half a turn keeps the order; the other six ways do not."""
    likeness = signs_of(way.inverse.moved(series(ROWS * COLS)))[:, 0]
    halves = [w.index for w in WAYS if abs(likeness[w.index] - likeness[way.index]) < 1e-9]
    assert way.index in halves
    assert len(halves) == 2
    assert likeness.max() == pytest.approx(likeness[way.index])


@pytest.mark.parametrize("way", WAYS, ids=str)
def test_empty_cells_come_last(way):
    last = signs_of(way.inverse.moved(series(ROWS * COLS - 3)))[:, 1]
    assert np.flatnonzero(last).tolist() == [way.index]


def test_too_few_slices_or_mostly_empty_cells_tell_nothing():
    assert not signs_of(series(LEAST_CELLS - 1)).any()
    assert signs_of(series(LEAST_CELLS)).any()
    assert not signs_of(series(LEAST_CELLS))[:, 1].any()  # more are empty than not: who knows why
    assert not signs_of(series(1, (1, 1))).any()


def test_a_grid_of_very_many_cells_tells_a_finite_chance():
    side = 30
    film = np.tile(np.arange(side * PX, dtype=np.float64), (side * PX, 1)) % PX * np.linspace(1, 15, side * PX)[:, None]
    chances = order_chances(film.astype(np.uint8), film_nodes((side + 1, side + 1)))
    assert np.isfinite(chances).all()
    assert chances.sum() == pytest.approx(1)
    assert chances.min() < 1.01 * UNORDERED / 8  # with so many cells, most ways are out of the question


def test_one_row_reads_alike_from_either_end_and_mirrored_upside_down():
    likeness = signs_of(series(6, (1, 6)))[:, 0]
    np.testing.assert_allclose(likeness, likeness[0])


def test_a_print_and_what_is_no_series():
    """No way is ever excluded; a print's own way is told from its mirror image; shuffled cells tell less."""
    config = PrintConfig(longer_px=1000, scout_share=0.0, header_share=0.0, empty_share=0.0)
    printed = make_print(head_phantom(np.random.default_rng(3)), np.random.default_rng(2), config)
    grey = np.rint(255 * printed.image).astype(np.uint8)
    for way in WAYS:
        vertices = way.inverse.moved(way.inverse.film_from_seen(printed.vertices))
        chances = order_chances(way.inverse.moved(grey), vertices)
        assert chances.sum() == pytest.approx(1)
        assert chances.min() >= UNORDERED / 8
        assert chances[way.index] == pytest.approx(chances.max())
        assert chances[way.index] > 5 * chances[(way.index + 4) % 8]
    rng = np.random.default_rng(0)
    spreads = []
    for _ in range(20):
        mixed = rng.permutation(series(ROWS * COLS).reshape(-1, PX, PX)).reshape(ROWS, COLS, PX, PX)
        spreads.append(np.ptp(signs_of(mixed)[:, 0]))
    assert np.mean(spreads) < 0.6 * np.ptp(signs_of(series(ROWS * COLS))[:, 0])
