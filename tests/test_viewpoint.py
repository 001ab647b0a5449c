"""Where the phone is held: in front, far enough, not edge-on; rolled and from behind as often as asked for."""

import json
from dataclasses import replace

import numpy as np
import pytest

from data_gen.camera.viewpoint import LEAST_COSINE, ViewConfig, mean_cosine, sample_camera, view_parameters
from hybrid.backward import Orientation
from hybrid.coords import node_centres_1d
from hybrid.mesh.film import film_mesh
from hybrid.mesh.raycast import true_backward_map

SIZE = (200, 200)
T = node_centres_1d(17)


def bent(depth=40.0):
    mesh = film_mesh((430.0, 350.0), np.linspace(0, 1, 4), np.linspace(0, 1, 5), 3)
    x, y = mesh.vertices[..., 0], mesh.vertices[..., 1]
    return mesh.bent(np.stack([x, y, depth * np.sin(x / 60)], axis=-1))


def views(count, config, film=None):
    film, rng = film or bent(), np.random.default_rng(5)
    cameras = [sample_camera(film, SIZE, rng, config) for _ in range(count)]
    return cameras, [view_parameters(film, c, true_backward_map(film, c, (9, 9))) for c in cameras]


@pytest.mark.parametrize("depth", [0.0, 40.0, 120.0])
def test_views_show_the_film(depth):
    film = bent(depth)
    points, normals = film.surface(T, T).reshape(-1, 3), film.normals(T, T).reshape(-1, 3)
    for camera in views(40, ViewConfig(fov_deg=(60.0, 68.0), tilt_deg=40.0), film)[0]:
        assert camera.camera_points(points)[:, 2].min() > 20.0
        if depth < 100:
            assert abs(mean_cosine(camera, points, normals)) >= LEAST_COSINE
        low, high = camera.photo_from_world(points).min(axis=0), camera.photo_from_world(points).max(axis=0)
        assert (high > 0).all()
        assert (low < SIZE).all()


@pytest.mark.parametrize("depth", [40.0, 120.0])
def test_films_leave_the_frame_only_where_they_may(depth):
    """Turning the phone moves the picture, and what nears a corner grows: neither may push a film out of the frame."""
    film, size = bent(depth), np.array(SIZE[::-1])
    points = film.surface(T, T).reshape(-1, 3)

    def share_leaving(config):
        photos = [camera.photo_from_world(points) / size for camera in views(80, config, film)[0]]
        return np.mean([(photo.min() < 0) | (photo.max() > 1) for photo in photos])

    wide = ViewConfig(fov_deg=(50.0, 68.0))
    assert share_leaving(replace(wide, leave_share=0.0)) == 0
    assert share_leaving(replace(wide, leave_share=1.0)) > 0.4


def test_shares_are_kept():
    _, labels = views(400, ViewConfig(behind_share=0.25, any_roll_share=0.5))
    assert np.mean([v["behind"] for v in labels]) == pytest.approx(0.25, abs=0.07)
    assert np.mean([abs(v["roll_deg"]) > 45 for v in labels]) == pytest.approx(0.5 * 0.75, abs=0.08)


def test_labels_are_the_truth():
    cameras, labels = views(60, ViewConfig(behind_share=0.5, any_roll_share=0.7))
    film = bent()
    for camera, view in zip(cameras, labels, strict=True):
        assert view["mirrored"] == view["behind"]
        backward = true_backward_map(film, camera, (9, 9))
        seen = backward.turned(Orientation(view["turns"], view["mirrored"]).inverse).nodes
        down = (seen[-1] - seen[0]).mean(axis=0)
        assert down[1] > 0
        roll, own = np.deg2rad(view["roll_deg"]), (backward.nodes[-1] - backward.nodes[0]).mean(axis=0)
        np.testing.assert_allclose(own / np.linalg.norm(own), [-np.sin(roll), np.cos(roll)], atol=1e-6)
        assert np.linalg.norm(camera.centre_world - film.surface(T, T).mean(axis=(0, 1))) == pytest.approx(
            view["distance_mm"]
        )
        json.dumps(view)


def test_a_phone_held_straight_is_said_to_be():
    config = replace(ViewConfig(), tilt_deg=0.0, roll_deg=0.0, any_roll_share=0.0, behind_share=0.0, leave_share=0.0)
    for view in views(10, config, bent(0.0))[1]:
        assert abs(view["roll_deg"]) < 3  # panned views are sheared a little
        assert view["turns"] == 0
        assert not view["mirrored"]
