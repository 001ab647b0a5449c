"""Whether a map is right, and what is done if that is in doubt: the film is refined again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

from hybrid.effort import RectifyConfig
from hybrid.pipeline.geometry import exact
from hybrid.pipeline.job import Job
from hybrid.pipeline.looks import LastLook, network_beside, seen_through
from hybrid.pipeline.starts import Start, other_starts
from hybrid.pipeline.whole_sheet import WholeSheet, whole_sheet
from hybrid.records import CoarseMaps, Signs, StageReport, StatusCode
from hybrid.rectify.coarse.invert import Inversion
from hybrid.rectify.edges.paths import EdgesRead
from hybrid.rectify.grid.borders import borders_shown
from hybrid.rectify.refine.refine import Refinement
from hybrid.rectify.verdict.nearness import nearness
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

    def after(self, doubted: int, config: RectifyConfig) -> Judged:
        """The same for a film that so many refinements had left in doubt: one of several is trusted less."""
        signs = replace(self.signs, doubted=doubted)
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
    """A refinement or, if in doubt, that of it and several more which is likely nearest to the truth.

    They start from where the first ended, with edges and cells as seen through its map, and then from elsewhere, until
    one leaves no doubt or is sure enough. whole: whether to look for margins that were taken for the background.
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
        found = [first.after(1, config)]
        for one in islice(_again(job, seen, first, whole), config.tries):
            found.append(one.after(len(found), config))
            if found[-1].verdict.ok or max(each.chance for each in found) >= config.enough:
                break
        nearest = max(found, key=lambda each: _rank(each, config))
        said = ", ".join(floored(each.chance) for each in found[1:])
        counts = "the first still counts" if nearest is found[0] else f"{floored(nearest.chance)} counts"
        report.reason = f"{floored(found[0].chance)} sure to be right at first, refined again {said}: {counts}"
    return nearest


def _rank(one: Judged, config: RectifyConfig) -> tuple[bool, bool, float]:
    """Larger for the one of several refinements that counts."""
    return one.verdict.ok, one.verdict.code is not StatusCode.NO_FILM, nearness(one.signs, config.nearness)


def _again(job: Job, seen: LastLook, first: Judged, whole: bool) -> Iterator[Judged]:
    """Further refinements, each made when it is asked for. Taking other numbers of cells for granted only leads to
    another start: what the film then shows of its cells decides."""
    beside = partial(network_beside, job.readers.network, seen, job.config)

    def refined(start: Start, job: Job = job) -> Judged:
        clock = Clock()
        found = exact(job, start, clock)
        sheet = whole_sheet(job, start.phases, found, beside, clock) if whole else WholeSheet(found)
        return judged(job, seen, sheet, False, clock)

    yield refined(_end_of(job, first))
    for start in other_starts(job, seen, first.refinement.backward, first.refinement.grid):
        if start.counts is not None:
            start = _end_of(job, refined(start, job.granting(start.counts)))
        yield refined(start)


def _end_of(job: Job, one: Judged) -> Start:
    """Where a refinement ended, with edges and cells as they are seen through its map."""
    return Start(one.refinement.backward, job.phases_of(one.seen), one.across)
