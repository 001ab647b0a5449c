"""What is behind a film shows through it: a film that does nothing to light cannot be told from what it covers."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from surroundings_case import FILM, SIZE, camera, even_room, scene

from data_gen.light.lamps import Lamp
from data_gen.light.lighting import Light, LightBox, Material
from data_gen.light.rooms import Environment, prefilter, procedural_room
from data_gen.render.background import background
from data_gen.render.seen_film import seen_film
from data_gen.render.shade import light_before, light_through, lit_film, room_behind
from data_gen.render.surroundings import Surroundings
from data_gen.render.through import behind_film
from data_gen.sample import scene_light
from hybrid.coords import pixel_from_film, sample_bilinear
from hybrid.mesh.camera import look_at

BASE = np.array([0.02, 0.02, 0.02])
AIR = Material(diffuse=0.0, transmission=0.0, clear=1.0, haze=0.0, roughness=0.5, ior=1.0)
MILK = replace(AIR, transmission=1.0, clear=0.0)
BOX = LightBox((3.0, 3.6, 4.2), 0.4, (0.4, 0.5), 0.6, 0.0, True, (1.5, 1.3), 5.0)


@pytest.fixture(scope="module")
def room():
    return prefilter(procedural_room(np.random.default_rng(2), (64, 128)))


def shown(picture, lit) -> np.ndarray:
    """The picture at the photo points of the film's fine lattice."""
    seen = seen_film(FILM, camera().centre_world, len(lit.fine.points))
    shares = lit.scene.camera.photo_from_world(seen.points) / np.array(SIZE[::-1])
    return sample_bilinear(picture, pixel_from_film(shares, SIZE))


@pytest.mark.parametrize("kind", ["room", "table", "wall", "dark"])
def test_a_film_of_air_shows_the_background(kind, room):
    for seed in range(3):
        taken = replace(scene(kind, seed, blur=12.0), material=AIR)
        picture, lit = background(taken, FILM, room, BASE), lit_film(FILM, taken)
        light = light_before(lit, room) + light_through(lit, behind_film(lit, room, picture))
        assert light.veil.max() < 1e-4 * light.gain.max()
        expected = shown(picture, lit)
        assert np.abs(light.gain - expected).mean() < 0.02 * expected.mean()


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.9, -0.2), (-0.9, 0.5)])
def test_a_film_of_air_shows_the_light_box_as_the_panel_beside_it(room, offset: tuple[float, float]):
    box = replace(BOX, offset=offset)
    taken = scene("panel", 1, Light(front=0.05, turn_deg=0.0, lying=False, box=box), blur=0.3, things=0)
    taken = replace(taken, material=AIR)
    picture, lit = background(taken, FILM, room, BASE), lit_film(FILM, taken)
    gain = light_through(lit, room_behind(lit, room)).gain
    on_panel = gain.mean(axis=-1) > 1.0
    assert np.median(np.abs(gain / shown(picture, lit) - 1)[on_panel]) < 0.02
    assert np.mean((shown(picture, lit).mean(axis=-1) > 1.0) == on_panel) > 0.97
    assert on_panel.all() == (offset == (0.0, 0.0))


def test_a_film_of_air_shows_what_lies_on_the_light_box(room, monkeypatch):
    taken = scene("panel", 1, Light(front=0.05, turn_deg=0.0, lying=False, box=BOX))
    picture = cv2.resize(np.random.default_rng(0).random((6, 8, 3), np.float32), SIZE[::-1])
    monkeypatch.setattr("data_gen.sample.surroundings", lambda *given: Surroundings(picture, ()))
    gain = scene_light(FILM, replace(taken, material=AIR), room, 1.0)[0].gain
    expected = shown(picture, lit_film(FILM, taken))
    assert np.abs(gain - expected).mean() < 0.02 * expected.mean()


def test_a_light_box_seen_from_behind_the_film_is_as_from_the_front(room):
    """Half a turn about the vertical: what hangs on it can still be read, and it is as bright where it is now seen."""
    taken = scene("panel", 2, Light(front=0.0, turn_deg=0.0, lying=False, box=BOX), blur=0.3, things=6)
    taken, turn = replace(taken, material=AIR), np.diag([-1.0, 1.0, -1.0])
    pose = look_at(turn @ taken.camera.centre_world, np.zeros(3), np.array([0, 1.0, 0]))
    behind = replace(taken, camera=replace(taken.camera, camera_from_world=pose))
    front, back = (background(one, FILM, room, BASE) for one in (taken, behind))
    np.testing.assert_allclose(back, front, atol=0.02 * front.max())
    gains = [light_through(lit, room_behind(lit, room)).gain for lit in (lit_film(FILM, x) for x in (taken, behind))]
    np.testing.assert_allclose(gains[1][:, ::-1], gains[0], rtol=1e-3)


def test_other_films_lie_beside_that_on_a_light_box(room):
    """As films are hung: at most their rims are under it."""
    for seed in range(6):
        taken = scene("panel", seed, Light(front=0.0, turn_deg=0.0, lying=False, box=BOX), blur=0.3)
        seen = [replace(taken, backdrop=replace(taken.backdrop, things=things)) for things in (0, 12)]
        bare, hung = (background(one, FILM, room, BASE) for one in seen)
        assert (hung < 0.9 * bare).mean() > 0.02
        lit = lit_film(FILM, taken)
        assert (shown(hung, lit) < 0.9 * shown(bare, lit)).mean() < 0.15


@pytest.mark.parametrize("material", [AIR, MILK])
def test_a_bare_light_box_shines_through_as_one_that_is_masked(material, room):
    taken = scene("panel", 1, Light(front=0.05, turn_deg=0.0, lying=False, box=BOX), blur=0.3, things=0)
    taken = replace(taken, material=material)
    masked = replace(taken, backdrop=replace(taken.backdrop, kind="dark"))
    gains = [scene_light(FILM, seen, room, 0.5)[0].gain for seen in (taken, masked)]
    assert np.median(np.abs(gains[0] / gains[1] - 1)) < 0.01


def test_a_scattering_film_on_an_even_table_is_lit_by_it_alone():
    """Light from the room cannot come through the table."""
    taken = replace(scene("table", gap_mm=1.0), material=MILK)
    lit = lit_film(FILM, taken)
    picture = np.full((*SIZE, 3), 0.3, np.float32)
    for radiance in (0.0, 5.0):
        gain = light_through(lit, behind_film(lit, even_room(radiance), picture)).gain
        np.testing.assert_allclose(gain, 0.3, rtol=1e-4)


def test_a_lamp_behind_the_film_is_seen_in_the_room_and_one_before_it_is_not():
    """It is as large as it should be, and as bright: the pixels it fills follow from its angular size."""
    view, even = camera(tilt=0.3), prefilter(Environment(np.ones((256, 512, 3), np.float32), "even"))
    away = view.camera_from_world[2, :3]
    for depth, seen in ((1500.0, True), (-600.0, False)):
        centre = tuple((depth * away).tolist())
        bulb = Lamp("sphere", centre, (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (200.0, 200.0), (50.0, 40.0, 30.0))
        light = Light(front=1.0, turn_deg=0.0, lying=False, lamps=(bulb,))
        picture = background(scene("room", light=light, blur=0.01), FILM, even, BASE)
        radius = view.intrinsics[0, 0] * 200 / (900 + depth)
        assert (picture - 1).mean(axis=(0, 1))[0] == pytest.approx(
            49 * np.pi * radius**2 / picture[..., 0].size if seen else 0.0, rel=0.05, abs=1e-4
        )
