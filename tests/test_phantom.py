"""Phantoms: they vary, repeat for a seed, and resemble anatomy in their numbers."""

import cv2
import numpy as np
import pytest

from data_gen.ct.phantom import body_phantom, head_phantom
from data_gen.ct.scanner import Rest, Scanner, draw_rest, scan
from data_gen.ct.shapes import Blob, Solid, Tube, paint, random_warp
from data_gen.ct.volumes import is_body, reformatted, tissue_width_mm
from data_gen.prints.prints import PrintConfig
from data_gen.prints.slices import random_look
from hybrid.coords import centres_1d

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


@pytest.mark.parametrize("phantom", PHANTOMS)
@pytest.mark.parametrize("plane", ["coronal", "sagittal"])
@pytest.mark.parametrize("seed", range(3))
def test_in_other_planes_it_is_as_wide_as_before_and_shown_whole(phantom, plane, seed: int):
    volume = phantom(np.random.default_rng(seed), size=128, slices=24)
    cut = reformatted(volume, plane)
    assert is_body(cut) == (phantom is body_phantom)
    assert abs(tissue_width_mm(cut) - tissue_width_mm(volume)) < 4 * 4 * volume.spacing_mm[1]  # four coarse voxels
    looks = [random_look(np.random.default_rng(k), cut, PrintConfig()) for k in range(40)]
    assert not any(look.round_field for look in looks)  # a round field is a circle around the patient's axis
    assert any(random_look(np.random.default_rng(k), volume, PrintConfig()).round_field for k in range(40))


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
    grey = np.clip((volume.hu.astype(np.float32) - (40.0 - 175.0)) / 350.0, 0.0, 1.0)
    assert np.all(grey.std(axis=(1, 2)) > 0.03)


SOLIDS = [
    Blob((12, -20, 4), (15, 30, 12), 50.0, 0.7),
    Blob((-30, 5, -6), (8, 8, 20), 50.0, 0.0, 900.0, 2.0),
    Blob((40, 40, 14), (12, 9, 6), 50.0, -0.3, rough_mm=1.0),
    Tube((-40, -40, -20), (30, 10, 25), 4.0, 50.0, 900.0, 1.0),
    Tube((0, 50, -8), (25, 45, 8), 3.0, 50.0, flat=2.0),
]


@pytest.mark.parametrize("solid", SOLIDS)
@pytest.mark.parametrize("seed", range(4))
def test_nothing_of_a_solid_lies_outside_its_window(solid: Solid, seed: int):
    """On tilted, warped slices too: painting only inside the window misses nothing of the solid."""
    rng = np.random.default_rng(seed)
    warp, axis = random_warp(rng, 4.0, 120.0, 0.15), (centres_1d(80) - 40) * 2.0
    for z_mm in (-14.0, 0.0, 11.0):
        plane = warp.plane(axis, axis, z_mm, rng.standard_normal((80, 80)).clip(-3, 3).astype(np.float32))
        touched = plane.distance(solid) + solid.rough_mm * plane.rough < solid.shell_mm + 0.4
        window = plane.window(solid)
        if window is not None:
            touched[window] = False
        assert not touched.any()


def test_distances_are_zero_on_the_surface_and_lengths_beside_a_tube():
    blob, tube = Blob((1, 2, 3), (10, 20, 30), 0.0), Tube((0, 0, 0), (10, 0, 0), 2.0, 0.0)
    angle = np.linspace(0, 6, 9, dtype=np.float32)[None]
    rim = (1 + 10 * np.cos(angle), 2 + 20 * np.sin(angle), np.full_like(angle, 3))
    assert np.abs(blob.distance(*rim)).max() < 1e-4
    x, y, z = (np.array([[v]], np.float32) for v in (5, 7, 0))
    assert np.isclose(tube.distance(x, y, z)[0, 0], 5.0)
    assert np.isclose(tube.mirrored().distance(-x, y, z)[0, 0], 5.0)


def test_the_warp_moves_no_point_further_than_it_says():
    warp, axis = random_warp(np.random.default_rng(0), 5.0, 150.0, 0.1), (centres_1d(60) - 30) * 4.0
    plane = warp.plane(axis, axis, 20.0, np.zeros((60, 60), np.float32))
    x, y = np.meshgrid(axis, axis)
    turned = np.tensordot(warp.rotation, np.stack([x, y, np.full_like(x, 20.0)]), axes=1)
    assert np.abs(np.stack([plane.x, plane.y, plane.z]) - turned).max() <= plane.slack_mm + 1e-3


def test_the_scanner_adds_the_noise_that_it_says_and_keeps_the_mean():
    water = np.full((200, 200), 40.0, np.float32)
    got = scan(water, np.random.default_rng(0), Scanner(12.0, 0.6, 0.5, 0.0, 0.0)).astype(float)
    assert abs(got.mean() - 40.0) < 0.5
    assert np.isclose(got.std(), 12.0, rtol=0.03)
    along = np.corrcoef(got[:, :-1].ravel(), got[:, 1:].ravel())[0, 1]
    assert 0.1 < along < 0.8  # grain, not independent pixels


@pytest.mark.parametrize("kind", ["cradle", "flat", "sides"])
def test_rests_are_drawn_in_air_only(kind: str):
    canvas = np.full((100, 100), -1000.0, np.float32)
    canvas[:, :50] = 50.0
    axis = (centres_1d(100) - 50) * 2.5
    draw_rest(canvas, axis, axis, Rest(kind, 60.0, 120.0, 90.0, 2.0, 12.0, -900.0))
    assert np.all(canvas[:, :50] == 50.0)
    assert (canvas[:, 50:] > -500).any()


def test_paint_leaves_a_soft_rim_around_the_solid():
    axis = centres_1d(64) - 32
    plane = random_warp(np.random.default_rng(0), 0.0, 100.0, 0.0).plane(
        axis, axis, 0.0, np.zeros((64, 64), np.float32)
    )
    canvas = np.zeros((64, 64), np.float32)
    paint(canvas, plane, Blob((0, 0, 0), (20, 20, 20), 100.0))
    assert abs(canvas.sum() / 100.0 - np.pi * 400) < 8  # the area of its middle slice
    assert ((canvas > 0) & (canvas < 100)).any()


@pytest.mark.parametrize("seed", range(3))
def test_brain_shows_fluid_white_and_grey_matter(seed: int):
    """With the grain blurred away, the middle slices hold all three, none of them as a mere trace."""
    volume = head_phantom(np.random.default_rng(seed), size=128, slices=16)
    heights = np.arange(16) * volume.spacing_mm[0]
    soft = np.stack(
        [cv2.GaussianBlur(s.astype(np.float32), (0, 0), 1.0) for s in volume.hu[heights > heights[-1] - 90]]
    )
    brain = soft[(soft > 0) & (soft < 60)]
    for low, high in ((0, 20), (23, 32), (33, 45)):
        assert 0.02 < ((brain > low) & (brain < high)).mean() < 0.9
