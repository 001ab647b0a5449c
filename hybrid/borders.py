"""The borders between the cells of a grid, and strips of the photo across them: what BorderNet reads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.pyramid import Photo
from hybrid.strips import SIDES, Side, StripConfig, strips_across

GROUP = len(SIDES)
"""Borders read together, all across one axis: as many as the sheet's edges, as both networks are of one kind."""
REACH = 0.4
"""How far a strip reaches on both sides of a border, in parts of a cell, but no farther than strips across edges do."""
INSIDE = 0.02
"""Borders closer to the sheet's edges than this, in film units, are left out, as they do not belong to cells alone."""


def inner_lines(first: float, pitch: float, cells: int) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Film coordinates of the lines of a grid whose first cell begins at ``first``, without those along the sheet's
    edges, and the number of each, counted from the grid's middle."""
    index = np.arange(cells + 1)
    lines = first + pitch * index
    inner = (lines > INSIDE) & (lines < 1.0 - INSIDE)
    return lines[inner], (index - 0.5 * cells)[inner]


def strip_across(pitch: float, config: StripConfig) -> StripConfig:
    """How to cut strips across the borders of cells with a pitch: they end before the next border."""
    return replace(config, reach=min(config.reach, REACH * pitch))


def border_side(axis: int, line: float) -> Side:
    """A line of one coordinate, as a side for strips across it: the first row lies at the least coordinate."""
    return Side("border", axis, line, 1.0)


def border_strips(
    photo: Photo, film: BackwardMap, axis: int, lines: Float[np.ndarray, " k"], strip: StripConfig
) -> tuple[UInt8[np.ndarray, "k r c 3"], Bool[np.ndarray, "k r c"]]:
    """Strips across lines of one coordinate, and where the photo covers them. strip: from ``strip_across``."""
    return strips_across(photo, [(border_side(axis, line), film) for line in lines.tolist()], strip)


__all__ = ["GROUP", "border_side", "border_strips", "inner_lines", "strip_across"]
