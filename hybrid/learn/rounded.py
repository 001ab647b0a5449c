"""Round corners, cut off the sharp ones of training films: sheets of film come out of their box rounded.

The twelve check photos with round corners end 0.27 px off (geometric mean), 0.33 by networks that had seen none.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

from hybrid.backward import BackwardMap
from hybrid.learn.behind import filled
from hybrid.round_corners import CORNERS, RoundCorners

SHARE = 0.5
"""Films whose corners are rounded."""

RADIUS = (0.005, 0.04)
"""Range of the radius, in parts of the film's longer side: 2 to 17 mm of 430."""


def round_some(
    photo: UInt8[np.ndarray, "h w 3"], film: BackwardMap, own: RoundCorners | None, rng: np.random.Generator
) -> tuple[UInt8[np.ndarray, "h w 3"], RoundCorners | None]:
    """The photo, and the round corners of its film: its own, or such as some of the others get; None if it has none."""
    if own is not None or rng.random() >= SHARE:
        return photo, own
    down, across = film.mean_film_pixels()
    radius = max(down, across) * float(np.exp(rng.uniform(*np.log(RADIUS))))
    corners = RoundCorners(min(radius / across, 0.4), min(radius / down, 0.4))
    return with_round_corners(photo, film, corners, rng), corners


def with_round_corners(
    photo: UInt8[np.ndarray, "h w 3"], film: BackwardMap, corners: RoundCorners, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """The photo with ground in place of the film's corners: what is seen further out, as it is or blurred."""
    size, changed = (photo.shape[0], photo.shape[1]), photo.copy()
    left = filled(film.photo_from_film(corners.outline()), size)
    # With the rim, in which the lens mixed the corners with the ground.
    cut = cv2.min(cv2.dilate(cv2.subtract(filled(film.outline(), size), left), np.ones((3, 3), np.uint8)), 255 - left)
    for at, centre in zip(film.photo_from_film(CORNERS), film.photo_from_film(corners.centres()), strict=True):
        reach, (dx, dy) = 1.2 * float(np.hypot(*(at - centre))) + 4, np.rint((at - centre) * rng.uniform(1.2, 2.5))
        soft = reach * rng.uniform(0.1, 0.4) if rng.random() < 0.5 else 0.0
        (x0, y0), (x1, y1) = (np.clip(np.rint(at + sign * reach), 0, size[::-1]).astype(int) for sign in (-1, 1))
        if x0 == x1 or y0 == y1:
            continue
        rows, columns = np.arange(y0, y1) + int(dy), np.arange(x0, x1) + int(dx)
        patch = photo[np.clip(rows, 0, size[0] - 1)[:, None], np.clip(columns, 0, size[1] - 1)]
        if soft:
            patch = cv2.GaussianBlur(patch, (0, 0), soft)
        share = cut[y0:y1, x0:x1] / np.float32(255)
        changed[y0:y1, x0:x1] = cv2.blendLinear(patch, changed[y0:y1, x0:x1], share, 1 - share)
    return changed
