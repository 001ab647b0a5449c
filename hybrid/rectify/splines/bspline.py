"""Regularised tensor-product cubic B-splines over the film's unit square, fitted to scattered points.

The spline has ``intervals`` equal knot intervals along each axis, so ``(intervals + 3)^2`` coefficients: few enough
that the normal equations are a small dense matrix. Coefficients are ordered row (v) first. Outside [0, 1] the
polynomial of the nearest interval continues, so that points a little beyond the edge may be used.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import get_lapack_funcs

from hybrid.coords import node_centres_1d

RIDGE = 1e-10
"""Relative to the mean diagonal: keeps the factorisation possible where an affine part is unobserved."""


_PIECES = np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6.0
"""The four cubic B-splines on a knot interval. Each column holds the coefficients of the powers of the place in it."""


@cache
def _pieces(derivative: int) -> Float[np.ndarray, "p 4"]:
    """The same for their derivatives."""
    return np.polynomial.polynomial.polyder(_PIECES, derivative)


def knot_interval(t: Float[np.ndarray, " n"], intervals: int) -> Int[np.ndarray, " n"]:
    """The knot interval nearest to each coordinate: also the index of the first of the four coefficients that count
    there."""
    # np.clip takes three times as long
    return np.minimum(np.maximum((t * intervals).astype(np.intp), 0), intervals - 1)


def local_weights(
    t: Float[np.ndarray, " n"], intervals: int, derivative: int = 0
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 4"]]:
    """Index of the first of the four coefficients of one axis that count at coordinates ``t``, and the weights of all
    four in the value, or in the first or second derivative."""
    first = knot_interval(t, intervals)
    powers = np.ones((4 - derivative, len(t)))
    np.subtract(t * intervals, first, out=powers[1])
    for k in range(2, len(powers)):
        np.multiply(powers[k - 1], powers[1], out=powers[k])
    return first, powers.T @ (_pieces(derivative) * float(intervals) ** derivative)


def axis_weights(t: Float[np.ndarray, " n"], intervals: int, derivative: int = 0) -> Float[np.ndarray, "n k"]:
    """Weights of the ``intervals + 3`` coefficients of one axis in the value or a derivative at coordinates ``t``."""
    first, local = local_weights(t, intervals, derivative)
    weights = np.zeros((len(t), intervals + 3))
    weights.ravel()[(np.arange(len(t)) * (intervals + 3) + first)[:, None] + np.arange(4)] = local
    return weights


def design(uv: Float[np.ndarray, "n 2"], intervals: int, by_u: int = 0, by_v: int = 0) -> Float[np.ndarray, "n kk"]:
    """Rows that give the spline's value, or a derivative, at film points ``uv`` from its coefficients."""
    along_u, along_v = axis_weights(uv[:, 0], intervals, by_u), axis_weights(uv[:, 1], intervals, by_v)
    return (along_v[:, :, None] * along_u[:, None, :]).reshape(len(uv), (intervals + 3) ** 2)


@dataclass(frozen=True, eq=False)
class SortedDesign:
    """Weights of a spline's coefficients at points that are sorted by the knot interval of v.

    Only four rows of coefficients count in an interval. weights: of the coefficients in these rows, row by row.
    starts: for each interval, the number of points in the intervals before it; then the number of all points.
    """

    weights: Float[np.ndarray, "n k4"]
    starts: tuple[int, ...]

    @property
    def width(self) -> int:
        """Number of coefficients in a row, and of rows."""
        return len(self.starts) + 2

    @staticmethod
    def order(uv: Float[np.ndarray, "n 2"], intervals: int) -> Int[np.ndarray, " n"]:
        """Indices that sort film points in this way."""
        return np.argsort(knot_interval(uv[:, 1], intervals), kind="stable")

    @staticmethod
    def of(uv: Float[np.ndarray, "n 2"], intervals: int, by_u: int = 0, by_v: int = 0) -> SortedDesign:
        """Weights in the spline's value, or in a derivative, at points in that order."""
        first, along_v = local_weights(uv[:, 1], intervals, by_v)
        along_u = axis_weights(uv[:, 0], intervals, by_u)
        weights = (along_v[:, :, None] * along_u[:, None, :]).reshape(len(uv), 4 * (intervals + 3))
        return SortedDesign(weights, tuple(np.searchsorted(first, np.arange(intervals + 1)).tolist()))

    def parts(self) -> Iterator[tuple[slice, slice]]:
        """For each interval, the points in it and the coefficients that count there."""
        for i, (start, end) in enumerate(pairwise(self.starts)):
            yield slice(start, end), slice(i * self.width, (i + 4) * self.width)

    def values(self, coefficients: Float[np.ndarray, "kk c"]) -> Float[np.ndarray, "n c"]:
        """Values of the spline with these coefficients."""
        values = np.empty((len(self.weights), coefficients.shape[1]))
        for points, near in self.parts():
            np.matmul(self.weights[points], coefficients[near], out=values[points])
        return values

    @cached_property
    def dense(self) -> Float[np.ndarray, "n kk"]:
        """The weights of all coefficients: quicker where a few points are evaluated again and again."""
        dense = np.zeros((len(self.weights), self.width**2))
        for points, near in self.parts():
            dense[points, near] = self.weights[points]
        return dense


@cache
def _axis_gram(intervals: int, derivative: int) -> np.ndarray:
    """Integral over [0, 1] of products of the B-splines' derivatives (exact: Gauss-Legendre, 4 points a knot)."""
    nodes, gauss = np.polynomial.legendre.leggauss(4)
    starts = np.arange(intervals)[:, None]
    t = ((starts + (nodes + 1.0) / 2.0) / intervals).ravel()
    weight = np.tile(gauss / 2.0 / intervals, intervals)
    values = axis_weights(t, intervals, derivative)
    return values.T @ (weight[:, None] * values)


@cache
def bending_energy(intervals: int) -> np.ndarray:
    """Quadratic form (kk, kk) of the thin-plate energy: integral of F_uu^2 + 2 F_uv^2 + F_vv^2 over the film."""
    value, slope, bend = (_axis_gram(intervals, d) for d in (0, 1, 2))
    energy = np.kron(value, bend) + 2.0 * np.kron(slope, slope) + np.kron(bend, value)
    energy.setflags(write=False)
    return energy


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """A weighted least squares problem, reduced to the size of the spline: to be solved for several smoothings."""

    matrix: Float[np.ndarray, "kk kk"]
    right: Float[np.ndarray, "kk c"]
    intervals: int

    @staticmethod
    def of(
        rows: Float[np.ndarray, "n kk"],
        weights: Float[np.ndarray, " n"],
        values: Float[np.ndarray, "n c"],
        intervals: int,
    ) -> NormalEquations:
        """The problem of finding the spline with these ``rows`` (from ``design``) that comes closest to ``values``."""
        root = np.sqrt(weights / weights.sum())[:, None]
        scaled = rows * root  # the same array on both sides: BLAS then forms only half of the symmetric product
        return NormalEquations(scaled.T @ scaled, scaled.T @ (values * root), intervals)

    def solve(self, smoothing: float) -> Float[np.ndarray, "kk c"]:
        """Coefficients that minimise the weighted mean squared residual plus ``smoothing`` times the bending energy."""
        matrix = self.matrix + smoothing * bending_energy(self.intervals)
        matrix[np.diag_indices_from(matrix)] += RIDGE * np.trace(matrix) / len(matrix)
        (posv,) = get_lapack_funcs(("posv",), (matrix,))
        _, solution, info = posv(matrix, self.right, lower=1, overwrite_a=1)
        if info != 0:
            raise np.linalg.LinAlgError(f"bspline.solve: the normal equations are singular (posv: {info})")
        return solution


def on_lattice(coefficients: Float[np.ndarray, "kk c"], size: tuple[int, int], intervals: int) -> np.ndarray:
    """Values (gh, gw, c) of the spline on a lattice of ``size`` (rows, columns) nodes, film edges included."""
    along_v = axis_weights(node_centres_1d(size[0]), intervals)
    along_u = axis_weights(node_centres_1d(size[1]), intervals)
    control = coefficients.reshape(intervals + 3, intervals + 3, -1)
    return np.einsum("ia,abc,jb->ijc", along_v, control, along_u, optimize=True)
