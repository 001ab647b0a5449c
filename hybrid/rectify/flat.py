"""A photo that is the flat film already: a scan, or what was flattened before. It has to come back as it is.

The network's map is off by a percent of the film there, as everywhere, and without a table around the sheet no edge
tells. Cells do: through the photo's own frame they are alike as they never are through a map that is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.pyramid import Pyramid
from hybrid.records import SliceGrid
from hybrid.rectify.refine import Refinement
from hybrid.rectify.trust import cells_alike
from hybrid.strips import SIDES

NEAR_FRAME = 0.05
"""Distance between the film as the network sees it and the photo's frame, in parts of the frame's diagonal, up to which
it may fill the photo."""

NOTHING_ELSE = 0.7
"""Share of a photo that shows film from which on it may fill the photo, wherever the network sees its ends: of films on
something it is 0.68 at most."""

BESIDE_FRAME, SURER = 0.005, 1.2
"""A sheet whose edges are seen, and further off the frame than this in parts of its diagonal, has something around it;
unless cells are more alike in the photo as it is by this factor: then these are no edges."""

EDGES_SEEN, LIKELY = 2, 0.8
"""A sheet's edges are seen if all four are; or so many, and all lie inside the photo and are as likely as this to lie
where they were read: of a scan's white border along a white margin no edge shows."""

AS_ALIKE, AS_ALIKE_UNMOVED = 0.95, 0.85
"""Cells are as alike in the photo as it is where they are so by this part of how alike they are through maps refined
from the network's and from the photo's frame: of a map that is hardly another one the last bits decide. The second,
where what is refined from the frame stays there: of 23 flat films 20 do, of as many that are bent by 2 px none."""

TOLD_ON_FRAME = 0.01
"""Up to which distance from the frame, in parts of its diagonal, corners that a person gives mean the photo's own."""

UNMOVED = 1e-4
"""Up to which distance from the frame, in parts of its diagonal, a map stays there."""

NEWTON_STEPS = 8

LEAST_ALIKE, LEAST_ALIKE_UNSEEN = 0.1, 0.2
"""How alike cells must be in any case, and in a photo in which the network sees no film, or not all of it."""


def frame_of(size: tuple[int, int]) -> BackwardMap:
    """The map of a film that fills a photo of ``size`` (h, w)."""
    return BackwardMap(film_nodes((33, 33)) * np.array(size[::-1], dtype=np.float64))


def already_flat(
    pyramid: Pyramid,
    coarse: BackwardMap | None,
    filled: float,
    refined: Refinement | None,
    exactly: Callable[[BackwardMap], Refinement],
) -> tuple[Refinement | None, str]:
    """The photo's frame as the film's map if the photo is the flat film itself, else None; with the evidence. The error
    that it expects is how far it moves where it is refined: hardly, or by as much as cells leave open.

    coarse, refined: the network's map, and what became of it; None where it was not refined. filled: share of the photo
    that shows film. exactly: refines a map into the photo.
    """
    frame = frame_of(pyramid.size)
    if filled < NOTHING_ELSE and (coarse is None or _off(coarse, frame) > NEAR_FRAME):
        return None, "the film does not fill the photo"
    edges_inside = refined is not None and _has_edges_inside(refined, frame)
    if edges_inside and filled < NOTHING_ELSE:
        return None, "the sheet's edges are seen inside the photo"
    framed = exactly(frame)
    if framed.grid is None:
        return None, "no grid tells whether the photo is the flat film itself"
    seen = [(one.backward, one.grid) for one in (framed, refined) if one is not None and one.grid is not None]
    grids = [on_frame for _, grid in seen for on_frame in _in_frame(grid, frame, pyramid.size)]
    most = max(grid.rows * grid.cols for grid in grids)
    straight, grid = max(((_explained(pyramid, frame, grid, most), grid) for grid in grids), key=lambda one: one[0])
    bent = [
        max(_explained(pyramid, backward, _on_film(grid, backward), most) for _, grid in seen) for backward, _ in seen
    ]
    reason = f"cells are alike to {straight:.0%} as the photo is, to {max(bent):.0%} through a refined map"
    least = max(bent) * (AS_ALIKE_UNMOVED if _off(framed.backward, frame) <= UNMOVED else AS_ALIKE)
    if straight < max(least, LEAST_ALIKE_UNSEEN if refined is None else LEAST_ALIKE):
        return None, reason
    if edges_inside and straight < SURER * bent[-1]:
        return None, f"the sheet's edges are seen inside the photo; {reason}"
    moved = float(np.linalg.norm(framed.backward.lattice((33, 33)) - frame.nodes, axis=-1).mean())
    return replace(framed, backward=frame, grid=grid, expected_px=moved, aspect=None), reason


def is_frame(told: BackwardMap, size: tuple[int, int]) -> bool:
    """Whether the plane sheet with corners that a person gave may be the whole photo of ``size`` (h, w)."""
    return _off(told, frame_of(size)) <= TOLD_ON_FRAME


def _has_edges_inside(refined: Refinement, frame: BackwardMap) -> bool:
    """Whether the edges of a sheet are seen, and not on the frame."""
    if not refined.believed or _off(refined.backward, frame) <= BESIDE_FRAME:
        return False
    if refined.edges == len(SIDES):
        return True
    likely = refined.across is not None and float(refined.across.support.min()) >= LIKELY
    return likely and refined.edges >= EDGES_SEEN and _nearest_side(refined.backward, frame) > BESIDE_FRAME


def _nearest_side(backward: BackwardMap, frame: BackwardMap) -> float:
    """How far inside a photo's frame a map's four sides lie at least, each at its mean, in parts of its diagonal."""
    off = _beside(backward, frame)
    return float(min(off[0, :, 1].mean(), -off[-1, :, 1].mean(), off[:, 0, 0].mean(), -off[:, -1, 0].mean()))


def _explained(pyramid: Pyramid, backward: BackwardMap, grid: SliceGrid, most: int) -> float:
    """How alike cells are, in proportion to their number, of at most so many: of few cells more is easily alike."""
    return cells_alike(pyramid, backward, grid) * grid.rows * grid.cols / most


def _in_frame(grid: SliceGrid, frame: BackwardMap, size: tuple[int, int]) -> Iterator[SliceGrid]:
    """A grid that was seen through another map as it lies in a photo of ``size`` (h, w) that is the film: where the
    photo shows it, and where that map has it on the film."""
    for vertices in (np.clip(grid.vertices_photo / np.array(size[::-1]), 0.0, 1.0), grid.vertices):
        yield replace(grid, vertices=vertices, vertices_photo=frame.photo_from_film(vertices))


def _on_film(grid: SliceGrid, backward: BackwardMap) -> SliceGrid:
    """A grid that was seen through another map as it lies on the film of this one."""
    vertices = backward.film_near(grid.vertices_photo.reshape(-1, 2), grid.vertices.reshape(-1, 2), NEWTON_STEPS)
    return replace(grid, vertices=vertices.reshape(grid.vertices.shape))


def _off(backward: BackwardMap, frame: BackwardMap) -> float:
    """The largest distance of a map from a photo's frame, in parts of its diagonal."""
    return float(np.linalg.norm(_beside(backward, frame), axis=-1).max())


def _beside(backward: BackwardMap, frame: BackwardMap) -> Float[np.ndarray, "33 33 2"]:
    """How far a map's lattice lies beside a photo's frame, in parts of its diagonal."""
    return (backward.lattice((33, 33)) - frame.nodes) / np.linalg.norm(frame.nodes[-1, -1])


__all__ = ["already_flat", "frame_of", "is_frame"]
