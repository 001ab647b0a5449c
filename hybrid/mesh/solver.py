"""Implicit time steps of a film that bends but does not stretch: backward Euler, Newton with a return to isometry.

A step minimises ``|x - y|^2_M / (2 dt^2) + U(x) + losses(x)``, where y is the position to which inertia alone would
lead (Martin et al. 2011, "Example-based elastic materials", eq. 2). A film resists stretching 1e5 times more than
bending. A plain Newton direction is straight and so stretches what it turns: a turn by an angle a stretches by a^2 / 2,
and the line search then allows only tiny moves. Here each direction is followed by a few solves with the *same* factor
that bring the strain back to what the linear model promised (a second-order correction, as in sequential quadratic
programming; Nocedal & Wright, Numerical Optimization, 15.6), and the energy is evaluated there. The geometric stiffness
also uses the stress of the linear model, not that of the strain in between.

Every matrix is positive definite and no step raises the energy, so no step size, stiffness or load can make the
state explode; the velocity is cut so that the total energy cannot grow beyond the work done on the sheet.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from jaxtyping import Float

from hybrid.errors import SimulationError, describe
from hybrid.mesh.contact import touch
from hybrid.mesh.film import FilmMesh
from hybrid.mesh.loads import Loads
from hybrid.mesh.material import STANDARD_GRAVITY
from hybrid.mesh.network import MassSpring, lattice_normals
from hybrid.mesh.newton import Descent, StepProblem, descend

_PIN = 100.0
"""Stiffness of a pin, in multiples of C11."""

_SINK = 5e-6
"""How deep the sheet's own weight presses it into a body, as a share of its diagonal."""

_SLIP = 2e-5
"""Travel along a body below which friction holds like a spring, as a share of the diagonal."""


class FrameStatus(Enum):
    """How a step ended, as a sentence."""

    OK = "The sheet is where the loads want it, and is not stretched."
    STRETCHED = "The loads cannot be met without stretching the film: holds are further apart than it is long, or pull."
    UNCONVERGED = (
        "The step was cut short before the forces balanced: more iterations or a smaller step would finish it."
    )


@dataclass(frozen=True)
class StepConfig:
    """How a time step is solved.

    dt_s: seconds. damping_per_s: rate at which velocity is lost. max_iterations: Newton's limit.
    tolerance: Newton stops when no vertex moves further than this share of the sheet's diagonal.
    strain_limit: strain above which a frame's status says that the film is stretched.
    """

    dt_s: float = 1 / 30
    damping_per_s: float = 1.0
    max_iterations: int = 20
    tolerance: float = 1e-5
    strain_limit: float = 1e-4


@dataclass(frozen=True)
class SettleConfig:
    """How a rest shape is found: steps from ``first_dt_s`` to ``last_dt_s`` seconds; the rest as in StepConfig."""

    first_dt_s: float = 0.1
    last_dt_s: float = 400.0
    max_steps: int = 60
    max_iterations: int = 20
    tolerance: float = 1e-6
    strain_limit: float = 1e-4


@dataclass(frozen=True, eq=False)
class Frame:
    """The sheet after a step.

    mesh: the bent sheet. velocity: (V, 3) mm/s. iterations: Newton iterations. moved_mm: the residual as a length, the
    last iteration's largest move, or what it leaves for the next where Newton converges quadratically. max_strain:
    largest strain of an edge, or half shear of a cell. residual_n: largest force on a vertex before the last move.
    status: how it ended. acceleration: (V, 3) mm/s^2 during the step; the next step guesses from it where it ends.
    """

    mesh: FilmMesh
    velocity: Float[np.ndarray, "v 3"]
    iterations: int
    moved_mm: float
    max_strain: float
    residual_n: float = 0.0
    status: FrameStatus = FrameStatus.OK
    acceleration: Float[np.ndarray, "v 3"] | None = None


def at_rest(mesh: FilmMesh) -> Frame:
    """A sheet that does not move."""
    still = np.zeros((mesh.vertices.shape[0] * mesh.vertices.shape[1], 3))
    return Frame(mesh, still, 0, 0.0, float(np.abs(mesh.edge_strain()).max()))


def step(network: MassSpring, frame: Frame, loads: Loads, config: StepConfig) -> Frame:
    """The sheet one time step later.

    Raises:
        SimulationError: the loads or the state are not finite, or so large that the energy is not.
    """
    _check(network, frame, loads, config)
    problem = _step_problem(network, frame, loads, config)
    guess = problem.target
    if frame.acceleration is not None:
        guess = guess + config.dt_s**2 * frame.acceleration
    result = descend(problem, guess, config.tolerance * network.size, config.max_iterations)
    if not np.isfinite(result.residual):
        raise SimulationError(
            describe(
                what="step",
                got=f"a residual of {result.residual} N after {result.iterations} iterations",
                allowed="finite energies",
                do="Use smaller forces, or a stiffness nearer to a film's.",
            )
        )
    velocity = _bounded_velocity(problem, result, frame, config)
    mesh = frame.mesh.bent(result.x.reshape(frame.mesh.vertices.shape))
    largest = result.state.largest
    status = FrameStatus.STRETCHED if largest > config.strain_limit else FrameStatus.OK
    if not result.converged:  # the strain is not yet the one that the loads cause
        status = FrameStatus.UNCONVERGED
    acceleration = (velocity - frame.velocity) / config.dt_s
    return Frame(mesh, velocity, result.iterations, result.moved, largest, result.residual, status, acceleration)


def settle(network: MassSpring, frame: Frame, loads: Loads, config: SettleConfig) -> Frame:
    """The shape in which the sheet comes to rest under steady loads (quasi-static: inertia only guides the way).

    Steps from standstill grow longer until a long one moves nothing.
    """
    dt_s, total = config.first_dt_s, 0
    for _ in range(config.max_steps):
        stepping = StepConfig(dt_s, 0.0, config.max_iterations, config.tolerance, config.strain_limit)
        after = step(network, still(frame), loads, stepping)
        moved = float(np.abs(after.mesh.vertices - frame.mesh.vertices).max())
        total += after.iterations
        frame = replace(
            after, iterations=total, moved_mm=moved, velocity=np.zeros_like(after.velocity), acceleration=None
        )
        if dt_s >= config.last_dt_s and moved <= 10 * config.tolerance * network.size:
            return frame
        dt_s = min(4 * dt_s, config.last_dt_s)
    return replace(frame, status=FrameStatus.UNCONVERGED)


def still(frame: Frame) -> Frame:
    """The same sheet, standing still."""
    return replace(frame, velocity=np.zeros_like(frame.velocity), acceleration=None)


def steady_force(network: MassSpring, frame: Frame, loads: Loads) -> Float[np.ndarray, "v 3"]:
    """All forces (N) that stay the same during the step from ``frame``: those of the loads and of rest curvature.

    Rest curvature acts along the normal, kept fixed for the step: on an isometry, bending has no component across it.
    """
    curl_u, curl_v = loads.rest_curvature
    if not (curl_u or curl_v):
        return loads.force_n
    normals = lattice_normals(network, frame.mesh.vertices).reshape(-1, 3)
    return loads.force_n + (curl_u * network.curvature_u + curl_v * network.curvature_v) @ normals


def mechanical_energy(network: MassSpring, frame: Frame, loads: Loads) -> float:
    """Kinetic and potential energy (N x length) under steady loads; that of forces is minus their work from 0."""
    problem = _step_problem(network, frame, loads, StepConfig(dt_s=1.0))
    kinetic = 0.5 * float(np.sum(problem.inertia * (frame.velocity**2).sum(axis=1)))
    work = float(np.vdot(problem.force, problem.start))
    return kinetic + problem.potential(problem.start, problem.strain(problem.start)) - work


def _step_problem(network: MassSpring, frame: Frame, loads: Loads, config: StepConfig) -> StepProblem:
    x0 = frame.mesh.vertices.reshape(-1, 3)
    drag = loads.drag if loads.drag is not None else np.zeros(len(x0))
    normal = loads.drag_normal if loads.drag_normal is not None else np.zeros_like(x0)
    weight = network.mass_kg * STANDARD_GRAVITY
    touches = tuple(touch(body, x0, weight / (_SINK * network.size), _SLIP * network.size) for body in loads.bodies)
    return StepProblem(
        network=network,
        loads=loads,
        inertia=network.mass_kg * network.metres_per_unit / config.dt_s**2,
        target=x0 + float(np.exp(-config.damping_per_s * config.dt_s)) * config.dt_s * frame.velocity,
        start=x0,
        force=steady_force(network, frame, loads),
        hold=np.where(np.isinf(loads.goal_stiffness), _PIN * network.membrane[0], loads.goal_stiffness),
        drag=drag / config.dt_s,
        drag_normal=normal,
        touches=touches,
    )


def _bounded_velocity(problem: StepProblem, result: Descent, frame: Frame, config: StepConfig) -> np.ndarray:
    """Velocity after the step, cut so that kinetic energy gains no more than the potential has lost.

    Backward Euler ensures this by itself where the energy is convex and its minimum was reached; a descent that was cut
    short need not.
    """
    velocity = (result.x - problem.start) / config.dt_s
    mass = problem.inertia * config.dt_s**2
    before = problem.potential(problem.start, problem.strain(problem.start))
    spent = problem.potential(result.x, result.state) + problem.losses(result.x) - before
    had = 0.5 * float(np.sum(mass * (frame.velocity**2).sum(axis=1)))
    has = 0.5 * float(np.sum(mass * (velocity**2).sum(axis=1)))
    allowed = max(had - spent, 0.0)
    return velocity if has <= allowed else velocity * np.sqrt(allowed / has)


def _check(network: MassSpring, frame: Frame, loads: Loads, config: StepConfig) -> None:
    arrays = {
        "force": loads.force_n,
        "goal": loads.goal_mm[loads.goal_stiffness > 0],
        "position": frame.mesh.vertices,
        "velocity": frame.velocity,
        "drag": loads.drag if loads.drag is not None else np.zeros(0),
        "rest curvature": np.array(loads.rest_curvature),
    }
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            raise SimulationError(describe(what="step", got=f"a {name} that is not finite", do=f"Bound the {name}."))
    if np.isnan(loads.goal_stiffness).any() or (loads.goal_stiffness < 0).any():
        raise SimulationError(
            describe(what="step", got="a goal stiffness below 0 or NaN", allowed="0 to inf", do="Correct it.")
        )
    if not (config.dt_s > 0 and np.isfinite(config.dt_s)):
        raise SimulationError(describe(what="step", got=f"dt_s = {config.dt_s}", allowed="> 0", do="Correct it."))
