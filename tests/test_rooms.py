"""Environments: lookup and blur are right in the cases that can be solved by hand."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_gen.light.lighting import Light, room_from_film
from data_gen.light.rooms import (
    Environment,
    directions,
    load_environments,
    load_hdri,
    mean_luminance,
    prefilter,
    procedural_room,
    resize_environment,
    room_lights,
    sample_environment,
    sample_filtered,
    sample_irradiance,
    solid_angles,
)
from hybrid.errors import DataError

SHARED = os.environ.get("HYBRID_SHARED_DATA")

FLOAT32 = 1e-5  # relative: a few dozen float32 operations
LOOKUP = 4e-3  # relative to the steepest step between pixels: OpenCV's angles are good to about 1e-2 degrees each


def constant(value: float, size: tuple[int, int] = (64, 128)) -> Environment:
    return Environment(np.full((*size, 3), value, np.float32), "constant")


def random_directions(n: int, seed: int = 0) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(n, 3))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def linear_light(size: tuple[int, int] = (64, 128)) -> Environment:
    """Radiance 2 + the component of the direction along each axis: a first-order harmonic."""
    return Environment(2.0 + directions(size), "linear")


def test_directions_are_unit_and_solid_angles_fill_the_sphere():
    rays = directions((32, 64))
    assert np.allclose(np.linalg.norm(rays, axis=-1), 1.0, atol=FLOAT32)
    assert np.isclose(solid_angles((32, 64)).sum() * 64, 4 * np.pi)
    assert rays[0, 0, 2] > 0.99  # row 0 looks up
    assert rays[16, 0, 0] > 0.99  # azimuth 0 is +x
    assert rays[16, 16, 1] > 0.99  # a quarter turn further is +y


def test_lookup_at_pixel_centres_returns_the_pixels():
    env = Environment(np.random.default_rng(0).uniform(0, 1, (32, 64, 3)).astype(np.float32), "noise")
    assert np.allclose(sample_environment(env, directions((32, 64))), env.radiance, atol=LOOKUP)


def test_lookup_of_a_smooth_field_is_right_everywhere_and_wraps():
    rays = random_directions(5000)
    got = sample_environment(linear_light((256, 512)), rays)
    assert np.abs(got - (2.0 + rays)).max() < 0.02  # half a pixel of clamping at the poles: pi / 512
    seam = np.array([[1.0, s * 1e-3, 0.0] for s in (-1.0, 1.0)], np.float32)
    below, above = sample_environment(linear_light((256, 512)), seam)
    assert np.allclose(below, above, atol=0.01)


@pytest.mark.parametrize("shape", [(3,), (0, 3), (1, 3), (4, 5, 3), (2049, 3), (40000, 1, 3)])
def test_lookup_keeps_every_shape(shape: tuple[int, ...]):
    rays = np.zeros(shape, np.float32)
    rays[..., 2] = 1.0
    assert sample_environment(constant(3.0), rays).shape == shape
    assert np.allclose(sample_environment(constant(3.0), rays), 3.0)


def test_resizing_keeps_the_light_of_the_sphere():
    rng = np.random.default_rng(1)
    radiance = np.exp(rng.normal(0, 2, (128, 256, 3))).astype(np.float32)
    small = resize_environment(radiance, (32, 64))
    assert np.isclose(mean_luminance(small), mean_luminance(radiance), rtol=1e-4)


def test_constant_light_stays_constant_and_its_irradiance_is_pi_times_it():
    filtered = prefilter(constant(2.5))
    assert all(np.allclose(level, 2.5, rtol=FLOAT32) for level in filtered.stack)
    assert np.allclose(filtered.grazing, np.pi * 2.5 / 21, rtol=FLOAT32)  # the mean of (1 - c)^5, by hand
    assert np.allclose(filtered.irradiance, np.pi * 2.5, rtol=FLOAT32)
    rays = random_directions(100)
    for roughness in (0.0, 0.05, 0.3, 1.0):
        assert np.allclose(sample_filtered(filtered, rays, roughness), 2.5, rtol=FLOAT32)
    assert np.allclose(sample_irradiance(filtered, rays), np.pi * 2.5, rtol=FLOAT32)


def test_irradiance_of_a_first_order_harmonic_is_two_thirds_pi_of_it():
    # Ramamoorthi and Hanrahan 2001: the clamped cosine scales order 0 by pi and order 1 by 2 pi / 3
    rays = random_directions(500)
    expected = np.pi * 2.0 + (2 * np.pi / 3) * rays
    assert np.abs(sample_irradiance(prefilter(linear_light()), rays) - expected).max() < 0.06  # 64 rows: 3 degrees


def test_blur_keeps_the_harmonics_direction_and_shrinks_with_roughness():
    filtered = prefilter(linear_light(), (0.2, 0.5, 1.0))
    gains = []
    for level in filtered.stack:
        rays = directions(level.shape[:2])
        gains.append(float(((level - 2.0) * rays).sum() / (rays * rays).sum()))
        assert np.abs(level - (2.0 + gains[-1] * rays)).max() < 0.02
    assert 1.0 > gains[0] > gains[1] > gains[2] > 0.5


def test_turning_the_room_turns_the_blur():
    radiance = np.exp(np.random.default_rng(2).normal(0, 1, (64, 128, 3))).astype(np.float32)
    straight, turned = (prefilter(Environment(np.roll(radiance, k, axis=1), "x")) for k in (0, 32))
    for a, b in zip((*straight.stack, straight.irradiance), (*turned.stack, turned.irradiance), strict=True):
        assert np.allclose(np.roll(a, a.shape[1] // 4, axis=1), b, rtol=1e-3)


def test_a_rooms_lights_tell_the_sun_from_its_sky():
    """A sun as strong as the sky around it is one light, in its place; what is below the plane is no light."""
    size, up = (64, 128), np.array([0.0, 0.0, 1.0])
    radiance = np.ones((*size, 3), np.float32)
    radiance[12, 40] += np.pi / (solid_angles(size)[12] * directions(size)[12, 40, 2])
    radiance[50:] = 3.0
    ways, shares, sigmas = room_lights(prefilter(Environment(radiance, "sun")), up, 6)
    np.testing.assert_allclose(shares.sum(), 1, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 1, rtol=1e-6)
    sun = int(np.argmin(sigmas))
    assert shares[sun] == pytest.approx(0.5, abs=0.02)
    assert ways[sun] @ directions(size)[12, 40] > 0.999
    assert sigmas[sun] < 0.02 < np.delete(sigmas, sun).min()


def test_light_of_one_direction_is_one_light_and_darkness_none():
    radiance = np.zeros((64, 128, 3), np.float32)
    assert len(room_lights(prefilter(Environment(radiance, "dark")), np.array([0, 0, 1.0]), 4)[0]) == 0
    radiance[5, 7] = 1
    ways, shares, sigmas = room_lights(prefilter(Environment(radiance, "lamp")), np.array([0, 0, 1.0]), 4)
    assert len(ways) == 1
    assert shares[0] == pytest.approx(1)
    assert sigmas[0] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("levels", [(), (0.0, 0.5), (0.5, 0.2), (0.5, 1.5)])
def test_roughness_levels_are_checked(levels: tuple[float, ...]):
    with pytest.raises(ValueError, match="roughness"):
        prefilter(constant(1.0), levels)


@pytest.mark.parametrize("seed", range(12))
def test_rooms_are_sane_varied_and_repeat(seed: int):
    room = procedural_room(np.random.default_rng(seed), (64, 128))
    assert room.radiance.shape == (64, 128, 3)
    assert room.radiance.dtype == np.float32
    assert np.isclose(mean_luminance(room.radiance), 1.0, rtol=1e-3)
    assert room.radiance.max() > 2.0  # some lamp, window or sky stands out
    assert np.array_equal(room.radiance, procedural_room(np.random.default_rng(seed), (64, 128)).radiance)


def test_rooms_have_high_dynamic_range():
    peaks = [procedural_room(np.random.default_rng(s), (64, 128)).radiance.max() for s in range(16)]
    assert np.median(peaks) > 10
    assert max(peaks) > 60


def test_hdr_file_round_trip(tmp_path: Path):
    radiance = np.random.default_rng(0).uniform(0.1, 3.0, (64, 128, 3)).astype(np.float32)
    cv2.imwrite(str(tmp_path / "a.hdr"), cv2.cvtColor(radiance, cv2.COLOR_RGB2BGR))
    env = load_environments(tmp_path)[0]
    assert env.radiance.shape == (512, 1024, 3)
    small = load_hdri(tmp_path / "a.hdr", (64, 128)).radiance
    gain = np.median(small / radiance)
    seen = np.fliplr(radiance)  # azimuth grows to the left
    assert np.allclose(small / gain, seen, atol=0.02)  # RGBE keeps 8 bits of the brightest channel


@pytest.mark.parametrize("lying", [False, True])
def test_what_is_on_the_right_of_a_picture_is_seen_on_the_right(tmp_path: Path, lying: bool):
    """A picture that gets brighter to the right, viewed along its horizon with the room's upward direction up."""
    radiance = np.broadcast_to(np.linspace(0.1, 3.0, 128, dtype=np.float32)[None, :, None], (64, 128, 3))
    cv2.imwrite(str(tmp_path / "a.hdr"), np.ascontiguousarray(radiance))
    light = Light(front=1.0, turn_deg=140.0, lying=lying)
    ahead = np.array([0.0, 1.0, 0.0] if lying else [0.0, 0.0, 1.0])
    right = np.cross(ahead, light.up)
    rays = np.stack([ahead + share * right for share in (-0.3, 0.0, 0.3)])
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ room_from_film(light).T
    left, middle, right_of_it = sample_environment(load_hdri(tmp_path / "a.hdr"), rays.astype(np.float32))[:, 0]
    assert left < middle < right_of_it


def test_unreadable_environments_are_refused(tmp_path: Path):
    (tmp_path / "text.hdr").write_text("no image")
    with pytest.raises(DataError, match=r"text\.hdr"):
        load_hdri(tmp_path / "text.hdr")
    with pytest.raises(DataError, match="no readable"):
        load_hdri(tmp_path / "missing.hdr")
    with pytest.raises(DataError, match=r"no \.hdr file"):
        load_environments(tmp_path / "nowhere")
    with pytest.raises(DataError, match="negative"):
        Environment(np.full((4, 8, 3), -1.0, np.float32), "x")


@pytest.mark.skipif(SHARED is None, reason="HYBRID_SHARED_DATA is not set: no real environments")
def test_real_environments_load():
    environments = load_environments(Path(str(SHARED)) / "hdri")
    assert len(environments) >= 10
    for env in environments:
        assert np.isclose(mean_luminance(env.radiance), 1.0, rtol=1e-3)
