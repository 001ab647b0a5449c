"""From the exact map to the film: the photo is read once, the film turned upright, and its light taken out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from hybrid.backward import BackwardMap, Orientation
from hybrid.grid_edit import GridEdit
from hybrid.learn.reading.orientation import orientation_chances, upright_way
from hybrid.pipeline.job import Job
from hybrid.records import CoarseMaps, RectifyResult, SliceGrid, Status, StatusCode
from hybrid.rectify.film.cover import covered_parts
from hybrid.rectify.film.deilluminate import Deillumination, deilluminate
from hybrid.rectify.film.resample import Rectified, read_film
from hybrid.rectify.film.size import bounded_size, film_size
from hybrid.rectify.refine.refine import Refinement
from hybrid.rectify.sheet.shape import SheetConfig
from hybrid.stages import Clock, Report


def finished(
    job: Job, maps: CoarseMaps, refinement: Refinement, lens: SheetConfig | None, clock: Clock
) -> RectifyResult:
    """Read the photo once through the map, turn the film upright, then take the light out.

    maps: what the network sees. lens: what is known of the camera's; None if the photo is the flat film itself: the
    film then keeps its size, and nothing is stretched. The result's status is ``OK``: whether the map is right is not
    judged here.
    """
    config = job.config
    backward: BackwardMap = refinement.backward
    grid: SliceGrid | None = refinement.grid
    with clock.stage("resample") as report:
        if lens is None:
            down, across = backward.mean_film_pixels()
            size = bounded_size(backward, down / across, config.size)
        else:
            aspect, sigma = refinement.aspect, refinement.aspect_sigma
            size = film_size(backward, job.pyramid.size, grid, config.size, aspect, lens, sigma)
        flat = read_film(job.pyramid, backward, size, config.resample)
        report.reason = f"to {flat}"
    with clock.stage("upright") as report:
        way, probability = _read(flat, grid, job, report)
        if way.index:
            flat, backward, grid = flat.turned(way), backward.turned(way), grid and grid.turned(way)
    with clock.stage("cover") as report:
        covered = covered_parts(maps, backward, flat.valid, config.cover)
        report.ran = bool(covered.any())
        seen_before = f"something lies in front of {covered.mean():.1%} of the film"
        report.reason = seen_before if report.ran else "nothing is seen in front of the film"
    light = _without_light(flat, covered, job, clock)
    return RectifyResult(
        status=Status(StatusCode.OK),
        stages=clock.reports,
        film=light.film,
        rectified=flat.image,
        backward=backward,
        grid=grid,
        orientation=way,
        upright_probability=probability,
        glare=light.glare,
        covered=covered,
        confidence=light.confidence,
    )


def made_anew(job: Job, edit: GridEdit, clock: Clock) -> RectifyResult:
    """The film through the map and grid that a person edited, at the same size and way up. It is ``UNSURE``, as the
    evidence for the map is not known."""
    before = edit.result
    assert before.film is not None  # or there would be nothing to edit
    assert before.covered is not None
    with clock.stage("resample") as report:
        flat = read_film(job.pyramid, edit.backward, (before.film.shape[0], before.film.shape[1]), job.config.resample)
        report.reason = f"to {flat}; corners moved by hand: {len(edit.done)}"
    light = _without_light(flat, before.covered, job, clock)
    return replace(
        before,
        status=Status(StatusCode.UNSURE, ("edited by hand",)),
        stages=clock.reports,
        film=light.film,
        rectified=flat.image,
        backward=edit.backward,
        grid=edit.grid,
        glare=light.glare,
        confidence=light.confidence,
        expected_error_px=None,
        limit_px=None,
        signs=None,
        photo=0,
        photos=1,
        left_out=(),
    )


def _without_light(flat: Rectified, covered: Bool[np.ndarray, "h w"], job: Job, clock: Clock) -> Deillumination:
    """The flat film without its light."""
    with clock.stage("light") as report:
        light = deilluminate(flat.image, flat.valid, job.readers.levels, job.config.light, covered)
        report.ran, report.reason = light.ran, light.reason
    return light


def _read(flat: Rectified, grid: SliceGrid | None, job: Job, report: Report) -> tuple[Orientation, float | None]:
    """How the flat film must be moved to read right, by what it shows, and the probability that it then does."""
    upright = job.config.upright
    if upright.given is not None:
        report.reason = f"turned by {upright.turn} degrees{' after mirroring' * upright.mirror}, as requested"
        return upright.given, None
    vertices = None if grid is None else grid.vertices
    chances, read = orientation_chances(job.readers.orientation, flat.image, vertices, upright)
    if chances is None:
        report.ran, report.reason = False, "left as it lies: the film is too small to be read"
        return Orientation(0, False), None
    way, said = upright_way(chances, upright)
    report.reason = f"{said} ({read})"
    return way, float(chances[way.index])


__all__ = ["finished", "made_anew"]
