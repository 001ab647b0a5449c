"""What the procedural phantoms are painted with: warped ellipsoids, smooth noise, and a scanner's blur and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int16

Triple = tuple[float | int, float | int, float | int]
Canvas = Float[np.ndarray, "rows cols"]


@dataclass(frozen=True)
class Blob:
    """An ellipsoid in millimetres (x to the patient's left, y backwards, z up): centre, semi-axes, tissue.

    yaw: turn about z in radians. hu: inside. shell_hu, shell_mm: a wall around it, drawn outside, if shell_mm > 0.
    """

    centre: Triple
    radii: Triple
    hu: float | int
    yaw: float = 0.0
    shell_hu: float = 0.0
    shell_mm: float = 0.0

    def mirrored(self) -> Blob:
        """The same on the other side of the body."""
        x, y, z = self.centre
        return Blob((-x, y, z), self.radii, self.hu, -self.yaw, self.shell_hu, self.shell_mm)


@dataclass(frozen=True, eq=False)
class Plane:
    """The coordinates in millimetres of one slice's pixel centres, tilted and warped as the patient lies."""

    x: Canvas
    y: Canvas
    z: Canvas

    def distance(self, blob: Blob) -> Canvas:
        """Roughly the distance in mm to the surface of a blob, negative inside (exact on the surface)."""
        (cx, cy, cz), (rx, ry, rz) = blob.centre, blob.radii
        cos, sin = np.float32(np.cos(blob.yaw)), np.float32(np.sin(blob.yaw))
        dx, dy = self.x - np.float32(cx), self.y - np.float32(cy)
        along, across = (dx * cos + dy * sin) / np.float32(rx), (dy * cos - dx * sin) / np.float32(ry)
        up = (self.z - np.float32(cz)) / np.float32(rz)
        return (np.sqrt(along * along + across * across + up * up) - 1.0) * np.float32(min(rx, ry, rz))

    def touches(self, blob: Blob, margin_mm: float = 12.0) -> bool:
        """False where the slice surely misses the blob (the plane may be tilted by about ``margin_mm``)."""
        reach = blob.radii[2] + blob.shell_mm + margin_mm
        middle = self.z[self.z.shape[0] // 2, self.z.shape[1] // 2]
        return bool(abs(middle - blob.centre[2]) < reach)


@dataclass(frozen=True, eq=False)
class Warp:
    """A smooth random displacement of space, a few waves for each axis, and a small rotation."""

    rotation: Float[np.ndarray, "3 3"]
    waves: Float[np.ndarray, "n 3"]
    phases: Float[np.ndarray, "n 3"]
    amplitude_mm: float

    def plane(self, rows: Float[np.ndarray, " r"], cols: Float[np.ndarray, " c"], z_mm: float) -> Plane:
        """Body coordinates of the slice at height ``z_mm`` whose pixel centres are at ``cols`` (x), ``rows`` (y) mm."""
        x, y = np.meshgrid(cols.astype(np.float32), rows.astype(np.float32))
        turned = [r[0] * x + r[1] * y + r[2] * np.float32(z_mm) for r in self.rotation.astype(np.float32)]
        for wave, phase in zip(self.waves.astype(np.float32), self.phases.astype(np.float32), strict=True):
            # separable: the sum over axes of waves along rows and columns costs vectors, not images
            base_x, base_y = wave[0] * cols.astype(np.float32), wave[1] * rows.astype(np.float32)
            for k in range(3):
                lift = wave[2] * np.float32(z_mm) + phase[k]
                bump = np.sin(base_y + lift)[:, None] * np.cos(base_x + lift)[None, :]
                turned[k] = turned[k] + np.float32(self.amplitude_mm) * bump
        return Plane(*turned)


def random_warp(rng: np.random.Generator, amplitude_mm: float, wavelength_mm: float, tilt_rad: float) -> Warp:
    """A warp of ``amplitude_mm`` with waves of about ``wavelength_mm`` and a tilt of about ``tilt_rad``."""
    vector = rng.normal(0.0, tilt_rad, 3)
    rotation, _ = cv2.Rodrigues(vector)
    waves = rng.normal(0.0, 2 * np.pi / wavelength_mm, (4, 3))
    return Warp(np.asarray(rotation), waves, rng.uniform(0, 2 * np.pi, (4, 3)), amplitude_mm / 2)


def paint(canvas: Canvas, plane: Plane, blob: Blob, soft_mm: float = 0.5) -> None:
    """Puts a blob over the canvas in place, its rim ``soft_mm`` wide so that slices do not show stairs."""
    if not plane.touches(blob):
        return
    distance = plane.distance(blob)
    if blob.shell_mm > 0:
        wall = np.clip(0.5 - (distance - np.float32(blob.shell_mm)) / np.float32(soft_mm), 0.0, 1.0)
        canvas += wall * (np.float32(blob.shell_hu) - canvas)
    share = np.clip(0.5 - distance / np.float32(soft_mm), 0.0, 1.0)
    canvas += share * (np.float32(blob.hu) - canvas)


def paint_all(canvas: Canvas, plane: Plane, blobs: Sequence[Blob]) -> None:
    """Puts blobs over the canvas in order, the last on top."""
    for blob in blobs:
        paint(canvas, plane, blob)


def blend(canvas: Canvas, share: Canvas, hu: Canvas | float) -> None:
    """Moves the canvas in place towards ``hu`` by ``share`` in [0, 1]."""
    canvas += share * (np.asarray(hu, np.float32) - canvas)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int, int], cells: tuple[int, int, int]) -> np.ndarray:
    """Noise (slices, rows, cols) float32 of about unit variance, correlated over 1 / ``cells`` of each axis."""
    small = rng.standard_normal(cells).astype(np.float32)
    planes = np.stack([cv2.resize(s, shape[2:0:-1], interpolation=cv2.INTER_CUBIC) for s in small])
    position = np.linspace(0, cells[0] - 1, shape[0]) if cells[0] > 1 else np.zeros(shape[0])
    lower = np.minimum(position.astype(int), max(cells[0] - 2, 0))
    share = (position - lower).astype(np.float32)[:, None, None]
    return planes[lower] * (1 - share) + planes[np.minimum(lower + 1, cells[0] - 1)] * share


def streaks(plane: Plane, source: tuple[float, float], rng: np.random.Generator, strength_hu: float) -> Canvas:
    """Rays of light and dark from a piece of metal at (x, y) mm, weaker with distance."""
    dx, dy = plane.x - np.float32(source[0]), plane.y - np.float32(source[1])
    angle, distance = np.arctan2(dy, dx), np.sqrt(dx * dx + dy * dy)
    pattern = np.zeros_like(angle)
    for frequency in rng.integers(2, 26, 6):
        pattern += np.sin(np.float32(frequency) * angle + np.float32(rng.uniform(0, 6.3)))
    return np.float32(strength_hu) * pattern * np.exp(-distance / np.float32(45.0))


def scan(canvas: Canvas, rng: np.random.Generator, noise_hu: float, blur_px: float) -> Int16[np.ndarray, "rows cols"]:
    """What a scanner makes of a slice: blurred, with correlated noise, cut to 12 bits."""
    noise = cv2.GaussianBlur(rng.standard_normal(canvas.shape, dtype=np.float32), (0, 0), 0.8) * np.float32(2.8)
    blurred = cv2.GaussianBlur(canvas, (0, 0), blur_px) + noise * np.float32(noise_hu)
    return np.clip(np.rint(blurred), -1024, 3071).astype(np.int16)
