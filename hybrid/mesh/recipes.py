"""Recipes that bend a film as hands, clips, tables, wind and the published force field do; each gives frames.

The film starts flat in the plane z = 0; +z is the side away from a reader.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hybrid.mesh.contact import Plane, Sphere, TableEdge
from hybrid.mesh.film import FilmMesh
from hybrid.mesh.forces import (
    PlaneField,
    PointField,
    gravity,
    gusts,
    plane_field,
    point_field,
    smooth_noise,
    turbulence,
)
from hybrid.mesh.grips import Grip, arc, edge_part, flat_points, grip_loads, gripped, near_point, ramp, rigid
from hybrid.mesh.loads import Loads
from hybrid.mesh.material import FilmMaterial
from hybrid.mesh.network import MassSpring, mass_spring
from hybrid.mesh.solver import Frame, StepConfig, at_rest, step

LoadsAt = Callable[[int, Frame], Loads]
"""The loads of frame number k, given the frame before it."""

_AWAY = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class BendConfig:
    """How a film is bent.

    frames: number of steps simulated. keep_from: first frame that is used, if any from there on is fit for use.
    max_angle_deg: frames with a normal further than this from the mean normal are dropped (PAPER code: 70).
    soft_share: share of films that stretch like the published soft bodies; the others are PET.
    max_iterations, tolerance: Newton's limits (StepConfig); a frame for a picture needs no more.
    """

    frames: int = 7
    keep_from: int = 2
    max_angle_deg: float = 70.0
    soft_share: float = 0.5
    max_iterations: int = 8
    tolerance: float = 1e-3


@dataclass(frozen=True, eq=False)
class Bending:
    """A recipe set up for one film: its network with clamps, the loads of each frame, and a suitable time step."""

    network: MassSpring
    loads_at: LoadsAt
    dt_s: float = 1 / 15
    damping_per_s: float = 4.0


def bend(film: FilmMesh, rng: np.random.Generator, config: BendConfig) -> tuple[str, list[Frame]]:
    """Bend a flat film by a random recipe: return its name and the frames that are fit to be photographed."""
    names = list(RECIPES)
    name = names[int(rng.choice(len(names), p=[weight for weight, _ in RECIPES.values()]))]
    soft = rng.random() < config.soft_share
    material = FilmMaterial(membrane_scale=float(10 ** rng.uniform(-4.5, -2.5)) if soft else 1.0)
    frames = simulate(RECIPES[name][1](mass_spring(film, material), rng), config)
    fit = [max_normal_angle(frame.mesh) <= np.deg2rad(config.max_angle_deg) for frame in frames]
    kept = [frame for k, frame in enumerate(frames) if fit[k] and k >= config.keep_from]
    if not kept:  # the film bends so far that only earlier frames can be used: the last fit one
        kept = [frame for k, frame in enumerate(frames) if fit[k]][-1:]
    return name, kept or [at_rest(film)]


def simulate(bending: Bending, config: BendConfig) -> list[Frame]:
    """All frames of a recipe, starting from the flat film (which is not among them)."""
    stepping = StepConfig(bending.dt_s, bending.damping_per_s, config.max_iterations, config.tolerance)
    frame, frames = at_rest(bending.network.film), []
    for k in range(config.frames):
        frame = step(bending.network, frame, bending.loads_at(k, frame), stepping)
        frames.append(frame)
    return frames


def max_normal_angle(mesh: FilmMesh) -> float:
    """Largest angle (rad) between a vertex normal and the mean normal."""
    normals = mesh.normals(mesh.u_lines, mesh.v_lines).reshape(-1, 3)
    mean = normals.mean(axis=0)
    cosine = normals @ mean / max(float(np.linalg.norm(mean)), 1e-12)
    return float(np.arccos(np.clip(cosine.min(), -1, 1)))


# ---------------------------------------------------------------- recipes


def flat(network: MassSpring, rng: np.random.Generator) -> Bending:
    """Nothing acts."""
    loads = _still(network)
    return Bending(network, lambda k, frame: loads)


def force_field(network: MassSpring, rng: np.random.Generator) -> Bending:
    """The published recipe: 5 to 15 goal vertices of weight 0.75 to 1 and one noisy field, no gravity; or no goals."""
    still, size = _still(network), float(np.mean(network.film.size_mm))
    stiffness = np.zeros(len(network.mass_kg))
    if rng.random() < 0.8:
        chosen = rng.choice(len(stiffness), size=int(rng.integers(5, 16)), replace=False)
        stiffness[chosen] = 10 ** rng.uniform(-4, -1) * rng.uniform(0.75, 1.0, len(chosen))
    field = _random_field(network, rng, size)

    def loads_at(k: int, frame: Frame) -> Loads:
        x = frame.mesh.vertices.reshape(-1, 3)
        pushed = plane_field(network, x, field) if isinstance(field, PlaneField) else point_field(network, x, field)
        return replace(still, force_n=pushed, goal_stiffness=stiffness)

    return Bending(network, loads_at, dt_s=1 / 24)


def one_corner(network: MassSpring, rng: np.random.Generator) -> Bending:
    """Held by a hand at one corner; the rest sags."""
    corner = rng.integers(0, 2, 2).astype(float)
    grip = rigid(network, near_point(network, corner, rng.uniform(25, 60)), rng.normal(0, 0.3, 3), np.zeros(3))
    return _sagging(network, rng, [grip])


def two_corners(network: MassSpring, rng: np.random.Generator) -> Bending:
    """Held at two corners, next to each other or opposite, a little closer together than when flat."""
    first = rng.integers(0, 2, 2).astype(float)
    second = np.abs(first - [[1, 0], [0, 1], [1, 1]][int(rng.integers(3))])
    way = (second - first) * [network.film.size_mm[1], network.film.size_mm[0]]
    closer = rng.uniform(0.002, 0.1) * np.append(way, 0.0)
    grips = [
        rigid(network, near_point(network, first, rng.uniform(15, 45)), rng.normal(0, 0.3, 3), 0.5 * closer),
        rigid(network, near_point(network, second, rng.uniform(15, 45)), rng.normal(0, 0.3, 3), -0.5 * closer),
    ]
    return _sagging(network, rng, grips)


def two_edges(network: MassSpring, rng: np.random.Generator) -> Bending:
    """Two opposite edges, or parts of them, pushed together and tilted, so that the sheet buckles between them."""
    axis = int(rng.integers(2))
    span = network.film.size_mm[1 - axis]
    low = rng.uniform(0, 0.6) if rng.random() < 0.5 else 0.0
    high = rng.uniform(low + 0.3, 1) if low else 1.0
    shift = np.zeros(3)
    shift[axis] = 0.5 * span * rng.uniform(0.005, 0.12)
    hinge = np.eye(3)[1 - axis]
    grips = [
        rigid(
            network,
            edge_part(network, 2 * axis + far, low, high),
            rng.normal(0, 0.3) * hinge + rng.normal(0, 0.06) * np.eye(3)[axis],
            (1 - 2 * far) * shift + rng.normal(0, 0.03) * span * _AWAY,
        )
        for far in (0, 1)
    ]
    return _sagging(network, rng, grips, weight=rng.uniform(0.1, 1.0), out=True)


def thumb_curl(network: MassSpring, rng: np.random.Generator) -> Bending:
    """Held from below or from a side between a thumb and fingers that bend it, so that it stands stiff."""
    side = int(rng.integers(4))
    middle, half = rng.uniform(0.35, 0.65), rng.uniform(0.1, 0.3)
    chosen = edge_part(network, side, middle - half, middle + half, rng.uniform(20, 60))
    along = 1 if side < 2 else 0
    grip = arc(network, chosen, along, float(rng.choice([-1, 1]) / rng.uniform(70, 400)))
    inwards = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]][side], float)
    pull = gravity(network, _unit(-inwards + rng.normal(0, 0.4, 3))) * rng.uniform(0.3, 1.0)
    bent = gripped(network, [grip])
    return Bending(bent, lambda k, frame: grip_loads(bent, [grip], ramp(k, 4), pull))


def clip(network: MassSpring, rng: np.random.Generator) -> Bending:
    """Hanging from one or two clips on a line, in moving air."""
    places = [0.5 + rng.normal(0, 0.05)] if rng.random() < 0.5 else [rng.uniform(0.05, 0.25), rng.uniform(0.75, 0.95)]
    side = int(rng.integers(4))
    closer = (0.0, 0.0) if len(places) == 1 else (1.0, -1.0)
    along = np.eye(3)[1 if side < 2 else 0] * rng.uniform(0.5, 8)
    grips = [
        rigid(
            network,
            edge_part(network, side, place - 0.05, place + 0.05, 15.0),
            rng.normal(0, 0.15, 3),
            sign * along,
        )
        for place, sign in zip(places, closer, strict=False)
    ]
    inwards = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]][side], float)
    weight = gravity(network, _unit(inwards + rng.normal(0, 0.1, 3)))
    air = turbulence(rng, rng.normal(size=3) * [0.3, 0.3, 1.0] * rng.uniform(0.2, 2.0), 0.4, network.size)
    bent, curl, dt = gripped(network, grips), _curl(rng, 0.4), 1 / 24

    def loads_at(k: int, frame: Frame) -> Loads:
        x = frame.mesh.vertices.reshape(-1, 3)
        blown = gusts(bent, x, air.velocity(x, k * dt))
        loads = grip_loads(bent, grips, ramp(k, 4), weight + blown.force_n, curl)
        return replace(loads, drag=blown.drag, drag_normal=blown.normal)

    return Bending(bent, loads_at, dt_s=dt, damping_per_s=1.0)


def table_edge(network: MassSpring, rng: np.random.Generator) -> Bending:
    """Laid over the edge of a table, at any angle, and kept there by a hand."""
    angle = rng.uniform(0, 2 * np.pi)
    outward = np.array([np.cos(angle), np.sin(angle), 0.0])
    reach = flat_points(network) @ outward
    rim = float(np.quantile(reach, rng.uniform(0.35, 0.75)))
    table = TableEdge(np.append(rim * outward[:2], 0.0), -_AWAY, outward, rng.uniform(1, 8), friction=0.3)
    hand = _film_point_at(network, float(np.quantile(reach, 0.15)) * outward)
    grip = rigid(network, near_point(network, hand, rng.uniform(30, 80)), np.zeros(3), np.zeros(3))
    weight, curl = gravity(network, _AWAY), _curl(rng, 0.3)
    bent = gripped(network, [grip])
    return Bending(bent, lambda k, frame: grip_loads(bent, [grip], 1.0, weight, curl, (table,)))


def pressed(network: MassSpring, rng: np.random.Generator) -> Bending:
    """A curled film on a table, pressed flat in part by a hand or two fingers."""
    grips: list[Grip] = []
    fingers: list[Sphere] = []
    for _ in range(int(rng.integers(1, 3))):
        place = rng.uniform(0.1, 0.9, 2)
        if rng.random() < 0.6:
            grips.append(rigid(network, near_point(network, place, rng.uniform(20, 90)), np.zeros(3), np.zeros(3)))
        else:
            tip = (place - 0.5) * [network.film.size_mm[1], network.film.size_mm[0]]
            fingers.append(Sphere(np.array([*tip, -29.0]), 30.0, friction=0.5))
    table = Plane(np.array([0.0, 0.0, 0.5]), -_AWAY, friction=0.1)
    weight, curl = gravity(network, _AWAY), _scaled(_curl(rng, 1.0), rng.uniform(2.0, 5.0))
    bent = gripped(network, grips)
    return Bending(
        bent, lambda k, frame: grip_loads(bent, grips, 1.0, weight, _scaled(curl, ramp(k, 5)), (table, *fingers))
    )


def on_table(network: MassSpring, rng: np.random.Generator) -> Bending:
    """Lying on a table, with corners or edges lifted and perhaps a curl."""
    grips = []
    for _ in range(int(rng.integers(0, 3))):
        chosen = near_point(network, _rim_point(rng), rng.uniform(10, 45))
        middle = flat_points(network)[chosen].mean(axis=0)
        lift = rng.uniform(10, 90)
        tilt = _unit(np.cross(_AWAY, middle)) * lift / rng.uniform(80, 200)
        grips.append(rigid(network, chosen, tilt, np.append(-_unit(middle)[:2] * rng.uniform(0.1, 0.3) * lift, -lift)))
    table = Plane(np.array([0.0, 0.0, 0.5]), -_AWAY, friction=0.2)
    weight, curl = gravity(network, _AWAY), _curl(rng, 0.6)
    bent = gripped(network, grips)
    return Bending(
        bent, lambda k, frame: grip_loads(bent, grips, ramp(k, 5), weight, _scaled(curl, ramp(k, 5)), (table,))
    )


def leaning(network: MassSpring, rng: np.random.Generator) -> Bending:
    """Standing on a table, its foot drawn away from the wall that its top leans on."""
    height = network.film.size_mm[0]
    wall = Plane(np.array([0.0, 0.0, 1.0]), -_AWAY, friction=0.3)
    foot = height * rng.uniform(0.1, 0.5)
    raised = height - np.sqrt(height**2 - foot**2)
    grip = rigid(
        network,
        edge_part(network, 3),
        np.array([-np.arcsin(foot / height) + rng.normal(0, 0.15), 0.0, rng.normal(0, 0.03)]),
        np.array([0.0, -rng.uniform(1.0, 1.5) * raised, -foot]),
    )
    weight = gravity(network, _unit(np.array([0.0, 1.0, rng.uniform(0.1, 0.5)]))) * rng.uniform(0.15, 0.6)
    curl = (float(rng.choice([-1, 1]) / rng.uniform(80, 250)), 0.0)  # a film stands by itself only when it is curled
    bent = gripped(network, [grip])
    return Bending(bent, lambda k, frame: grip_loads(bent, [grip], ramp(k, 6), weight, curl, (wall,)))


def twisted(network: MassSpring, rng: np.random.Generator) -> Bending:
    """Two opposite edges, or the middles of them, turned against each other."""
    axis = int(rng.integers(2))
    half = rng.uniform(0.1, 0.5)
    angle = float(rng.choice([-1, 1]) * rng.uniform(0.1, 0.7))
    closer = np.eye(3)[axis] * network.film.size_mm[1 - axis] * rng.uniform(0.005, 0.05)
    grips = [
        rigid(
            network,
            edge_part(network, 2 * axis + far, 0.5 - half, 0.5 + half),
            (1 - 2 * far) * 0.5 * angle * np.eye(3)[axis],
            (1 - 2 * far) * 0.5 * closer,
        )
        for far in (0, 1)
    ]
    return _sagging(network, rng, grips, weight=rng.uniform(0.1, 1.0))


def curled(network: MassSpring, rng: np.random.Generator) -> Bending:
    """A film kept rolled and held at a point."""
    grip = rigid(network, near_point(network, rng.uniform(0.2, 0.8, 2), rng.uniform(15, 60)), np.zeros(3), np.zeros(3))
    pull = rng.uniform(0, 0.5) * gravity(network, _unit(rng.normal(size=3)))
    curl, bent = _curl(rng, 1.0), gripped(network, [grip])
    return Bending(bent, lambda k, frame: grip_loads(bent, [grip], 1.0, pull, _scaled(curl, ramp(k, 4))))


RECIPES: dict[str, tuple[float, Callable[[MassSpring, np.random.Generator], Bending]]] = {
    "flat": (0.04, flat),
    "force_field": (0.26, force_field),
    "one_corner": (0.06, one_corner),
    "two_corners": (0.08, two_corners),
    "two_edges": (0.16, two_edges),
    "thumb_curl": (0.06, thumb_curl),
    "clip": (0.05, clip),
    "table_edge": (0.05, table_edge),
    "pressed": (0.05, pressed),
    "on_table": (0.06, on_table),
    "leaning": (0.04, leaning),
    "twisted": (0.04, twisted),
    "curled": (0.05, curled),
}
"""Name: (share of the films, recipe)."""


# ---------------------------------------------------------------- parts of recipes


def _sagging(
    network: MassSpring, rng: np.random.Generator, grips: list[Grip], weight: float = 1.0, out: bool = False
) -> Bending:
    """Grips that take their places in five frames, under gravity in any direction; ``out``: mostly out of the plane."""
    spread = [0.3, 0.3, 1.0] if out else [0.4, 1.0, 0.5]
    pull = weight * gravity(network, _unit(rng.normal(size=3) * spread))
    bent, curl = gripped(network, grips), _curl(rng, 0.3)
    return Bending(bent, lambda k, frame: grip_loads(bent, grips, ramp(k, 5), pull, curl))


def _random_field(network: MassSpring, rng: np.random.Generator, size: float) -> PointField | PlaneField:
    strength = float(rng.choice([-1, 1]) * 10 ** rng.uniform(-0.3, 1.2))
    noise = rng.uniform(0, 1) * smooth_noise(rng, network.film.shape)
    centre = np.append(rng.uniform(-0.7, 0.7, 2), rng.choice([-1, 1]) * rng.uniform(0.2, 1.0)) * size
    falloff = float(rng.uniform(0, 2))
    if rng.random() < 0.25:
        return PlaneField(0.3 * centre, _unit(rng.normal(size=3)), strength, 0.6 * size, falloff, noise)
    return PointField(centre, strength, 0.6 * size, falloff, noise)


def _still(network: MassSpring) -> Loads:
    points = flat_points(network)
    return Loads(np.zeros_like(points), points, np.zeros(len(points)))


def _film_point_at(network: MassSpring, place: np.ndarray) -> np.ndarray:
    """Film coordinates of a point of the flat film's plane, kept within the sheet."""
    height, width = network.film.size_mm
    return np.clip(place[:2] / [width, height] + 0.5, 0.0, 1.0)


def _rim_point(rng: np.random.Generator) -> np.ndarray:
    """A film point on one of the four edges, at a corner half of the time."""
    along = float(rng.integers(2)) if rng.random() < 0.5 else float(rng.random())
    point = np.array([along, float(rng.integers(2))])
    return point if rng.random() < 0.5 else point[[1, 0]]


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _scaled(curl: tuple[float, float], share: float) -> tuple[float, float]:
    return curl[0] * share, curl[1] * share


def _curl(rng: np.random.Generator, share: float) -> tuple[float, float]:
    """Rest curvature (1/mm) along u and v: none, or mostly about one axis with a radius of 150 mm or more."""
    if rng.random() > share:
        return (0.0, 0.0)
    main = float(rng.choice([-1, 1]) / rng.uniform(150, 1200))
    other = main * float(rng.uniform(-0.1, 0.1))
    return (main, other) if rng.random() < 0.5 else (other, main)
