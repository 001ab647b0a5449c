"""The film as a sheet that bends but does not stretch, seen by a camera: the shape that its edges in the photo tell.

A network's map, even one that is put right along the edges, is off inside, where it knows only what films look like on
average. But a film does not stretch (its strain is a millionth), and what a camera shows of the four edges of such a
sheet tells where it is near and where it slopes: opposite edges show how the distance varies, and distance and slope
how the film's length is spread along the edges and over the inside (compare Perriollat and Bartoli 2013, "A
computational model of bounded developable surfaces"). Fitted at once are the surface in space, a cubic B-spline of
film uv; the focal length; the sheet's ratio of sides; and the lens's first radial distortion. Minimised are the
distances of the edges from where they were seen, strain, bending, and, weakly, the distance from the network's map:
Gauss-Newton steps with Levenberg's damping. Edges alone do not always tell: a sheet rolled about a slanting axis may be
mistaken for another. So what is printed has the last word (refine.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres, film_nodes
from hybrid.rectify.bspline import bending_energy
from hybrid.rectify.invert import fit_homography
from hybrid.rectify.sightings import Sightings
from hybrid.rectify.tps import MAD_TO_SIGMA, tukey_weights


@dataclass(frozen=True)
class SheetConfig:
    """Options of the fit of a sheet to its edges."""

    intervals: tuple[int, int] = (4, 6)
    """Knot intervals of the surface along each film axis: while it is far from its place, and at last."""
    steps: tuple[int, int] = (12, 8)
    """Most Gauss-Newton steps on each."""
    settled: float = 3e-3
    """Steps that lower the cost by less than this part are the last."""
    every: int = 4
    """Of the points of an edge, one of so many counts: they are correlated."""
    edge_px: float = 0.7
    """Standard deviation of an edge's place in a photo of 1000 pixels."""
    network_px: float = 12.0
    """Standard deviation of the network's map in such a photo; smooth, so that all nodes tell as much as six."""
    strain: float = 1.5e-3
    """Standard deviation of the strain at 40 places: what the splines cannot follow; film itself strains far less."""
    bending: tuple[float, float] = (250.0, 25.0)
    """Weight of the mean squared second derivatives, in units of the film's height: at first, and for films that this
    leaves unexplained because they are bent sharply."""
    unexplained: float = 15.0
    """Cost beyond which a film counts as such a one."""
    focal: tuple[float, float] = (1.1, 0.5)
    """Focal length of phones, in sides of the photo, and its relative deviation."""
    distortion: float = 0.02
    """Standard deviation of the first radial distortion."""
    least_edges: int = 3
    """With fewer edges the sheet's shape is not determined."""
    most_cost: float = 60.0
    """Beyond this cost some edge is none of the sheet's."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """A bent sheet before a camera.

    control: (n, 3) B-spline coefficients in camera axes, in units of the film's height. log_focal: of the focal length
    in sides of the photo. log_aspect: of the film's width over its height. distortion: first radial coefficient.
    cost: half the sum of the squared residuals in deviations: how badly a sheet explains what was seen.
    """

    intervals: int
    control: Float[np.ndarray, "n 3"]
    log_focal: float
    log_aspect: float
    distortion: float
    cost: float = np.inf

    def moved(self, step: Float[np.ndarray, " m"]) -> Sheet:
        """With a step of all unknowns added."""
        n = len(self.control)
        return replace(
            self,
            control=self.control + step[: 3 * n].reshape(3, n).T,
            log_focal=self.log_focal + float(np.clip(step[-3], -0.3, 0.3)),
            log_aspect=self.log_aspect + float(np.clip(step[-2], -0.1, 0.1)),
            distortion=self.distortion + float(step[-1]),
        )


@dataclass(frozen=True, eq=False)
class FittedSheet:
    """The map of a sheet, and how badly a sheet explains what was seen: half the sum of squares, in deviations."""

    backward: BackwardMap
    cost: float


@dataclass(eq=False)
class _Edge:
    """One side as seen: film points on it, which slide along it, and the points of the photo, in its sides."""

    along: int
    place: Float[np.ndarray, "n 2"]
    seen: Float[np.ndarray, "n 2"]
    normal: Float[np.ndarray, "n 2"]
    basis: Float[np.ndarray, "n k"]
    noise: float = 1.0


def fit_sheet(
    coarse: BackwardMap, size: tuple[int, int], outline: Sequence[Sightings], config: SheetConfig
) -> FittedSheet | None:
    """The unstretched sheet whose edges were seen through ``coarse``; None where the fit fails.

    size: (height, width) of the photo, whose centre the camera looks at. outline: three or four sides.
    """
    side, centre = float(max(size)), 0.5 * np.array(size[::-1], dtype=np.float64)
    edges = [_edge(coarse, s.subset(np.arange(0, len(s), config.every)), centre, side) for s in outline]
    first, last = config.intervals
    try:
        sheet = _plane(coarse, centre, side, first, config)
        sheet = _fitted(sheet, coarse, edges, (centre, side), (config.bending[0], config.steps[0]), config)
        sharp = sheet.cost > config.unexplained
        if sharp:
            sheet = _fitted(sheet, coarse, edges, (centre, side), (config.bending[1], config.steps[0]), config)
        sheet = _finer(sheet, last)
        sheet = _fitted(sheet, coarse, edges, (centre, side), (config.bending[int(sharp)], config.steps[1]), config)
    except LinAlgError:
        return None
    nodes = film_nodes((33, 33))
    seen, *_ = _project(sheet, _basis(nodes.reshape(-1, 2), last))
    if not np.isfinite(seen).all():
        return None
    return FittedSheet(BackwardMap(seen.reshape(nodes.shape) * side + centre), sheet.cost)


def _edge(coarse: BackwardMap, side: Sightings, centre: Float[np.ndarray, "2"], unit: float) -> _Edge:
    """A side that was seen through the coarse map."""
    seen = (coarse.photo_from_film(side.seen) - centre) / unit
    place = np.clip(side.places(), 0.0, 1.0)
    return _Edge(1 - side.axis, place, seen, np.zeros_like(seen), np.zeros((len(seen), 0)))


# ---------------------------------------------------------------- the fit


def _fitted(
    sheet: Sheet,
    coarse: BackwardMap,
    edges: list[_Edge],
    frame: tuple[Float[np.ndarray, "2"], float],
    effort: tuple[float, int],
    config: SheetConfig,
) -> Sheet:
    """The sheet after Gauss-Newton steps. frame: centre and side of the photo. effort: weight of bending, most steps.

    Raises LinAlgError where the normal equations cannot be solved.
    """
    nodes = film_nodes((9, 9)).reshape(-1, 2)
    target = (coarse.photo_from_film(nodes) - frame[0]) / frame[1]
    damping = 1e-3
    for edge in edges:
        _slide(edge, sheet)
    sheet = replace(sheet, cost=_system(sheet, target, edges, effort[0], config)[0])
    for _ in range(effort[1]):
        cost, matrix, right = _system(sheet, target, edges, effort[0], config)
        better = None
        for _ in range(4):
            damped = matrix + damping * np.diag(np.diag(matrix))
            trial = sheet.moved(-cho_solve(cho_factor(damped, check_finite=False), right, check_finite=False))
            if (trial.control[:, 2] > 0.05).all():
                reached = _system(trial, target, edges, effort[0], config, derivatives=False)[0]
                if reached < cost:
                    better = replace(trial, cost=reached)
                    break
            damping *= 8.0
        if better is None:
            break
        sheet, damping = better, max(damping / 5.0, 1e-7)
        if cost - sheet.cost < config.settled * cost:
            break
        for edge in edges:
            _slide(edge, sheet)
    return sheet


class _Sum:
    """Cost, normal matrix and gradient of residuals that are added block by block."""

    def __init__(self, unknowns: int, derivatives: bool) -> None:
        self.cost, self.derivatives = 0.0, derivatives
        self.matrix, self.right = np.zeros((unknowns, unknowns)), np.zeros(unknowns)

    def add(
        self, residual: Float[np.ndarray, " m"], rows: Float[np.ndarray, "m u"], weight: np.ndarray | float
    ) -> None:
        """Residuals in deviations, their derivatives, and weights."""
        self.cost += 0.5 * float(np.sum(weight * residual * residual))
        if self.derivatives:
            scaled = rows * np.sqrt(np.broadcast_to(weight, residual.shape))[:, None]
            self.matrix += scaled.T @ scaled
            self.right += rows.T @ (weight * residual)

    def add_prior(self, k: int, residual: float, slope: float) -> None:
        """What is known of one unknown beforehand."""
        self.cost += 0.5 * residual * residual
        self.matrix[k, k] += slope * slope
        self.right[k] += slope * residual


def _system(
    sheet: Sheet,
    target: Float[np.ndarray, "m 2"],
    edges: list[_Edge],
    bending: float,
    config: SheetConfig,
    derivatives: bool = True,
) -> tuple[float, Float[np.ndarray, "u u"], Float[np.ndarray, " u"]]:
    """Cost of a sheet, and the normal equations around it; without the latter where ``derivatives`` is False."""
    n = len(sheet.control)
    total = _Sum(3 * n + 3, derivatives)
    nodes = _basis(film_nodes((9, 9)).reshape(-1, 2), sheet.intervals)
    seen, dx, dy, lens = _project(sheet, nodes)
    sigma = 1e-3 * config.network_px * np.sqrt(len(nodes) / 6.0)
    for k, slope in ((0, dx), (1, dy)):
        rows = _rows(nodes, slope / sigma, seen[:, k] / sigma, lens[:, k] / sigma) if derivatives else nodes
        total.add((seen[:, k] - target[:, k]) / sigma, rows, 1.0)
    sigma = 1e-3 * config.edge_px
    for edge in edges:
        seen, dx, dy, lens = _project(sheet, edge.basis)
        nx, ny = edge.normal.T[:, :, None] / sigma
        residual = np.sum((seen - edge.seen) * edge.normal, axis=1) / sigma
        along = np.sum(seen * edge.normal, axis=1) / sigma, np.sum(lens * edge.normal, axis=1) / sigma
        rows = _rows(edge.basis, dx * nx + dy * ny, *along) if derivatives else edge.basis
        total.add(residual, rows, tukey_weights(residual / edge.noise))
    _add_strain(total, sheet, config)
    energy = bending_energy(sheet.intervals)
    for k in range(3):
        pull = bending * (energy @ sheet.control[:, k])
        total.cost += 0.5 * float(sheet.control[:, k] @ pull)
        if derivatives:
            total.matrix[k * n : (k + 1) * n, k * n : (k + 1) * n] += bending * energy
            total.right[k * n : (k + 1) * n] += pull
    usual, spread = config.focal
    total.add_prior(3 * n, (sheet.log_focal - float(np.log(usual))) / spread, 1.0 / spread)
    total.add_prior(3 * n + 2, sheet.distortion / config.distortion, 1.0 / config.distortion)
    return total.cost, total.matrix, total.right


def _rows(
    basis: Float[np.ndarray, "m n"], slope: Float[np.ndarray, "m 3"], focal: np.ndarray, lens: np.ndarray
) -> Float[np.ndarray, "m u"]:
    """Derivatives of residuals by all unknowns, given those by the point in space, log focal length and distortion."""
    return np.hstack(
        [*(basis * slope[:, k : k + 1] for k in range(3)), focal[:, None], 0 * lens[:, None], lens[:, None]]
    )


def _add_strain(total: _Sum, sheet: Sheet, config: SheetConfig) -> None:
    """Residuals of the lengths of film along u and v, and of the right angle between them."""
    across, down = _slopes(sheet.intervals)
    a, b, aspect = across @ sheet.control, down @ sheet.control, float(np.exp(sheet.log_aspect))
    sigma = config.strain * np.sqrt(len(across) / 40.0)
    stretch_a = np.sum(a * a, axis=1) / aspect**2
    shear = np.sum(a * b, axis=1) / (aspect * sigma)
    none = np.zeros((len(across), 1))
    rows_a = rows_b = rows_s = none
    if total.derivatives:
        rows_a = np.hstack([_by(across, a) / (aspect**2 * sigma), none, -stretch_a[:, None] / sigma, none])
        rows_b = np.hstack([_by(down, b) / sigma, none, none, none])
        rows_s = np.hstack([(_by(across, b) + _by(down, a)) / (aspect * sigma), none, -shear[:, None], none])
    total.add((stretch_a - 1.0) / (2.0 * sigma), rows_a, 1.0)
    total.add((np.sum(b * b, axis=1) - 1.0) / (2.0 * sigma), rows_b, 1.0)
    total.add(shear, rows_s, 1.0)


def _by(basis: Float[np.ndarray, "m n"], vector: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m k"]:
    """``basis`` three times side by side, times the three components."""
    return np.hstack([basis * vector[:, k : k + 1] for k in range(3)])


def _project(
    sheet: Sheet, basis: Float[np.ndarray, "m n"]
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"], Float[np.ndarray, "m 2"]]:
    """Photo points, in sides of the photo from its centre; the derivatives of x and of y by the point in space; and
    the derivatives of both by the distortion."""
    point = basis @ sheet.control
    focal, depth = float(np.exp(sheet.log_focal)), point[:, 2:]
    x = point[:, :2] / depth
    square = np.sum(x * x, axis=1, keepdims=True)
    stretch = 1.0 + sheet.distortion * square
    zero = np.zeros(len(x))
    a = np.stack([1.0 / depth[:, 0], zero, -x[:, 0] / depth[:, 0]], axis=1)
    b = np.stack([zero, 1.0 / depth[:, 0], -x[:, 1] / depth[:, 0]], axis=1)
    own = focal * (stretch + 2.0 * sheet.distortion * x * x)
    mixed = (2.0 * focal * sheet.distortion * x[:, 0] * x[:, 1])[:, None]
    return focal * x * stretch, own[:, :1] * a + mixed * b, mixed * a + own[:, 1:] * b, focal * x * square


def _slide(edge: _Edge, sheet: Sheet) -> None:
    """Moves the film points of an edge along it to where the sheet's edge comes nearest to what was seen."""
    u_or_v = [(1, 0), (0, 1)][edge.along]
    for _ in range(2):
        seen, dx, dy, _ = _project(sheet, _basis(edge.place, sheet.intervals))
        tangent = _basis(edge.place, sheet.intervals, *u_or_v) @ sheet.control
        along = np.stack([np.sum(dx * tangent, axis=1), np.sum(dy * tangent, axis=1)], axis=1)
        square = np.maximum(np.sum(along * along, axis=1), 1e-9)
        step = np.clip(np.sum((edge.seen - seen) * along, axis=1) / square, -0.05, 0.05)
        edge.place[:, edge.along] = np.clip(edge.place[:, edge.along] + step, 0.0, 1.0)
    edge.normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.sqrt(square)[:, None]
    edge.basis = _basis(edge.place, sheet.intervals)
    seen, *_ = _project(sheet, edge.basis)
    residual = np.sum((seen - edge.seen) * edge.normal, axis=1)
    edge.noise = max(1.0, 2.0 * MAD_TO_SIGMA * float(np.median(np.abs(residual))) / 7e-4)


# ---------------------------------------------------------------- surfaces


@lru_cache(maxsize=32)
def _axis_spline(intervals: int, derivative: int) -> BSpline:
    """The uniform cubic B-splines of one axis, or their derivatives."""
    spline = BSpline(np.arange(-3, intervals + 4) / intervals, np.eye(intervals + 3), 3)
    return spline if derivative == 0 else spline.derivative(derivative)


def _basis(uv: Float[np.ndarray, "m 2"], intervals: int, by_u: int = 0, by_v: int = 0) -> Float[np.ndarray, "m n"]:
    """Weights of the coefficients, ordered row (v) first, in the surface's value or derivative at film points."""
    across, down = _axis_spline(intervals, by_u)(uv[:, 0]), _axis_spline(intervals, by_v)(uv[:, 1])
    return (down[:, :, None] * across[:, None, :]).reshape(len(uv), -1)


@lru_cache(maxsize=4)
def _slopes(intervals: int) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, "m n"]]:
    """Weights of the coefficients in the slopes along u and v where strain is measured."""
    places = film_centres((2 * intervals - 2, 2 * intervals - 2)).reshape(-1, 2)
    return _basis(places, intervals, 1, 0), _basis(places, intervals, 0, 1)


def _plane(
    coarse: BackwardMap, centre: Float[np.ndarray, "2"], side: float, intervals: int, config: SheetConfig
) -> Sheet:
    """The flat sheet that shows about what the coarse map says, from the homography between film and photo."""
    uv, focal = film_nodes((17, 17)).reshape(-1, 2), config.focal[0]
    homography = fit_homography(uv, (coarse.photo_from_film(uv) - centre) / side, np.ones(len(uv)))
    pose = np.diag([1.0 / focal, 1.0 / focal, 1.0]) @ homography
    if pose[2] @ np.array([0.5, 0.5, 1.0]) < 0:
        pose = -pose
    pose = pose / np.linalg.norm(pose[:, 1])
    knots = np.arange(-1, intervals + 2) / intervals
    u, v = np.meshgrid(knots, knots)  # coefficients there make a linear function
    control = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1) @ pose.T
    return Sheet(intervals, control, float(np.log(focal)), float(np.log(np.linalg.norm(pose[:, 0]))), 0.0)


@lru_cache(maxsize=4)
def _refiner(before: int, after: int) -> Float[np.ndarray, "k n"]:
    """Coefficients of the finer splines that come nearest to the coarser ones."""
    places = film_centres((4 * after, 4 * after)).reshape(-1, 2)
    return np.linalg.lstsq(_basis(places, after), _basis(places, before), rcond=None)[0]


def _finer(sheet: Sheet, intervals: int) -> Sheet:
    """The same sheet on more intervals."""
    return replace(sheet, intervals=intervals, control=_refiner(sheet.intervals, intervals) @ sheet.control)


__all__ = ["FittedSheet", "SheetConfig", "fit_sheet"]
