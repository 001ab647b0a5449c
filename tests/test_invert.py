"""Properties of the fit of backward maps to uv maps."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bent_sheets import bent_sheet, maps_of, smooth_noise

from hybrid.backward import BackwardMap, end_point_error
from hybrid.coords import film_nodes
from hybrid.rectify.coarse.homography import apply_homography, fit_homography
from hybrid.rectify.coarse.invert import Inversion, InvertConfig, NotInverted, fit_backward
from hybrid.rectify.splines import bspline

CLEAN_PX = 0.5  # mean error without noise: cost of the spline's knots and the penalty on a sheet rolled by 50 degrees
SHEETS = [(0.0, 0.0), (0.5, 0.3), (0.9, 0.4), (-0.9, -0.4)]


def inverted(maps, config: InvertConfig | None = None) -> Inversion:
    result = fit_backward(maps, config)
    assert isinstance(result, Inversion)
    return result


@pytest.mark.parametrize(("bend", "tilt"), SHEETS)
def test_a_clean_map_is_inverted(bend: float, tilt: float):
    true = BackwardMap.from_function(bent_sheet(bend, tilt=tilt))
    result = inverted(maps_of(true))
    error = end_point_error(result.backward, true.nodes)
    assert error.mean() < CLEAN_PX
    assert error.max() < 5 * CLEAN_PX
    assert result.residual_px < CLEAN_PX
    assert result.coverage > 0.99
    assert result.inlier_share > 0.99


def test_a_plane_sheet_is_exact_to_its_edges():
    true = BackwardMap.from_function(bent_sheet(0.0))
    assert end_point_error(inverted(maps_of(true)).backward, true.nodes).max() < 1e-3


@pytest.mark.parametrize("correlation", [0.0, 2.0])
def test_noise_is_averaged_out(correlation: float):
    rng = np.random.default_rng(1)
    true = BackwardMap.from_function(bent_sheet())
    maps = maps_of(true)
    noise = rng.normal(0, 0.005, (64, 64, 2)) if correlation == 0 else smooth_noise(rng, (64, 64), correlation, 0.005)
    error = end_point_error(inverted(replace(maps, uv=maps.uv + noise)).backward, true.nodes)
    raw_px = 0.005 * np.sqrt(2) * 0.5 * sum(true.mean_film_pixels())
    assert error.mean() < raw_px / (3 if correlation == 0 else 1.2)  # correlated noise looks like shape


def test_a_fifth_of_the_pixels_may_be_wrong():
    rng = np.random.default_rng(2)
    true = BackwardMap.from_function(bent_sheet())
    maps = maps_of(true)
    bad = rng.uniform(size=(64, 64)) < 0.2
    uv = np.where(bad[..., None], rng.uniform(size=(64, 64, 2)), maps.uv)
    mask = maps.mask.copy()
    mask[:5, :8] = 1.0  # and an island of false film
    result = inverted(replace(maps, uv=uv, mask=mask))
    assert end_point_error(result.backward, true.nodes).mean() < 3.0
    assert 0.7 < result.inlier_share < 0.95


def test_a_covered_corner_is_continued_smoothly():
    true = BackwardMap.from_function(bent_sheet(0.5))
    maps = maps_of(true)
    mask = np.where((maps.uv[..., 0] > 0.75) & (maps.uv[..., 1] > 0.75), 0.0, maps.mask)
    result = inverted(replace(maps, mask=mask))
    error = end_point_error(result.backward, true.nodes)
    assert error.max() < 0.02 * sum(true.mean_film_pixels()) / 2
    assert 0.9 < result.coverage < 0.97


def test_moving_and_scaling_the_photo_moves_and_scales_the_map():
    maps = maps_of(BackwardMap.from_function(bent_sheet()))
    moved = replace(maps, photo_points=3.0 * maps.photo_points + np.array([100.0, -50.0]))
    expected = 3.0 * inverted(maps).backward.nodes + np.array([100.0, -50.0])
    np.testing.assert_allclose(inverted(moved).backward.nodes, expected, atol=1e-6)


def test_inputs_are_not_modified():
    maps = maps_of(BackwardMap.from_function(bent_sheet()))
    before = [maps.mask.copy(), maps.uv.copy(), maps.photo_points.copy()]
    fit_backward(maps)
    for array, copy in zip((maps.mask, maps.uv, maps.photo_points), before, strict=True):
        np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize("kind", ["empty", "constant", "nan"])
def test_no_film_is_a_reason_and_not_an_exception(kind: str):
    maps = maps_of(BackwardMap.from_function(bent_sheet()))
    if kind == "empty":
        maps = replace(maps, mask=np.zeros((64, 64)))
    elif kind == "constant":
        maps = replace(maps, uv=np.full((64, 64, 2), 0.5))
    else:
        maps = replace(maps, uv=np.full((64, 64, 2), np.nan))
    result = fit_backward(maps)
    assert isinstance(result, NotInverted)
    assert result.reason


def test_homography_round_trip():
    true = np.array([[1.1, 0.2, -0.4], [-0.1, 0.9, 0.3], [0.15, -0.1, 1.0]])
    uv = film_nodes((5, 5)).reshape(-1, 2)
    found = fit_homography(uv, apply_homography(true, uv), np.ones(len(uv)))
    np.testing.assert_allclose(found / found[2, 2], true, atol=1e-9)


def test_bspline_weights_sum_to_one_and_reproduce_lines():
    t = np.linspace(-0.05, 1.05, 23)
    weights = bspline.axis_weights(t, 8)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    knots = (np.arange(11) - 1.0) / 8
    np.testing.assert_allclose(weights @ knots, t, atol=1e-12)


def test_a_sorted_design_is_the_design_row_for_row():
    uv = np.random.default_rng(0).uniform(-0.02, 1.02, (50, 2))
    uv = uv[bspline.SortedDesign.order(uv, 6)]
    for by_u, by_v in ((0, 0), (1, 0), (0, 1), (1, 1), (0, 2)):
        found, rows = bspline.SortedDesign.of(uv, 6, by_u, by_v), bspline.design(uv, 6, by_u, by_v)
        np.testing.assert_allclose(found.dense, rows, atol=1e-12)
        coefficients = np.random.default_rng(1).normal(0, 1, (81, 3))
        np.testing.assert_allclose(found.values(coefficients), rows @ coefficients, atol=1e-9)


def test_bending_energy_is_that_of_analytic_surfaces():
    uv = film_nodes((40, 40)).reshape(-1, 2)
    rows = bspline.design(uv, 6)
    energy = bspline.bending_energy(6)
    u, v = uv.T
    for values, expected in ((1 + 2 * u - v, 0.0), (u * v, 2.0), (u**2, 4.0), (u**3 - v**2, 16.0)):
        fit = np.linalg.lstsq(rows, values, rcond=None)[0]
        assert fit @ energy @ fit == pytest.approx(expected, abs=1e-8)


@pytest.mark.skipif("HYBRID_SHARED_DATA" not in os.environ, reason="HYBRID_SHARED_DATA names no folder of photos")
def test_true_maps_of_rendered_photos():
    for path in sorted(Path(os.environ["HYBRID_SHARED_DATA"], "photos").glob("*.npz"))[:3]:
        with np.load(path) as data:
            true = BackwardMap(data["lattice"].astype(np.float64))
        assert end_point_error(inverted(maps_of(true.resized((33, 33)))).backward, true.nodes).mean() < CLEAN_PX
