"""The minimisation within one step: energy, gradient, tangent, and a Newton iteration that returns to isometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hybrid.mesh.banded import BandFactor
from hybrid.mesh.contact import Touch, contact_energy, contact_gradient, entering, friction_loss
from hybrid.mesh.loads import Loads
from hybrid.mesh.network import (
    CellStress,
    MassSpring,
    Strain,
    cell_tangents,
    edge_tangents,
    spring_gradient,
    strain,
    stress,
    stretch_energy,
)
from hybrid.mesh.tangent import tangent_factor

_TURN_LIMIT = 0.8
"""Limit on the first trial length of a Newton step: no edge may turn (or stretch) by more than about this (rad)."""

_RETURNS = 4
"""Maximum number of solves that bring the strain back to the linear model's, for each step length tried."""

_RETURNED = 1e-7
"""Strain error at which the return ends: a thousandth of the strain that a frame may have."""

_HALVINGS = 10

_LEAD_LIMIT = 0.3
"""The descent starts at the guess if no edge turns by more than this (rad) to get there."""

_REUSE_TURN = 0.02
"""A factor is reused after a move that turned (or stretched) no edge by more than this."""

_REUSE_SHRINK = 0.2
"""... and stays in use until a move is longer than this share of the one before."""

_LANDINGS = 2
"""Maximum number of times a Newton move is recomputed because vertices would enter a body."""


@dataclass(frozen=True, eq=False)
class StepProblem:
    """One step's energy.

    inertia: (V,) force per length. target: (V, 3), where inertia alone would lead. start: (V, 3) before the step.
    force: (V, 3) constant during the step. hold: (V,) stiffness of goals and pins. drag: (V,) force per length.
    """

    network: MassSpring
    loads: Loads
    inertia: Float[np.ndarray, " v"]
    target: Float[np.ndarray, "v 3"]
    start: Float[np.ndarray, "v 3"]
    force: Float[np.ndarray, "v 3"]
    hold: Float[np.ndarray, " v"]
    drag: Float[np.ndarray, " v"]
    drag_normal: Float[np.ndarray, "v 3"]
    touches: tuple[Touch, ...]

    def strain(self, x: Float[np.ndarray, "v 3"]) -> Strain:
        """Strain of the lattice at ``x``."""
        return strain(self.network, x.reshape(*self.network.film.shape, 3))

    def potential(self, x: Float[np.ndarray, "v 3"], state: Strain) -> float:
        """Energy stored in springs, bending, goals and contacts, less the work of the forces since the start."""
        bent = self.network.bending_root @ x
        total = stretch_energy(self.network, state) + 0.5 * np.vdot(bent, bent)
        total -= np.vdot(self.force, x - self.start)
        total += 0.5 * np.sum(self.hold * ((x - self.loads.goal_mm) ** 2).sum(axis=1))
        return float(total + sum(contact_energy(contact, x) for contact in self.touches))

    def losses(self, x: Float[np.ndarray, "v 3"]) -> float:
        """Energy lost to drag and friction."""
        along = np.einsum("vk,vk->v", x - self.start, self.drag_normal)
        return float(0.5 * np.sum(self.drag * along**2) + sum(friction_loss(contact, x) for contact in self.touches))

    def energy(self, x: Float[np.ndarray, "v 3"], state: Strain) -> float:
        """What the step minimises."""
        kinetic = 0.5 * np.sum(self.inertia * ((x - self.target) ** 2).sum(axis=1))
        return float(kinetic + self.potential(x, state) + self.losses(x))

    def gradient(self, x: Float[np.ndarray, "v 3"], state: Strain) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (V, 3) of the energy and the part of its Hessian that couples no vertices (V, 3, 3)."""
        network = self.network
        total = self.inertia[:, None] * (x - self.target) - self.force
        total += network.bending @ x
        total += self.hold[:, None] * (x - self.loads.goal_mm)
        total += spring_gradient(network, state, stress(network, state.along_u, state.along_v, state.shear))
        normal = self.drag_normal
        total += (self.drag * np.einsum("vk,vk->v", x - self.start, normal))[:, None] * normal
        own = (self.inertia + self.hold)[:, None, None] * np.eye(3)
        own += self.drag[:, None, None] * (normal[:, :, None] * normal[:, None, :])
        for contact in self.touches:
            slope, block = contact_gradient(contact, x)
            total += slope
            own += block
        return total, own


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a minimisation ended: positions, their strain, iterations, the last move (length) and residual (force)."""

    x: Float[np.ndarray, "v 3"]
    state: Strain
    iterations: int
    moved: float
    residual: float
    converged: bool


def descend(problem: StepProblem, guess: Float[np.ndarray, "v 3"], tolerance: float, max_iterations: int) -> Descent:
    """Minimise the step's energy until no vertex moves by more than ``tolerance`` (length).

    The descent starts at ``guess`` if that is not far. If it ends at a higher energy than the step's start has, it is
    repeated from the step's start.
    """
    start = problem.strain(problem.start)
    ahead = max(float(np.abs(part).max()) for part in _tangents(problem, guess - problem.start))
    if 0 < ahead < _LEAD_LIMIT:
        result = _descend_from(problem, guess, start, tolerance, max_iterations)
        if problem.energy(result.x, result.state) <= problem.energy(problem.start, start):
            return result
    return _descend_from(problem, problem.start, start, tolerance, max_iterations)


def _descend_from(
    problem: StepProblem, x: Float[np.ndarray, "v 3"], known: Strain, tolerance: float, max_iterations: int
) -> Descent:
    """Minimise from ``x``, where the stress is close to that of the strain ``known``.

    A factor is reused as long as the sheet hardly turns and the moves shrink.
    """
    state = problem.strain(x)
    promised = _Promise(known.along_u, known.along_v, known.shear)
    energy, moved, residual = problem.energy(x, state), np.inf, np.inf
    model: _Model | None = None
    for iteration in range(1, max_iterations + 1):
        gradient, own = problem.gradient(x, state)
        residual = float(np.abs(gradient).max())
        fresh = model is None
        if model is None:
            model = _model(problem, x, state, promised.stress(problem.network), gradient, own)
        if model is None or not np.isfinite(residual):
            return Descent(x, state, iteration, np.inf, residual, False)
        move = model.first_move if fresh else -model.tangent.solve(gradient)
        gain = -float(np.vdot(gradient, move))
        tried = _line_search(problem, x, state, energy, move, gain, model)
        if tried is None and fresh:
            # Rounding hides any gain that is left, unless the model promised more than rounding.
            slight = gain < 1e-9 * (abs(energy) + problem.network.bending_stiffness)
            return Descent(x, state, iteration, float(np.abs(move).max()), residual, slight)
        if tried is None:
            model = None
            continue
        after, state, energy, promised = tried
        turned = max(float(np.abs(part).max()) for part in _tangents(problem, after - x))
        quadratic = fresh and model.exact and float(np.abs(after - x).max()) > 0.8 * float(np.abs(move).max())
        before, moved, x = moved, float(np.abs(move).max()), after
        if quadratic and 2 * turned * moved <= tolerance:
            # Each Newton move leaves about its length times its turn for the next (measured: 0.1 to 2.2 times that).
            return Descent(x, state, iteration, 2 * turned * moved, residual, True)
        if moved <= tolerance:
            return Descent(x, state, iteration, moved, residual, True)
        if turned > _REUSE_TURN or (not fresh and moved > _REUSE_SHRINK * before):
            model = None
    return Descent(x, state, max_iterations, moved, residual, False)


@dataclass(frozen=True, eq=False)
class _Model:
    """A factored tangent, whether it is exact, the state it belongs to, and the Newton move from there."""

    tangent: BandFactor
    exact: bool
    base: Strain
    first_move: Float[np.ndarray, "v 3"]


@dataclass(frozen=True, eq=False)
class _Promise:
    """The strain that the linear model gives for a move."""

    along_u: Float[np.ndarray, "rows c1"]
    along_v: Float[np.ndarray, "r1 cols"]
    shear: Float[np.ndarray, "r1 c1"]

    def stress(self, network: MassSpring) -> CellStress:
        """Stress of the promised strain."""
        return stress(network, self.along_u, self.along_v, self.shear)

    def missed_by(self, state: Strain) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Actual minus promised strain."""
        return state.along_u - self.along_u, state.along_v - self.along_v, state.shear - self.shear


def _model(
    problem: StepProblem, x: np.ndarray, state: Strain, force: CellStress, gradient: np.ndarray, own: np.ndarray
) -> _Model | None:
    """Tangent and Newton move, recomputed if vertices would enter a body whose contact springs they do not feel yet."""
    found = tangent_factor(problem.network, state, force, own)
    if found is None:
        return None
    tangent, exact = found
    move = -tangent.solve(gradient)
    for _ in range(_LANDINGS if problem.touches else 0):
        ahead = [entering(contact, x, x + move) for contact in problem.touches]
        if not any(block.any() for _, block in ahead):
            break
        own = own + sum(block for _, block in ahead)
        gradient = gradient + sum(slope for slope, _ in ahead)
        landing = tangent_factor(problem.network, state, force, own)
        if landing is None:
            break
        tangent, exact = landing
        move = -tangent.solve(gradient)
    return _Model(tangent, exact and not problem.touches, state, move)


def _line_search(
    problem: StepProblem,
    x: np.ndarray,
    state: Strain,
    energy: float,
    move: np.ndarray,
    slope: float,
    model: _Model,
) -> tuple[np.ndarray, Strain, float, _Promise] | None:
    """The first of ever shorter moves that lowers the energy, each judged after its return to the promised strain."""
    change = _linear_change(problem, state, move)
    turn = max(float(np.abs(part).max()) for part in _tangents(problem, move))
    length = min(1.0, _TURN_LIMIT / max(turn, 1e-300))
    for _ in range(_HALVINGS):
        promise = _Promise(
            state.along_u + length * change[0], state.along_v + length * change[1], state.shear + length * change[2]
        )
        after, strained = _returned(problem, x + length * move, promise, model)
        reached = problem.energy(after, strained)
        if reached <= energy - 1e-4 * length * slope:
            return after, strained, reached, promise
        length *= 0.4
    return None


def _returned(problem: StepProblem, x: np.ndarray, promise: _Promise, model: _Model) -> tuple[np.ndarray, Strain]:
    """``x`` with its strain brought (nearly) to the promised one by the moves that the tangent resists least."""
    network = problem.network
    state = problem.strain(x)
    worst = max(float(np.abs(miss).max()) for miss in promise.missed_by(state))
    for _ in range(_RETURNS):
        if worst < _RETURNED:
            break
        force = stress(network, *promise.missed_by(state))
        tried = x - model.tangent.solve(spring_gradient(network, model.base, force))
        strained = problem.strain(tried)
        left = max(float(np.abs(miss).max()) for miss in promise.missed_by(strained))
        if not left < worst:
            break
        x, state, worst = tried, strained, left
    return x, state


def _tangents(problem: StepProblem, move: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Change of the edge tangents in a move."""
    return edge_tangents(problem.network, move.reshape(*problem.network.film.shape, 3))


def _linear_change(problem: StepProblem, state: Strain, move: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """J move: the first-order change of strain."""
    across, down = _tangents(problem, move)
    mean_u, mean_v = cell_tangents(state.across, state.down)
    move_u, move_v = cell_tangents(across, down)
    shear = np.einsum("rck,rck->rc", move_u, mean_v) + np.einsum("rck,rck->rc", mean_u, move_v)
    return (
        np.einsum("rck,rck->rc", state.across, across),
        np.einsum("rck,rck->rc", state.down, down),
        shear,
    )
