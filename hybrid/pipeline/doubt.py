"""Whether a map is right, and what is done if that is in doubt: the film is refined once more."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

from hybrid.backward import BackwardMap
from hybrid.effort import RectifyConfig
from hybrid.pipeline.geometry import evened, exact
from hybrid.pipeline.job import Job
from hybrid.pipeline.looks import LastLook, network_beside, see_from_sides, seen_through
from hybrid.pipeline.whole_sheet import WholeSheet, whole_sheet
from hybrid.records import CoarseMaps, Signs, StageReport, StatusCode
from hybrid.rectify.coarse.invert import Inversion
from hybrid.rectify.edges.paths import EdgesRead, put_on_edges, read_edges
from hybrid.rectify.grid.borders import borders_shown
from hybrid.rectify.grid.phases import CellPhases
from hybrid.rectify.refine.refine import Refinement
from hybrid.rectify.verdict.survey import Verdict
from hybrid.rectify.verdict.trust import chance_right, film_verdict, floored, signs_of
from hybrid.stages import Clock


@dataclass(frozen=True, eq=False)
class Judged:
    """A refinement, and what the networks make of it when they look through its map.

    across, seen: the edges as read across its map, and what the network sees through it. stages: the reports of the
    stages that run for each refinement.
    """

    refinement: Refinement
    across: EdgesRead
    seen: CoarseMaps
    signs: Signs
    verdict: Verdict
    chance: float
    stages: tuple[StageReport, ...]

    def doubted(self, config: RectifyConfig) -> Judged:
        """The same for a film that was in doubt at first: a choice among several refinements is trusted less."""
        signs = replace(self.signs, doubted=True)
        verdict = film_verdict(signs, config.trust)
        *before, last = self.stages
        stages = (*before, replace(last, reason=verdict.reason))
        return replace(self, signs=signs, verdict=verdict, chance=chance_right(signs, config.trust), stages=stages)


def judged(job: Job, seen: LastLook, sheet: WholeSheet, flat: bool, clock: Clock) -> Judged:
    """Whether the map is as good as certain, and the evidence for and against it; the networks look once more.

    flat: whether the photo was found to be the flat film itself.
    """
    refinement = sheet.refinement
    pyramid, readers, config = job.pyramid, job.readers, job.config
    coarse = seen.inversion.backward if isinstance(seen.inversion, Inversion) else refinement.backward
    with clock.stage("verdict") as report:
        look_again = seen_through(readers.network, seen, config, refinement.backward)
        across = job.edges_of(refinement)
        film, grid = refinement.backward, refinement.grid
        shown = 0.0 if grid is None else borders_shown(pyramid, film, grid, readers.borders, config.refine.borders)
        signs = signs_of(
            pyramid, seen.maps, coarse, refinement, look_again, across, shown, flat, seen.near, sheet.goes_on
        )
        verdict = film_verdict(signs, config.trust)
        report.reason = verdict.reason
    stages = (*refinement.stages, clock.reports[-1])
    return Judged(refinement, across, look_again, signs, verdict, chance_right(signs, config.trust), stages)


def beyond_doubt(job: Job, seen: LastLook, first: Judged, whole: bool, clock: Clock) -> Judged:
    """A refinement or, if in doubt, the surest of it and several more, up to the first that is not in doubt.

    They start from where the first ended, with edges and cells as seen through its map, then from what the network sees
    in other orientations. whole: whether to look for margins that were taken for the background.
    """
    config = job.config
    with clock.stage("again") as report:
        doubtful = first.verdict.code is StatusCode.UNSURE
        hopeful = first.chance >= config.hopeless
        report.ran = bool(config.tries and doubtful and hopeful)
        if not report.ran:
            some = "too little speaks for it" if config.tries else "one refinement is enough in this effort"
            report.reason = some if doubtful else "no doubt is left that another refinement could remove"
            return first
        found, beside = [first.doubted(config)], partial(network_beside, job.readers.network, seen, config)
        for start in _starts(job, seen, first):
            apart = Clock()
            refined = exact(job, *start, apart)
            sheet = whole_sheet(job, start[1], refined, beside, apart) if whole else WholeSheet(refined)
            found.append(judged(job, seen, sheet, False, apart).doubted(config))
            if found[-1].verdict.ok or len(found) > config.tries:
                break
        surest = max(found, key=lambda one: (one.verdict.ok, one.verdict.code is not StatusCode.NO_FILM, one.chance))
        said = ", ".join(floored(one.chance) for one in found[1:])
        counts = "the first still counts" if surest is found[0] else f"{floored(surest.chance)} counts"
        report.reason = f"{floored(found[0].chance)} sure to be right at first, refined again {said}: {counts}"
    return surest


def _starts(job: Job, seen: LastLook, first: Judged) -> Iterator[tuple[BackwardMap, CellPhases | None, EdgesRead]]:
    """Maps to refine anew, with what the network says of the cells, and with the edges read: where the first refinement
    ended, and then what the network sees in other orientations."""
    yield first.refinement.backward, job.phases_of(first.seen), first.across
    phases, config = job.phases_of(seen.maps), job.config
    for side in see_from_sides(job.readers.network, seen, config)[:-1]:
        read = read_edges(job.pyramid, side.backward, job.readers.edges, config.edges)
        yield evened(put_on_edges(side.backward, read, config.edges), phases, read, config), phases, read
