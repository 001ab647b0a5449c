"""Implicit mass-spring solver for a film: backward Euler, Newton with line search, banded Cholesky.

The energy of a step (Martin et al. 2011, "Example-based elastic materials", eq. 2) is
``|x - y|^2_M / (2 dt^2) + E(x)`` with ``y`` the position that inertia alone would give. E has
structural and shear springs, bending, goal springs and a table; each term's Hessian is used in a form that is positive
semi-definite, so every Newton direction descends and the Cholesky factor exists at any step size.

Units: mm, N, kg, s. A mass of m kg under f N is accelerated by 1000 f / m mm/s^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.linalg import cho_solve_banded, cholesky_banded

from hybrid.errors import SimulationError, describe
from hybrid.mesh.film import FilmMesh

MM_PER_M = 1000.0
GRAVITY_MM_S2 = 9806.65
_SPRING_POISSON = 1.0 / 3.0
"""Poisson's ratio that a lattice of central springs has, whatever the film's own (Cauchy relation)."""


@dataclass(frozen=True)
class FilmMaterial:
    """Elastic film. The defaults are the PET base of an X-ray film.

    youngs_modulus_mpa: N/mm^2. thickness_mm: mm. poisson: for bending. density_kg_mm3: kg/mm^3.
    membrane_scale: factor on the stretching stiffness only; below 1 the sheet behaves like the soft bodies of the
        published data set, which bulge into shapes that no real sheet can take.
    """

    youngs_modulus_mpa: float = 4000.0
    thickness_mm: float = 0.175
    poisson: float = 0.3
    density_kg_mm3: float = 1390e-9
    membrane_scale: float = 1.0

    @property
    def bending_stiffness(self) -> float:
        """D = E h^3 / (12 (1 - nu^2)) in N mm."""
        return self.youngs_modulus_mpa * self.thickness_mm**3 / (12 * (1 - self.poisson**2))

    @property
    def membrane_stiffness(self) -> float:
        """E h in N/mm, scaled."""
        return self.youngs_modulus_mpa * self.thickness_mm * self.membrane_scale


@dataclass(frozen=True)
class StepConfig:
    """How a time step is solved.

    dt_s: seconds. damping: share of the velocity that is lost in a step. max_iterations: Newton's limit.
    tolerance_mm: Newton stops when no vertex moves further than this.
    """

    dt_s: float = 1 / 30
    damping: float = 0.1
    max_iterations: int = 12
    tolerance_mm: float = 0.02


@dataclass(frozen=True, eq=False)
class Loads:
    """What acts on the sheet during a step.

    force_n: (V, 3) N on each vertex. goal_mm: (V, 3) where goal springs pull to. goal_stiffness: (V,) N/mm, 0 for free.
    rest_curvature: 1/mm along u and along v (a film kept rolled). table_z_mm: a table's plane
        (+z is down there), or None.
    """

    force_n: Float[np.ndarray, "v 3"]
    goal_mm: Float[np.ndarray, "v 3"]
    goal_stiffness: Float[np.ndarray, " v"]
    rest_curvature: tuple[float, float] = (0.0, 0.0)
    table_z_mm: float | None = None


@dataclass(frozen=True, eq=False)
class Frame:
    """The sheet after a step.

    mesh: the bent sheet. velocity: (V, 3) mm/s. iterations: Newton iterations. moved_mm: the last iteration's largest
    move (the residual, in length). max_strain: largest relative change of length of a lattice edge.
    """

    mesh: FilmMesh
    velocity: Float[np.ndarray, "v 3"]
    iterations: int
    moved_mm: float
    max_strain: float


@dataclass(frozen=True, eq=False)
class MassSpring:
    """The network of a sheet: masses, springs with rest lengths and stiffness, and the bending matrix.

    mass_kg: (V,). springs: (S, 2) vertex numbers. rest_mm, stiffness: (S,). bending: (V, V) N/mm, constant.
    curvature_u, curvature_v: (V, V), area-weighted second derivatives along u and v, for rest curvature (N).
    """

    film: FilmMesh
    material: FilmMaterial
    mass_kg: Float[np.ndarray, " v"]
    springs: Int[np.ndarray, "s 2"]
    rest_mm: Float[np.ndarray, " s"]
    stiffness: Float[np.ndarray, " s"]
    bending: sparse.csr_array
    curvature_u: sparse.csr_array
    curvature_v: sparse.csr_array

    @cached_property
    def bandwidth(self) -> int:
        """Number of diagonals below the main one of the 3 V x 3 V system."""
        coo = self.bending.tocoo()
        widest = max(np.abs(coo.row - coo.col).max(), np.abs(np.diff(self.springs, axis=1)).max())
        return 3 * int(widest) + 2

    @cached_property
    def bending_band(self) -> Float[np.ndarray, "b n"]:
        """The bending matrix in LAPACK's lower banded storage, for the three coordinates of each vertex."""
        coo = sparse.kron(self.bending, sparse.identity(3)).tocoo()
        band = np.zeros((self.bandwidth + 1, 3 * len(self.mass_kg)))
        lower = coo.row >= coo.col
        band[coo.row[lower] - coo.col[lower], coo.col[lower]] = coo.data[lower]
        return band

    @cached_property
    def spring_slots(self) -> Int[np.ndarray, "s 36"]:
        """Flat places in the banded storage of each spring's 6 x 6 block (upper triangle sent to a dump slot)."""
        dofs = (3 * self.springs[:, :, None] + np.arange(3)).reshape(-1, 6)
        row, col = np.broadcast_arrays(dofs[:, :, None], dofs[:, None, :])
        n = 3 * len(self.mass_kg)
        slots = np.where(row >= col, (row - col) * n + col, (self.bandwidth + 1) * n)
        return slots.reshape(-1, 36)


def mass_spring(film: FilmMesh, material: FilmMaterial) -> MassSpring:
    """The spring network of a flat film, with stiffness derived from the material.

    Springs of a lattice cell a x b with both diagonals d have the membrane stiffness of an isotropic sheet with
    nu = 1/3 for k_diagonal = C12 d^2 / (2 a b) and k_u = (C11 - C12 a^2 / b^2) b / a, where C11 = 9 E h / 8 and
    C12 = 3 E h / 8 (equal strain energy; a cell longer than sqrt(3) : 1 keeps a small positive k). Bending is the plate
    energy D / 2 (|x_uu|^2 + 2 |x_uv|^2 + |x_vv|^2) by second differences (quadratic, Bergou et al. 2006).
    """
    rows, cols = film.shape
    height, width = film.size_mm
    du, dv = np.diff(film.u_lines) * width, np.diff(film.v_lines) * height
    area = np.outer(_lumped(dv), _lumped(du)).ravel()
    springs, stiffness = _springs(rows, cols, du, dv, material.membrane_stiffness)
    flat = film.vertices.reshape(-1, 3)
    rest = np.linalg.norm(flat[springs[:, 0]] - flat[springs[:, 1]], axis=1)
    second_u = sparse.kron(sparse.identity(rows), _second_difference(du)).tocsr()
    second_v = sparse.kron(_second_difference(dv), sparse.identity(cols)).tocsr()
    mixed = sparse.kron(_first_difference(dv), _first_difference(du)).tocsr()
    weight = sparse.diags_array(area * material.bending_stiffness)
    cell = sparse.diags_array(2 * np.outer(dv, du).ravel() * material.bending_stiffness)
    bending = second_u.T @ weight @ second_u + second_v.T @ weight @ second_v + mixed.T @ cell @ mixed
    mass = area * material.thickness_mm * material.density_kg_mm3
    return MassSpring(
        film=film,
        material=material,
        mass_kg=mass,
        springs=springs,
        rest_mm=rest,
        stiffness=stiffness,
        bending=sparse.csr_array(bending),
        curvature_u=sparse.csr_array(second_u.T @ weight),
        curvature_v=sparse.csr_array(second_v.T @ weight),
    )


def step(network: MassSpring, frame: Frame, loads: Loads, config: StepConfig) -> Frame:
    """The sheet one time step later.

    Raises:
        SimulationError: the loads or the state are not finite.
    """
    x0 = frame.mesh.vertices.reshape(-1, 3)
    if not (np.isfinite(loads.force_n).all() and np.isfinite(loads.goal_mm).all() and np.isfinite(x0).all()):
        raise SimulationError(describe(what="step", got="a force, goal or position that is not finite", do="Bound it."))
    inertia = network.mass_kg / (MM_PER_M * config.dt_s**2)
    target = x0 + (1 - config.damping) * config.dt_s * frame.velocity
    problem = _StepProblem(network, loads, inertia, target, frame.mesh.bent(frame.mesh.vertices))
    x, moved, iterations = x0, np.inf, 0
    while iterations < config.max_iterations and moved > config.tolerance_mm:
        x_next = problem.descend(x)
        moved = float(np.abs(x_next - x).max())
        x, iterations = x_next, iterations + 1
    mesh = frame.mesh.bent(x.reshape(frame.mesh.vertices.shape))
    return Frame(mesh, (x - x0) / config.dt_s, iterations, moved, float(np.abs(mesh.edge_strain()).max()))


def at_rest(mesh: FilmMesh) -> Frame:
    """A sheet that does not move."""
    still = np.zeros((mesh.vertices.shape[0] * mesh.vertices.shape[1], 3))
    return Frame(mesh, still, 0, 0.0, float(np.abs(mesh.edge_strain()).max()))


# ---------------------------------------------------------------- one step's minimisation


class _StepProblem:
    """The energy of one step with its gradient and a positive definite Hessian."""

    def __init__(
        self,
        network: MassSpring,
        loads: Loads,
        inertia: np.ndarray,
        target: np.ndarray,
        mesh: FilmMesh,
    ) -> None:
        self.network, self.loads, self.inertia, self.target = network, loads, inertia, target
        # Rest curvature bends about the surface normal, which is held for the step: its load is then constant.
        normals = mesh.normals(mesh.u_lines, mesh.v_lines).reshape(-1, 3)
        curl_u, curl_v = loads.rest_curvature
        self.force = loads.force_n + (curl_u * network.curvature_u + curl_v * network.curvature_v) @ normals
        self.table_stiffness = 0.2 * network.material.membrane_stiffness if loads.table_z_mm is not None else 0.0

    def energy(self, x: np.ndarray) -> float:
        """Energy in N mm."""
        net, loads = self.network, self.loads
        length = np.linalg.norm(x[net.springs[:, 0]] - x[net.springs[:, 1]], axis=1)
        total = 0.5 * np.sum(self.inertia * ((x - self.target) ** 2).sum(axis=1))
        total += 0.5 * np.sum(net.stiffness * (length - net.rest_mm) ** 2)
        total += 0.5 * np.sum(x * (net.bending @ x)) - np.sum(self.force * x)
        total += 0.5 * np.sum(loads.goal_stiffness * ((x - loads.goal_mm) ** 2).sum(axis=1))
        return float(total + 0.5 * self.table_stiffness * np.sum(self._depth(x) ** 2))

    def descend(self, x: np.ndarray) -> np.ndarray:
        """One Newton step with backtracking; ``x`` itself where no step lowers the energy."""
        direction = self._newton_direction(x)
        start, scale = self.energy(x), 1.0
        for _ in range(12):
            moved = x + scale * direction
            if self.energy(moved) <= start:
                return moved
            scale *= 0.5
        return x

    def _depth(self, x: np.ndarray) -> np.ndarray:
        """How deep each vertex is in the table, mm."""
        if self.loads.table_z_mm is None:
            return np.zeros(len(x))
        return np.maximum(x[:, 2] - self.loads.table_z_mm, 0.0)

    def _newton_direction(self, x: np.ndarray) -> np.ndarray:
        net, loads = self.network, self.loads
        n = 3 * len(x)
        edge = x[net.springs[:, 0]] - x[net.springs[:, 1]]
        length = np.maximum(np.linalg.norm(edge, axis=1), 1e-12)
        unit = edge / length[:, None]
        tension = net.stiffness * (length - net.rest_mm)
        pull = tension[:, None] * unit
        gradient = self.inertia[:, None] * (x - self.target) + net.bending @ x - self.force
        gradient += loads.goal_stiffness[:, None] * (x - loads.goal_mm)
        for k in range(3):
            gradient[:, k] += np.bincount(net.springs[:, 0], pull[:, k], len(x))
            gradient[:, k] -= np.bincount(net.springs[:, 1], pull[:, k], len(x))
        depth = self._depth(x)
        gradient[:, 2] += self.table_stiffness * depth

        # Spring Hessian k (d d^T + (1 - rest / length)+ (I - d d^T)): a compressed spring's negative part is dropped.
        across = np.maximum(tension / length, 0.0)
        outer = unit[:, :, None] * unit[:, None, :]
        block = (net.stiffness - across)[:, None, None] * outer + across[:, None, None] * np.eye(3)
        blocks = np.empty((len(block), 2, 3, 2, 3))
        blocks[:, 0, :, 0] = blocks[:, 1, :, 1] = block
        blocks[:, 0, :, 1] = blocks[:, 1, :, 0] = -block
        size = (net.bandwidth + 1) * n
        band = np.bincount(net.spring_slots.ravel(), blocks.ravel(), size + 1)[:size].reshape(-1, n)
        band += net.bending_band
        diagonal = np.repeat(self.inertia + loads.goal_stiffness, 3)
        diagonal[2::3] += self.table_stiffness * (depth > 0)
        band[0] += diagonal
        factor = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
        return -cho_solve_banded((factor, True), gradient.ravel(), check_finite=False).reshape(-1, 3)


# ---------------------------------------------------------------- lattice operators


def _lumped(spacing: np.ndarray) -> np.ndarray:
    """Length that belongs to each node of an axis: half of the cells on either side."""
    half = 0.5 * spacing
    return np.concatenate([half, [0.0]]) + np.concatenate([[0.0], half])


def _first_difference(spacing: np.ndarray) -> sparse.csr_array:
    """(n - 1, n) first derivative in each cell."""
    n = len(spacing)
    return sparse.csr_array(sparse.diags_array([-1 / spacing, 1 / spacing], offsets=[0, 1], shape=(n, n + 1)))


def _second_difference(spacing: np.ndarray) -> sparse.csr_array:
    """(n, n) second derivative at the inner nodes of an uneven axis; zero rows at its free ends."""
    first = _first_difference(spacing)
    inner = sparse.diags_array(2 / (spacing[:-1] + spacing[1:])) @ (first[1:] - first[:-1])
    empty = sparse.csr_array((1, first.shape[1]))
    return sparse.csr_array(sparse.vstack([empty, inner, empty]))


def _springs(
    rows: int, cols: int, du: np.ndarray, dv: np.ndarray, membrane: float
) -> tuple[Int[np.ndarray, "s 2"], Float[np.ndarray, " s"]]:
    """Structural springs along u and v and shear springs on both diagonals, with their stiffness in N/mm."""
    c11 = membrane / (1 - _SPRING_POISSON**2)
    c12 = _SPRING_POISSON * c11
    number = np.arange(rows * cols).reshape(rows, cols)
    a, b = np.meshgrid(du, dv)  # cell sizes, (rows - 1, cols - 1)
    floor = 0.1 * c11
    cell_u = 0.5 * np.maximum(c11 - c12 * (a / b) ** 2, floor) * b / a  # half of a cell's share to each of its sides
    cell_v = 0.5 * np.maximum(c11 - c12 * (b / a) ** 2, floor) * a / b
    k_u = np.zeros((rows, cols - 1))
    k_u[:-1] += cell_u
    k_u[1:] += cell_u
    k_v = np.zeros((rows - 1, cols))
    k_v[:, :-1] += cell_v
    k_v[:, 1:] += cell_v
    k_diagonal = (c12 * (a**2 + b**2) / (2 * a * b)).ravel()
    pairs = [
        np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], axis=1),
        np.stack([number[:-1].ravel(), number[1:].ravel()], axis=1),
        np.stack([number[:-1, :-1].ravel(), number[1:, 1:].ravel()], axis=1),
        np.stack([number[:-1, 1:].ravel(), number[1:, :-1].ravel()], axis=1),
    ]
    return np.concatenate(pairs), np.concatenate([k_u.ravel(), k_v.ravel(), k_diagonal, k_diagonal])
