"""Ground that was taken for margins: where the sheet ends before its map does.

With its own hard shadow behind it, or on a plain sheet that sticks out below it, a film looks like a larger one whose
print has margins. So the map is cut to its print, and the edges near there are read: mostly, nothing within a sheet
looks like its edge. Where all four are as good as certain even once the shorter sheet is refined, and its print lies in
its middle, what was cut off is no margin if it sticks out farther on one side than on the opposite one, if the longer
map ended in something that does not look like the sheet's edge, or if the grid has become far more probable.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hybrid.backward import BackwardMap
from hybrid.errors import require_at_least, require_at_most
from hybrid.pyramid import Pyramid
from hybrid.records import SliceGrid
from hybrid.rectify.edges.paths import EdgeConfig, EdgesRead, look_across, put_on_edges, read_nearer
from hybrid.rectify.margins.clear import beyond_end, lengthened, told_of, unlike_ends
from hybrid.strips import SIDES, Side, StripReader


@dataclass(frozen=True)
class FalseMarginsConfig:
    """Options of the search for ground that was taken for margins. Lengths in parts of the film along the axis.

    least: narrowest margin that is cut off. likely, sure: least probability of every edge before the shorter sheet is
    refined, and after it. most_lopsided: most by which its opposite margins may then differ (``SliceGrid.lopsided``).
    One of three must also hold: what was cut off differs on opposite sides by ``unlike``; some edge of the longer map
    looked like the sheet's with less than the probability ``unseen``; or the grid is more probable by ``grid_gained``.
    """

    least: float = 0.02
    likely: float = 0.6
    sure: float = 0.9
    most_lopsided: float = 0.02
    unlike: float = 0.035
    unseen: float = 0.3
    grid_gained: float = 0.5

    def __post_init__(self) -> None:
        require_at_least(self, 1e-3, "least")
        require_at_most(self, 1, "likely", "sure")


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


def without_margins(
    pyramid: Pyramid,
    film: BackwardMap,
    grid: SliceGrid,
    reader: StripReader,
    edges: EdgeConfig,
    config: FalseMarginsConfig,
) -> ShorterSheet | None:
    """The sheet without its margins, if edges are seen near where its print ends, and put on these edges. grid: of the
    print, through ``film``."""
    margins = {side: float(grid.margins[int(side.edge), side.axis]) for side in SIDES}
    wide = {side: -margin for side, margin in margins.items() if margin > config.least}
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


__all__ = ["FalseMarginsConfig", "ShorterSheet", "without_margins"]
