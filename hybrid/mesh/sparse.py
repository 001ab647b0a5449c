"""Few rays for many pixels: interpolate between rays where the film is smooth, and mark the pixels where it is not."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from hybrid.coords import opencv_from_photo, rescale_points

_LINE_BITS = 4
"""Fractional bits of the points of OpenCV's lines."""

_RIM_SCALE = 2
"""Lines are drawn at twice the photo's resolution, two fine pixels wide: every pixel that they cross is marked."""


@dataclass(frozen=True)
class Sparse:
    """How sparsely rays are cast where the film is smooth.

    spacing: pixels between rays. error_px: largest error, in photo pixels, of what is interpolated between them.
    """

    spacing: int
    error_px: float

    def blocks(self, size: tuple[int, int]) -> tuple[int, int]:
        """Rows and columns of blocks that cover a photo, with one more on either side."""
        return -(-size[0] // self.spacing) + 2, -(-size[1] // self.spacing) + 2


FOR_PHOTOS, FOR_MAPS = Sparse(4, 0.03), Sparse(2, 0.01)


@dataclass(frozen=True, eq=False)
class Blocks:
    """What rays (camera axes, z = 1) through the centres of blocks meet: uv and depth (mm), NaN for a miss."""

    rays: Float32[np.ndarray, "r c 3"]
    hit: Bool[np.ndarray, "r c"]
    uv: Float32[np.ndarray, "r c 2"]
    depth: Float32[np.ndarray, "r c"]


def enlarged(values: np.ndarray, size: tuple[int, int], sparse: Sparse, how: int = cv2.INTER_LINEAR) -> np.ndarray:
    """Values of the blocks at the pixels of a photo of ``size``.

    Enlarged pixel areas keep their centres: between the blocks' centres this is bilinear interpolation, and a miss
    (NaN) spreads to every pixel that its ray contributes to.
    """
    (h, w), step = size, sparse.spacing
    fine = cv2.resize(values, (values.shape[1] * step, values.shape[0] * step), interpolation=how)
    return np.ascontiguousarray(fine[step : step + h, step : step + w])


def smooth_film(
    blocks: Blocks, rim: Bool[np.ndarray, "h w"], size: tuple[int, int], sparse: Sparse
) -> tuple[Bool[np.ndarray, "h w"], Float32[np.ndarray, "h w 2"], Bool[np.ndarray, "h w"]]:
    """Mask and uv interpolated between the blocks, and the pixels where that is not good enough.

    These are the pixels near the rim, those where some of the rays miss the film, and those where uv's second
    difference shows that interpolation errs by more than ``error_px``.
    """
    uv = enlarged(blocks.uv, size, sparse)
    mask = uv[..., 0] == uv[..., 0]  # not NaN
    touched = cv2.dilate(blocks.hit.astype(np.uint8), np.ones((3, 3), np.uint8))
    reach = np.ones((sparse.spacing + 3, sparse.spacing + 3), np.uint8)  # a block's centre is at most half a block away
    wanted = cv2.dilate(rim.astype(np.uint8), reach)
    wanted |= enlarged(_rough(blocks.uv, sparse), size, sparse, cv2.INTER_NEAREST)
    wanted |= (enlarged(touched, size, sparse, cv2.INTER_NEAREST) > mask).astype(np.uint8)
    return mask, uv, wanted.astype(bool)


def bumpy(blocks: Blocks, focal_px: float, size: tuple[int, int], sparse: Sparse) -> Bool[np.ndarray, "h w"]:
    """Pixels at which the interpolated depth errs by more than ``error_px`` times a pixel's size at that depth."""
    marks = np.zeros(blocks.depth.shape, np.uint8)
    for axis in (0, 1):
        before, here, after = (_along(blocks.depth, axis, k) for k in range(3))
        bent = np.abs(after - 2 * here + before)
        _along(marks, axis, 1)[bent > 8 * sparse.error_px / focal_px * here] = 1
    return enlarged(_spread(marks), size, sparse, cv2.INTER_NEAREST).astype(bool)


def _rough(uv: Float32[np.ndarray, "r c 2"], sparse: Sparse) -> np.ndarray:
    """Marks of the blocks around which bilinear interpolation of ``uv`` errs by more than ``error_px``.

    It errs by an eighth of the second difference; the first difference, over two spacings, converts that to pixels.
    Where a ray missed, both are NaN and the comparison is False.
    """
    marks = np.zeros(uv.shape[:2], np.uint8)
    for axis in (0, 1):
        before, here, after = (_along(uv, axis, k) for k in range(3))
        bent, way = np.abs(after - 2 * here + before), np.abs(after - before)
        bent, way = (np.maximum(x[..., 0], x[..., 1]) for x in (bent, way))  # a reduction over two is ten times slower
        _along(marks, axis, 1)[bent > 8 * sparse.error_px / (2 * sparse.spacing) * way] = 1
    return _spread(marks)


def _spread(marks: np.ndarray) -> np.ndarray:
    return cv2.dilate(marks, np.ones((3, 3), np.uint8))


def _along(values: np.ndarray, axis: int, start: int) -> np.ndarray:
    """A view of all but two of the values along an axis: the first, the middle or the last ones."""
    stop = values.shape[axis] - 2 + start
    return values[start:stop] if axis == 0 else values[:, start:stop]


def crossed(lines: list[Float[np.ndarray, "_ 2"]], size: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """Pixels of a photo of ``size`` that lines (photo points) run through, and a few beside them."""
    fine = (_RIM_SCALE * size[0], _RIM_SCALE * size[1])
    picture = np.zeros(fine, np.uint8)
    limit = 4.0 * max(fine)  # OpenCV's lines take 32-bit numbers; film that far outside does not show
    points = [np.clip(opencv_from_photo(rescale_points(line, size, fine)), -limit, limit) for line in lines]
    fixed = [np.rint(p * 2**_LINE_BITS).astype(np.int32) for p in points]
    cv2.polylines(picture, fixed, False, 255, _RIM_SCALE, cv2.LINE_8, _LINE_BITS)
    return cv2.resize(picture, size[::-1], interpolation=cv2.INTER_AREA) > 0
