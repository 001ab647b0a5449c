"""What lies behind the film: light in, light out in proportion; the plane where the camera sees it; the same twice."""

import numpy as np
import pytest
from surroundings_case import FILM, SIZE, camera, even_room, scene

from data_gen._clutter import _SIZE_MM, sprite
from data_gen._materials import _PAINTED, TILE, tile
from data_gen.backdrop import KINDS, sample_backdrop
from data_gen.background import background
from data_gen.ground import film_shade, ground_below, ground_light
from data_gen.lighting import Light, LightBox, sample_light
from data_gen.patches import filled
from data_gen.rooms import prefilter, procedural_room
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
    """With nothing on the plane that shines itself."""
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
    assert np.abs(off).max() < 0.01 * max(view.size)  # its lens distortion is left aside


def test_white_matt_ground_in_even_light_is_as_bright_as_the_light():
    photographed = scene("table", 4)
    ground = ground_below(FILM, photographed.camera, photographed.backdrop)
    matt, gloss = ground_light(ground, photographed.camera, photographed, even_room(0.7), (5, 5))
    np.testing.assert_allclose(matt, 0.7, rtol=1e-3)
    assert (gloss >= 0).all()
    assert gloss.max() < 0.7


def test_shadows_only_darken_and_grow_fainter_with_the_gap(room):
    darkest = []
    for gap in (0.5, 30.0, 400.0):
        photographed = scene("table", 5, gap_mm=gap)
        ground = ground_below(FILM, photographed.camera, photographed.backdrop)
        shade = film_shade(ground, FILM, photographed.camera, photographed, room)
        assert shade.min() > 0
        assert shade.max() <= 1
        darkest.append(shade.min())
    assert darkest[0] < darkest[2]


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
