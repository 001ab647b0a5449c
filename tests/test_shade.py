"""Shading: energy is conserved, light adds up, mirrors obey the law of reflection, turning all changes nothing."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_gen.light.gloss import ALBEDO_COSINES, GRAZING_MEAN, fresnel, gloss, smith
from data_gen.light.lamps import Lamp, highlight
from data_gen.light.lighting import (
    LAMP_SHARE,
    Light,
    LightBox,
    Material,
    mirrored,
    room_from_film,
    sample_light,
    sample_material,
)
from data_gen.light.rooms import Environment, directions, prefilter, procedural_room
from data_gen.render.reflections import lamp_highlight, reflection, wide_reflection
from data_gen.render.seen_film import seen_film
from data_gen.render.shade import FilmLight, film_light, glossy_lattice
from data_gen.scene.scene import Scene, SceneConfig, sample_scene
from data_gen.scene.shadows import Shadow
from hybrid.coords import film_centres_1d
from hybrid.mesh.camera import Camera, look_at
from hybrid.mesh.film import FilmMesh, film_mesh

FURNACE = 0.004  # error of an integral over 256 half vectors, and of interpolation between cosines
LIGHT = Light(front=1.0, turn_deg=0.0, lying=False)
EVEN = prefilter(Environment(np.ones((64, 128, 3), np.float32), "even"))


def bent(roll: float = 0.8) -> FilmMesh:
    film = film_mesh((430.0, 350.0), np.linspace(0.05, 0.95, 4), np.linspace(0.05, 0.95, 4), 2)
    angle = film.vertices[..., 0] / 350 * roll
    radius = 350 / roll
    return film.bent(np.stack([radius * np.sin(angle), film.vertices[..., 1], radius * (np.cos(angle) - 1)], axis=-1))


def camera(eye=(100.0, -50.0, -700.0), size: int = 256) -> Camera:
    matrix = look_at(np.array(eye), np.zeros(3), np.array([0.0, 1.0, 0.0]))
    return Camera(
        np.array([[size * 1.3, 0, size / 2], [0, size * 1.3, size / 2], [0, 0, 1]]), matrix, (0.0, 0.0), (size, size)
    )


def scene(material: Material, light: Light = LIGHT, view: Camera | None = None) -> Scene:
    drawn = sample_scene(bent(), (256, 256), np.random.default_rng(0), SceneConfig())
    return replace(drawn, camera=view or camera(), material=material, light=light, shadows=(), onlookers=())


def radiance(light: FilmLight, grey: float = 1.0) -> np.ndarray:
    return light.gain * grey + light.veil


# ---------------------------------------------------------------- energy

LOBES = {
    "diffuse": Material(1.0, 0.0, 0.0, 0.0, 0.5, 1.5),
    "transmission": Material(0.0, 1.0, 0.0, 0.0, 0.5, 1.5),
    "clear": Material(0.0, 0.0, 1.0, 0.0, 0.5, 1.5),
    "haze": Material(0.0, 0.0, 0.0, 0.5, 0.5, 1.5),
    "all": Material(0.3, 0.3, 0.3, 0.05, 0.5, 1.5),
}


@pytest.mark.parametrize("lobe", LOBES)
@pytest.mark.parametrize("roughness", [0.05, 0.2, 0.5, 0.95])
@pytest.mark.parametrize("surfaces", [1, 3])
def test_a_white_lossless_film_vanishes_in_a_white_furnace(lobe: str, roughness: float, surfaces: int):
    material = replace(LOBES[lobe], roughness=roughness, surfaces=surfaces)
    assert np.allclose(radiance(film_light(bent(), scene(material), EVEN)), 1.0, atol=FURNACE)


@given(seed=st.integers(0, 10**6))
@settings(deadline=None, max_examples=25)
def test_no_material_gives_more_than_it_gets(seed: int):
    material = sample_material(np.random.default_rng(seed))
    assert radiance(film_light(bent(), scene(material), EVEN)).max() < 1 + FURNACE
    assert material.diffuse + material.transmission + material.clear + 2 * material.haze <= 1
    assert 0.05 <= material.roughness <= 0.95


def test_shares_above_one_are_refused():
    with pytest.raises(ValueError, match="shares"):
        Material(0.6, 0.5, 0.0, 0.0, 0.5, 1.5)


@pytest.mark.parametrize("roughness", [0.1, 0.4, 0.95])
@pytest.mark.parametrize("cosine", [0.25, 0.6, 1.0])
def test_directional_albedo_is_the_integral_of_the_lobe(roughness: float, cosine: float):
    surface = gloss(roughness, 1.45)
    # GGX slopes drawn by inverting their cumulative density, instead of half vectors drawn by what the eye sees.
    share, turn = np.meshgrid((np.arange(800) * 2 + 1) / 1600, (np.arange(200) * 2 + 1) / 400 * 2 * np.pi)
    slope = surface.alpha * np.sqrt(share / (1 - share))
    h_z = 1 / np.sqrt(1 + slope**2)
    o_h = np.sqrt(1 - cosine**2) * slope * h_z * np.cos(turn) + cosine * h_z
    lit = fresnel(np.maximum(o_h, 0), 1.45) * smith(2 * o_h * h_z - cosine, surface.alpha) * np.maximum(o_h, 0) / h_z
    expected = (lit * smith(np.array(cosine), surface.alpha) / cosine).mean()
    assert surface.reflected(np.array(cosine)) == pytest.approx(expected, rel=0.01)


def test_smooth_surfaces_reflect_as_fresnel_says():
    for ior in (1.3, 1.5, 1.6):
        assert fresnel(np.array(1.0), ior) == pytest.approx(((ior - 1) / (ior + 1)) ** 2)
        assert fresnel(np.array(0.0), ior) == pytest.approx(1.0)
        brewster = np.cos(np.arctan(ior))  # only light polarised across, half of all, is reflected here
        across = (brewster - np.sqrt(ior**2 - 1 + brewster**2)) / (brewster + np.sqrt(ior**2 - 1 + brewster**2))
        assert fresnel(np.array(brewster), ior) == pytest.approx(across**2 / 2)
        albedo = gloss(0.05, ior).albedo
        steep = ALBEDO_COSINES > 0.1
        assert np.allclose(albedo[steep], fresnel(ALBEDO_COSINES[steep], ior), atol=2e-3)


def test_entry_weights_keep_the_light():
    for roughness in (0.05, 0.3, 0.95):
        a, b = gloss(roughness, 1.5).entry
        assert a + b * GRAZING_MEAN == pytest.approx(1.0)


@pytest.mark.parametrize("roughness", [0.4, 0.6, 0.8])
@pytest.mark.parametrize("n", [48, 160])
def test_wide_reflections_lie_where_they_are(roughness: float, n: int):
    """The sum is taken at few points of the film; interpolated between them, it is the room's reflection there."""
    room = prefilter(procedural_room(np.random.default_rng(5), (64, 128)))
    seen, surface = seen_film(bent(), camera().centre_world, n), gloss(roughness, 1.5)
    some = slice(1, None, max(n // 24, 1))
    expected = wide_reflection(seen.part(some, some), room, room_from_film(LIGHT), surface)
    expected *= surface.reflected(seen.part(some, some).cosine) * np.float32(LIGHT.front)
    found = reflection(seen, scene(LOBES["all"]), room, surface)[some, some]
    assert np.abs(found / expected - 1).mean() < 0.02


# ---------------------------------------------------------------- linearity, turning


BULB = Lamp("sphere", (150.0, -200.0, -400.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (20.0, 20.0), (300.0, 200.0, 100.0))
BOX = LightBox((4.0, 4.0, 5.0), 0.5, (0.4, 0.5), 0.5, 3.0, True, (1.2, 1.2), 10.0)


def test_twice_the_light_is_twice_the_radiance():
    room = prefilter(procedural_room(np.random.default_rng(1), (64, 128)))
    twice = prefilter(Environment(room.environment.radiance * 2, "twice"))
    lamps, brighter = ((replace(BULB, radiance=tuple(k * x for x in BULB.radiance)),) for k in (1, 2))
    box, double = (replace(BOX, radiance=tuple(k * x for x in BOX.radiance)) for k in (1, 2))
    material = replace(LOBES["all"], roughness=0.25)
    one = film_light(bent(), scene(material, replace(LIGHT, lamps=lamps, box=box)), room)
    two = film_light(bent(), scene(material, replace(LIGHT, lamps=brighter, box=double)), twice)
    assert np.allclose(two.gain, 2 * one.gain, rtol=1e-4)
    assert np.allclose(two.veil, 2 * one.veil, rtol=1e-4)


def test_light_of_lamps_and_room_adds_up():
    room = prefilter(procedural_room(np.random.default_rng(2), (64, 128)))
    dark = replace(LIGHT, front=0.0)
    material = replace(LOBES["all"], roughness=0.25)
    parts = [replace(dark, lamps=(BULB,)), LIGHT, replace(LIGHT, lamps=(BULB,))]
    bulb, alone, both = (radiance(film_light(bent(), scene(material, light), room)) for light in parts)
    assert np.allclose(bulb + alone, both, rtol=1e-4, atol=1e-5)


def test_turning_film_lamp_and_camera_in_a_room_turned_alike_changes_nothing():
    """A quarter turn about the room's vertical, which is the film's y, of the room and of all that is in it."""
    room = procedural_room(np.random.default_rng(3), (64, 128)).radiance
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    film, view = bent(), camera()
    eye = turn @ view.centre_world
    turned_view = replace(view, camera_from_world=look_at(eye, np.zeros(3), np.array([0.0, 1, 0])))
    lamp = replace(BULB, centre_mm=tuple((turn @ np.array(BULB.centre_mm)).tolist()))
    material = replace(LOBES["all"], roughness=0.25)
    straight = film_light(film, scene(material, replace(LIGHT, lamps=(BULB,)), view), prefilter(Environment(room, "a")))
    # Film x is the room's x and film z its y: film z turns to x, so the azimuth falls from a quarter (32 columns) to 0.
    rolled = prefilter(Environment(np.roll(room, -32, axis=1), "b"))
    turned = scene(material, replace(LIGHT, lamps=(lamp,)), turned_view)
    result = film_light(film.bent(film.vertices @ turn.T), turned, rolled)
    assert np.abs(radiance(result) / radiance(straight) - 1).max() < 0.01


# ---------------------------------------------------------------- mirrors


def flat() -> FilmMesh:
    return film_mesh((430.0, 350.0), np.linspace(0.05, 0.95, 4), np.linspace(0.05, 0.95, 4), 2)


MIRROR = Material(0.0, 0.0, 0.0, 0.0, 0.08, 1.5)


def brightest(light: FilmLight) -> np.ndarray:
    """Film uv at the middle of the brightest part."""
    level = light.veil.sum(axis=-1)
    rows, cols = np.nonzero(level > 0.7 * level.max())
    t = film_centres_1d(len(level))
    return np.array([t[cols].mean(), t[rows].mean()])


@pytest.mark.parametrize("at", [(0.0, 0.0), (80.0, -60.0), (-100.0, 120.0)])
def test_a_lamp_shows_where_its_mirror_image_stands(at: tuple[float, float]):
    eye, target = np.array([100.0, -50.0, -700.0]), np.array([*at, 0.0])
    towards = target - eye
    lamp = target + 1.1 * towards * [1, 1, -1]  # the mirrored ray from the eye, followed beyond the film
    one = replace(BULB, centre_mm=tuple(lamp.tolist()), half_mm=(4.0, 4.0))
    light = film_light(flat(), scene(MIRROR, replace(LIGHT, front=0.0, lamps=(one,)), camera()), EVEN)
    expected = target[:2] / [350, 430] + np.array([1, 1]) / 2
    assert np.abs(brightest(light) - expected).max() < 1.0 / len(light.veil)


@settings(max_examples=15, deadline=None)
@given(st.tuples(st.floats(0.15, 0.85), st.floats(0.15, 0.85)), st.integers(0, 50))
def test_a_mirrored_lamp_shows_at_its_point_and_lights_the_middle_as_before(uv: tuple[float, float], seed: int):
    film, eye = bent(), camera().centre_world
    u, v = np.array(uv[:1]), np.array(uv[1:])
    drawn = np.random.default_rng(seed).normal(0, 1, 3) * [1, 1, 0] - [0, 0, 3]
    bulb = replace(BULB, centre_mm=tuple((drawn * 300).tolist()), half_mm=(6.0, 6.0))
    lamp = mirrored(bulb, film.surface(u, v)[0, 0], film.normals(u, v)[0, 0], eye)
    assert np.linalg.norm(lamp.centre_mm) == pytest.approx(np.linalg.norm(bulb.centre_mm))
    light = film_light(film, scene(MIRROR, replace(LIGHT, front=0.0, lamps=(lamp,)), camera()), EVEN)
    v_near, u_near = (int(x * len(light.veil)) for x in (uv[1], uv[0]))
    near = light.veil[max(v_near - 2, 0) : v_near + 3, max(u_near - 2, 0) : u_near + 3]
    assert near.max() > 0.5 * light.veil.max()


@pytest.mark.parametrize("roughness", [0.08, 0.15])
def test_a_sharp_highlight_fades_without_a_frame(roughness: float):
    """On the coarse lattice that finds it, as on the fine one: any step that is left is smaller than a display level.

    A bright lamp's tails are seen far around its image.
    """
    surface, seen = gloss(roughness, 1.5), seen_film(flat(), camera().centre_world, 320)
    bulb = replace(BULB, centre_mm=(-100.0, 50.0, -700.0), radiance=(800.0, 800.0, 800.0))
    shown = 800 * lamp_highlight(bulb, seen, surface)
    alpha = max(surface.alpha, (1 / 2) / len(seen.points))
    exact = 800 * highlight(bulb, seen.points, seen.normals, seen.view, surface, alpha)
    assert exact.max() > 1
    assert np.abs(shown - exact).max() < 0.02


def test_the_sun_shows_where_the_mirrored_ray_meets_it():
    eye, target = np.array([100.0, -50.0, -700.0]), np.array([40.0, 30.0, 0.0])
    mirrored = (target - eye) * [1, 1, -1] / np.linalg.norm(target - eye)
    for lying in (False, True):
        light = replace(LIGHT, lying=lying, turn_deg=70.0)
        sun = room_from_film(light) @ mirrored
        rays = directions((256, 512))
        sky = 0.01 + 1000 * (rays @ sun.astype(np.float32) > np.cos(0.03))
        room = prefilter(Environment(np.repeat(sky[..., None], 3, axis=2).astype(np.float32), "sun"))
        got = film_light(flat(), scene(MIRROR, light, camera()), room)
        expected = target[:2] / [350, 430] + np.array([1, 1]) / 2
        assert np.abs(brightest(got) - expected).max() < 1.5 / len(got.veil)  # and half a pixel of the sky


def test_a_film_in_front_of_its_back_light_is_the_same_from_behind():
    """The sheet has two equal sides: seen from behind in an even room, it looks as it does from the front."""
    front = film_light(flat(), scene(LOBES["all"]), EVEN)
    behind = film_light(flat(), scene(LOBES["all"], view=camera((100.0, -50.0, 700.0))), EVEN)
    assert np.allclose(radiance(front), radiance(behind), rtol=1e-4)


def test_a_box_shines_through_and_black_print_hides_it():
    material = Material(0.0, 0.5, 0.3, 0.0, 0.3, 1.5)
    light = film_light(
        flat(), scene(material, replace(LIGHT, front=0.0, box=replace(BOX, falloff=0.0, tubes=0.0))), EVEN
    )
    middle = light.gain[40:60, 40:60].mean(axis=(0, 1))
    assert np.allclose(middle / BOX.radiance, middle[0] / BOX.radiance[0], rtol=0.01)
    assert 0.7 < middle[0] / BOX.radiance[0] < 0.8  # 0.8 less what the surface keeps out
    assert light.veil.max() < 1e-3


def test_what_stands_before_a_film_takes_no_light_from_behind_it():
    shadow = Shadow("head", (0.5, 0.5), 0.0, 1.0, 20.0, 0.8, 0)
    box = scene(LOBES["all"], replace(LIGHT, front=0.0, box=BOX))
    before = scene(LOBES["all"])
    for lit, darker in ((box, False), (before, True)):
        free, crossed = (film_light(flat(), replace(lit, shadows=casts), EVEN) for casts in ((), (shadow,)))
        share = crossed.gain[80, 80] / cv2.resize(free.gain, crossed.gain.shape[1::-1])[80, 80]
        assert (share < 0.95).all() == darker
        assert (share > 0.99).all() != darker


# ---------------------------------------------------------------- lattices, draws


def test_the_lattice_lies_on_the_smooth_film():
    film, t = bent(), film_centres_1d(30)
    seen = seen_film(film, np.array([0.0, 0.0, -600.0]), 30)
    assert np.allclose(seen.points, film.surface(t, t), atol=1e-3)
    assert np.allclose(seen.normals, film.normals(t, t), atol=1e-5)
    assert np.allclose(np.linalg.norm(seen.mirror, axis=-1), 1.0, atol=1e-5)


def test_mirrors_get_finer_lattices_than_matt_films():
    rough, shiny = (replace(MIRROR, roughness=r) for r in (0.9, 0.1))
    assert glossy_lattice(rough, (1080, 1080)) < glossy_lattice(shiny, (256, 256)) < glossy_lattice(shiny, (1080, 1080))


def test_light_is_drawn_in_the_shares_that_are_promised():
    lights = [sample_light(np.random.default_rng(seed), 0.2) for seed in range(2000)]
    rooms = [light for light in lights if not light.light_box]
    assert len(rooms) / len(lights) == pytest.approx(0.8, abs=0.04)
    assert np.mean([bool(light.lamps) for light in rooms]) == pytest.approx(LAMP_SHARE, abs=0.04)
    assert any(lamp.at_camera for light in rooms for lamp in light.lamps)
    assert not any(light.lamps for light in lights if light.light_box)
    glossy = np.mean([sample_material(np.random.default_rng(seed)).roughness < 0.3 for seed in range(1000)])
    assert glossy > 0.5
