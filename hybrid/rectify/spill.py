"""The outermost pixels of a flat film, without the ground that shines into them.

At the sheet's edge, pixels and the photo's blur mix film and ground: a film on a bright table gets a pale rim, a clear
one on a dark table a dark one. What was printed there cannot be told from the mixture, but where the film just inside
is even, it goes on to the edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d
from hybrid.errors import require_at_most
from hybrid.film_view import view_film
from hybrid.strips import SIDES, Side

GROUND_PX = 2.0
"""Photo pixels beyond the film's edge at which its ground is read: past the blur."""


@dataclass(frozen=True)
class SpillConfig:
    """Options of the correction of a flat film's outermost pixels."""

    reach_px: float = 1.25
    """Pixels whose centres lie this near to the edge are corrected, in photo pixels; 0: none are."""
    contrast: float = 12.0
    """Grey levels (of 255) by which the ground must differ from the film inside."""
    even: float = 0.25
    """The film inside is even where neighbouring pixels differ by less than this share of that contrast."""
    most: float = 0.45
    """Largest share of ground in a side's outermost pixels, at the median: a print that is as bright along the edge as
    a rule shows a larger one, or none between 0 and 1, and is left as it is."""

    def __post_init__(self) -> None:
        require_at_most(self, 8, "reach_px")
        require_at_most(self, 1, "even", "most")


def limit_spill(
    image: UInt8[np.ndarray, "h w 3"],
    valid: Bool[np.ndarray, "h w"],
    photo: UInt8[np.ndarray, "H W 3"],
    backward: BackwardMap,
    config: SpillConfig,
) -> None:
    """Correct the rim of a flat film, in place: no pixel there comes nearer to its ground than the film inside does.

    image: the film as read from ``photo`` through ``backward``; pixels that are not ``valid`` are left alone.
    """
    for side in SIDES:
        pixels, shown = _from_edge(image, side), _from_edge(valid, side)
        film_px = backward.mean_film_pixels()[1 - side.axis]
        depth = int(np.ceil(config.reach_px * len(pixels) / film_px - 0.5))  # pixels whose centres are within reach
        if depth < 1 or len(pixels) < 2 * depth + 2:
            continue
        ground, seen = _ground(photo, backward, side, pixels.shape[1], GROUND_PX / film_px)
        inside = pixels[depth : depth + 2].astype(np.float32)
        contrast = (ground - inside[0]).mean(axis=-1)
        unlike = (inside[1] - inside[0]).mean(axis=-1)
        clear = seen & shown[: depth + 2].all(axis=0)
        clear &= (np.abs(contrast) > config.contrast) & (np.abs(unlike) < config.even * np.abs(contrast))
        if not clear.any():
            continue
        share = float(np.median((pixels[0] - inside[0]).mean(axis=-1)[clear] / contrast[clear]))
        if 0 < share <= config.most:
            brighter = ground > inside[0]
            most = np.where(clear[:, None] & brighter, inside.max(axis=0), 255)
            least = np.where(clear[:, None] & ~brighter, inside.min(axis=0), 0)
            pixels[:depth] = np.clip(pixels[:depth], least, most)


def _from_edge(picture: np.ndarray, side: Side) -> np.ndarray:
    """A view of a film's picture whose rows run along a side, the outermost first."""
    rows = picture if side.axis == 1 else picture.swapaxes(0, 1)
    return rows if side.inward > 0 else rows[::-1]


def _ground(
    photo: UInt8[np.ndarray, "H W 3"], backward: BackwardMap, side: Side, count: int, beyond: float
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """What the photo shows at so many places along a side, ``beyond`` film units outside it, and whether it does."""
    along, across = film_centres_1d(count), np.array([side.edge - side.inward * beyond])
    u, v = (along, across) if side.axis == 1 else (across, along)
    view = view_film(photo, backward, u, v)
    return view.image.reshape(count, 3), view.inside.ravel()
