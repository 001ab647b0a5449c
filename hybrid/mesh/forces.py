"""Forces on the vertices of a film, in newtons: gravity, the published data set's force field, wind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hybrid.mesh.film import FilmMesh
from hybrid.mesh.solver import GRAVITY_MM_S2, MM_PER_M, MassSpring


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


def gravity(network: MassSpring, direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "v 3"]:
    """Weight of each vertex along a unit ``direction``."""
    return network.mass_kg[:, None] * (GRAVITY_MM_S2 / MM_PER_M) * direction


def point_field(network: MassSpring, vertices: Float[np.ndarray, "v 3"], field: PointField) -> Float[np.ndarray, "v 3"]:
    """Force of a point field on each vertex; the distance is kept above a twentieth of the reach."""
    arm = vertices - field.centre_mm
    distance = np.maximum(np.linalg.norm(arm, axis=1, keepdims=True), field.reach_mm / 20)
    weight = network.mass_kg[:, None] * (GRAVITY_MM_S2 / MM_PER_M)
    fade = (field.reach_mm / distance) ** field.falloff
    return field.strength * weight * fade * (1 + field.noise)[:, None] * arm / distance


def wind(
    network: MassSpring, mesh: FilmMesh, velocity_m_s: Float[np.ndarray, "3"], air_kg_m3: float = 1.2
) -> Float[np.ndarray, "v 3"]:
    """Pressure of a steady wind: rho/2 (v . n) |v . n| over each vertex's share of the area, along the normal."""
    normals = mesh.normals(mesh.u_lines, mesh.v_lines).reshape(-1, 3)
    area_m2 = network.mass_kg / (network.material.thickness_mm * network.material.density_kg_mm3) / MM_PER_M**2
    across = normals @ velocity_m_s
    return (0.5 * air_kg_m3 * area_m2 * across * np.abs(across))[:, None] * normals


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], waves: int = 4) -> Float[np.ndarray, " v"]:
    """Smooth random values of unit variance over a lattice, as a sum of a few plane waves."""
    v, u = np.meshgrid(np.linspace(0, 1, shape[0]), np.linspace(0, 1, shape[1]), indexing="ij")
    total = np.zeros(shape)
    for _ in range(waves):
        fu, fv = rng.normal(0, 1.2, 2)
        total += np.cos(2 * np.pi * (fu * u + fv * v) + rng.uniform(0, 2 * np.pi))
    return (total * np.sqrt(2 / waves)).ravel()
