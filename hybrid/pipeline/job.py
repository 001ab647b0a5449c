"""What the stages share about a photo to rectify: its copies, the networks that read its film, and the options."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from hybrid.backward import BackwardMap
from hybrid.effort import RectifyConfig
from hybrid.learn.networks.edgenet import strip_reader
from hybrid.learn.networks.filmnet import FilmNet, FilmNetConfig
from hybrid.learn.networks.inference import ready
from hybrid.learn.networks.lightnet import level_reader
from hybrid.learn.networks.weights import (
    load_weights,
    packaged_border_net,
    packaged_edge_net,
    packaged_film_net,
    packaged_light_net,
    packaged_slice_net,
    packaged_upright_net,
)
from hybrid.learn.reading.orientation import OrientationReader
from hybrid.levels import LevelReader
from hybrid.pyramid import Pyramid
from hybrid.records import CoarseMaps
from hybrid.rectify.edges.paths import EdgesRead, look_across
from hybrid.rectify.grid.phases import CellPhases
from hybrid.rectify.refine.config import RefineConfig
from hybrid.rectify.refine.refine import Refinement
from hybrid.strips import StripReader


@dataclass(frozen=True, eq=False)
class Readers:
    """The networks that read a film.

    network: sees it in the photo as a whole. edges, borders: read strips across the sheet's edges, and across the
    borders between its cells. orientation, levels: see it flat: which way is up, and what print black and print white
    look like.
    """

    network: FilmNet
    edges: StripReader
    borders: StripReader
    orientation: OrientationReader
    levels: LevelReader

    @classmethod
    def packaged(cls, weights: Path | None = None) -> Readers:
        """The packaged networks. weights: a file with those of another ``network``.

        Raises:
            DataError: it is not a weights file.
        """
        network = packaged_film_net() if weights is None else load_weights(weights, FilmNet, FilmNetConfig)
        return cls(
            ready(network),
            strip_reader(ready(packaged_edge_net())),
            strip_reader(ready(packaged_border_net())),
            OrientationReader(ready(packaged_upright_net()), ready(packaged_slice_net())),
            level_reader(ready(packaged_light_net())),
        )


@dataclass(frozen=True, eq=False)
class Job:
    """A photo on its way to the film: what reads it, and how."""

    pyramid: Pyramid
    readers: Readers
    config: RectifyConfig

    def refining(self, refine: RefineConfig) -> Job:
        """The same with other options of refinement."""
        return replace(self, config=replace(self.config, refine=refine))

    def granting(self, counts: tuple[int, int]) -> Job:
        """The same with these numbers of columns and rows taken for granted."""
        refine = self.config.refine
        return self.refining(replace(refine, cells=replace(refine.cells, counts=counts)))

    def phases_of(self, maps: CoarseMaps) -> CellPhases | None:
        """What the network says of the cells, if the options ask for it."""
        return CellPhases.of(maps, self.readers.borders) if self.config.told_cells else None

    def look_across(self, film: BackwardMap) -> EdgesRead:
        """The sheet's edges as they are read across those of a map."""
        return look_across(self.pyramid, film, self.readers.edges, self.config.edges)

    def edges_of(self, refinement: Refinement) -> EdgesRead:
        """The edges as read across a refinement's map; they are read now if they have not been."""
        return refinement.across or self.look_across(refinement.backward)


__all__ = ["Job", "Readers"]
