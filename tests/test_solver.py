"""The mass-spring solver against what mechanics says."""

import numpy as np
import pytest

from hybrid.errors import SimulationError
from hybrid.mesh.film import film_mesh
from hybrid.mesh.forces import PointField, gravity, point_field, smooth_noise, wind
from hybrid.mesh.recipes import RECIPES, BendConfig, bend, max_normal_angle
from hybrid.mesh.solver import (
    GRAVITY_MM_S2,
    FilmMaterial,
    Frame,
    Loads,
    StepConfig,
    at_rest,
    mass_spring,
    step,
)

DOWN = np.array([0.0, 0.0, 1.0])


def sheet(height=430.0, width=350.0, rows=4, cols=3, levels=2):
    return film_mesh((height, width), np.linspace(0, 1, cols + 1), np.linspace(0, 1, rows + 1), levels)


def free(network) -> Loads:
    flat = network.film.vertices.reshape(-1, 3)
    return Loads(np.zeros_like(flat), flat, np.zeros(len(flat)))


def test_mass_and_bending_stiffness_are_the_films():
    network = mass_spring(sheet(), FilmMaterial())
    assert network.mass_kg.sum() == pytest.approx(430 * 350 * 0.175 * 1390e-9)
    assert FilmMaterial().bending_stiffness == pytest.approx(1.96, rel=2e-3)  # N mm, as 1.96e-3 N m


def test_nothing_moves_without_loads():
    network = mass_spring(sheet(), FilmMaterial())
    after = step(network, at_rest(network.film), free(network), StepConfig())
    np.testing.assert_allclose(after.mesh.vertices, network.film.vertices, atol=1e-9)


def test_free_fall_is_backward_eulers():
    network = mass_spring(sheet(), FilmMaterial())
    loads = free(network)
    loads = Loads(gravity(network, DOWN), loads.goal_mm, loads.goal_stiffness)
    config = StepConfig(dt_s=0.01, damping=0.0)
    frame = at_rest(network.film)
    for _ in range(5):
        frame = step(network, frame, loads, config)
    fallen = GRAVITY_MM_S2 * 0.01**2 * (1 + 2 + 3 + 4 + 5)
    np.testing.assert_allclose(
        frame.mesh.vertices - network.film.vertices, fallen * DOWN * np.ones((17, 13, 1)), rtol=1e-6, atol=1e-6
    )
    assert frame.max_strain < 1e-9


def test_uniform_stretch_has_the_sheets_stiffness():
    """Energy of a small stretch along u at fixed v against plane stress: C11 e^2 / 2 per area, C11 = 9 E h / 8."""
    film = sheet(300.0, 300.0, 3, 3)
    network = mass_spring(film, FilmMaterial())
    x = film.vertices.reshape(-1, 3) * [1 + 1e-5, 1, 1]
    length = np.linalg.norm(x[network.springs[:, 0]] - x[network.springs[:, 1]], axis=1)
    energy = 0.5 * np.sum(network.stiffness * (length - network.rest_mm) ** 2)
    assert energy == pytest.approx(0.5 * 9 / 8 * 4000 * 0.175 * 1e-10 * 300 * 300, rel=1e-4)


@pytest.mark.parametrize("levels", [2, 3])
def test_a_short_cantilever_sags_as_a_plate_strip(levels):
    """Tip of a clamped strip under its own weight, small deflection: q L^4 / (8 D)."""
    length = 60.0
    film = sheet(10.0, length, 1, 4, levels)
    network = mass_spring(film, FilmMaterial())
    flat = film.vertices.reshape(-1, 3)
    clamped = np.zeros(film.shape)
    clamped[:, :2] = 1e3
    loads = Loads(gravity(network, DOWN), flat, clamped.ravel())
    frame = at_rest(film)
    for _ in range(40):
        frame = step(network, frame, loads, StepConfig(dt_s=0.1, damping=0.9, max_iterations=40, tolerance_mm=1e-4))
    overhang = length * (1 - film.u_lines[1])
    load = 0.175 * 1390e-9 * GRAVITY_MM_S2 / 1000
    expected = load * overhang**4 / (8 * FilmMaterial().bending_stiffness)
    tip = frame.mesh.vertices[:, -1, 2].mean()
    assert tip == pytest.approx(expected, rel={2: 0.25, 3: 0.12}[levels])


def test_a_hanging_film_does_not_stretch():
    network = mass_spring(sheet(), FilmMaterial())
    flat = network.film.vertices.reshape(-1, 3)
    held = np.zeros(network.film.shape)
    held[0] = 1e4
    loads = Loads(gravity(network, np.array([0.0, 1.0, 0.0])), flat, held.ravel())
    frame = at_rest(network.film)
    for _ in range(10):
        frame = step(network, frame, loads, StepConfig())
        assert frame.max_strain < 1e-4


def test_same_in_another_place_and_orientation():
    network = mass_spring(sheet(), FilmMaterial())
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    force = np.random.default_rng(1).normal(0, 1e-3, (len(network.mass_kg), 3))
    flat = network.film.vertices.reshape(-1, 3)
    stiffness = np.full(len(flat), 1e-3)
    here = step(network, at_rest(network.film), Loads(force, flat, stiffness), StepConfig())
    moved = Frame(network.film.bent(network.film.vertices @ turn.T), here.velocity * 0, 0, 0.0, 0.0)
    there = step(network, moved, Loads(force @ turn.T, flat @ turn.T, stiffness), StepConfig())
    np.testing.assert_allclose(there.mesh.vertices, here.mesh.vertices @ turn.T, atol=1e-5)


def test_a_table_holds_the_film():
    network = mass_spring(sheet(), FilmMaterial())
    loads = free(network)
    loads = Loads(gravity(network, DOWN), loads.goal_mm, loads.goal_stiffness, table_z_mm=0.5)
    frame = at_rest(network.film)
    for _ in range(20):
        frame = step(network, frame, loads, StepConfig(damping=0.5))
    assert 0.4 < frame.mesh.vertices[..., 2].max() < 0.51


def test_two_runs_are_bit_identical():
    runs = [bend(sheet(), np.random.default_rng(5), BendConfig(frames=4, keep_from=0)) for _ in range(2)]
    assert runs[0][0] == runs[1][0]
    np.testing.assert_array_equal(runs[0][1][-1].mesh.vertices, runs[1][1][-1].mesh.vertices)


@pytest.mark.parametrize("name", RECIPES)
def test_recipes_stay_finite_and_within_the_angle(name):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        network = mass_spring(sheet(), FilmMaterial(membrane_scale=0.01))
        loads_at = RECIPES[name][1](network, rng)
        frame = at_rest(network.film)
        for k in range(3):
            frame = step(network, frame, loads_at(k, frame), StepConfig(max_iterations=4))
        assert np.isfinite(frame.mesh.vertices).all()
    _, frames = bend(sheet(), np.random.default_rng(3), BendConfig(frames=4))
    assert max(max_normal_angle(f.mesh) for f in frames) <= np.deg2rad(70)


def test_forces_point_where_they_should():
    network = mass_spring(sheet(), FilmMaterial())
    x = network.film.vertices.reshape(-1, 3)
    field = PointField(np.array([0.0, 0.0, 100.0]), 2.0, 200.0, 1.0, np.zeros(len(x)))
    assert (point_field(network, x, field)[:, 2] < 0).all()  # pushed away from a point behind the film
    blown = wind(network, network.film, np.array([0.0, 0.0, 3.0])).sum(axis=0)
    np.testing.assert_allclose(blown, [0, 0, 0.5 * 1.2 * 9 * 0.43 * 0.35], atol=1e-9)
    noise = smooth_noise(np.random.default_rng(0), (33, 33))
    assert noise.shape == (33 * 33,)


def test_infinite_forces_are_refused():
    network = mass_spring(sheet(), FilmMaterial())
    loads = free(network)
    with pytest.raises(SimulationError, match="not finite"):
        step(
            network,
            at_rest(network.film),
            Loads(loads.force_n + np.inf, loads.goal_mm, loads.goal_stiffness),
            StepConfig(),
        )
