"""Where between the sheet's edges the print lies: what most prints have in common is tried on the fitted sheet.

Only the sheet's bend determines the width of the margins, to a few thousandths of the film, and an error there bends
the sheet wrongly. But most prints fill their film, and most of the others have equal margins on both sides. Nor does
anything but the bend determine how wide cells are for their height, yet those of most prints are square, as slices are.
If a sheet explains what is seen nearly as well with such margins or cells, they are adopted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hybrid.errors import require_at_least
from hybrid.rectify.edges.outline import as_seen
from hybrid.rectify.grid.layout import Evidence, Source
from hybrid.rectify.grid.lines import Borders, Comb, GridConfig, GridLines
from hybrid.rectify.grid.repeat import Repeats
from hybrid.rectify.sheet.fit import FittedSheet
from hybrid.rectify.sheet.problem import Cell
from hybrid.rectify.sheet.shape import Sheet


@dataclass(frozen=True)
class MarginsConfig:
    """Options of the margins that are tried. Lengths are in film units.

    filling: margins are tried as none if their total width is at most this, or negative by at most this. off_middle: a
    grid whose middle lies this near the film's is tried as centred; off_middle_read: the same for borders that were
    read, whose places are less exact. costs: share by which the fit's sum of squares may grow. narrow, narrow_costs: a
    total width, and that share for margins no wider than that: hardly any film has such. sigma: prior standard
    deviation of the print's place with the margins tried. loose: lines that were taken to fill the film may be let go
    if their margins are then together this wide; loose_gain: share by which the sum of squares must then shrink.
    square: cells are tried as square if the logarithm of their height over their width is at most this, in size.
    possible_filling, possible_off, possible_costs: the same as filling, off_middle and costs where such margins are
    only possible, and have to show what they are worth in further rounds.
    """

    filling: float = 0.04
    narrow: float = 0.02
    off_middle: float = 0.006
    off_middle_read: float = 0.02
    costs: float = 0.05
    narrow_costs: float = 0.12
    sigma: float = 1e-4
    loose: float = 0.012
    loose_gain: float = 0.03
    square: float = 0.03
    possible_filling: float = 0.06
    possible_off: float = 0.05
    possible_costs: float = 0.6

    def __post_init__(self) -> None:
        require_at_least(self, 1e-6, "sigma")

    @property
    def possible(self) -> MarginsConfig:
        """The same for margins that are only possible."""
        return replace(
            self,
            filling=self.possible_filling,
            off_middle=self.possible_off,
            off_middle_read=self.possible_off,
            costs=self.possible_costs,
            narrow_costs=self.possible_costs,
        )

    def in_the_middle(self, source: Source, off: float) -> bool:
        """Whether lines or borders whose middle is this far from the film's may be centred."""
        if isinstance(source, Comb):
            return bool(off < self.off_middle)
        return isinstance(source, Borders) and bool(off < self.off_middle_read)


Fit = Callable[[Sequence[Evidence], FittedSheet | None, bool], FittedSheet | None]
"""Fits the sheet that best explains the evidence, starting from another sheet or from none. Cells are taken to be
square if they were on that sheet, or if the last argument says so."""


@dataclass(frozen=True, eq=False)
class PlacedPrint:
    """A sheet, and the evidence that it was fitted to. seen: the part of the evidence that counted."""

    sheet: FittedSheet
    evidence: tuple[Evidence, ...]
    seen: tuple[Evidence, ...]

    def along(self, axis: int) -> list[int]:
        """Indices of the evidence that tells where the print lies along an axis."""
        return [k for k, e in enumerate(self.evidence) if e.source is not None and e.source.axis == axis]


def usual_margins(found: PlacedPrint, fit: Fit, grid: GridConfig, config: MarginsConfig) -> PlacedPrint:
    """What was found, with usual margins along each axis where these explain what is seen nearly as well."""
    for axis in (0, 1):
        for usual in (_filling, _in_the_middle):
            tried = usual(found, axis, grid, config)
            if tried is None:
                continue
            placed, costs = tried
            sheet = fit(placed.seen, found.sheet, False)
            if sheet is not None and sheet.cost < (1.0 + costs) * found.sheet.cost:
                found = replace(placed, sheet=sheet)
                break
    return found


def possible_margins(found: PlacedPrint, fit: Fit, grid: GridConfig, config: MarginsConfig) -> PlacedPrint | None:
    """What was found, with usual margins also where these explain much less well what is seen, which was seen through a
    map without them; None if there are no others."""
    placed = usual_margins(found, fit, grid, config.possible)
    return None if placed is found else placed


def unfilled(found: PlacedPrint, fit: Fit, grid: GridConfig, config: MarginsConfig) -> PlacedPrint:
    """What was found, with lines along an axis no longer taken to fill the film if they then end well inside it and
    explain better what is seen: lines that end near the edges of a crooked map need not end at the film's."""
    for axis in (0, 1):
        tried = _loose(found, axis, grid)
        if tried is None:
            continue
        loose, lines = tried
        sheet = fit(loose.seen, found.sheet, False)
        if sheet is None or _margins(loose, sheet, lines) < config.loose:
            continue
        if sheet.cost < (1.0 - config.loose_gain) * found.sheet.cost:
            found = replace(loose, sheet=sheet)
    return found


def square_cells(found: PlacedPrint, fit: Fit, config: MarginsConfig) -> PlacedPrint:
    """What was found, with square cells where these explain what is seen nearly as well."""
    sheet = found.sheet
    if sheet.has_square_cells or not nearly_square(found.seen, sheet.sheet, sheet.state.constants, config):
        return found
    squared = fit(found.seen, sheet, True)
    explains = squared is not None and squared.cost < (1.0 + config.costs) * sheet.cost
    return replace(found, sheet=squared) if explains else found


def nearly_square(
    evidence: Sequence[Evidence], sheet: Sheet, constants: Float[np.ndarray, " g"] | None, config: MarginsConfig
) -> bool:
    """Whether cells are known along both axes and may be square on a sheet.

    constants: those that the sightings share, one after the other; None where they are 0.
    """
    if constants is None:
        constants = np.zeros(sum(e.sightings.shared.shape[1] for e in evidence))
    ratios = [cell.log_ratio(sheet, constants) for cell in cells_on(evidence)]
    return len(ratios) > 0 and bool(abs(np.median(ratios)) <= config.square)


def cells_on(evidence: Sequence[Evidence]) -> tuple[Cell, ...]:
    """The cells that the evidence shows: one for each two pieces of it that tell a width and a height."""
    sides: tuple[list[tuple[float, int]], list[tuple[float, int]]] = ([], [])
    first = 0
    for e in evidence:
        constants = e.sightings.shared.shape[1]
        if e.source is not None and len(e.sightings):
            sides[e.source.axis].append((_pitch(e), first + e.source.pitch_at % constants))
        first += constants
    return tuple(Cell(*width, *height) for width in sides[0] for height in sides[1])


def undecided(evidence: Sequence[Evidence], grid: GridConfig, config: MarginsConfig) -> bool:
    """Whether the print may have usual margins along some axis, but is not yet held to them."""
    sources = [e.source for e in evidence if e.source is not None]
    held = {source.axis for source in sources if _held_to_usual(source, grid)}
    return any(source.axis not in held and _nearly_usual(source, config) for source in sources)


def in_place(e: Evidence, config: MarginsConfig) -> Evidence:
    """Evidence of a print whose place is known, with that place as a prior; any other evidence unchanged."""
    if isinstance(e.source, GridLines) and e.source.centred:
        return _held(e, {0: config.sigma})
    if isinstance(e.source, Repeats) and e.source.filling:
        return _held(e, {e.source.pitch_at: config.sigma / e.source.cells})
    return e


# ---------------------------------------------------------------- what is tried, and what it may cost


def _held_to_usual(source: Source, grid: GridConfig) -> bool:
    if isinstance(source, GridLines):
        return source.centred or source.fills_film(grid)
    return source.filling


def _nearly_usual(source: Source, config: MarginsConfig) -> bool:
    filled = source.cells * source.pitch
    off = abs(source.first + 0.5 * filled - 0.5)
    return config.in_the_middle(source, off) or abs(1.0 - filled) <= config.filling


def _filling(
    found: PlacedPrint, axis: int, grid: GridConfig, config: MarginsConfig
) -> tuple[PlacedPrint, float] | None:
    """The cells from edge to edge, and what that may cost; None if they are so already, or pitch or place
    contradict."""
    which, widest = found.along(axis), 0.0
    for k in which:
        source, constants = found.evidence[k].source, found.sheet.constants[k]
        assert source is not None
        if isinstance(source, Comb):
            known, elsewhere = source.fills_film(grid), abs(constants[0]) > config.off_middle
        else:
            known, elsewhere = source.filling, False
        margins = abs(_margins(found, found.sheet, k))
        if known or elsewhere or margins > config.filling:
            return None
        widest = max(widest, margins)
    if not which:
        return None
    costs = config.narrow_costs if widest <= config.narrow else config.costs
    return _changed(found, which, lambda e: _filled(e, config)), costs


def _loose(found: PlacedPrint, axis: int, grid: GridConfig) -> tuple[PlacedPrint, int] | None:
    """The print with lines that were taken to fill the film let go, and the index of their evidence; None if there are
    no such lines. Rules along the film's edges are then no longer expected."""
    for k in found.along(axis):
        source = found.evidence[k].source
        if isinstance(source, Comb) and source.fills_film(grid):
            which = [j for j, e in enumerate(found.evidence) if e.sightings.axis == axis]
            return _changed(found, which, lambda e: _loosened(e, grid)), k
    return None


def _loosened(e: Evidence, grid: GridConfig) -> Evidence:
    """Evidence of lines or of an edge if lines need not fill the film; any other evidence unchanged."""
    if e.sightings.rule_expected:
        return replace(e, sightings=as_seen(e.sightings))
    if not isinstance(e.source, Comb):
        return e
    lines = replace(e.source, loose=True)
    place, pitch = lines.before(grid)[1]
    return _held(replace(e, source=lines), {0: place, lines.pitch_at: pitch})


def _margins(found: PlacedPrint, sheet: FittedSheet, which: int) -> float:
    """Total width of the margins on both sides, from one piece of evidence and the sheet fitted to it."""
    source = found.evidence[which].source
    assert source is not None
    return 1.0 - source.cells * (source.pitch + float(sheet.constants[which][source.pitch_at]))


def _in_the_middle(
    found: PlacedPrint, axis: int, grid: GridConfig, config: MarginsConfig
) -> tuple[PlacedPrint, float] | None:
    """Lines or borders centred, and what that may cost; None if none are seen, or they lie elsewhere."""
    for k in found.along(axis):
        source, off = found.evidence[k].source, found.sheet.constants[k][0]
        assert source is not None
        if not _held_to_usual(source, grid) and config.in_the_middle(source, abs(off)):
            return _changed(found, [k], lambda e: in_place(_centred(e), config)), config.costs
    return None


def _pitch(e: Evidence) -> float:
    """The pitch of what is printed, where the constants are 0: lines that were taken to fill the film are seen so."""
    assert e.source is not None
    if isinstance(e.source, Repeats):
        return e.source.pitch
    return e.source.adjusted(e.sightings, np.zeros(e.sightings.shared.shape[1])).pitch


def _changed(found: PlacedPrint, which: Sequence[int], change: Callable[[Evidence], Evidence]) -> PlacedPrint:
    """The same with some of the evidence changed, and likewise the part of it that counted."""
    evidence, seen = (
        tuple(change(e) if k in which else e for k, e in enumerate(each)) for each in (found.evidence, found.seen)
    )
    return replace(found, evidence=evidence, seen=seen)


def _centred(e: Evidence) -> Evidence:
    """Evidence of lines or borders whose middle is taken to be the film's."""
    assert isinstance(e.source, GridLines)
    return replace(e, source=replace(e.source, centred=True))


def _filled(e: Evidence, config: MarginsConfig) -> Evidence:
    """Evidence of cells or lines of a print that is taken to have no margins."""
    source = e.source
    assert source is not None
    known = e.sightings.known + e.sightings.shared[:, source.pitch_at] * (1.0 / source.cells - source.pitch)
    moved, filled = replace(e.sightings, known=known), replace(source, first=0.0, pitch=1.0 / source.cells)
    filled = replace(filled, loose=False) if isinstance(filled, Comb) else replace(filled, filling=True)
    if isinstance(filled, Repeats):
        return in_place(Evidence(moved, filled), config)
    return _held(Evidence(moved, filled), {0: config.sigma, filled.pitch_at: config.sigma / filled.cells})


def _held(e: Evidence, sigma: dict[int, float]) -> Evidence:
    """The same with new prior deviations for some of the shared constants."""
    deviations = e.sightings.shared_sigma.copy()
    for column, value in sigma.items():
        deviations[column] = value
    return replace(e, sightings=replace(e.sightings, shared_sigma=deviations))


__all__ = [
    "MarginsConfig",
    "PlacedPrint",
    "cells_on",
    "in_place",
    "nearly_square",
    "possible_margins",
    "square_cells",
    "undecided",
    "unfilled",
    "usual_margins",
]
