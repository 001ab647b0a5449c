"""Lamps: irradiance against closed forms, place and strength of highlights, colour."""

import numpy as np
import pytest

from data_gen.light.gloss import fresnel, gloss, smith
from data_gen.light.lamps import Lamp, highlight, lamp_seen, planckian, surface_irradiance, vector_irradiance

FLOAT32 = 2e-4  # relative: sums over edges nearly cancel
UP = np.array([[0.0, 0.0, 1.0]], np.float32)
ORIGIN = np.zeros((1, 3), np.float32)


def lamp(kind="rectangle", centre=(0.0, 0.0, 500.0), half=(100.0, 60.0), axis=(0.0, 0.0, -1.0)) -> Lamp:
    return Lamp(kind, centre, axis, (1.0, 0.0, 0.0), half, (1.0, 1.0, 1.0))


def irradiance(one: Lamp, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return surface_irradiance(vector_irradiance(one, points), normals)[0]


@pytest.mark.parametrize(("a", "b", "h"), [(100.0, 60.0, 500.0), (800.0, 300.0, 200.0), (5.0, 5.0, 1000.0)])
def test_irradiance_of_a_rectangle_overhead_is_the_closed_form(a: float, b: float, h: float):
    # Four times the form factor of a rectangle seen from below a corner (Howell, A catalog of radiation factors, B-3).
    x, y = a / h, b / h
    u, v = np.sqrt(1 + x**2), np.sqrt(1 + y**2)
    corner = (x / u * np.arctan(y / u) + y / v * np.arctan(x / v)) / (2 * np.pi)
    got = irradiance(lamp(centre=(0.0, 0.0, h), half=(a, b)), ORIGIN, UP)
    assert got == pytest.approx(np.pi * 4 * corner, rel=5e-3 if x > 1 else FLOAT32)  # wide ones: replaced by spheres


def test_irradiance_of_a_disc_and_a_bulb_overhead():
    sine2 = 0.2**2 / (1 + 0.2**2)
    assert irradiance(lamp("disc", half=(100.0, 100.0)), ORIGIN, UP) == pytest.approx(np.pi * sine2, rel=2e-3)
    bulb = lamp("sphere", half=(100.0, 100.0))
    assert irradiance(bulb, ORIGIN, UP) == pytest.approx(np.pi * 0.04, rel=FLOAT32)


@pytest.mark.parametrize("kind", ["sphere", "disc", "rectangle"])
def test_light_falls_off_with_the_square_of_distance_and_the_cosine(kind):
    near, far = (irradiance(lamp(kind, (0.0, 0.0, d), (5.0, 5.0)), ORIGIN, UP) for d in (500.0, 1500.0))
    assert near / far == pytest.approx(9.0, rel=2e-3)
    for angle in (0.3, 0.9, 1.4):
        tilted = np.array([[np.sin(angle), 0, np.cos(angle)]], np.float32)
        assert irradiance(lamp(kind, half=(5.0, 5.0)), ORIGIN, tilted) == pytest.approx(
            np.cos(angle) * irradiance(lamp(kind, half=(5.0, 5.0)), ORIGIN, UP), rel=5e-3
        )


def test_a_bulb_cut_by_the_horizon_against_its_integral():
    rng = np.random.default_rng(0)
    sine = 0.6
    bulb = lamp("sphere", (0.0, 0.0, 100.0), (60.0, 60.0))
    z = 1 - rng.random(400_000) * (1 - np.sqrt(1 - sine**2))
    turn = rng.uniform(0, 2 * np.pi, z.size)
    rays = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
    for angle in (1.2, 1.57, 1.9, 2.5):
        normal = np.array([[np.sin(angle), 0.0, np.cos(angle)]], np.float32)
        summed = np.maximum(rays @ normal[0], 0).mean() * 2 * np.pi * (1 - np.sqrt(1 - sine**2))
        assert irradiance(bulb, ORIGIN, normal)[0] == pytest.approx(summed, abs=0.004)


def test_front_less_back_is_the_vector_irradiances_component_and_behind_a_lamp_is_dark():
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(50, 3))
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    points = rng.uniform(-200, 200, (50, 3)).astype(np.float32)
    vector = vector_irradiance(lamp(), points)
    front, back = surface_irradiance(vector, normals)[0], surface_irradiance(vector, -normals)[0]
    assert np.allclose(front - back, (vector * normals).sum(axis=1), atol=2e-3)
    assert not vector_irradiance(lamp(axis=(0.0, 0.0, 1.0)), points).any()


def test_patches_of_a_window_shed_its_light():
    window = lamp(centre=(0.0, 0.0, 1000.0), half=(700.0, 900.0))
    patches = window.patches()
    assert len(patches) > 3
    whole = vector_irradiance(window, ORIGIN)
    assert np.allclose(sum(vector_irradiance(p, ORIGIN) for p in patches), whole, rtol=FLOAT32, atol=1e-4)


def summed_highlight(one: Lamp, view: np.ndarray, roughness: float, n: int = 400) -> float:
    """The reflection at the origin, summed over the lamp's surface."""
    surface, k = gloss(roughness, 1.5), (np.arange(n) * 2 + 1) / n - 1
    a, b = np.meshgrid(k, k)
    across, axis = np.array(one.across), np.array(one.axis)
    along = np.cross(axis, across)
    points = one.centre_mm + a[..., None] * one.half_mm[0] * across + b[..., None] * one.half_mm[1] * along
    squared = (points**2).sum(axis=-1)
    towards = points / np.sqrt(squared)[..., None]
    angle = 4 * one.half_mm[0] * one.half_mm[1] / n**2 * np.maximum(-towards @ axis, 0) / squared
    half = towards + view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    density = surface.alpha**2 / (np.pi * (half[..., 2] ** 2 * (surface.alpha**2 - 1) + 1) ** 2)
    masking = smith(towards[..., 2], surface.alpha) * smith(view[2], surface.alpha)
    return float((angle * fresnel(half @ view, 1.5) * density * masking).sum() / (4 * view[2]))


@pytest.mark.parametrize("roughness", [0.1, 0.2, 0.4, 0.8])
@pytest.mark.parametrize("centre", [(-250.0, 0.0, 430.0), (-150.0, 60.0, 430.0), (100.0, 0.0, 480.0)])
def test_highlight_of_a_rectangle_is_the_integral_over_it(roughness: float, centre: tuple[float, float, float]):
    view = np.array([0.5, 0.0, np.sqrt(0.75)])
    axis = -np.array(centre) / np.linalg.norm(centre)
    across = np.cross([0.0, 1.0, 0.0], axis)
    across /= np.linalg.norm(across)
    one = Lamp("rectangle", centre, tuple(axis.tolist()), tuple(across.tolist()), (60.0, 40.0), (1.0, 1.0, 1.0))
    surface = gloss(roughness, 1.5)
    got = highlight(one, ORIGIN, UP, view[None].astype(np.float32), surface, surface.alpha)
    assert got[0] == pytest.approx(summed_highlight(one, view, roughness), rel=0.02)


def test_a_disc_is_round_to_a_hundredth():
    corners = lamp("disc", half=(80.0, 80.0)).corners - np.array([0.0, 0.0, 500.0])
    edges = (corners + np.roll(corners, 1, axis=0)) / 2
    assert np.linalg.norm(edges, axis=1).min() > 0.99 * np.linalg.norm(corners, axis=1).max()


@pytest.mark.parametrize("roughness", [0.15, 0.4, 0.8])
def test_bulb_and_disc_of_one_solid_angle_shine_alike(roughness: float):
    view = np.array([[-0.3, 0.1, np.sqrt(0.9)]], np.float32)
    surface = gloss(roughness, 1.5)
    facing = ((200.0, 0.0, 700.0), (-0.27472, 0.0, -0.96152), (0.0, 1.0, 0.0), (5.0, 5.0), (1.0, 1.0, 1.0))
    bulb, disc = Lamp("sphere", *facing), Lamp("disc", *facing)
    a, b = (highlight(x, ORIGIN, UP, view, surface, surface.alpha)[0] for x in (bulb, disc))
    assert a == pytest.approx(b, rel=0.02)


@pytest.mark.parametrize("kind", ["sphere", "disc", "rectangle"])
@pytest.mark.parametrize("roughness", [0.1, 0.5])
def test_a_lamp_below_the_horizon_leaves_no_highlight(kind: str, roughness: float):
    """The visible side of a film mirrors no light from behind the film."""
    surface, view = gloss(roughness, 1.5), np.array([[0.2, 0.0, np.sqrt(0.96)]], np.float32)
    for x in (0.0, -150.0, 400.0):
        below = lamp(kind, (x, 0.0, -700.0), (70.0, 70.0), (0.0, 0.0, 1.0))
        above = lamp(kind, (x, 0.0, 700.0), (70.0, 70.0))
        got, some = (highlight(one, ORIGIN, UP, view, surface, surface.alpha)[0] for one in (below, above))
        assert got == 0
        assert some > 0


def test_a_huge_lamp_in_a_mirror_shows_its_radiance_times_fresnel():
    view = np.array([[0.4, 0.0, np.sqrt(0.84)]], np.float32)
    surface = gloss(0.03, 1.5)
    for kind in ("rectangle", "disc"):
        got = highlight(lamp(kind, half=(5000.0, 5000.0)), ORIGIN, UP, view, surface, surface.alpha)
        assert got[0] == pytest.approx(float(fresnel(np.sqrt(0.84), 1.5)), rel=5e-3)


def test_rays_meet_lamps_where_they_are():
    rays = np.array([[0, 0, 1], [0.19, 0, 1], [0.21, 0, 1], [0, 0.13, 1], [0, 0, -1]], np.float32)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    points = np.zeros((5, 3), np.float32)
    assert lamp_seen(lamp(), points, rays).tolist() == [True, True, False, False, False]
    assert lamp_seen(lamp("sphere", half=(100.0, 100.0)), points, rays).tolist() == [True, True, False, True, False]
    assert not lamp_seen(lamp(axis=(0.0, 0.0, 1.0)), points, rays).any()


def test_colour_of_lamps_runs_from_orange_through_white_to_blue():
    colours = np.array([planckian(k) for k in (2700.0, 4000.0, 5500.0, 6504.0, 8000.0, 10200.0)])
    assert np.allclose(colours @ [0.2126, 0.7152, 0.0722], 1.0)
    assert np.all(np.diff(colours[:, 2] / colours[:, 0]) > 0)
    assert np.allclose(planckian(6504.0), 1.0, atol=0.06)  # daylight lies slightly off the black body's curve


def test_a_flash_moves_with_the_camera():
    flash = Lamp(
        "sphere", (10.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (2.0, 2.0), (1.0, 1.0, 1.0), at_camera=True
    )
    placed = flash.placed(np.array([0.0, 5.0, -400.0]))
    assert placed.centre_mm == (10.0, 5.0, -400.0)
    assert not placed.at_camera
    assert placed.placed(np.ones(3)) == placed
