"""From what the network sees to the backward map and the grid: edges, the plane, refinement, margins, the verdict, and
once more if doubt remains; each only as far as the film needs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hybrid.backward import BackwardMap, mean_move
from hybrid.effort import RectifyConfig
from hybrid.learn.networks.filmnet import FilmNet
from hybrid.looks import LastLook, network_beside, see_from_sides, seen_through
from hybrid.pyramid import Photo, Pyramid
from hybrid.records import CoarseMaps, Signs, StageReport, StatusCode
from hybrid.rectify.coarse.foreshortening import even
from hybrid.rectify.coarse.invert import Inversion
from hybrid.rectify.edges.paths import EdgesRead, look_across, put_on_edges, read_edges
from hybrid.rectify.grid.borders import borders_shown
from hybrid.rectify.grid.phases import CellPhases
from hybrid.rectify.margins.clear import LongerSheet, with_margins
from hybrid.rectify.margins.ground import without_margins
from hybrid.rectify.refine.plane import flat_film
from hybrid.rectify.refine.refine import Refinement, refine
from hybrid.rectify.verdict.flat import already_flat, is_frame
from hybrid.rectify.verdict.survey import Verdict, survey_print
from hybrid.rectify.verdict.trust import chance_right, film_verdict, floored, signs_of
from hybrid.stages import Clock, Report
from hybrid.strips import StripReader

MOST_MARGINS = 2
"""How often margins are looked for: at one end they may show only once the sheet is made longer at the other."""


@dataclass(frozen=True, eq=False)
class Readers:
    """The networks that read a photo's film: ``network`` sees it as a whole, the others read strips across the sheet's
    edges and across the borders between its cells."""

    network: FilmNet
    edges: StripReader
    borders: StripReader

    def phases_of(self, maps: CoarseMaps, config: RectifyConfig) -> CellPhases | None:
        """What the network says of the cells, if the options ask for it."""
        return CellPhases.of(maps, self.borders) if config.told_cells else None


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


def shape_of(
    pyramid: Pyramid,
    coarse: BackwardMap,
    phases: CellPhases | None,
    reader: StripReader,
    config: RectifyConfig,
    clock: Clock,
) -> Refinement:
    """The exact map of the film and its grid, found by the shortest way that the film allows.

    coarse: the network's map. phases: what the network says of the cells. reader: reads the film's edges.
    """
    with clock.stage("edges") as report:
        read = read_edges(pyramid, coarse, reader, config.edges)
        start = put_on_edges(coarse, read, config.edges)
        report.reason = f"{len(read.sightings)} of 4 edges read, at most {read.off:.1%} of the film off the network's"
    by_edges = partial(flat_film, edges=read.seen_through(start), refine=config.refine, config=config.plane)
    flat = _on_copy(pyramid, start, phases, config.refine.working_px, by_edges)
    clock.reports += flat.stages
    if flat.believed:
        return flat
    with clock.stage("spacing") as report:
        report.ran, before = phases is not None, start
        start = _evened(start, phases, read, config)
        moved = mean_move(before, start)
        report.reason = f"cells moved by {moved:.2%} of the film" if report.ran else "the network predicts no cells"
    return exact(pyramid, start, phases, read, reader, config, clock)


def exact(
    pyramid: Pyramid,
    start: BackwardMap,
    phases: CellPhases | None,
    read: EdgesRead,
    reader: StripReader,
    config: RectifyConfig,
    clock: Clock,
) -> Refinement:
    """Refine a map by what is seen of the film, and once more from where its edges are then read, if that is surer."""
    first = _exactly(pyramid, phases, read, config, start)
    clock.reports += first.stages
    with clock.stage("reread") as report:
        return reread(pyramid, phases, first, reader, config, report)


def _evened(film: BackwardMap, phases: CellPhases | None, read: EdgesRead, config: RectifyConfig) -> BackwardMap:
    """The film with its cells evened out, as far as the network sees them."""
    return film if phases is None else even(film, phases, read.seen_through(film), config.foreshortening)


def reread(
    pyramid: Pyramid,
    phases: CellPhases | None,
    first: Refinement,
    reader: StripReader,
    config: RectifyConfig,
    report: Report,
) -> Refinement:
    """A refinement with its edges as read across its map; or a second one, which starts from these edges and is held to
    them, if its edges are then surer; or else one that leaves open where the print ends, if its edges are then as good
    as certain."""
    options = config.edges
    read = look_across(pyramid, first.backward, reader, options)
    least = float(read.support.min())
    first = replace(first, across=read)
    report.ran = first.believed and least < options.doubtful and read.off > options.beside
    report.reason = f"each edge is at least {least:.0%} likely, and at most {read.off:.2%} of the film off the map's"
    if not report.ran:
        return first
    on_edges = put_on_edges(first.backward, read, options)
    held, surer = config.refine.edges_held, least + options.surer
    for refining, enough in ((held, surer), (held.print_free, max(surer, options.sure))):
        second = _exactly(pyramid, phases, read, replace(config, refine=refining), on_edges)
        again = look_across(pyramid, second.backward, reader, options)
        report.reason += f"; {float(again.support.min()):.0%} once refined from there"
        if second.stands and again.support.min() > enough:
            report.reason += ", which counts"
            left = second if second.believed else first  # else it stays where it began, from the first's map
            return replace(second, across=again, expected_px=left.expected_px)
        report.reason += ", which is not surer"
    return first


def whole_sheet(
    pyramid: Pyramid,
    phases: CellPhases | None,
    refined: Refinement,
    reader: StripReader,
    beside: Callable[[BackwardMap], float],
    config: RectifyConfig,
    clock: Clock,
) -> Refinement:
    """A refinement, or one of a longer sheet with margins that had been taken for the background, if its edges are
    likely to be there, its print lies in its middle, and the network sees it there, too; or one of a shorter sheet
    without margins that were background.

    reader: reads the film's edges. beside: how far beside a map the network sees the film (``seen_beside``).
    """
    with clock.stage("margins") as report:
        found: list[str] = []
        while len(found) < MOST_MARGINS:
            wider = _with_margins(pyramid, phases, refined, reader, beside, config)
            if wider is None:
                break
            refined = wider[0]
            found.append(wider[1])
        if shorter := _without_margins(pyramid, phases, refined, reader, config):
            refined = shorter[0]
            found.append(shorter[1])
        report.ran = bool(found)
        report.reason = "; ".join(found) or "the sheet ends where its map does"
    return refined


def _with_margins(
    pyramid: Pyramid,
    phases: CellPhases | None,
    refined: Refinement,
    reader: StripReader,
    beside: Callable[[BackwardMap], float],
    config: RectifyConfig,
) -> tuple[Refinement, str] | None:
    """The first refinement with such margins that is believed, and what the margins are."""
    options = config.margins
    before = np.inf if refined.expected_px is None else refined.expected_px
    grid_before = _grid_chance(refined)
    for longer in with_margins(pyramid, refined.backward, reader, config.edges, options):
        wider = _exactly(pyramid, phases, longer.read, config, longer.read.through)
        most_px = options.most_expected * max(wider.backward.mean_film_pixels())
        if wider.expected_px is None or wider.expected_px > most_px:
            continue
        if wider.grid is not None and wider.grid.lopsided > options.most_lopsided:
            continue
        across = look_across(pyramid, wider.backward, reader, config.edges)
        chance = longer.chance(across)
        if chance < options.sure or across.support.min() < options.least_support:
            continue
        larger = wider.expected_px > options.most_growth * before
        fits = _grid_chance(wider) - grid_before >= (options.grid_changed if larger else -options.grid_changed)
        if not (fits or _blank(pyramid, longer, wider, config)):
            continue
        surely = fits or chance >= options.blank_sure
        if not surely and _edges_of(pyramid, refined, reader, config).support.min() >= config.edges.sure:
            continue
        if beside(wider.backward) <= options.most_beside:
            return replace(wider, across=across), str(longer)
    return None


def _without_margins(
    pyramid: Pyramid, phases: CellPhases | None, refined: Refinement, reader: StripReader, config: RectifyConfig
) -> tuple[Refinement, str] | None:
    """A refinement of the sheet without margins that were background, and what these were."""
    options, grid, across = config.false_margins, refined.grid, refined.across
    if grid is None:
        return None
    unseen = across is not None and across.support.min() < options.unseen  # a plane has straight edges that are seen
    may_gain = grid.confidence + options.grid_gained <= 1.0
    if not (unseen or may_gain or grid.lopsided >= options.unlike - options.most_lopsided):
        return None  # whatever were cut off, nothing would tell it from a margin
    shorter = without_margins(pyramid, refined.backward, grid, reader, config.edges, options)
    if shorter is None:
        return None
    is_ground = unseen or shorter.unlike >= options.unlike
    if not (is_ground or may_gain):
        return None
    within = exact(pyramid, shorter.read.through, phases, shorter.read, reader, config, Clock())
    if within.grid is None or within.grid.lopsided > options.most_lopsided:
        return None
    if not (is_ground or within.grid.confidence >= grid.confidence + options.grid_gained):
        return None
    sure = _edges_of(pyramid, within, reader, config).support.min() >= options.sure
    return (within, str(shorter)) if sure else None


def _grid_chance(refinement: Refinement) -> float:
    """How probable the grid is; 0 where there is none."""
    return 0.0 if refinement.grid is None else refinement.grid.confidence


def _edges_of(pyramid: Pyramid, refinement: Refinement, reader: StripReader, config: RectifyConfig) -> EdgesRead:
    """The edges as read across a refinement's map; they are read now if they have not been."""
    return refinement.across or look_across(pyramid, refinement.backward, reader, config.edges)


def _blank(pyramid: Pyramid, longer: LongerSheet, wider: Refinement, config: RectifyConfig) -> bool:
    """Whether what a sheet gains is blank and alike on both sides of the print: margins, however the print fits."""
    options, lopsided = config.margins, longer.lopsided if wider.grid is None else wider.grid.lopsided
    if lopsided > options.blank_lopsided:
        return False
    return longer.detail_gained(pyramid, wider.backward, config.refine.cells) <= options.blank


def flat_itself(
    pyramid: Pyramid,
    seen: LastLook,
    phases: CellPhases | None,
    refined: Refinement | None,
    told: BackwardMap | None,
    config: RectifyConfig,
    clock: Clock,
) -> Refinement | None:
    """The photo's frame as the film's map, if the photo is a scan or a film that was flattened before.

    refined: what became of the network's map; None if that is not a film's. told: the plane sheet with the corners that
    a person gave; the photo is the film only if these are the photo's own.
    """
    coarse = seen.inversion.backward if isinstance(seen.inversion, Inversion) else None
    with clock.stage("flat") as report:
        if told is not None and not is_frame(told, pyramid.size):
            report.ran, report.reason = False, "the given corners are not those of the photo"
            return None
        exactly = partial(_exactly, pyramid, phases, None, config)
        flat, report.reason = already_flat(pyramid, coarse, seen.filled, refined, exactly)
        if flat is not None and refined is None:  # where no film was found, its print was not checked
            printed = survey_print(pyramid, flat.backward, config.survey)
            flat, report.reason = (flat if printed.ok else None), f"{report.reason}; {printed.reason}"
        report.ran = flat is not None
    return flat


def judged(
    readers: Readers,
    pyramid: Pyramid,
    seen: LastLook,
    refinement: Refinement,
    flat: bool,
    config: RectifyConfig,
    clock: Clock,
) -> Judged:
    """Whether the map is as good as certain, and the evidence for and against it; the networks look once more.

    flat: whether the photo was found to be the flat film itself.
    """
    coarse = seen.inversion.backward if isinstance(seen.inversion, Inversion) else refinement.backward
    with clock.stage("verdict") as report:
        look_again = seen_through(readers.network, seen, config, refinement.backward)
        across = _edges_of(pyramid, refinement, readers.edges, config)
        film, grid = refinement.backward, refinement.grid
        shown = 0.0 if grid is None else borders_shown(pyramid, film, grid, readers.borders, config.refine.borders)
        signs = signs_of(pyramid, seen.maps, coarse, refinement, look_again, across, shown, flat, seen.near)
        verdict = film_verdict(signs, config.trust)
        report.reason = verdict.reason
    stages = (*refinement.stages, clock.reports[-1])
    return Judged(refinement, across, look_again, signs, verdict, chance_right(signs, config.trust), stages)


def beyond_doubt(
    readers: Readers,
    pyramid: Pyramid,
    seen: LastLook,
    first: Judged,
    whole: bool,
    config: RectifyConfig,
    clock: Clock,
) -> Judged:
    """A refinement or, if in doubt, the surest of it and several more, up to the first that is not in doubt.

    They start from where the first ended, with edges and cells as seen through its map, then from what the network sees
    in other orientations. whole: whether to look for margins that were taken for the background.
    """
    with clock.stage("again") as report:
        doubtful = first.verdict.code is StatusCode.UNSURE
        hopeful = first.chance >= config.hopeless
        report.ran = bool(config.tries and doubtful and hopeful)
        if not report.ran:
            some = "too little speaks for it" if config.tries else "one refinement is enough in this effort"
            report.reason = some if doubtful else "no doubt is left that another refinement could remove"
            return first
        found, beside = [first.doubted(config)], partial(network_beside, readers.network, seen, config)
        for start in _starts(readers, pyramid, seen, first, config):
            apart = Clock()
            refined = exact(pyramid, *start, readers.edges, config, apart)
            if whole:
                refined = whole_sheet(pyramid, start[1], refined, readers.edges, beside, config, apart)
            found.append(judged(readers, pyramid, seen, refined, False, config, apart).doubted(config))
            if found[-1].verdict.ok or len(found) > config.tries:
                break
        surest = max(found, key=lambda one: (one.verdict.ok, one.verdict.code is not StatusCode.NO_FILM, one.chance))
        said = ", ".join(floored(one.chance) for one in found[1:])
        counts = "the first still counts" if surest is found[0] else f"{floored(surest.chance)} counts"
        report.reason = f"{floored(found[0].chance)} sure to be right at first, refined again {said}: {counts}"
    return surest


def _starts(
    readers: Readers, pyramid: Pyramid, seen: LastLook, first: Judged, config: RectifyConfig
) -> Iterator[tuple[BackwardMap, CellPhases | None, EdgesRead]]:
    """Maps to refine anew, with what the network says of the cells, and with the edges read: where the first refinement
    ended, and then what the network sees in other orientations."""
    yield first.refinement.backward, readers.phases_of(first.seen, config), first.across
    phases = readers.phases_of(seen.maps, config)
    for side in see_from_sides(readers.network, seen, config)[:-1]:
        read = read_edges(pyramid, side.backward, readers.edges, config.edges)
        yield _evened(put_on_edges(side.backward, read, config.edges), phases, read, config), phases, read


def _exactly(
    pyramid: Pyramid, phases: CellPhases | None, read: EdgesRead | None, config: RectifyConfig, start: BackwardMap
) -> Refinement:
    """Refine a map on a copy of the photo that is large enough for it. read: the edges, if they were read."""
    edges = () if read is None else read.seen_through(start)
    return _on_copy(
        pyramid, start, phases, config.refine.working_px, partial(refine, config=config.refine, edges=edges)
    )


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
