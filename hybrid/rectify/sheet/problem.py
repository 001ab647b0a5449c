"""What is minimised to find a sheet: distances of what is seen, strain, bending, and prior knowledge."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import LinAlgError, get_lapack_funcs

from hybrid.rectify.sheet.equations import Block, Sum
from hybrid.rectify.sheet.seen import Curves, Seen, slid
from hybrid.rectify.sheet.shape import (
    ASPECT,
    CAMERA,
    FOCAL,
    LENS,
    Sheet,
    SheetConfig,
    at_nodes,
    inner,
    project,
    slopes,
)
from hybrid.rectify.splines.bspline import bending_energy
from hybrid.rectify.splines.tps import tukey_weights

NEAREST = 0.05
"""Least distance of any point of the sheet from the camera, in units of the film's height."""
SMALLEST = 1e-3
"""Least width and height of a cell, in parts of those of the film."""
MOST_BENT = 0.4
"""Largest length of the second-order part of a step, in lengths of the first-order part."""
FAIR_STEPS, HOPELESS = 3, 4.0
"""After so many steps, a state that costs so many times what is enough is given up."""
_POTRF, _POTRS = get_lapack_funcs(("potrf", "potrs"), dtype=np.float64)
"""LAPACK's factorisation of a positive definite matrix, and the solution with it."""


@dataclass(frozen=True)
class Cell:
    """The width and height of a cell, in parts of those of the film, each known up to one of the sightings' constants.

    across, down: width and height where the constants are 0. across_at, down_at: numbers of the constants that add to
    them.
    """

    across: float
    across_at: int
    down: float
    down_at: int

    def sides(self, constants: Float[np.ndarray, " g"]) -> tuple[float, float]:
        """Its width and height, in parts of those of the film; a step too far may leave no less than SMALLEST."""
        across, down = self.across + constants[self.across_at], self.down + constants[self.down_at]
        return max(float(across), SMALLEST), max(float(down), SMALLEST)

    def log_ratio(self, sheet: Sheet, constants: Float[np.ndarray, " g"]) -> float:
        """Logarithm of its height over its width, both measured along the sheet: 0 for a square cell."""
        across, down = self.sides(constants)
        return float(np.log(down / across) - sheet.log_aspect)


@dataclass(frozen=True, eq=False)
class State:
    """A sheet, the constants of all sightings, and their cost. bent: of the problem that the state solves."""

    sheet: Sheet
    constants: Float[np.ndarray, " g"]
    cost: float = np.inf
    bent: float = np.inf

    def moved(self, step: Float[np.ndarray, " m"]) -> State:
        """With a step of all unknowns added."""
        return replace(
            self, sheet=self.sheet.moved(step), constants=self.constants + step[len(step) - len(self.constants) :]
        )


@dataclass(frozen=True)
class Eased:
    """A cost of which each further part counts less: one film is hardly bent, another is rolled, and how much a film is
    bent or stretched is not known beforehand.

    A quadratic cost q becomes ``scale * log(1 + q / scale) + firm * q``: the first term as for a normal distribution of
    unknown width, the second because some widths do not occur. weight: of the quadratic cost with the same slope.
    beyond: by how much the eased cost exceeds that one.
    """

    weight: float
    beyond: float

    @staticmethod
    def of(cost: float, scale: float, firm: float = 0.0) -> Eased:
        if scale == np.inf:
            return Eased(1.0 + firm, 0.0)
        weight = 1.0 / (1.0 + cost / scale)
        return Eased(weight + firm, scale * float(np.log1p(cost / scale)) - weight * cost)


@dataclass(frozen=True, eq=False)
class Problem:
    """What is minimised. target: where the network puts the film. bent: cost of bending above which further
    bending costs ever less. square: cells that are taken to be square."""

    seen: Seen
    target: Float[np.ndarray, "m 2"]
    config: SheetConfig
    bent: float = np.inf
    square: tuple[Cell, ...] = ()

    def begun(self, sheet: Sheet) -> State:
        """The state of a sheet to start from."""
        return State(sheet, np.zeros(self.seen.shared.shape[1]), bent=self.bent)

    def explains(self, state: State, most: float) -> bool:
        """Whether a state's cost is below ``most`` per point seen."""
        return bool(state.cost < most * len(self.seen.along))

    def eased_after(self, state: State) -> Problem:
        """The same where further bending costs ever less: the better a state, which may not be bent enough yet,
        explains what is seen, the sooner."""
        curves = slid(self.seen, state.sheet, state.constants, self.seen.along, near=True)
        cost = self._from_sightings(state, curves, derivatives=False).cost
        return replace(self, bent=self.config.bent * max(cost, 1.0))

    def normal_equations(self, state: State, curves: Curves, derivatives: bool = True) -> Sum:
        """Cost of a state, and the normal equations around it; only the cost where ``derivatives`` is False."""
        sheet, config, constants = state.sheet, self.config, len(state.constants)
        strained = strain(sheet, config, constants, derivatives)
        stretching = Eased.of(strained.cost, config.stretched, config.firm)
        blocks = (
            self._from_network(sheet, constants, derivatives),
            self._from_sightings(state, curves, derivatives),
            strained.weighed(stretching.weight),
        )
        bending = Eased.of(bending_cost(sheet, config), self.bent)
        total = Sum(blocks, stretching.weight)
        total.add_energy(bending.weight * config.bending * bending_energy(sheet.intervals), sheet.control)
        total.cost += stretching.beyond + bending.beyond
        _add_camera(total, sheet, config, config.focal_sigma[len(self.seen.along) > 0])
        for k, (constant, spread) in enumerate(zip(state.constants, self.seen.shared_sigma, strict=True)):
            total.add_prior(constant / spread, {total.camera + CAMERA + k: 1.0 / spread})
        for cell in self.square:
            _add_square(total, state, cell, config)
        return total

    def _from_network(self, sheet: Sheet, constants: int, derivatives: bool) -> Block:
        """Distances of points of the film from where the network puts them."""
        nodes = at_nodes(sheet.intervals)
        shown = project(sheet, nodes.dense @ sheet.control)
        sigma = 1e-3 * self.config.network_px * np.sqrt(len(shown.point) / 6.0)
        residual = (shown.point - self.target) / sigma
        if not derivatives:
            return Block.without_derivatives(nodes, residual)
        block = Block.of(nodes, residual, constants)
        for k in (0, 1):
            block.write(k, (nodes.weights, shown.by_point[:, k] / sigma))
        block.tail[:, :, FOCAL], block.tail[:, :, LENS] = shown.by_focal / sigma, shown.by_lens / sigma
        return block

    def _from_sightings(self, state: State, curves: Curves, derivatives: bool) -> Block:
        """Distances of what is seen from its curves, with less weight where they are large."""
        shown = project(state.sheet, curves.design.values(state.sheet.control))
        residual = inner(shown.point - curves.point, curves.normal)
        residual += curves.pull @ (state.constants - curves.constants)
        root = np.sqrt(tukey_weights(residual / curves.tolerance))
        residual = (residual * root)[:, None]
        if not derivatives:
            return Block.without_derivatives(curves.design, residual)
        block, normal = Block.of(curves.design, residual, len(state.constants)), curves.normal * root[:, None]
        block.write(0, (curves.design.weights, np.einsum("nk,nkj->nj", normal, shown.by_point)))
        tail = block.tail[:, 0]
        tail[:, FOCAL], tail[:, LENS] = inner(shown.by_focal, normal), inner(shown.by_lens, normal)
        np.multiply(curves.pull, root[:, None], out=tail[:, CAMERA:])
        return block


def aspect_sigma(problem: Problem, state: State) -> float:
    """Standard deviation of the logarithm of the ratio of sides around a solution, from the inverse normal matrix.

    Sides that are parallel in the photo, as those of a sheet that only leans, do not determine the focal length, and so
    not the ratio. Infinite where the matrix cannot be inverted.
    """
    curves = slid(problem.seen, state.sheet, state.constants, problem.seen.along, near=True)
    total = problem.normal_equations(state, curves)
    factor, info = _POTRF(total.matrix.T, lower=True, clean=False)
    if info != 0:
        return float("inf")
    at = total.camera + ASPECT
    unit = np.zeros(len(total.right))
    unit[at] = 1.0
    return float(np.sqrt(_POTRS(factor, unit, lower=True)[0][at]))


def minimised(problem: Problem, state: State, steps: int, near: bool = False, enough: float = np.inf) -> State:
    """The state after at most so many Gauss-Newton steps.

    near: whether the state is already so near that residuals tell how exact the sightings are (``slid``); otherwise
    they do from the second step on. enough: cost below which a state is of use; the steps end where it stays far above.
    Raises LinAlgError where the normal equations cannot be solved.
    """
    damping = 1e-3
    curves = slid(problem.seen, state.sheet, state.constants, problem.seen.along, near)
    for step in range(steps):
        total = problem.normal_equations(state, curves)
        better = None
        for _ in range(4):
            trial = state.moved(_step(total, state.sheet, damping, problem.config))
            if trial.sheet.nearest() > NEAREST:
                reached = problem.normal_equations(trial, curves, derivatives=False).cost
                if reached < total.cost:
                    better = replace(trial, cost=reached)
                    break
            damping *= 8.0
        if better is None:
            return replace(state, cost=total.cost)
        state, damping = better, max(damping / 5.0, 1e-7)
        if step + near > 1 and total.cost - state.cost < problem.config.settled * total.cost:
            break
        if step >= FAIR_STEPS and state.cost > HOPELESS * enough:
            break
        curves = slid(problem.seen, state.sheet, state.constants, curves.along, near or step > 0)
    return state


def _step(total: Sum, sheet: Sheet, damping: float, config: SheetConfig) -> Float[np.ndarray, " m"]:
    """The damped Gauss-Newton step, bent along the valley that the strain makes.

    A sheet whose coefficients move along a straight line stretches with the square of the step; a second-order term
    takes that back (geodesic acceleration: Transtrum and Sethna 2012, "Improvements to the Levenberg-Marquardt
    algorithm for nonlinear least-squares minimization"). It is computed for the strain alone, where it matters most.
    """
    damped = total.matrix.copy()
    damped.flat[:: len(damped) + 1] *= 1.0 + damping
    factor, info = _POTRF(damped.T, lower=True, clean=False, overwrite_a=True)  # transposed, it is in LAPACK's order
    if info != 0:
        raise LinAlgError("the normal equations of the sheet are not positive definite")
    first = -_POTRS(factor, total.right, lower=True)[0]
    curved = total.strain_weight * strain_curvature(sheet, first, config)
    second = -0.5 * _POTRS(factor, curved, lower=True)[0]
    n = total.camera
    ratio = float(np.linalg.norm(second[:n]) / max(np.linalg.norm(first[:n]), 1e-12))
    return first + second * min(1.0, MOST_BENT / max(ratio, 1e-12))


def strain(sheet: Sheet, config: SheetConfig, constants: int, derivatives: bool) -> Block:
    """Residuals of the film's lengths along u and v, and of the right angle between them."""
    across, down = slopes(sheet.intervals)
    a, b, aspect = across.dense @ sheet.control, down.dense @ sheet.control, float(np.exp(sheet.log_aspect))
    sigma = config.strain * np.sqrt(len(a) / 40.0)
    stretch_a = inner(a, a) / aspect**2
    shear = inner(a, b) / (aspect * sigma)
    longer = ((stretch - 1.0) / (2.0 * sigma) for stretch in (stretch_a, inner(b, b)))
    residual = np.stack([*longer, shear], axis=1)
    if not derivatives:
        return Block.without_derivatives(across, residual)
    block = Block.of(across, residual, constants)
    block.write(0, (across.weights, a / (aspect**2 * sigma)))
    block.write(1, (down.weights, b / sigma))
    block.write(2, (across.weights, b / (aspect * sigma)), (down.weights, a / (aspect * sigma)))
    block.tail[:, 0, ASPECT], block.tail[:, 2, ASPECT] = -stretch_a / sigma, -shear
    return block


def strain_curvature(sheet: Sheet, step: Float[np.ndarray, " m"], config: SheetConfig) -> Float[np.ndarray, " m"]:
    """Second derivatives of the strain residuals along a step, times their first derivatives by all unknowns."""
    across, down = slopes(sheet.intervals)
    n, aspect = sheet.control.size, float(np.exp(sheet.log_aspect))
    move, wider = step[:n].reshape(3, -1).T, float(step[n + ASPECT])
    (a, by_a), (b, by_b) = ((x.dense @ sheet.control, x.dense @ move) for x in (across, down))
    aa, ab = inner(a, a), inner(a, b)
    stretch_a = inner(by_a, by_a) - 4.0 * wider * inner(a, by_a) + 2.0 * wider**2 * aa
    stretch_b = inner(by_b, by_b)
    shear = 2.0 * inner(by_a, by_b) - 2.0 * wider * (inner(a, by_b) + inner(b, by_a)) + wider**2 * ab
    stretch_a, shear = stretch_a / aspect**4, shear / aspect**2
    gradient = across.dense.T @ (a * stretch_a[:, None] + b * shear[:, None])
    gradient += down.dense.T @ (b * stretch_b[:, None] + a * shear[:, None])
    total = np.zeros(len(step))
    total[:n] = gradient.T.ravel()
    total[n + ASPECT] = -float(np.sum(stretch_a * aa) + np.sum(shear * ab))
    return total / (config.strain**2 * len(a) / 40.0)


def bending_cost(sheet: Sheet, config: SheetConfig) -> float:
    """Cost of bending: the mean squared second derivatives of the surface."""
    return 0.5 * config.bending * float(np.sum(sheet.control * (bending_energy(sheet.intervals) @ sheet.control)))


def _add_camera(total: Sum, sheet: Sheet, config: SheetConfig, focal_sigma: float) -> None:
    """Priors on phone cameras. focal_sigma: of the logarithm of the focal length, within the usual range."""
    focal = total.camera + FOCAL
    total.add_prior((sheet.log_focal - np.log(config.focal)) / focal_sigma, {focal: 1.0 / focal_sigma})
    beyond = sheet.log_focal - float(np.clip(sheet.log_focal, *np.log(config.focal_range)))
    if beyond:
        total.add_prior(beyond / config.beyond_sigma, {focal: 1.0 / config.beyond_sigma})
    total.add_prior(sheet.distortion / config.distortion, {total.camera + LENS: 1.0 / config.distortion})


def _add_square(total: Sum, state: State, cell: Cell, config: SheetConfig) -> None:
    """Prior on the ratio of a cell's sides, for a cell that is taken to be square."""
    across, down = cell.sides(state.constants)
    first, each = total.camera + CAMERA, 1.0 / config.square
    slopes = {
        total.camera + ASPECT: -each,
        first + cell.across_at: -each / across,
        first + cell.down_at: each / down,
    }
    total.add_prior(each * cell.log_ratio(state.sheet, state.constants), slopes)


__all__ = [
    "Cell",
    "Eased",
    "Problem",
    "State",
    "aspect_sigma",
    "bending_cost",
    "minimised",
    "strain",
    "strain_curvature",
]
