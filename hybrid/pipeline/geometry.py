"""From the network's map to the exact one and the grid: edges, the plane, refinement, or the photo as the flat film
itself; each only as far as the film needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from hybrid.backward import BackwardMap, mean_move
from hybrid.pipeline.job import Job
from hybrid.pipeline.looks import LastLook
from hybrid.pipeline.starts import Start, evened, on_edges
from hybrid.pyramid import Photo, Pyramid
from hybrid.rectify.coarse.invert import Inversion
from hybrid.rectify.edges.paths import EdgesRead, put_on_edges
from hybrid.rectify.grid.phases import CellPhases
from hybrid.rectify.refine.plane import flat_film
from hybrid.rectify.refine.refine import Refinement, refine
from hybrid.rectify.verdict.flat import already_flat, is_frame
from hybrid.rectify.verdict.survey import survey_print
from hybrid.stages import Clock, Report


def shape_of(job: Job, coarse: BackwardMap, phases: CellPhases | None, clock: Clock) -> Refinement:
    """The exact map of the film and its grid, found by the shortest way that the film allows.

    coarse: the network's map. phases: what the network says of the cells.
    """
    config = job.config
    with clock.stage("edges") as report:
        start = on_edges(job, coarse, phases)
        read = start.edges
        report.reason = f"{len(read.sightings)} of 4 edges read, at most {read.off:.1%} of the film off the network's"
    by_edges = partial(flat_film, edges=read.seen_through(start.film), refine=config.refine, config=config.plane)
    flat = _on_copy(job.pyramid, start.film, phases, config.refine.working_px, by_edges)
    clock.reports += flat.stages
    if flat.believed:
        return flat
    with clock.stage("spacing") as report:
        report.ran, before = phases is not None, start.film
        start = evened(job, start)
        moved = mean_move(before, start.film)
        report.reason = f"cells moved by {moved:.2%} of the film" if report.ran else "the network predicts no cells"
    return exact(job, start, clock)


def exact(job: Job, start: Start, clock: Clock) -> Refinement:
    """Refine a map by what is seen of the film, and once more from where its edges are then read, if that is surer."""
    first = refine_once(job, start.phases, start.edges, start.film)
    clock.reports += first.stages
    with clock.stage("reread") as report:
        return reread(job, start.phases, first, report)


def reread(job: Job, phases: CellPhases | None, first: Refinement, report: Report) -> Refinement:
    """A refinement with its edges as read across its map; or a second one, which starts from these edges and is held to
    them, if its edges are then surer; or else one that leaves open where the print ends, if its edges are then as good
    as certain."""
    options = job.config.edges
    read = job.look_across(first.backward)
    least = float(read.support.min())
    first = replace(first, across=read)
    report.ran = first.believed and least < options.doubtful and read.off > options.beside
    report.reason = f"each edge is at least {least:.0%} likely, and at most {read.off:.2%} of the film off the map's"
    if not report.ran:
        return first
    on_edges = put_on_edges(first.backward, read, options)
    held, surer = job.config.refine.edges_held, least + options.surer
    for refining, enough in ((held, surer), (held.print_free, max(surer, options.sure))):
        second = refine_once(job.refining(refining), phases, read, on_edges)
        again = job.look_across(second.backward)
        report.reason += f"; {float(again.support.min()):.0%} once refined from there"
        if second.stands and again.support.min() > enough:
            report.reason += ", which counts"
            left = second if second.believed else first  # else it stays where it began, from the first's map
            return replace(second, across=again, expected_px=left.expected_px)
        report.reason += ", which is not surer"
    return first


def flat_itself(
    job: Job,
    seen: LastLook,
    phases: CellPhases | None,
    refined: Refinement | None,
    told: BackwardMap | None,
    clock: Clock,
) -> Refinement | None:
    """The photo's frame as the film's map, if the photo is a scan or a film that was flattened before.

    refined: what became of the network's map; None if that is not a film's. told: the plane sheet with the corners that
    a person gave; the photo is the film only if these are the photo's own.
    """
    pyramid = job.pyramid
    coarse = seen.inversion.backward if isinstance(seen.inversion, Inversion) else None
    with clock.stage("flat") as report:
        if told is not None and not is_frame(told, pyramid.size):
            report.ran, report.reason = False, "the given corners are not those of the photo"
            return None
        refining = partial(refine_once, job, phases, None)
        flat, report.reason = already_flat(pyramid, coarse, seen.filled, refined, refining)
        if flat is not None and refined is None:  # where no film was found, its print was not checked
            printed = survey_print(pyramid, flat.backward, job.config.survey)
            flat, report.reason = (flat if printed.ok else None), f"{report.reason}; {printed.reason}"
        report.ran = flat is not None
    return flat


def refine_once(job: Job, phases: CellPhases | None, read: EdgesRead | None, start: BackwardMap) -> Refinement:
    """Refine a map on a copy of the photo that is large enough for it. read: the edges, if they were read."""
    edges, options = () if read is None else read.seen_through(start), job.config.refine
    return _on_copy(job.pyramid, start, phases, options.working_px, partial(refine, config=options, edges=edges))


def _on_copy(
    pyramid: Pyramid,
    coarse: BackwardMap,
    phases: CellPhases | None,
    film_px: int,
    work: Callable[[Photo, BackwardMap, CellPhases | None], Refinement],
) -> Refinement:
    """What ``work`` makes of the map on a copy of the photo in which the film's longer side is about ``film_px``."""
    photo, (x, y) = pyramid.scaled(film_px / max(coarse.mean_film_pixels()))
    found = work(photo, coarse.cropped((0.0, 0.0), (x, y)), phases and phases.scaled((x, y)))
    up = (1.0 / x, 1.0 / y)
    grid = found.grid and replace(found.grid, vertices_photo=found.grid.vertices_photo * np.array(up))
    left = None if found.expected_px is None else found.expected_px * up[0]
    return replace(found, backward=found.backward.cropped((0.0, 0.0), up), grid=grid, expected_px=left)
