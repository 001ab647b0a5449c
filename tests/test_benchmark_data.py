"""The benchmarks of the data set: consistency catches wrong maps; rates are measured and written."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.consistency import Truth, errors_of, summary
from benchmarks.data_rate import open3d_peak, parts
from data_gen.sample import SampleConfig, film_samples
from data_gen.sources import SourceConfig

CONFIG = SampleConfig(size=96, map_size=96, photos_per_film=1, sources=SourceConfig(phantoms=(0, 1)))


@pytest.fixture(scope="module")
def truth():
    s = next(film_samples(1, 0, CONFIG))
    return Truth(s.maps.mask, s.maps.uv, s.maps.xyz, s.backward, s.camera, s.size_mm)


def half_and_back(values):
    """A map resized bilinearly to half and back, with pixels off the film treated as film at 0."""
    h, w = values.shape[:2]
    filled = np.nan_to_num(values).astype(np.float32)
    half = cv2.resize(filled, (w // 2, h // 2), interpolation=cv2.INTER_LINEAR)
    return cv2.resize(half, (w, h), interpolation=cv2.INTER_LINEAR)


def test_true_maps_agree(truth):
    figures = summary([errors_of(truth)])
    assert figures["projection_max_px"] < 0.05
    assert figures["inverse_max_px"] < 0.1
    assert figures["edge_pixels"] > 50
    assert figures["mixed_pixels"] == 0


@pytest.mark.parametrize("name", ["uv", "xyz"])
def test_maps_mixed_at_the_edge_are_caught(truth, name):
    mixed = np.where(truth.mask[..., None], half_and_back(getattr(truth, name)), np.nan)
    found = errors_of(replace(truth, **{name: mixed}))
    assert found.mixed > 0.2 * found.edge


def test_depth_mixed_with_background_is_caught_though_it_stays_on_its_ray(truth):
    """The rim's pixels are moved to two thirds of their depth: projection does not notice."""
    inner = cv2.erode(truth.mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    rim = truth.mask & ~inner
    found = errors_of(replace(truth, xyz=np.where(rim[..., None], truth.xyz * np.float32(2 / 3), truth.xyz)))
    assert found.projection.max() < 0.05
    assert found.mixed > 0.5 * found.edge


def test_maps_shifted_by_a_pixel_are_not_inverse(truth):
    shifted = np.roll(truth.uv, 1, axis=1)
    both = truth.mask & np.isfinite(shifted).all(axis=-1)
    assert np.median(errors_of(replace(truth, mask=both, uv=shifted)).inverse) > 0.9


def test_parts_make_up_the_whole_and_rays_are_counted():
    figures = parts(replace(CONFIG, photos_per_film=2), 1)
    assert figures["samples"] == 2
    assert all(seconds > 0 for seconds in figures["seconds_by_part"].values())
    assert figures["seconds_by_part"]["rest"] < 0.5 * figures["seconds"]
    assert figures["rays"] > 96 * 96 / 4
    json.dumps(figures)
    assert open3d_peak(2500) > figures["mray_per_s"] / 50
