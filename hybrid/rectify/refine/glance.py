"""The grid of slices of a flat film, as one look through its map shows it: the map is left unchanged."""

from __future__ import annotations

from time import perf_counter

import cv2
import numpy as np
from jaxtyping import UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d
from hybrid.film_view import view_film
from hybrid.records import StageReport
from hybrid.rectify.grid.borders import places_along
from hybrid.rectify.grid.layout import Layout, find_lines, find_repeating
from hybrid.rectify.grid.phases import CellPhases
from hybrid.rectify.refine.config import RefineConfig
from hybrid.rectify.refine.course import read_view, told_borders
from hybrid.rectify.refine.refine import Refinement

VIEW_PX = 500
"""Longer side of the film in this look: half of that in refinement, enough to count slices."""

FLAT = "the film is flat"
"""Why the film needs no spline, for the reports."""


def glance(
    photo: UInt8[np.ndarray, "H W 3"],
    backward: BackwardMap,
    phases: CellPhases | None,
    expected: float,
    config: RefineConfig,
) -> Refinement:
    """The map unchanged, with the grid that shows through it.

    phases: what the network predicts of the cells. expected: error of the map, as a fraction of the film's size.
    """
    start = perf_counter()
    down, across = backward.mean_film_pixels()
    scale = VIEW_PX / max(down, across)
    size = (max(64, round(down * scale)), max(64, round(across * scale)))
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)
    view = view_film(grey, backward, film_centres_1d(size[1]), film_centres_1d(size[0]))
    told = phases and phases.inside(backward).axes()
    reading = read_view(view, Layout(), told, down / across, config)
    known = find_repeating(view, Layout(read=reading), config.repeat)
    borders = places_along(told_borders(photo, backward, known, phases, config))
    layout, _ = find_lines(view, known, True, borders, config.grid)
    grid = layout.slice_grid(reading, backward, expected)
    seconds = perf_counter() - start
    stages = (
        StageReport("outline", False, FLAT, 0.0),
        StageReport("grid", grid is not None, layout.reason(reading), seconds),
        StageReport("spline", False, FLAT, 0.0),
    )
    return Refinement(backward, grid, stages)


__all__ = ["glance"]
