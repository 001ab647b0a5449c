"""Forces on the vertices of a film, in newtons: gravity, the published data set's force fields, wind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hybrid.mesh.material import STANDARD_GRAVITY
from hybrid.mesh.network import MassSpring, lattice_normals

AIR_KG_M3 = 1.2


@dataclass(frozen=True, eq=False)
class PointField:
    """A field that pushes away from (strength > 0) or pulls to a point (PAPER, deformation simulating).

    centre_mm: (3,). strength: force on the whole sheet at the distance ``reach_mm``, in multiples of its weight.
    falloff: power of the distance with which it fades. noise: relative size of smooth random variation over the sheet.
    """

    centre_mm: Float[np.ndarray, "3"]
    strength: float
    reach_mm: float
    falloff: float
    noise: Float[np.ndarray, " v"]


@dataclass(frozen=True, eq=False)
class PlaneField:
    """A field that pushes along a plane's unit ``normal``, away from the plane (strength > 0) or to it, on both sides.

    point_mm: (3,) on the plane; the other fields are as in PointField, with the distance from the plane.
    """

    point_mm: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    strength: float
    reach_mm: float
    falloff: float
    noise: Float[np.ndarray, " v"]


@dataclass(frozen=True, eq=False)
class Air:
    """Pressure of the air on a sheet: the force at rest, and the resistance to motion along the normal.

    Loads takes both. The resistance is treated implicitly, so wind is stable at any step size.
    """

    force_n: Float[np.ndarray, "v 3"]
    drag: Float[np.ndarray, " v"]
    normal: Float[np.ndarray, "v 3"]


def gravity(network: MassSpring, direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "v 3"]:
    """Weight of each vertex along a unit ``direction``."""
    return network.mass_kg[:, None] * STANDARD_GRAVITY * direction


def point_field(network: MassSpring, vertices: Float[np.ndarray, "v 3"], field: PointField) -> Float[np.ndarray, "v 3"]:
    """Force of a point field on each vertex; the distance is kept above a twentieth of the reach."""
    arm = vertices - field.centre_mm
    distance = np.linalg.norm(arm, axis=1)
    return _fading(network, field, distance)[:, None] * arm / np.maximum(distance, field.reach_mm / 20)[:, None]


def plane_field(network: MassSpring, vertices: Float[np.ndarray, "v 3"], field: PlaneField) -> Float[np.ndarray, "v 3"]:
    """Force of a planar field on each vertex; it flips smoothly within a twentieth of the reach from the plane."""
    height = (vertices - field.point_mm) @ field.normal
    side = height / np.maximum(np.abs(height), field.reach_mm / 20)
    return (_fading(network, field, np.abs(height)) * side)[:, None] * field.normal


def gusts(network: MassSpring, vertices: Float[np.ndarray, "v 3"], velocity_m_s: Float[np.ndarray, "v 3"]) -> Air:
    """Air with its own velocity at each vertex; still air resists as if it moved at 0.3 m/s.

    The force is rho / 2 |v . n| (v - x') . n times each vertex's share of the area, along the normal.
    """
    normals = lattice_normals(network, vertices.reshape(*network.film.shape, 3)).reshape(-1, 3)
    area_m2 = network.area * network.metres_per_unit**2
    across = np.einsum("vk,vk->v", normals, velocity_m_s)
    per_speed = 0.5 * AIR_KG_M3 * area_m2 * np.maximum(np.abs(across), 0.3)  # N s/m
    return Air((per_speed * across)[:, None] * normals, per_speed * network.metres_per_unit, normals)


def turbulence(
    rng: np.random.Generator, mean_m_s: Float[np.ndarray, "3"], share: float, size_mm: float, waves: int = 6
) -> Turbulence:
    """Gusts of about ``share`` of the mean speed, as waves that the mean wind carries along (Taylor's hypothesis)."""
    speed = float(np.linalg.norm(mean_m_s))
    wave = rng.normal(size=(waves, 3)) * (2 * np.pi / (size_mm * rng.uniform(0.5, 3.0, (waves, 1))))
    return Turbulence(
        mean_m_s,
        rng.normal(size=(waves, 3)) * share * speed * np.sqrt(2 / waves),
        wave,
        rng.uniform(0, 2 * np.pi, waves),
    )


@dataclass(frozen=True, eq=False)
class Turbulence:
    """A wind with frozen gusts: mean (3,) m/s, amplitudes (n, 3) m/s, wave vectors (n, 3) 1/mm and phases (n,)."""

    mean_m_s: Float[np.ndarray, "3"]
    amplitude: Float[np.ndarray, "n 3"]
    wave: Float[np.ndarray, "n 3"]
    phase: Float[np.ndarray, " n"]

    def velocity(self, vertices: Float[np.ndarray, "v 3"], time_s: float) -> Float[np.ndarray, "v 3"]:
        """Velocity (m/s) of the air at each vertex."""
        carried = vertices - self.mean_m_s * (1000.0 * time_s)
        return self.mean_m_s + np.cos(carried @ self.wave.T + self.phase) @ self.amplitude


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], waves: int = 4) -> Float[np.ndarray, " v"]:
    """Smooth random values of unit variance over a lattice, as a sum of a few plane waves."""
    v, u = np.meshgrid(np.linspace(0, 1, shape[0]), np.linspace(0, 1, shape[1]), indexing="ij")
    total = np.zeros(shape)
    for _ in range(waves):
        fu, fv = rng.normal(0, 1.2, 2)
        total += np.cos(2 * np.pi * (fu * u + fv * v) + rng.uniform(0, 2 * np.pi))
    return (total * np.sqrt(2 / waves)).ravel()


def _fading(network: MassSpring, field: PointField | PlaneField, distance: np.ndarray) -> np.ndarray:
    """Force (N) on each vertex at a distance from the field's source."""
    fade = (field.reach_mm / np.maximum(distance, field.reach_mm / 20)) ** field.falloff
    return field.strength * network.mass_kg * STANDARD_GRAVITY * fade * (1 + field.noise)
