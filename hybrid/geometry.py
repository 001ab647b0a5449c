"""From the photo to the backward map and the grid: looks, the plane, refinement; each only as far as the film needs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from hybrid.backward import BackwardMap, mean_move
from hybrid.effort import RectifyConfig
from hybrid.learn.network import FilmNet
from hybrid.learn.predict import look, look_from_sides
from hybrid.learn.views import film_view, plane_of, whole_view
from hybrid.pyramid import Photo, Pyramid
from hybrid.records import CoarseMaps, Signs, StageReport, StatusCode
from hybrid.rectify.border_paths import borders_shown
from hybrid.rectify.cell_phases import CellPhases
from hybrid.rectify.clear_margins import with_margins
from hybrid.rectify.consensus import geometric_median
from hybrid.rectify.corners import put_on_corners
from hybrid.rectify.edge_paths import EdgesRead, look_across, put_on_edges, read_edges
from hybrid.rectify.flat import already_flat
from hybrid.rectify.foreshortening import even
from hybrid.rectify.invert import Inversion, NotInverted, agreed, change, fit_backward
from hybrid.rectify.plane import flat_film
from hybrid.rectify.refine import Refinement, refine
from hybrid.rectify.survey import SurveyConfig, Verdict, expected_error, survey_maps, survey_print
from hybrid.rectify.trust import film_verdict, signs_of
from hybrid.strips import StripReader

WIDER = 1.25
"""How many times as wide as the photo the first look is that is tried if none shows a film."""

MOST_MARGINS = 2
"""How often margins are looked for: beyond one end they may show only once the sheet is as long as it is at the other.
"""

AS_SURE = 1.6
"""A refinement that expects more than this times the least error of all does not count for their middle."""


@dataclass
class Report:
    """What a stage says of itself while it runs."""

    reason: str = ""
    ran: bool = True


class Clock:
    """Collects the reports of the stages of one photo, with their seconds."""

    def __init__(self) -> None:
        self.reports: tuple[StageReport, ...] = ()

    @contextmanager
    def stage(self, name: str) -> Iterator[Report]:
        report, start = Report(), time.perf_counter()
        yield report
        self.reports += (StageReport(name, report.ran, report.reason, time.perf_counter() - start),)

    def counts(self, refinement: Refinement) -> None:
        """Of stages that ran several times, has what this refinement says of them reported; seconds are of the first
        run, the others' being in the stages that called for them."""
        said = {report.name: report for report in refinement.stages}
        self.reports = tuple(
            replace(said[report.name], seconds=report.seconds) if report.name in said else report
            for report in self.reports
        )


@dataclass(frozen=True, eq=False)
class LastLook:
    """What the network saw in its last look: the maps, the film's map that follows, and the view of the film, if any.

    All but ``inversion`` and ``maps`` are of ``photo``, the copy of the photo, ``factor`` times smaller, that it saw.
    """

    maps: CoarseMaps
    inversion: Inversion | NotInverted
    view: BackwardMap | None
    photo: Photo
    factor: int


def see(network: FilmNet, pyramid: Pyramid, config: RectifyConfig, clock: Clock, wider: float = 1.0) -> LastLook:
    """The network's looks at the photo: at the whole, then at the film, flattened by the plane seen last.

    wider: the first look is at a square so many times as wide as the photo.
    """
    predict = config.predict
    with clock.stage("network") as report:
        photo, factor = pyramid.reduced(max(pyramid.photo.shape[:2]) / predict.least_px)
        (maps,) = look(network, photo, [whole_view((photo.shape[0], photo.shape[1]), wider)])
        inversion, looks, moved = fit_backward(maps, config.invert), 1, np.inf
        view: BackwardMap | None = None
        while looks < predict.looks and moved > predict.settled:
            if isinstance(inversion, NotInverted) or inversion.backward.folds((9, 9)):
                break
            if looks > 1 and expected_error(maps) > config.survey.max_expected_error:
                break  # no film, it seems: a further look would only flatter it
            view = film_view(plane_of(inversion.backward), predict.margin)
            (maps,) = look_from_sides(network, photo, view, predict.sides[:1])
            last, inversion = inversion, fit_backward(maps, config.invert)
            looks, moved = looks + 1, change(last, inversion)
        if isinstance(inversion, NotInverted):
            report.reason = inversion.reason
        else:
            inversion = inversion.enlarged(factor)
            report.reason = f"{looks} looks, the last explained to {inversion.residual_px:.1f} px"
    return LastLook(maps.enlarged(factor), inversion, view, photo, factor)


def see_at(network: FilmNet, pyramid: Pyramid, told: BackwardMap, config: RectifyConfig, clock: Clock) -> LastLook:
    """The network's look at a film whose corners a person gave, flattened by the plane sheet ``told`` that has them.

    The map is displaced to have these corners; where the network sees no film there, it is that of the plane sheet.
    """
    predict = config.predict
    with clock.stage("network") as report:
        photo, factor = pyramid.reduced(max(pyramid.photo.shape[:2]) / predict.least_px)
        told = told.cropped((0.0, 0.0), (1 / factor, 1 / factor))
        view = film_view(told, predict.margin)
        (maps,) = look_from_sides(network, photo, view, predict.sides[:1])
        inversion = fit_backward(maps, config.invert)
        if isinstance(inversion, Inversion):
            inversion = replace(inversion, backward=put_on_corners(inversion.backward, told))
            report.reason = f"a look at the given corners, explained to {inversion.residual_px * factor:.1f} px"
        if isinstance(inversion, NotInverted) or inversion.backward.folds((17, 17)):
            inversion = Inversion(told, residual_px=0.0, coverage=0.0, inlier_share=0.0)
            report.reason = "the plane sheet with the given corners: no film is seen there"
    return LastLook(maps.enlarged(factor), inversion.enlarged(factor), view, photo, factor)


def check(pyramid: Pyramid, seen: LastLook, config: SurveyConfig) -> Verdict:
    """Whether what the network saw is one sheet, seen whole, and printed as films are."""
    verdict = survey_maps(seen.maps, seen.inversion, pyramid.photo.shape, config)
    if not verdict.ok or isinstance(seen.inversion, NotInverted):
        return verdict
    printed = survey_print(pyramid, seen.inversion.backward, config)
    return Verdict(printed.code, f"{printed.reason}; {verdict.reason}")


def checked(
    network: FilmNet, pyramid: Pyramid, seen: LastLook, config: RectifyConfig, clock: Clock
) -> tuple[LastLook, Verdict]:
    """What the network saw, and whether it is a film; if not, what it sees from a first look that is wider.

    With little room beside it a film may look as if it went on beyond the photo. That counts only if the whole sheet
    lies in the photo then: of one that does leave it the seen part would be taken for all.
    """
    with clock.stage("check") as report:
        verdict = check(pyramid, seen, config.survey)
        if verdict.code in (StatusCode.NO_FILM, StatusCode.CUT_OFF, StatusCode.PAPER):
            other = see(network, pyramid, config, Clock(), WIDER)
            second = check(pyramid, other, config.survey)
            if second.ok and _lies_within(other.inversion, pyramid.photo.shape):
                seen, verdict = other, Verdict(second.code, f"from a wider look: {second.reason}")
        report.reason = verdict.reason
    return seen, verdict


def _lies_within(inversion: Inversion | NotInverted, size: tuple[int, ...]) -> bool:
    """Whether a photo of ``size`` (height, width, ...) shows all of the sheet."""
    if isinstance(inversion, NotInverted):
        return False
    nodes = inversion.backward.nodes
    return bool((nodes >= 0).all() and (nodes <= np.array(size[1::-1])).all())


def see_from_sides(network: FilmNet, seen: LastLook, config: RectifyConfig, clock: Clock) -> list[Inversion]:
    """The maps of the last look, turned and mirrored in several ways for the network; that of ``seen`` is the last."""
    first, others = seen.inversion, config.predict.sides[1:]
    if isinstance(first, NotInverted):
        return []
    with clock.stage("sides") as report:
        report.ran = bool(others) and seen.view is not None
        report.reason = "the film was not looked at alone" if others else "one side was asked for"
        if seen.view is None or not others:
            return [first]
        looks = look_from_sides(network, seen.photo, seen.view, others)
        found = [fit_backward(maps, config.invert) for maps in looks]
        sides = [side.enlarged(seen.factor) for side in found if isinstance(side, Inversion)]
        apart = np.mean([change(first, side) for side in sides]) if sides else 0.0
        report.reason = f"{len(sides)} more sides, {apart:.1%} of the film from the first on average"
    return [*sides, first]


def shape_of(
    pyramid: Pyramid,
    coarse: BackwardMap,
    phases: CellPhases | None,
    reader: StripReader,
    sides: Callable[[], Sequence[Inversion]],
    config: RectifyConfig,
    clock: Clock,
) -> Refinement:
    """The exact map of the film and its grid, by the shortest way that it allows.

    coarse: the network's map of one side. phases: what it tells of the cells. reader: reads the film's edges. sides:
    gives the maps of all sides, that one's last; called where they are needed.
    """
    with clock.stage("edges") as report:
        read = read_edges(pyramid, coarse, reader, config.edges)
        on_edges = partial(put_on_edges, read=read, config=config.edges)
        start = on_edges(coarse)
        report.reason = f"{len(read.sightings)} of 4 edges read, up to {read.off:.1%} of the film beside the network's"
    by_edges = partial(flat_film, edges=read.seen_through(start), refine=config.refine, config=config.plane)
    flat = _on_copy(pyramid, start, phases, config.refine.working_px, by_edges)
    clock.reports += flat.stages
    if flat.believed:
        return flat

    def evened(film: BackwardMap) -> BackwardMap:
        return film if phases is None else even(film, phases, read.seen_through(film), config.foreshortening)

    with clock.stage("spacing") as report:
        report.ran, before = phases is not None, start
        start = evened(start)
        moved = mean_move(before, start)
        report.reason = (
            f"cells moved by {moved:.2%} of the film" if report.ran else "the network tells nothing of cells"
        )

    def others() -> list[BackwardMap]:
        *further, one = sides()
        mean = agreed([*further, one])
        assert isinstance(mean, Inversion)  # as ``one`` is
        return [evened(on_edges(side.backward)) for side in ([mean, *further] if further else [])]

    return _exact(pyramid, start, phases, read, reader, others, config, clock)


def _exact(
    pyramid: Pyramid,
    coarse: BackwardMap,
    phases: CellPhases | None,
    read: EdgesRead,
    reader: StripReader,
    others: Callable[[], Sequence[BackwardMap]],
    config: RectifyConfig,
    clock: Clock,
) -> Refinement:
    """The network's map made exact by what is seen of the film; where the effort says so and it is not sure then, other
    maps too, those of the other sides and the mean of all."""
    exactly = partial(_exactly, pyramid, phases, read, config)
    first = exactly(coarse)
    clock.reports += first.stages
    with clock.stage("reread") as report:
        first = reread(pyramid, phases, first, reader, config, report)
    with clock.stage("again") as report:
        expected = np.inf if first.expected_px is None else first.expected_px / max(first.backward.mean_film_pixels())
        report.ran = bool(expected > config.again_above)
        if not report.ran:
            sure = f"one refinement is sure to {expected:.2%} of the film"
            report.reason = "one refinement is enough in this effort" if np.isinf(config.again_above) else sure
            return first
        found = [first, *map(exactly, others())]
        surest = as_sure(found)
        one = "the surest" if surest else "the first, as none is believed"
        counts = f"the middle of the {len(surest)} that are surest" if surest[1:] else one
        apart = ends_apart(found)
        report.reason = f"from the maps of other sides and their mean, {len(found) - 1} in all: {counts}"
        report.reason += "" if apart is None else f"; they end {apart:.2%} of the film apart"
        return replace(middle(surest) if surest else first, ends_apart=apart)


def reread(
    pyramid: Pyramid,
    phases: CellPhases | None,
    first: Refinement,
    reader: StripReader,
    config: RectifyConfig,
    report: Report,
) -> Refinement:
    """A refinement whose edges are read where it puts them, or one more from where they are read through its map, if
    they are more surely there then."""
    options = config.edges
    read = look_across(pyramid, first.backward, reader, options)
    least = float(read.support.min())
    first = replace(first, across=read)
    report.ran = first.believed and least < options.doubtful and read.off > options.beside
    report.reason = f"an edge reads as one to {least:.0%} at least, up to {read.off:.2%} of the film beside"
    if not report.ran:
        return first
    second = _exactly(pyramid, phases, read, config, put_on_edges(first.backward, read, options))
    again = look_across(pyramid, second.backward, reader, options)
    report.reason += f"; {float(again.support.min()):.0%} once refined from there"
    surer = second.stands and again.support.min() > least + options.surer
    report.reason += ", which counts" if surer else ", which is not surer"
    left = second.expected_px if second.believed else first.expected_px  # not believed, it starts from the first's map
    return replace(second, across=again, expected_px=left) if surer else first


def whole_sheet(
    pyramid: Pyramid,
    phases: CellPhases | None,
    refined: Refinement,
    reader: StripReader,
    config: RectifyConfig,
    clock: Clock,
) -> Refinement:
    """A refinement, or one of the sheet with margins that were taken for the ground, if its edges are sure to be there,
    its print lies in its middle and all that is seen of it agrees."""
    with clock.stage("margins") as report:
        found: list[str] = []
        while len(found) < MOST_MARGINS:
            wider = _with_margins(pyramid, phases, refined, reader, config)
            if wider is None:
                break
            refined = wider[0]
            found.append(wider[1])
        report.ran = bool(found)
        report.reason = "; ".join(found) or "the sheet does not go on beyond its map"
    return refined


def _with_margins(
    pyramid: Pyramid, phases: CellPhases | None, refined: Refinement, reader: StripReader, config: RectifyConfig
) -> tuple[Refinement, str] | None:
    """The first refinement with such margins that is to be believed, and what they are."""
    options = config.margins
    for longer in with_margins(pyramid, refined.backward, reader, config.edges, options):
        wider = _exactly(pyramid, phases, longer.read, config, longer.read.through)
        most_px = options.most_expected * max(wider.backward.mean_film_pixels())
        if wider.expected_px is None or wider.expected_px > most_px:
            continue
        if wider.grid is not None and wider.grid.lopsided > options.most_lopsided:
            continue
        across = look_across(pyramid, wider.backward, reader, config.edges)
        if longer.chance(across) >= options.sure and across.support.min() >= options.least_support:
            return replace(wider, across=across), str(longer)
    return None


def flat_itself(
    pyramid: Pyramid,
    coarse: BackwardMap,
    phases: CellPhases | None,
    refined: Refinement,
    config: RectifyConfig,
    clock: Clock,
) -> Refinement | None:
    """The photo's frame as the film's map, if the photo is a scan or a film that was flattened before."""
    with clock.stage("flat") as report:
        flat, report.reason = already_flat(pyramid, coarse, refined, partial(_exactly, pyramid, phases, None, config))
        report.ran = flat is not None
    return flat


def trusted(
    network: FilmNet,
    edges: StripReader,
    borders: StripReader,
    pyramid: Pyramid,
    seen: LastLook,
    refinement: Refinement,
    flat: bool,
    config: RectifyConfig,
    clock: Clock,
) -> tuple[Verdict, Signs]:
    """Whether the map is as good as certain, and what speaks for it and against it; the networks look once more.

    flat: whether the photo was found to be the flat film itself.
    """
    coarse = seen.inversion
    assert isinstance(coarse, Inversion)  # else there is nothing to trust
    with clock.stage("verdict") as report:
        plane = plane_of(refinement.backward.cropped((0.0, 0.0), (1 / seen.factor, 1 / seen.factor)))
        (again,) = look(network, seen.photo, [film_view(plane, config.predict.margin)])
        across = refinement.across or look_across(pyramid, refinement.backward, edges, config.edges)
        film, grid = refinement.backward, refinement.grid
        shown = 0.0 if grid is None else borders_shown(pyramid, film, grid, borders, config.refine.borders)
        look_again = again.enlarged(seen.factor)
        signs = signs_of(pyramid, seen.maps, coarse.backward, refinement, look_again, across, shown, flat)
        verdict = film_verdict(signs, config.trust)
        report.reason = verdict.reason
    return verdict, signs


def _exactly(
    pyramid: Pyramid, phases: CellPhases | None, read: EdgesRead | None, config: RectifyConfig, start: BackwardMap
) -> Refinement:
    """A map made exact, on a copy of the photo that is large enough for that. read: the edges, if they were read."""
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
    """What ``work`` makes of the map on a copy of the photo in which the film's longer side has about ``film_px``."""
    photo, (x, y) = pyramid.scaled(film_px / max(coarse.mean_film_pixels()))
    found = work(photo, coarse.cropped((0.0, 0.0), (x, y)), phases and phases.scaled((x, y)))
    up = (1.0 / x, 1.0 / y)
    grid = found.grid and replace(found.grid, vertices_photo=found.grid.vertices_photo * np.array(up))
    left = None if found.expected_px is None else found.expected_px * up[0]
    return replace(found, backward=found.backward.cropped((0.0, 0.0), up), grid=grid, expected_px=left)


def as_sure(refinements: Sequence[Refinement]) -> list[Refinement]:
    """Those that are believed and expect hardly more error than the surest: most of what went astray shows it.

    Of two nobody knows which is astray: then only the surest.
    """
    known = [(one.expected_px, one) for one in refinements if one.expected_px is not None]
    known.sort(key=lambda pair: pair[0])
    sure = [one for expected, one in known if expected <= AS_SURE * known[0][0]]
    return sure if len(sure) > 2 else sure[:1]


def ends_apart(refinements: Sequence[Refinement]) -> float | None:
    """Mean distance between two maps, the median over all pairs, in parts of the film's size; None of fewer than three.

    What leads one start astray is another thing for each, so ends that are one have hardly all been led there.
    """
    if len(refinements) < 3:
        return None
    ends = [one.backward.lattice((17, 17)) for one in refinements]
    apart = [np.linalg.norm(a - b, axis=-1).mean() for a, b in combinations(ends, 2)]
    return float(np.median(apart) / np.sqrt(np.prod(refinements[0].backward.mean_film_pixels())))


def middle(refinements: Sequence[Refinement]) -> Refinement:
    """The map on which refinements from several maps agree (their geometric median), with the evidence of the nearest.

    What leads each of them astray a little is another thing for each: their middle is more exact than most of them.
    """
    if len(refinements) == 1:
        return refinements[0]
    rows, columns = refinements[0].backward.nodes.shape[:2]
    nodes = np.stack([one.backward.resized((rows, columns)).nodes for one in refinements])
    between = geometric_median(nodes)
    nearest = refinements[int(np.argmin(np.square(nodes - between).sum(axis=(1, 2, 3))))]
    backward, grid = BackwardMap(between), nearest.grid
    if grid is not None:
        grid = replace(grid, vertices_photo=backward.photo_from_film(grid.vertices))
    return replace(nearest, backward=backward, grid=grid, across=None)
