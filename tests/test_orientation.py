"""Orientation of a film in a photo: eight ways to lie, each found and undone."""

import numpy as np
import pytest

from hybrid.backward import BackwardMap, Orientation, orientation
from hybrid.coords import film_nodes
from hybrid.records import SliceGrid


def seen_map() -> BackwardMap:
    """A slightly bent, slightly rolled film that is upright in its photo."""
    uv = film_nodes((9, 9))
    x = 100 + 300 * uv[..., 0] + 40 * uv[..., 1] + 15 * np.sin(2 * uv[..., 1])
    y = 80 - 30 * uv[..., 0] + 400 * uv[..., 1] + 10 * uv[..., 0] ** 2
    return BackwardMap(np.stack([x, y], axis=-1))


@pytest.mark.parametrize("index", range(8))
def test_orientation_is_what_makes_the_seen_film_upright(index):
    way = Orientation.from_index(index)
    assert way.index == index
    true = seen_map().turned(way)
    assert orientation(true) == way
    back = true.turned(way.inverse)
    np.testing.assert_allclose(back.nodes, seen_map().nodes)


def test_there_are_eight_ways_and_no_others():
    for index in (-1, 8, 9):
        with pytest.raises(ValueError, match=rf"Index of an Orientation: got {index}; allowed: 0 to 7"):
            Orientation.from_index(index)
    for turns in (-1, 4, 5):
        with pytest.raises(ValueError, match=rf"Orientation\.turns: got {turns}; allowed: 0 to 3"):
            Orientation(turns, False)


@pytest.mark.parametrize("index", range(8))
def test_coordinates_agree_with_the_turned_map(index):
    way, seen = Orientation.from_index(index), seen_map()
    true = seen.turned(way)
    uv_seen = np.random.default_rng(index).random((50, 2))
    np.testing.assert_allclose(
        true.photo_from_film(way.film_from_seen(uv_seen)), seen.photo_from_film(uv_seen), atol=1e-9
    )
    np.testing.assert_allclose(way.seen_from_film(way.film_from_seen(uv_seen)), uv_seen, atol=1e-12)


@pytest.mark.parametrize("roll_deg", [-40, -20, 20, 40])
def test_orientation_is_the_nearest_quarter_turn(roll_deg):
    turn = np.deg2rad(roll_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    flat = BackwardMap(film_nodes((5, 5)) * [300, 400])
    for extra in range(4):
        quarter = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), extra)
        rolled = BackwardMap(flat.nodes @ (quarter @ rotation).T)
        assert orientation(rolled) == Orientation(-extra % 4, False)


@pytest.mark.parametrize("index", range(8))
def test_a_grid_turns_with_its_film(index):
    way, seen = Orientation.from_index(index), seen_map()
    vertices = film_nodes((4, 3))
    grid = SliceGrid(3, 2, vertices, seen.photo_from_film(vertices), 0.9).turned(way)
    film = seen.turned(way)
    np.testing.assert_allclose(film.photo_from_film(grid.vertices), grid.vertices_photo, atol=1e-9)
    assert (np.diff(grid.vertices[..., 0], axis=1) > 0).all()  # columns to the right, rows down, as ever
    assert (np.diff(grid.vertices[..., 1], axis=0) > 0).all()
