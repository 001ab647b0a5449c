"""A coarse backward map made exact to a fraction of a pixel by what the photo shows of the sheet and its print.

Two maps are started from. One is that of a sheet that does not stretch, bent until its edges lie where they are seen
in the photo (sheet.py); the other is the network's, corrected along the edges. From each, what is printed on the film
is looked for and fitted (course.py). The sheet is tried first, and the network's map only where what is printed does
not bear the sheet out; then that through which the cells look more alike counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.records import SliceGrid, StageReport
from hybrid.rectify.course import (
    Clock,
    Course,
    Progress,
    RefineConfig,
    Scene,
    agreement,
    begin,
    contradiction,
    ended,
    followed,
    working_scene,
)
from hybrid.rectify.outline import find_outline
from hybrid.rectify.sheet import fit_sheet
from hybrid.rectify.sightings import Sightings

ALL = 99
"""More rounds than there are."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """A refined map, the slice grid if one was found, and what was done.

    expected_px: expected mean end-point error that is left, in pixels of the photo; None where the coarse map was kept.
    """

    backward: BackwardMap
    grid: SliceGrid | None
    stages: tuple[StageReport, ...]
    expected_px: float | None = None


def refine(photo: UInt8[np.ndarray, "H W 3"], coarse: BackwardMap, config: RefineConfig) -> Refinement:
    """The coarse map, corrected where the photo shows how.

    photo: RGB, the one that ``coarse`` maps into. Returns the coarse map itself where nothing was seen, where
    the correction does not explain the photo better, or where it would fold the film or move it too far; the
    report of stage ``spline`` says which. Raises nothing on any photo.
    """
    clock = Clock()
    scene = working_scene(photo, coarse, config)
    outline = find_outline(scene.photo, scene.coarse, config.outline)
    clock.lap("outline")
    begun = _begun(scene, outline, config, clock)
    progress = followed(begun, ALL, config, clock) if begun is not None else None
    if progress is None:
        return _unchanged(coarse, "no edge, rule, gutter or repeated text was seen", clock)
    course = ended(progress, config, clock)
    is_bent = course.scene is not scene
    scale = (photo.shape[1] / scene.photo.shape[1], photo.shape[0] / scene.photo.shape[0])
    changed = course.believed and (is_bent or course.moves)
    backward = coarse
    if changed:
        start = course.scene.coarse.cropped((0.0, 0.0), scale) if is_bent else coarse
        rows, columns = (max(33, n) for n in coarse.nodes.shape[:2])
        backward = course.displacement.composed(start, (rows, columns))
    stages = (
        StageReport("outline", course.edges > 0, f"{course.edges} of 4 edges", clock["outline"]),
        StageReport("grid", course.layout.any_found, course.layout.reason(), clock["grid"]),
        StageReport("spline", changed, course.verdict, clock["spline"]),
    )
    expected = _expected_px(coarse, backward, course) if changed else None
    return Refinement(backward, course.layout.slice_grid(backward), stages, expected)


def _begun(scene: Scene, outline: Sequence[Sightings], config: RefineConfig, clock: Clock) -> Progress | None:
    """The first rounds from the map that what is printed bears out: the sheet's if there is one, or the scene's."""
    bent = _from_sheet(scene, outline, config, clock)
    near = bent is None or _distance(bent.scene.coarse, scene.coarse) < config.near_sheet
    if bent is not None and near and contradiction(bent, config) < config.borne_out:
        return bent
    flat = followed(begin(scene, outline, config), config.trial_rounds, config, clock)
    if bent is None or flat is None:
        return flat or bent
    alike = [max(agreement(one, layout) for layout in (flat.layout, bent.layout)) for one in (flat, bent)]
    clock.lap("spline")
    return bent if alike[1] >= config.as_alike[0 if near else 1] * alike[0] else flat


def _distance(one: BackwardMap, other: BackwardMap) -> float:
    """Mean distance between two maps, in parts of the film's longer side."""
    points = film_nodes((9, 9))
    apart = np.linalg.norm(one.photo_from_film(points) - other.photo_from_film(points), axis=-1).mean()
    return float(apart / max(other.mean_film_pixels()))


def _from_sheet(scene: Scene, outline: Sequence[Sightings], config: RefineConfig, clock: Clock) -> Progress | None:
    """The first rounds from the map of an unstretched sheet; None where too few edges are seen, or none fits them."""
    if len(outline) < config.sheet.least_edges:
        return None
    found = fit_sheet(scene.coarse, (scene.photo.shape[0], scene.photo.shape[1]), outline, config.sheet)
    if found is None or found.cost > config.sheet.most_cost or found.backward.folds((33, 33)):
        clock.lap("outline")
        return None
    bent = replace(scene, coarse=found.backward)
    outline = find_outline(scene.photo, bent.coarse, replace(config.outline, band=config.near_band))
    clock.lap("outline")
    return followed(begin(bent, outline, config), config.trial_rounds, config, clock)


def _expected_px(coarse: BackwardMap, refined: BackwardMap, course: Course) -> float:
    """The mean error that is left after the film was moved so far, by what was seen on it."""
    moved = float(np.linalg.norm(refined.nodes - coarse.resized(refined.nodes.shape[:2]).nodes, axis=-1).mean())
    lines = sum(comb is not None for comb in course.layout.combs)
    left = 0.15 if lines == 2 else 0.3 if lines or course.layout.settled else 0.8
    return 0.4 + left * moved


def _unchanged(coarse: BackwardMap, reason: str, clock: Clock) -> Refinement:
    stages = tuple(StageReport(name, False, reason, clock[name]) for name in ("outline", "grid", "spline"))
    return Refinement(coarse, None, stages)


__all__ = ["RefineConfig", "Refinement", "refine"]
