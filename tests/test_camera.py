"""Camera and ray-cast maps: project and unproject, crop and resize commute, maps and backward map agree."""

import numpy as np
import pytest

from hybrid.coords import pixel_centres
from hybrid.mesh.camera import Camera, look_at
from hybrid.mesh.film import film_mesh
from hybrid.mesh.raycast import FilmCaster, true_backward_map


def camera(size=(120, 160), distortion=(0.05, -0.02)):
    f = 1.3 * size[1]
    intrinsics = np.array([[f, 0, size[1] / 2 + 3], [0, f, size[0] / 2 - 2], [0, 0, 1.0]])
    pose = look_at(np.array([60.0, -40.0, -700.0]), np.array([5.0, 0.0, 0.0]), np.array([0.1, 1.0, 0.0]))
    return Camera(intrinsics, pose, distortion, size)


def bent_film():
    mesh = film_mesh((430.0, 350.0), np.linspace(0, 1, 4), np.linspace(0, 1, 5), 3)
    x, y = mesh.vertices[..., 0], mesh.vertices[..., 1]
    return mesh.bent(np.stack([x, y, 30 * np.sin(x / 90) + 12 * np.cos(y / 120)], axis=-1))


def test_a_ray_through_a_projected_point_meets_it():
    cam = camera()
    xyz = np.random.default_rng(0).uniform([-150, -150, 400], [150, 150, 900], (200, 3))
    rays = cam.ray_directions(cam.photo_from_camera(xyz))
    np.testing.assert_allclose(rays * xyz[:, 2:], xyz, atol=1e-3)


def test_resizing_and_cropping_commute_with_projection():
    cam = camera()
    xyz = np.random.default_rng(1).uniform(-100, 100, (50, 3))
    at = cam.photo_from_world(xyz)
    np.testing.assert_allclose(cam.resized((240, 320)).photo_from_world(xyz), 2 * at, atol=1e-9)
    np.testing.assert_allclose(cam.cropped((7, 11), (50, 60)).photo_from_world(xyz), at - [7, 11], atol=1e-9)


def test_look_at_puts_the_target_on_the_axis_and_down_downwards():
    eye, target = np.array([100.0, 50.0, -500.0]), np.array([10.0, -20.0, 30.0])
    pose = look_at(eye, target, np.array([0.0, 1.0, 0.0]))
    seen = pose[:3, :3] @ target + pose[:3, 3]
    np.testing.assert_allclose(seen, [0, 0, np.linalg.norm(target - eye)], atol=1e-9)
    assert (pose[:3, :3] @ [0, 1, 0])[1] > 0.5
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)


def test_maps_agree_with_the_camera_and_the_backward_map():
    cam, film = camera((240, 320)), bent_film()
    maps = FilmCaster(film).annotate(cam)
    centres = pixel_centres(cam.size)[maps.mask]
    assert 0.1 < maps.mask.mean() < 0.9
    np.testing.assert_allclose(cam.photo_from_camera(maps.xyz[maps.mask]), centres, atol=0.05)
    np.testing.assert_allclose(true_backward_map(film, cam).photo_from_film(maps.uv[maps.mask]), centres, atol=0.1)
    assert np.isnan(maps.uv[~maps.mask]).all()
    assert np.isnan(maps.depth[~maps.mask]).all()
    np.testing.assert_allclose(np.linalg.norm(maps.normal[maps.mask], axis=-1), 1, atol=1e-6)  # float32
    assert ((maps.normal * maps.xyz)[maps.mask].sum(axis=-1) < 0).all()  # normals face the camera


def test_the_uv_map_is_the_annotations():
    cam, film = camera(), bent_film()
    mask, uv = FilmCaster(film).uv_map(cam)
    maps = FilmCaster(film).annotate(cam)
    np.testing.assert_array_equal(mask, maps.mask)
    np.testing.assert_allclose(uv[mask], maps.uv[mask], atol=5e-5)  # interpolated to 0.01 px


def test_a_film_read_right_is_not_mirrored():
    backward = true_backward_map(bent_film(), camera())
    assert (np.linalg.det(backward.jacobian(np.random.default_rng(0).random((100, 2)))) > 0).all()
