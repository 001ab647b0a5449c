"""Bent sheets with a known backward map, and what a perfect or a noisy network would predict for them."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from hybrid.backward import BackwardMap
from hybrid.coords import pixel_centres
from hybrid.records import CoarseMaps

PHOTO_SIZE = (1080, 1080)


def bent_sheet(
    bend: float = 0.8, aspect: float = 1.25, tilt: float = 0.3, turn: float = 0.2
) -> Callable[[np.ndarray], np.ndarray]:
    """A function from film points to photo points of a sheet rolled by ``bend`` radians about its v axis.

    tilt, turn: rotations about the photo's x axis and in its plane, in radians.
    """
    width, height = 1.0, aspect

    def xyz(uv: np.ndarray) -> np.ndarray:
        s = (uv[..., 0] - 0.5) * width
        x = np.sin(bend * s) / bend if bend else s
        z = (1.0 - np.cos(bend * s)) / bend if bend else 0.0 * s
        y = (uv[..., 1] - 0.5) * height
        points = np.stack([x, np.cos(tilt) * y - np.sin(tilt) * z, np.sin(tilt) * y + np.cos(tilt) * z], axis=-1)
        c, n = np.cos(turn), np.sin(turn)
        return points @ np.array([[c, n, 0], [-n, c, 0], [0, 0, 1]]) / np.hypot(width, height)

    def photo(uv: np.ndarray) -> np.ndarray:
        points = xyz(uv)
        depth = 2.5 + points[..., 2:]
        return 1900.0 * points[..., :2] / depth + 540.0

    return photo


def flat_sheet_seen(
    aspect: float, focal: float, turns: tuple[float, float, float], size: tuple[int, int]
) -> Callable[[np.ndarray], np.ndarray]:
    """A function from film to photo points of a flat sheet, three heights from a camera whose axis meets the photo's
    centre.

    aspect: height over width. focal: in longer sides of the photo, whose size is (height, width). turns: rotation
    vector (x, y, z), in radians.
    """
    pose, side = cv2.Rodrigues(np.array(turns))[0], max(size)

    def photo(uv: np.ndarray) -> np.ndarray:
        flat = (uv - 0.5) * np.array([1.0 / aspect, 1.0])
        points = flat @ pose[:, :2].T + np.array([0.1, -0.05, 3.0 * focal])
        return side * focal * points[..., :2] / points[..., 2:] + 0.5 * np.array(size[::-1])

    return photo


def maps_of(backward: BackwardMap, n: int = 64) -> CoarseMaps:
    """What a perfect network of resolution ``n`` would predict for the film of ``backward``."""
    points = pixel_centres((n, n)) * (PHOTO_SIZE[0] / n)
    uv = backward.film_from_photo(points)
    mask = np.isfinite(uv).all(axis=-1)
    uv = np.where(mask[..., None], uv, 0.0)
    flat, grey = np.zeros((n, n, 3)), np.full((n, n), 0.2)
    return CoarseMaps(mask=mask.astype(np.float64), uv=uv, xyz=flat, albedo=grey, photo_points=points)


def smooth_noise(rng: np.random.Generator, size: tuple[int, int], sigma: float, std: float) -> np.ndarray:
    """Gaussian noise (h, w, 2) of standard deviation ``std``, correlated over ``sigma`` pixels."""
    noise = np.stack([cv2.GaussianBlur(rng.normal(size=size), (0, 0), sigma) for _ in range(2)], axis=-1)
    return noise * (std / noise.std())
