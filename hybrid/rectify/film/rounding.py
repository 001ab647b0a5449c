"""Round corners of the sheet in a photo: beyond their arcs, a flat film shows the ground.

Most films leave the factory with round corners, all of one radius. Around each corner of the map, ground and film are
known from beside it. The radius counts for which what lies beyond the arcs is ground and what lies just inside is film,
in nearly all corners at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import FILM_CORNERS, centres_1d, film_centres_1d
from hybrid.errors import require_at_least, require_at_most
from hybrid.film_view import view_film
from hybrid.round_corners import RoundCorners

PIXELS = 560
"""Pixels along the film's shorter side in the views of its corners."""
OUTSIDE = 3
"""Pixels by which these reach beyond the corner."""
BLUR = 1.0
"""Pixels on either side of an arc that say nothing."""
WIDER = 3.0
"""Pixels added to the radius that is found, lest a blurred arc of ground be left: 1.2 pixels in a corner's middle."""


@dataclass(frozen=True)
class RoundingConfig:
    """Options of the search for round corners.

    smallest, largest: radius in parts of the film's shorter side. contrast: grey levels (of 255) by which ground and
    film must differ at a corner; 255: none do. agreed: share of the pixels beyond an arc that must be nearer to the
    ground than to the film, and of those inside that must be nearer to the film. step: least difference between their
    means, in parts of that contrast. plain: share of the largest difference with which a smaller radius does as well.
    """

    smallest: float = 0.018
    largest: float = 0.07
    contrast: float = 25.0
    agreed: float = 0.8
    step: float = 0.65
    plain: float = 0.92

    def __post_init__(self) -> None:
        require_at_least(self, 0.01, "smallest")
        require_at_least(self, self.smallest + 0.01, "largest")
        require_at_most(self, 0.2, "largest")
        require_at_most(self, 255, "contrast")
        require_at_most(self, 1, "agreed", "step", "plain")


def find_round_corners(
    photo: UInt8[np.ndarray, "H W 3"], backward: BackwardMap, aspect: float, config: RoundingConfig
) -> RoundCorners | None:
    """The round corners of a sheet; None where they are square, or do not stand out from their ground.

    photo, backward: the sheet's map into the photo. aspect: the film's height over its width.
    """
    pixels = (PIXELS * max(1.0, aspect), PIXELS * max(1.0, 1.0 / aspect))  # along the height and the width
    reach = round(PIXELS * config.largest)
    radii, beyond, inside, edges = _parts(round(PIXELS * config.smallest), reach)
    steps, agree = [], []
    for corner in FILM_CORNERS:
        share = _ground_share(photo, backward, corner, pixels, reach, config.contrast)
        if share is None:
            continue
        share, is_ground = share.ravel(), (share > 0.5).astype(np.float64).ravel()
        steps.append(beyond @ share - np.abs(inside @ share))
        agree.append(np.minimum(beyond @ is_ground, 1.0 - np.maximum(inside @ is_ground, edges @ is_ground)))
    if len(steps) < 2:
        return None
    fit = np.sort(np.where(np.array(agree) >= config.agreed, steps, 0.0), axis=0)
    score = fit[0] if len(fit) < 3 else fit[1]  # all corners, or all but one
    best = float(score.max())
    if best < config.step:
        return None
    radius = float(radii[np.argmax(score >= config.plain * best)]) + WIDER
    return RoundCorners(radius / pixels[1], radius / pixels[0])


def blank_beyond(corners: RoundCorners, image: UInt8[np.ndarray, "h w 3"], valid: Bool[np.ndarray, "h w"]) -> None:
    """Blank, in place, the pixels of a flat film whose centres lie beyond its round corners: they are not valid."""
    height, width = valid.shape
    v, u = film_centres_1d(height), film_centres_1d(width)
    rows, columns = (_ends(int(np.ceil(radius * n))) for radius, n in ((corners.v, height), (corners.u, width)))
    for corner in product(rows, columns):
        beyond = corners.cut(np.stack(np.meshgrid(u[corner[1]], v[corner[0]]), axis=-1))
        image[corner][beyond], valid[corner][beyond] = 0, False


def _ends(n: int) -> tuple[slice, slice]:
    """The first and the last n."""
    return slice(None, n), slice(-n, None)


def _ground_share(
    photo: UInt8[np.ndarray, "H W 3"],
    backward: BackwardMap,
    corner: Float[np.ndarray, "2"],
    pixels: tuple[float, float],
    reach: int,
    contrast: float,
) -> Float[np.ndarray, "n n"] | None:
    """Share of ground in the pixels of a corner, the outermost first; None where the photo does not show it, or ground
    and film are alike.

    corner: a film point. pixels: of the whole film, along its height and its width.
    """
    out = centres_1d(OUTSIDE + reach) - OUTSIDE
    v, u = (end + (1.0 - 2.0 * end) * out / n for end, n in zip(corner[::-1], pixels, strict=True))
    view = view_film(photo, backward, u, v)
    if not view.inside.all():
        return None
    grey = view.image.mean(axis=-1)
    half = OUTSIDE + reach // 2
    ground, film = np.median([grey[0, :half], grey[:half, 0]]), np.median(grey[OUTSIDE:, OUTSIDE:])
    if abs(ground - film) < contrast:
        return None
    return (grey[OUTSIDE:, OUTSIDE:] - film) / (ground - film)


@lru_cache(maxsize=2)
def _parts(least: int, reach: int) -> tuple[np.ndarray, ...]:
    """Radii in pixels and, for each, weights (adding up to 1) of a corner's pixels beyond its arc, of those just inside
    it, and of those along the straight edges. Read-only."""
    radii = np.arange(least, reach - OUTSIDE, dtype=np.float64)
    x, y = np.meshgrid(centres_1d(reach), centres_1d(reach))
    r = radii[:, None, None]
    arc, rounded = np.hypot(r - x, r - y) - r, (x < r) & (y < r)
    near = np.minimum(x, y)
    beyond, inside = rounded & (arc > BLUR), rounded & (arc < -BLUR) & (arc > -BLUR - OUTSIDE)
    edges = (np.maximum(x, y) > r + BLUR) & (near > BLUR) & (near < BLUR + OUTSIDE)
    weights = [
        part.reshape(len(radii), -1) / np.maximum(part.sum(axis=(1, 2)), 1)[:, None] for part in (beyond, inside, edges)
    ]
    for array in (radii, *weights):
        array.setflags(write=False)
    return radii, *weights
