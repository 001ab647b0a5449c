"""Which unstretched sheet the photo shows: fitted to its edges and to what is printed on it.

A network's map, even one that is put right along the edges, is off inside, where it knows only what films look like on
average. But a film does not stretch (its strain is a millionth), and what a camera shows of the four edges of such a
sheet tells where it is near and where it slopes: opposite edges show how the distance varies, and distance and slope
how the film's length is spread along the edges and over the inside (compare Perriollat and Bartoli 2013, "A
computational model of bounded developable surfaces"). Edges alone do not always tell: a sheet rolled about a slanting
axis may be mistaken for another. Lines and cells printed on it tell the rest, and the sheet in turn tells what they
leave open, as where between the edges the grid lies and how wide its cells are.

Fitted at once are the surface, the camera, the sheet's ratio of sides, and the constants that sightings share.
Minimised are the distances of what is seen from where it should be, strain, bending, and, weakly, the distance from the
network's map: Gauss-Newton steps with Levenberg's damping.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.rectify.bspline import bending_energy
from hybrid.rectify.sheet import CAMERA, Frame, Sheet, basis, flat_sheet, project, slopes, surface
from hybrid.rectify.sightings import Sightings, group_noise
from hybrid.rectify.tps import MAD_TO_SIGMA, tukey_weights

_NOTHING = Sightings(0, np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 0)), np.zeros(0))
"""No sightings at all."""


@dataclass(frozen=True)
class SheetConfig:
    """Options of the fit of a sheet to what is seen of it. Pixels are those of a photo of 1000."""

    intervals: tuple[int, int] = (4, 6)
    """Knot intervals of the surface along each film axis: while it is far from its place, and at last."""
    steps: tuple[int, int, int] = (12, 8, 15)
    """Most Gauss-Newton steps on each, and with what is printed."""
    settled: float = 3e-3
    """Steps that lower the cost by less than this part are the last."""
    every: tuple[int, int] = (4, 2)
    """Of the points of an edge or a line, and of the cells' windows, one of so many counts: they are correlated."""
    edge_px: float = 0.7
    """Standard deviation of an edge's place."""
    print_px: float = 0.7
    """Standard deviation of the place of what is printed, beside what is stated for it."""
    network_px: float = 12.0
    """Standard deviation of the network's map; smooth, so that all nodes tell as much as six."""
    strain: float = 1.5e-3
    """Standard deviation of the strain at 40 places: what the splines cannot follow; film itself strains far less."""
    bending: tuple[float, float] = (250.0, 25.0)
    """Weight of the mean squared second derivatives, in units of the film's height: at first, and for films that this
    leaves unexplained because they are bent sharply, or whose print is seen too."""
    bent_share: float = 0.25
    """With what is printed, the lower weight is tried where bending makes more than this part of the cost."""
    sharper: float = 0.6
    """It counts if the cost is less than this part then."""
    unexplained: float = 15.0
    """Cost beyond which a film counts as bent sharply."""
    focal: tuple[float, float, float] = (0.65, 1.1, 3.5)
    """Focal lengths of phones, in sides of the photo: shortest, usual and longest."""
    focal_sigma: float = 0.15
    """Relative deviation beyond these."""
    distortion: float = 0.02
    """Standard deviation of the first radial distortion."""
    least_edges: int = 3
    """With fewer edges the sheet's shape is not determined."""
    most_cost: float = 60.0
    """Beyond this cost some edge is none of the sheet's."""


@dataclass(frozen=True, eq=False)
class FittedSheet:
    """A sheet and its map.

    cost: half the sum of squares, in deviations: how badly a sheet explains what was seen. constants: those that each
    list of sightings shares. bending: weight of bending that it was found with.
    """

    sheet: Sheet
    backward: BackwardMap
    cost: float
    constants: tuple[Float[np.ndarray, " _"], ...]
    bending: float


def fit_sheet(
    coarse: BackwardMap, size: tuple[int, int], outline: Sequence[Sightings], config: SheetConfig
) -> FittedSheet | None:
    """The unstretched sheet whose edges were seen through ``coarse``; None where the fit fails.

    size: (height, width) of the photo, whose centre the camera looks at. outline: three or four sides.
    """
    frame = Frame.of(size)
    problem = _Problem(_seen(coarse, outline, frame, config), _target(coarse, frame), config.bending[0], config)
    first, last = config.intervals
    try:
        state = problem.begun(flat_sheet(coarse, frame, first, config.focal[1]))
        state = _fitted(problem, state, config.steps[0])
        if state.cost > config.unexplained:
            problem = replace(problem, bending=config.bending[1])
            state = _fitted(problem, state, config.steps[0])
        state = _fitted(problem, replace(state, sheet=state.sheet.finer(last)), config.steps[1])
    except LinAlgError:
        return None
    return _result(state, frame, outline, problem)


def refit_sheet(
    near: BackwardMap,
    through: BackwardMap,
    size: tuple[int, int],
    sightings: Sequence[Sightings],
    config: SheetConfig,
    before: FittedSheet | None = None,
) -> FittedSheet | None:
    """The unstretched sheet that explains best what is seen of its edges and its print; None where the fit fails.

    near: a map that is near, to start from, and from ``before`` if that is its sheet. through: the map through which
    the sightings were made.
    """
    frame = Frame.of(size)
    problem = _Problem(_seen(through, sightings, frame, config), _target(near, frame), config.bending[0], config)
    try:
        if before is not None:
            problem = replace(problem, bending=before.bending)
            return _result(_fitted(problem, problem.begun(before.sheet), config.steps[2]), frame, sightings, problem)
        softer = replace(problem, bending=config.bending[1])
        start = _near_map(softer, near, frame)
        state = _fitted(problem, start, config.steps[2])
        if _bending(state.sheet, problem.bending) > config.bent_share * state.cost:
            bent = _fitted(softer, start, config.steps[2])
            if bent.cost < config.sharper * state.cost:
                state, problem = bent, softer
    except LinAlgError:
        return None
    return _result(state, frame, sightings, problem)


def _near_map(problem: _Problem, near: BackwardMap, frame: Frame) -> _State:
    """The unstretched sheet that comes nearest to a map; of what is seen it knows nothing."""
    config = problem.config
    first, last = config.intervals
    blind = replace(problem, seen=_seen(near, [_NOTHING], frame, config), config=replace(config, network_px=1.0))
    state = _fitted(blind, blind.begun(flat_sheet(near, frame, first, config.focal[1])), config.steps[0])
    state = _fitted(blind, replace(state, sheet=state.sheet.finer(last)), config.steps[1])
    return problem.begun(state.sheet)


@dataclass(frozen=True, eq=False)
class _State:
    """A sheet, the constants of all sightings, and the cost of both."""

    sheet: Sheet
    constants: Float[np.ndarray, " g"]
    cost: float = np.inf

    def moved(self, step: Float[np.ndarray, " m"]) -> _State:
        """With a step of all unknowns added."""
        return _State(self.sheet.moved(step), self.constants + step[len(step) - len(self.constants) :])


def _result(state: _State, frame: Frame, sightings: Sequence[Sightings], problem: _Problem) -> FittedSheet | None:
    backward = state.sheet.backward(frame)
    if backward is None:
        return None
    ends = np.cumsum([s.shared.shape[1] for s in sightings])
    return FittedSheet(state.sheet, backward, state.cost, tuple(np.split(state.constants, ends[:-1])), problem.bending)


# ---------------------------------------------------------------- what is seen


@dataclass(frozen=True, eq=False)
class _Seen:
    """Points of the photo, in the frame's units, at which one film coordinate is known up to the shared constants.

    across: the axis of that coordinate. along: film coordinate on the other axis, as far as known. sigma: in film
    units, 0 where only ``floor`` counts: the deviation in the frame's units. number: of the list each is from.
    group: of what shows the same thing, -1 where there is none.
    """

    point: Float[np.ndarray, "n 2"]
    across: Int[np.ndarray, " n"]
    known: Float[np.ndarray, " n"]
    along: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]
    floor: Float[np.ndarray, " n"]
    shared: Float[np.ndarray, "n g"]
    shared_sigma: Float[np.ndarray, " g"]
    number: Int[np.ndarray, " n"]
    group: Int[np.ndarray, " n"]


def _seen(through: BackwardMap, sightings: Sequence[Sightings], frame: Frame, config: SheetConfig) -> _Seen:
    """Sightings that were made through a map, as points of the photo."""
    thinned = [s.subset(np.arange(0, len(s), config.every[s.group is not None])) for s in sightings]
    number = np.repeat(np.arange(len(thinned)), [len(s) for s in thinned])
    widths = [s.shared.shape[1] for s in thinned]
    shared, first = np.zeros((len(number), sum(widths))), np.cumsum([0, *widths])
    group, next_group = np.full(len(number), -1), 0
    for k, s in enumerate(thinned):
        shared[number == k, first[k] : first[k + 1]] = s.shared
        if s.group is not None:
            own = np.unique(s.group, return_inverse=True)[1]
            group[number == k] = own + next_group
            next_group += int(own.max(initial=-1)) + 1
    edge = np.array([s.shared.shape[1] == 0 for s in thinned])[number]
    seen, places = np.concatenate([s.seen for s in thinned]), np.concatenate([s.places() for s in thinned])
    across = np.array([s.axis for s in thinned])[number]
    rows = np.arange(len(number))
    return _Seen(
        frame.from_photo(through.photo_from_film(seen)),
        across,
        places[rows, across],
        np.clip(places[rows, 1 - across], 0.0, 1.0),
        np.where(edge, 0.0, np.concatenate([s.sigma for s in thinned])),
        1e-3 * np.where(edge, config.edge_px, config.print_px),
        shared,
        np.concatenate([s.shared_sigma for s in thinned]),
        number,
        group,
    )


@dataclass(frozen=True, eq=False)
class _Curves:
    """Where a sheet has what is seen: film points that slid along their curves to where they are nearest.

    weights: of the sheet's coefficients. along: as in _Seen. normal: to the curves in the photo, over the deviation.
    pull: by how much the points move along the normal with the known coordinate. tolerance: in deviations.
    constants: at which all this holds.
    """

    weights: Float[np.ndarray, "n k"]
    along: Float[np.ndarray, " n"]
    normal: Float[np.ndarray, "n 2"]
    pull: Float[np.ndarray, " n"]
    tolerance: Float[np.ndarray, " n"]
    constants: Float[np.ndarray, " g"]


def _slid(seen: _Seen, state: _State, along: Float[np.ndarray, " n"], near: bool) -> _Curves:
    """What is seen, slid along its curves on a sheet. along: where to start from. near: whether the sheet is so near
    that what still disagrees tells how exact sightings are."""
    sheet, rows = state.sheet, np.arange(len(along))
    known = np.clip(seen.known + seen.shared @ state.constants, -0.05, 1.05)
    place = np.empty((len(along), 2))
    place[rows, seen.across] = np.clip(known, 0.0, 1.0)
    place[rows, 1 - seen.across] = along
    for _ in range(2):
        points, by_uv = surface(sheet, place)
        now = project(sheet, points)
        by_uv = now.by_point @ by_uv  # (n, 2, 2): of x, y by u, v
        tangent = by_uv[rows, :, 1 - seen.across]
        square = np.maximum(np.sum(tangent * tangent, axis=1), 1e-9)
        step = np.clip(np.sum((seen.point - now.point) * tangent, axis=1) / square, -0.05, 0.05)
        place[rows, 1 - seen.across] = np.clip(place[rows, 1 - seen.across] + step, 0.0, 1.0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.sqrt(square)[:, None]
    pull = np.sum(by_uv[rows, :, seen.across] * normal, axis=1)
    sigma = np.hypot(seen.sigma * pull, seen.floor)
    weights = basis(place, sheet.intervals)
    residual = np.sum((project(sheet, weights @ sheet.control).point - seen.point) * normal, axis=1)
    if near and (seen.group >= 0).any():
        sigma = group_noise(sigma, seen.group, residual)
    tolerance = np.ones(len(along))
    for k in np.unique(seen.number):
        own = seen.number == k
        tolerance[own] = max(1.0, 2.0 * MAD_TO_SIGMA * float(np.median(np.abs(residual[own]) / sigma[own])))
    return _Curves(
        weights, place[rows, 1 - seen.across], normal / sigma[:, None], pull / sigma, tolerance, state.constants
    )


# ---------------------------------------------------------------- the fit


def _target(coarse: BackwardMap, frame: Frame) -> Float[np.ndarray, "m 2"]:
    """Where the network has some points of the film."""
    return frame.from_photo(coarse.photo_from_film(film_nodes((9, 9)).reshape(-1, 2)))


@dataclass(frozen=True, eq=False)
class _Problem:
    """What is minimised. target: where the network has the film. bending: weight of bending."""

    seen: _Seen
    target: Float[np.ndarray, "m 2"]
    bending: float
    config: SheetConfig

    def begun(self, sheet: Sheet) -> _State:
        """A sheet to start from."""
        return _State(sheet, np.zeros(self.seen.shared.shape[1]))

    def normal_equations(self, state: _State, curves: _Curves, derivatives: bool = True) -> _Sum:
        """Cost of a state, and the normal equations around it; without the latter where ``derivatives`` is False."""
        sheet, config, n = state.sheet, self.config, len(state.sheet.control)
        total = _Sum(3 * n + CAMERA + len(state.constants), derivatives)
        nodes = basis(film_nodes((9, 9)).reshape(-1, 2), sheet.intervals)
        shown = project(sheet, nodes @ sheet.control)
        sigma = 1e-3 * config.network_px * np.sqrt(len(nodes) / 6.0)
        for k in (0, 1):
            parts = (shown.by_point[:, k] / sigma, shown.point[:, k] / sigma, shown.by_lens[:, k] / sigma)
            total.add((shown.point[:, k] - self.target[:, k]) / sigma, _rows(nodes, *parts) if derivatives else None)
        shown = project(sheet, curves.weights @ sheet.control)
        residual = np.sum((shown.point - self.seen.point) * curves.normal, axis=1)
        residual += curves.pull * (self.seen.shared @ (state.constants - curves.constants))
        rows = None
        if derivatives:
            parts = (
                np.einsum("nk,nkj->nj", curves.normal, shown.by_point),
                *(np.sum(x * curves.normal, axis=1) for x in (shown.point, shown.by_lens)),
            )
            rows = np.hstack([_rows(curves.weights, *parts), curves.pull[:, None] * self.seen.shared])
        total.add(residual, rows, tukey_weights(residual / curves.tolerance))
        _add_strain(total, sheet, config)
        _add_bending(total, sheet, self.bending)
        beyond = sheet.log_focal - float(np.clip(sheet.log_focal, *np.log(config.focal)[[0, 2]]))
        if beyond:
            total.add_prior(3 * n, beyond / config.focal_sigma, 1.0 / config.focal_sigma)
        total.add_prior(3 * n + 2, sheet.distortion / config.distortion, 1.0 / config.distortion)
        for k, (constant, spread) in enumerate(zip(state.constants, self.seen.shared_sigma, strict=True)):
            total.add_prior(3 * n + CAMERA + k, constant / spread, 1.0 / spread)
        return total


def _fitted(problem: _Problem, state: _State, steps: int) -> _State:
    """The state after at most so many Gauss-Newton steps.

    Raises LinAlgError where the normal equations cannot be solved.
    """
    damping = 1e-3
    curves = _slid(problem.seen, state, problem.seen.along, near=False)
    for step in range(steps):
        total = problem.normal_equations(state, curves)
        better = None
        for _ in range(4):
            damped = total.matrix + damping * np.diag(np.diag(total.matrix))
            trial = state.moved(-cho_solve(cho_factor(damped, check_finite=False), total.right, check_finite=False))
            if (trial.sheet.control[:, 2] > 0.05).all():
                reached = problem.normal_equations(trial, curves, derivatives=False).cost
                if reached < total.cost:
                    better = replace(trial, cost=reached)
                    break
            damping *= 8.0
        if better is None:
            return replace(state, cost=total.cost)
        state, damping = better, max(damping / 5.0, 1e-7)
        if step > 1 and total.cost - state.cost < problem.config.settled * total.cost:
            break
        curves = _slid(problem.seen, state, curves.along, near=step > 0)
    return state


class _Sum:
    """Cost, normal matrix and gradient of residuals that are added block by block."""

    def __init__(self, unknowns: int, derivatives: bool) -> None:
        self.cost, self.derivatives = 0.0, derivatives
        size = unknowns if derivatives else 0
        self.matrix, self.right = np.zeros((size, size)), np.zeros(size)

    def add(
        self,
        residual: Float[np.ndarray, " m"],
        rows: Float[np.ndarray, "m u"] | None,
        weight: np.ndarray | float = 1.0,
    ) -> None:
        """Residuals in deviations, their derivatives by the first unknowns, and weights."""
        self.cost += 0.5 * float(np.sum(weight * residual * residual))
        if rows is not None:
            used = rows.shape[1]
            scaled = rows * np.sqrt(np.broadcast_to(weight, residual.shape))[:, None]
            self.matrix[:used, :used] += scaled.T @ scaled
            self.right[:used] += rows.T @ (weight * residual)

    def add_prior(self, k: int, residual: float, slope: float) -> None:
        """What is known of one unknown beforehand."""
        self.cost += 0.5 * residual * residual
        if self.derivatives:
            self.matrix[k, k] += slope * slope
            self.right[k] += slope * residual


def _rows(
    weights: Float[np.ndarray, "m n"],
    by_point: Float[np.ndarray, "m 3"],
    by_focal: Float[np.ndarray, " m"],
    by_lens: Float[np.ndarray, " m"],
) -> Float[np.ndarray, "m u"]:
    """Derivatives of residuals by the sheet's unknowns, given those by the point in space and by the camera."""
    n = weights.shape[1]
    rows = np.empty((len(weights), 3 * n + CAMERA))
    for k in range(3):
        np.multiply(weights, by_point[:, k : k + 1], out=rows[:, k * n : (k + 1) * n])
    rows[:, 3 * n :] = np.stack([by_focal, np.zeros_like(by_focal), by_lens], axis=1)
    return rows


def _add_strain(total: _Sum, sheet: Sheet, config: SheetConfig) -> None:
    """Residuals of the lengths of film along u and v, and of the right angle between them."""
    across, down = slopes(sheet.intervals)
    a, b, aspect = across @ sheet.control, down @ sheet.control, float(np.exp(sheet.log_aspect))
    sigma = config.strain * np.sqrt(len(across) / 40.0)
    stretch_a = np.sum(a * a, axis=1) / aspect**2
    shear = np.sum(a * b, axis=1) / (aspect * sigma)
    none = np.zeros((len(across), 1))
    rows_a = rows_b = rows_s = None
    if total.derivatives:
        rows_a = np.hstack([_by(across, a) / (aspect**2 * sigma), none, -stretch_a[:, None] / sigma, none])
        rows_b = np.hstack([_by(down, b) / sigma, none, none, none])
        rows_s = np.hstack([(_by(across, b) + _by(down, a)) / (aspect * sigma), none, -shear[:, None], none])
    total.add((stretch_a - 1.0) / (2.0 * sigma), rows_a)
    total.add((np.sum(b * b, axis=1) - 1.0) / (2.0 * sigma), rows_b)
    total.add(shear, rows_s)


def _bending(sheet: Sheet, weight: float) -> float:
    """Cost of bending: the mean squared second derivatives of the surface."""
    return 0.5 * weight * float(np.sum(sheet.control * (bending_energy(sheet.intervals) @ sheet.control)))


def _add_bending(total: _Sum, sheet: Sheet, weight: float) -> None:
    """The same, with its derivatives."""
    total.cost += _bending(sheet, weight)
    if total.derivatives:
        energy, n = weight * bending_energy(sheet.intervals), len(sheet.control)
        for k in range(3):
            own = slice(k * n, (k + 1) * n)
            total.matrix[own, own] += energy
            total.right[own] += energy @ sheet.control[:, k]


def _by(weights: Float[np.ndarray, "m n"], vector: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m k"]:
    """``weights`` three times side by side, times the three components."""
    return np.hstack([weights * vector[:, k : k + 1] for k in range(3)])


__all__ = ["FittedSheet", "SheetConfig", "fit_sheet", "refit_sheet"]
