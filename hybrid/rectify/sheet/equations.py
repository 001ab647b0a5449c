"""Normal equations of a sheet, from residuals each of which depends on few of its coefficients.

The unknowns are the x of all coefficients, their y, their z, the camera, and the constants of the sightings. Where a
point of the film is seen depends on only four rows of coefficients (SortedDesign), the camera and the constants.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hybrid.rectify.sheet.shape import CAMERA
from hybrid.rectify.splines.bspline import SortedDesign


@dataclass(frozen=True, eq=False)
class Block:
    """Residuals at the points of a design, one or more kinds at each, in standard deviations.

    derivatives: by the coefficients that count at the point, all x, then y, then z; then by the ``tail``, camera and
    constants. Empty where only the cost is needed.
    """

    design: SortedDesign
    residual: Float[np.ndarray, "n kinds"]
    derivatives: Float[np.ndarray, "n kinds u"]

    @staticmethod
    def of(design: SortedDesign, residual: Float[np.ndarray, "n kinds"], constants: int) -> Block:
        """A block whose derivatives by the coefficients are still to be written; those by the tail are 0."""
        near = 3 * design.weights.shape[1]
        derivatives = np.empty((*residual.shape, near + CAMERA + constants))
        derivatives[:, :, near:] = 0.0
        return Block(design, residual, derivatives)

    @staticmethod
    def without_derivatives(design: SortedDesign, residual: Float[np.ndarray, "n kinds"]) -> Block:
        """Residuals of which only the cost is needed."""
        return Block(design, residual, np.empty((*residual.shape, 0)))

    def write(self, kind: int, *terms: tuple[Float[np.ndarray, "n k4"], Float[np.ndarray, "n 3"]]) -> None:
        """Write derivatives by the coefficients, as the sum of terms: each has the coefficients' weights in a point in
        space, or in its slope, and the derivatives by that."""
        near = self.design.weights.shape[1]
        for k in range(3):
            written = self.derivatives[:, kind, k * near : (k + 1) * near]
            for number, (weights, by_point) in enumerate(terms):
                if number:
                    written += weights * by_point[:, k : k + 1]
                else:
                    np.multiply(weights, by_point[:, k : k + 1], out=written)

    def weighed(self, weight: float) -> Block:
        """The residuals, with this weight on their squares."""
        root = float(np.sqrt(weight))
        return replace(self, residual=root * self.residual, derivatives=root * self.derivatives)

    @property
    def tail(self) -> Float[np.ndarray, "n kinds t"]:
        """Derivatives by the camera and the constants."""
        return self.derivatives[:, :, 3 * self.design.weights.shape[1] :]

    @property
    def cost(self) -> float:
        """Half the sum of squares."""
        return 0.5 * float(np.vdot(self.residual, self.residual))


class Sum:
    """Cost, normal matrix and gradient of all residuals.

    strain_weight: weight of the squares of strain among them.
    matrix: its upper triangle; the part below is incomplete. camera: index of the camera's first unknown.
    derivatives: whether the blocks have any; otherwise matrix and gradient are empty.
    """

    def __init__(self, blocks: Sequence[Block], strain_weight: float) -> None:
        self.strain_weight = strain_weight
        tail = blocks[0].tail.shape[2]
        self.cost, self.derivatives = sum(block.cost for block in blocks), tail > 0
        self.camera = 3 * blocks[0].design.width ** 2
        size = self.camera + tail if self.derivatives else 0
        self.matrix, self.right = np.zeros((size, size)), np.zeros(size)
        if self.derivatives:
            self._add(blocks)

    def _add(self, blocks: Sequence[Block]) -> None:
        """The products of all blocks, knot interval by knot interval: so there are few, and they are small."""
        first, n = self.camera, self.camera // 3
        surface, mixed = self.matrix[:first, :first].reshape(3, n, 3, n), self.matrix[:first, first:].reshape(3, n, -1)
        tail, right = self.matrix[first:, first:], self.right[:first].reshape(3, n)
        near = blocks[0].design.weights.shape[1]
        for parts in zip(*(block.design.parts() for block in blocks), strict=True):
            here, inside = parts[0][1], [points for points, _ in parts]
            own = [block.derivatives[points] for block, points in zip(blocks, inside, strict=True)]
            rows = np.concatenate([x.reshape(-1, x.shape[2]) for x in own])
            residual = np.concatenate([b.residual[points].ravel() for b, points in zip(blocks, inside, strict=True)])
            square, slope = rows.T @ rows, residual @ rows  # only half of a matrix's product with itself is computed
            surface[:, here, :, here] += square[: 3 * near, : 3 * near].reshape(3, near, 3, near)
            mixed[:, here] += square[: 3 * near, 3 * near :].reshape(3, near, -1)
            tail += square[3 * near :, 3 * near :]
            right[:, here] += slope[: 3 * near].reshape(3, near)
            self.right[first:] += slope[3 * near :]

    def add_prior(self, residual: float, slopes: Mapping[int, float]) -> None:
        """Add what is known beforehand of one unknown, or of several together.

        slopes: derivatives of the residual by these unknowns.
        """
        self.cost += 0.5 * residual * residual
        if self.derivatives:
            for k, slope in slopes.items():
                self.right[k] += slope * residual
                for other, by_other in slopes.items():
                    self.matrix[k, other] += slope * by_other

    def add_energy(self, energy: Float[np.ndarray, "n n"], control: Float[np.ndarray, "n 3"]) -> None:
        """Add a quadratic form of the coefficients' x, and of their y and z."""
        slope = energy @ control
        self.cost += 0.5 * float(np.vdot(control, slope))
        if self.derivatives:
            n = len(energy)
            for k in range(3):
                own = slice(k * n, (k + 1) * n)
                self.matrix[own, own] += energy
                self.right[own] += slope[:, k]


__all__ = ["Block", "Sum"]
