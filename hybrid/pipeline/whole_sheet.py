"""Where the sheet ends: margins that were taken for the background, and background that was taken for margins."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from hybrid.backward import BackwardMap
from hybrid.pipeline.geometry import exact, refine_once
from hybrid.pipeline.job import Job
from hybrid.pipeline.starts import Start
from hybrid.rectify.edges.paths import EdgesRead
from hybrid.rectify.grid.phases import CellPhases
from hybrid.rectify.margins.clear import LongerSheet, detail_of_margins, unlike_ends, with_margins
from hybrid.rectify.margins.ground import ends_inside, ends_of_print, without_margins
from hybrid.rectify.refine.refine import Refinement
from hybrid.stages import Clock
from hybrid.strips import Side

MOST_MARGINS = 2
"""How often margins are looked for: at one end they may show only once the sheet is made longer at the other."""


@dataclass(frozen=True, eq=False)
class WholeSheet:
    """A refinement of the whole sheet. goes_on: how likely the edges of a still longer sheet are that was not believed;
    0 where there is none."""

    refinement: Refinement
    goes_on: float = 0.0


def whole_sheet(
    job: Job,
    phases: CellPhases | None,
    refined: Refinement,
    beside: Callable[[BackwardMap], float],
    clock: Clock,
) -> WholeSheet:
    """A refinement, or one of a longer sheet with margins that had been taken for the background, if its edges are
    likely to be there and the network sees it there, too; or one of a shorter sheet without margins that were
    background.

    beside: how far beside a map the network sees the film (``seen_beside``).
    """
    with clock.stage("margins") as report:
        found: list[str] = []
        whole = WholeSheet(refined)
        while len(found) < MOST_MARGINS:
            whole, margins = _with_margins(job, phases, whole.refinement, beside)
            if margins is None:
                break
            found.append(margins)
        if shorter := _without_margins(job, phases, whole.refinement):
            whole = WholeSheet(shorter[0])
            found.append(shorter[1])
        report.ran = bool(found)
        report.reason = "; ".join(found) or "the sheet ends where its map does"
    return whole


def _with_margins(
    job: Job, phases: CellPhases | None, refined: Refinement, beside: Callable[[BackwardMap], float]
) -> tuple[WholeSheet, str | None]:
    """The first refinement with such margins that is believed, and what they are; or the one before, and None."""
    options, goes_on = job.config.margins, 0.0
    for longer in with_margins(job.pyramid, refined.backward, job.readers.edges, job.config.edges, options):
        wider = refine_once(job, phases, longer.read, longer.read.through)
        most_px = options.most_expected * max(wider.backward.mean_film_pixels())
        if wider.expected_px is None or wider.expected_px > most_px:
            continue
        across = job.look_across(wider.backward)
        likely = _certain(job, longer, wider, across) or _likelier(job, refined, longer, wider, across)
        chance = longer.chance(across)
        if (likely or chance > goes_on) and beside(wider.backward) <= options.most_beside:
            if likely:
                return WholeSheet(replace(wider, across=across)), str(longer)
            goes_on = chance
    return WholeSheet(refined, goes_on), None


def _certain(job: Job, longer: LongerSheet, wider: Refinement, across: EdgesRead) -> bool:
    """Whether the edges of a longer sheet are as likely as they must be if the print says nothing: above all where what
    it gains is blank, as a sheet below the film is."""
    options, least = job.config.margins, min(longer.chance(across), across.support.min())
    if least >= options.certain and _lopsided(longer, wider) <= options.most_lopsided:
        return True
    return bool(least >= options.written and options.blank < _detail(job, longer, wider) < math.inf)


def _likelier(job: Job, refined: Refinement, longer: LongerSheet, wider: Refinement, across: EdgesRead) -> bool:
    """Whether a longer sheet is likelier than the one before, by its edges, its print, and the margins it gains."""
    config, options = job.config, job.config.margins
    chance = longer.chance(across)
    if wider.grid is not None and wider.grid.lopsided > options.most_lopsided:
        return False
    if chance < options.sure or across.support.min() < options.least_support:
        return False
    assert wider.expected_px is not None
    larger = refined.expected_px is not None and wider.expected_px > options.most_growth * refined.expected_px
    gained = _grid_chance(wider) - _grid_chance(refined)
    fits = gained >= (options.grid_changed if larger else -options.grid_changed)
    if not (fits or _blank(job, longer, wider)):
        return False
    surely = fits or chance >= options.blank_sure
    return surely or bool(job.edges_of(refined).support.min() < config.edges.sure)


def _without_margins(job: Job, phases: CellPhases | None, refined: Refinement) -> tuple[Refinement, str] | None:
    """Refinement of the sheet without margins that were background, and what these were."""
    options, grid, across = job.config.false_margins, refined.grid, refined.across
    readers, film, before = job.readers, refined.backward, _grid_chance(refined)
    unseen = across is not None and across.support.min() < options.unseen  # a plane has straight edges that are seen
    may_gain = before + options.grid_gained <= 1.0
    least = options.unlike - options.most_lopsided
    told: Mapping[Side, float] = {}
    if grid is not None and (unseen or may_gain or grid.lopsided >= least):
        told = ends_of_print(grid, options)
    read = ends_inside(job.pyramid, film, readers.edges, job.config.edges, options)
    wide = {**read, **told}
    if not (unseen or may_gain or unlike_ends(wide) >= least):
        return None  # whatever were cut off, nothing would tell it from a margin
    shorter = without_margins(job.pyramid, film, wide, readers.edges, job.config.edges, options)
    if shorter is None:
        return None
    is_ground = unseen or shorter.unlike >= options.unlike
    if not (is_ground or may_gain):
        return None
    untold = [side for side in shorter.lost if side not in told]
    if untold and _may_be_print(job, refined, shorter.lost, untold):
        return None
    within = exact(job, Start(shorter.read.through, phases, shorter.read), Clock())
    if within.grid is None or within.grid.lopsided > options.most_lopsided:
        return None
    if not (is_ground or within.grid.confidence >= before + options.grid_gained):
        return None
    sure = job.edges_of(within).support.min() >= options.sure
    return (within, str(shorter)) if sure else None


def _may_be_print(job: Job, refined: Refinement, lost: Mapping[Side, float], untold: Sequence[Side]) -> bool:
    """Whether what is cut off shows too much for ground. untold: ends where the grid has no margin, so that it might be
    a row of cells."""
    options, edges = job.config.false_margins, job.edges_of(refined)
    certain = any(edges.support_of(side) >= options.certain for side in untold)
    detail = detail_of_margins(job.pyramid, refined.backward, lost, job.config.refine.cells)
    return detail > (options.blank_certain if certain else options.blank)


def _grid_chance(refinement: Refinement) -> float:
    """How probable the grid is; 0 where there is none."""
    return 0.0 if refinement.grid is None else refinement.grid.confidence


def _blank(job: Job, longer: LongerSheet, wider: Refinement) -> bool:
    """Whether what a sheet gains is blank and alike on both sides of the print: margins, however the print fits."""
    options = job.config.margins
    return _lopsided(longer, wider) <= options.blank_lopsided and _detail(job, longer, wider) <= options.blank


def _lopsided(longer: LongerSheet, wider: Refinement) -> float:
    """By how much opposite margins differ: those around the grid or, where none is seen, those gained."""
    return longer.lopsided if wider.grid is None else wider.grid.lopsided


def _detail(job: Job, longer: LongerSheet, wider: Refinement) -> float:
    """Detail of the margins gained, in parts of the print's; infinite where the photo does not show it."""
    return longer.detail_gained(job.pyramid, wider.backward, job.config.refine.cells)
