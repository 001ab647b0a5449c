"""Wide margins, clear or black, that look like what surrounds the sheet: where the sheet extends beyond its map.

The print is whole and straight, and its end is as good an edge as any, so the earlier looks take the print for the
sheet. But beyond it lies the sheet's own end, and the edges on both sides run straight on to there. So strips beyond
each end of the map are read. Where one shows an edge, the map is extended to it and put on the edges that are read
across the extended map. Other sheets and tables also end beyond the film, but there the sides do not run on, and the
print would lie far from the sheet's middle. So both the new end and the added parts of the sides must read as edges,
and, unless they do so beyond much doubt, opposite margins must be alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d, film_nodes, node_centres_1d
from hybrid.errors import require_at_least, require_at_most
from hybrid.film_view import grey_view
from hybrid.pyramid import Pyramid
from hybrid.rectify.edges.paths import (
    CORNER,
    EdgeConfig,
    EdgesRead,
    look_across,
    off_corners,
    put_on_edges,
    read_edges,
    read_paths,
)
from hybrid.rectify.grid.cells import CellsConfig
from hybrid.rectify.grid.repeat import detail
from hybrid.strips import SIDES, Side, StripReader, strip_copy, strips_across

NODES = (33, 33)
"""Nodes of a map that was extended."""
SIDES_SHOWN = 0.3
"""The photo must show at least this share of the sides of an added margin."""
RIM = 0.2
"""Part of a margin, at both of its ends, whose detail may be that of the print or of the sheet's edge."""
BESIDE_FRAME, MOST = 0.02, 0.75
"""A node of a new end counts as shown if it lies this far inside the photo's frame, in parts of the film: else the end
may be the frame. At least this share of the nodes must be shown."""


@dataclass(frozen=True)
class ClearMarginsConfig:
    """Options of the search for margins that were taken for background. Lengths in parts of the film along the axis.

    beyond: middles of the strips that are read beyond the map's ends; empty to look for no margins. noticed: least mean
    probability, over its columns, of an edge there that is examined further. least: narrowest margin. likely, sure:
    least probability of margins (``LongerSheet.chance``) before refinement, and after it. The rest applies after
    refinement. most_lopsided: most by which the margins on opposite sides of the film may differ, as most prints are in
    the sheet's middle (``SliceGrid.lopsided``). least_support: least mean probability, over any side, that an edge lies
    where the longer map has it. most_expected: largest expected error, in parts of the film's longer side;
    most_growth: the same in parts of the error before, unless the grid became more probable by ``grid_changed``. It
    must never become less probable by more than that. If part of another film is taken for the sheet's margin, the
    print fits worse. But margins that show no more than ``blank`` of the print's detail belong to no other film, and if
    they differ by at most ``blank_lopsided``, they belong to no sheet below it, either: those count however the print
    fits, if some edge of the map before is not nearly certain or if their probability is at least ``blank_sure``.
    most_beside: largest distance, smoothed over the film, between where the network sees it and the longer map
    (verdict/trust.py). written: where the margins and every edge of the longer map are as probable as this and
    they show more than ``blank``, as a strip of writing does, which makes a print lopsided and has no cells, only the
    expected error and this distance can speak against them. certain: the same for blank margins, alike to
    ``most_lopsided``.
    """

    beyond: tuple[float, ...] = (0.12, 0.28)
    noticed: float = 0.4
    least: float = 0.05
    likely: float = 0.35
    sure: float = 0.5
    most_lopsided: float = 0.08
    least_support: float = 0.3
    most_expected: float = 0.02
    most_growth: float = 1.2
    grid_changed: float = 0.1
    blank: float = 0.4
    blank_lopsided: float = 0.03
    blank_sure: float = 0.8
    most_beside: float = 0.02
    written: float = 0.6
    certain: float = 0.85

    def __post_init__(self) -> None:
        require_at_least(self, 1e-3, "least")
        require_at_most(self, 1, "noticed", "least", "likely")
        require_at_least(self, 0, "blank")


@dataclass(frozen=True, eq=False)
class LongerSheet:
    """A sheet with margins that were taken for background. read: its edges, as read across those of its map. gained: by
    how much it is longer at each new end, in parts of the film before."""

    read: EdgesRead
    gained: Mapping[Side, float]

    def chance(self, across: EdgesRead) -> float:
        """Probability of the margins, given the edges read across a map that has them: that of a new end times that of
        the side edges gained there, for the end where this is least."""
        return min(across.support_of(end) * self._sides(across, end) for end in self.gained)

    def only(self, end: Side) -> LongerSheet:
        """The same with one of the new ends alone."""
        return replace(self, gained={end: self.gained[end]})

    def _sides(self, across: EdgesRead, end: Side) -> float:
        """Mean probability of the side edges along the margin gained at one end, where the photo shows them; 0 where it
        hardly does."""
        chances = across.chances[[side.axis != end.axis for side in SIDES]]
        depth = -_outside(film_centres_1d(chances.shape[1]), end)  # inside of the new end
        gained = chances[:, (depth < self._share(end)) & (depth > CORNER)]
        shown = np.isfinite(gained)
        return float(gained[shown].mean()) if gained.size and shown.mean() >= SIDES_SHOWN else 0.0

    def _share(self, end: Side) -> float:
        """What the sheet gains at one of its ends, in parts of the longer sheet."""
        return self.gained[end] / (1.0 + sum(length for side, length in self.gained.items() if side.axis == end.axis))

    @property
    def lopsided(self) -> float:
        """Largest difference between the gains at opposite ends, in parts of the longer sheet."""
        return unlike_ends({end: self._share(end) for end in self.gained})

    def detail_gained(self, pyramid: Pyramid, film: BackwardMap, look: CellsConfig) -> float:
        """Detail of the margins gained, seen through the longer map ``film`` (``detail_of_margins``)."""
        return detail_of_margins(pyramid, film, {end: self._share(end) for end in self.gained}, look)

    def __str__(self) -> str:
        return f"the sheet goes on: {told_of(self.gained, self.read)}"


def with_margins(
    pyramid: Pyramid, film: BackwardMap, reader: StripReader, edges: EdgeConfig, config: ClearMarginsConfig
) -> Iterator[LongerSheet]:
    """Sheets with margins that were taken for background, each map put on the sheet's edges; usually none."""
    noticed = edges_beside(pyramid, film, config.beyond, reader, edges, config.noticed, config.least)
    for ahead in _together(noticed):
        new = list(ahead)
        while new:
            start = lengthened(film, {end: ahead[end] for end in new})
            if start.folds((17, 17)):
                break
            on_edges = put_on_edges(start, read_edges(pyramid, start, reader, edges), edges)
            moved = {side: beyond_end(film, on_edges, side) for side in SIDES}
            if any(abs(moved[side]) >= config.least for side in SIDES if side not in new):
                break  # a side that was right was moved to another edge
            read = look_across(pyramid, on_edges, reader, edges)
            longer = LongerSheet(read, {end: moved[end] for end in new})
            borne_out = [
                end
                for end in new
                if moved[end] >= config.least
                and _shown(on_edges, end, pyramid.size)
                and longer.only(end).chance(read) >= config.likely
            ]
            if borne_out == new:
                yield longer
                break
            new = borne_out


def detail_of_margins(pyramid: Pyramid, film: BackwardMap, margins: Mapping[Side, float], look: CellsConfig) -> float:
    """Detail of margins, in parts of that of the print between them: for the end that shows most. Infinite where the
    photo does not show an end.

    margins: their widths, in parts of the film. look: how cells are looked at: the same view is used here.
    """
    view = grey_view(pyramid, film, look.side_px)
    shown, printed, seen = np.abs(detail(view.image[..., 0], *look.detail_px)), view.inside, []
    for end, width in margins.items():
        depth = -_outside(view.u if end.axis == 0 else view.v, end) / width
        depth = depth if end.axis == 0 else depth[:, None]
        seen.append(shown[view.inside & (depth > RIM) & (depth < 1.0 - RIM)])
        printed = printed & (depth > 1.0)
    if not printed.any() or not all(margin.size for margin in seen):
        return float("inf")
    return max(float(margin.mean()) for margin in seen) / max(float(shown[printed].mean()), 1e-6)


def lengthened(film: BackwardMap, gained: Mapping[Side, float]) -> BackwardMap:
    """The map extended straight on beyond some of its ends, by lengths in parts of the map, or cut by negative ones."""
    added = np.zeros((2, 2))
    for end, length in gained.items():
        added[int(end.edge), end.axis] = length
    before, after = added
    return BackwardMap(film.photo_from_film((1.0 + before + after) * film_nodes(NODES) - before))


def _together(noticed: Mapping[Side, float]) -> Iterator[Mapping[Side, float]]:
    """Ends that are tried together, and how far beyond the map each may lie.

    If ends across both axes were noticed, all are tried first, because a margin has edges at its sides only once the
    map is as wide as the sheet; even before that, they are tried with their opposite ends, as margins are mostly alike.
    Then the ends across each axis are tried by themselves, as one false end spoils the others.
    """
    across = [{end: off for end, off in noticed.items() if end.axis == axis} for axis in (0, 1)]
    if all(across):
        opposite = {side: off for side in SIDES for end, off in noticed.items() if side.axis == end.axis}
        if len(opposite) > len(noticed):
            yield {**opposite, **noticed}
        yield noticed
    yield from across


def edges_beside(
    pyramid: Pyramid,
    film: BackwardMap,
    middles: Sequence[float],
    reader: StripReader,
    edges: EdgeConfig,
    noticed: float,
    least: float,
) -> dict[Side, float]:
    """The film's ends beside which something reads as the sheet's edge, and how far beyond; inside is negative.

    middles: of the strips that are read, beyond the ends, or inside if negative. noticed: least mean probability, over
    its columns, of such an edge. least: how far from the end it must be.
    """
    photo, on_copy = strip_copy(pyramid, film, reader.strip)
    found: dict[Side, tuple[float, float]] = {}
    beside = [(side, middle) for middle in middles for side in SIDES]
    if not beside:
        return {}
    lines = [(replace(side, edge=side.edge - side.inward * middle), on_copy) for side, middle in beside]
    paths = read_paths(reader.logs(*strips_across(photo, lines, reader.strip)), edges.paths)
    depth, core = reader.strip.depth_of(paths.row), off_corners(paths.row.shape[1])
    for k, (side, middle) in enumerate(beside):
        off = middle - depth[k]
        counts = core & (np.copysign(off, middle) == off) & (np.abs(off) > least)
        mass = float((paths.mass[k] * counts).sum() / core.sum())
        if mass > max(noticed, found.get(side, (0.0, 0.0))[0]):
            found[side] = mass, float(np.median(off[counts]))
    return {side: off for side, (_, off) in found.items()}


def _shown(film: BackwardMap, end: Side, size: tuple[int, int]) -> bool:
    """Whether a photo of ``size`` (height, width) shows most of one of the film's ends, and background beyond it."""
    points = film.photo_from_film(_along(end))
    beside = BESIDE_FRAME * max(film.mean_film_pixels())
    inside = ((points > beside) & (points < np.array(size[::-1]) - beside)).all(axis=1)
    return bool(inside.mean() > MOST)


def beyond_end(film: BackwardMap, other: BackwardMap, end: Side) -> float:
    """How far an end of another map lies beyond the film's, in parts of the film: the median."""
    at = film.film_near(other.photo_from_film(_along(end)), _along(end), iterations=4, most_step=0.2)
    return float(np.median(_outside(at[:, end.axis], end)))


def told_of(lengths: Mapping[Side, float], read: EdgesRead) -> str:
    """Lengths at a sheet's ends, and how likely its edges are, in words."""
    told = " and ".join(f"{length:.0%} at the {end.name}" for end, length in lengths.items())
    return f"{told}, each edge at least {float(read.support.min()):.0%} likely"


def unlike_ends(lengths: Mapping[Side, float]) -> float:
    """Largest difference between lengths at opposite ends, 0 at ends that are not named."""
    along = ([end.inward * length for end, length in lengths.items() if end.axis == axis] for axis in (0, 1))
    return max(abs(sum(ends, 0.0)) for ends in along)


def _along(end: Side) -> Float[np.ndarray, "n 2"]:
    """Film points along one of the film's ends."""
    return end.film_points(node_centres_1d(NODES[0]), np.zeros(NODES[0]))


def _outside(at: Float[np.ndarray, " n"], end: Side) -> Float[np.ndarray, " n"]:
    """How far film coordinates across one of the film's ends lie beyond it."""
    return end.inward * (end.edge - at)


__all__ = [
    "ClearMarginsConfig",
    "LongerSheet",
    "beyond_end",
    "detail_of_margins",
    "edges_beside",
    "lengthened",
    "told_of",
    "unlike_ends",
    "with_margins",
]
