"""Samples: seed in, same bytes out; every map consistent with every other."""

import cv2
import numpy as np
import pytest

from data_gen.sample import SampleConfig, film_samples
from hybrid.coords import pixel_centres, rescale_points

CONFIG = SampleConfig(size=96, map_size=64, photos_per_film=2)


@pytest.fixture(scope="module")
def samples():
    return list(film_samples(3, 1, CONFIG))


def test_a_seed_gives_the_same_bytes(samples):
    again = list(film_samples(3, 1, CONFIG))
    assert [s.photo for s in again] == [s.photo for s in samples]
    np.testing.assert_array_equal(again[1].maps.uv, samples[1].maps.uv)
    assert samples[0].photo != samples[1].photo


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
