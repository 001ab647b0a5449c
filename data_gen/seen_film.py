"""Film points as a camera sees them, on the smooth surface through the mesh."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float32
from scipy.interpolate import make_interp_spline

from data_gen.gloss import cross, dot, unit
from hybrid.coords import film_centres_1d
from hybrid.mesh.film import FilmMesh


@dataclass(frozen=True, eq=False)
class SeenFilm:
    """A lattice of film points as one camera sees them; float32.

    points: mm. normals: unit, of the side that is seen. view: unit, towards the camera. cosine: between those two.
    """

    points: Float[np.ndarray, "m n 3"]
    normals: Float[np.ndarray, "m n 3"]
    view: Float[np.ndarray, "m n 3"]
    cosine: Float[np.ndarray, "m n 1"]

    @property
    def mirror(self) -> Float[np.ndarray, "m n 3"]:
        """Unit directions from which a mirror would send light to the camera."""
        return 2 * self.cosine * self.normals - self.view

    def part(self, rows: slice, cols: slice) -> SeenFilm:
        return SeenFilm(*(getattr(self, name)[rows, cols] for name in ("points", "normals", "view", "cosine")))


def seen_film(film: FilmMesh, camera_mm: Float[np.ndarray, "3"], n: int) -> SeenFilm:
    """The n x n lattice of film pixel centres on the smooth (bicubic) film, seen from ``camera_mm``.

    The bicubic surface through the vertices is a product of two interpolations: matrices, fast on fine lattices.
    """
    (u, du), (v, dv) = (_spline_matrices(tuple(lines.tolist()), n) for lines in (film.u_lines, film.v_lines))
    grid = np.ascontiguousarray(film.vertices.transpose(2, 0, 1), dtype=np.float32)

    def lattice(rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.moveaxis(rows @ (grid @ cols.T), 0, -1))

    points, normals = lattice(v, u), unit(cross(lattice(dv, u), lattice(v, du)))
    view = unit(camera_mm.astype(np.float32) - points)
    towards = dot(view, normals)[..., None]
    normals *= np.where(towards < 0, np.float32(-1), np.float32(1))
    return SeenFilm(points, normals, view, np.maximum(np.abs(towards), np.float32(0.01)))


@lru_cache(maxsize=64)
def _spline_matrices(lines: tuple[float, ...], n: int) -> tuple[Float32[np.ndarray, "n m"], Float32[np.ndarray, "n m"]]:
    """What takes values on the m lattice lines of one axis to the cubic spline, and its slope, at n pixel centres."""
    spline, t = make_interp_spline(np.array(lines), np.eye(len(lines))), film_centres_1d(n)
    return spline(t).astype(np.float32), spline(t, nu=1).astype(np.float32)
