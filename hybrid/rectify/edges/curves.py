"""Curves that run across an image from column to column: found as best paths, refined, checked for smoothness."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from hybrid.rectify.splines.tps import tukey_weights


def best_paths(score: Float[np.ndarray, "b d p"], max_step: int = 2, cost: float = 0.25) -> Int[np.ndarray, "b p"]:
    """For each image, the rows of the path from the first to the last column with the largest sum of scores, less
    ``cost`` for each row stepped."""
    b, d, p = score.shape
    columns = np.ascontiguousarray(np.moveaxis(score, 2, 0))
    price = cost * np.abs(np.arange(-max_step, max_step + 1))[:, None]
    # Best sum of a path from the first column to each place; rows beyond the image are never worth a step.
    sums = np.full((p, b, d + 2 * max_step), -np.inf)
    inner = sums[:, :, max_step : max_step + d]
    inner[0] = columns[0]
    came = np.lib.stride_tricks.sliding_window_view(sums, d, axis=2)  # the previous sums, for each step
    worth = np.empty((p, b, 2 * max_step + 1, d))
    for column in range(1, p):
        np.subtract(came[column - 1], price, out=worth[column])
        np.maximum.reduce(worth[column], axis=1, out=inner[column])
        inner[column] += columns[column]
    path = np.empty((p, b), dtype=np.intp)
    path[-1] = inner[-1].argmax(axis=1)
    image = np.arange(b)
    for column in range(p - 1, 0, -1):
        path[column - 1] = path[column] + worth[column, image, :, path[column]].argmax(axis=1) - max_step
    return np.ascontiguousarray(path.T)


def parabola_peak(values: Float[np.ndarray, "d p"]) -> Float[np.ndarray, " p"]:
    """Row, to a fraction, of the largest value in each column, except in the first and last row."""
    columns = np.arange(values.shape[1])
    peak = np.argmax(values[1:-1], axis=0) + 1
    left, centre, right = values[peak - 1, columns], values[peak, columns], values[peak + 1, columns]
    curvature = np.minimum(left - 2 * centre + right, -1e-6)
    return peak + np.clip(0.5 * (left - right) / curvature, -0.7, 0.7)


def smooth_curve_weights(
    along: Float[np.ndarray, " p"],
    depth: Float[np.ndarray, "b p"],
    good: Bool[np.ndarray, "b p"],
    sigma: Float[np.ndarray, " b"],
) -> Float[np.ndarray, "b p"]:
    """Weights of the points of b curves, each judged against a smooth curve (Legendre polynomial of degree 7) through
    most of its good points; 0 where a curve has too few of them. sigma: noise of a good point of each curve."""
    basis = np.polynomial.legendre.legvander(2.0 * along - 1.0, 7)
    products = (basis[:, :, None] * basis[:, None, :]).reshape(len(along), -1)
    ridge = np.diag(np.maximum(1e-3 * np.arange(8.0) ** 2, 1e-9))  # solvable even where every point is an outlier
    enough = good.sum(axis=1) >= 12
    good = good & enough[:, None]
    depth = np.where(good, depth, 0.0)
    centred = np.abs(depth - _medians(depth, good)[:, None])
    noise = np.maximum(sigma, _medians(centred, good))
    weights = good.astype(np.float64)
    # A curve without points gets the zero polynomial instead of a singular system.
    ridge = ridge + np.where(enough, 0.0, 1.0)[:, None, None] * np.eye(8)
    for _ in range(8):
        normal = (weights @ products).reshape(-1, 8, 8) + ridge
        fit = np.linalg.solve(normal, ((weights * depth) @ basis)[..., None])[..., 0] @ basis.T
        noise = np.maximum(sigma, 0.6 * noise)
        weights = np.where(good, tukey_weights((depth - fit) / noise[:, None]), 0.0)
    return weights


def _medians(values: Float[np.ndarray, "b p"], good: Bool[np.ndarray, "b p"]) -> Float[np.ndarray, " b"]:
    """Median of the good values of each row; 0 where there are none."""
    ordered, row, count = np.sort(np.where(good, values, np.inf), axis=1), np.arange(len(values)), good.sum(axis=1)
    middle = 0.5 * (ordered[row, np.maximum(count - 1, 0) // 2] + ordered[row, count // 2])
    return np.where(count > 0, middle, 0.0)


__all__ = ["best_paths", "parabola_peak", "smooth_curve_weights"]
