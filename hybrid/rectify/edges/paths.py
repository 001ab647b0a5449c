"""A coarse map put onto the sheet's edges by what EdgeNet reads in strips across them.

For each column of a strip, the network gives the probability of every row. Dynamic programming finds the likeliest path
along each side; it counts in the columns that agree with it. A smooth displacement that brings the four edges there is
all that is changed: what lies between the edges is left to refinement.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d
from hybrid.errors import require_at_least, require_at_most
from hybrid.pyramid import Pyramid
from hybrid.rectify.edges.curves import best_paths
from hybrid.rectify.edges.outline import edge_sightings
from hybrid.rectify.splines.displacement import SplineConfig, fit_displacement
from hybrid.rectify.splines.sightings import Sightings, carried
from hybrid.strips import SIDES, Side, StripConfig, StripReader, edge_strips, strip_copy

SUPPORT_ROWS = 2
"""Rows on each side of an edge within which a reading agrees with it."""
LEAST_SHOWN = 0.1
"""Share of a side that the photo must show for it to be read."""
CORNER = 0.04
"""Share of a side, at each of its ends, that is ignored in judging how well the side is seen: corners may be round."""


@dataclass(frozen=True)
class PathConfig:
    """Options of paths through strips.

    floor: least log-probability of a row: no column alone leads the path away. max_step, step_cost: most rows that a
    path may step from one column to the next, and the log-probability that each step of a row costs. near: rows on each
    side of the path that count for it. min_mass: least probability of these rows together for a column to count.
    row_sigma: stated deviation of the network's likeliest place, in rows.
    """

    floor: float = -9.0
    max_step: int = 3
    step_cost: float = 0.15
    near: int = 3
    min_mass: float = 0.35
    row_sigma: float = 0.5

    def __post_init__(self) -> None:
        require_at_least(self, 1e-3, "row_sigma")
        require_at_most(self, 0, "floor")


@dataclass(frozen=True)
class EdgeConfig:
    """Options for reading the sheet's edges.

    paths: how they are read in strips. min_columns: least number of columns of a side that counts. far: edges read
    farther than this beside those predicted, in parts of the film, are read once more. doubtful, beside, surer: the
    film is refined once more if an edge of the map reads as one with less than the first probability, and an edge is
    read farther beside the map's than the second, in parts of the film; the result counts if it raises the probability
    by the third. sure: otherwise a refinement that leaves open where the print ends is tried, and must raise it to
    this, too. spline: of the displacement.
    """

    paths: PathConfig = field(default_factory=PathConfig)
    min_columns: int = 6
    far: float = 0.02
    doubtful: float = 0.8
    beside: float = 0.0015
    surer: float = 0.03
    sure: float = 0.95
    spline: SplineConfig = field(default_factory=SplineConfig)

    def __post_init__(self) -> None:
        require_at_least(self, 1, "min_columns")
        require_at_most(self, 1, "doubtful", "surer", "sure")


@dataclass(frozen=True, eq=False)
class EdgePaths:
    """The likeliest edges in some strips. row: to a fraction, for each column. spread: standard deviation, in rows.
    mass: probability that the edge crosses the column there."""

    row: Float[np.ndarray, "k c"]
    spread: Float[np.ndarray, "k c"]
    mass: Float[np.ndarray, "k c"]


def read_paths(logs: Float[np.ndarray, "k r1 c"], config: PathConfig) -> EdgePaths:
    """The likeliest path through each strip, and how likely it is in each column."""
    path: Int[np.ndarray, "k c"] = best_paths(np.maximum(logs[:, :-1], config.floor), config.max_step, config.step_cost)
    near = config.near
    chances = np.pad(np.exp(logs[:, :-1]), ((0, 0), (near, near), (0, 0)))
    offset = np.arange(-near, near + 1)[None, :, None]
    local = np.take_along_axis(chances, path[:, None] + offset + near, axis=1)
    mass = local.sum(axis=1)
    share = local / np.maximum(mass, 1e-9)[:, None]
    mean = (share * offset).sum(axis=1)
    spread = np.sqrt((share * (offset - mean[:, None]) ** 2).sum(axis=1))
    return EdgePaths(path + mean, spread, mass)


def path_sightings(read: EdgePaths, strip: StripConfig, config: EdgeConfig) -> list[Sightings]:
    """Sightings from the columns that show an edge, for the sides that have enough of them."""
    depth = strip.depth_of(read.row)
    along = film_centres_1d(depth.shape[1])
    sigma = strip.pitch * np.hypot(config.paths.row_sigma, read.spread) / np.sqrt(np.maximum(read.mass, 1e-9))
    found = []
    for k, side in enumerate(SIDES):
        good = read.mass[k] > config.paths.min_mass
        if good.sum() >= config.min_columns:
            found.append(edge_sightings(side, along[good], depth[k, good], sigma[k, good]))
    return found


@dataclass(frozen=True, eq=False)
class EdgesRead:
    """The sheet's edges as they were read. through: the map whose edges the strips were cut across. sightings: through
    it, one record for each side that was seen. off: distance of the farthest of them from the edges of the map that was
    asked for, in parts of the film. chances: for SIDES, in columns along them, the probability that the sheet's edge
    lies within SUPPORT_ROWS of where the map of the strips puts it; NaN where the photo does not show that."""

    through: BackwardMap
    sightings: tuple[Sightings, ...]
    off: float
    chances: Float[np.ndarray, "4 c"]

    @cached_property
    def support(self) -> Float[np.ndarray, " 4"]:
        """For SIDES, the mean of these probabilities without the corners; 1 for a side that the photo hardly shows."""
        shown = np.isfinite(self.chances) & off_corners(self.chances.shape[1])
        seen = shown.mean(axis=1) > LEAST_SHOWN
        sums = np.where(shown, self.chances, 0.0).sum(axis=1)
        return np.where(seen, sums / np.maximum(shown.sum(axis=1), 1), 1.0)

    @property
    def weakest(self) -> str:
        """Name of the side with the least support."""
        return SIDES[int(self.support.argmin())].name

    def support_of(self, side: Side) -> float:
        """That of one of SIDES."""
        return float(self.support[SIDES.index(side)])

    def seen_through(self, film: BackwardMap) -> tuple[Sightings, ...]:
        """The sightings as if they had been made through another map that is near."""
        return carried(self.sightings, self.through, film)


def off_corners(columns: int) -> Bool[np.ndarray, " c"]:
    """Which of the columns along a side lie outside its corners."""
    return np.asarray(np.abs(film_centres_1d(columns) - 0.5) < 0.5 - CORNER)


def read_edges(pyramid: Pyramid, film: BackwardMap, reader: StripReader, config: EdgeConfig) -> EdgesRead:
    """The edges as read across those of a map; if they are far beside these, as read once more across the edges
    found."""
    return read_nearer(pyramid, look_across(pyramid, film, reader, config), reader, config)


def read_nearer(pyramid: Pyramid, read: EdgesRead, reader: StripReader, config: EdgeConfig) -> EdgesRead:
    """Edges as they were read, or as read once more across the edges found if these are far beside the map's."""
    if read.off <= config.far:
        return read
    return replace(look_across(pyramid, put_on_edges(read.through, read, config), reader, config), off=read.off)


def put_on_edges(film: BackwardMap, read: EdgesRead, config: EdgeConfig) -> BackwardMap:
    """A map near the one that the edges were read through, smoothly displaced to have these edges; unchanged where none
    were read, or where it would fold."""
    if not read.sightings:
        return film
    moved = fit_displacement(read.seen_through(film), config.spline).displacement.composed(film)
    return film if moved.folds((17, 17)) else moved


def look_across(pyramid: Pyramid, film: BackwardMap, reader: StripReader, config: EdgeConfig) -> EdgesRead:
    """The edges as read across those of a map, once."""
    photo, on_copy = strip_copy(pyramid, film, reader.strip)
    images, inside = edge_strips(photo, on_copy, reader.strip)
    logs = reader.logs(images, inside)
    sightings = path_sightings(read_paths(logs, config.paths), reader.strip, config)
    off = max((float(np.median(np.abs(s.offsets()))) for s in sightings), default=0.0)
    return EdgesRead(film, tuple(sightings), off, _chances(logs, inside))


def _chances(logs: Float[np.ndarray, "4 r1 c"], inside: Bool[np.ndarray, "4 r c2"]) -> Float[np.ndarray, "4 c"]:
    """As EdgesRead.chances: the network's columns may each stand for several of the strip's."""
    middle = inside.shape[1] // 2
    near = slice(middle - SUPPORT_ROWS, middle + SUPPORT_ROWS)
    chances = np.exp(logs)[:, near].sum(axis=1)
    shown = inside[:, near].all(axis=1).reshape(*chances.shape, -1).all(axis=2)
    return np.where(shown, chances, np.nan)


__all__ = [
    "EdgeConfig",
    "EdgePaths",
    "EdgesRead",
    "PathConfig",
    "look_across",
    "off_corners",
    "put_on_edges",
    "read_edges",
    "read_nearer",
    "read_paths",
]
