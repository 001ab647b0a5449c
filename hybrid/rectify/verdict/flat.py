"""Photos that are the flat film already: scans, or films flattened before, which have to come back unchanged.

The network's map is off by a percent of the film here as everywhere, and without a table around the sheet no edge shows
the error. Cells do: through the photo's own frame they are more alike than through any wrong map.
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
from hybrid.rectify.refine.refine import Refinement
from hybrid.rectify.verdict.trust import cells_alike
from hybrid.strips import SIDES

NEAR_FRAME = 0.05
"""Largest distance between the film as the network sees it and the photo's frame at which the film may fill the photo,
as a fraction of the frame's diagonal."""

NOTHING_ELSE = 0.7
"""A film that covers at least this share of the photo may fill it, wherever the network sees its ends: for films on a
background the share is 0.68 at most."""

BESIDE_FRAME, SURER = 0.005, 1.2
"""A sheet whose edges are seen farther from the frame than this fraction of its diagonal has a background around it,
unless cells are more alike in the unchanged photo by this factor: then these are no edges."""

EDGES_SEEN, LIKELY = 2, 0.8
"""A sheet's edges count as seen if all four are; or if at least this many are, all four lie inside the photo, and each
is at least this likely to lie where it was read: a scan's white border shows no edge along a white margin."""

AS_ALIKE, AS_ALIKE_UNMOVED = 0.95, 0.85
"""Cells count as equally alike in the unchanged photo if their likeness is at least this fraction of that through maps
refined from the network's map and from the photo's frame: between nearly equal maps rounding errors would decide. The
second value holds where the map refined from the frame stays there: of 23 flat films 20 do, of as many that are bent by
2 px none."""

TOLD_ON_FRAME = 0.01
"""Largest distance from the frame at which corners that a person gives mean the photo's own, as a fraction of its
diagonal."""

UNMOVED = 1e-4
"""Largest distance from the frame at which a map counts as staying there, as a fraction of its diagonal."""

NEWTON_STEPS = 8

LEAST_ALIKE, LEAST_ALIKE_UNSEEN = 0.1, 0.2
"""How alike cells must be at least, in general and in a photo in which the network sees no film, or not all of it."""


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
    """The photo's frame as the film's map if the photo is the flat film itself, else None; with the evidence. Its
    expected error is how far it moves when refined: hardly, or as far as cells leave its place open.

    coarse, refined: the network's map, and its refinement; None where it was not refined. filled: share of the photo
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
    """Whether the plane sheet given by a person's corners may be the whole photo of ``size`` (h, w)."""
    return _off(told, frame_of(size)) <= TOLD_ON_FRAME


def _has_edges_inside(refined: Refinement, frame: BackwardMap) -> bool:
    """Whether the edges of a sheet are seen off the frame."""
    if not refined.believed or _off(refined.backward, frame) <= BESIDE_FRAME:
        return False
    if refined.edges == len(SIDES):
        return True
    likely = refined.across is not None and float(refined.across.support.min()) >= LIKELY
    return likely and refined.edges >= EDGES_SEEN and _nearest_side(refined.backward, frame) > BESIDE_FRAME


def _nearest_side(backward: BackwardMap, frame: BackwardMap) -> float:
    """Least mean distance of a map's four sides inside a photo's frame, as a fraction of its diagonal."""
    off = _beside(backward, frame)
    return float(min(off[0, :, 1].mean(), -off[-1, :, 1].mean(), off[:, 0, 0].mean(), -off[:, -1, 0].mean()))


def _explained(pyramid: Pyramid, backward: BackwardMap, grid: SliceGrid, most: int) -> float:
    """How alike cells are, scaled down in proportion where there are not this many: few are easily alike by chance."""
    return cells_alike(pyramid, backward, grid) * grid.rows * grid.cols / most


def _in_frame(grid: SliceGrid, frame: BackwardMap, size: tuple[int, int]) -> Iterator[SliceGrid]:
    """A grid seen through another map, placed in a photo of ``size`` (h, w) that is the film: once where the photo
    shows it, once where that map has it on the film."""
    for vertices in (np.clip(grid.vertices_photo / np.array(size[::-1]), 0.0, 1.0), grid.vertices):
        yield replace(grid, vertices=vertices, vertices_photo=frame.photo_from_film(vertices))


def _on_film(grid: SliceGrid, backward: BackwardMap) -> SliceGrid:
    """A grid seen through another map, placed on the film of this one."""
    vertices = backward.film_near(grid.vertices_photo.reshape(-1, 2), grid.vertices.reshape(-1, 2), NEWTON_STEPS)
    return replace(grid, vertices=vertices.reshape(grid.vertices.shape))


def _off(backward: BackwardMap, frame: BackwardMap) -> float:
    """The largest distance of a map from a photo's frame, as a fraction of its diagonal."""
    return float(np.linalg.norm(_beside(backward, frame), axis=-1).max())


def _beside(backward: BackwardMap, frame: BackwardMap) -> Float[np.ndarray, "33 33 2"]:
    """Displacement of a map's lattice from a photo's frame, as a fraction of its diagonal."""
    return (backward.lattice((33, 33)) - frame.nodes) / np.linalg.norm(frame.nodes[-1, -1])


__all__ = ["already_flat", "frame_of", "is_frame"]
