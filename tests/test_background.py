"""The background behind the film: proportional to the light, its plane where the camera sees it, and reproducible."""

from dataclasses import replace

import numpy as np
import pytest
from surroundings_case import FILM, SIZE, camera, even_room, scene

from data_gen.light.lamps import Lamp
from data_gen.light.lighting import Light, LightBox, sample_light
from data_gen.light.rooms import prefilter, procedural_room
from data_gen.render.background import background
from data_gen.render.clutter import _SIZE_MM, sprite
from data_gen.render.ground import Ground, ground_below, ground_light, place_things
from data_gen.render.ground_shadows import lit_ground, through
from data_gen.scene.backdrop import KINDS, sample_backdrop
from data_gen.scene.materials import _PAINTED, TILE, tile
from data_gen.scene.patches import filled
from data_gen.scene.shadows import Shadow
from hybrid.coords import film_centres, pixel_centres

BASE = np.array([0.02, 0.02, 0.021])
BOX = LightBox((3.0, 3.1, 3.2), 0.3, (0.5, 0.5), 0.6, 0.0, True, (1.5, 1.2), 5.0)


def light_for(kind, front=1.0):
    return Light(front=front, turn_deg=30.0, lying=kind == "table", box=BOX if kind == "panel" else None)


@pytest.fixture(scope="module")
def room():
    return prefilter(procedural_room(np.random.default_rng(2), (64, 128)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_background_fills_the_photo_with_light_and_is_the_same_twice(kind, room):
    for seed in range(3):
        photographed = scene(kind, seed, light_for(kind))
        picture = background(photographed, FILM, room, BASE)
        assert picture.shape == (*SIZE, 3)
        assert picture.dtype == np.float32
        assert np.isfinite(picture).all()
        assert picture.min() >= 0
        np.testing.assert_array_equal(background(photographed, FILM, room, BASE), picture)


@pytest.mark.parametrize("kind", ["room", "table", "wall"])
def test_twice_the_light_is_twice_the_radiance(kind, room):
    """This holds if nothing on the plane emits light of its own."""
    once = background(scene(kind, 1, light_for(kind, 0.5), things=0), FILM, room, BASE)
    twice = background(scene(kind, 1, light_for(kind, 1.0), things=0), FILM, room, BASE)
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-4, atol=1e-6)


def test_a_dark_background_is_near_the_films_base(room):
    seen = [background(scene("dark", k), FILM, room, BASE).mean(axis=(0, 1)) / BASE for k in range(40)]
    assert 0.7 < np.median(seen) < 1.4
    assert np.max(seen) < 4
    assert np.min(seen) > 0.25


def test_dark_backgrounds_are_a_tenth_or_more():
    rng = np.random.default_rng(0)
    kinds = [sample_backdrop(sample_light(rng, 0.2), rng).kind for _ in range(600)]
    assert set(kinds) == set(KINDS)
    assert kinds.count("dark") > 60


def test_the_plane_touches_the_film_and_lies_beyond_it():
    for seed in range(5):
        photographed = scene("table", seed, gap_mm=0.0, tilt=(0.0, 0.0))
        ground = ground_below(FILM, photographed.camera, photographed.backdrop)
        above = (FILM.vertices - ground.origin) @ ground.normal
        assert above.min() == pytest.approx(0, abs=1e-6)
        assert (photographed.camera.centre_world - ground.origin) @ ground.normal > 0
        axes = np.stack([ground.along, ground.across, ground.normal])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


def test_coordinates_on_the_plane_project_back_to_their_place():
    view = camera(tilt=0.4)
    ground = ground_below(FILM, view, scene("table", 3).backdrop)
    shares = film_centres((7, 9))
    photo = view.photo_from_world(ground.world(ground.coordinates(view, shares)))
    np.testing.assert_allclose(photo / view.size[::-1], shares, atol=1e-6)
    u, v, seen = ground.pixels(view)
    assert seen.all()
    off = view.photo_from_world(ground.world(np.stack([u, v], axis=-1).astype(np.float64))) - pixel_centres(view.size)
    assert np.abs(off).max() < 0.01 * max(view.size)  # lens distortion is ignored


def test_what_lies_on_the_plane_is_seen_the_right_way_round():
    """A step along the first axis goes right in the photo, one along the second goes down: writing is legible."""
    for seed, tilt in ((0, -0.5), (1, 0.0), (2, 0.5)):
        view = camera(tilt=tilt)
        ground = ground_below(FILM, view, scene("table", seed).backdrop)
        at = view.photo_from_world(ground.world(np.array([[0.0, 0.0], [50.0, 0.0], [0.0, 50.0]])))
        right, down = at[1] - at[0], at[2] - at[0]
        assert right[0] > 2 * abs(right[1])
        assert down[1] > 2 * abs(down[0])


def test_white_matt_ground_in_even_light_is_as_bright_as_the_light():
    photographed = scene("table", 4)
    ground = ground_below(FILM, photographed.camera, photographed.backdrop)
    light = ground_light(ground, photographed.camera, photographed, even_room(0.7), (5, 5))
    np.testing.assert_allclose(light.room, 0.7, rtol=1e-3)
    assert light.lamps == ()
    assert (light.gloss >= 0).all()
    assert light.gloss.max() < 0.7
    np.testing.assert_allclose(light.matt(), light.room)


def test_what_lies_on_metal_hides_its_gloss(room):
    """Black things on a mirror-like table are dark, whatever room it reflects."""
    photographed = scene("table", 2, light_for("table"), material="metal", things=40, blur=0.01)
    ground = ground_below(FILM, photographed.camera, photographed.backdrop)
    rng, reflectance = np.random.default_rng(photographed.backdrop.seed), np.ones((*SIZE, 3), np.float32)
    place_things(reflectance, ground, photographed.camera, photographed.backdrop, rng)
    black = reflectance.max(axis=-1) < 0.05
    gloss = ground_light(ground, photographed.camera, photographed, room, SIZE).gloss
    assert black.sum() > 100
    assert gloss[black].mean() > 0.1
    assert background(photographed, FILM, room, BASE)[black].mean() < 0.5 * gloss[black].mean()


# ---------------------------------------------------------------- shadows on the background

BULB = Lamp("sphere", (-500.0, 0.0, -900.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (8.0, 8.0), (3000.0, 3000.0, 3000.0))


def shadow_of(room, light, film=FILM, shadows=(), ground=None, **changes):
    """The light on the ground below a milky film divided by that on bare ground; also the scene and its ground."""
    of = scene("table", 5, light, tilt=(0.0, 0.0), **changes)
    photographed = replace(of, camera=OVERHEAD, shadows=shadows, material=replace(of.material, clear=0.0))
    ground = ground or ground_below(film, photographed.camera, photographed.backdrop)
    free = ground_light(ground, photographed.camera, photographed, room, SIZE)
    lit = lit_ground(ground, film, photographed.camera, photographed, room, free)
    return (lit / (free.room + sum(free.lamps)))[..., 1], photographed, ground


OVERHEAD = camera(SIZE, 1500.0)


def test_shadows_only_darken_and_in_even_light_grow_fainter_with_the_gap(room):
    darkest = []
    for gap in (0.5, 100.0, 400.0):
        for lit in (room, even_room()):
            factor, _, _ = shadow_of(lit, light_for("table"), gap_mm=gap)
            assert factor.min() > 0
            assert factor.max() <= 1 + 1e-5
        darkest.append(factor.min())
    assert darkest[0] < darkest[1] < darkest[2]


def test_a_bulb_throws_the_film_where_its_rays_go():
    """A bulb at the left casts the film's right edge, 40 mm above ground, 40 / 900 of its distance farther right."""
    factor, photographed, ground = shadow_of(even_room(1e-6), Light(1.0, 0.0, True, lamps=(BULB,)), gap_mm=40.0)
    right = 175.0 + 40.0 * (175.0 + 500.0) / 900.0
    row = np.array([[right - 25.0, 0.0, 40.0], [right + 25.0, 0.0, 40.0]])
    assert np.abs((row - ground.origin) @ ground.normal).max() < 1e-6
    inside, outside = (factor[int(y), int(x)] for x, y in photographed.camera.photo_from_world(row))
    assert inside == pytest.approx(through(photographed)[1], abs=0.02)
    assert outside == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(("gap_mm", "least", "most"), [(0.2, 0.8, 0.92), (6.0, 0.35, 0.8), (200.0, 0.15, 0.25)])
def test_a_clear_film_that_touches_its_ground_is_paid_for_once(gap_mm, least, most):
    """Bare film shows a table by light that passed twice, and the print as rendered already includes both passes."""
    photographed = scene("table", 5, Light(1.0, 0.0, True), gap_mm=gap_mm)
    material = replace(photographed.material, diffuse=0.0, transmission=0.0, clear=0.9, haze=0.0, tint=(1.0, 1.0, 1.0))
    assert least < through(replace(photographed, material=material))[1] * 0.95 < most


def test_a_bluish_film_throws_a_bluish_shadow():
    """The light passes once through the film's base; what the sheet scatters has no colour, as over the film."""
    blue, of = (0.5, 0.7, 0.9), scene("table", 5, Light(1.0, 0.0, True), gap_mm=200.0)
    milky = replace(of.material, diffuse=0.0, transmission=0.3, clear=0.0)
    let_through = [
        through(replace(of, material=replace(milky, haze=haze, tint=tint)))
        for haze, tint in ((0.0, (1.0, 1.0, 1.0)), (0.0, blue), (0.1, blue))
    ]
    np.testing.assert_allclose(let_through[1], let_through[0] * blue, rtol=1e-5)
    np.testing.assert_allclose(let_through[2], let_through[1] + 0.1, rtol=1e-5)


def test_a_shadows_rim_is_soft_where_the_sheet_is_lifted():
    """A large lamp overhead lights a sloping sheet with one side on the ground and the other 150 mm above it."""
    t = np.linspace(0, 1, FILM.shape[1])[None, :, None]
    sloping = FILM.bent(FILM.vertices - t * np.array([0.0, 0.0, 150.0]))
    lamp = replace(BULB, kind="disc", centre_mm=(0.0, 0.0, -1500.0), half_mm=(300.0, 300.0))
    light = Light(1.0, 0.0, True, lamps=(lamp,))
    below = Ground(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, -1.0]))
    factor, _, _ = shadow_of(even_room(1e-6), light, sloping, ground=below)
    row = factor[SIZE[0] // 2]
    steepest = np.abs(np.diff(row))
    assert steepest[: len(row) // 2].max() > 1.5 * steepest[len(row) // 2 :].max()


def test_what_shadows_the_film_shadows_the_table_beside_it():
    """The rim of a door's shadow runs across the film's middle and on."""
    door = Shadow("edge", (0.5, 0.5), 0.0, 1.0, 2.0, 0.7, 0)
    factor, photographed, _ = shadow_of(even_room(), Light(1.0, 0.0, True), shadows=(door,), gap_mm=1.0)
    beside = photographed.camera.photo_from_world(np.array([[230.0, -60.0, 0.0], [230.0, 60.0, 0.0]]))
    dark, bright = (factor[int(y), int(x)] for x, y in beside)
    assert dark < 0.5 * bright
    far, _, _ = shadow_of(even_room(), Light(1.0, 0.0, True), shadows=(door,), gap_mm=500.0)
    assert far.min() > 0.6


def test_an_outline_is_filled_by_its_area():
    outline = np.array([[10.3, 5.2], [70.7, 5.2], [70.7, 60.4], [10.3, 60.4]])
    perimeter = 2 * (60.4 + 55.2)
    assert 0 <= filled(outline, (80, 90)).sum() - 60.4 * 55.2 < perimeter


@pytest.mark.parametrize("material", sorted(_PAINTED))
def test_materials_reflect_less_than_they_receive_and_repeat_without_a_seam(material):
    found = tile(material, 0)
    picture = found.levels[0].astype(np.float64)
    assert picture.shape == (TILE, TILE, 3)
    assert picture.max() <= 255 * np.sqrt(0.93)
    inner = np.abs(np.diff(picture, axis=1)).mean(axis=(0, 2))
    seam = np.abs(picture[:, 0] - picture[:, -1]).mean()
    assert seam <= inner.max() + 3


@pytest.mark.parametrize("kind", sorted(_SIZE_MM))
def test_things_have_a_picture_in_proportion(kind):
    thing = sprite(kind, 1)
    high, wide = thing.levels[0].shape[:2]
    assert high / wide == pytest.approx(thing.size_mm[0] / thing.size_mm[1], rel=0.15)
    assert thing.levels[0][..., 3].max() == 255
