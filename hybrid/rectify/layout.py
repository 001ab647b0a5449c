"""What is known of the grid of slices: along each axis lines (grid.py), repetition (repeat.py), both, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid.backward import BackwardMap
from hybrid.records import SliceGrid
from hybrid.rectify.film_view import FilmView
from hybrid.rectify.follow import follow_comb
from hybrid.rectify.grid import Comb, GridConfig, find_comb
from hybrid.rectify.repeat import RepeatConfig, Repeats, find_repeats
from hybrid.rectify.sightings import Displacement, Sightings

GOOD_SHARE = 0.0025
"""Expected error of the map, in parts of the film, from which on a grid is trusted less: about 2 px of a photo."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Sightings and what they are of: a comb of lines, cells that repeat, or (None) the sheet's edge."""

    sightings: Sightings
    source: Comb | Repeats | None = None

    def lifted(self, displacement: Displacement) -> Evidence:
        """As if seen through the coarse map."""
        return replace(self, sightings=displacement.lift(self.sightings))


@dataclass(frozen=True, eq=False)
class Layout:
    """What is known of the grid along u and along v."""

    combs: tuple[Comb | None, Comb | None] = (None, None)
    repeats: tuple[Repeats | None, Repeats | None] = (None, None)

    @property
    def is_enough(self) -> bool:
        """True where there are no cells to match: lines have been looked for twice, and more rounds find no more."""
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

    def adjusted(self, evidence: Sequence[Evidence], found: Sequence[np.ndarray]) -> Layout:
        """With the places and pitches that a fit found: the constants that each of the sightings share. Lines are
        straight through the map that it gives."""
        combs, repeats = list(self.combs), list(self.repeats)
        for e, constants in zip(evidence, found, strict=True):
            if isinstance(e.source, Comb):
                combs[e.source.axis] = e.source.adjusted(e.sightings, constants).straight()
            elif isinstance(e.source, Repeats):
                repeats[e.source.axis] = e.source.adjusted(constants)
        return Layout((combs[0], combs[1]), (repeats[0], repeats[1]))

    def reason(self) -> str:
        """What was found, for the report."""
        found = []
        for axis, name in ((0, "columns"), (1, "rows")):
            best = self.along(axis)
            how = "lines" if isinstance(best, Comb) else "repetition"
            found.append(f"{best.cells} {name} by {how}" if best is not None else f"no {name} seen")
        return ", ".join(found)

    def slice_grid(self, backward: BackwardMap, expected: float) -> SliceGrid | None:
        """The grid of slices; None where an axis shows neither lines nor repetition.

        expected: error of the map, in parts of the film: vertices lie no better than that.
        """
        columns, rows = (self.along(axis) for axis in (0, 1))
        if columns is None or rows is None:
            return None
        u, v = np.meshgrid(np.clip(columns.lines(), 0.0, 1.0), np.clip(rows.lines(), 0.0, 1.0))
        vertices = np.stack([u, v], axis=-1)
        trust = min(_trust(columns), _trust(rows)) * min(1.0, GOOD_SHARE / expected)
        return SliceGrid(rows.cells, columns.cells, vertices, backward.photo_from_film(vertices), trust)


def _trust(best: Comb | Repeats) -> float:
    """How sure the cells along one axis are, in [0, 1]: lines of which one is missing say less, and repetition tells
    where cells begin only where they fill the film."""
    if isinstance(best, Comb):
        return best.strength if len(best.seen) > best.cells else 0.7 * best.strength
    return 0.75 if best.cells * best.pitch > 0.998 else 0.4


def find_layout(
    view: FilmView, known: Layout, looking: bool, grid: GridConfig, repeat: RepeatConfig
) -> tuple[Layout, tuple[Sightings | None, Sightings | None]]:
    """What is found of the grid in this view, added to what was known, and the sightings of the lines of each axis.

    Lines are only followed unless ``looking`` for them. Lines that contradict the repeats are dropped: tables and
    bones make lines too.
    """
    grey = view.image[..., 0]
    repeats = [r or find_repeats(grey, axis, repeat) for axis, r in enumerate(known.repeats)]
    combs, followed = list(known.combs), []
    for axis, repeated in enumerate(repeats):
        comb = combs[axis]
        if looking and (comb is None or len(comb.seen) <= comb.cells):
            around = (0.94 * repeated.pitch, 1.06 * repeated.pitch) if repeated is not None else (0.0, 1.0)
            found = find_comb(grey, axis, grid, around)
            if found is not None and _plausible(found, repeated, grid):
                comb = found if comb is None or len(found.seen) > len(comb.seen) else comb
        followed.append(follow_comb(view, comb, grid) if comb is not None else None)
        combs[axis] = comb if followed[axis] is not None else None
        repeats[axis] = _in_step(repeated, combs[axis])
    return Layout((combs[0], combs[1]), (repeats[0], repeats[1])), (followed[0], followed[1])


def _in_step(repeat: Repeats | None, comb: Comb | None) -> Repeats | None:
    """The cells that repeat, between the lines where there are lines: repetition does not tell where cells begin."""
    if comb is None or repeat is None:
        return repeat
    return Repeats(comb.axis, comb.first, comb.pitch, comb.cells)


def _plausible(comb: Comb, repeat: Repeats | None, config: GridConfig) -> bool:
    """True where the cells repeat at the comb's pitch or, if no repetition is seen, several lines are unbroken."""
    if repeat is None:
        return comb.cells > 2 and comb.strength >= config.sure_share
    return comb.strength >= config.believed_share and abs(comb.pitch - repeat.pitch) < 0.04 * repeat.pitch


__all__ = ["Evidence", "Layout", "find_layout"]
