"""What the scanner adds to a phantom: blur, grain, streaks from metal and from dense bone, and the table."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int16

from data_gen.ct.shapes import Canvas, blend, ramp

DENSE_HU = 300.0
"""Anything denser hardens the beam and starves the detector."""


@dataclass(frozen=True)
class Scanner:
    """noise_hu: standard deviation in water. blur_px: of the reconstruction. sharp: in [0, 1], how much of the grain
    is fine, as bone kernels make it. starve_hu: streaks along rows full of bone. cup_hu: dark between bones.
    """

    noise_hu: float
    blur_px: float
    sharp: float
    starve_hu: float
    cup_hu: float


def scan(canvas: Canvas, rng: np.random.Generator, scanner: Scanner) -> Int16[np.ndarray, "rows cols"]:
    """What a scanner makes of a slice: blurred, with grain and streaks, clipped to 12 bits."""
    white = rng.standard_normal(canvas.shape, dtype=np.float32)
    fine = cv2.GaussianBlur(white, (0, 0), 0.6)
    grain = fine - np.float32(scanner.sharp) * cv2.GaussianBlur(white, (0, 0), 1.6)
    grain *= np.float32(scanner.noise_hu / max(float(grain[::4, ::4].std()), 1e-6))
    blurred = cv2.GaussianBlur(canvas, (0, 0), scanner.blur_px)
    inside = ramp(blurred + 500.0, 400.0)
    dense = ramp(canvas - DENSE_HU, 900.0).mean(axis=1)
    starved = cv2.GaussianBlur(rng.standard_normal(canvas.shape, dtype=np.float32), (31, 1), 9.0, sigmaY=0.5) * 5
    rows = dense * dense / (dense * dense + np.float32(0.01))  # grows with the share of bone in a row, then levels off
    blurred += inside * rows[:, None] * (np.float32(scanner.starve_hu) * starved - np.float32(scanner.cup_hu))
    blurred += grain * (0.35 + 0.65 * inside)
    return np.clip(np.rint(blurred), -1024, 3071).astype(np.int16)


def streaks(x: Canvas, y: Canvas, rng: np.random.Generator, strength_hu: float) -> Canvas:
    """Rays of light and dark from a piece of metal at the origin of ``x``, ``y`` (mm), weaker with distance."""
    angle, distance = np.arctan2(y, x), np.sqrt(x * x + y * y)
    pattern = np.zeros_like(angle)
    for frequency in rng.integers(2, 26, 6):
        pattern += np.sin(np.float32(frequency) * angle + np.float32(rng.uniform(0, 6.3)))
    core = 1400.0 * ramp(3.5 - distance, 2.0)
    return core + np.float32(strength_hu) * pattern * np.exp(-distance / np.float32(45.0))


@dataclass(frozen=True)
class Rest:
    """What the patient lies on: ``kind`` of "cradle", "flat", "sides", "none".

    lowest_mm: of its upper surface, below the middle. radius_mm: of a cradle. half_mm: half its width. wall_mm: of its
    shell. gap_mm: between its two shells. foam_hu: between them.
    """

    kind: str
    lowest_mm: float
    radius_mm: float
    half_mm: float
    wall_mm: float
    gap_mm: float
    foam_hu: float


def draw_rest(canvas: Canvas, rows: Float[np.ndarray, " r"], cols: Float[np.ndarray, " c"], rest: Rest) -> None:
    """Draws the rest under the patient in place, only over air."""
    if rest.kind == "none":
        return
    x, y = np.meshgrid(cols.astype(np.float32), rows.astype(np.float32))
    half = np.float32(rest.half_mm)
    if rest.kind == "sides":  # the two walls of an open head holder
        depth, inside = np.abs(np.abs(x) - half), (np.abs(y - np.float32(rest.lowest_mm - 60.0)) < 45.0)
        shell, foam = ramp(np.float32(rest.wall_mm) - depth), np.zeros_like(x)
    else:
        if rest.kind == "flat":
            depth = y - np.float32(rest.lowest_mm)
        else:
            depth = np.hypot(x, y - np.float32(rest.lowest_mm - rest.radius_mm)) - np.float32(rest.radius_mm)
        inside = (np.abs(x) < half) & (y > np.float32(rest.lowest_mm - rest.radius_mm))
        wall, gap = np.float32(rest.wall_mm / 2 + 0.5), np.float32(rest.gap_mm)
        shell = ramp(wall - np.abs(depth)) + ramp(wall - np.abs(depth - gap))
        foam = ((depth > 0) & (depth < gap)).astype(np.float32)
    free = (canvas < -600) * inside.astype(np.float32)
    blend(canvas, foam * free, rest.foam_hu)
    blend(canvas, np.clip(shell, 0.0, 1.0) * free, 70.0)


__all__ = ["Rest", "Scanner", "draw_rest", "scan", "streaks"]
