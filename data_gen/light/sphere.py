"""Equirectangular images of the sphere of directions: their pixels' directions and solid angles, and lookup."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float

from hybrid.coords import centres_1d, opencv_from_photo

REMAP_COLUMNS = 2048
"""OpenCV's remap accepts no side longer than 32767, so lists of points are folded into rows."""


@lru_cache(maxsize=8)
def directions(size: tuple[int, int]) -> Float[np.ndarray, "H W 3"]:
    """Unit world directions (float32, z up, read-only) of the pixel centres of an environment of ``size`` (h, w)."""
    polar, azimuth = centres_1d(size[0]) * (np.pi / size[0]), centres_1d(size[1]) * (2 * np.pi / size[1])
    sin = np.sin(polar)[:, None]
    z = np.broadcast_to(np.cos(polar)[:, None], size)
    rays = np.stack([sin * np.cos(azimuth), sin * np.sin(azimuth), z], axis=-1).astype(np.float32)
    rays.flags.writeable = False
    return rays


def solid_angles(size: tuple[int, int]) -> Float[np.ndarray, " H"]:
    """Solid angle in steradians of one pixel of each row, exact: they sum to 4 pi over the sphere."""
    edges = np.cos(np.linspace(0.0, np.pi, size[0] + 1))
    return (edges[:-1] - edges[1:]) * (2 * np.pi / size[1])


class SphereLookup:
    """Directions prepared for bilinear lookup in any number of equirectangular images.

    Directions are unit vectors, z up. Values between pixel centres are bilinear, wrap in azimuth and end at the poles.
    """

    def __init__(self, directions: Float[np.ndarray, "*n 3"]) -> None:
        self._shape = directions.shape
        self._count = directions[..., 0].size
        columns = max(min(self._count, REMAP_COLUMNS), 1)
        self._azimuth, self._polar = np.zeros((2, -(-self._count // columns), columns), np.float32)
        if self._count == 0:
            return
        x, y, z = (np.ascontiguousarray(directions[..., k], np.float32).reshape(-1, 1) for k in range(3))
        radius, azimuth = cv2.cartToPolar(x, y)
        self._azimuth.reshape(-1)[: self._count] = azimuth.ravel()
        self._polar.reshape(-1)[: self._count] = cv2.phase(z, radius).ravel()

    def values(self, image: Float[np.ndarray, "H W 3"]) -> Float[np.ndarray, "*n 3"]:
        """The image (float32) in these directions."""
        if self._count == 0:
            return np.zeros(self._shape, np.float32)
        height, width = image.shape[:2]
        x = opencv_from_photo(self._azimuth * np.float32(width / (2 * np.pi)))
        y = np.clip(opencv_from_photo(self._polar * np.float32(height / np.pi)), 0, height - 1)
        out = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)  # only columns go beyond the rim
        return out.reshape(-1, 3)[: self._count].reshape(self._shape)
