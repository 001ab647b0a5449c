"""Ground that was taken for margins: where the sheet ends before its map does.

With its own hard shadow behind it, or on a plain sheet that sticks out below it, a film looks like a larger one whose
print has margins. So the map is cut to where its print ends, and to where edges are read inside it, and the edges near
there are read: mostly, nothing within a sheet looks like its edge. Where all four are as good as certain even once the
shorter sheet is refined, and its print lies in its middle, what was cut off is no margin if it sticks out farther on
one side than on the opposite one, if the longer map ended in something that does not look like the sheet's edge, or if
the grid has become far more probable. Where the longer map's grid knows of no margin, what is cut off must be blank.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hybrid.backward import BackwardMap
from hybrid.errors import require_at_least, require_at_most
from hybrid.pyramid import Pyramid
from hybrid.records import SliceGrid
from hybrid.rectify.edges.paths import EdgeConfig, EdgesRead, look_across, put_on_edges, read_nearer
from hybrid.rectify.margins.clear import beyond_end, edges_beside, lengthened, told_of, unlike_ends
from hybrid.strips import SIDES, Side, StripReader


@dataclass(frozen=True)
class FalseMarginsConfig:
    """Options of the search for ground that was taken for margins. Lengths in parts of the film along the axis.

    inside: middles of the strips that are read inside the map's ends. noticed: least mean probability, over its
    columns, of an edge there that is examined further. least: narrowest margin that is cut off. likely, sure: least
    probability of every edge before the shorter sheet is refined, and after it. most_lopsided: most by which its
    opposite margins may then differ (``SliceGrid.lopsided``). Where the longer map's grid has no margin, what is cut
    off might be a row of cells: no more detail than ``blank`` may then show, in parts of the print's, or
    ``blank_certain`` where an edge is seen there with the probability ``certain``: most of its cells may be empty.
    One of three must also hold: what was cut off differs on opposite sides by ``unlike``; some edge of the longer map
    looked like the sheet's with less than the probability ``unseen``; or the grid is more probable by ``grid_gained``.
    """

    inside: tuple[float, ...] = (0.08, 0.18)
    noticed: float = 0.6
    least: float = 0.02
    likely: float = 0.6
    sure: float = 0.9
    most_lopsided: float = 0.02
    blank: float = 0.4
    certain: float = 0.95
    blank_certain: float = 0.1
    unlike: float = 0.035
    unseen: float = 0.3
    grid_gained: float = 0.5

    def __post_init__(self) -> None:
        require_at_least(self, 1e-3, "least")
        require_at_most(self, 1, "likely", "sure", "certain")


@dataclass(frozen=True, eq=False)
class ShorterSheet:
    """A sheet without margins that may be ground. read: its edges, as read across those of its map. lost: by how much
    it is shorter at its ends, in parts of the sheet before."""

    read: EdgesRead
    lost: Mapping[Side, float]

    @property
    def unlike(self) -> float:
        """Largest difference between what is lost at opposite ends, in parts of the sheet before."""
        return unlike_ends(self.lost)

    def __str__(self) -> str:
        return f"the sheet ends before its map: {told_of(self.lost, self.read)}"


def ends_inside(
    pyramid: Pyramid, film: BackwardMap, reader: StripReader, edges: EdgeConfig, config: FalseMarginsConfig
) -> dict[Side, float]:
    """The film's ends inside of which something reads as the sheet's edge, and how far inside, as negative lengths."""
    middles = [-middle for middle in config.inside]
    return edges_beside(pyramid, film, middles, reader, edges, config.noticed, config.least)


def ends_of_print(grid: SliceGrid, config: FalseMarginsConfig) -> dict[Side, float]:
    """The film's ends at which its print has margins, and how far inside the print ends, as negative lengths."""
    margins = {side: float(grid.margins[int(side.edge), side.axis]) for side in SIDES}
    return {side: -margin for side, margin in margins.items() if margin > config.least}


def without_margins(
    pyramid: Pyramid,
    film: BackwardMap,
    wide: Mapping[Side, float],
    reader: StripReader,
    edges: EdgeConfig,
    config: FalseMarginsConfig,
) -> ShorterSheet | None:
    """The sheet without margins, if edges are seen near where these end, and put on these edges. wide: the margins, as
    negative lengths."""
    if not wide:
        return None
    start = lengthened(film, wide)
    read = look_across(pyramid, start, reader, edges)
    if not _lost(film, put_on_edges(start, read, edges), config):
        return None  # mostly: the edges that are seen are those of the map
    on_edges = put_on_edges(start, read_nearer(pyramid, read, reader, edges), edges)
    lost = _lost(film, on_edges, config)
    if not lost:
        return None
    read = look_across(pyramid, on_edges, reader, edges)
    return ShorterSheet(read, lost) if read.support.min() >= config.likely else None


def _lost(film: BackwardMap, shorter: BackwardMap, config: FalseMarginsConfig) -> dict[Side, float]:
    """By how much a shorter map is so at its ends, where that is no less than the narrowest margin."""
    inside = {side: -beyond_end(film, shorter, side) for side in SIDES}
    return {side: length for side, length in inside.items() if length > config.least}


__all__ = ["FalseMarginsConfig", "ShorterSheet", "ends_inside", "ends_of_print", "without_margins"]
