"""The film as a mesh: a sheet whose slice-grid corners are vertices, subdivided by Open3D, and its smooth surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import BSpline, make_interp_spline

from hybrid.backward import MIN_NODES
from hybrid.errors import ConfigError, describe
from hybrid.mesh.vectors import cross


@dataclass(frozen=True, eq=False)
class FilmMesh:
    """A flat or bent sheet on a rectangular lattice of film points.

    u_lines, v_lines: increasing film coordinates of the lattice columns and rows, from 0 to 1.
    vertices: (rows, cols, 3) mm; for a flat sheet x runs along u, y along v, z is 0, the centre is the origin.
    size_mm: (height, width) of the flat sheet.
    grid_rows, grid_cols: numbers of the lattice rows and columns that carry the lines of the slice grid.
    """

    u_lines: Float[np.ndarray, " cols"]
    v_lines: Float[np.ndarray, " rows"]
    vertices: Float[np.ndarray, "rows cols 3"]
    size_mm: tuple[float, float]
    grid_rows: Int[np.ndarray, " r"]
    grid_cols: Int[np.ndarray, " c"]

    @property
    def shape(self) -> tuple[int, int]:
        """Number of lattice rows and columns."""
        return self.vertices.shape[0], self.vertices.shape[1]

    @cached_property
    def triangles(self) -> Int[np.ndarray, "t 3"]:
        """Vertex numbers (row by row) of the triangles, two for each lattice cell."""
        rows, cols = self.shape
        return lattice_triangles(rows, cols)

    @property
    def grid_vertices(self) -> Float[np.ndarray, "r c 3"]:
        """Positions (mm) of the slice grid's corners."""
        return self.vertices[np.ix_(self.grid_rows, self.grid_cols)]

    def bent(self, vertices: Float[np.ndarray, "rows cols 3"]) -> FilmMesh:
        """The same sheet with other vertex positions."""
        if vertices.shape != self.vertices.shape:
            raise ValueError(f"FilmMesh.bent: got shape {vertices.shape}; allowed: {self.vertices.shape}")
        return FilmMesh(self.u_lines, self.v_lines, vertices, self.size_mm, self.grid_rows, self.grid_cols)

    def surface(self, u: np.ndarray, v: np.ndarray) -> Float[np.ndarray, "nv nu 3"]:
        """Points (mm) of the smooth (bicubic) surface on the lattice of film coordinates ``v`` x ``u``."""
        return self._product(spline_matrices(self.v_lines, v)[0], spline_matrices(self.u_lines, u)[0])

    def normals(self, u: np.ndarray, v: np.ndarray) -> Float[np.ndarray, "nv nu 3"]:
        """Unit normals of the smooth surface; they point to the side from which the film reads right.

        For the flat sheet that is -z: with x to the right and y down, as a reader sees it, +z points away.
        """
        (across, slope_u), (down, slope_v) = spline_matrices(self.u_lines, u), spline_matrices(self.v_lines, v)
        normal = np.ascontiguousarray(cross(self._product(slope_v, across), self._product(down, slope_u)))
        return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)

    def _product(
        self, rows: Float[np.ndarray, "nv m"], cols: Float[np.ndarray, "nu k"]
    ) -> Float[np.ndarray, "nv nu 3"]:
        """The vertices interpolated along both axes by one-dimensional interpolation matrices."""
        return np.stack([rows @ self.vertices[..., k] @ cols.T for k in range(3)], axis=-1)

    def angle_defects(self) -> Float[np.ndarray, "r2 c2"]:
        """Gaussian curvature times area (rad) at the inner vertices: 2 pi minus the angles of the triangles there."""
        corners = self._corners()
        total = np.zeros(self.shape[0] * self.shape[1])
        for k in range(3):
            here, left, right = (corners[(k + n) % 3] for n in range(3))
            p, q = left - here, right - here
            angle = np.arctan2(np.linalg.norm(np.cross(p, q), axis=1), np.einsum("tk,tk->t", p, q))
            total += np.bincount(self.triangles[:, k], angle, len(total))
        return (2 * np.pi - total.reshape(self.shape))[1:-1, 1:-1]

    def _corners(self) -> tuple[np.ndarray, ...]:
        points = self.vertices.reshape(-1, 3)
        return tuple(points[self.triangles[:, k]] for k in range(3))

    def edge_strain(self) -> Float[np.ndarray, " e"]:
        """Relative change in length of all lattice edges compared with the flat sheet."""
        height, width = self.size_mm
        across = np.linalg.norm(np.diff(self.vertices, axis=1), axis=-1) / (np.diff(self.u_lines) * width) - 1
        down = np.linalg.norm(np.diff(self.vertices, axis=0), axis=-1) / (np.diff(self.v_lines) * height)[:, None] - 1
        return np.concatenate([across.ravel(), down.ravel()])


def spline_matrices(
    lines: Float[np.ndarray, " m"], t: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n m"], Float[np.ndarray, "n m"]]:
    """Matrices that turn values on the lattice lines of one axis into their cubic spline and its slope at ``t``."""
    return _spline_matrices(lines.tobytes(), np.asarray(t, np.float64).tobytes())


@lru_cache(maxsize=128)
def _spline_matrices(lines: bytes, t: bytes) -> tuple[np.ndarray, np.ndarray]:
    spline, at = _interpolation(lines), np.frombuffer(t)
    return spline(at), spline(at, nu=1)


@lru_cache(maxsize=16)
def _interpolation(lines: bytes) -> BSpline:
    """For each line, the cubic spline that is 1 on that line and 0 on the others."""
    t = np.frombuffer(lines)
    return make_interp_spline(t, np.eye(len(t)))


def lattice_triangles(rows: int, cols: int) -> Int[np.ndarray, "t 3"]:
    """Vertex numbers of the triangles of a lattice numbered row by row, two for each cell."""
    corner = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)[None, :]).ravel()
    upper = np.stack([corner, corner + cols, corner + 1], axis=1)
    lower = np.stack([corner + 1, corner + cols, corner + cols + 1], axis=1)
    return np.concatenate([upper, lower])


def film_mesh(
    size_mm: tuple[float, float],
    grid_u: Float[np.ndarray, " c"],
    grid_v: Float[np.ndarray, " r"],
    levels: int = 2,
) -> FilmMesh:
    """A flat sheet of ``size_mm`` (height, width) whose slice-grid lines at ``grid_u``, ``grid_v`` are lattice lines.

    The base mesh has one cell for each slice and for each margin; Open3D's midpoint subdivision then halves every
    edge ``levels`` times, so the grid's corners stay vertices at each level (PAPER, deformation simulating).

    Raises:
        ConfigError: a size that is not positive, or grid lines that do not increase within [0, 1].
    """
    if min(size_mm) <= 0 or levels < 0:
        raise ConfigError(
            describe(what="film mesh", got=(size_mm, levels), allowed="size > 0, levels >= 0", do="Check both.")
        )
    u_base, v_base = base_lines(grid_u, "grid_u"), base_lines(grid_v, "grid_v")
    uv = _subdivided_uv(u_base, v_base, levels)
    u_lines, v_lines = np.unique(uv[:, 0]), np.unique(uv[:, 1])
    if min(len(u_lines), len(v_lines)) < MIN_NODES:
        raise ConfigError(
            describe(
                what="film mesh", got=f"{len(v_lines)} x {len(u_lines)} vertices", allowed="4 x 4", do="Add levels."
            )
        )
    height, width = size_mm
    u, v = np.meshgrid(u_lines, v_lines)
    vertices = np.stack([(u - 0.5) * width, (v - 0.5) * height, np.zeros_like(u)], axis=-1)
    columns = np.abs(u_lines[:, None] - grid_u).argmin(axis=0)
    rows = np.abs(v_lines[:, None] - grid_v).argmin(axis=0)
    return FilmMesh(u_lines, v_lines, vertices, size_mm, rows, columns)


def base_lines(grid: np.ndarray, name: str = "grid") -> np.ndarray:
    """The sheet's edges and the grid's lines along one axis, each once."""
    if len(grid) < 2 or grid[0] < 0 or grid[-1] > 1 or np.any(np.diff(grid) <= 0):
        raise ConfigError(describe(what=name, got=grid, allowed="increasing values in [0, 1]", do="Sort the lines."))
    lines = np.concatenate([[0.0], grid, [1.0]])
    return lines[np.concatenate([[True], np.diff(lines) > 1e-6])]


def _subdivided_uv(u_base: np.ndarray, v_base: np.ndarray, levels: int) -> Float[np.ndarray, "n 2"]:
    """Film points of the vertices after ``levels`` midpoint subdivisions by Open3D (rounded to 1e-9)."""
    import open3d as o3d

    rows, cols = len(v_base), len(u_base)
    u, v = np.meshgrid(u_base, v_base)
    points = np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], axis=1)
    triangles = lattice_triangles(rows, cols)
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(points), o3d.utility.Vector3iVector(triangles))
    fine = mesh.subdivide_midpoint(number_of_iterations=levels)
    return np.round(np.asarray(fine.vertices)[:, :2], 9)
