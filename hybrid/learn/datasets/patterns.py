"""Prints that no scan gives: test patterns in a grid of cells, so that networks do not learn anatomy by heart."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

_FINE = 2
"""Supersampling factor of test patterns, along both axes."""


def drawn_pattern(px: int, rng: np.random.Generator) -> UInt8[np.ndarray, "n n"]:
    """A print that no scan gives: cells of discs, ramps, steps and spots, all alike or each different, some empty."""
    rows, cols = (int(n) for n in rng.integers(1, 8, 2))
    side = max(_FINE * px // max(rows, cols), 8)
    ground, alike, empty = int(rng.integers(0, 30)), rng.random() < 0.5, rng.uniform(0, 0.3)
    kinds = pattern_kinds(rng)
    one = pattern_cell(side, kinds, ground, rng)
    film = np.full((rows * side, cols * side), ground, np.uint8)
    for row in range(rows):
        for col in range(cols):
            if rng.random() >= empty:
                cell = one if alike else pattern_cell(side, kinds, ground, rng)
                film[row * side : (row + 1) * side, col * side : (col + 1) * side] = cell
    return cv2.resize(film, (px, px), interpolation=cv2.INTER_AREA)


def pattern_kinds(rng: np.random.Generator) -> np.ndarray:
    """Which kinds of patterns a print shows."""
    return rng.permutation(4)[: int(rng.integers(1, 4))]


def pattern_cell(side: int, kinds: np.ndarray, ground: int, rng: np.random.Generator) -> UInt8[np.ndarray, "s s"]:
    """One cell with a pattern of one of these kinds, and with strokes like writing in a corner."""
    kind, v, u = int(rng.choice(kinds)), *np.meshgrid(*(2 * [np.linspace(-1, 1, side)]), indexing="ij")
    half, low, high = rng.uniform(0.4, 0.9, 2), *np.sort(rng.uniform(0.1, 1, 2))
    radius = np.hypot(u / half[0], v / half[1])
    ramp = (u * np.cos(turn := rng.uniform(0, 2 * np.pi)) + v * np.sin(turn) + 1.4) / 2.8
    if kind == 0:  # a disc within a bright ring
        grey, inside = np.where(radius > rng.uniform(0.8, 0.97), 1.0, low + (high - low) * ramp), radius < 1
    elif kind == 1:  # a ramp over a rectangle
        grey, inside = low + (high - low) * ramp, np.maximum(abs(u) / half[0], abs(v) / half[1]) < 1
    elif kind == 2:  # steps
        steps = int(rng.integers(3, 25))
        grey, inside = np.floor(ramp * steps) / steps, np.maximum(abs(u) / half[0], abs(v) / half[1]) < 1
    else:  # spots
        spots = cv2.resize(rng.random((6, 6)), (side, side), interpolation=cv2.INTER_CUBIC)
        grey, inside = np.clip(spots, 0, 1) * high, radius < 1
    cell = np.where(inside, 255 * np.clip(grey, 0, 1), ground).astype(np.uint8)
    for line in range(int(rng.integers(0, 4))):
        at, length = 2 + line * max(side // 14, 2), int(side * rng.uniform(0.1, 0.35))
        cell[at : at + max(side // 40, 1), 2 : 2 + length : 2] = 255
    return cell
