"""Phantoms: they vary, repeat for a seed, and look like anatomy in their numbers."""

import time

import numpy as np
import pytest

from data_gen.phantom import body_phantom, head_phantom
from data_gen.volumes import is_body, window

PHANTOMS = [head_phantom, body_phantom]


@pytest.mark.parametrize("phantom", PHANTOMS)
def test_a_seed_repeats_and_another_differs(phantom):
    one, same, other = (phantom(np.random.default_rng(seed), size=64, slices=6) for seed in (1, 1, 2))
    assert np.array_equal(one.hu, same.hu)
    assert one.spacing_mm == same.spacing_mm
    assert not np.array_equal(one.hu, other.hu)


@pytest.mark.parametrize("phantom", PHANTOMS)
@pytest.mark.parametrize("size", [48, 130])
def test_size_and_field_of_view_agree(phantom, size: int):
    volume = phantom(np.random.default_rng(0), size=size, slices=5)
    assert volume.hu.shape == (5, size, size)
    assert 150 < size * volume.spacing_mm[1] < 520
    assert is_body(volume) == (phantom is body_phantom)


@pytest.mark.parametrize("seed", range(4))
def test_head_has_skull_around_brain_around_nothing_denser(seed: int):
    volume = head_phantom(np.random.default_rng(seed), size=128, slices=24)
    heights = np.arange(24) * volume.spacing_mm[0]
    middle = volume.hu[int(np.searchsorted(heights, heights[-1] - 65.0))].astype(float)  # well above the base
    rows, cols = np.nonzero(middle > 700)
    centre = middle[int(rows.mean()) - 8 : int(rows.mean()) + 8, int(cols.mean()) - 8 : int(cols.mean()) + 8]
    assert 0 < np.median(centre) < 80  # brain or a ventricle
    assert 0.02 < (middle > 500).mean() < 0.2  # the skull is a ring
    assert 0.3 < (middle < -800).mean() < 0.85  # air around
    base = volume.hu[6:14]
    assert (base < -900).any()
    assert (base > 900).any()


@pytest.mark.parametrize("seed", range(3))
def test_body_has_lungs_above_and_organs_below(seed: int):
    volume = body_phantom(np.random.default_rng(seed), size=128, slices=20)
    lung = ((volume.hu > -950) & (volume.hu < -700)).mean(axis=(1, 2))
    soft = ((volume.hu > 0) & (volume.hu < 200)).mean(axis=(1, 2))
    assert lung[-1] > lung[0] or lung.max() > 0.1
    assert soft.max() > 0.08
    assert (volume.hu > 400).any(axis=(1, 2)).mean() > 0.8  # spine or ribs nearly everywhere


@pytest.mark.parametrize("phantom", PHANTOMS)
def test_a_window_shows_something_on_every_slice(phantom):
    volume = phantom(np.random.default_rng(3), size=96, slices=12)
    grey = window(volume.hu, 40.0, 350.0)
    assert np.all(grey.std(axis=(1, 2)) > 0.03)


def test_full_size_slices_are_made_quickly():
    start = time.perf_counter()
    head_phantom(np.random.default_rng(0), slices=8)
    assert time.perf_counter() - start < 3.0  # 0.15 s where nothing else runs and shapes are not checked
