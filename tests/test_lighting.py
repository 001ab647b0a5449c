"""Rooms around films that lie: the visible side faces up, whichever side that is."""

from dataclasses import replace

import numpy as np
import pytest
from surroundings_case import FILM, camera, scene

from data_gen.camera.viewpoint import ViewConfig
from data_gen.light.lamps import Lamp, lamp_seen, vector_irradiance
from data_gen.light.lighting import Light, over_table, room_from_film, some_mirrored
from data_gen.light.rooms import prefilter, procedural_room
from data_gen.render.shade import film_light
from data_gen.scene.scene import SceneConfig, sample_scene
from hybrid.mesh.camera import Camera, look_at

BULB = Lamp("sphere", (300.0, 100.0, -800.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (30.0, 30.0), (400.0, 400.0, 400.0))
FLASH = replace(BULB, centre_mm=(5.0, 8.0, 0.0), half_mm=(2.0, 2.0), at_camera=True)
LYING = Light(1.0, 50.0, True, lamps=(BULB,))
TURN = np.diag([1.0, -1.0, -1.0])


def from_below(view: Camera) -> Camera:
    """The camera turned over about the film's x axis."""
    pose = look_at(TURN @ view.centre_world, np.zeros(3), np.array([0.0, -1.0, 0.0]))
    return Camera(view.intrinsics, pose, view.distortion, view.size)


def test_a_lying_film_seen_from_behind_is_lit_as_one_that_is_seen_from_the_front():
    room, before = prefilter(procedural_room(np.random.default_rng(3), (64, 128))), camera(tilt=0.3)
    seen = scene("table", 0, LYING)
    behind = from_below(before)
    front, back = (
        film_light(FILM, replace(seen, camera=view, light=over_table(LYING, view.centre_world)), room)
        for view in (before, behind)
    )
    for one, other in ((front.gain, back.gain), (front.veil, back.veil)):
        np.testing.assert_allclose(np.flip(other, axis=0), one, rtol=2e-3, atol=1e-4 * one.max())


@pytest.mark.parametrize("light", [LYING, replace(LYING, lying=False), replace(LYING, face_down=True)])
def test_the_rooms_upward_direction_is_up(light: Light):
    turn = room_from_film(light)
    np.testing.assert_allclose(turn @ light.up, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1)


def test_only_what_lies_is_turned_over_and_the_flash_stays_at_the_camera():
    above, below = np.array([50.0, 30.0, -700.0]), np.array([50.0, 30.0, 700.0])
    upright, flashed = replace(LYING, lying=False), replace(LYING, lamps=(FLASH, BULB))
    assert over_table(LYING, above) is LYING
    assert over_table(upright, below) is upright
    over = over_table(flashed, below)
    assert over.lamps[0] is FLASH
    np.testing.assert_allclose(over.lamps[1].centre_mm, TURN @ BULB.centre_mm)
    assert over_table(over, below) is over


def test_no_table_is_photographed_from_below():
    config = SceneConfig(view=ViewConfig(behind_share=0.5))
    for seed in range(60):
        drawn = sample_scene(FILM, (96, 96), np.random.default_rng(seed), config)
        if drawn.light.lying:
            assert drawn.light.up @ drawn.camera.centre_world > 0


def test_no_lamp_stands_in_the_photo_before_the_film():
    """Such a lamp would hide the film; lamps seen beyond the film must remain."""
    lamps, beyond = 0, 0
    for seed in range(150):
        drawn = sample_scene(FILM, (96, 96), np.random.default_rng(seed), SceneConfig(light_box_share=0.0))
        view = drawn.camera
        rays = (view.pixel_rays() @ view.camera_from_world[:3, :3]).astype(np.float32)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        for lamp in drawn.light.lamps:
            if not lamp.at_camera:
                both = [replace(lamp, axis=tuple(k * x for x in lamp.axis)) for k in (1.0, -1.0)]
                seen = any(lamp_seen(one, np.broadcast_to(view.centre_world, rays.shape), rays).any() for one in both)
                farther = (
                    view.camera_points(np.array([lamp.centre_mm]))[0, 2]
                    > view.camera_points(FILM.vertices)[..., 2].max()
                )
                assert farther or not seen
                lamps, beyond = lamps + 1, beyond + (seen and farther)
    assert lamps > 90
    assert beyond > 5


def test_a_lamp_that_makes_way_lights_the_films_middle_as_before():
    bulb = replace(BULB, centre_mm=(-60.0, 20.0, -400.0))
    for seed in range(10):
        (moved,) = some_mirrored(replace(LYING, lamps=(bulb,)), FILM, camera(), np.random.default_rng(seed)).lamps
        assert np.linalg.norm(moved.centre_mm) > 1.1 * np.linalg.norm(bulb.centre_mm)
        received = [np.linalg.norm(vector_irradiance(one, np.zeros((1, 3)))) for one in (bulb, moved)]
        assert received[1] == pytest.approx(received[0], rel=1e-4)
