"""Thin-plate splines from the plane to the plane: exact, smoothed, and robust.

The spline ``f(x) = A [1, x] + sum_i c_i phi(|x - x_i|)``, ``phi(r) = r^2 log r``, with ``sum c_i = 0`` and
``sum c_i x_i = 0``, has the smallest bending energy of all functions with the same values at the ``x_i``
(Duchon 1977). The small dense system is solved directly, in float64 and in normalised coordinates.

kornia's ``get_tps_transform(src, dst)`` also interpolates, but centres its kernels on ``dst``, so its spline
is not the one of least bending energy, and it cannot smooth: between the points the two differ, at the points
they agree. What is needed here is smoothing and weights, hence this module.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from hybrid.coords import film_nodes
from hybrid.errors import HybridError, describe

MIN_POINTS = 3
"""A plane through fewer points is not determined."""
COLLINEAR_RATIO = 1e-6
"""Points whose spread across is below this fraction of their spread along lie on a line for float64's purposes."""
CLOSE_RATIO = 1e-6
"""Points closer together than this fraction of the extent of all are one point for float64's purposes."""
TUKEY_CUT = 4.685
"""Tukey's biweight with this cut, in standard deviations, is 95 % efficient under Gaussian noise."""
MAD_TO_SIGMA = 1.4826
"""Standard deviation of Gaussian noise over its median absolute deviation."""


def mad_sigma(residuals: Float[np.ndarray, " n"]) -> float:
    """Standard deviation of Gaussian noise from the median of the residuals' absolute values; needs at least one.

    By sorting: on a thousand values NumPy's median takes three times as long.
    """
    ordered = np.sort(np.abs(residuals))
    return MAD_TO_SIGMA * 0.5 * float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])


class SplineError(HybridError, ValueError):
    """Observations that do not determine a thin-plate spline."""


@dataclass(frozen=True, eq=False)
class ThinPlateSpline:
    """A smooth map of the plane, as a callable on (N, 2) points.

    centres: kernel centres in normalised coordinates ``(x - origin) / scale``.
    kernel: coefficients c of the kernels, in units of the values.
    affine: rows constant, x, y of the affine part, in normalised coordinates.
    origin, scale: what normalises a point.
    """

    centres: Float[np.ndarray, "n 2"]
    kernel: Float[np.ndarray, "n 2"]
    affine: Float[np.ndarray, "3 2"]
    origin: Float[np.ndarray, "2"]
    scale: float

    def __call__(self, points: Float[np.ndarray, "*m 2"]) -> Float[np.ndarray, "*m 2"]:
        """Values at the points; linear growth far away."""
        flat = (np.asarray(points, dtype=np.float64).reshape(-1, 2) - self.origin) / self.scale
        values = thin_plate_kernel(flat, self.centres) @ self.kernel + affine_basis(flat) @ self.affine
        return values.reshape(np.shape(points))

    def residuals(self, points: Float[np.ndarray, "n 2"], values: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Distance between the spline and ``values`` at ``points``."""
        return np.linalg.norm(self(points) - values, axis=-1)

    def bending_energy(self) -> float:
        """Integral of the squared second derivatives over the plane, over 8 pi, in normalised coordinates."""
        return float(np.sum(self.kernel * (thin_plate_kernel(self.centres, self.centres) @ self.kernel)))


# ---------------------------------------------------------------- basis


def thin_plate_kernel(points: Float[np.ndarray, "m 2"], centres: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m n"]:
    """phi(r) = r^2 log r of all distances between points and centres; 0 at r = 0."""
    dx = points[:, 0, None] - centres[None, :, 0]
    dy = points[:, 1, None] - centres[None, :, 1]
    dx *= dx
    dy *= dy
    r2 = np.add(dx, dy, out=dx)
    logarithm = np.log(np.maximum(r2, np.finfo(np.float64).tiny, out=dy), out=dy)
    logarithm *= 0.5
    return np.multiply(r2, logarithm, out=r2)


def affine_basis(points: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 3"]:
    """The columns 1, x, y."""
    return np.column_stack([np.ones(len(points)), points])


@dataclass(frozen=True, eq=False)
class LatticeSpline:
    """All thin-plate splines with kernels on a regular film lattice, written by their values at its nodes.

    Centres on a fixed lattice rather than at the observations keep the system small and equally conditioned however
    many observations there are, and allow observations of one coordinate only, or of a value up to an unknown
    constant: each is one row over the node values.

    size: rows and columns of the lattice, edges of the film included.
    bending: the bending energy of node values y is ``y @ bending @ y``.
    """

    size: tuple[int, int]
    nodes: Float[np.ndarray, "n 2"]
    cardinal: Float[np.ndarray, "k n"]
    bending: Float[np.ndarray, "n n"]

    def rows(self, uv: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m n"]:
        """Weights of the node values in the spline's values at film points."""
        return self._basis(uv) @ self.cardinal

    def evaluate(self, uv: Float[np.ndarray, "m 2"], values: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "m c"]:
        """The spline through the node values at film points: ``rows(uv) @ values``, but quicker."""
        return self._basis(uv) @ (self.cardinal @ values)

    def _basis(self, uv: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m k"]:
        """All kernels and affine functions at film points."""
        return np.hstack([thin_plate_kernel(uv, self.nodes), affine_basis(uv)])


@lru_cache(maxsize=4)
def lattice_spline(size: tuple[int, int]) -> LatticeSpline:
    """The thin-plate splines of a film lattice of ``size`` (rows, columns) nodes."""
    nodes = film_nodes(size).reshape(-1, 2)
    n = len(nodes)
    cardinal = np.linalg.solve(_saddle(nodes, np.zeros(n)), np.eye(n + 3, n))
    bending = cardinal[:n].T @ thin_plate_kernel(nodes, nodes) @ cardinal[:n]
    return LatticeSpline(size, nodes, cardinal, 0.5 * (bending + bending.T))


# ---------------------------------------------------------------- fits


def fit_tps(
    points: Float[np.ndarray, "n 2"],
    values: Float[np.ndarray, "n 2"],
    smoothing: float = 0.0,
    sigma: Float[np.ndarray, " n"] | None = None,
) -> ThinPlateSpline:
    """The minimiser of ``sum |f(x_i) - y_i|^2 / sigma_i^2 + smoothing * bending energy``; interpolates at 0.

    sigma: stated noise of each observation (1 where None); an infinite one leaves an observation out.
    Repeated points are averaged by their weights. The energy is that of normalised coordinates, so
    ``smoothing`` does not depend on the unit of the points. Raises SplineError.
    """
    points, values, sigma = _checked(points, values, sigma)
    if not (np.isfinite(smoothing) and smoothing >= 0):
        raise SplineError(
            describe(
                what="Thin-plate spline", where="smoothing", got=smoothing, allowed=">= 0", do="Pass 0 to interpolate."
            )
        )
    centres, targets, variance = _merged(points, values, sigma)
    origin, scale = _normaliser(centres)
    normal = (centres - origin) / scale
    right = np.vstack([targets, np.zeros((3, 2))])
    solution = np.linalg.solve(_saddle(normal, smoothing * variance), right)
    return ThinPlateSpline(normal, solution[:-3], solution[-3:], origin, scale)


def choose_smoothing(
    points: Float[np.ndarray, "n 2"],
    values: Float[np.ndarray, "n 2"],
    sigma: Float[np.ndarray, " n"] | None = None,
) -> float:
    """The smoothing of least generalised cross-validation (Wahba 1990), over 12 decades.

    With Q an orthonormal basis of the complement of the affine functions and Q' S K S Q = V diag(l) V',
    S = diag(1 / sigma), the residual is ``smoothing / (l + smoothing)`` in each direction V: one eigenproblem
    serves all candidates. Raises SplineError.
    """
    points, values, sigma = _checked(points, values, sigma)
    centres, targets, variance = _merged(points, values, sigma)
    origin, scale = _normaliser(centres)
    normal = (centres - origin) / scale
    whiten = 1.0 / np.sqrt(variance)
    basis = np.linalg.qr(affine_basis(normal) * whiten[:, None], mode="complete")[0][:, 3:]
    if basis.shape[1] == 0:
        return 0.0
    kernel = thin_plate_kernel(normal, normal) * whiten[:, None] * whiten
    eigenvalues, vectors = eigh(basis.T @ kernel @ basis)
    eigenvalues = np.maximum(eigenvalues, 0.0)
    z2 = np.sum((vectors.T @ basis.T @ (targets * whiten[:, None])) ** 2, axis=1)
    candidates = np.geomspace(1e-10, 1e2, 49) * max(float(eigenvalues.max()), 1e-300)
    shrink = candidates[:, None] / (eigenvalues + candidates[:, None])
    score = np.sum(shrink**2 * z2, axis=1) / np.sum(shrink, axis=1) ** 2
    return float(candidates[np.argmin(score)])


def fit_tps_robust(
    points: Float[np.ndarray, "n 2"],
    values: Float[np.ndarray, "n 2"],
    smoothing: float,
    sigma: float,
    iterations: int = 40,
) -> ThinPlateSpline:
    """A smoothed spline that outliers do not move: reweighted least squares with Tukey's biweight.

    sigma: noise of a good observation, in the unit of the values; errors beyond ``4.685 sigma`` end without any weight.
    The noise assumed starts at the spread of the values and falls to ``sigma``: at first the spline is stiff and
    tolerant, so that no outlier can bend it to itself (graduated non-convexity). Withstands 30 % of gross outliers.
    ``smoothing`` must be above 0: an interpolating spline has no residuals. Raises SplineError.
    """
    if not (np.isfinite(sigma) and sigma > 0 and smoothing > 0):
        raise SplineError(
            describe(
                what="Robust thin-plate spline",
                got=f"smoothing {smoothing}, sigma {sigma}",
                allowed="both finite and > 0",
                do="State the noise of a good observation.",
            )
        )
    points, values, _ = _checked(points, values, None)
    weights = np.ones(len(points))
    noise = max(sigma, mad_sigma(np.linalg.norm(values - np.median(values, axis=0), axis=1)))
    for _ in range(iterations):
        spread = np.where(weights > 1e-6, noise / np.sqrt(np.maximum(weights, 1e-6)), np.inf)
        spline = fit_tps(points, values, smoothing, spread)
        previous, weights = weights, tukey_weights(spline.residuals(points, values) / noise)
        if noise <= sigma and np.allclose(weights, previous, atol=1e-3):
            break
        noise = max(sigma, 0.7 * noise)
    return spline


def tukey_weights(standardised: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Tukey's biweight of residuals in standard deviations: 1 at 0, 0 from 4.685 on."""
    return np.square(np.maximum(1.0 - np.square(standardised / TUKEY_CUT), 0.0))


# ---------------------------------------------------------------- inside


def _saddle(centres: Float[np.ndarray, "n 2"], ridge: Float[np.ndarray, " n"]) -> Float[np.ndarray, "m m"]:
    """The symmetric system of kernel and affine coefficients, with ``ridge`` on the kernels' diagonal."""
    affine = affine_basis(centres)
    return np.block([[thin_plate_kernel(centres, centres) + np.diag(ridge), affine], [affine.T, np.zeros((3, 3))]])


def _checked(
    points: np.ndarray, values: np.ndarray, sigma: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The observations that count; raises SplineError, saying why, if no spline goes through them."""
    points, values = np.asarray(points, dtype=np.float64), np.asarray(values, dtype=np.float64)
    sigma = np.ones(len(points)) if sigma is None else np.asarray(sigma, dtype=np.float64)
    if not (np.isfinite(points).all() and np.isfinite(values).all() and not np.isnan(sigma).any()):
        raise SplineError(
            describe(
                what="Thin-plate spline",
                where="observations",
                got="NaN or infinity",
                allowed="finite points and values",
                do="Drop the observations that are missing.",
            )
        )
    if np.any(sigma <= 0):
        raise SplineError(
            describe(what="Thin-plate spline", where="sigma", got="0 or less", allowed="> 0", do="State the noise.")
        )
    counted = np.isfinite(sigma)
    points, values, sigma = points[counted], values[counted], sigma[counted]
    _refuse_lines(points)
    return points, values, sigma


def _refuse_lines(points: Float[np.ndarray, "n 2"]) -> None:
    """Raise SplineError where the points do not determine a plane."""
    if len(points) < MIN_POINTS or _collinear(points):
        raise SplineError(
            describe(
                what="Thin-plate spline",
                where="points",
                got=f"{len(points)} points, all on a line" if len(points) >= MIN_POINTS else f"{len(points)} points",
                allowed=f"at least {MIN_POINTS} that are not on one line",
                do="Observe more of the film.",
            )
        )


def _collinear(points: Float[np.ndarray, "n 2"]) -> bool:
    """True where the points have no spread across their main direction."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] <= COLLINEAR_RATIO * spread[0])


def _merged(points: np.ndarray, values: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distinct points, weighted mean values, and variances of those means.

    Points closer than CLOSE_RATIO of their extent count as one: a spline through two values at almost the same place
    is lost in rounding. Raises SplineError where what is left lies on a line.
    """
    close = CLOSE_RATIO * float(np.ptp(points, axis=0).max())
    first, second = KDTree(points).query_pairs(close, output_type="ndarray").T
    joined = coo_array((np.ones(len(first)), (first, second)), shape=(len(points), len(points)))
    _, index = connected_components(joined, directed=False)
    weight = np.bincount(index, 1.0 / sigma**2)
    means = [np.bincount(index, column / sigma**2) / weight for column in (*points.T, *values.T)]
    centres = np.stack(means[:2], axis=1)
    _refuse_lines(centres)
    return centres, np.stack(means[2:], axis=1), 1.0 / weight


def _normaliser(points: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, float]:
    """Origin and scale that bring the points into [-1, 1]."""
    low, high = points.min(axis=0), points.max(axis=0)
    return 0.5 * (low + high), float(0.5 * (high - low).max())


__all__ = [
    "LatticeSpline",
    "SplineError",
    "ThinPlateSpline",
    "choose_smoothing",
    "fit_tps",
    "fit_tps_robust",
    "lattice_spline",
    "mad_sigma",
]
