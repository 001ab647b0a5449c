"""The borders between the cells of a grid, and strips of the photo across them: what BorderNet reads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.pyramid import Photo
from hybrid.strips import SIDES, Side, StripConfig, strips_across

GROUP = len(SIDES)
"""Borders that are read together, all across one axis: as many as the sheet's edges, as it is one network."""
REACH = 0.4
"""Parts of a cell to which a strip reaches on both sides of a border, but no farther than strips across edges do."""
INSIDE = 0.02
"""Borders nearer to the sheet's edges than this, in film units, are none of the cells' alone."""


def inner_lines(first: float, pitch: float, cells: int) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Film coordinates of the lines of a grid whose first cell begins at ``first``, but for those along the sheet's
    edges, and the number of each, counted from the grid's middle."""
    index = np.arange(cells + 1)
    lines = first + pitch * index
    inner = (lines > INSIDE) & (lines < 1.0 - INSIDE)
    return lines[inner], (index - 0.5 * cells)[inner]


def strip_across(pitch: float, config: StripConfig) -> StripConfig:
    """How strips across the borders of cells are cut that lie at a pitch: they end before the next border."""
    return replace(config, reach=min(config.reach, REACH * pitch))


def border_side(axis: int, line: float) -> Side:
    """A line of one coordinate as strips are cut across it: the first row lies at the least coordinate."""
    return Side("border", axis, line, 1.0)


def border_strips(
    photo: Photo, film: BackwardMap, axis: int, lines: Float[np.ndarray, " k"], strip: StripConfig
) -> tuple[UInt8[np.ndarray, "k r c 3"], Bool[np.ndarray, "k r c"]]:
    """Strips across lines of one coordinate, and where the photo covers them. strip: as ``strip_across`` has it."""
    return strips_across(photo, [(border_side(axis, line), film) for line in lines.tolist()], strip)


__all__ = ["GROUP", "border_side", "border_strips", "inner_lines", "strip_across"]
