"""Film points as a camera sees them, on the smooth surface through the mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from hybrid.coords import film_centres_1d
from hybrid.mesh.film import FilmMesh, spline_matrices
from hybrid.mesh.vectors import cross, dot, unit


@dataclass(frozen=True, eq=False)
class SeenFilm:
    """A lattice of film points as one camera sees them; float32, planar (hybrid.mesh.vectors).

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

    The bicubic surface through the vertices is a product of two interpolations: both are matrices, fast on fine
    lattices.
    """
    (u, du), (v, dv) = (_spline(lines, n) for lines in (film.u_lines, film.v_lines))
    points, normals = _lattice(film, v, u), unit(cross(_lattice(film, dv, u), _lattice(film, v, du)))
    view = unit(camera_mm.astype(np.float32) - points)
    towards = dot(view, normals)[..., None]
    normals *= np.where(towards < 0, np.float32(-1), np.float32(1))
    return SeenFilm(points, normals, view, np.maximum(np.abs(towards), np.float32(0.01)))


def film_points(film: FilmMesh, n: int) -> Float[np.ndarray, "n n 3"]:
    """Only the points (mm) of that lattice."""
    return _lattice(film, _spline(film.v_lines, n)[0], _spline(film.u_lines, n)[0])


def _spline(lines: Float[np.ndarray, " m"], n: int) -> tuple[Float32[np.ndarray, "n m"], Float32[np.ndarray, "n m"]]:
    values, slopes = spline_matrices(lines, film_centres_1d(n))
    return values.astype(np.float32), slopes.astype(np.float32)


def _lattice(
    film: FilmMesh, rows: Float32[np.ndarray, "n r"], cols: Float32[np.ndarray, "n c"]
) -> Float32[np.ndarray, "n n 3"]:
    grid = np.ascontiguousarray(film.vertices.transpose(2, 0, 1), dtype=np.float32)
    return np.moveaxis(rows @ (grid @ cols.T), 0, -1)
