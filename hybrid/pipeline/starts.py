"""Maps to refine a film from: the network's, the end of an earlier refinement, and others worth a try."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from hybrid.backward import BackwardMap, mean_move
from hybrid.film_view import grey_view
from hybrid.learn.reading.views import plane_of
from hybrid.pipeline.job import Job
from hybrid.pipeline.looks import LastLook, see_bent, see_from_sides
from hybrid.records import SliceGrid
from hybrid.rectify.coarse.foreshortening import even, turned_away
from hybrid.rectify.coarse.invert import Inversion
from hybrid.rectify.edges.paths import EdgesRead, put_on_edges, read_edges
from hybrid.rectify.grid.cells import weighed_counts
from hybrid.rectify.grid.phases import CellPhases
from hybrid.rectify.refine.glance import VIEW_PX

LEAST_COUNTED, MOST_COUNTS = 0.05, 2
"""Least probability of other numbers of cells that are worth a try, and how many of these there are at most."""

BENT = 0.013
"""Least mean distance from a plane, in parts of the film, of a sheet one end of which may turn away unnoticed."""

BENDS = ((0.4, 0.2), (0.7, 0.35))
"""How much further an end may turn away: places there are up to 1.6 and 2.05 times as dense as the map has them."""

KEPT = (4, 3, 2)
"""How many of the looks at such a sheet each round keeps, the last one as starts."""


@dataclass(frozen=True, eq=False)
class Start:
    """A map to refine, and what is known of the film before: what the network says of its cells, its edges as read near
    those of the map, and numbers of columns and rows to take for granted."""

    film: BackwardMap
    phases: CellPhases | None
    edges: EdgesRead
    counts: tuple[int, int] | None = None


def on_edges(job: Job, film: BackwardMap, phases: CellPhases | None) -> Start:
    """A map, put on the edges that are read across its own."""
    read = read_edges(job.pyramid, film, job.readers.edges, job.config.edges)
    return Start(put_on_edges(film, read, job.config.edges), phases, read)


def evened(job: Job, start: Start) -> Start:
    """The same with the film's cells evened out, as far as the network sees them."""
    if start.phases is None:
        return start
    film = even(start.film, start.phases, start.edges.seen_through(start.film), job.config.foreshortening)
    return replace(start, film=film)


def other_starts(job: Job, seen: LastLook, ended: BackwardMap, grid: SliceGrid | None) -> Iterator[Start]:
    """Starts that lead elsewhere than the usual one: if the sheet is bent, from what the network sees where an end of
    it is assumed to turn away from the camera, and else from the plane sheet nearest to where the usual one ended,
    ignoring what the network says of the cells; from the network's map with other numbers of cells, or ignoring what
    the network says of them; and from what it sees in other orientations. Each is made when it is asked for.

    ended, grid: map and grid of the refinement from the usual start.
    """
    plane = plane_of(ended)
    if not isinstance(seen.inversion, Inversion):
        yield on_edges(job, plane, None)
        return
    if mean_move(ended, plane) < BENT:
        yield on_edges(job, plane, None)
    else:
        yield from _turned_away(job, seen, seen.inversion.backward)
    phases = job.phases_of(seen.maps)
    start = on_edges(job, seen.inversion.backward, phases)
    for counts in _other_counts(job, evened(job, start), grid):
        yield replace(start, counts=counts)
    if phases is not None:
        yield replace(start, phases=None)
    for side in see_from_sides(job.readers.network, seen, job.config)[:-1]:
        yield evened(job, on_edges(job, side.backward, phases))


def _turned_away(job: Job, seen: LastLook, film: BackwardMap) -> Iterator[Start]:
    """What the network sees through maps by which an end of the sheet turns away more than in ``film``, the surest."""
    film = on_edges(job, film, None).film
    for found in see_bent(job.readers.network, seen, job.config, [film, *turned_away(film, BENDS)], KEPT):
        assert isinstance(found.inversion, Inversion)
        yield evened(job, on_edges(job, found.inversion.backward, job.phases_of(found.maps)))


def _other_counts(job: Job, start: Start, grid: SliceGrid | None) -> list[tuple[int, int]]:
    """The likeliest numbers of columns and rows, as seen through a map, except for those of a grid."""
    refine, (down, across) = job.config.refine, start.film.mean_film_pixels()
    view = grey_view(job.pyramid, start.film, VIEW_PX)
    told = start.phases and start.phases.inside(start.film).axes()
    weighed = weighed_counts(view.image[..., 0], down / across, told, refine.grid, refine.cells)
    known = None if grid is None else (grid.cols, grid.rows)
    return [counts for counts, chance in weighed if counts != known and chance >= LEAST_COUNTED][:MOST_COUNTS]


__all__ = ["Start", "evened", "on_edges", "other_starts"]
