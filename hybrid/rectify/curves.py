"""Curves that run across an image from column to column: found as best paths, refined, checked for smoothness."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from hybrid.rectify.tps import tukey_weights


def best_paths(score: Float[np.ndarray, "b d p"], max_step: int = 2, cost: float = 0.25) -> Int[np.ndarray, "b p"]:
    """For each image, the row of the path from first to last column of the largest sum of scores, less ``cost`` for
    each row stepped."""
    b, d, p = score.shape
    steps = np.arange(-max_step, max_step + 1)
    padded = np.full((b, d + 2 * max_step), -np.inf)
    total = padded[:, max_step : max_step + d]
    total[:] = score[:, :, 0]
    came_from = np.zeros((p, b, d), dtype=np.int8)
    choices = np.empty((len(steps), b, d))
    for column in range(1, p):
        for k, step in enumerate(steps):
            np.subtract(padded[:, max_step + step : max_step + step + d], cost * abs(step), out=choices[k])
        best = came_from[column]
        np.argmax(choices, axis=0, out=(index := np.empty((b, d), dtype=np.intp)))
        best[:] = index
        np.add(choices.max(axis=0), score[:, :, column], out=total)
    path = np.empty((b, p), dtype=np.intp)
    path[:, -1] = np.argmax(total, axis=1)
    rows = np.arange(b)
    for column in range(p - 1, 0, -1):
        path[:, column - 1] = path[:, column] + steps[came_from[column, rows, path[:, column]]]
    return path


def parabola_peak(values: Float[np.ndarray, "d p"]) -> Float[np.ndarray, " p"]:
    """Row, to a fraction, of the largest value in each column, first and last row left out."""
    columns = np.arange(values.shape[1])
    peak = np.argmax(values[1:-1], axis=0) + 1
    left, centre, right = values[peak - 1, columns], values[peak, columns], values[peak + 1, columns]
    curvature = np.minimum(left - 2 * centre + right, -1e-6)
    return peak + np.clip(0.5 * (left - right) / curvature, -0.7, 0.7)


def smooth_curve_weights(
    along: Float[np.ndarray, " p"], depth: Float[np.ndarray, " p"], good: Bool[np.ndarray, " p"], sigma: float
) -> Float[np.ndarray, " p"]:
    """Weights of edge points around a smooth curve (Legendre polynomial of degree 7) through most of them."""
    basis = np.polynomial.legendre.legvander(2.0 * along - 1.0, 7)
    ridge = 1e-3 * np.diag(np.arange(8.0) ** 2)
    weights = good.astype(np.float64)
    if good.sum() < 12:
        return np.zeros(len(along))
    noise = max(sigma, float(np.median(np.abs(depth[good] - np.median(depth[good])))))
    for _ in range(8):
        weighted = basis * weights[:, None]
        fit = basis @ np.linalg.solve(weighted.T @ basis + ridge, weighted.T @ np.where(good, depth, 0.0))
        noise = max(sigma, 0.6 * noise)
        weights = np.where(good, tukey_weights((depth - fit) / noise), 0.0)
    return weights


__all__ = ["best_paths", "parabola_peak", "smooth_curve_weights"]
