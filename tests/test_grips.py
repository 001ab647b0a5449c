"""The part of a film that hands and clips hold can be tilted, however coarse the lattice is."""

import numpy as np
import pytest

from data_gen.ct.phantom import head_phantom
from data_gen.prints.prints import PrintConfig, make_print
from data_gen.sample import SIMULATION_VERTICES, sheet_of
from hybrid.mesh.film import film_mesh
from hybrid.mesh.grips import edge_part, film_points, flat_points, near_point, rigid
from hybrid.mesh.material import FilmMaterial
from hybrid.mesh.network import MassSpring, mass_spring

SIZE_MM = (430.0, 350.0)


@pytest.fixture(params=[0, 2], ids=["coarse", "fine"])
def network(request) -> MassSpring:
    lines = np.linspace(0, 1, 5)
    return mass_spring(film_mesh(SIZE_MM, lines, lines, request.param), FilmMaterial())


def spread(points: np.ndarray) -> float:
    """How far points lie from their best-fitting line: the smaller of their two spreads."""
    return float(np.linalg.svd(points[:, :2] - points[:, :2].mean(axis=0))[1][1])


@pytest.mark.parametrize("side", range(4))
@pytest.mark.parametrize(("low", "high", "depth_mm"), [(0.0, 1.0, 0.0), (0.45, 0.55, 15.0), (0.1, 0.11, 0.0)])
def test_a_part_of_an_edge_is_two_lines_deep_at_least(network, side, low, high, depth_mm):
    chosen = edge_part(network, side, low, high, depth_mm)
    axis = 0 if side < 2 else 1
    inwards = np.unique(film_points(network)[chosen, axis])
    assert len(inwards) >= 2
    assert (0.0 if side % 2 == 0 else 1.0) in inwards


@pytest.mark.parametrize("uv", [(0.0, 0.0), (1.0, 0.0), (0.5, 1.0), (0.31, 0.62)])
@pytest.mark.parametrize("radius_mm", [1.0, 60.0])
def test_a_grip_can_be_tilted_about_any_axis(network, uv, radius_mm):
    chosen = near_point(network, np.array(uv), radius_mm)
    points = flat_points(network)[chosen]
    assert spread(points) > 10.0
    for axis in (0, 1):
        moved = rigid(network, chosen, 0.3 * np.eye(3)[axis], np.zeros(3)).at(1.0)[chosen]
        assert np.abs(moved - points)[:, 2].max() > 2.0


def test_a_tilted_edge_leaves_its_plane(network):
    chosen = edge_part(network, 0)
    moved = rigid(network, chosen, 0.3 * np.eye(3)[1], np.zeros(3)).at(1.0)[chosen]
    assert np.abs(moved[:, 2]).max() > 2.0


def test_sheets_are_as_fine_as_the_simulation_affords():
    volume = head_phantom(np.random.default_rng(0), size=64, slices=16)
    for seed in range(40):
        film = sheet_of(make_print(volume, np.random.default_rng(seed), PrintConfig(longer_px=400, longer_spread=0.0)))
        assert max(film.shape) - 1 > SIMULATION_VERTICES / 2  # else it could be subdivided once more
