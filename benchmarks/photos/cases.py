"""Photos to score methods on: a photo and its true map, from a data set's shards or a folder of photos."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from benchmarks.photos.truth import load_photo, load_photos
from hybrid.backward import BackwardMap, Orientation
from hybrid.coords import film_nodes, pixel_centres, rescale_points
from hybrid.draw import resized
from hybrid.errors import DataError, describe
from hybrid.image_io import read_photo
from hybrid.learn.datasets.samples import Place, film_of, open_places, photo_of, truth_at
from hybrid.learn.networks.tensors import map_batch
from hybrid.learn.paper.dewarpnet import coordinate_code
from hybrid.rectify.film.size import FilmSizeConfig

SAME_SIZE = 1.25
"""Ratio of areas up to which a photo counts as having the requested size."""

CORNERS = (2, 2)
"""Film points that tell the eight ways of reading a film apart."""


@dataclass(frozen=True, eq=False)
class Case:
    """A photo whose truth is known.

    source: its file, or its place in a data set. backward: the true map of the film that reads right, in pixels.
    size: (height, width) to which the photo is resized; its own if None. held: returns the photo, if in memory.
    """

    name: str
    source: Path | Place
    backward: BackwardMap
    size: tuple[int, int] | None = None
    held: Callable[[], UInt8[np.ndarray, "h w 3"]] | None = None

    def photo(self) -> UInt8[np.ndarray, "h w 3"]:
        """The photo itself, RGB; a copy for the caller, unless it is lent."""
        if self.held is not None:
            return self.held()
        photo = read_photo(self.source) if isinstance(self.source, Path) else photo_of(self.source)
        return photo if self.size is None else resized(photo, self.size)

    def at(self, megapixels: float) -> Case:
        """The case with its photo, and its truth, resized to this many megapixels; unchanged if it is near that.

        Near is within SAME_SIZE: resizing a photo for nothing would only blur it.
        """
        height, width = self.photo().shape[:2]
        area = 1e6 * megapixels / (height * width)
        if 1 / SAME_SIZE <= area <= SAME_SIZE:
            return self
        size = (round(height * area**0.5), round(width * area**0.5))
        truth = self.backward.cropped((0.0, 0.0), (size[1] / width, size[0] / height))
        return replace(self, backward=truth, size=size, held=None)

    def in_memory(self) -> Case:
        """The case with its photo read once and kept; it gives copies of it."""
        return replace(self, held=self.photo().copy)

    def lending(self, photo: UInt8[np.ndarray, "h w 3"]) -> Case:
        """The case with this photo, which it returns as it is: no copy is made."""
        return replace(self, held=lambda: photo)

    def film_size(self) -> tuple[int, int]:
        """Size (h, w) of the flat film: what the photo resolves, but no larger than ``hybrid`` makes it."""
        down, across = self.backward.mean_film_pixels()
        scale = min(1.0, FilmSizeConfig().max_side_px / max(down, across))
        return max(1, round(down * scale)), max(1, round(across * scale))

    @cached_property
    def sheet_ratio(self) -> float:
        """Height over width of the sheet itself."""
        if isinstance(self.source, Path):
            height, width = load_photo(self.source.with_suffix(".npz")).read_print().shape
        else:
            shard, k = self.source
            height, width = shard.record(k)["size_mm"]
        return height / width


def photo_cases(folder: Path) -> list[Case]:
    """The photos with truth in a folder.

    Raises:
        DataError: there are none, or one is incomplete.
    """
    return [Case(truth.name, truth.path, truth.backward) for truth in load_photos(folder)]


def sample_cases(folders: Sequence[Path]) -> list[Case]:
    """The samples of one or more data sets.

    Raises:
        DataError: a data set that cannot be read.
    """
    places = open_places(folders)
    return [Case(f"{shard.entry.first + k:06d}", (shard, k), film_of((shard, k))) for shard, k in places]


@dataclass(frozen=True, eq=False)
class TrueShape:
    """What networks of 3D maps are given: the code of the true 3D map, its mask, and the photo's size (h, w)."""

    code: Float[Tensor, "1 3 n n"]
    mask: Bool[np.ndarray, "n n"]
    photo_size: tuple[int, int]


def true_shape(case: Case, px: int) -> TrueShape:
    """The 3D map of a sample at px x px.

    Raises:
        DataError: the case is not a sample of a data set.
    """
    if isinstance(case.source, Path):
        raise DataError(
            describe(what="3D map", where=case.name, got="a photo without one", do="Use a data set's samples.")
        )
    height, width = case.photo().shape[:2]
    points = rescale_points(pixel_centres((px, px)), (px, px), (height, width))
    truth = truth_at(case.source, points, (height, width))
    code = coordinate_code(map_batch([truth.xyz]), map_batch([truth.mask]))
    return TrueShape(code, truth.mask, (height, width))


def read_alike(found: BackwardMap, true: BackwardMap) -> tuple[BackwardMap, Orientation]:
    """The map, turned and mirrored to come nearest to the true one, and the orientation that does this.

    Geometry is scored apart from orientation: networks that see a small film as it lies cannot know how it reads, and a
    film at 45 degrees lies either way.
    """
    points = true.photo_from_film(film_nodes(CORNERS))
    ways = [Orientation.from_index(index) for index in range(8)]
    maps = [found.turned(way) for way in ways]
    errors = [float(np.linalg.norm(m.photo_from_film(film_nodes(CORNERS)) - points, axis=-1).mean()) for m in maps]
    best = int(np.argmin(errors))
    return maps[best], ways[best]


__all__ = ["Case", "TrueShape", "photo_cases", "read_alike", "sample_cases", "true_shape"]
