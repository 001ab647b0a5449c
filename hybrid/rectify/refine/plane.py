"""Flat films: where all four edges of the sheet are straight, their lines determine the whole map, a homography."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.errors import require_at_most
from hybrid.records import StageReport
from hybrid.rectify.coarse.homography import apply_homography, fit_homography, survey_plane
from hybrid.rectify.edges.outline import find_outline
from hybrid.rectify.grid.phases import CellPhases
from hybrid.rectify.refine.config import RefineConfig
from hybrid.rectify.refine.glance import glance
from hybrid.rectify.refine.refine import Refinement
from hybrid.rectify.splines.sightings import Sightings, carried
from hybrid.rectify.splines.tps import mad_sigma, tukey_weights
from hybrid.strips import SIDES

PARTS = 8
"""Parts of an edge, each of which must lie on its line: an arc, a wave or a curled corner shows in some of them."""

EXPECTED_ERROR = 5e-4
"""Median error of the map of a flat film, in parts of its size; 0.1 to 1 on flat films of the generator."""


@dataclass(frozen=True)
class PlaneConfig:
    """When a film is taken to be flat. Lengths are in parts of the film's size."""

    max_off: float = 0.015
    """Largest distance of the network's map from that of the nearest plane: beyond it, edges are not examined."""
    max_bend: float = 0.001
    """Largest distance of a part of an edge from the edge's line."""
    max_shift: float = 0.03
    """Largest distance between a corner as the edges give it and as the network's map does."""
    min_parts: int = 6
    """How many of the eight parts of each edge must be seen."""

    def __post_init__(self) -> None:
        require_at_most(self, PARTS, "min_parts")


@dataclass(frozen=True, eq=False)
class EdgeLine:
    """An edge as a line, ``across = at + slope * along`` in film coordinates.

    bend: largest distance of a part of the edge from the line. parts: how many of the PARTS are seen.
    """

    at: float
    slope: float
    bend: float
    parts: int


def flat_film(
    photo: UInt8[np.ndarray, "H W 3"],
    coarse: BackwardMap,
    phases: CellPhases | None,
    edges: Sequence[Sightings],
    refine: RefineConfig,
    config: PlaneConfig,
) -> Refinement:
    """The map of a flat film from the lines of its edges, with the grid that shows through it.

    coarse: the network's map. phases: what the network says about the cells. edges: as read (edges/paths.py) through
    ``coarse``. Where the film is not surely flat, returns that map without expected_px.
    """
    start = perf_counter()
    decision, plane = survey_plane(coarse, config.max_off)
    found, evidence, lines = None, decision.reason, []
    if decision.yes:  # edges that are straight look straight through the map of the nearest plane sheet
        read = carried(edges, coarse, plane)
        lines = [edge_line(edge) for edge in find_outline(photo, plane, refine.outline, read)]
        found, evidence = plane_by_edges(lines, plane, config)
    report = StageReport("plane", decision.yes, evidence, perf_counter() - start)
    if found is None:
        return Refinement(coarse, None, (report,))
    flat = glance(photo, found, phases, EXPECTED_ERROR, refine)
    left = EXPECTED_ERROR * max(found.mean_film_pixels())
    return replace(flat, stages=(report, *flat.stages), expected_px=left, edges=len(lines))


def plane_by_edges(
    lines: Sequence[EdgeLine], plane: BackwardMap, config: PlaneConfig
) -> tuple[BackwardMap | None, str]:
    """The homography from the edges' lines as seen through ``plane``, or None if not surely flat; and the evidence."""
    if len(lines) < len(SIDES):
        return None, f"{len(lines)} of 4 edges seen"
    bend, parts = max(line.bend for line in lines), min(line.parts for line in lines)
    evidence = f"edges straight to {bend:.2%} of the film"
    if bend > config.max_bend or parts < config.min_parts:
        return None, f"{evidence}, each in {parts} of {PARTS} parts: not surely flat"
    corners, true = film_corners(lines), film_nodes((2, 2)).reshape(-1, 2)
    shift = float(np.abs(corners - true).max())
    if shift > config.max_shift:
        return None, f"{evidence}, but {shift:.1%} beside the film that the network saw"
    at = fit_homography(true, corners, np.ones(len(true)))  # where the plane shows a film point

    def shown(uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        return plane.photo_from_film(apply_homography(at, uv))

    size = (plane.nodes.shape[0], plane.nodes.shape[1])
    return BackwardMap.from_function(shown, size), f"flat: {evidence}"


def edge_line(side: Sightings) -> EdgeLine:
    """The line along an edge, by robust least squares, and how far the edge departs from it."""
    along, across = side.seen[:, 1 - side.axis], side.seen[:, side.axis]
    rows = np.stack([np.ones_like(along), along], axis=1)
    weight = np.ones(len(along))
    for _ in range(5):
        fit = np.linalg.lstsq(rows * weight[:, None], across * weight, rcond=None)[0]
        residual = across - rows @ fit
        scale = max(mad_sigma(residual), 1e-6)
        weight = np.sqrt(tukey_weights(residual / scale))
    part = np.clip((along * PARTS).astype(int), 0, PARTS - 1)
    middles = [abs(float(np.median(residual[part == k]))) for k in range(PARTS) if np.count_nonzero(part == k) >= 3]
    return EdgeLine(float(fit[0]), float(fit[1]), max(middles, default=np.inf), len(middles))


def film_corners(lines: Sequence[EdgeLine]) -> Float[np.ndarray, "4 2"]:
    """Where the lines of the edges (top, bottom, left, right) meet, in the order of ``film_nodes((2, 2))``."""
    top, bottom, left, right = lines
    corners = []
    for across in (top, bottom):
        for down in (left, right):
            # u = down.at + down.slope * v and v = across.at + across.slope * u
            u = (down.at + down.slope * across.at) / (1.0 - down.slope * across.slope)
            corners.append([u, across.at + across.slope * u])
    return np.array(corners)
