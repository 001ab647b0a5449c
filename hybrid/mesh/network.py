"""The mass-spring network of a film: masses, springs and bending on the lattice, with stiffness from the material.

Stretching. Each lattice edge is a structural spring, each cell has a shear spring that acts on the *difference* of its
two diagonals, and Poisson's coupling joins the edges of a cell: three independent measures for each cell, as many as a
surface has metric components. Four independent springs for each cell (both diagonals) would make every cell rigid, and
such a sheet could only fold along its lattice lines; with three it rolls up in any direction without strain. Green
strains are polynomials of the positions: nothing is singular, whatever the state.

Bending. ``D / 2 (|x_uu|^2 + 2 |x_uv|^2 + |x_vv|^2)`` by second differences: quadratic, so its Hessian is constant
(Bergou et al. 2006, "A quadratic bending model for inextensible surfaces").
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse

from hybrid.errors import ConfigError, describe
from hybrid.mesh.banded import band_of
from hybrid.mesh.film import FilmMesh
from hybrid.mesh.material import FilmMaterial

MM_PER_M = 1000.0


@dataclass(frozen=True, eq=False)
class Strain:
    """Green strain of a lattice: of its edges along u and along v, and the shear of its cells.

    across: (rows, cols - 1, 3) and down: (rows - 1, cols, 3) are the stretched tangents x_u and x_v of the edges.
    """

    across: Float[np.ndarray, "rows c1 3"]
    down: Float[np.ndarray, "r1 cols 3"]
    along_u: Float[np.ndarray, "rows c1"]
    along_v: Float[np.ndarray, "r1 cols"]
    shear: Float[np.ndarray, "r1 c1"]

    @property
    def largest(self) -> float:
        """Largest of all edge strains and half shears."""
        return max(float(np.abs(s).max()) for s in (self.along_u, self.along_v, 0.5 * self.shear))


@dataclass(frozen=True, eq=False)
class CellStress:
    """Work conjugate of a cell's strains, times the cell's area (force x length).

    edges: (4, rows - 1, cols - 1), of the cell's upper and lower edges (along u), left and right edges (along v).
    shear: (rows - 1, cols - 1).
    """

    edges: Float[np.ndarray, "4 r1 c1"]
    shear: Float[np.ndarray, "r1 c1"]


@dataclass(frozen=True, eq=False)
class MassSpring:
    """The network of a sheet. Lengths are in units of ``metres_per_unit``; forces in N, masses in kg, times in s.

    du, dv: lattice spacing. mass_kg: (V,), row by row. area: (V,) of the flat sheet.
    membrane: C11, C12, C66 in N per unit length. bending_stiffness: N times unit length.
    held: vertices that are held fast.
    """

    film: FilmMesh
    material: FilmMaterial
    metres_per_unit: float
    du: Float[np.ndarray, " c1"]
    dv: Float[np.ndarray, " r1"]
    mass_kg: Float[np.ndarray, " v"]
    area: Float[np.ndarray, " v"]
    membrane: tuple[float, float, float]
    bending_stiffness: float
    held: Bool[np.ndarray, "rows cols"]

    @cached_property
    def bending_root(self) -> sparse.csr_array:
        """S such that |S x|^2 / 2 is the bending energy.

        Where two neighbours are held and the next is free, a clamp ends at the second: the second difference there
        covers half a cell within the clamp, which stays straight, and half a cell outside, whose curvature is then
        twice the difference. The energy of the two together is doubled. Without this a clamp seems to begin half a cell
        too early, a first-order error.
        """
        weight = self.area * self.bending_stiffness
        grip_u = weight * (1.0 + _clamp_ends(self.held)).ravel()
        grip_v = weight * (1.0 + _clamp_ends(self.held.T).T).ravel()
        mixed = sparse.kron(_first_difference(self.dv), _first_difference(self.du)).tocsr()
        cell = 2 * self.cell_area.ravel() * self.bending_stiffness
        parts = [(grip_u, self._second_u), (grip_v, self._second_v), (cell, mixed)]
        root = sparse.vstack([sparse.diags_array(np.sqrt(w)) @ operator for w, operator in parts])
        root = sparse.csr_array(root)
        root.eliminate_zeros()
        return root

    @cached_property
    def curvature_u(self) -> sparse.csr_array:
        """(V, V) bending stiffness times area-weighted second derivatives along u: their product with the normals is
        the load of a unit rest curvature."""
        return self._curvature(self._second_u)

    @cached_property
    def curvature_v(self) -> sparse.csr_array:
        """Likewise along v."""
        return self._curvature(self._second_v)

    def _curvature(self, second: sparse.csr_array) -> sparse.csr_array:
        return sparse.csr_array(second.T @ sparse.diags_array(self.area * self.bending_stiffness))

    @cached_property
    def _second_u(self) -> sparse.csr_array:
        return sparse.kron(sparse.identity(self.film.shape[0]), _second_difference(self.du)).tocsr()

    @cached_property
    def _second_v(self) -> sparse.csr_array:
        return sparse.kron(_second_difference(self.dv), sparse.identity(self.film.shape[1])).tocsr()

    @cached_property
    def bending(self) -> sparse.csr_array:
        """(V, V) Hessian of the bending energy, the same for x, y and z."""
        return sparse.csr_array(self.bending_root.T @ self.bending_root)

    @cached_property
    def bending_band(self) -> Float[np.ndarray, "n b"]:
        """The bending Hessian as a band (banded.py)."""
        return band_of(self.bending, self.film.shape)

    @cached_property
    def cell_area(self) -> Float[np.ndarray, "r1 c1"]:
        """Area of each flat cell."""
        return np.outer(self.dv, self.du)

    @property
    def size(self) -> float:
        """Diagonal of the flat sheet."""
        return float(np.hypot(*self.film.size_mm))


def mass_spring(film: FilmMesh, material: FilmMaterial, metres_per_unit: float = 1 / MM_PER_M) -> MassSpring:
    """The network of a flat film whose sizes and vertices are in units of ``metres_per_unit`` (default a millimetre).

    Raises:
        ConfigError: lattice lines that do not increase, or a material without stiffness or mass.
    """
    _check(film, material)
    per_mm = 1 / (MM_PER_M * metres_per_unit)  # units per millimetre
    height, width = film.size_mm
    du, dv = np.diff(film.u_lines) * width, np.diff(film.v_lines) * height
    area = np.outer(_lumped(dv), _lumped(du)).ravel()
    nu, eh = material.poisson, material.membrane_stiffness / per_mm
    c11 = eh / (1 - nu**2)
    return MassSpring(
        film=film,
        material=material,
        metres_per_unit=metres_per_unit,
        du=du,
        dv=dv,
        mass_kg=area * material.thickness_mm * material.density_kg_mm3 / per_mm**2,
        area=area,
        membrane=(c11, nu * c11, eh / (2 * (1 + nu))),
        bending_stiffness=material.bending_stiffness * per_mm,
        held=np.zeros(film.shape, bool),
    )


def clamped(network: MassSpring, held: Bool[np.ndarray, "rows cols"]) -> MassSpring:
    """The network when the vertices ``held`` are held fast."""
    return replace(network, held=held)


def strain(network: MassSpring, x: Float[np.ndarray, "rows cols 3"]) -> Strain:
    """Green strain (|x_u|^2 - 1) / 2 of the edges and x_u . x_v of the cells.

    With the diagonals p and q of a cell a x b, x_u . x_v is (|p|^2 - |q|^2) / (4 a b): the shear spring.
    """
    across, down = edge_tangents(network, x)
    mean_u, mean_v = cell_tangents(across, down)
    return Strain(
        across=across,
        down=down,
        along_u=0.5 * (np.einsum("rck,rck->rc", across, across) - 1),
        along_v=0.5 * (np.einsum("rck,rck->rc", down, down) - 1),
        shear=np.einsum("rck,rck->rc", mean_u, mean_v),
    )


def edge_tangents(network: MassSpring, x: Float[np.ndarray, "rows cols 3"]) -> tuple[np.ndarray, np.ndarray]:
    """x_u of the edges along u, (rows, cols - 1, 3), and x_v of those along v, (rows - 1, cols, 3)."""
    return (x[:, 1:] - x[:, :-1]) / network.du[:, None], (x[1:] - x[:-1]) / network.dv[:, None, None]


def cell_tangents(across: np.ndarray, down: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean x_u and x_v of each cell, (rows - 1, cols - 1, 3) each."""
    return 0.5 * (across[:-1] + across[1:]), 0.5 * (down[:, :-1] + down[:, 1:])


def stress(network: MassSpring, along_u: np.ndarray, along_v: np.ndarray, shear: np.ndarray) -> CellStress:
    """Stress of plane-stress elasticity for given strains (``along_u``: (rows, cols - 1) and so on)."""
    c11, c12, c66 = network.membrane
    area = network.cell_area
    upper, lower, left, right = along_u[:-1], along_u[1:], along_v[:, :-1], along_v[:, 1:]
    poisson_u, poisson_v = 0.25 * c12 * (left + right), 0.25 * c12 * (upper + lower)
    edges = np.empty((4, *area.shape))
    edges[0], edges[1], edges[2], edges[3] = upper, lower, left, right
    edges *= 0.5 * c11
    edges[:2] += poisson_u
    edges[2:] += poisson_v
    edges *= area
    return CellStress(edges, area * c66 * shear)


def stretch_energy(network: MassSpring, state: Strain) -> float:
    """Energy of the structural and shear springs (force x length)."""
    force = stress(network, state.along_u, state.along_v, state.shear)
    upper, lower, left, right = force.edges
    twice = np.vdot(upper, state.along_u[:-1]) + np.vdot(lower, state.along_u[1:])
    twice += np.vdot(left, state.along_v[:, :-1]) + np.vdot(right, state.along_v[:, 1:])
    return float(0.5 * (twice + np.vdot(force.shear, state.shear)))


def spring_gradient(network: MassSpring, state: Strain, force: CellStress) -> Float[np.ndarray, "v 3"]:
    """J^T stress: the gradient of the stretching energy if ``force`` is the stress of ``state``."""
    mean_u, mean_v = cell_tangents(state.across, state.down)
    half = 0.5 * force.shear[..., None]
    on_u, on_v = np.zeros_like(state.across), np.zeros_like(state.down)
    on_u[:-1] += force.edges[0][..., None] * state.across[:-1] + half * mean_v
    on_u[1:] += force.edges[1][..., None] * state.across[1:] + half * mean_v
    on_v[:, :-1] += force.edges[2][..., None] * state.down[:, :-1] + half * mean_u
    on_v[:, 1:] += force.edges[3][..., None] * state.down[:, 1:] + half * mean_u
    on_u /= network.du[:, None]
    on_v /= network.dv[:, None, None]
    gradient = np.zeros((*network.film.shape, 3))
    gradient[:, 1:] += on_u
    gradient[:, :-1] -= on_u
    gradient[1:] += on_v
    gradient[:-1] -= on_v
    return gradient.reshape(-1, 3)


def lattice_normals(network: MassSpring, x: Float[np.ndarray, "rows cols 3"]) -> Float[np.ndarray, "rows cols 3"]:
    """Unit normals by central differences, x_v cross x_u as in FilmMesh.normals; 0 where the sheet has collapsed."""
    u, v = (np.concatenate([[0.0], np.cumsum(d)]) for d in (network.du, network.dv))
    normal = np.cross(np.gradient(x, v, axis=0), np.gradient(x, u, axis=1))
    return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)


# ---------------------------------------------------------------- lattice operators


def _check(film: FilmMesh, material: FilmMaterial) -> None:
    what = "mass-spring network"
    if np.any(np.diff(film.u_lines) <= 0) or np.any(np.diff(film.v_lines) <= 0) or min(film.shape) < 2:
        raise ConfigError(
            describe(
                what=what,
                got=f"lattice lines u {film.u_lines}, v {film.v_lines}: triangles without area",
                allowed="at least two strictly increasing lines each",
                do="Merge the lines that coincide.",
            )
        )
    numbers = (material.youngs_modulus_mpa, material.thickness_mm, material.density_kg_mm3, material.membrane_scale)
    if not (np.isfinite(numbers).all() and min(numbers) > 0 and 0 <= material.poisson <= 0.5):
        raise ConfigError(
            describe(what=what, got=material, allowed="positive numbers, 0 <= poisson <= 0.5", do="Correct them.")
        )


def _clamp_ends(held: np.ndarray) -> np.ndarray:
    """1.0 at held vertices with a held and a free neighbour along the columns, else 0.0."""
    ends = np.zeros(held.shape)
    before, here, after = held[:, :-2], held[:, 1:-1], held[:, 2:]
    ends[:, 1:-1] = here & (before ^ after)
    return ends


def _lumped(spacing: np.ndarray) -> np.ndarray:
    """Length that belongs to each node of an axis: half of each adjacent cell."""
    half = 0.5 * spacing
    return np.concatenate([half, [0.0]]) + np.concatenate([[0.0], half])


def _first_difference(spacing: np.ndarray) -> sparse.csr_array:
    """(n - 1, n) first derivative in each cell."""
    return sparse.csr_array(np.diff(np.eye(len(spacing) + 1), axis=0) / spacing[:, None])


def _second_difference(spacing: np.ndarray) -> sparse.csr_array:
    """(n, n) second derivative at the inner nodes of an uneven axis; zero rows at its free ends."""
    slopes = np.diff(np.eye(len(spacing) + 1), axis=0) / spacing[:, None]
    second = np.zeros((len(spacing) + 1, len(spacing) + 1))
    second[1:-1] = np.diff(slopes, axis=0) * (2 / (spacing[:-1] + spacing[1:]))[:, None]
    return sparse.csr_array(second)
