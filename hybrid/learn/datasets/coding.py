"""How a sample's maps are stored: integers of a known error, made and undone here and nowhere else.

| map | stored as | largest error |
| --- | --- | --- |
| mask, glare | bool | none |
| uv | uint16, 0 to 65535 for 0 to 1 | 7.7e-6 of the film's side |
| xyz | uint16 for each axis, between the sample's least and largest value (offset and step in its record) | 1 / 131070 of that range: 0.0046 mm for 600 mm |
| normal | int16, two octahedral coordinates (Meyer et al. 2010), -32767 to 32767 for -1 to 1 | 0.004 degrees |
| albedo | uint8, 0 to 255 for 0 to 1 | 0.002 |

Stored maps are 0 where the mask is False; decoded ones are NaN there (glare: False).
"""  # noqa: E501 - rows of a table

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int16, Shaped, UInt8, UInt16

UV_LEVELS = 65535
XYZ_LEVELS = 65535
NORMAL_LEVELS = 32767
ALBEDO_LEVELS = 255

Mask = Bool[np.ndarray, "h w"]


def encode_uv(uv: Float[np.ndarray, "h w 2"], mask: Mask) -> UInt16[np.ndarray, "h w 2"]:
    """Film coordinates in [0, 1] in steps of 1 / 65535."""
    return _levels(uv, mask, (UV_LEVELS, UV_LEVELS), cv2.CV_16U)


def decode_uv(stored: UInt16[np.ndarray, "h w 2"], mask: Mask) -> Float[np.ndarray, "h w 2"]:
    return _put(_picked(stored, mask) / np.float32(UV_LEVELS), mask, np.float32)


def encode_xyz(
    xyz: Float[np.ndarray, "h w 3"], mask: Mask
) -> tuple[UInt16[np.ndarray, "h w 3"], dict[str, list[float]]]:
    """Coordinates in mm in 65535 steps between the least and the largest of each axis, and the offset and step."""
    values = _picked(xyz, mask)
    low, high = (values.min(axis=1), values.max(axis=1)) if values.size else (np.zeros(3), np.ones(3))
    low, step = low.astype(np.float64), np.maximum((high - low.astype(np.float64)) / XYZ_LEVELS, 1e-9)
    stored = _levels(xyz - low.astype(np.float32), mask, tuple((1 / step).tolist()), cv2.CV_16U)
    return stored, {"offset": low.tolist(), "step": step.tolist()}


def decode_xyz(
    stored: UInt16[np.ndarray, "h w 3"], mask: Mask, coding: dict[str, list[float]]
) -> Float[np.ndarray, "h w 3"]:
    return _put(xyz_from_stored(_picked(stored, mask).T, coding).T, mask, np.float32)


def xyz_from_stored(stored: np.ndarray, coding: dict[str, list[float]]) -> Float[np.ndarray, "*n 3"]:
    """Coordinates in mm of stored ones (..., 3), or of means of them."""
    return stored * np.array(coding["step"]) + np.array(coding["offset"])


def encode_normal(normal: Float[np.ndarray, "h w 3"], mask: Mask) -> Int16[np.ndarray, "h w 2"]:
    """Unit vectors on the octahedron |x| + |y| + |z| = 1, its lower half folded out into the corners of a square."""
    x, y, z = cv2.split(cv2.copyTo(normal.astype(np.float32), mask.view(np.uint8)))
    p = np.stack([x, y]) / np.maximum(np.abs(x) + np.abs(y) + np.abs(z), np.float32(1e-9))
    p = np.where(z < 0, _folded(p), p)
    return _levels(cv2.merge([*p]), mask, (NORMAL_LEVELS, NORMAL_LEVELS), cv2.CV_16S)


def decode_normal(stored: Int16[np.ndarray, "h w 2"], mask: Mask) -> Float[np.ndarray, "h w 3"]:
    p = _picked(stored, mask) / np.float32(NORMAL_LEVELS)
    z = 1 - np.abs(p).sum(axis=0)
    n = np.stack([*np.where(z < 0, _folded(p), p), z])
    return _put(n / np.linalg.norm(n, axis=0), mask, np.float32)


def _folded(p: Float[np.ndarray, "2 *n"]) -> Float[np.ndarray, "2 *n"]:
    """Points reflected at the edge |x| + |y| = 1 of their quadrant; its own inverse."""
    x, y = np.abs(p)
    return np.stack([np.copysign(1 - y, p[0]), np.copysign(1 - x, p[1])])


def encode_albedo(albedo: Float[np.ndarray, "h w"], mask: Mask) -> UInt8[np.ndarray, "h w"]:
    """Display grey in [0, 1] in steps of 1 / 255."""
    return _levels(albedo, mask, (ALBEDO_LEVELS,), cv2.CV_8U)


def decode_albedo(stored: UInt8[np.ndarray, "h w"], mask: Mask) -> Float[np.ndarray, "h w"]:
    return _put(_picked(stored, mask) / np.float32(ALBEDO_LEVELS), mask, np.float32)[..., 0]


def _levels(
    values: Float[np.ndarray, "h w *c"], mask: Mask, scale: tuple[float | int, ...], kind: int
) -> Shaped[np.ndarray, "h w *c"]:
    """Values times the scale of their channel, rounded and kept within the type; 0 where the mask is False."""
    film = cv2.copyTo(values.astype(np.float32), mask.view(np.uint8))
    return cv2.multiply(film, np.array([*scale, *(4 - len(scale)) * [0]], np.float64), dtype=kind)


# Numbers of pixels and rows of channels: ten times as fast as indexing (h, w, c) with the mask.


def _picked(values: np.ndarray, mask: Mask) -> Shaped[np.ndarray, "c n"]:
    """The film's values, one row for each channel."""
    rows = values.reshape(mask.size, -1).take(np.flatnonzero(mask), axis=0)
    return np.ascontiguousarray(rows.T)


def _put(values: Shaped[np.ndarray, "c n"], mask: Mask, dtype: type) -> Shaped[np.ndarray, "h w c"]:
    """Values of the film's pixels put where these are; elsewhere NaN for floats and 0 for integers."""
    missing = np.nan if issubclass(dtype, np.floating) else 0
    everywhere = np.full((mask.size, len(values)), missing, dtype)
    at = np.flatnonzero(mask)
    for channel, row in enumerate(values):
        everywhere[at, channel] = row
    return everywhere.reshape(*mask.shape, -1)
