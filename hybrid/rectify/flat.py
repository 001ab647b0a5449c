"""A photo that is the flat film already: a scan, or what was flattened before. It has to come back as it is.

The network's map is off by a percent of the film there, as everywhere, and without a table around the sheet no edge
tells. Cells do: through the photo's own frame they are alike as they never are through a map that is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.pyramid import Pyramid
from hybrid.rectify.refine import Refinement
from hybrid.rectify.trust import cells_alike
from hybrid.strips import SIDES

NEAR_FRAME = 0.05
"""Largest distance between the film as the network sees it and the photo's frame, in parts of the frame's diagonal."""

BESIDE_FRAME = 0.005
"""A sheet all of whose edges are seen, and further off the frame than this in parts of its diagonal, has something
around it."""

AS_ALIKE = 0.95
"""Cells are as alike in the photo as it is where they are so by this part of how alike they are through maps refined
from the network's and from the photo's frame: of a map that is hardly another one the last bits decide."""


def frame_of(size: tuple[int, int]) -> BackwardMap:
    """The map of a film that fills a photo of ``size`` (h, w)."""
    return BackwardMap(film_nodes((33, 33)) * np.array(size[::-1], dtype=np.float64))


def already_flat(
    pyramid: Pyramid, coarse: BackwardMap, refined: Refinement, exactly: Callable[[BackwardMap], Refinement]
) -> tuple[Refinement | None, str]:
    """The photo's frame as the film's map if the photo is the flat film itself, else None; with the evidence.

    coarse, refined: the network's map, and what became of it. exactly: refines a map into the photo.
    """
    size = pyramid.size
    frame = frame_of(size)
    if _off(coarse, frame) > NEAR_FRAME:
        return None, "the film does not fill the photo"
    if refined.believed and refined.edges == len(SIDES) and _off(refined.backward, frame) > BESIDE_FRAME:
        return None, "the sheet's edges are seen inside the photo"
    framed = exactly(frame)
    if framed.grid is None:
        return None, "no grid tells whether the photo is the flat film itself"
    grids = [grid for grid in (framed.grid, refined.grid) if grid is not None]
    straight, *refined_ones = (
        max(cells_alike(pyramid, m, grid) for grid in grids) for m in (frame, framed.backward, refined.backward)
    )
    reason = f"cells are alike to {straight:.0%} as the photo is, to {max(refined_ones):.0%} through a refined map"
    if straight <= 0 or straight < AS_ALIKE * max(refined_ones):
        return None, reason
    vertices = np.clip(framed.grid.vertices_photo / np.array(size[::-1]), 0.0, 1.0)  # it was seen through another map
    grid = replace(framed.grid, vertices=vertices, vertices_photo=frame.photo_from_film(vertices))
    return replace(framed, backward=frame, grid=grid, expected_px=None, aspect=None), reason


def _off(backward: BackwardMap, frame: BackwardMap) -> float:
    """The largest distance of a map from a photo's frame, in parts of its diagonal."""
    off = backward.lattice((33, 33)) - frame.nodes
    return float(np.linalg.norm(off, axis=-1).max() / np.linalg.norm(frame.nodes[-1, -1]))


__all__ = ["already_flat", "frame_of"]
