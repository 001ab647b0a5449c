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
from hybrid.coords import centres_1d, linear_from_srgb
from hybrid.errors import require_at_most
from hybrid.strips import SIDES, view_across

DEEPEST = 6
"""Most pixels of the film that are corrected, from its edge on."""
_THIRDS = np.full(3, 1.0 / 3.0, np.float32)


@dataclass(frozen=True)
class SpillConfig:
    """Options of the correction of a flat film's outermost pixels."""

    contrast: float = 12.0
    """Grey levels (of 255) by which the ground must differ from the film inside; 255: nothing is corrected."""
    even: float = 0.25
    """The film inside is even where neighbouring pixels differ by less than this share of that contrast."""
    level: float = 0.04
    """It shows no more ground where they differ by less than this share at the median."""
    odd: float = 0.25
    """A blurred edge has as much ground inside as it has film outside: the shares of ground in the pixels on both sides
    of it add up to 1, except for this, in linear light at the median. If a rule lies along the edge, they do not."""

    def __post_init__(self) -> None:
        require_at_most(self, 255, "contrast")
        require_at_most(self, 1, "even", "level", "odd")


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
    on_its_side = (image.swapaxes(0, 1), valid.T, BackwardMap(backward.nodes.swapaxes(0, 1)))
    for picture, shown, film in ((image, valid, backward), on_its_side):
        outside = -centres_1d(DEEPEST + 2) / len(picture)
        for side in SIDES[:2]:  # top and bottom; of the film on its side, left and right
            from_edge = slice(None, DEEPEST + 2) if side.inward > 0 else slice(None, -DEEPEST - 3, -1)
            ground, seen = view_across(photo, film, side, outside, picture.shape[1], fine=1)
            _limit(picture[from_edge], ground, np.all(seen, axis=0) & shown[from_edge].all(axis=0), config)


def _limit(
    rim: UInt8[np.ndarray, "d n 3"],
    ground: Float[np.ndarray, "d n 3"],
    shown: Bool[np.ndarray, " n"],
    config: SpillConfig,
) -> None:
    """Correct one side: its outermost pixels, down to the first that shows no ground, from which the others follow.

    rim, ground: rows of pixels from the edge on, inside and outside. shown: where the photo shows both.
    """
    grey, beside = (rows.astype(np.float32) @ _THIRDS for rows in (rim, ground))
    for depth in range(1, len(rim) - 1):
        contrast, unlike = beside[depth + 1] - grey[depth], grey[depth + 1] - grey[depth]
        clear = shown & (np.abs(contrast) > config.contrast) & (np.abs(unlike) < config.even * np.abs(contrast))
        if not clear.any() or abs(np.median(unlike[clear] / contrast[clear])) > config.level:
            continue
        rows = (grey[0], beside[0], grey[depth], beside[depth + 1])
        inner, outer, film, bare = (linear_from_srgb(row[clear] / 255.0) for row in rows)
        both_shares = (inner + outer - 2.0 * film) / (bare - film)
        if abs(np.median(both_shares) - 1.0) <= config.odd:
            inside = rim[depth : depth + 2]
            brighter = ground[depth + 1] > inside[0]
            most = np.where(clear[:, None] & brighter, inside.max(axis=0), 255)
            least = np.where(clear[:, None] & ~brighter, inside.min(axis=0), 0)
            rim[:depth] = np.clip(rim[:depth], least, most)
        return
