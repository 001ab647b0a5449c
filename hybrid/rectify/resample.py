"""The one place where the photo's pixels are read: from photo to flat film through a backward map."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap, Orientation, spline_weights
from hybrid.coords import film_centres_1d, opencv_from_photo, photo_from_opencv, sample_bilinear

KEPT_DENSITY = 1.6
"""Photo pixels per film pixel, along an axis, that are left for cubic interpolation where the photo is averaged down.
Cubic weights are closest to the area average between 1.4 and 2 (38 to 45 dB on a print's texts); at 4 they alias
(28 dB), and averaging down to 1 blurs twice (32 dB)."""
SHRINK_LIMIT = 2.4
"""Photo pixels per film pixel above which the photo is averaged down first."""
STRIP_ROWS = 128
"""Rows of the film that are made at a time."""
MARGIN_PX = 8
"""Photo pixels kept around the film when the photo is cropped: more than any interpolation kernel reaches."""


@dataclass(frozen=True, eq=False)
class Rectified:
    """The flat film with its light. image: (h, w, 3) uint8 sRGB, black where not ``valid``. valid: inside the photo."""

    image: UInt8[np.ndarray, "h w 3"]
    valid: Bool[np.ndarray, "h w"]

    def turned(self, way: Orientation) -> Rectified:
        """The film moved as ``way`` says."""
        return Rectified(*(np.ascontiguousarray(way.moved(picture)) for picture in (self.image, self.valid)))


def rectify_photo(photo: UInt8[np.ndarray, "H W 3"], backward: BackwardMap, size: tuple[int, int]) -> Rectified:
    """The film, flat, in ``size`` (h, w) pixels, interpolated once from the full-resolution photo."""
    low = np.maximum(np.floor(backward.nodes.min(axis=(0, 1))) - MARGIN_PX, 0).astype(int)
    high = np.minimum(np.ceil(backward.nodes.max(axis=(0, 1))) + MARGIN_PX, photo.shape[1::-1]).astype(int)
    if (high - low < 2).any():
        return Rectified(np.zeros((*size, 3), np.uint8), np.zeros(size, bool))
    part = photo[low[1] : high[1], low[0] : high[0]]
    local = backward.cropped((float(low[0]), float(low[1])))
    part, local = _averaged_down(part, local, size)
    image = np.empty((*size, 3), np.uint8)
    valid = np.ones(size, bool)
    surely_inside = _surely_inside(backward, photo.shape[:2])
    weights_v, columns_x, columns_y = _opencv_columns(local, size)
    # Strip by strip, the two maps stay in the processor's cache: that halves the time on top of the remap.
    for top in range(0, size[0], STRIP_ROWS):
        rows = slice(top, min(top + STRIP_ROWS, size[0]))
        map_x, map_y = weights_v[rows] @ columns_x, weights_v[rows] @ columns_y
        # Cubic: 2 dB closer than linear to an area-averaged print at one photo pixel per film pixel, for twice the
        # time; Lanczos gains another 0.3 dB for five times the time, and rings. Its 1/32 px steps do not show.
        cv2.remap(part, map_x, map_y, cv2.INTER_CUBIC, dst=image[rows], borderMode=cv2.BORDER_REPLICATE)
        if not surely_inside:
            valid[rows] = _inside(map_x, map_y, part.shape[:2])
            image[rows] *= valid[rows, :, None]
    return Rectified(image, valid)


def index_in_grid(
    photo_points: Float[np.ndarray, "h w 2"], points: Float[np.ndarray, "*n 2"], iterations: int = 8
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Fractional (column, row) of photo points in a map whose pixel centres lie at ``photo_points``.

    Exact at once where these are a regular grid, as of a window of the photo; a view of the film that is flattened by a
    map bends them, and a few corrections by the grid's mean slope follow that. Beyond the grid it goes on linearly.
    """
    corners = photo_points.astype(np.float64)
    origin, last = corners[0, 0], np.array(corners.shape[1::-1]) - 1
    slope = np.stack([(corners[0, -1] - origin) / last[0], (corners[-1, 0] - origin) / last[1]], axis=1)
    back = np.linalg.inv(slope).T
    flat = points.reshape(1, -1, 2)
    index = (flat - origin) @ back
    for _ in range(iterations):
        inside = np.clip(index, 0, last)
        at = photo_from_opencv(inside)
        seen = np.dstack([sample_bilinear(np.ascontiguousarray(corners[..., k], np.float32), at) for k in range(2)])
        index = index + (flat - seen - (index - inside) @ slope.T) @ back
    index = index.reshape(points.shape)
    return index[..., 0], index[..., 1]


def photo_per_film_pixel(backward: BackwardMap, size: tuple[int, int]) -> float:
    """Mean photo pixels per pixel of a film image of ``size`` (h, w), along one axis: above 1 the film is shrunk."""
    down, across = backward.mean_film_pixels()
    return float(np.sqrt(down / size[0] * across / size[1]))


def _averaged_down(
    part: UInt8[np.ndarray, "H W 3"], local: BackwardMap, size: tuple[int, int]
) -> tuple[UInt8[np.ndarray, "h w 3"], BackwardMap]:
    """The photo averaged over areas, with its map, where the film is shrunk so far that interpolation would alias."""
    shrink = photo_per_film_pixel(local, size)
    if shrink <= SHRINK_LIMIT:
        return part, local
    height, width = (max(round(n * KEPT_DENSITY / shrink), 4) for n in part.shape[:2])
    small = cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA)
    return small, local.cropped((0.0, 0.0), (width / part.shape[1], height / part.shape[0]))


def _opencv_columns(
    backward: BackwardMap, size: tuple[int, int]
) -> tuple[Float[np.ndarray, "h gh"], Float[np.ndarray, "gh w"], Float[np.ndarray, "gh w"]]:
    """Factors (float32) of OpenCV's two maps at the film's pixel centres: rows times columns of x, and of y.

    The shift between the frames is taken off the nodes, not off millions of pixels: the weights sum to one.
    """
    nodes = opencv_from_photo(backward.nodes)
    along_v = spline_weights(nodes.shape[0], film_centres_1d(size[0])).astype(np.float32)
    along_u = spline_weights(nodes.shape[1], film_centres_1d(size[1])).T
    return along_v, (nodes[..., 0] @ along_u).astype(np.float32), (nodes[..., 1] @ along_u).astype(np.float32)


def _surely_inside(backward: BackwardMap, size: tuple[int, int]) -> bool:
    """True where the nodes alone show that the whole film lies within an image of ``size``: the usual case."""
    # between nodes the spline leaves their range by far less than the distance of the outermost ones from the next
    spare = float(max(np.abs(np.diff(backward.nodes, axis=k)).max() for k in range(2)))
    return bool((backward.nodes > spare / 8).all() and (backward.nodes < np.array(size[::-1]) - spare / 8).all())


def _inside(
    map_x: Float[np.ndarray, "h w"], map_y: Float[np.ndarray, "h w"], size: tuple[int, int]
) -> Bool[np.ndarray, "h w"]:
    """Where OpenCV's maps point into an image of ``size``, its outermost half pixels included."""
    low = opencv_from_photo(np.zeros(2))
    high = opencv_from_photo(np.array(size[::-1], dtype=np.float64))
    inside = cv2.bitwise_and(
        cv2.inRange(map_x, float(low[0]), float(high[0])), cv2.inRange(map_y, float(low[1]), float(high[1]))
    )
    return inside.astype(bool)
