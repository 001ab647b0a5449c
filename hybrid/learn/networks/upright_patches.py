"""Where a flat film is written on: the small pictures that UprightNet reads.

On every film, writing is bright and thin, with short strokes on dark ground. Finding it needs no network, only a
top-hat (Meyer 1979): what an opening removes is thinner than its structuring element.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from hybrid.coords import film_from_pixel, photo_from_opencv, pixel_from_film

CUE_SHARE = 0.5
"""The search needs half the resolution of reading."""
STROKE_PX = 5
"""At that resolution, strokes are thinner than this."""
LINES = (
    np.ones((1, 9), np.uint8),
    np.ones((9, 1), np.uint8),
    np.eye(7, dtype=np.uint8),
    np.eye(7, dtype=np.uint8)[::-1],
)
"""What contains such a line is not a letter but a rule, a scale bar, the table or a skull."""
NEAR_PX = 13
"""Side of the square over which bright areas count: letters stand apart from slices, the edges of bones do not."""
DARK = 20.0
"""Grey level (of 255) added to the ground's, so that black ground does not count without bound."""
APART = 0.55
"""Twice the least distance of patches along one axis or the other, as a fraction of their side."""
FAINT = 0.03
"""Fraction of the film's best cue below which a place counts as not written on."""
FLAT = 4.0
"""Grey levels: spread below which a patch is taken for empty rather than amplified."""


@dataclass(frozen=True)
class PatchConfig:
    """How films are cut up.

    film_px: longer side to which films are resized; letters are then 3 to 18 pixels high. side_px: side of a patch.
    count: patches of a film.
    """

    film_px: float = 1200.0
    side_px: int = 32
    count: int = 64


def text_patches(film: UInt8[np.ndarray, "h w"], config: PatchConfig) -> Float32[np.ndarray, "n p p"]:
    """The patches of a flat film (sRGB grey) that look most written on, standardised; all 0 where there are fewer."""
    scale = config.film_px / max(film.shape)
    side = min(max(round(config.side_px / scale), 2), *film.shape)
    shape = (config.side_px, config.side_px)
    patches = np.zeros((config.count, *shape), np.uint8)
    middles = pixel_from_film(text_places(film, config), (film.shape[0], film.shape[1]))
    for patch, middle in zip(patches, middles, strict=False):
        left, top = np.clip(np.rint(middle - side / 2).astype(int), 0, np.subtract(film.shape[::-1], side)).tolist()
        part = film[top : top + side, left : left + side]
        cv2.resize(part, shape, dst=patch, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    return standardised(patches)


def text_places(film: UInt8[np.ndarray, "h w"], config: PatchConfig) -> Float[np.ndarray, "n 2"]:
    """Film uv of the middles of at most ``config.count`` patches, the one that looks most written on first."""
    side = round(CUE_SHARE * config.side_px)
    cue = writing(film, CUE_SHARE * config.film_px / max(film.shape), side)
    odd = round(APART * side) // 2 * 2 + 1
    rows, cols = np.divmod(np.flatnonzero(cv2.dilate(cue, np.ones((odd, odd), np.uint8)) == cue), cue.shape[1])
    best = np.argsort(-cue[rows, cols], kind="stable")[: config.count]
    best = best[cue[rows[best], cols[best]] > FAINT * max(cue.max(), 1e-3)]
    points = photo_from_opencv(np.stack([cols[best], rows[best]], axis=-1).astype(np.float64))
    return film_from_pixel(points, (cue.shape[0], cue.shape[1]))


def standardised(patches: UInt8[np.ndarray, "n p p"]) -> Float32[np.ndarray, "n p p"]:
    """Patches minus their means, over their spreads: neither the light nor the film's base matters. Within +-4."""
    grey = patches.astype(np.float32)
    grey -= grey.mean(axis=(1, 2), keepdims=True)
    grey /= grey.std(axis=(1, 2), keepdims=True) + np.float32(FLAT)
    return np.clip(grey, -4, 4, out=grey)


def writing(film: UInt8[np.ndarray, "h w"], scale: float, side: int) -> Float32[np.ndarray, "ch cw"]:
    """How much a window of ``side`` pixels looks written on, around each pixel of the film brought to ``scale``."""
    size = (max(round(film.shape[1] * scale), side), max(round(film.shape[0] * scale), side))
    whole = int(1 / scale)
    if whole > 1:  # an average over whole pixels is several times faster than one over parts of them
        film = cv2.resize(film, None, fx=1 / whole, fy=1 / whole, interpolation=cv2.INTER_AREA)
    small = cv2.resize(film, size, interpolation=cv2.INTER_LINEAR)
    ground = cv2.morphologyEx(small, cv2.MORPH_OPEN, np.ones((STROKE_PX, STROKE_PX), np.uint8))
    thin = cv2.subtract(small, ground)
    lines = [cv2.morphologyEx(thin, cv2.MORPH_OPEN, line) for line in LINES]
    thin = cv2.subtract(thin, np.max(lines, axis=0))
    ground = cv2.dilate(ground, np.ones((NEAR_PX, NEAR_PX), np.uint8))
    return _around(thin, side) / (_around(ground, side) + np.float32(DARK)) ** 2


def _around(values: UInt8[np.ndarray, "h w"], side: int) -> Float32[np.ndarray, "h w"]:
    """Means over windows of ``side`` pixels, in which the middle counts most: letters on empty ground then have one
    best window, not many."""
    odd = (side // 4 * 2 + 1, side // 4 * 2 + 1)
    return cv2.boxFilter(cv2.boxFilter(values, cv2.CV_32F, odd), cv2.CV_32F, odd)
