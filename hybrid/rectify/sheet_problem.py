"""What is minimised to find a sheet: distances of what is seen, strain, bending, and what is known beforehand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from hybrid.rectify.bspline import bending_energy
from hybrid.rectify.sheet import CAMERA, Sheet, SheetConfig, inner, node_weights, project, slopes
from hybrid.rectify.sheet_seen import Curves, Seen, slid
from hybrid.rectify.tps import tukey_weights

NEAREST = 0.05
"""No point of the sheet comes nearer to the camera than this, in units of the film's height."""
MOST_BENT = 0.4
"""Longest second-order part of a step, in lengths of the first."""


@dataclass(frozen=True, eq=False)
class State:
    """A sheet, the constants of all sightings, and the cost of both."""

    sheet: Sheet
    constants: Float[np.ndarray, " g"]
    cost: float = np.inf

    def moved(self, step: Float[np.ndarray, " m"]) -> State:
        """With a step of all unknowns added."""
        return State(self.sheet.moved(step), self.constants + step[len(step) - len(self.constants) :])


@dataclass(frozen=True, eq=False)
class Problem:
    """What is minimised. target: where the network has the film. bending: weight of bending."""

    seen: Seen
    target: Float[np.ndarray, "m 2"]
    bending: float
    config: SheetConfig

    def begun(self, sheet: Sheet) -> State:
        """A sheet to start from."""
        return State(sheet, np.zeros(self.seen.shared.shape[1]))

    def explains(self, state: State, most: float) -> bool:
        """Whether a state's cost is below ``most`` for each point that is seen."""
        return bool(state.cost < most * len(self.seen.along))

    def normal_equations(self, state: State, curves: Curves, derivatives: bool = True) -> Sum:
        """Cost of a state, and the normal equations around it; without the latter where ``derivatives`` is False."""
        sheet, config, n = state.sheet, self.config, len(state.sheet.control)
        total = Sum(3 * n + CAMERA + len(state.constants), derivatives)
        nodes = node_weights(sheet.intervals)
        shown = project(sheet, nodes @ sheet.control)
        sigma = 1e-3 * config.network_px * np.sqrt(len(nodes) / 6.0)
        rows = None
        if derivatives:
            rows = np.empty((2, len(nodes), 3 * n + CAMERA))
            for k in (0, 1):
                _by_surface(rows[k], nodes, shown.by_point[:, k] / sigma)
                _by_camera(rows[k], n, shown.by_focal[:, k] / sigma, shown.by_lens[:, k] / sigma)
            rows = rows.reshape(-1, rows.shape[2])
        total.add((shown.point - self.target).T.ravel() / sigma, rows)
        shown = project(sheet, curves.weights @ sheet.control)
        residual = inner(shown.point - self.seen.point, curves.normal)
        residual += curves.pull * (self.seen.shared @ (state.constants - curves.constants))
        root = np.sqrt(tukey_weights(residual / curves.tolerance))
        rows = None
        if derivatives:
            normal = curves.normal * root[:, None]
            rows = np.empty((len(root), 3 * n + CAMERA + len(state.constants)))
            _by_surface(rows, curves.weights, np.einsum("nk,nkj->nj", normal, shown.by_point))
            _by_camera(rows, n, *(inner(x, normal) for x in (shown.by_focal, shown.by_lens)))
            np.multiply(self.seen.shared, (curves.pull * root)[:, None], out=rows[:, 3 * n + CAMERA :])
        total.add(residual * root, rows)
        add_strain(total, sheet, config)
        _add_bending(total, sheet, self.bending)
        _add_camera(total, sheet, config, config.focal_sigma[len(self.seen.along) > 0])
        for k, (constant, spread) in enumerate(zip(state.constants, self.seen.shared_sigma, strict=True)):
            total.add_prior(3 * n + CAMERA + k, constant / spread, 1.0 / spread)
        return total


def minimised(problem: Problem, state: State, steps: int) -> State:
    """The state after at most so many Gauss-Newton steps.

    Raises LinAlgError where the normal equations cannot be solved.
    """
    damping = 1e-3
    curves = slid(problem.seen, state.sheet, state.constants, problem.seen.along, near=False)
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
        if step > 1 and total.cost - state.cost < problem.config.settled * total.cost:
            break
        curves = slid(problem.seen, state.sheet, state.constants, curves.along, near=step > 0)
    return state


def _step(total: Sum, sheet: Sheet, damping: float, config: SheetConfig) -> Float[np.ndarray, " m"]:
    """The damped Gauss-Newton step, bent along the valley that the strain makes.

    A sheet that is bent along a straight line of coefficients stretches with the square of the step; a second-order
    term takes that back (geodesic acceleration: Transtrum and Sethna 2012, "Improvements to the Levenberg-Marquardt
    algorithm for nonlinear least-squares minimization"), of the strain alone, where it counts most.
    """
    damped = total.matrix.copy()
    damped.flat[:: len(damped) + 1] *= 1.0 + damping
    factor = cho_factor(damped, overwrite_a=True, check_finite=False)
    first = -cho_solve(factor, total.right, check_finite=False)
    second = -0.5 * cho_solve(factor, strain_curvature(sheet, first, config), check_finite=False)
    n = 3 * len(sheet.control)
    ratio = float(np.linalg.norm(second[:n]) / max(np.linalg.norm(first[:n]), 1e-12))
    return first + second * min(1.0, MOST_BENT / max(ratio, 1e-12))


class Sum:
    """Cost, normal matrix and gradient of residuals that are added block by block."""

    def __init__(self, unknowns: int, derivatives: bool) -> None:
        self.cost, self.derivatives = 0.0, derivatives
        size = unknowns if derivatives else 0
        self.matrix, self.right = np.zeros((size, size)), np.zeros(size)

    def add(self, residual: Float[np.ndarray, " m"], rows: Float[np.ndarray, "m u"] | None) -> None:
        """Residuals in deviations, and their derivatives by the first unknowns."""
        self.cost += 0.5 * float(residual @ residual)
        if rows is not None:
            used = rows.shape[1]
            self.matrix[:used, :used] += rows.T @ rows  # of one matrix with itself only half is computed
            self.right[:used] += residual @ rows

    def add_prior(self, k: int, residual: float, slope: float) -> None:
        """What is known of one unknown beforehand."""
        self.cost += 0.5 * residual * residual
        if self.derivatives:
            self.matrix[k, k] += slope * slope
            self.right[k] += slope * residual


def _by_surface(
    rows: Float[np.ndarray, "m u"], weights: Float[np.ndarray, "m n"], by_point: Float[np.ndarray, "m 3"]
) -> None:
    """Writes derivatives of residuals by the coefficients, given those by the point in space that these weigh."""
    n = weights.shape[1]
    for k in range(3):
        np.multiply(weights, by_point[:, k : k + 1], out=rows[:, k * n : (k + 1) * n])


def _by_camera(
    rows: Float[np.ndarray, "m u"], n: int, by_focal: Float[np.ndarray, " m"], by_lens: Float[np.ndarray, " m"]
) -> None:
    """Writes derivatives by the camera, after those by n coefficients; the ratio of sides moves no point."""
    for k, values in enumerate((by_focal, 0.0, by_lens)):
        rows[:, 3 * n + k] = values


def add_strain(total: Sum, sheet: Sheet, config: SheetConfig) -> None:
    """Residuals of the lengths of film along u and v, and of the right angle between them."""
    across, down = slopes(sheet.intervals)
    a, b, aspect = across @ sheet.control, down @ sheet.control, float(np.exp(sheet.log_aspect))
    (m, n), sigma = across.shape, config.strain * np.sqrt(len(across) / 40.0)
    stretch_a = inner(a, a) / aspect**2
    shear = inner(a, b) / (aspect * sigma)
    rows = None
    if total.derivatives:
        rows = np.empty((3, m, 3 * n + CAMERA))
        _by_surface(rows[0], across, a / (aspect**2 * sigma))
        _by_surface(rows[1], down, b / sigma)
        _by_surface(rows[2], across, b / (aspect * sigma))
        for k in range(3):
            rows[2, :, k * n : (k + 1) * n] += down * (a[:, k : k + 1] / (aspect * sigma))
        rows[:, :, 3 * n :] = 0.0
        rows[0, :, 3 * n + 1], rows[2, :, 3 * n + 1] = -stretch_a / sigma, -shear
        rows = rows.reshape(3 * m, -1)
    longer = ((stretch - 1.0) / (2.0 * sigma) for stretch in (stretch_a, inner(b, b)))
    total.add(np.concatenate([*longer, shear]), rows)


def strain_curvature(sheet: Sheet, step: Float[np.ndarray, " m"], config: SheetConfig) -> Float[np.ndarray, " m"]:
    """Second derivatives of the strain's residuals along a step, times their first derivatives by all unknowns."""
    across, down = slopes(sheet.intervals)
    n, aspect = len(sheet.control), float(np.exp(sheet.log_aspect))
    move, wider = step[: 3 * n].reshape(3, n).T, float(step[3 * n + 1])
    a, b, by_a, by_b = across @ sheet.control, down @ sheet.control, across @ move, down @ move
    aa, ab = inner(a, a), inner(a, b)
    stretch_a = inner(by_a, by_a) - 4.0 * wider * inner(a, by_a) + 2.0 * wider**2 * aa
    stretch_b = inner(by_b, by_b)
    shear = 2.0 * inner(by_a, by_b) - 2.0 * wider * (inner(a, by_b) + inner(b, by_a)) + wider**2 * ab
    stretch_a, shear = stretch_a / aspect**4, shear / aspect**2
    gradient = across.T @ (a * stretch_a[:, None] + b * shear[:, None])
    gradient += down.T @ (b * stretch_b[:, None] + a * shear[:, None])
    total = np.zeros(len(step))
    total[: 3 * n] = gradient.T.ravel()
    total[3 * n + 1] = -float(np.sum(stretch_a * aa) + np.sum(shear * ab))
    return total / (config.strain**2 * len(across) / 40.0)


def bending_cost(sheet: Sheet, weight: float) -> float:
    """Cost of bending: the mean squared second derivatives of the surface."""
    return 0.5 * weight * float(np.sum(sheet.control * (bending_energy(sheet.intervals) @ sheet.control)))


def _add_bending(total: Sum, sheet: Sheet, weight: float) -> None:
    """The same, with its derivatives."""
    total.cost += bending_cost(sheet, weight)
    if total.derivatives:
        energy, n = weight * bending_energy(sheet.intervals), len(sheet.control)
        for k in range(3):
            own = slice(k * n, (k + 1) * n)
            total.matrix[own, own] += energy
            total.right[own] += energy @ sheet.control[:, k]


def _add_camera(total: Sum, sheet: Sheet, config: SheetConfig, focal_sigma: float) -> None:
    """What is known of phones' cameras. focal_sigma: of the logarithm of the focal length, within the usual range."""
    first = 3 * len(sheet.control)
    total.add_prior(first, (sheet.log_focal - np.log(config.focal)) / focal_sigma, 1.0 / focal_sigma)
    beyond = sheet.log_focal - float(np.clip(sheet.log_focal, *np.log(config.focal_range)))
    if beyond:
        total.add_prior(first, beyond / config.beyond_sigma, 1.0 / config.beyond_sigma)
    total.add_prior(first + 2, sheet.distortion / config.distortion, 1.0 / config.distortion)


__all__ = ["Problem", "State", "Sum", "add_strain", "bending_cost", "minimised", "strain_curvature"]
