"""Wide margins, clear or black, that look like what lies around the sheet: where the sheet goes on beyond its map.

The print is whole and straight, and where it ends is as good an edge as any, so that the looks before take it for the
sheet. But the edges on both sides of it go on, straight through that end, to where the sheet's own end is. So strips
across these edges are read further on than the map goes; where both sides of the film go on beyond one of its ends, the
map is made longer by as much and put on the edges that are read across it. Another sheet or the line of a table may run
on like that, too, but then nothing lies across where they stop: the new end must read as an edge like the others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d, film_nodes, node_centres_1d
from hybrid.errors import require_at_least
from hybrid.pyramid import Pyramid
from hybrid.rectify.edge_paths import (
    EdgeConfig,
    EdgePaths,
    EdgesRead,
    look_across,
    put_on_edges,
    read_edges,
    read_paths,
)
from hybrid.strips import SIDES, Side, StripReader, strip_copy, strips_across

NODES = (33, 33)
"""Of a map that was made longer."""
BESIDE_FRAME, MOST = 0.02, 0.75
"""Of a new end most nodes must be shown so far inside the photo's frame, in parts of the film: else the frame is it."""


@dataclass(frozen=True)
class ClearMarginsConfig:
    """Options of the search for margins that were taken for the ground. Lengths in parts of the film along the axis.

    reach: how far beyond the map's ends strips are read; 0 to look for none. least_mass: least probability, of both
    sides, that an edge lies in a column of their strips. free, more: rows by which it may lie beside where the map goes
    on, and by how much more for each part of the film. least: narrowest margin, and how far the new end must lie beyond
    the old one. likely, least_support: least mean probability, over any side, that an edge lies where the longer map
    has it: for it to be refined, and then. most_less: by how much that may be less than it was. most_expected: largest
    error to be expected then, in parts of the film's longer side.
    """

    reach: float = 0.3
    least_mass: float = 0.45
    free: float = 4.0
    more: float = 40.0
    least: float = 0.05
    likely: float = 0.6
    least_support: float = 0.65
    most_less: float = 0.15
    most_expected: float = 0.006

    def __post_init__(self) -> None:
        require_at_least(self, 1e-3, "least")


@dataclass(frozen=True)
class Longer:
    """By how much a film is longer than its map, beyond both ends along an axis (0: along u), in parts of the map."""

    axis: int
    before: float
    after: float

    def applied(self, film: BackwardMap) -> BackwardMap:
        """The map made so much longer, straight on beyond its ends."""
        uv = film_nodes(NODES).copy()
        uv[..., self.axis] = (1.0 + self.before + self.after) * uv[..., self.axis] - self.before
        return BackwardMap(film.photo_from_film(uv))


def with_margins(
    pyramid: Pyramid, film: BackwardMap, reader: StripReader, edges: EdgeConfig, config: ClearMarginsConfig
) -> Iterator[tuple[EdgesRead, str]]:
    """Maps of the film with margins that were taken for the ground, put on its edges and read across these, and what
    the margins are; mostly none."""
    if config.reach <= 0.0:
        return
    paths = _paths_beyond(pyramid, film, reader, edges, config)
    for axis in (0, 1):
        ends = [side for side in SIDES if side.axis == axis]
        before, after = (_length(paths, reader, end, config) for end in ends)
        longer = Longer(axis, before, after)
        if max(before, after) < config.least or (start := longer.applied(film)).folds((17, 17)):
            continue
        on_edges = put_on_edges(start, read_edges(pyramid, start, reader, edges), edges)
        gained = [(end, _gained(film, on_edges, end)) for end in ends]
        new = [end for end, length in gained if length >= config.least]
        if not new or not all(_shown(on_edges, end, pyramid.photo.shape) for end in new):
            continue
        read = look_across(pyramid, on_edges, reader, edges)
        support = float(read.support.min())
        if support >= config.likely:
            told = " and ".join(f"{length:.0%} at the {end.name}" for end, length in gained if length > 0.01)
            yield read, f"the sheet goes on: {told}, each edge at least {support:.0%} likely"


def _paths_beyond(
    pyramid: Pyramid, film: BackwardMap, reader: StripReader, edges: EdgeConfig, config: ClearMarginsConfig
) -> EdgePaths:
    """What is read across each side, from ``reach`` before its beginning to as much beyond its end."""
    photo, on_copy = strip_copy(pyramid, film, reader.strip)
    along = [(side, Longer(1 - side.axis, config.reach, config.reach).applied(on_copy)) for side in SIDES]
    return read_paths(reader.logs(*strips_across(photo, along, reader.strip)), edges.paths)


def _length(paths: EdgePaths, reader: StripReader, end: Side, config: ClearMarginsConfig) -> float:
    """How far the sides beside one of the film's ends go on beyond it, in parts of the film."""
    columns = paths.row.shape[1]
    at = (1.0 + 2.0 * config.reach) * film_centres_1d(columns) - config.reach
    beyond = _outside(at, end)
    order = np.argsort(beyond)
    order = order[beyond[order] > 0.0]
    lateral = [k for k, side in enumerate(SIDES) if side.axis != end.axis]
    aside = np.abs(paths.row[lateral] - 0.5 * (reader.strip.rows - 1)).max(axis=0)
    shown = (paths.mass[lateral].min(axis=0) > config.least_mass) & (aside < config.free + config.more * beyond)
    count = int(np.cumprod(shown[order]).sum())
    return config.reach * count / max(len(order), 1)


def _shown(film: BackwardMap, end: Side, size: tuple[int, ...]) -> bool:
    """Whether a photo of ``size`` (height, width, ...) shows most of one of the film's ends, and ground beyond it."""
    points = film.photo_from_film(_along(end))
    beside = BESIDE_FRAME * max(film.mean_film_pixels())
    inside = ((points > beside) & (points < np.array(size[1::-1]) - beside)).all(axis=1)
    return bool(inside.mean() > MOST)


def _gained(film: BackwardMap, longer: BackwardMap, end: Side) -> float:
    """How far an end of a longer map lies beyond the film's, in parts of the film: the median."""
    at = film.film_near(longer.photo_from_film(_along(end)), _along(end), iterations=4, most_step=0.2)
    return float(np.median(_outside(at[:, end.axis], end)))


def _along(end: Side) -> Float[np.ndarray, "n 2"]:
    """Film points along one of the film's ends."""
    return end.film_points(node_centres_1d(NODES[0]), np.zeros(NODES[0]))


def _outside(at: Float[np.ndarray, " n"], end: Side) -> Float[np.ndarray, " n"]:
    """How far film coordinates across one of the film's ends lie beyond it."""
    return end.inward * (end.edge - at)


__all__ = ["ClearMarginsConfig", "Longer", "with_margins"]
