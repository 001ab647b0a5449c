"""Borders between cells, as BorderNet reads them in strips across the borders that a map and a grid predict.

Rules and gutters show as lines. Where they are clear, they are followed without BorderNet (grid/lines.py). Where they
are faint or missing, the texts and scale bars on both sides still tell where one cell ends and the next begins, and
which lines lie between cells and which are couches or rows of text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.borders import GROUP, border_strips, inner_lines, strip_across
from hybrid.coords import film_centres_1d
from hybrid.errors import require_at_least
from hybrid.pyramid import Photo, Pyramid
from hybrid.records import SliceGrid
from hybrid.rectify.edges.paths import PathConfig, read_paths
from hybrid.rectify.grid.layout import Evidence, Layout, Places
from hybrid.rectify.grid.lines import Borders, GridConfig
from hybrid.rectify.splines.sightings import Sightings
from hybrid.strips import StripConfig, StripReader, strip_copy


@dataclass(frozen=True)
class BorderConfig:
    """Options for reading borders.

    paths: how borders are read in strips. soft_rows: spread of the readings, in rows, where a line is clear: any spread
    beyond it makes the whole border uncertain. sharp: least deviation of a whole border, in film units.
    min_columns: least number of columns that must show a border, over all borders across an axis, for the axis to
    count.
    """

    paths: PathConfig = field(default_factory=PathConfig)
    soft_rows: float = 0.7
    sharp: float = 1e-4
    min_columns: int = 12

    def __post_init__(self) -> None:
        require_at_least(self, 1e-6, "sharp")
        require_at_least(self, 1, "min_columns")


def read_borders(
    photo: Photo, film: BackwardMap, layout: Layout, reader: StripReader, grid: GridConfig, config: BorderConfig
) -> list[Evidence]:
    """Sightings of the borders across each axis along which no lines are known, through the map ``film`` into
    ``photo``. An axis is left out if nothing is known of it, or if too few columns show a border."""
    found = []
    for axis in (0, 1):
        borders, across = _known(layout, axis), layout.combs[1 - axis] or _known(layout, 1 - axis)
        if borders is None or layout.combs[axis] is not None:
            continue
        ends = (0.0, 1.0) if across is None else (float(across.lines()[0]), float(across.lines()[-1]))
        sightings = _sightings(photo, film, borders, ends, reader, config)
        found += [] if sightings is None else [_held(sightings, borders, grid)]
    return found


def places_along(read: Sequence[Evidence]) -> tuple[Places | None, Places | None]:
    """Where each border between two cells was read (the median along it), across u and across v; None where none
    was."""
    by_axis = {e.sightings.axis: _places(e) for e in read}
    return by_axis.get(0), by_axis.get(1)


def borders_shown(
    pyramid: Pyramid, film: BackwardMap, grid: SliceGrid, reader: StripReader, config: BorderConfig
) -> float:
    """Mean probability, over all columns, that borders between cells show near where a grid on the film has them: the
    first and the last border inside the sheet along each axis are read, all together. 0 where there are none."""
    images, inside = [], []
    for axis in (0, 1):
        first, pitch, cells = grid.along(axis)
        lines, _ = inner_lines(first, pitch, cells)
        if pitch > 0.0 and len(lines):  # a grid whose corners were cut off at the film's edges may have no width left
            strip = strip_across(pitch, reader.strip)
            copy, on_copy = strip_copy(pyramid, film, strip)
            strips = border_strips(copy, on_copy, axis, lines[[0, -1]], strip)
            images, inside = [*images, strips[0]], [*inside, strips[1]]
    if not images:
        return 0.0
    group = [0, 1] if len(images) > 1 else [0, 0]
    logs = reader.logs(np.concatenate([images[k] for k in group]), np.concatenate([inside[k] for k in group]))
    return float(read_paths(logs, config.paths).mass.mean())


def held_to(layout: Layout, read: Evidence, grid: GridConfig) -> Evidence:
    """Borders that were read before, held to the grid as it is known now."""
    borders = layout.borders[read.sightings.axis] or read.source
    assert isinstance(borders, Borders)
    return _held(read.sightings, borders, grid)


def _held(read: Sightings, borders: Borders, grid: GridConfig) -> Evidence:
    """The borders that were read, with their coordinates on the grid and the priors of its place and pitch."""
    pitch, before = borders.before(grid)
    known = 0.5 + pitch * read.shared[:, borders.pitch_at]
    shared_sigma = np.append(before, read.shared_sigma[len(before) :])
    return Evidence(replace(read, known=known, shared_sigma=shared_sigma), borders)


def _places(read: Evidence) -> Places:
    borders, sightings = read.source, read.sightings
    assert isinstance(borders, Borders)
    number, across = sightings.shared[:, borders.pitch_at], sightings.seen[:, sightings.axis]
    between = np.unique(number[np.abs(number) < 0.5 * borders.cells - 0.25])
    return np.array([np.median(across[number == k]) for k in between])


def _known(layout: Layout, axis: int) -> Borders | None:
    """Where borders lie along an axis: as they were read before, else as the whole film was read, if as many cells
    repeat."""
    borders, repeats = layout.borders[axis], layout.repeats[axis]
    if borders is not None:
        return borders
    if repeats is None or layout.read is None or not layout.read.is_likely:
        return None
    read = (layout.read.columns, layout.read.rows)[axis]
    return Borders(axis, read.first, read.pitch, read.cells) if read.cells == repeats.cells else None


def _sightings(
    photo: Photo,
    film: BackwardMap,
    borders: Borders,
    ends: tuple[float, float],
    reader: StripReader,
    config: BorderConfig,
) -> Sightings | None:
    """Sightings from the columns of all strips, between the ends of the grid, that show a border; not yet held to any
    grid.

    What borders share: the offset of the grid's middle from the film's, the error of its pitch, and, for each border,
    the offset by which it is misread as a whole.
    """
    lines, number = inner_lines(borders.first, borders.pitch, borders.cells)
    if not len(lines):
        return None
    strip = strip_across(borders.pitch, reader.strip)
    row, spread, mass = _read(photo, film, borders.axis, lines, strip, reader, config)
    depth, along = strip.depth_of(row), film_centres_1d(row.shape[1])
    good = (mass > config.paths.min_mass) & (along > ends[0]) & (along < ends[1])
    if good.sum() < config.min_columns:
        return None
    line, column = np.nonzero(good)
    unsure = np.sqrt(np.maximum(np.square(spread) - config.soft_rows**2, 0.0))
    sigma = strip.pitch * np.hypot(config.paths.row_sigma, unsure[good]) / np.sqrt(mass[good])
    seen = np.empty((len(line), 2))
    seen[:, borders.axis], seen[:, 1 - borders.axis] = lines[line] + depth[good], along[column]
    each = np.flatnonzero(good.any(axis=1))
    misread = [strip.pitch * np.sqrt(np.mean(np.square(unsure[k, good[k]]))) for k in each]
    shared = np.column_stack([np.ones(len(line)), number[line], *(line == k for k in each)])
    shared_sigma = np.append([np.inf, np.inf], np.hypot(config.sharp, misread))
    return Sightings(borders.axis, seen, np.full(len(line), np.nan), sigma, shared, shared_sigma)


def _read(
    photo: Photo,
    film: BackwardMap,
    axis: int,
    lines: Float[np.ndarray, " k"],
    strip: StripConfig,
    reader: StripReader,
    config: BorderConfig,
) -> tuple[Float[np.ndarray, "k c"], Float[np.ndarray, "k c"], Float[np.ndarray, "k c"]]:
    """Row, spread and mass (EdgePaths) of the likeliest path of each of k borders, all groups at once. The last group
    is filled up with borders that are read in any case."""
    count = len(lines)
    whole = -(-count // GROUP) * GROUP
    which = [k if k < count else (k - GROUP) % count for k in range(whole)]
    images, inside = border_strips(photo, film, axis, lines[which], strip)
    paths = read_paths(reader.logs(images, inside)[:count], config.paths)
    return paths.row, paths.spread, paths.mass


__all__ = ["BorderConfig", "borders_shown", "held_to", "places_along", "read_borders"]
