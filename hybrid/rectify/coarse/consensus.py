"""What several maps of one film agree on, from one photo or from several: more exact than most of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes


def read_beside(backward: BackwardMap, shift: Float[np.ndarray, "gh gw 2"]) -> BackwardMap:
    """The map that reads each film point at an offset of ``shift`` (film units, on film nodes)."""
    return BackwardMap(backward.photo_from_film(film_nodes(shift.shape[:2]) + shift))


def to_common(
    shifts: Sequence[Float[np.ndarray, "gh gw 2"]], counts: Sequence[bool]
) -> list[Float[np.ndarray, "gh gw 2"]]:
    """Where the points on which the photos agree lie on the film of each, as shifts.

    shifts: where points of the first film lie on each film. counts: whose maps take part; at least one. The maps of
    several photos err independently, so the median of the places that they give for a point of the print errs less than
    each of them. It is the geometric median of the fields: of three photos one may be far off.
    """
    middle = _geometric_median(np.stack([shift for shift, asked in zip(shifts, counts, strict=True) if asked]))
    nodes = film_nodes(middle.shape[:2])
    back = -middle
    for _ in range(3):  # the first film's point whose median place is a node; the fields are smooth and small
        back = -_between(middle, nodes + back)
    return [back + _between(shift, nodes + back) for shift in shifts]


def _geometric_median(fields: Float[np.ndarray, "n gh gw 2"]) -> Float[np.ndarray, "gh gw 2"]:
    """The field with the least sum of root-mean-square distances to all fields (Weiszfeld 1937); of two, their mean."""
    middle = fields.mean(axis=0)
    if len(fields) == 2:
        return middle
    for _ in range(30):
        distance = np.sqrt(np.square(fields - middle).mean(axis=(1, 2, 3)))
        weight = 1.0 / np.maximum(distance, max(1e-3 * float(distance.max()), 1e-12))
        middle = np.tensordot(weight / weight.sum(), fields, axes=1)
    return middle


def _between(field: Float[np.ndarray, "gh gw 2"], uv: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
    """A smooth field on film nodes, interpolated at film points."""
    return BackwardMap(field).photo_from_film(uv)


__all__ = ["read_beside", "to_common"]
