"""The phone and the person before a film, mirrored in its gloss; bases of real films; local tone mapping of phones."""

from dataclasses import replace

import numpy as np
import pytest
from surroundings_case import FILM, camera
from test_develop import PLAIN

from data_gen.camera.develop import develop, local_tone, sample_lens
from data_gen.light.lamps import Lamp
from data_gen.light.lighting import BLUE_BASE, Light, sample_material, some_mirrored
from data_gen.light.onlookers import Billboard, left_free, mirrored_onlookers, sample_onlookers
from hybrid.mesh.camera import Camera

CAMERA = Camera(np.diag([1000.0, 1000.0, 1.0]), np.eye(4), (0.0, 0.0), (100, 100))
"""At the world's origin, looking along z."""
PHONE = Billboard("box", (0.0, 0.0, 0.0), (40.0, 80.0), (0.1, 0.1, 0.1))


def mirrored(onlooker: Billboard, x: float, y: float, alpha: float = 0.0) -> float:
    """What a flat mirror 400 mm away, parallel to the phone, shows at (x, y) in a room of light 1."""
    point = np.array([[[x, y, 400.0]]], np.float32)
    view = -point / np.linalg.norm(point)
    mirror = view * [-1, -1, 1]  # a mirror flips a ray's component along its normal
    around, mean = np.ones((1, 1, 3), np.float32), np.ones(3)
    return float(mirrored_onlookers((onlooker,), CAMERA, point, mirror.astype(np.float32), alpha, around, mean).mean())


def test_a_flat_mirror_shows_the_phone_at_half_its_size():
    assert mirrored(PHONE, 0.0, 0.0) == pytest.approx(0.1)
    assert mirrored(PHONE, 17.0, 37.0) == pytest.approx(0.1)  # seen at (34, 74) in the phone's plane
    assert mirrored(PHONE, 23.0, 0.0) == pytest.approx(1.0)
    assert mirrored(PHONE, 0.0, 43.0) == pytest.approx(1.0)


def test_lamps_behind_somebody_are_not_mirrored_and_those_before_are():
    """The middle of a flat mirror 400 mm away shows the phone; 40 mm beside it, it shows what is beside the phone."""
    points = np.array([[[0.0, 0.0, 400.0], [40.0, 0.0, 400.0]]], np.float32)
    view = -points / np.linalg.norm(points, axis=-1, keepdims=True)
    mirror = (view * [-1, -1, 1]).astype(np.float32)
    behind, before = np.array([0.0, 0.0, -900.0]), np.array([0.0, 0.0, 200.0])
    np.testing.assert_allclose(left_free((PHONE,), CAMERA, points, mirror, 0.0, behind), [[0, 1]], atol=1e-6)
    np.testing.assert_array_equal(left_free((PHONE,), CAMERA, points, mirror, 0.0, before), 1)
    np.testing.assert_array_equal(left_free((), CAMERA, points, mirror, 0.0, behind), 1)


@pytest.mark.parametrize("depth", [-12.0, -1e-6, 12.0])
def test_a_phone_does_not_hide_its_own_flash(depth):
    """Where the film mirrors the phone, it shows the flash but not a bulb an arm's length behind the phone."""
    points = np.array([[[0.0, 0.0, 400.0]]], np.float32)
    mirror = np.array([[[0.0, 0.0, -1.0]]], np.float32)
    flash, bulb = np.array([9.0, 14.0, depth]), np.array([9.0, 14.0, depth - 500.0])
    np.testing.assert_array_equal(left_free((PHONE,), CAMERA, points, mirror, 0.02, flash), 1)
    np.testing.assert_array_equal(left_free((PHONE,), CAMERA, points, mirror, 0.02, bulb), 0)


def test_what_is_farther_away_looks_smaller_and_a_rough_film_blurs_it():
    behind = replace(PHONE, centre_mm=(0.0, 0.0, -400.0))
    assert mirrored(behind, 12.0, 0.0) == pytest.approx(0.1)  # three lengths of 400 mm to the mirror's one: at 36 mm
    assert mirrored(behind, 16.0, 0.0) == pytest.approx(1.0)
    assert 0.3 < mirrored(PHONE, 20.0, 0.0, alpha=0.05) < 0.8
    assert 0.1 < mirrored(PHONE, 18.0, 0.0, alpha=0.05) < mirrored(PHONE, 22.0, 0.0, alpha=0.05) < 1.0


def test_a_phone_is_always_there_and_mostly_a_person():
    rng = np.random.default_rng(0)
    drawn = [sample_onlookers(rng) for _ in range(200)]
    assert all(each[-1].shape == "box" and each[-1].centre_mm[2] == 0 for each in drawn)
    assert 0.6 < np.mean([len(each) == 3 for each in drawn]) < 0.9
    for each in drawn:  # the camera looks out of its phone
        assert each[-1].outside_mm(np.zeros(1), np.zeros(1))[0] < 0


def test_films_are_milky_clear_and_bluish():
    rng = np.random.default_rng(1)
    drawn = [sample_material(rng) for _ in range(2000)]
    clear = np.array([one.clear / (one.clear + one.diffuse + one.transmission) for one in drawn])
    assert 0.2 < (clear > 0.75).mean() < 0.35
    assert not any(m.clear > 3 * (m.diffuse + m.transmission) for m in (sample_material(rng, 0.0) for _ in range(500)))
    tint = np.array([one.tint for one in drawn])
    assert 0.3 < (tint[:, 0] < 1).mean() < 0.5
    assert (tint >= np.array(BLUE_BASE) - 1e-9).all()


def test_local_tone_mapping_makes_dark_parts_brighter_beside_bright_ones():
    linear = np.full((96, 96, 3), 0.02, np.float32)
    linear[:, 48:] = 1.0
    lens = replace(PLAIN, local=0.4, local_reach=0.05)
    factor = local_tone(linear, lens)
    assert factor[40, 4] > 1.5 > 1 > factor[40, -4]
    assert factor[40, 4] / factor[40, -4] == pytest.approx(50**0.4, rel=0.05)
    assert local_tone(linear, PLAIN).size == 1
    plain, toned = (
        np.frombuffer(develop(linear, lens, 1.0, np.random.default_rng(0), local), np.uint8)
        for local in (local_tone(linear, PLAIN), factor)
    )
    assert plain.tobytes() != toned.tobytes()


def test_two_lenses_in_five_map_tones_locally():
    rng = np.random.default_rng(2)
    assert 0.3 < np.mean([sample_lens(rng).local > 0 for _ in range(500)]) < 0.5


def test_a_window_behind_the_film_stays_there_and_one_before_it_is_turned_to_where_it_shows():
    window = Lamp(
        "rectangle", (300.0, 0.0, 1500.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (500.0, 700.0), (50.0, 50.0, 50.0)
    )
    before = replace(window, centre_mm=(300.0, 900.0, -800.0))
    for seed in range(20):
        lit = some_mirrored(Light(1.0, 0.0, False, lamps=(window, before)), FILM, camera(), np.random.default_rng(seed))
        assert lit.lamps[0] == window
        assert lit.lamps[1].centre_mm[2] < 0


def test_local_tone_makes_bright_parts_darker_and_dark_ones_brighter():
    picture = np.full((100, 100, 3), 0.1, np.float32)
    picture[:, 50:] = 0.8
    factors = local_tone(picture, replace(PLAIN, local=0.5, local_reach=0.05))
    half = factors.shape[1] // 2
    assert factors[:, : half - 8].min() > 1 > factors[:, half + 8 :].max()
