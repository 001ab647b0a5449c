"""Regularised tensor-product cubic B-splines over the film's unit square, fitted to scattered points.

The spline has ``intervals`` equal knot intervals along each axis, so ``(intervals + 3)^2`` coefficients: few enough
that the normal equations are a small dense matrix. Coefficients are ordered row (v) first. Outside [0, 1] the
polynomial of the nearest interval goes on, so that points a little beyond the edge may be used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline
from scipy.linalg import get_lapack_funcs

from hybrid.coords import node_centres_1d

RIDGE = 1e-10
"""Relative to the mean diagonal: keeps the factorisation possible where an affine part is unobserved."""


@cache
def _axis_spline(intervals: int, derivative: int) -> BSpline:
    """The uniform cubic B-splines of one axis, or their derivatives."""
    spline = BSpline(np.arange(-3, intervals + 4) / intervals, np.eye(intervals + 3), 3)
    return spline.derivative(derivative) if derivative else spline


def axis_weights(t: Float[np.ndarray, " n"], intervals: int, derivative: int = 0) -> Float[np.ndarray, "n k"]:
    """Weights of the ``intervals + 3`` coefficients of one axis in the value or a derivative at coordinates ``t``."""
    return _axis_spline(intervals, derivative)(t)


def design(uv: Float[np.ndarray, "n 2"], intervals: int, by_u: int = 0, by_v: int = 0) -> Float[np.ndarray, "n kk"]:
    """Rows that give the spline's value, or a derivative, at film points ``uv`` from its coefficients."""
    along_u, along_v = axis_weights(uv[:, 0], intervals, by_u), axis_weights(uv[:, 1], intervals, by_v)
    return (along_v[:, :, None] * along_u[:, None, :]).reshape(len(uv), (intervals + 3) ** 2)


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
