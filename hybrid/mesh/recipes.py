"""Recipes that bend a film as hands, tables and the published force field do; each gives a sequence of frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hybrid.mesh.film import FilmMesh
from hybrid.mesh.forces import PointField, gravity, point_field, smooth_noise
from hybrid.mesh.solver import FilmMaterial, Frame, Loads, MassSpring, StepConfig, at_rest, mass_spring, step

LoadsAt = Callable[[int, Frame], Loads]
"""The loads of frame number k, given the frame before it."""


@dataclass(frozen=True)
class BendConfig:
    """How a film is bent.

    frames: number of steps simulated. keep_from: first frame that may be used.
    max_angle_deg: frames with a normal further than this from the mean normal are dropped (PAPER code: 70).
    soft_share: share of films that stretch like the published soft bodies; the others are inextensible.
    step: the time step.
    """

    frames: int = 9
    keep_from: int = 2
    max_angle_deg: float = 70.0
    soft_share: float = 0.5
    step: StepConfig = field(default_factory=lambda: StepConfig(max_iterations=6, tolerance_mm=0.05))


def bend(film: FilmMesh, rng: np.random.Generator, config: BendConfig) -> tuple[str, list[Frame]]:
    """Bend a flat film by a random recipe: its name and the frames that are fit to be photographed."""
    names = list(RECIPES)
    name = names[int(rng.choice(len(names), p=[weight for weight, _ in RECIPES.values()]))]
    soft = rng.random() < config.soft_share
    material = FilmMaterial(membrane_scale=float(10 ** rng.uniform(-4.5, -2.5)) if soft else 0.1)
    network = mass_spring(film, material)
    loads_at = RECIPES[name][1](network, rng)
    frame, kept = at_rest(film), []
    for k in range(config.frames):
        frame = step(network, frame, loads_at(k, frame), config.step)
        if k >= config.keep_from and max_normal_angle(frame.mesh) <= np.deg2rad(config.max_angle_deg):
            kept.append(frame)
    return name, kept or [at_rest(film)]


def max_normal_angle(mesh: FilmMesh) -> float:
    """Largest angle (rad) between a vertex normal and the mean normal."""
    normals = mesh.normals(mesh.u_lines, mesh.v_lines).reshape(-1, 3)
    mean = normals.mean(axis=0)
    cosine = normals @ mean / max(float(np.linalg.norm(mean)), 1e-12)
    return float(np.arccos(np.clip(cosine.min(), -1, 1)))


# ---------------------------------------------------------------- recipes


def flat(network: MassSpring, rng: np.random.Generator) -> LoadsAt:
    """Nothing acts."""
    loads = _loads(network)
    return lambda k, frame: loads


def force_field(network: MassSpring, rng: np.random.Generator) -> LoadsAt:
    """The published recipe: 5 to 15 goal vertices of weight 0.75 to 1 and one noisy point field, no gravity."""
    flat_mm = _flat(network)
    size = float(np.mean(network.film.size_mm))
    stiffness = np.zeros(len(flat_mm))
    chosen = rng.choice(len(flat_mm), size=int(rng.integers(5, 16)), replace=False)
    stiffness[chosen] = 10 ** rng.uniform(-3, 0) * rng.uniform(0.75, 1.0, len(chosen))
    field = PointField(
        centre_mm=np.append(rng.uniform(-0.7, 0.7, 2), rng.choice([-1, 1]) * rng.uniform(0.2, 1.0)) * size,
        strength=float(rng.choice([-1, 1]) * 10 ** rng.uniform(-0.3, 1.2)),
        reach_mm=0.6 * size,
        falloff=float(rng.uniform(0, 2)),
        noise=rng.uniform(0, 1) * smooth_noise(rng, network.film.shape),
    )
    return lambda k, frame: Loads(point_field(network, frame.mesh.vertices.reshape(-1, 3), field), flat_mm, stiffness)


def held(network: MassSpring, rng: np.random.Generator) -> LoadsAt:
    """Held at one to four places of its rim, sagging under its own weight in any direction."""
    flat_mm = _flat(network)
    goal, stiffness = flat_mm.copy(), np.zeros(len(flat_mm))
    for _ in range(int(rng.integers(1, 5))):
        near = _near(network, _rim_point(rng), radius=rng.uniform(0.05, 0.2))
        stiffness[near] = 0.3
        goal[near] = flat_mm[near] + np.append(rng.normal(0, 6, 2), rng.normal(0, 25))
    pull = rng.uniform(0.2, 1.5) * gravity(network, _unit(rng.normal(size=3) * [0.4, 1.0, 0.5]))
    curl = _curl(rng, 0.4)
    return lambda k, frame: Loads(pull, goal, stiffness * min(1.0, (k + 1) / 4), curl)


def squeezed(network: MassSpring, rng: np.random.Generator) -> LoadsAt:
    """Two opposite edges (or parts of them) pushed together and tilted, so that the sheet buckles between them."""
    flat_mm = _flat(network)
    axis = int(rng.integers(2))  # 0: left and right edges, 1: top and bottom
    uv = _uv(network)
    span = network.film.size_mm[1 - axis]
    low, high = np.sort(rng.uniform(0, 1, 2)) if rng.random() < 0.5 else (0.0, 1.0)
    along = uv[:, 1 - axis]
    part = (along >= min(low, 0.7)) & (along <= max(high, min(low, 0.7) + 0.3))
    goal, stiffness = flat_mm.copy(), np.zeros(len(flat_mm))
    push = span * rng.uniform(0.002, 0.08)
    for side, sign in ((0.0, 1), (1.0, -1)):
        edge = (np.abs(uv[:, axis] - side) < 0.02) & part
        stiffness[edge] = 0.3
        goal[edge, axis] += sign * push / 2
        tilt = rng.normal(0, 0.12)
        goal[edge, 2] += tilt * flat_mm[edge, 1 - axis] + rng.normal(0, 0.05) * span
    nudge = gravity(network, np.array([0.0, 0.0, rng.choice([-1.0, 1.0])])) * rng.uniform(0.1, 1.0)
    return lambda k, frame: Loads(nudge, goal, stiffness, _NO_CURL)


def curled(network: MassSpring, rng: np.random.Generator) -> LoadsAt:
    """A film kept rolled, that lies free or is held at a point."""
    flat_mm = _flat(network)
    stiffness = np.zeros(len(flat_mm))
    stiffness[_near(network, rng.uniform(0.2, 0.8, 2), rng.uniform(0.1, 0.3))] = 0.02
    curl = _curl(rng, 1.0)
    pull = rng.uniform(0, 0.5) * gravity(network, _unit(rng.normal(size=3)))
    return lambda k, frame: Loads(
        pull, flat_mm, stiffness, (curl[0] * min(1, (k + 1) / 4), curl[1] * min(1, (k + 1) / 4))
    )


def on_table(network: MassSpring, rng: np.random.Generator) -> LoadsAt:
    """Lying on a table, with corners or edges lifted and perhaps a curl."""
    flat_mm = _flat(network)
    goal, stiffness = flat_mm.copy(), np.zeros(len(flat_mm))
    for _ in range(int(rng.integers(0, 4))):
        near = _near(network, _rim_point(rng), rng.uniform(0.03, 0.12))
        stiffness[near] = 0.1
        goal[near, 2] -= rng.uniform(5, 70)
    weight = gravity(network, np.array([0.0, 0.0, 1.0]))
    curl = _curl(rng, 0.6)
    return lambda k, frame: Loads(weight, goal, stiffness, curl, table_z_mm=0.5)


RECIPES: dict[str, tuple[float, Callable[[MassSpring, np.random.Generator], LoadsAt]]] = {
    "flat": (0.05, flat),
    "force_field": (0.35, force_field),
    "held": (0.2, held),
    "squeezed": (0.2, squeezed),
    "curled": (0.1, curled),
    "on_table": (0.1, on_table),
}
"""Name: (share of the films, recipe)."""

_NO_CURL = (0.0, 0.0)


def _loads(network: MassSpring) -> Loads:
    flat_mm = _flat(network)
    return Loads(np.zeros_like(flat_mm), flat_mm, np.zeros(len(flat_mm)))


def _flat(network: MassSpring) -> np.ndarray:
    return network.film.vertices.reshape(-1, 3)


def _uv(network: MassSpring) -> np.ndarray:
    u, v = np.meshgrid(network.film.u_lines, network.film.v_lines)
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _near(network: MassSpring, uv: np.ndarray, radius: float) -> np.ndarray:
    """Vertices within ``radius`` (film units) of a film point; always at least one."""
    distance = np.linalg.norm(_uv(network) - uv, axis=1)
    return distance <= max(radius, float(distance.min()))


def _rim_point(rng: np.random.Generator) -> np.ndarray:
    """A film point on one of the four edges, at a corner half of the time."""
    along = float(rng.integers(2)) if rng.random() < 0.5 else float(rng.random())
    point = np.array([along, float(rng.integers(2))])
    return point if rng.random() < 0.5 else point[[1, 0]]


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _curl(rng: np.random.Generator, share: float) -> tuple[float, float]:
    """Rest curvature (1/mm) along u and v: none, or mostly about one axis with a radius of 150 mm and more."""
    if rng.random() > share:
        return _NO_CURL
    main = float(rng.choice([-1, 1]) / rng.uniform(150, 1200))
    other = main * float(rng.uniform(-0.1, 0.1))
    return (main, other) if rng.random() < 0.5 else (other, main)
