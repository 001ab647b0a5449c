"""The one place where the photo's pixels are read: from photo to flat film through a backward map."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap, Orientation, spline_weights
from hybrid.coords import film_centres_1d, film_nodes, opencv_from_photo, photo_from_opencv, sample_bilinear
from hybrid.pyramid import Pyramid
from hybrid.rectify.film.rounding import RoundingConfig, blank_beyond, find_round_corners
from hybrid.rectify.film.spill import SpillConfig, limit_spill
from hybrid.round_corners import RoundCorners
from hybrid.threads import in_strips

SHRINK_LIMIT = 2.4
"""Photo pixels per film pixel, along an axis, above which the photo is halved first. Up to this limit, interpolation
comes as near to an area average of a print's texts as on the halved photo (40 to 43 dB); above, it aliases."""
STRIP_ROWS = 128
"""Rows of the film made at a time."""
LEAST_WEIGHT = 1e-7
"""Weights of nodes below this are lost in single precision."""
MARGIN_PX = 8
"""Photo pixels kept around the film when the photo is cropped: more than the reach of any interpolation kernel."""


@dataclass(frozen=True)
class ResampleConfig:
    """How the photo's pixels are interpolated."""

    cubic_below: float = 1.0
    """Photo pixels per film pixel, along an axis, below which interpolation is cubic, at 2.5 times the cost of linear.
    Against an area average of a print's texts, cubic gains 3 dB at 0.7 (34 against 32 dB) and at 1 (40 against 37, far
    above all other errors of a film), nothing at 1.4, and loses beyond (at 1.8: 41 against 47). 0: never."""
    rounding: RoundingConfig = field(default_factory=RoundingConfig)
    """Options of ``read_film``'s search for round corners."""
    spill: SpillConfig = field(default_factory=SpillConfig)
    """Options of ``read_film``'s correction of the outermost pixels."""


@dataclass(frozen=True, eq=False)
class Rectified:
    """The flat film, light kept.

    image: (h, w, 3) uint8 sRGB, black where not ``valid``. valid: inside the photo, and not beyond the sheet's round
    corners. corners: these, if they were seen.
    """

    image: UInt8[np.ndarray, "h w 3"]
    valid: Bool[np.ndarray, "h w"]
    corners: RoundCorners | None = None

    def turned(self, way: Orientation) -> Rectified:
        """The film moved as ``way`` says."""
        image, valid = (np.ascontiguousarray(way.moved(picture)) for picture in (self.image, self.valid))
        return Rectified(image, valid, self.corners and self.corners.turned(way.turns))

    def __str__(self) -> str:
        size = f"{self.image.shape[1]} x {self.image.shape[0]} pixels"
        return size if self.corners is None else f"{size}, its corners rounded by {self.corners.u:.1%} of its width"


def read_film(
    photo: UInt8[np.ndarray, "H W 3"] | Pyramid,
    backward: BackwardMap,
    size: tuple[int, int],
    config: ResampleConfig | None = None,
) -> Rectified:
    """As ``rectify_photo``, through the map of a whole sheet: what lies beyond its round corners is not valid, and its
    rim is freed of the ground that shines into it."""
    config = config or ResampleConfig()
    pyramid = photo if isinstance(photo, Pyramid) else Pyramid(photo)
    flat = rectify_photo(pyramid, backward, size, config)
    corners = find_round_corners(pyramid.photo, backward, size[0] / size[1], config.rounding)
    if corners is not None:
        blank_beyond(corners, flat.image, flat.valid)
    limit_spill(flat.image, flat.valid, pyramid.photo, backward, config.spill)
    return replace(flat, corners=corners)


def rectify_photo(
    photo: UInt8[np.ndarray, "H W 3"] | Pyramid,
    backward: BackwardMap,
    size: tuple[int, int],
    config: ResampleConfig | None = None,
) -> Rectified:
    """The film, flat, in ``size`` (h, w) pixels, interpolated once from the full-resolution photo.

    A photo with far more pixels than the film is interpolated from a copy of half its size, or less.
    """
    pyramid = photo if isinstance(photo, Pyramid) else Pyramid(photo)
    shrink = photo_per_film_pixel(backward, size)
    part, factor = pyramid.reduced(2.0 * shrink / SHRINK_LIMIT)
    whole = np.array(pyramid.photo.shape[1::-1]) / factor  # a copy lacks the remainder that halving dropped
    backward, shrink = backward.cropped((0.0, 0.0), (1.0 / factor, 1.0 / factor)), shrink / factor
    low = np.maximum(np.floor(backward.nodes.min(axis=(0, 1))) - MARGIN_PX, 0).astype(int)
    high = np.minimum(np.ceil(backward.nodes.max(axis=(0, 1))) + MARGIN_PX, part.shape[1::-1]).astype(int)
    if (high - low < 2).any():
        return Rectified(np.zeros((*size, 3), np.uint8), np.zeros(size, bool))
    surely_inside = _surely_inside(backward, whole)
    part = part[low[1] : high[1], low[0] : high[0]]  # OpenCV reads no image of more than 32,767 pixels a side
    image = np.empty((*size, 3), np.uint8)
    valid = np.ones(size, bool)
    weights_v, columns_x, columns_y = _opencv_columns(backward.cropped((float(low[0]), float(low[1]))), size)
    # OpenCV's cubic steps of 1/32 px do not show; Lanczos gains another 0.3 dB at five times the cost, and rings.
    method = cv2.INTER_CUBIC if shrink < (config or ResampleConfig()).cubic_below else cv2.INTER_LINEAR

    def read(rows: slice) -> None:
        weights, near = _near_rows(weights_v[rows])
        map_x, map_y = weights @ columns_x[near], weights @ columns_y[near]
        cv2.remap(part, map_x, map_y, method, dst=image[rows], borderMode=cv2.BORDER_REPLICATE)
        if not surely_inside:
            valid[rows] = _inside(map_x, map_y, whole - low)
            image[rows] *= valid[rows, :, None]

    in_strips(read, size[0], STRIP_ROWS)  # the two maps stay in the cache: this halves the time on top of the remap
    return Rectified(image, valid)


def index_in_grid(
    photo_points: Float[np.ndarray, "h w 2"], points: Float[np.ndarray, "*n 2"], iterations: int = 2
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Fractional (column, row) of photo points in a map whose pixel centres lie at ``photo_points``.

    Exact at once where these are a plane seen aslant, as for a window of the photo or a film flattened by a plane's
    map; a few corrections follow any bending. Beyond the grid, the index goes on as the plane does.
    """
    origin, last = photo_points[0, 0].astype(np.float64), np.array(photo_points.shape[1::-1]) - 1
    grid = photo_points - origin
    corners, ends = grid[[0, 0, -1, -1], [0, -1, 0, -1]], film_nodes((2, 2)).reshape(-1, 2) * last
    plane = cv2.getPerspectiveTransform(corners.astype(np.float32), ends.astype(np.float32))
    x, y = (np.ascontiguousarray(grid[..., k], np.float32) for k in range(2))
    flat = points if points.ndim == 3 else points.reshape(1, -1, 2)  # OpenCV's rows are shorter than 32,767
    on_plane = index = cv2.perspectiveTransform(flat - origin, plane)
    for _ in range(iterations):
        inside = np.clip(index, 0, last)
        at = photo_from_opencv(inside)
        seen = np.dstack([sample_bilinear(x, at), sample_bilinear(y, at)])
        index = on_plane + inside - cv2.perspectiveTransform(seen.astype(np.float64), plane)
    index = index.reshape(points.shape)
    return index[..., 0], index[..., 1]


def photo_per_film_pixel(backward: BackwardMap, size: tuple[int, int]) -> float:
    """Mean photo pixels per pixel of a film image of ``size`` (h, w), along one axis: above 1 the film is shrunk."""
    down, across = backward.mean_film_pixels()
    return float(np.sqrt(down / size[0] * across / size[1]))


def _opencv_columns(
    backward: BackwardMap, size: tuple[int, int]
) -> tuple[Float[np.ndarray, "h gh"], Float[np.ndarray, "gh w"], Float[np.ndarray, "gh w"]]:
    """Factors (float32) of OpenCV's two maps at the film's pixel centres: rows times columns of x, and of y.

    The shift between the frames is subtracted from the nodes, not from millions of pixels: the weights sum to one.
    """
    nodes = opencv_from_photo(backward.nodes)
    along_v = spline_weights(nodes.shape[0], film_centres_1d(size[0])).astype(np.float32)
    along_u = spline_weights(nodes.shape[1], film_centres_1d(size[1])).T
    return along_v, (nodes[..., 0] @ along_u).astype(np.float32), (nodes[..., 1] @ along_u).astype(np.float32)


def _near_rows(weights: Float[np.ndarray, "h gh"]) -> tuple[Float[np.ndarray, "h n"], slice]:
    """The weights of those rows of nodes that matter to some rows of pixels, and which: a spline's weights fall off by
    0.27 from node to node, so a map of many nodes is read several times as fast."""
    rows = np.flatnonzero(np.abs(weights).max(axis=0) > LEAST_WEIGHT)
    near = slice(rows[0], rows[-1] + 1)
    return weights[:, near], near


def _surely_inside(backward: BackwardMap, end: Float[np.ndarray, "2"]) -> bool:
    """True where the nodes alone show that the whole film lies within an image that ends at ``end``: the usual case."""
    # between nodes the spline leaves their range by far less than the distance from the outermost ones to the next
    spare = float(max(np.abs(np.diff(backward.nodes, axis=k)).max() for k in range(2)))
    return bool((backward.nodes > spare / 8).all() and (backward.nodes < end - spare / 8).all())


def _inside(
    map_x: Float[np.ndarray, "h w"], map_y: Float[np.ndarray, "h w"], end: Float[np.ndarray, "2"]
) -> Bool[np.ndarray, "h w"]:
    """Where OpenCV's maps point into an image that ends at ``end`` (x, y), its outermost half pixels included."""
    low, high = opencv_from_photo(np.zeros(2)), opencv_from_photo(end)
    inside = cv2.bitwise_and(
        cv2.inRange(map_x, float(low[0]), float(high[0])), cv2.inRange(map_y, float(low[1]), float(high[1]))
    )
    return inside.astype(bool)
