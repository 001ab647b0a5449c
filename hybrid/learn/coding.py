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

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int16, UInt8, UInt16

UV_LEVELS = 65535
XYZ_LEVELS = 65535
NORMAL_LEVELS = 32767
ALBEDO_LEVELS = 255

Mask = Bool[np.ndarray, "h w"]


def encode_uv(uv: Float[np.ndarray, "h w 2"], mask: Mask) -> UInt16[np.ndarray, "h w 2"]:
    """Film coordinates in [0, 1] in steps of 1 / 65535."""
    return _spread(np.rint(np.clip(uv[mask], 0.0, 1.0) * UV_LEVELS), mask, np.uint16)


def decode_uv(stored: UInt16[np.ndarray, "h w 2"], mask: Mask) -> Float[np.ndarray, "h w 2"]:
    return _spread(stored[mask] / np.float32(UV_LEVELS), mask, np.float32)


def encode_xyz(
    xyz: Float[np.ndarray, "h w 3"], mask: Mask
) -> tuple[UInt16[np.ndarray, "h w 3"], dict[str, list[float]]]:
    """Coordinates in mm in 65535 steps between the least and the largest of each axis, and the offset and step."""
    values = xyz[mask]
    low = values.min(axis=0) if len(values) else np.zeros(3)
    step = np.maximum((values.max(axis=0) - low) / XYZ_LEVELS, 1e-9) if len(values) else np.ones(3)
    stored = _spread(np.rint((values - low) / step), mask, np.uint16)
    return stored, {"offset": [float(x) for x in low], "step": [float(x) for x in step]}


def decode_xyz(
    stored: UInt16[np.ndarray, "h w 3"], mask: Mask, coding: dict[str, list[float]]
) -> Float[np.ndarray, "h w 3"]:
    return _spread(xyz_from_stored(stored[mask], coding), mask, np.float32)


def xyz_from_stored(stored: np.ndarray, coding: dict[str, list[float]]) -> Float[np.ndarray, "*n 3"]:
    """Coordinates in mm of stored ones (..., 3), or of means of them."""
    return stored * np.array(coding["step"]) + np.array(coding["offset"])


def encode_normal(normal: Float[np.ndarray, "h w 3"], mask: Mask) -> Int16[np.ndarray, "h w 2"]:
    """Unit vectors on the octahedron |x| + |y| + |z| = 1, its lower half folded out into the corners of a square."""
    n = normal[mask]
    n = n / np.abs(n).sum(axis=1, keepdims=True)
    folded = (1 - np.abs(n[:, 1::-1])) * np.copysign(1.0, n[:, :2])
    return _spread(np.rint(np.where(n[:, 2:] < 0, folded, n[:, :2]) * NORMAL_LEVELS), mask, np.int16)


def decode_normal(stored: Int16[np.ndarray, "h w 2"], mask: Mask) -> Float[np.ndarray, "h w 3"]:
    p = stored[mask] / np.float32(NORMAL_LEVELS)
    z = 1 - np.abs(p).sum(axis=1, keepdims=True)
    xy = np.where(z < 0, (1 - np.abs(p[:, 1::-1])) * np.copysign(np.float32(1), p), p)
    n = np.concatenate([xy, z], axis=1)
    return _spread(n / np.linalg.norm(n, axis=1, keepdims=True), mask, np.float32)


def encode_albedo(albedo: Float[np.ndarray, "h w"], mask: Mask) -> UInt8[np.ndarray, "h w"]:
    """Display grey in [0, 1] in steps of 1 / 255."""
    return _spread(np.rint(np.clip(albedo[mask], 0.0, 1.0) * ALBEDO_LEVELS), mask, np.uint8)


def decode_albedo(stored: UInt8[np.ndarray, "h w"], mask: Mask) -> Float[np.ndarray, "h w"]:
    return _spread(stored[mask] / np.float32(ALBEDO_LEVELS), mask, np.float32)


def _spread(values: np.ndarray, mask: Mask, dtype: type) -> np.ndarray:
    """Values of the film's pixels put where these are; elsewhere NaN for floats and 0 for integers."""
    missing: Any = np.nan if issubclass(dtype, np.floating) else 0
    everywhere = np.full((*mask.shape, *values.shape[1:]), missing, dtype)
    everywhere[mask] = values
    return everywhere
