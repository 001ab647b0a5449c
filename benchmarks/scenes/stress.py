"""Random scenes that try to break the solver: each must end in a shape or a readable refusal, and gain no energy."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from hybrid.errors import HybridError
from hybrid.mesh.contact import Body, Cylinder, Plane, Sphere, TableEdge
from hybrid.mesh.film import FilmMesh
from hybrid.mesh.loads import Loads
from hybrid.mesh.material import STANDARD_GRAVITY, FilmMaterial
from hybrid.mesh.network import MassSpring, clamped, mass_spring
from hybrid.mesh.solver import Frame, StepConfig, at_rest, mechanical_energy, steady_force, step

STEPS = 4
"""Number of time steps of a scene."""

ENERGY_ROUNDING = 1e-9
"""Growth of energy that counts as rounding, as a share of the largest energy at play."""


@dataclass(frozen=True, eq=False)
class StressScene:
    """A sheet in some state under some loads."""

    network: MassSpring
    frame: Frame
    loads: Loads
    config: StepConfig


@dataclass(frozen=True)
class StressResult:
    """How a scene ended: ``outcome`` is the last frame's status or the refusal's type; ``failure`` is empty if none.

    growth: the largest growth of energy in a step, as a share of the largest energy at play.
    """

    seed: int
    outcome: str
    failure: str
    message: str
    growth: float = 0.0


def run_scene(seed: int, largest: int = 65) -> StressResult:
    """One random scene of at most ``largest`` vertices a side."""
    try:
        scene = random_scene(np.random.default_rng(seed), largest)
    except HybridError as refusal:
        return _refused(seed, refusal)
    frame, largest_growth = scene.frame, 0.0
    for _ in range(STEPS):
        try:
            after = step(scene.network, frame, scene.loads, scene.config)
        except HybridError as refusal:
            return _refused(seed, refusal)
        if not (np.isfinite(after.mesh.vertices).all() and np.isfinite(after.velocity).all()):
            return StressResult(seed, after.status.name, "not finite", str(after.status.value))
        growth = _energy_growth(scene, frame, after)
        if growth > ENERGY_ROUNDING:
            failure = f"energy grew by {growth:.3g} of the largest at play"
            return StressResult(seed, after.status.name, failure, str(after.status.value), growth)
        frame, largest_growth = after, max(largest_growth, growth)
    return StressResult(seed, frame.status.name, "", str(frame.status.value), largest_growth)


def outcomes(results: list[StressResult]) -> dict[str, int]:
    """How many scenes ended in each way."""
    return dict(sorted(Counter(result.outcome for result in results).items()))


def random_scene(rng: np.random.Generator, largest: int) -> StressScene:
    """Stiffness over nine decades, steps from 1e-4 to 1 s, forces to 1000 g, meshes from 2 x 2; flat to collapsed.

    Raises:
        ConfigError: a lattice has triangles without area (one scene in twenty asks for that).
    """
    film = _random_film(rng, largest)
    material = FilmMaterial(
        youngs_modulus_mpa=float(10 ** rng.uniform(-4, 5)),
        thickness_mm=float(10 ** rng.uniform(-1.5, 0.3)),
        poisson=float(rng.uniform(0, 0.5)),
        membrane_scale=float(10 ** rng.uniform(-4, 0)) if rng.random() < 0.3 else 1.0,
    )
    network = mass_spring(film, material)
    loads = _random_loads(network, rng)
    network = clamped(network, np.isinf(loads.goal_stiffness).reshape(film.shape))
    frame = at_rest(film.bent(_random_state(film, rng)))
    speed = float(10 ** rng.uniform(0, 4)) if rng.random() < 0.5 else 0.0
    frame = replace(frame, velocity=speed * rng.normal(size=frame.velocity.shape))
    config = StepConfig(
        dt_s=float(10 ** rng.uniform(-4, 0)),
        damping_per_s=float(rng.choice([0.0, 1.0])),
        max_iterations=int(rng.integers(1, 11)),
    )
    return StressScene(network, frame, loads, config)


def _energy_growth(scene: StressScene, before: Frame, after: Frame) -> float:
    """Relative growth of energy in a step. A lagged force is held constant, so that all its work is in the energy."""
    held = replace(scene.loads, force_n=steady_force(scene.network, before, scene.loads), rest_curvature=(0.0, 0.0))
    had, has = (mechanical_energy(scene.network, frame, held) for frame in (before, after))
    work = np.abs(held.force_n * np.maximum(np.abs(before.mesh.vertices), np.abs(after.mesh.vertices)).reshape(-1, 3))
    scale = max(abs(had), abs(has), float(work.sum()), 1e-12)
    return float((has - had) / scale)


def _refused(seed: int, refusal: HybridError) -> StressResult:
    readable = len(str(refusal)) > 30 and "got" in str(refusal)
    return StressResult(seed, type(refusal).__name__, "" if readable else "unreadable refusal", str(refusal))


def _random_film(rng: np.random.Generator, largest: int) -> FilmMesh:
    rows, cols = (round(2 * (largest / 2) ** (rng.random() ** 1.5)) for _ in range(2))
    lines = [np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 1, n - 1))]) for n in (rows, cols)]
    v, u = (line / line[-1] for line in lines)
    if rng.random() < 0.05 and cols > 2:
        u[1] = u[0]
    size = (float(10 ** rng.uniform(1, 3)), float(10 ** rng.uniform(1, 3)))
    uu, vv = np.meshgrid(u, v)
    flat = np.stack([(uu - 0.5) * size[1], (vv - 0.5) * size[0], np.zeros_like(uu)], axis=-1)
    return FilmMesh(u, v, flat, size, np.array([0, rows - 1]), np.array([0, cols - 1]))


def _random_state(film: FilmMesh, rng: np.random.Generator) -> np.ndarray:
    """Flat, crumpled, folded onto itself, or collapsed to a line or a point."""
    flat, size = film.vertices, float(np.hypot(*film.size_mm))
    kind = rng.choice(["flat", "crumpled", "folded", "line", "point"], p=[0.5, 0.2, 0.1, 0.1, 0.1])
    if kind == "crumpled":
        return flat + rng.normal(0, 10 ** rng.uniform(-6, 0) * size, flat.shape)
    if kind == "folded":
        return np.abs(flat)
    return flat * {"flat": [1.0, 1, 1], "line": [1.0, 0, 0], "point": [0.0, 0, 0]}[str(kind)]


def _random_loads(network: MassSpring, rng: np.random.Generator) -> Loads:
    flat = network.film.vertices.reshape(-1, 3)
    count, size = len(flat), network.size
    weight = network.mass_kg[:, None] * STANDARD_GRAVITY
    force = weight * 10 ** rng.uniform(-1, 3) * (rng.normal(size=(1, 3)) + rng.normal(size=(count, 3)) * rng.random())
    goal, stiffness = flat.copy(), np.zeros(count)
    pins = rng.choice(count, size=min(count, int(rng.integers(0, 9))), replace=False)
    stiffness[pins] = np.inf if rng.random() < 0.6 else 10 ** rng.uniform(-6, 3)
    goal[pins] += rng.normal(0, 10 ** rng.uniform(-4, 0) * size, (len(pins), 3))
    if len(pins) > 1 and rng.random() < 0.2:
        goal[pins] = goal[pins[0]]  # coincident pins
    curl = (float(rng.normal(0, 3 / size)), float(rng.normal(0, 3 / size))) if rng.random() < 0.2 else (0.0, 0.0)
    drag = 10 ** rng.uniform(-12, -3) * np.ones(count) if rng.random() < 0.3 else None
    normal = np.tile([0.0, 0.0, 1.0], (count, 1)) if drag is not None else None
    return Loads(force, goal, stiffness, curl, tuple(_random_bodies(rng, size)), drag, normal)


def _random_bodies(rng: np.random.Generator, size: float) -> list[Body]:
    up, out = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])
    place = rng.normal(0, 0.3 * size, 3)
    choice: list[Body] = [
        Plane(place, up),
        TableEdge(place, up, out, 0.01 * size),
        Cylinder(place, out, 0.1 * size),
        Sphere(place, 0.1 * size, friction=2.0),
    ]
    return [choice[k] for k in rng.choice(4, size=int(rng.integers(0, 3)), replace=False)]
