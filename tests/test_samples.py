"""Samples: seed in, same bytes out; every map consistent with every other."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from surroundings_case import FILM

from data_gen.light.lighting import smallest_rotation
from data_gen.lit_films import lit_film
from data_gen.sample import SampleConfig, film_samples
from data_gen.scene.scene import placed
from data_gen.sources import SourceConfig
from hybrid.coords import pixel_centres, rescale_points
from hybrid.mesh.recipes import bend

CONFIG = SampleConfig(size=96, map_size=64, photos_per_film=2)


@pytest.fixture(scope="module")
def samples():
    return list(film_samples(3, 1, CONFIG))


def test_a_seed_gives_the_same_bytes(samples):
    again = list(film_samples(3, 1, CONFIG))
    assert [s.photo for s in again] == [s.photo for s in samples]
    np.testing.assert_array_equal(again[1].maps.uv, samples[1].maps.uv)
    assert samples[0].photo != samples[1].photo


def test_a_photos_size_changes_nothing_of_what_is_photographed(samples):
    larger = list(film_samples(3, 1, replace(CONFIG, size=128)))
    for one, other in zip(samples, larger, strict=True):
        for name in ("material", "lens", "backdrop", "things", "shadows", "onlookers", "frame"):
            assert one.parameters[name] == other.parameters[name]
        np.testing.assert_allclose(one.camera.centre_world, other.camera.centre_world, atol=1e-6)


def test_uv_and_backward_map_are_inverse(samples):
    for sample in samples:
        centres = rescale_points(pixel_centres((64, 64)), (64, 64), sample.camera.size)[sample.maps.mask]
        off = sample.backward.photo_from_film(sample.maps.uv[sample.maps.mask]) - centres
        assert np.abs(off).max() < 0.1


def test_points_project_to_their_pixels(samples):
    for sample in samples:
        centres = rescale_points(pixel_centres((64, 64)), (64, 64), sample.camera.size)[sample.maps.mask]
        off = sample.camera.photo_from_camera(sample.maps.xyz[sample.maps.mask]) - centres
        assert np.abs(off).max() < 0.05


def test_grid_vertices_are_the_same_in_every_frame(samples):
    for sample in samples:
        in_photo = sample.backward.photo_from_film(sample.grid_film)
        np.testing.assert_allclose(in_photo, sample.grid_photo, atol=0.05)
        np.testing.assert_allclose(sample.camera.photo_from_camera(sample.grid_camera), sample.grid_photo, atol=1e-6)


def test_no_value_where_there_is_no_film(samples):
    for sample in samples:
        off = ~sample.maps.mask
        for values in (sample.maps.uv, sample.maps.xyz, sample.maps.normal, sample.albedo):
            assert np.isnan(values[off]).all()
            assert np.isfinite(values[~off]).all()


def test_photos_are_pictures_of_the_right_size(samples):
    photo = cv2.imdecode(np.frombuffer(samples[0].photo, np.uint8), cv2.IMREAD_COLOR)
    assert photo.shape == (96, 96, 3)
    assert np.ptp(photo) > 20


# ---------------------------------------------------------------- where the film is


def carried(frames):
    """The frames with their films as ``placed`` puts them, and with the same films moved far off and turned over."""
    turn = smallest_rotation(np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, -0.8]))
    films = [placed(frame.mesh) for frame in frames]
    moved = [film.bent(film.vertices @ turn.T + [900.0, -400.0, 1500.0]) for film in films]
    return tuple([replace(f, mesh=m) for f, m in zip(frames, meshes, strict=True)] for meshes in (films, moved))


def taken() -> np.ndarray:
    codes = [np.frombuffer(one.photo, np.uint8) for one in film_samples(3, 1, CONFIG)]
    return np.stack([np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR)) for code in codes])


def lit() -> np.ndarray:
    return lit_film(3, 1, 2, SourceConfig()).photos


@pytest.mark.parametrize(("module", "photos"), [("sample", taken), ("lit_films", lit)])
def test_a_film_that_is_carried_off_is_photographed_as_one_that_is_not(module, photos, monkeypatch):
    """Room, lamps, light box and table surround it as they otherwise would."""
    shown = []
    for k in range(2):
        monkeypatch.setattr(f"data_gen.{module}.bend", lambda *given, k=k: ("any", carried(bend(*given)[1])[k]))
        shown.append(photos().astype(int))
    assert np.abs(shown[0] - shown[1]).mean() < 0.2


def test_placing_a_film_does_not_bend_it():
    film, at = FILM.bent(FILM.vertices + [0.0, 0.0, 30.0] * (FILM.vertices[..., :1] / 100) ** 2), np.array([0, 0, 1.0])
    turn = smallest_rotation(at, np.array([0.6, 0.0, -0.8]))
    still, turned = placed(film), placed(film.bent(film.vertices @ turn.T + [900.0, -400.0, 1500.0]))
    np.testing.assert_allclose(turned.vertices, still.vertices, atol=1e-9)
    np.testing.assert_allclose(still.edge_strain(), film.edge_strain(), atol=1e-12)
    np.testing.assert_allclose(still.vertices.mean(axis=(0, 1)), 0, atol=1e-9)
    np.testing.assert_allclose(placed(FILM).vertices, FILM.vertices, atol=1e-9)
