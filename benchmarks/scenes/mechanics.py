"""Bending problems with known answers, and the solver's errors on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_bvp

from hybrid.mesh.film import FilmMesh
from hybrid.mesh.forces import gravity
from hybrid.mesh.loads import Loads
from hybrid.mesh.material import STANDARD_GRAVITY, FilmMaterial
from hybrid.mesh.network import MassSpring, clamped, mass_spring
from hybrid.mesh.solver import SettleConfig, at_rest, settle

SZE_TIP = {0.05: (0.026, 0.663), 0.5: (1.604, 4.933), 1.0: (3.286, 6.698)}
"""Share of the full load (P L^2 / (E I) = 4): shortening U and deflection W of a cantilever of length 10, end shear
(Sze, Liu, Lo 2004, "Popular benchmark problems for geometric nonlinear analysis of shells", table 1)."""


@dataclass(frozen=True)
class TipError:
    """A cantilever's tip against the truth: load parameter, cells along it, error as a share of its length, strain."""

    load: float
    cells: int
    error: float
    max_strain: float


def lattice_sheet(size: tuple[float, float], cells: tuple[int, int]) -> FilmMesh:
    """A flat sheet of ``size`` (height, width) with equal cells (rows, columns); x, y from its centre."""
    v, u = np.linspace(0, 1, cells[0] + 1), np.linspace(0, 1, cells[1] + 1)
    uu, vv = np.meshgrid(u, v)
    vertices = np.stack([(uu - 0.5) * size[1], (vv - 0.5) * size[0], np.zeros_like(uu)], axis=-1)
    return FilmMesh(u, v, vertices, size, np.array([0, cells[0]]), np.array([0, cells[1]]))


def heavy_elastica_tip(gamma: float) -> Float[np.ndarray, "2"]:
    """Tip (along, down) of a strip of length 1 clamped level, under its own weight, gamma = rho h g L^3 / D.

    theta'' = -gamma (1 - s) cos theta, theta(0) = 0, theta'(1) = 0 (SciPy's collocation, to 1e-8).
    """
    s = np.linspace(0, 1, 41)
    guess = np.zeros((4, len(s)))
    guess[2] = s
    for load in np.geomspace(min(1.0, gamma), gamma, 8):
        solution = solve_bvp(
            lambda t, y, load=load: np.stack([y[1], -load * (1 - t) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]),
            lambda a, b: np.array([a[0], b[1], a[2], a[3]]),
            s,
            guess,
            tol=1e-8,
            max_nodes=20000,
        )
        s, guess = solution.x, solution.y
    return guess[2:, -1]


def cantilever(
    length: float, width: float, cells: int, material: FilmMaterial, unit: float
) -> tuple[MassSpring, Loads]:
    """A strip along x, clamped to the left of x = 0 by one more cell; no force yet."""
    spacing = length / cells
    sheet = lattice_sheet((width, length + spacing), (2, cells + 1))
    shifted = sheet.bent(sheet.vertices + np.array([0.5 * (length - spacing), 0.0, 0.0]))
    held = np.zeros(sheet.shape, bool)
    held[:, :2] = True
    network = clamped(mass_spring(shifted, material, unit), held)
    flat = shifted.vertices.reshape(-1, 3)
    return network, Loads(np.zeros_like(flat), flat, np.where(held, np.inf, 0.0).ravel())


def heavy_strip(gamma: float, cells: int) -> TipError:
    """A film strip under its own weight, of the length that ``gamma`` requires."""
    film = FilmMaterial()
    per_area = film.density_kg_mm3 * film.thickness_mm * STANDARD_GRAVITY
    length = (gamma * film.bending_stiffness / per_area) ** (1 / 3)
    network, loads = cantilever(length, 0.2 * length, cells, film, 1e-3)
    pulled = Loads(gravity(network, np.array([0.0, 0.0, 1.0])), loads.goal_mm, loads.goal_stiffness)
    frame = settle(network, at_rest(network.film), pulled, SettleConfig())
    along, down = heavy_elastica_tip(gamma) * length
    tip = frame.mesh.vertices[:, -1].mean(axis=0)
    return TipError(gamma, cells, float(np.hypot(tip[0] - along, tip[2] - down) / length), frame.max_strain)


def sheared_cantilever(share: float, cells: int) -> TipError:
    """Sze's cantilever: L = 10, width 1, h = 0.1, E = 1.2e6, nu = 0, end shear of ``share`` times 4."""
    material = FilmMaterial(youngs_modulus_mpa=1.2e6, thickness_mm=0.1, poisson=0.0, density_kg_mm3=1e-6)
    network, loads = cantilever(10.0, 1.0, cells, material, 1e-3)
    force = np.zeros((*network.film.shape, 3))
    force[:, -1, 2] = 4.0 * share * np.array([0.25, 0.5, 0.25])
    frame = settle(
        network,
        at_rest(network.film),
        Loads(force.reshape(-1, 3), loads.goal_mm, loads.goal_stiffness),
        SettleConfig(first_dt_s=0.003),
    )
    tip = frame.mesh.vertices[:, -1].mean(axis=0)
    shortening, deflection = SZE_TIP[share]
    error = max(abs(10.0 - tip[0] - shortening), abs(tip[2] - deflection)) / 10.0
    return TipError(share, cells, float(error), frame.max_strain)
