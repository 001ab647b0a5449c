"""From one map to start from, round by round, to a map that is supported by what is seen on the film.

The start is kept and corrected by a smooth displacement of the film plane (splines/displacement.py). Sightings are the
sheet's edges (edges/outline.py), the rules or gutters between the slices (grid/lines.py) or else the borders that
BorderNet reads there (grid/borders.py), and what the cells have in common (grid/match.py in the first round, then
grid/congeal.py). All are looked for again through the improved map, and count only if they agree: the spline is fitted
to half of them and must explain the other half.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap, mean_move
from hybrid.film_view import FilmView
from hybrid.pyramid import Photo
from hybrid.rectify.edges.outline import expecting_rule, find_outline
from hybrid.rectify.grid.borders import held_to, places_along, read_borders
from hybrid.rectify.grid.cells import Reading, read_cells
from hybrid.rectify.grid.congeal import register_cells
from hybrid.rectify.grid.layout import Evidence, Layout, find_lines, find_repeating
from hybrid.rectify.grid.lines import GridLines
from hybrid.rectify.grid.match import match_cells
from hybrid.rectify.grid.phases import AxisPhases, CellPhases
from hybrid.rectify.grid.repeat import cell_agreement
from hybrid.rectify.grid.rim import without_background
from hybrid.rectify.margins.placing import (
    PlacedPrint,
    cells_on,
    in_place,
    nearly_square,
    possible_margins,
    square_cells,
    undecided,
    unfilled,
    usual_margins,
)
from hybrid.rectify.refine.config import RefineConfig
from hybrid.rectify.refine.scene import Scene, half_view, phases_along, view_of
from hybrid.rectify.sheet.fit import FittedSheet, fit_sheet
from hybrid.rectify.splines.displacement import Displacement, SplineConfig, fit_displacement, no_displacement
from hybrid.rectify.splines.held_out import held_out_residuals
from hybrid.rectify.splines.sightings import Sightings, carried
from hybrid.stages import Stopwatch

COUNTED_WHOLE_PX = 500
"""Views whose longer side has fewer pixels are not halved to count cells (grid/cells.py): too little would be left."""


@dataclass(frozen=True, eq=False)
class Course:
    """The result of all rounds.

    displacement: of the start; zero where no better one is believed. layout: of the grid. evidence: what was seen,
    through the start. before, after: held-out residual of the start and of the result, in stated deviations.
    believed: whether what was seen supports the result. sheet: the one that the result is based on, if a sheet explains
    the print. verdict: why it is believed or not. apart: mean distance between the result of the free rounds and that
    of the sheet, up to a shift, in parts of the film; None where there is no such sheet, 0 where none is tried
    (verdict/trust.py is calibrated so).
    """

    scene: Scene
    displacement: Displacement
    layout: Layout
    evidence: tuple[Evidence, ...]
    before: float
    after: float
    believed: bool
    sheet: FittedSheet | None
    verdict: str
    apart: float | None = None

    @cached_property
    def film(self) -> BackwardMap:
        """The resulting map, into the scene's photo."""
        return self.displacement.composed(self.scene.coarse)

    @cached_property
    def half_view(self) -> FilmView:
        """The film through that map, at half the size."""
        return half_view(self.scene, self.film)

    @property
    def counted_view(self) -> FilmView:
        """The view in which cells are counted at the end: the one of half the size, unless that leaves too little."""
        small = max(self.scene.film_size) < COUNTED_WHOLE_PX
        return view_of(self.scene, self.film) if small else self.half_view

    @property
    def edges(self) -> int:
        """Number of the sheet's edges that were seen."""
        return sum(e.source is None for e in self.evidence)


@dataclass(frozen=True, eq=False)
class _Attempt:
    """A displacement and the evidence that a round fitted it to, as seen through the coarse map; none at the start."""

    displacement: Displacement
    evidence: tuple[Evidence, ...] = ()
    weights: tuple[Float[np.ndarray, " _"], ...] = ()
    stiffness: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Progress:
    """What is known after some rounds.

    outline, borders, attempt: as seen through the scene's map; borders are read only once through it. settled: whether
    the last round moved nothing. sheet: the one that gave the scene's map, where a sheet explains the print. sheets:
    how many have been fitted.
    """

    scene: Scene
    outline: tuple[Sightings, ...]
    attempt: _Attempt
    layout: Layout = field(default_factory=Layout)
    borders: tuple[Evidence, ...] = ()
    settled: bool = False
    sheet: FittedSheet | None = None
    sheets: int = 0

    @cached_property
    def film(self) -> BackwardMap:
        """The current map, into the scene's photo."""
        return self.attempt.displacement.composed(self.scene.coarse)

    @property
    def margins_are_next(self) -> bool:
        """Whether the next sheet is the one with which usual margins are tried: the first is too far off to show them,
        and the third shows what the second did."""
        return self.sheets == 1

    def is_last(self, config: RefineConfig) -> bool:
        """Whether no further sheet can change anything: the last round moved nothing, and neither margins nor the shape
        of the cells are in question."""
        return self.settled and not (self.margins_are_next and self._in_question(config))

    def _in_question(self, config: RefineConfig) -> bool:
        """Whether what most prints have in common would be tried with a further sheet."""
        evidence, sheet = self.attempt.evidence, self.sheet
        may_be_square = sheet is not None and nearly_square(evidence, sheet.sheet, None, config.margins)
        return may_be_square or undecided(evidence, config.grid, config.margins.possible)


def begin(scene: Scene, outline: Sequence[Sightings], config: RefineConfig) -> Progress:
    """The state before the first round. outline: the edges as seen through the scene's map."""
    displacement = no_displacement(config.spline)
    if outline:
        displacement = fit_displacement(outline, config.spline).displacement
    return Progress(scene, tuple(outline), _Attempt(displacement))


def followed(progress: Progress, config: RefineConfig, watch: Stopwatch) -> Progress | None:
    """The state after all rounds, or after fewer if they settle earlier. None where nothing is seen."""
    for number, matcher in enumerate(_matchers(config)):
        after = _round(progress, number, matcher, config, watch)
        if after is None or after.settled:
            return after
        progress = after
    return progress


def _round(
    progress: Progress,
    number: int,
    matcher: Callable[..., tuple[Sightings, ...]],
    config: RefineConfig,
    watch: Stopwatch,
) -> Progress | None:
    """One more round: the print is looked for through the improved map, and everything is fitted anew."""
    scene, outline, displacement = progress.scene, progress.outline, progress.attempt.displacement
    looking = number < config.line_rounds
    near = progress.film
    view, known = view_of(scene, near), progress.layout
    if number == 0:
        known = replace(known, read=read_view(view, known, phases_along(scene, near), scene.aspect, config))
    known = find_repeating(view, known, config.repeat)
    read = [] if progress.borders else told_borders(scene.photo, near, known, scene.phases, config)
    layout, lines = find_lines(view, known, looking, places_along(read), config.grid)
    found = _observe_print(view, layout, lines, matcher, outline, config)
    borders = progress.borders or tuple(e.lifted(displacement) for e in read)
    watch.lap("grid")
    evidence = tuple(e.lifted(displacement) for e in found)
    unseen = (e for e in borders if layout.combs[e.sightings.axis] is None)
    evidence += tuple(_placed(held_to(layout, e, config.grid), outline, config) for e in unseen)
    if number == 0:
        edges = find_outline(scene.photo, near, config.outline_again, carried(scene.edges, scene.coarse, near))
        outline = tuple(displacement.lift(s) for s in edges)
        watch.lap("outline")
    evidence += tuple(Evidence(_as_uncertain(s, layout, config)) for s in outline)
    if not evidence:
        return None
    fit = fit_displacement([e.sightings for e in evidence], _spline(progress, config))
    layout = layout.adjusted(evidence, fit.constants)
    watch.lap("spline")
    moved = float(np.abs(fit.displacement.values - displacement.values).max())
    attempt = _Attempt(fit.displacement, evidence, fit.weights, fit.stiffness)
    least = config.settled_move if progress.sheet is None else config.settled_sheet
    settled = number >= 1 and (moved < least or (progress.sheet is None and not layout.has_cells))
    return replace(progress, outline=outline, borders=borders, attempt=attempt, layout=layout, settled=settled)


@dataclass(frozen=True, eq=False)
class NextSheets:
    """The unstretched sheets that explain what the last round saw. likeliest: None where there is none, or where all
    has settled and other margins move nothing. possible: one with usual margins that explains it less well."""

    likeliest: PlacedPrint | None = None
    possible: PlacedPrint | None = None


def next_sheets(progress: Progress, config: RefineConfig, watch: Stopwatch) -> NextSheets:
    """The sheets to go on from after the last round."""
    attempt, scene, options = progress.attempt, progress.scene, config.margins
    seen = tuple(e.subset(w > config.counts) for e, w in zip(attempt.evidence, attempt.weights, strict=True))
    if sum(e.source is None for e in attempt.evidence) < config.sheet.least_edges:
        return NextSheets()
    near = progress.film
    size = (scene.photo.shape[0], scene.photo.shape[1])

    def fit(seen: Sequence[Evidence], before: FittedSheet | None, square: bool) -> FittedSheet | None:
        still_square = before is not None and before.has_square_cells
        cells = cells_on(seen) if square or still_square else ()
        return fit_sheet(near, scene.coarse, size, [e.sightings for e in seen], config.sheet, before, cells)

    sheet = fit(seen, progress.sheet, False)
    watch.lap("sheet")
    if sheet is None:
        return NextSheets()
    placed = PlacedPrint(sheet, attempt.evidence, seen)
    if progress.sheet is None:
        placed = unfilled(placed, fit, config.grid, options)
    if not progress.margins_are_next:
        return NextSheets(placed)
    placed = usual_margins(placed, fit, config.grid, options)
    possible = possible_margins(placed, fit, config.grid, options)
    placed = square_cells(placed, fit, options)
    watch.lap("sheet")

    def moved(other: PlacedPrint, film: BackwardMap) -> bool:
        return mean_move(film, other.sheet.backward) >= config.settled_margins

    likeliest = placed if not progress.settled or moved(placed, sheet.backward) else None
    return NextSheets(likeliest, possible if possible and moved(possible, placed.sheet.backward) else None)


def unstretched(progress: Progress, placed: PlacedPrint, config: RefineConfig, watch: Stopwatch) -> Progress | None:
    """One more round, from the map of an unstretched sheet that explains what the last round saw; None where it folds,
    or where nothing is seen through it."""
    scene, near = progress.scene, progress.film
    sheet = placed.sheet
    if sheet.backward.folds((33, 33)):
        return None
    layout = progress.layout.adjusted(placed.evidence, sheet.constants)
    borders: tuple[Evidence, ...] = ()
    if progress.sheet is None:
        read = carried(scene.edges, scene.coarse, sheet.backward)
        outline = find_outline(scene.photo, sheet.backward, config.outline_again, read)
    else:
        outline = carried(progress.outline, scene.coarse, sheet.backward)
        moved = carried([e.sightings for e in progress.borders], scene.coarse, sheet.backward)
        borders = tuple(replace(e, sightings=s) for e, s in zip(progress.borders, moved, strict=True))
    scene = replace(scene, coarse=sheet.backward, edges=())  # from now on edges are carried, not looked for
    watch.lap("sheet")
    still = _Attempt(no_displacement(config.spline))
    begun = Progress(scene, outline, still, layout, borders, sheet=sheet, sheets=progress.sheets + 1)
    after = _round(begun, max(config.line_rounds, 1), _matchers(config)[-1], config, watch)
    if after is None or progress.sheet is None:
        return after
    return replace(after, settled=after.settled or mean_move(near, after.film) < config.settled_end)


def ended(progress: Progress, config: RefineConfig, watch: Stopwatch) -> Course:
    """The result of the last round, whether it is believed, and why or why not."""
    scene, sheet, still = progress.scene, progress.sheet, no_displacement(config.spline)
    attempt = progress.attempt
    spline = replace(_spline(progress, config), stiffness=_fixed(attempt.stiffness, config))
    before, after = held_out_residuals([e.sightings for e in attempt.evidence], spline)
    move = float(np.linalg.norm(attempt.displacement.values, axis=1).max())
    moved, believed = attempt.displacement, False
    if after > config.max_residual:
        verdict = f"held-out residual {after:.1f} sigma: what is seen on the film contradicts itself"
    elif sheet is None and after > config.min_gain * before:
        verdict = f"held-out residual {after:.2f} sigma against {before:.2f} before: no better"
        moved, believed = still, True
    elif move > config.max_move:
        verdict = f"the film would move by {move:.3f} of its size"
    elif moved.composed(scene.coarse).folds((33, 33)) and not scene.coarse.folds((33, 33)):
        verdict = "the film would fold"
    else:
        verdict = f"held-out residual {before:.1f} -> {after:.1f} sigma, moved by up to {100 * move:.1f} %"
        believed = True
    shift = moved if believed else still
    watch.lap("spline")
    return Course(scene, shift, progress.layout, attempt.evidence, before, after, believed, sheet, verdict)


def agreement(course: Course, layouts: Sequence[Layout]) -> float:
    """How alike the cells look through a course's map, in [0, 1], with the layout in which they look most alike; 0
    where no layout has cells."""
    known = [(columns, rows) for columns, rows in (layout.repeats for layout in layouts) if columns and rows]
    return max((cell_agreement(course.half_view, *cells) for cells in known), default=0.0)


def read_view(
    view: FilmView,
    layout: Layout,
    told: tuple[AxisPhases, AxisPhases] | None,
    aspect: float,
    config: RefineConfig,
) -> Reading | None:
    """The cells of the film in a view of it. told: what the network says about them, through the same map. aspect: the
    film's height over its width."""
    return read_cells(view.image[..., 0], aspect, layout.pitches(), told, config.grid, config.cells)


def told_borders(
    photo: Photo, film: BackwardMap, layout: Layout, phases: CellPhases | None, config: RefineConfig
) -> list[Evidence]:
    """Borders between cells as they are read through a map into a photo; none without a reader."""
    reader = None if phases is None else phases.borders
    return [] if reader is None else read_borders(photo, film, layout, reader, config.grid, config.borders)


# ---------------------------------------------------------------- steps


def _matchers(config: RefineConfig) -> list[Callable[..., tuple[Sightings, ...]]]:
    """How cells are matched, round by round: with ever shorter reach and ever more exactly."""
    match = [partial(match_cells, config=config.match)] if config.matched else []
    return match + [partial(register_cells, blur_px=b, config=config.congeal) for b in config.congeal.blurs_px]


def _observe_print(
    view: FilmView,
    layout: Layout,
    lines: tuple[Sightings | None, Sightings | None],
    matcher: Callable[..., tuple[Sightings, ...]],
    outline: Sequence[Sightings],
    config: RefineConfig,
) -> list[Evidence]:
    """Sightings of lines, and of what the cells have in common.

    Where both edges across an axis are seen, they tell where the lines are, unless the grid fills the film: straight
    lines that repeat need not lie where cells meet. A grid that fills the film ends at the film's edges if these have
    rules along them; with a frame, it ends inside them.
    """
    seen = zip(layout.combs, lines, strict=True)
    evidence = [_placed(Evidence(s, comb), outline, config) for comb, s in seen if comb is not None and s is not None]
    columns, rows = layout.repeats
    if columns is not None and rows is not None:
        clean = without_background(view, layout, config.rim)
        alike = (Evidence(s, layout.repeats[s.axis]) for s in matcher(clean, columns, rows))
        evidence += [in_place(e, config.margins) for e in alike]
    return evidence


def _placed(e: Evidence, outline: Sequence[Sightings], config: RefineConfig) -> Evidence:
    """Evidence of lines, with priors of their place and pitch from margins and the edges that are seen."""
    assert isinstance(e.source, GridLines)
    lines, across = e.source, [edge for edge in outline if edge.axis == e.source.axis]
    place, pitch, *others = e.sightings.shared_sigma
    if lines.fills_film(config.grid) and not any(edge.has_frame for edge in across):
        if any(edge.has_rule for edge in across):
            place, pitch = config.grid.flush_sigma, config.grid.flush_sigma / lines.cells
    elif len(across) == 2:
        place = pitch = config.congeal.shared_sigma
    placed = replace(e, sightings=replace(e.sightings, shared_sigma=np.array([place, pitch, *others])))
    return in_place(placed, config.margins)


def _as_uncertain(edge: Sightings, layout: Layout, config: RefineConfig) -> Sightings:
    """An edge that may have a rule along it that was not told apart from the edge (edges/profile.py): next to a bright
    background the step that is seen is the rule's inner side.

    Its shape counts, but its place only to within a rule's width: this holds where the lines' pitch tells the place
    better.
    """
    comb = layout.combs[edge.axis]
    if len(edge.shared_sigma) or edge.has_frame or comb is None or comb.sign < 0 or not comb.fills_film(config.grid):
        return edge
    return expecting_rule(edge, config.rule_width)


def _spline(progress: Progress, config: RefineConfig) -> SplineConfig:
    """The displacement's options: the map of a sheet that explains the print may be displaced less."""
    return config.spline if progress.sheet is None else replace(config.spline, prior_px=config.sheet_prior_px)


def _fixed(found: tuple[float, float], config: RefineConfig) -> tuple[float, float, int]:
    """As SplineConfig.stiffness: the one that the evidence chose, and no other."""
    stiffness = max(*found, config.spline.stiffness[0])
    return stiffness, stiffness, 1


__all__ = [
    "Course",
    "NextSheets",
    "Progress",
    "agreement",
    "begin",
    "ended",
    "followed",
    "next_sheets",
    "read_view",
    "told_borders",
    "unstretched",
]
