"""What is known of the grid of slices along each axis: lines (grid/lines.py), repetition (grid/repeat.py), or both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.film_view import FilmView
from hybrid.records import SliceGrid
from hybrid.rectify.grid.cells import SAME_PLACE, Reading
from hybrid.rectify.grid.follow import follow_comb
from hybrid.rectify.grid.lines import Borders, Comb, GridConfig, find_comb
from hybrid.rectify.grid.repeat import RepeatConfig, Repeats, find_repeats
from hybrid.rectify.splines.displacement import Displacement
from hybrid.rectify.splines.sightings import Sightings

GOOD_SHARE = 0.0025
"""Expected error of the map, as a fraction of the film, above which a grid is trusted less: about 2 px of a photo."""


Places = Float[np.ndarray, " _"]
"""Film coordinates across one axis."""

Source = Comb | Borders | Repeats
"""What sightings of the print are of: it gives the places of the cells along an axis."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Sightings and what they are of: a comb of lines, borders that were read, cells that repeat, or (None) the sheet's
    edge."""

    sightings: Sightings
    source: Source | None = None

    def lifted(self, displacement: Displacement) -> Evidence:
        """The same, as if seen through the coarse map."""
        return replace(self, sightings=displacement.lift(self.sightings))

    def subset(self, chosen: np.ndarray) -> Evidence:
        """The chosen sightings only."""
        return replace(self, sightings=self.sightings.subset(chosen))


@dataclass(frozen=True, eq=False)
class Layout:
    """What is known about the grid along u and along v: lines that were seen, borders that were read where there are no
    lines, cells that repeat. read: the cells as they were read at the first look."""

    combs: tuple[Comb | None, Comb | None] = (None, None)
    borders: tuple[Borders | None, Borders | None] = (None, None)
    repeats: tuple[Repeats | None, Repeats | None] = (None, None)
    read: Reading | None = None

    @property
    def has_cells(self) -> bool:
        """True if repetition was seen along both axes, so that cells can be matched. If not, rounds after the two that
        look for lines find nothing more."""
        return all(r is not None for r in self.repeats)

    def along(self, axis: int) -> Source | None:
        """The best source known along one axis."""
        return self.combs[axis] or self.borders[axis] or self.repeats[axis]

    def adjusted(self, evidence: Sequence[Evidence], found: Sequence[np.ndarray]) -> Layout:
        """The same with the places and pitches that a fit found: the constants shared by each list of sightings. Lines
        are straight through the fitted map."""
        combs, borders, repeats = list(self.combs), list(self.borders), list(self.repeats)
        for e, constants in zip(evidence, found, strict=True):
            if isinstance(e.source, Comb):
                combs[e.source.axis] = e.source.adjusted(e.sightings, constants).straight()
            elif isinstance(e.source, Borders):
                borders[e.source.axis] = e.source.adjusted(e.sightings, constants)
            elif isinstance(e.source, Repeats):
                repeats[e.source.axis] = e.source.adjusted(constants)
        both = {"combs": combs, "borders": borders, "repeats": repeats}
        return replace(self, **{name: (one, other) for name, (one, other) in both.items()})

    def reason(self, reading: Reading | None) -> str:
        """How the film was read and what was fitted, for the report."""
        if reading is None:
            return "the view of the film is too small to count cells"
        read = f"{reading.rows.cells} x {reading.columns.cells} cells are {reading.probability:.0%} probable"
        if not reading.is_likely:
            return f"no grid is likely: {read} at best"
        how, kinds = [], {Comb: "lines", Borders: "borders", Repeats: "repetition"}
        for name, one in (("columns", reading.columns), ("rows", reading.rows)):
            fitted = _fitted(one, self.along(one.axis))
            by = "what was read" if fitted is one else kinds[type(fitted)]
            how.append(f"{name} by {by}")
        return f"{read}; {', '.join(how)}"

    def pitches(self) -> tuple[list[float], list[float]]:
        """The pitches along u and along v that lines and repetition give."""
        columns, rows = (
            [one.pitch for one in along if one is not None] for along in zip(self.combs, self.repeats, strict=True)
        )
        return columns, rows

    def slice_grid(self, reading: Reading | None, backward: BackwardMap, expected: float) -> SliceGrid | None:
        """The grid of slices as read from the film; None if it could not be read.

        Where fitted lines or repetition give the same cells, they locate them more exactly.
        expected: error of the map, as a fraction of the film: vertices are no more exact than that.
        """
        if reading is None or not reading.is_likely:
            return None
        columns, rows = (_fitted(one, self.along(one.axis)) for one in (reading.columns, reading.rows))
        u, v = np.meshgrid(np.clip(columns.lines(), 0.0, 1.0), np.clip(rows.lines(), 0.0, 1.0))
        vertices = np.stack([u, v], axis=-1)
        trust = reading.probability * min(1.0, GOOD_SHARE / expected)
        return SliceGrid(rows.cells, columns.cells, vertices, backward.photo_from_film(vertices), trust)


def _fitted(read: Repeats, fitted: Source | None) -> Source:
    """The cells along one axis as fitted, if these are the cells that were read; else as read."""
    if fitted is None or fitted.cells != read.cells:
        return read
    return fitted if np.abs(fitted.lines() - read.lines()).max() < SAME_PLACE else read


def find_repeating(view: FilmView, known: Layout, config: RepeatConfig) -> Layout:
    """The known layout, with the cells that repeat in this view along the axes on which none were known.

    Repetition counts only if it gives as many cells as were read.
    """
    if all(known.repeats):
        return known
    found = find_repeats(view.image[..., 0], config)
    told = zip(known.repeats, found, _likely(known), strict=True)
    columns, rows = (before or _as_read(new, read) for before, new, read in told)
    return replace(known, repeats=(columns, rows))


def find_lines(
    view: FilmView, known: Layout, looking: bool, borders: tuple[Places | None, Places | None], config: GridConfig
) -> tuple[Layout, tuple[Sightings | None, Sightings | None]]:
    """The known layout, with the lines in this view, and the sightings of the lines of each axis.

    borders: where those across each axis were read in this view, if they were. Unless ``looking``, known lines are only
    followed. Lines that contradict the repeats, or do not lie where cells meet, are dropped: couches, texts and bones
    make lines too.
    """
    grey, read = view.image[..., 0], _likely(known)
    fitted = [None if b is None else b.lines()[1:-1] for b in known.borders]
    seen = [before if now is None else now for now, before in zip(borders, fitted, strict=True)]
    combs, repeats, followed = list(known.combs), list(known.repeats), []
    for axis, repeated in enumerate(repeats):
        comb = combs[axis]
        if looking and (comb is None or len(comb.seen) <= comb.cells):
            around = (0.94 * repeated.pitch, 1.06 * repeated.pitch) if repeated is not None else (0.0, 1.0)
            found = find_comb(grey, axis, config, around)
            if found is not None and _plausible(found, repeated, read[axis], seen[axis], config):
                comb = found if comb is None or len(found.seen) > len(comb.seen) else comb
        followed.append(follow_comb(view, comb, config) if comb is not None else None)
        combs[axis] = comb if followed[axis] is not None else None
        repeats[axis] = _in_step(repeated, combs[axis])
    return replace(known, combs=(combs[0], combs[1]), repeats=(repeats[0], repeats[1])), (followed[0], followed[1])


def _likely(known: Layout) -> tuple[Repeats | None, Repeats | None]:
    """The cells along each axis as read from the film, if the reading is likely."""
    return (None, None) if known.read is None or not known.read.is_likely else (known.read.columns, known.read.rows)


def _as_read(repeat: Repeats | None, read: Repeats | None) -> Repeats | None:
    """The cells that repeat along one axis, as many as were read there; centred, as texts do not tell their place.

    Repetition gives the pitch more exactly, but its peaks are mistaken for one another while the map is still crooked.
    """
    if read is None or (repeat is not None and repeat.cells == read.cells):
        return repeat
    pitch = min(read.pitch, 1.0 / read.cells)
    return Repeats(read.axis, 0.5 * (1.0 - read.cells * pitch), pitch, read.cells)


def _in_step(repeat: Repeats | None, comb: Comb | None) -> Repeats | None:
    """The cells that repeat, placed between lines if there are lines: repetition does not tell where cells begin."""
    if comb is None or repeat is None:
        return repeat
    return Repeats(comb.axis, comb.first, comb.pitch, comb.cells)


def _plausible(
    comb: Comb, repeat: Repeats | None, read: Repeats | None, borders: Places | None, config: GridConfig
) -> bool:
    """True if the cells repeat at the comb's pitch or, where no repetition is seen, several lines are unbroken; and if
    the lines lie where cells meet according to the film and the borders as read."""
    if read is not None and beside_cells(comb, read) > config.beside:
        return False
    if borders is not None and len(borders) and beside_borders(comb, borders) > config.beside_read:
        return False
    if repeat is None:
        return comb.cells > 2 and comb.strength >= config.sure_share
    return comb.strength >= config.believed_share and abs(comb.pitch - repeat.pitch) < 0.04 * repeat.pitch


def beside_cells(comb: Comb, cells: Repeats) -> float:
    """Mean distance of the lines that were seen from where cells meet, in cells."""
    return _beside(comb.lines()[comb.seen], cells.lines()) / cells.pitch


def beside_borders(comb: Comb, borders: Places) -> float:
    """Mean distance of the borders that were read from the nearest lines that were seen, in cells. While a map is still
    crooked, neither are evenly spaced, so both are compared where they were seen."""
    return _beside(borders, comb.tracks.mean(axis=1)) / comb.pitch


def _beside(places: Places, others: Places) -> float:
    """Mean distance of places from the nearest of the others."""
    return float(np.abs(places[:, None] - others).min(axis=1).mean())


__all__ = ["Evidence", "Layout", "Places", "Source", "find_lines", "find_repeating"]
