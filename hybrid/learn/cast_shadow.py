"""A hard shadow of the film beside it: what of all that lies behind a film looks most like another sheet."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, opencv_from_photo

SHARE = 0.3
"""Photos that are shown with such a shadow."""

OFFSET, SCALE, RIM, DEPTH = (0.02, 0.4), (0.95, 1.15), (0.001, 0.02), (0.15, 0.9)
"""Ranges: how far off the shadow lies, its size and the sigma of its rim, over the film's; what it takes of the grey.

A point source throws it so, of a film that hangs before a wall or stands off a table. The data's lamps and rooms do
that by physics (data_gen/ground_shadows.py), but seldom from so far and so sharply: of 69 photos with truth that were
given such a shadow, 14 were read with film and shadow as one sheet by a network that had not seen any.
"""

TINT = 0.08
"""One sigma by which what it takes of red and blue differs: other light is left where a lamp's is kept off."""

LENS_PX = 0.8
"""Sigma of a lens's blur in the data's photos."""

_ALONG = 65
_FINER = 2


def beside_some(
    photo: UInt8[np.ndarray, "h w 3"], film: BackwardMap, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """``with_shadow`` of a share of the photos, the others as they are."""
    return with_shadow(photo, film, rng) if rng.random() < SHARE else photo


def with_shadow(
    photo: UInt8[np.ndarray, "h w 3"], film: BackwardMap, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """The photo with a shadow of the film's shape on what lies around the film; the film itself stays as it was."""
    nodes = film.photo_from_film(film_nodes((_ALONG, _ALONG)))
    outline = np.concatenate([nodes[0, :-1], nodes[:-1, -1], nodes[-1, :0:-1], nodes[:0:-1, 0]])
    centre, size = nodes.mean(axis=(0, 1)), np.linalg.norm(np.ptp(nodes, axis=(0, 1))) / np.sqrt(2)
    turn, far = rng.uniform(0, 2 * np.pi), size * rng.uniform(*OFFSET)
    thrown = (outline - centre) * rng.uniform(*SCALE) + centre + far * np.array([np.cos(turn), np.sin(turn)])
    rim = size * float(np.exp(rng.uniform(*np.log(RIM))))
    shade = cv2.GaussianBlur(_filled(thrown, photo.shape[:2]), (0, 0), max(rim, 0.3))
    shade = cv2.multiply(shade, 255 - _within(_filled(outline, photo.shape[:2])), scale=1 / 255)
    taken = np.clip(rng.uniform(*DEPTH) + TINT * rng.normal(0, 1) * np.array([1.0, 0.0, -1.0]), 0, 0.95)
    left = np.rint(255 - np.arange(256)[:, None] * taken).astype(np.uint8)
    return cv2.multiply(photo, cv2.LUT(cv2.merge([shade] * 3), left[None]), scale=1 / 255)


def _filled(outline: Float[np.ndarray, "n 2"], size: tuple[int, ...]) -> UInt8[np.ndarray, "h w"]:
    """Share, of 255, of each pixel within an outline of photo points, to a quarter of a pixel."""
    mask = np.zeros((size[0] * _FINER, size[1] * _FINER), np.uint8)
    fixed = np.clip(opencv_from_photo(outline * _FINER) * 16, -(2**19), 2**19).round().astype(np.int32)
    cv2.fillPoly(mask, [fixed], 255, shift=4)
    return cv2.resize(mask, size[::-1], interpolation=cv2.INTER_AREA)


def _within(film: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """The film without its rim, in which the lens mixes the ground: left bright it would tell film from shadow."""
    soft = cv2.GaussianBlur(film, (0, 0), LENS_PX)
    return cv2.LUT(soft, np.clip(2 * np.arange(256) - 255, 0, 255).astype(np.uint8))
