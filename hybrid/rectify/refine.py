"""A coarse backward map made exact to a fraction of a pixel by what the photo shows of the sheet and its print.

The coarse map is kept and corrected by a smooth displacement of the film plane (sightings.py): the film's shape
is the network's, only its smooth error is fitted. Sightings are the sheet's edges (outline.py), the rules or
gutters between the slices (grid.py), and what the cells have in common (repeat.py for the first two rounds, then
congeal.py). All are looked for again through the improved map, and count only if they agree: the spline is fitted
to half of them and must explain the other half better than the map before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d
from hybrid.records import SliceGrid, StageReport
from hybrid.rectify.congeal import CongealConfig, register_cells
from hybrid.rectify.film_view import FilmView, view_film
from hybrid.rectify.grid import Comb, GridConfig, find_comb, follow_comb
from hybrid.rectify.outline import OutlineConfig, find_outline
from hybrid.rectify.repeat import RepeatConfig, Repeats, cell_agreement, find_repeats, match_cells, match_to_one_cell
from hybrid.rectify.sightings import (
    Displacement,
    DisplacementFit,
    Sightings,
    SplineConfig,
    fit_displacement,
    no_displacement,
)


@dataclass(frozen=True)
class RefineConfig:
    """Options of the refinement of a coarse map."""

    outline: OutlineConfig = field(default_factory=OutlineConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    repeat: RepeatConfig = field(default_factory=RepeatConfig)
    congeal: CongealConfig = field(default_factory=CongealConfig)
    spline: SplineConfig = field(default_factory=SplineConfig)
    working_px: int = 1000
    """Longer side of the film, in pixels, at which the photo is looked at; larger films are scaled down to it."""
    near_band: float = 0.015
    """Half width of the search band for edges once the map has been improved, in film units."""
    sure_lines: float = 0.95
    """Share of the film's length on which lines must be seen if nothing repeats at their pitch."""
    rule_width: float = 0.002
    """How far a rule printed on the film's edge may shift the edge that is seen, in film units."""
    settled_move: float = 5e-4
    """A round that moves the film by less than this is the last, in film units."""
    line_rounds: int = 3
    """Rounds in which lines are looked for where they have not been found: they show better in a straighter view."""
    max_move: float = 0.08
    """Largest displacement believed, in film units."""
    min_gain: float = 0.9
    """The spline counts only if held-out sightings disagree with it by less than this fraction of before."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """A refined map, the slice grid if one was found, and what was done."""

    backward: BackwardMap
    grid: SliceGrid | None
    stages: tuple[StageReport, ...]


@dataclass(frozen=True, eq=False)
class _Scene:
    """The photo at working size and the coarse map into it."""

    photo: UInt8[np.ndarray, "H W 3"]
    grey: UInt8[np.ndarray, "H W"]
    coarse: BackwardMap
    film_size: tuple[int, int]


def refine(photo: UInt8[np.ndarray, "H W 3"], coarse: BackwardMap, config: RefineConfig) -> Refinement:
    """The coarse map, corrected where the photo shows how.

    photo: RGB, the one that ``coarse`` maps into. Returns the coarse map itself where nothing was seen, where
    the correction does not explain the photo better, or where it would fold the film or move it too far; the
    report of stage ``spline`` says which. Raises nothing on any photo.
    """
    clock = _Clock()
    scene = _working_scene(photo, coarse, config)
    outline = find_outline(scene.photo, scene.coarse, config.outline)
    displacement = no_displacement(config.spline)
    if outline:
        displacement = fit_displacement(outline, config.spline).displacement
    clock.lap("outline")

    layout, attempts = _Layout(), [_Attempt(displacement, tuple(_Evidence(s) for s in outline))]
    near = replace(config.outline, band=config.near_band)
    for number, matcher in enumerate(_matchers(config)):
        displacement = attempts[-1].displacement
        view = _view(scene, displacement)
        layout = _find_layout(view, layout, number < config.line_rounds, config)
        found = _observe_print(view, layout, matcher, outline, config)
        clock.lap("grid")
        evidence = tuple(e.lifted(displacement) for e in found)
        if number == 0:
            edges = find_outline(scene.photo, displacement.composed(scene.coarse), near)
            outline = tuple(displacement.lift(s) for s in edges)
            clock.lap("outline")
        evidence += tuple(_Evidence(_as_uncertain(s, layout, config)) for s in outline)
        if not evidence:
            return _unchanged(coarse, "no edge, rule, gutter or repeated text was seen", clock)
        fit = fit_displacement([e.sightings for e in evidence], config.spline)
        attempts.append(_Attempt(fit.displacement, evidence, fit.stiffness))
        layout = layout.adjusted(evidence, fit)
        clock.lap("spline")
        moved = float(np.abs(fit.displacement.values - displacement.values).max())
        if number >= 2 and (moved < config.settled_move or layout.is_enough):
            break
    chosen = _most_alike(scene, layout, attempts, config)
    backward, verdict = _judge(coarse, chosen, config)
    clock.lap("spline")
    edges = [e for e in chosen.evidence if e.source is None]
    stages = (
        StageReport("outline", bool(edges), f"{len(edges)} of 4 edges", clock["outline"]),
        StageReport("grid", layout.any_found, layout.reason(), clock["grid"]),
        StageReport("spline", backward is not None, verdict, clock["spline"]),
    )
    backward = coarse if backward is None else backward
    return Refinement(backward, _slice_grid(layout, backward), stages)


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Sightings and what they are of: a comb of lines, cells that repeat, or (None) the sheet's edge."""

    sightings: Sightings
    source: Comb | Repeats | None = None

    def lifted(self, displacement: Displacement) -> _Evidence:
        """As if seen through the coarse map."""
        return replace(self, sightings=displacement.lift(self.sightings))


@dataclass(frozen=True, eq=False)
class _Attempt:
    """A displacement and what it was fitted to, as seen through the coarse map."""

    displacement: Displacement
    evidence: tuple[_Evidence, ...]
    stiffness: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class _Layout:
    """What is known of the grid along u and along v."""

    combs: tuple[Comb | None, Comb | None] = (None, None)
    repeats: tuple[Repeats | None, Repeats | None] = (None, None)

    @property
    def is_enough(self) -> bool:
        """True where there are no cells to match: lines have been looked for thrice, and more rounds find no more."""
        return not self.settled

    @property
    def settled(self) -> bool:
        """True where repetition was seen along both axes, so that cells can be matched."""
        return all(r is not None for r in self.repeats)

    @property
    def any_found(self) -> bool:
        """True where lines or repetition were found along any axis."""
        return any(x is not None for x in (*self.combs, *self.repeats))

    def along(self, axis: int) -> Comb | Repeats | None:
        """What is best known along one axis."""
        return self.combs[axis] if self.combs[axis] is not None else self.repeats[axis]

    def adjusted(self, evidence: Sequence[_Evidence], fit: DisplacementFit) -> _Layout:
        """With the places and pitches that the fit found; lines are straight through the map that it gives."""
        combs, repeats = list(self.combs), list(self.repeats)
        for e, constants in zip(evidence, fit.constants, strict=True):
            if isinstance(e.source, Comb):
                combs[e.source.axis] = e.source.adjusted(e.sightings, constants).straight()
            elif isinstance(e.source, Repeats):
                repeats[e.source.axis] = e.source.adjusted(constants)
        return _Layout((combs[0], combs[1]), (repeats[0], repeats[1]))

    def reason(self) -> str:
        """What was found, for the report."""
        found = []
        for axis, name in ((0, "columns"), (1, "rows")):
            best = self.along(axis)
            how = "lines" if isinstance(best, Comb) else "repetition"
            found.append(f"{best.cells} {name} by {how}" if best is not None else f"no {name} seen")
        return ", ".join(found)


class _Clock:
    """Seconds spent in each stage."""

    def __init__(self) -> None:
        self._last = perf_counter()
        self._spent: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        """Books the time since the last call on a stage."""
        now = perf_counter()
        self._spent[stage] = self._spent.get(stage, 0.0) + now - self._last
        self._last = now

    def __getitem__(self, stage: str) -> float:
        return self._spent.get(stage, 0.0)


# ---------------------------------------------------------------- steps


def _matchers(config: RefineConfig) -> list[Callable[..., tuple[Sightings, ...]]]:
    """How cells are matched, round for round: ever less far and ever more exactly."""
    far = partial(match_to_one_cell, search=config.repeat.first, config=config.repeat)
    nearer = partial(match_cells, search=config.repeat.second, config=config.repeat)
    return [far, nearer, *(partial(register_cells, blur_px=b, config=config.congeal) for b in config.congeal.blurs_px)]


def _working_scene(photo: UInt8[np.ndarray, "H W 3"], coarse: BackwardMap, config: RefineConfig) -> _Scene:
    """The photo scaled down, if need be, until the film's longer side has ``working_px`` pixels."""
    film_px = max(coarse.mean_film_pixels())
    if film_px > 1.15 * config.working_px:
        scale = config.working_px / film_px
        height, width = photo.shape[:2]
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        photo = cv2.resize(photo, size, interpolation=cv2.INTER_AREA)
        coarse = coarse.cropped((0.0, 0.0), (size[0] / width, size[1] / height))
    down, across = coarse.mean_film_pixels()
    film_size = (int(np.clip(round(down), 64, 4096)), int(np.clip(round(across), 64, 4096)))
    return _Scene(photo, cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY), coarse, film_size)


def _view(scene: _Scene, displacement: Displacement) -> FilmView:
    """The flat grey film as the displaced map sees it."""
    height, width = scene.film_size
    return view_film(scene.grey, displacement.composed(scene.coarse), film_centres_1d(width), film_centres_1d(height))


def _find_layout(view: FilmView, known: _Layout, looking: bool, config: RefineConfig) -> _Layout:
    """What is found of the grid in this view, added to what was known; lines only if ``looking`` for them.

    Lines that contradict the repeats are dropped: tables and bones make lines too.
    """
    grey = view.image[..., 0]
    combs, repeats = list(known.combs), list(known.repeats)
    for axis in (0, 1):
        if repeats[axis] is None:
            repeats[axis] = find_repeats(grey, axis, config.repeat)
        comb, repeat = combs[axis], repeats[axis]
        if looking and (comb is None or len(comb.seen) <= comb.cells):
            around = (0.94 * repeat.pitch, 1.06 * repeat.pitch) if repeat is not None else (0.0, 1.0)
            found = find_comb(grey, axis, config.grid, around)
            if found is not None and _plausible(found, repeat, config):
                comb = found if comb is None or len(found.seen) > len(comb.seen) else comb
        if comb is not None and follow_comb(view, comb, config.grid) is None:
            comb = None
        combs[axis] = comb
    return _Layout((combs[0], combs[1]), (repeats[0], repeats[1]))


def _plausible(comb: Comb, repeat: Repeats | None, config: RefineConfig) -> bool:
    """True where the cells repeat at the comb's pitch or, if no repetition is seen, several lines are unbroken."""
    if repeat is None:
        return comb.cells > 2 and comb.strength >= config.sure_lines
    return abs(comb.pitch - repeat.pitch) < 0.04 * repeat.pitch


def _observe_print(
    view: FilmView,
    layout: _Layout,
    matcher: Callable[..., tuple[Sightings, ...]],
    outline: Sequence[Sightings],
    config: RefineConfig,
) -> list[_Evidence]:
    """Sightings of lines, and of what the cells have in common.

    Where both edges across an axis are seen they say where the lines are, unless the grid fills the film: what is
    straight and repeats need not lie where cells meet.
    """
    evidence = []
    for comb in layout.combs:
        sightings = follow_comb(view, comb, config.grid) if comb is not None else None
        if comb is None or sightings is None:
            continue
        pinned = sum(edge.axis == comb.axis for edge in outline) == 2
        if pinned and not (comb.sign > 0 and comb.fills_film(config.grid)):
            sightings = replace(sightings, shared_sigma=np.full(2, config.congeal.shared_sigma))
        evidence.append(_Evidence(sightings, comb))
    columns, rows = layout.repeats
    if columns is not None and rows is not None:
        evidence += [_Evidence(s, layout.repeats[s.axis]) for s in matcher(view, columns, rows)]
    return evidence


def _as_uncertain(edge: Sightings, layout: _Layout, config: RefineConfig) -> Sightings:
    """An edge on which a rule may be printed: next to a bright background its step is the rule's inner side.

    Its shape counts, its place only within a rule's width: where the lines' pitch tells the place better.
    """
    comb = layout.combs[edge.axis]
    if comb is None or comb.sign < 0 or not comb.fills_film(config.grid):
        return edge
    return replace(edge, shared=np.ones((len(edge), 1)), shared_sigma=np.array([config.rule_width]))


def _most_alike(scene: _Scene, layout: _Layout, attempts: list[_Attempt], config: RefineConfig) -> _Attempt:
    """Of no displacement, the outline's and the last two, that through which the cells look most alike.

    The last where cells were not matched.
    """
    columns, rows = layout.repeats
    if columns is None or rows is None:
        return attempts[-1]
    candidates = [_Attempt(no_displacement(config.spline), ()), attempts[0], *attempts[1:][-2:]]
    return max(candidates, key=lambda a: cell_agreement(_view(scene, a.displacement), columns, rows))


def _judge(coarse: BackwardMap, attempt: _Attempt, config: RefineConfig) -> tuple[BackwardMap | None, str]:
    """The corrected map if it is to be believed, and why or why not."""
    if not attempt.evidence:
        return None, "the cells look most alike through the coarse map"
    stiffness = max(*attempt.stiffness, config.spline.stiffness[0])
    same = replace(config.spline, stiffness=(stiffness, stiffness, 1))
    before, after = held_out_residuals([e.sightings for e in attempt.evidence], same)
    size = tuple(max(33, n) for n in coarse.nodes.shape[:2])
    move = float(np.linalg.norm(attempt.displacement.values, axis=1).max())
    if after > config.min_gain * before:
        return None, f"held-out residual {after:.2f} sigma against {before:.2f} before: no better"
    if move > config.max_move:
        return None, f"the film would move by {move:.3f} of its size"
    backward = attempt.displacement.composed(coarse, (size[0], size[1]))
    if backward.folds() and not coarse.folds():
        return None, "the film would fold"
    return backward, f"held-out residual {before:.1f} -> {after:.1f} sigma, moved by up to {100 * move:.1f} %"


def held_out_residuals(sightings: Sequence[Sightings], config: SplineConfig, folds: int = 2) -> tuple[float, float]:
    """Mean clipped residual in stated deviations, before and after, of sightings that the spline did not see.

    Runs of neighbouring sightings are held out together, because neighbours share their errors. The constants
    that a list shares are taken from the sightings that the spline did see.
    """
    clip = 20.0
    before, after, count = 0.0, 0.0, 0
    for fold in range(folds):
        out = [np.arange(len(s)) // 8 % folds == fold for s in sightings]
        fit = fit_displacement([s.subset(~o) for s, o in zip(sightings, out, strict=True)], config)
        for s, o, constants in zip(sightings, out, fit.constants, strict=True):
            held = s.subset(o)
            if not len(held):
                continue
            predicted = fit.displacement(held.places())[:, held.axis] - held.places()[:, held.axis]
            offsets = held.offsets() - held.shared @ constants
            before += np.minimum(np.abs(_without_shared(held)) / held.sigma, clip).sum()
            after += np.minimum(np.abs(offsets - predicted) / held.sigma, clip).sum()
            count += len(held)
    return (before / count, after / count) if count else (0.0, 0.0)


def _without_shared(sightings: Sightings) -> Float[np.ndarray, " n"]:
    """Offsets less what the shared constants alone can explain: what is left if nothing is displaced."""
    if sightings.shared.shape[1] == 0:
        return sightings.offsets()
    best, *_ = np.linalg.lstsq(sightings.shared, sightings.offsets(), rcond=None)
    return sightings.offsets() - sightings.shared @ best


# ---------------------------------------------------------------- reports


def _slice_grid(layout: _Layout, backward: BackwardMap) -> SliceGrid | None:
    """The grid of slices; None where an axis shows neither lines nor repetition."""
    columns, rows = (layout.along(axis) for axis in (0, 1))
    if columns is None or rows is None:
        return None
    u, v = np.meshgrid(np.clip(columns.lines(), 0.0, 1.0), np.clip(rows.lines(), 0.0, 1.0))
    vertices = np.stack([u, v], axis=-1)
    trust = [a.strength if isinstance(a, Comb) else a.correlation for a in (columns, rows)]
    confidence = float(np.clip(min(trust), 0.0, 1.0))
    return SliceGrid(rows.cells, columns.cells, vertices, backward.photo_from_film(vertices), confidence)


def _unchanged(coarse: BackwardMap, reason: str, clock: _Clock) -> Refinement:
    stages = tuple(StageReport(name, False, reason, clock[name]) for name in ("outline", "grid", "spline"))
    return Refinement(coarse, None, stages)


__all__ = ["RefineConfig", "Refinement", "held_out_residuals", "refine"]
