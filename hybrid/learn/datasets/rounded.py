"""Rounds the sharp corners of training films: sheets of film come out of their box rounded.

The twelve check photos with round corners end 0.27 px off (geometric mean), or 0.33 with networks that had seen none.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import FILM_CORNERS
from hybrid.learn.datasets.behind import filled, mixed
from hybrid.learn.datasets.draws import log_uniform
from hybrid.round_corners import RoundCorners

SHARE = 0.5
"""Share of films whose corners are rounded."""

RADIUS = (0.005, 0.04)
"""Range of the radius, as a fraction of the film's longer side: 2 to 17 mm of 430."""


def round_some(
    photo: UInt8[np.ndarray, "h w 3"], film: BackwardMap, own: RoundCorners | None, rng: np.random.Generator
) -> tuple[UInt8[np.ndarray, "h w 3"], RoundCorners | None]:
    """The photo, and the round corners of its film: its own, or random ones on some others; None if it has none."""
    if own is not None or rng.random() >= SHARE:
        return photo, own
    down, across = film.mean_film_pixels()
    radius = max(down, across) * log_uniform(rng, RADIUS)
    corners = RoundCorners(min(radius / across, 0.4), min(radius / down, 0.4))
    return with_round_corners(photo, film, corners, rng), corners


def with_round_corners(
    photo: UInt8[np.ndarray, "h w 3"], film: BackwardMap, corners: RoundCorners, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """The photo with ground in place of the film's corners: a patch from further out, as it is or blurred."""
    size, changed = (photo.shape[0], photo.shape[1]), photo.copy()
    cut = cut_share(film, corners, size, 1)
    for at, centre in zip(film.photo_from_film(FILM_CORNERS), film.photo_from_film(corners.centres()), strict=True):
        reach, (dx, dy) = 1.2 * float(np.hypot(*(at - centre))) + 4, np.rint((at - centre) * rng.uniform(1.2, 2.5))
        soft = reach * rng.uniform(0.1, 0.4) if rng.random() < 0.5 else 0.0
        (x0, y0), (x1, y1) = (np.clip(np.rint(at + sign * reach), 0, size[::-1]).astype(int) for sign in (-1, 1))
        if x0 == x1 or y0 == y1:
            continue
        rows, columns = np.arange(y0, y1) + int(dy), np.arange(x0, x1) + int(dx)
        patch = photo[np.clip(rows, 0, size[0] - 1)[:, None], np.clip(columns, 0, size[1] - 1)]
        if soft:
            patch = cv2.GaussianBlur(patch, (0, 0), soft)
        changed[y0:y1, x0:x1] = mixed(changed[y0:y1, x0:x1], patch, cut[y0:y1, x0:x1])
    return changed


def cut_share(film: BackwardMap, corners: RoundCorners, size: tuple[int, int], rim_px: int) -> UInt8[np.ndarray, "h w"]:
    """Share, of 255, of each pixel of a photo of ``size`` (h, w) that is cut off, with the rim around it, in which the
    lens mixed film and ground. Along the sides, where both outlines coincide, little may be left of it: it is meant for
    use near the corners only."""
    left = filled(film.photo_from_film(corners.outline()), size)
    kernel = np.ones((2 * rim_px + 1, 2 * rim_px + 1), np.uint8)
    return cv2.min(cv2.dilate(cv2.subtract(filled(film.outline(), size), left), kernel), 255 - left)
