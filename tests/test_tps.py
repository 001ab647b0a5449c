"""Laws of the thin-plate spline: interpolation, least bending, invariance, robustness, refusal."""

import numpy as np
import pytest
import torch
from kornia.geometry.transform import get_tps_transform, warp_points_tps
from scipy.interpolate import RBFInterpolator

from hybrid.coords import film_nodes
from hybrid.rectify.splines.tps import SplineError, choose_smoothing, fit_tps, fit_tps_robust, lattice_spline, mad_sigma

EXACT = 1e-9
"""Error of dense solves of up to 150 unknowns in float64."""


def wave(points: np.ndarray) -> np.ndarray:
    x, y = points[:, 0], points[:, 1]
    return np.column_stack([np.sin(2.1 * x) + 0.3 * y * x, np.cos(1.7 * y) - 0.2 * x**2])


@pytest.fixture
def scattered() -> tuple[np.ndarray, np.ndarray]:
    points = np.random.default_rng(0).uniform(-1, 2, (40, 2))
    return points, wave(points)


def test_interpolates_and_agrees_with_scipy(scattered):
    points, values = scattered
    spline = fit_tps(points, values)
    assert np.abs(spline(points) - values).max() < EXACT
    elsewhere = np.random.default_rng(1).uniform(-1, 2, (200, 2))
    scipy = RBFInterpolator(points, values, kernel="thin_plate_spline", smoothing=0)
    assert np.abs(spline(elsewhere) - scipy(elsewhere)).max() < EXACT


def test_agrees_with_kornia_at_the_points_and_bends_less_between_them(scattered):
    points, values = scattered
    kernel, affine = get_tps_transform(torch.as_tensor(points)[None], torch.as_tensor(values)[None])
    warp = warp_points_tps(torch.as_tensor(points)[None], torch.as_tensor(values)[None], kernel, affine)[0].numpy()
    spline = fit_tps(points, values)
    assert np.abs(warp - spline(points)).max() < 1e-6  # kornia solves its system without normalising
    # kornia's spline, sampled densely, is one of the functions through the same values
    grid = film_nodes((12, 12)).reshape(-1, 2) * 3 - 1
    both = np.vstack([points, grid])
    kornia_values = warp_points_tps(torch.as_tensor(both)[None], torch.as_tensor(values)[None], kernel, affine)[0]
    through_both = fit_tps(both, kornia_values.numpy())
    scale = (through_both.scale / spline.scale) ** 2
    assert spline.bending_energy() * scale <= through_both.bending_energy() * (1 + 1e-6)


def test_affine_maps_are_reproduced_without_bending(scattered):
    points, _ = scattered
    values = points @ np.array([[1.2, -0.3], [0.4, 0.9]]) + np.array([3.0, -7.0])
    for smoothing in (0.0, 1e3):
        spline = fit_tps(points, values, smoothing)
        assert np.abs(spline(3 * points) - (3 * points @ [[1.2, -0.3], [0.4, 0.9]] + [3.0, -7.0])).max() < 1e-7
        assert spline.bending_energy() < EXACT


def test_turning_scaling_and_shifting_the_points_changes_nothing(scattered):
    points, values = scattered
    turn = 250 * np.array([[np.cos(1), -np.sin(1)], [np.sin(1), np.cos(1)]])
    plain, turned = fit_tps(points, values), fit_tps(points @ turn + 900, values)
    assert np.abs(plain(points[:9] + 0.1) - turned((points[:9] + 0.1) @ turn + 900)).max() < 1e-8


def test_bending_falls_with_smoothing_and_residual_grows(scattered):
    points, values = scattered
    splines = [fit_tps(points, values, s) for s in (0.0, 1e-3, 1e-1, 1e1)]
    assert np.all(np.diff([s.bending_energy() for s in splines]) < 0)
    assert np.all(np.diff([s.residuals(points, values).mean() for s in splines]) > 0)


def test_cross_validation_beats_interpolating_noise():
    rng = np.random.default_rng(2)
    points = rng.uniform(0, 1, (150, 2))
    noisy = wave(points) + rng.normal(0, 0.05, (150, 2))
    elsewhere = rng.uniform(0.05, 0.95, (200, 2))
    smooth = fit_tps(points, noisy, choose_smoothing(points, noisy))
    error = smooth.residuals(elsewhere, wave(elsewhere)).mean()
    assert error < 0.5 * fit_tps(points, noisy).residuals(elsewhere, wave(elsewhere)).mean()


def test_a_precise_observation_outweighs_vague_ones(scattered):
    points, values = scattered
    sigma = np.full(len(points), 10.0)
    sigma[3] = 1e-4
    wrong = values.copy()
    wrong[3] += 1.0
    residuals = fit_tps(points, wrong, 1.0, sigma).residuals(points, wrong)
    assert residuals[3] < 1e-3


def test_duplicates_are_averaged(scattered):
    points, values = scattered
    doubled = fit_tps(np.vstack([points, points[:5]]), np.vstack([values, values[:5] + 0.2]))
    assert np.abs(doubled(points[:5]) - values[:5] - 0.1).max() < EXACT
    assert np.abs(doubled(points[5:]) - values[5:]).max() < EXACT


@pytest.mark.parametrize("apart", [1e-12, 1e-9, 1e-7, 1e-5])
def test_points_that_all_but_coincide_do_not_blow_up(scattered, apart):
    points, values = scattered
    twins = points[:9] + apart * np.random.default_rng(4).normal(size=(9, 2))
    doubled = fit_tps(np.vstack([points, twins]), np.vstack([values, values[:9] + 0.2]))
    assert doubled.residuals(points[9:], values[9:]).max() < 1e-5  # a slope of 2e4 between twins costs digits
    assert doubled.residuals(points[:9], values[:9]).max() < 0.1 * np.sqrt(2) + 1e-6
    with pytest.raises(SplineError, match="on a line"):
        fit_tps(np.repeat([[0.0, 0.0], [1.0, 0.5]], 3, axis=0) + 1e-8 * np.eye(6)[:, :2], np.ones((6, 2)))


@pytest.mark.parametrize("seed", range(4))
def test_robust_fit_survives_30_percent_outliers(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (120, 2))
    values = wave(points) + rng.normal(0, 0.005, (120, 2))
    bad = rng.permutation(120)[:36]
    values[bad] += rng.normal(0, 1.0, (36, 2))
    spline = fit_tps_robust(points, values, smoothing=30.0, sigma=0.005)
    inside = rng.uniform(0.1, 0.9, (200, 2))
    good = np.setdiff1d(np.arange(120), bad)
    told = fit_tps(points[good], values[good], 30.0, np.full(84, 0.005))  # knows the outliers
    assert spline.residuals(inside, wave(inside)).mean() < 1.2 * told.residuals(inside, wave(inside)).mean() + 0.002


@pytest.mark.parametrize(
    ("points", "values", "match"),
    [
        (np.eye(2), np.eye(2), "2 points"),
        (np.outer(np.arange(9.0), [1.0, 2.0]), np.ones((9, 2)), "on a line"),
        (np.full((5, 2), np.nan), np.ones((5, 2)), "NaN"),
        (np.ones((5, 2)), np.ones((5, 2)), "on a line"),
    ],
)
def test_impossible_input_is_refused_with_a_reason(points, values, match):
    with pytest.raises(SplineError, match=match):
        fit_tps(points, values)


@pytest.mark.parametrize("count", [1, 2, 7, 1000])
def test_the_spread_is_that_of_numpys_median(count):
    residuals = np.random.default_rng(count).normal(size=count)
    assert mad_sigma(residuals) == pytest.approx(1.4826 * np.median(np.abs(residuals)))


def test_lattice_spline_is_the_spline_through_its_node_values():
    lattice = lattice_spline((6, 5))
    values = wave(lattice.nodes)
    spline = fit_tps(lattice.nodes, values)
    elsewhere = np.random.default_rng(3).uniform(-0.1, 1.1, (50, 2))
    assert np.abs(lattice.rows(elsewhere) @ values - spline(elsewhere)).max() < EXACT
    energy = sum(values[:, k] @ lattice.bending @ values[:, k] for k in range(2))
    assert energy == pytest.approx(spline.bending_energy() / spline.scale**2, rel=1e-9)
