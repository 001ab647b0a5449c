"""The tangent of a step: material and geometric stiffness of the cells, bending and the vertices' blocks, factored."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hybrid.mesh.banded import SHIFTS, BandFactor, add_cells, add_vertices, factor
from hybrid.mesh.network import CellStress, MassSpring, Strain, cell_tangents

_P = np.array([-0.5, 0.5, -0.5, 0.5])
_Q = np.array([-0.5, -0.5, 0.5, 0.5])
_WARP = np.array([0.5, -0.5, -0.5, 0.5])
"""A cell's mean tangents (times its sides) and warp from its corners: upper left, upper right, lower left and right."""


def tangent_factor(
    network: MassSpring, state: Strain, force: CellStress, own: Float[np.ndarray, "v 3 3"]
) -> tuple[BandFactor, bool] | None:
    """Factor of J^T K J + geometric stiffness of ``force`` + bending + each vertex's ``own`` block.

    The geometric stiffness is exact (and the second value True) if the sum is definite. If compression makes the sum
    indefinite (the sheet is about to buckle), the positive part of the geometric stiffness is used.
    """
    shape = network.film.shape
    material = _material_blocks(network, state)
    for geometric in (_geometric, _positive_geometric):
        band = network.bending_band.copy()
        add_cells(band, shape, _with_each_axis(material, geometric(network, force)))
        add_vertices(band, shape, own)
        found = factor(band, shape, SHIFTS if geometric is _positive_geometric else (0.0,))
        if found is not None:
            return found, geometric is _geometric
    return None


def _with_each_axis(blocks: np.ndarray, geometric: np.ndarray) -> np.ndarray:
    """The cells' blocks plus a matrix of the corners that acts alike on x, y and z."""
    total = blocks.copy()
    for k in range(3):
        total[:, :, :, k, :, k] += geometric
    return total


def _material_blocks(network: MassSpring, state: Strain) -> Float[np.ndarray, "r1 c1 4 3 4 3"]:
    """J^T K J of each cell for its corners upper left, upper right, lower left, lower right."""
    c11, c12, c66 = network.membrane
    law = np.zeros((5, 5))
    law[range(4), range(4)] = 0.5 * c11
    law[:2, 2:4] = law[2:4, :2] = 0.25 * c12
    law[4, 4] = c66
    rows, cols = (n - 1 for n in network.film.shape)
    root = np.sqrt(network.cell_area)[..., None, None] * np.linalg.cholesky(law).T @ _measures(network, state)
    return np.matmul(root.swapaxes(-1, -2), root).reshape(rows, cols, 4, 3, 4, 3)


def _measures(network: MassSpring, state: Strain) -> Float[np.ndarray, "r1 c1 5 12"]:
    """Derivatives of a cell's five strains (edges above, below, left, right; shear) by its corners."""
    rows, cols = (n - 1 for n in network.film.shape)
    a, b = network.du[:, None], network.dv[:, None, None]
    slope = np.zeros((rows, cols, 5, 4, 3))
    across, down = state.across / a, state.down / b
    slope[:, :, 0, 1], slope[:, :, 1, 3] = across[:-1], across[1:]
    slope[:, :, 0, 0], slope[:, :, 1, 2] = -across[:-1], -across[1:]
    slope[:, :, 2, 2], slope[:, :, 3, 3] = down[:, :-1], down[:, 1:]
    slope[:, :, 2, 0], slope[:, :, 3, 1] = -down[:, :-1], -down[:, 1:]
    mean_u, mean_v = cell_tangents(state.across, state.down)
    with_u, with_v = 0.5 * mean_v / a, 0.5 * mean_u / b
    slope[:, :, 4, 0] = -with_u - with_v
    slope[:, :, 4, 1] = with_u - with_v
    slope[:, :, 4, 2] = with_v - with_u
    slope[:, :, 4, 3] = with_u + with_v
    return slope.reshape(rows, cols, 5, 12)


def _geometric(network: MassSpring, force: CellStress) -> Float[np.ndarray, "r1 c1 4 4"]:
    """Geometric stiffness of each cell, alike for x, y and z: stress times the second derivative of its strain."""
    a, b = network.du[None, :], network.dv[:, None]
    edges = [[-1.0, 1, 0, 0], [0, 0, -1, 1], [-1, 0, 1, 0], [0, -1, 0, 1]]
    total = np.zeros((*force.shear.shape, 4, 4))
    for edge, pull, length in zip(np.array(edges), force.edges, (a, a, b, b), strict=True):
        total += (pull / length**2)[..., None, None] * np.outer(edge, edge)
    both = np.outer(_P, _Q)
    return total + (force.shear / (a * b))[..., None, None] * (both + both.T)


def _positive_geometric(network: MassSpring, force: CellStress) -> Float[np.ndarray, "r1 c1 4 4"]:
    """Geometric stiffness without the part that compression would make negative.

    With mean tangents p, q of the cell and its warp h = (x11 - x10 - x01 + x00) / 2, the second variation of the
    springs' energy is n_u |dp|^2 + 2 tau dp.dq + n_v |dq|^2 + (n_u / a^2 + n_v / b^2) |dh|^2, apart from terms in the
    stress difference of opposite edges. The 2 x 2 matrix of the stress is replaced by its positive part.
    """
    n_u, n_v, tau = force.edges[0] + force.edges[1], force.edges[2] + force.edges[3], force.shear
    a, b = network.du[None, :], network.dv[:, None]
    middle, half = 0.5 * (n_u + n_v), 0.5 * (n_u - n_v)
    radius = np.maximum(np.hypot(half, tau), 1e-300)
    high, low = np.maximum(middle + radius, 0), np.maximum(middle - radius, 0)
    mean, swing = 0.5 * (high + low), 0.5 * (high - low) / radius
    on_p, on_q, on_both = (mean + swing * half) / a**2, (mean - swing * half) / b**2, swing * tau / (a * b)
    warp = np.maximum(n_u / a**2 + n_v / b**2, 0)
    terms = [
        (on_p, np.outer(_P, _P)),
        (on_q, np.outer(_Q, _Q)),
        (on_both, np.outer(_P, _Q) + np.outer(_Q, _P)),
        (warp, np.outer(_WARP, _WARP)),
    ]
    return np.asarray(sum(weight[..., None, None] * matrix for weight, matrix in terms))
