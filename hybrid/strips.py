"""The sheet's four sides, and strips of the photo across them as a map predicts them: what EdgeNet reads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d
from hybrid.film_view import view_film
from hybrid.pyramid import Photo, Pyramid


@dataclass(frozen=True)
class Side:
    """One side of the sheet. ``axis``: the coordinate that is fixed on it; ``edge``: its value; ``inward``: +-1."""

    name: str
    axis: int
    edge: float
    inward: float

    def film_points(self, along: Float[np.ndarray, " n"], depth: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Film points at places along the side, at these depths inside it."""
        points = np.empty((len(along), 2))
        points[:, self.axis], points[:, 1 - self.axis] = self.edge + self.inward * depth, along
        return points


SIDES = (
    Side("top", 1, 0.0, 1.0),
    Side("bottom", 1, 1.0, -1.0),
    Side("left", 0, 0.0, 1.0),
    Side("right", 0, 1.0, -1.0),
)


@dataclass(frozen=True)
class StripConfig:
    """rows: across the edge, from ``reach`` (film units) outside its predicted place to as far inside. columns: along
    it, each the mean of ``fine`` samples."""

    rows: int = 96
    columns: int = 64
    reach: float = 0.096
    fine: int = 4

    @property
    def depth(self) -> Float[np.ndarray, " rows"]:
        """Film units by which the rows lie inside the predicted edge."""
        return self.reach * (2 * film_centres_1d(self.rows) - 1)

    @property
    def pitch(self) -> float:
        """Film units from row to row."""
        return float(self.depth[1] - self.depth[0])

    def depth_of(self, row: np.ndarray) -> np.ndarray:
        """The same at fractional rows."""
        return np.interp(row, np.arange(self.rows), self.depth)

    def row_of(self, depth: np.ndarray) -> np.ndarray:
        """Its inverse, continued beyond the strip."""
        return (depth - self.depth[0]) / self.pitch


@dataclass(frozen=True, eq=False)
class StripReader:
    """What reads strips. strip: how they are cut. logs: from strips, in fours that belong together, and from where the
    photo covers them, the log-probabilities of the rows at which the edge crosses each column; the last: that it is not
    in the strip."""

    strip: StripConfig
    logs: Callable[[UInt8[np.ndarray, "k r c 3"], Bool[np.ndarray, "k r c"]], Float[np.ndarray, "k r1 c2"]]


def view_across(
    photo: Photo, film: BackwardMap, side: Side, depth: Float[np.ndarray, " d"], columns: int, fine: int
) -> tuple[Float[np.ndarray, "d p 3"], Bool[np.ndarray, "d p"]]:
    """The photo across one side: rows at these depths inside it, columns that are means of ``fine`` samples along it;
    and where the photo covers all of these samples."""
    along, across = film_centres_1d(columns * fine), side.edge + side.inward * depth
    if side.axis == 1:
        view = view_film(photo, film, along, across)
        image = cv2.resize(view.image, (columns, len(depth)), interpolation=cv2.INTER_AREA)  # the mean of each ``fine``
        return image, _all_of_each(view.inside, fine)
    view = view_film(photo, film, across, along)
    image = cv2.resize(view.image, (len(depth), columns), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(image.transpose(1, 0, 2)), _all_of_each(view.inside.T, fine)


def _all_of_each(inside: Bool[np.ndarray, "d n"], fine: int) -> Bool[np.ndarray, "d p"]:
    """Whether all columns in each group of ``fine`` are true."""
    if inside.all():
        return np.ones((len(inside), inside.shape[1] // fine), dtype=bool)
    return np.logical_and.reduce([inside[:, k::fine] for k in range(fine)])


def strip_copy(pyramid: Pyramid, film: BackwardMap, config: StripConfig) -> tuple[Photo, BackwardMap]:
    """The smallest copy of a photo that has a pixel for each row of a strip, and the map into it."""
    photo, factor = pyramid.reduced(max(film.mean_film_pixels()) * config.pitch)
    return photo, film.cropped((0.0, 0.0), (1 / factor, 1 / factor))


def edge_strips(
    photo: Photo, film: BackwardMap, config: StripConfig
) -> tuple[UInt8[np.ndarray, "4 r c 3"], Bool[np.ndarray, "4 r c"]]:
    """The strips of SIDES, outermost row first, and where the photo covers them."""
    return strips_across(photo, [(side, film) for side in SIDES], config)


def strips_across(
    photo: Photo, lines: Sequence[tuple[Side, BackwardMap]], config: StripConfig
) -> tuple[UInt8[np.ndarray, "k r c 3"], Bool[np.ndarray, "k r c"]]:
    """Strips across lines, each predicted by a map of its own, and where the photo covers them."""
    images = np.empty((len(lines), config.rows, config.columns, 3), np.uint8)
    inside = np.empty(images.shape[:3], bool)
    for k, (side, film) in enumerate(lines):
        image, inside[k] = view_across(photo, film, side, config.depth, config.columns, config.fine)
        images[k] = np.rint(image)
    return images, inside


__all__ = ["SIDES", "Side", "StripConfig", "StripReader", "edge_strips", "strip_copy", "strips_across", "view_across"]
