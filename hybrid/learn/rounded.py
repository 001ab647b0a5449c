"""Round corners, cut off the sharp ones of training films: sheets of film come out of their box rounded.

Of the twelve check photos, 0.28 px off at the geometric mean, networks that had only seen sharp corners made 1.81 px
when these were rounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.learn.behind import filled

SHARE = 0.5
"""Films whose corners are rounded."""

RADIUS = (0.005, 0.04)
"""Range of the radius, in parts of the film's longer side: 2 to 17 mm of 430."""

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@dataclass(frozen=True)
class Rounding:
    """Radius of a sheet's corners, in parts of its width (u) and of its height (v)."""

    u: float
    v: float

    def cuts(self, uv: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Which film points lie beyond the arcs."""
        radius = np.array([self.u, self.v], uv.dtype)
        within = np.maximum(1 - np.minimum(uv, 1 - uv) / radius, 0)  # from where the arc begins, in radii
        return np.asarray(within.min(axis=-1) > 0) & (np.square(within).sum(axis=-1) > 1)

    def centres(self) -> Float[np.ndarray, "4 2"]:
        """Film points about which the arcs turn, once around from the top-left one."""
        return np.abs(CORNERS - [self.u, self.v])

    def outline(self) -> Float[np.ndarray, "n 2"]:
        """Film points of the sheet's edge, once around from the top-left corner."""
        turns, begins = np.linspace(0, np.pi / 2, 17), np.pi * np.array([1, 1.5, 0, 0.5])
        arcs = [
            centre + np.stack([self.u * np.cos(turns + begin), self.v * np.sin(turns + begin)], axis=1)
            for centre, begin in zip(self.centres(), begins, strict=True)
        ]
        sides = [np.linspace(arc[-1], after[0], 33)[1:-1] for arc, after in zip(arcs, arcs[1:] + arcs[:1], strict=True)]
        return np.concatenate([part for pair in zip(arcs, sides, strict=True) for part in pair])


def rounding_of_some(film: BackwardMap, rng: np.random.Generator) -> Rounding | None:
    """The radius of a film's corners; None for films whose corners stay as they are."""
    if rng.random() >= SHARE:
        return None
    down, across = film.mean_film_pixels()
    radius = max(down, across) * float(np.exp(rng.uniform(*np.log(RADIUS))))
    return Rounding(min(radius / across, 0.4), min(radius / down, 0.4))


def with_round_corners(
    photo: UInt8[np.ndarray, "h w 3"], film: BackwardMap, rounding: Rounding, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """The photo with ground in place of the film's corners: what is seen further out, as it is or blurred."""
    size, changed = (photo.shape[0], photo.shape[1]), photo.copy()
    left = filled(film.photo_from_film(rounding.outline()), size)
    # With the rim, in which the lens mixed the corners with the ground.
    cut = cv2.min(cv2.dilate(cv2.subtract(filled(film.outline(), size), left), np.ones((3, 3), np.uint8)), 255 - left)
    for at, centre in zip(film.photo_from_film(CORNERS), film.photo_from_film(rounding.centres()), strict=True):
        reach, further = 1.2 * float(np.hypot(*(at - centre))) + 4, (at - centre) * rng.uniform(1.2, 2.5)
        soft = reach * rng.uniform(0.1, 0.4) if rng.random() < 0.5 else 0.0
        (x0, y0), (x1, y1) = (np.clip(np.rint(at + sign * reach), 0, size[::-1]).astype(int) for sign in (-1, 1))
        if x0 == x1 or y0 == y1:
            continue
        x, y = (
            np.rint(np.arange(a, b) + step).astype(int) for a, b, step in ((x0, x1, further[0]), (y0, y1, further[1]))
        )
        patch = photo[np.clip(y, 0, size[0] - 1)[:, None], np.clip(x, 0, size[1] - 1)]
        if soft:
            patch = cv2.GaussianBlur(patch, (0, 0), soft)
        share = cut[y0:y1, x0:x1] / np.float32(255)
        changed[y0:y1, x0:x1] = cv2.blendLinear(patch, changed[y0:y1, x0:x1], share, 1 - share)
    return changed
