"""The film's outermost pixels in a view of it: what lies beyond the sheet shines into them.

The photo's blur mixes film and background there. Where a text lies near the sheet's edge, cells at that edge then look
shifted against those inside, which have no background beside them, by up to a third of a pixel: texts are located more
exactly than that. The next pixels inside replace the outermost ones, unless rules are printed between the cells; half
a rule then lies along the sheet's edge, and tells more than the background spoils.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hybrid.film_view import FilmView
from hybrid.rectify.grid.layout import Layout
from hybrid.rectify.grid.lines import Comb
from hybrid.rectify.grid.repeat import Repeats

NEAR = np.arange(-2, 2)
"""Pixels around where cells meet, in which a rule is looked for."""
AFTER = np.arange(3, 6)
BEFORE = -1 - AFTER
"""Pixels beside these, on either side."""


@dataclass(frozen=True)
class RimConfig:
    """Options of the correction of the rim."""

    width_px: int = 2
    """Width of the rim that is replaced, in pixels of the view; 0: nothing is."""
    rule: float = 2.0
    """Grey levels (of 255) by which a rule between the cells is brighter than the film beside it."""


def without_background(view: FilmView, layout: Layout, config: RimConfig) -> FilmView:
    """The view, which covers the film from edge to edge, with its rim replaced by the film inside it.

    Left as it is along an axis on which rules are printed or no cells are known.
    """
    image = None
    for repeats, comb in zip(layout.repeats, layout.combs, strict=True):
        if config.width_px == 0 or repeats is None or _is_ruled(view.image[..., 0], repeats, comb, config):
            continue
        image = view.image.copy() if image is None else image
        along = image.swapaxes(0, 1) if repeats.axis == 0 else image
        along[: config.width_px] = along[config.width_px]
        along[-config.width_px :] = along[-config.width_px - 1]
    return view if image is None else replace(view, image=image)


def _is_ruled(grey: Float[np.ndarray, "h w"], repeats: Repeats, comb: Comb | None, config: RimConfig) -> bool:
    """Whether bright rules are known to lie between the cells, or the film is mostly brighter there than beside."""
    if comb is not None and comb.sign > 0:
        return True
    along = grey.T if repeats.axis == 0 else grey
    meet = _between(repeats, len(along))
    if not len(meet):
        return False
    near = along[meet[:, None] + NEAR].max(axis=1)
    beside = np.maximum(*(along[meet[:, None] + side].mean(axis=1) for side in (AFTER, BEFORE)))
    return float(np.median(near - beside)) > config.rule


def _between(repeats: Repeats, n: int) -> np.ndarray:
    """The first pixel after each place where two cells meet, in a view of n pixels; none too near its ends."""
    edges = np.round((repeats.first + repeats.pitch * np.arange(1, repeats.cells)) * n).astype(int)
    return edges[(edges >= -BEFORE[-1]) & (edges < n - AFTER[-1])]


__all__ = ["RimConfig", "without_background"]
