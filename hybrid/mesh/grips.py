"""Where hands, clips and edges hold a film, and how the held part moves from where it lay flat."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from hybrid.mesh.contact import Body
from hybrid.mesh.loads import Loads
from hybrid.mesh.network import MassSpring, clamped

GRIP_N_MM3 = 2e-3
"""Stiffness of a grip, N/mm per square millimetre: a thumb's 10 cm^2 hold with 2 N/mm and give a little."""


@dataclass(frozen=True, eq=False)
class Grip:
    """Part of a film that is held: which vertices (V,), and where they are (V, 3) at a share 0..1 of the way."""

    chosen: Bool[np.ndarray, " v"]
    at: Callable[[float], np.ndarray]


def flat_points(network: MassSpring) -> Float[np.ndarray, "v 3"]:
    """Vertices of the flat film."""
    return network.film.vertices.reshape(-1, 3)


def film_points(network: MassSpring) -> Float[np.ndarray, "v 2"]:
    """Film coordinates (u, v) of the vertices."""
    u, v = np.meshgrid(network.film.u_lines, network.film.v_lines)
    return np.stack([u.ravel(), v.ravel()], axis=1)


def near_point(network: MassSpring, uv: Float[np.ndarray, "2"], radius_mm: float) -> Bool[np.ndarray, " v"]:
    """Vertices within ``radius_mm`` of a film point; always at least the nearest lattice cell, which can be tilted."""
    height, width = network.film.size_mm
    beside = np.abs(film_points(network) - uv) * [width, height]
    cell = [beside[:, k] <= np.unique(beside[:, k].round(6))[1] + 1e-6 for k in range(2)]
    return (np.linalg.norm(beside, axis=1) <= radius_mm) | (cell[0] & cell[1])


def edge_part(
    network: MassSpring, side: int, low: float = 0.0, high: float = 1.0, depth_mm: float = 0.0
) -> Bool[np.ndarray, " v"]:
    """Vertices of an edge (0 left, 1 right, 2 top, 3 bottom), ``low`` to ``high`` along it, ``depth_mm`` inwards.

    The part is two lattice lines deep at least: one alone would turn about itself like a hinge. Where the lattice is
    coarser than the part is long, each line contributes the vertex nearest to the part's middle.
    """
    uv = film_points(network)
    axis, far = (0, side == 1) if side < 2 else (1, side == 3)
    size = network.film.size_mm[1 - axis]
    inwards = (1 - uv[:, axis] if far else uv[:, axis]) * size
    along = uv[:, 1 - axis]
    near = inwards <= max(depth_mm, np.unique(inwards)[1]) + 1e-6
    within = (along >= low - 1e-9) & (along <= high + 1e-9)
    if not (near & within).any():
        beside = np.abs(along - 0.5 * (low + high))
        within = beside <= beside.min() + 1e-9
    return near & within


def rigid(network: MassSpring, chosen: Bool[np.ndarray, " v"], turn_rad: np.ndarray, shift: np.ndarray) -> Grip:
    """A part that moves as a rigid body: turned about its centre by a rotation vector, and shifted (length)."""
    points = flat_points(network)
    centre = points[chosen].mean(axis=0)

    def at(share: float) -> np.ndarray:
        return Rotation.from_rotvec(share * turn_rad).apply(points - centre) + centre + share * shift

    return Grip(chosen, at)


def arc(network: MassSpring, chosen: Bool[np.ndarray, " v"], along: int, curvature: float, lift: float = 0.0) -> Grip:
    """A part bent into a circle along u (``along`` 0) or v (1) about its centre, and shifted by ``lift`` along z."""
    points = flat_points(network)
    centre = points[chosen].mean(axis=0)
    arm = points[:, along] - centre[along]

    def at(share: float) -> np.ndarray:
        goal, kappa = points.copy(), share * curvature
        angle = kappa * arm
        goal[:, along] = centre[along] + arm * np.sinc(angle / np.pi)
        goal[:, 2] += share * lift + 0.5 * kappa * arm**2 * np.sinc(0.5 * angle / np.pi) ** 2
        return goal

    return Grip(chosen, at)


def gripped(network: MassSpring, grips: Sequence[Grip]) -> MassSpring:
    """The network with its bending corrected at the ends of the grips."""
    held = np.any([grip.chosen for grip in grips], axis=0) if grips else np.zeros(len(network.mass_kg), bool)
    return clamped(network, held.reshape(network.film.shape))


def grip_loads(
    network: MassSpring,
    grips: Sequence[Grip],
    share: float,
    force_n: Float[np.ndarray, "v 3"],
    rest_curvature: tuple[float, float] = (0.0, 0.0),
    bodies: Sequence[Body] = (),
) -> Loads:
    """Loads of grips that are ``share`` of their way along, together with forces, curl and bodies."""
    goal, stiffness = flat_points(network).copy(), np.zeros(len(network.mass_kg))
    for grip in grips:
        goal[grip.chosen] = grip.at(share)[grip.chosen]
        stiffness[grip.chosen] = GRIP_N_MM3 * network.area[grip.chosen]
    return Loads(force_n, goal, stiffness, rest_curvature, bodies)


def ramp(frame: int, frames: int) -> float:
    """Share of the way at a frame: a smooth start and stop over ``frames`` steps."""
    t = min(1.0, (frame + 1) / frames)
    return t * t * (3 - 2 * t)
