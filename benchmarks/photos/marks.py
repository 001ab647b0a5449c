"""Photos with truth, with what is no print on their film or in the lens: labels, writing by hand, lens flare."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Float

from benchmarks.photos.damage import Damaged
from benchmarks.photos.grounds import Change, Picture, Sheet
from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, opencv_from_photo

Box = tuple[float, float, float, float]
"""u0, v0, u1, v1 of a part of the film."""

_FRACTION_BITS = 4
"""Of the pixels to which OpenCV draws."""


def _labels(sheet: Sheet, other: Sheet, rng: np.random.Generator) -> Damaged:
    """One to three paper labels with lines of bars, at most a fortieth of the film each; the second is at its edge."""
    photo = sheet.photo.copy()
    for k in range(int(rng.integers(1, 4))):
        size = rng.uniform(0.12, 0.25), rng.uniform(0.05, 0.1)
        u, v = (float(rng.uniform(0.03, 0.97 - length)) for length in size)
        u = 0.01 if k == 1 else u
        box = u, v, u + size[0], v + size[1]
        paper = rng.uniform(200, 250) * np.array([1.0, rng.uniform(0.95, 1.0), rng.uniform(0.85, 1.0)])
        _fill(photo, sheet, [box], paper)
        _fill(photo, sheet, _bars(box, rng), np.full(3, 25.0))
    return Damaged(photo, sheet.backward)


def _bars(box: Box, rng: np.random.Generator) -> list[Box]:
    """Lines of upright bars on a label, as of a bar code or of letters."""
    u0, v0, u1, v1 = box
    rows = np.linspace(v0, v1, int(rng.integers(3, 5)))
    bars: list[Box] = []
    for top, bottom in pairwise(rows):
        ends = u0 + (u1 - u0) * np.sort(rng.uniform(0.06, 0.94, 2 * int(rng.integers(6, 16))))
        low, high = top + 0.2 * (bottom - top), bottom - 0.2 * (bottom - top)
        bars += [(float(a), float(low), float(b), float(high)) for a, b in zip(ends[::2], ends[1::2], strict=True)]
    return bars


def _fill(photo: Picture, sheet: Sheet, boxes: Sequence[Box], colour: Float[np.ndarray, "3"]) -> None:
    """Paint parts of the film, bent as it is, in the photo."""
    for u0, v0, u1, v1 in boxes:
        part = np.array([u0, v0]) + film_nodes((9, 9)) * np.array([u1 - u0, v1 - v0])
        outline = BackwardMap(sheet.backward.photo_from_film(part)).outline()
        cv2.fillPoly(photo, [_fixed(outline)], colour.tolist(), cv2.LINE_AA, _FRACTION_BITS)


def _written(sheet: Sheet, other: Sheet, rng: np.random.Generator) -> Damaged:
    """Rings and strokes of a wax pencil, of one colour."""
    photo = sheet.photo.copy()
    colour = [(200, 30, 30), (240, 240, 240), (230, 210, 40), (20, 40, 160)][int(rng.integers(4))]
    width = max(1, round(0.006 * max(sheet.backward.mean_film_pixels())))
    t = np.linspace(0.0, 1.0, 48)
    for _ in range(int(rng.integers(3, 8))):
        middle, size = rng.uniform(0.12, 0.88, 2), rng.uniform(0.03, 0.1)
        turns, phase = rng.uniform(0.9, 3.0), rng.uniform(0.0, 2 * np.pi)
        drift = rng.uniform(-1.0, 1.0, 2) * (t[:, None] - 0.5)  # a ring, or letters in a row
        ring = np.stack([np.cos(2 * np.pi * turns * t + phase), np.sin(2 * np.pi * turns * t + phase)], axis=1)
        points = sheet.backward.photo_from_film(np.clip(middle + size * (ring + drift), 0.0, 1.0))
        cv2.polylines(photo, [_fixed(points)], False, colour, width, cv2.LINE_AA, _FRACTION_BITS)
    return Damaged(photo, sheet.backward)


def _flare(sheet: Sheet, other: Sheet, rng: np.random.Generator) -> Damaged:
    """A lamp beside the picture in the lens: a glow around it and faint discs in line with the middle."""
    h, w = sheet.photo.shape[:2]
    y, x = np.mgrid[:h, :w].astype(np.float32) / max(h, w)
    middle, lamp = np.array([w, h]) / (2 * max(h, w)), rng.uniform(0.0, 1.0, 2) * np.array([w, h]) / max(h, w)
    glow = np.exp(-np.hypot(x - lamp[0], y - lamp[1]) / 0.25)
    added = 0.15 * glow[..., None] * np.array([1.0, 0.95, 0.85], np.float32)
    for along in rng.uniform(-1.2, 1.2, 4):
        at, radius = middle + along * (lamp - middle), rng.uniform(0.02, 0.1)
        disc = np.clip((radius - np.hypot(x - at[0], y - at[1])) * 200, 0, 1)
        added += disc[..., None] * rng.uniform(0.01, 0.06, 3).astype(np.float32)
    light = (sheet.photo / np.float32(255)) ** np.float32(2.2) + added
    return Damaged(np.rint(255 * np.clip(light, 0, 1) ** (1 / 2.2)).astype(np.uint8), sheet.backward)


def _fixed(points: Float[np.ndarray, "n 2"]) -> np.ndarray:
    """Photo points as OpenCV draws them, with fractions."""
    return np.rint(opencv_from_photo(points) * 2**_FRACTION_BITS).astype(np.int32)


MARKS: dict[str, tuple[str, Change]] = {
    "labels": ("labels stuck on it", _labels),
    "written": ("written on with a wax pencil", _written),
    "flare": ("seen through lens flare", _flare),
}
"""What each change is called, in words, and how it is made."""

__all__ = ["MARKS"]
