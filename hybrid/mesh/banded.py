"""Tangent stiffness of a lattice as a band, and its Cholesky factor by LAPACK.

If the vertices of an m x n lattice are numbered along its shorter side, each is coupled only with vertices at most 2 m
numbers away. The matrix of 3 m n unknowns is then a band of 6 m, which LAPACK factors at the speed of matrix products.
The band is stored transposed, (unknown, diagonal), as LAPACK expects; this also makes blocks of vertices strided views.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.linalg import get_lapack_funcs

_PBTRF, _PBTRS = get_lapack_funcs(("pbtrf", "pbtrs"), dtype=np.float64)

SHIFTS = (0.0, 1e-12, 1e-9, 1e-6, 1e-3)
"""Shares of the mean diagonal that are added in turn until the matrix is definite in floating point."""


@dataclass(frozen=True, eq=False)
class BandFactor:
    """Cholesky factor of a tangent.

    lower: LAPACK's band. order: number of each vertex in the band. shift: share of the mean diagonal that was added.
    """

    lower: Float[np.ndarray, "b n"]
    order: Int[np.ndarray, " v"]
    shift: float

    def solve(self, right: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
        """Solution for a load on each vertex."""
        ordered = np.empty_like(right)
        ordered[self.order] = right
        solution, _ = _PBTRS(self.lower, ordered.ravel(), lower=1)
        return solution.reshape(-1, 3)[self.order]


def lattice_order(shape: tuple[int, int]) -> Int[np.ndarray, "rows cols"]:
    """Numbers of the vertices, counted along the shorter side first."""
    rows, cols = shape
    if cols <= rows:
        return np.arange(rows * cols).reshape(rows, cols)
    return np.arange(rows * cols).reshape(cols, rows).T


def bandwidth(shape: tuple[int, int]) -> int:
    """Number of diagonals below the main one: second differences reach two lattice lines away."""
    return 3 * 2 * max(min(shape), 2) + 2


def band_of(matrix: sparse.csr_array, shape: tuple[int, int]) -> Float[np.ndarray, "n b"]:
    """A (V, V) matrix that acts alike on x, y and z, as a transposed band."""
    number = lattice_order(shape).ravel()
    coo = matrix.tocoo()
    row, col = number[coo.row], number[coo.col]
    lower = row >= col
    band = np.zeros((len(number), 3, bandwidth(shape) + 1))
    for k in range(3):
        band[col[lower], k, 3 * (row - col)[lower]] = coo.data[lower]
    return band.reshape(3 * len(number), -1)


def add_cells(band: np.ndarray, shape: tuple[int, int], blocks: Float[np.ndarray, "r1 c1 4 3 4 3"]) -> None:
    """Add the 12 x 12 matrices of the cells (corners: upper left, upper right, lower left, lower right) to a band."""
    rows, cols = shape
    places = [np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, :-1], np.s_[1:, 1:]]
    whole = np.zeros((rows, cols, 3, 3))
    right, down = np.zeros((rows, cols - 1, 3, 3)), np.zeros((rows - 1, cols, 3, 3))
    for corner, place in enumerate(places):
        whole[place] += blocks[:, :, corner, :, corner]
    right[:-1] += blocks[:, :, 0, :, 1]
    right[1:] += blocks[:, :, 2, :, 3]
    down[:, :-1] += blocks[:, :, 0, :, 2]
    down[:, 1:] += blocks[:, :, 1, :, 3]
    _add_pairs(band, shape, (0, 0), whole)
    _add_pairs(band, shape, (0, 1), right)
    _add_pairs(band, shape, (1, 0), down)
    _add_pairs(band, shape, (1, 1), blocks[:, :, 0, :, 3])
    _add_pairs(band, shape, (1, -1), blocks[:, :, 1, :, 2])


def add_vertices(band: np.ndarray, shape: tuple[int, int], blocks: Float[np.ndarray, "v 3 3"]) -> None:
    """Add a 3 x 3 matrix of each vertex to a band."""
    _add_pairs(band, shape, (0, 0), blocks.reshape(*shape, 3, 3))


def factor(
    band: Float[np.ndarray, "n b"], shape: tuple[int, int], shifts: tuple[float, ...] = SHIFTS
) -> BandFactor | None:
    """Cholesky factor of a band, which is overwritten; None if no shift makes it definite."""
    order = lattice_order(shape).ravel()
    mean = float(band[:, 0].mean())
    if not np.isfinite(mean):
        return None
    original = band.copy() if len(shifts) > 1 else band
    for shift in shifts:
        if shift > 0:
            np.copyto(band, original)
            band[:, 0] += shift * mean
        lower, info = _PBTRF(band.T, lower=1, overwrite_ab=1)
        if info == 0:
            return BandFactor(lower, order, shift)
    return None


def _add_pairs(band: np.ndarray, shape: tuple[int, int], way: tuple[int, int], blocks: np.ndarray) -> None:
    """Add blocks (.., 3, 3) that couple each vertex with the one ``way`` (rows, cols) away to the lower triangle.

    The first axes of ``blocks`` run over all pairs of the lattice.
    """
    rows, cols = shape
    view, strides = band.reshape(rows, cols, 3, -1), (cols, 1)
    if cols > rows:
        view, strides = band.reshape(cols, rows, 3, -1).swapaxes(0, 1), (1, rows)
    offset = way[0] * strides[0] + way[1] * strides[1]
    if offset < 0:
        way, offset, blocks = (-way[0], -way[1]), -offset, blocks.swapaxes(-1, -2)
    first = view[_from(way[0]), _from(way[1])]
    for i in range(3):
        for j in range(3):
            if 3 * offset + j - i >= 0:
                first[:, :, i, 3 * offset + j - i] += blocks[..., i, j]


def _from(way: int) -> slice:
    """Lattice lines that have another one ``way`` further on."""
    return slice(max(-way, 0), -way if way > 0 else None)
