"""What the procedural phantoms are painted with: warped ellipsoids and tubes, and smooth noise."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Bool, Float

Triple = tuple[float | int, float | int, float | int]
Canvas = Float[np.ndarray, "rows cols"]
Window = tuple[slice, slice]


@dataclass(frozen=True)
class Blob:
    """An ellipsoid in millimetres (x to the patient's left, y backwards, z up): centre, semi-axes, tissue.

    yaw: turn about z in radians. hu: inside. shell_hu, shell_mm: a wall around it, drawn outside, if shell_mm > 0.
    rough_mm: how far its surface strays.
    """

    centre: Triple
    radii: Triple
    hu: float | int
    yaw: float = 0.0
    shell_hu: float = 0.0
    shell_mm: float = 0.0
    rough_mm: float = 0.0

    def mirrored(self) -> Blob:
        """The same on the other side of the body."""
        x, y, z = self.centre
        return replace(self, centre=(-x, y, z), yaw=-self.yaw)

    @cached_property
    def box(self) -> tuple[Triple, Triple]:
        """Middle and half sides of an upright box around it, walls left out."""
        across = max(self.radii[0], self.radii[1]) if self.yaw else 0.0
        return self.centre, (max(self.radii[0], across), max(self.radii[1], across), self.radii[2])

    def distance(self, x: Canvas, y: Canvas, z: Canvas) -> Canvas:
        """Approximate distance in mm to the surface, negative inside: the level over its gradient (I. Quilez)."""
        (cx, cy, cz), (rx, ry, rz) = self.centre, self.radii
        cos, sin = np.float32(np.cos(self.yaw)), np.float32(np.sin(self.yaw))
        dx, dy = x - np.float32(cx), y - np.float32(cy)
        along, across = (dx * cos + dy * sin) / np.float32(rx), (dy * cos - dx * sin) / np.float32(ry)
        up = (z - np.float32(cz)) / np.float32(rz)
        level = np.sqrt(along * along + across * across + up * up)
        along /= np.float32(rx)
        across /= np.float32(ry)
        up /= np.float32(rz)
        slope = np.sqrt(along * along + across * across + up * up)
        return level * (level - 1.0) / np.maximum(slope, np.float32(1e-4))


@dataclass(frozen=True)
class Tube:
    """A straight piece of a vessel or bone from ``start`` to ``end`` in millimetres, round, with round ends.

    hu, shell_hu, shell_mm, rough_mm: as of a Blob; flat: how many times thinner it is across than in z.
    """

    start: Triple
    end: Triple
    radius: float
    hu: float | int
    shell_hu: float = 0.0
    shell_mm: float = 0.0
    rough_mm: float = 0.0
    flat: float = 1.0

    def mirrored(self) -> Tube:
        """The same on the other side of the body."""
        (ax, ay, az), (bx, by, bz) = self.start, self.end
        return replace(self, start=(-ax, ay, az), end=(-bx, by, bz))

    @cached_property
    def box(self) -> tuple[Triple, Triple]:
        """Middle and half sides of an upright box around it, walls left out."""
        middle = tuple((a + b) / 2 for a, b in zip(self.start, self.end, strict=True))
        half = [abs(a - b) / 2 + self.radius for a, b in zip(self.start, self.end, strict=True)]
        return (middle[0], middle[1], middle[2]), (half[0], half[1], half[2] + (self.flat - 1.0) * self.radius)

    def distance(self, x: Canvas, y: Canvas, z: Canvas) -> Canvas:
        """Distance in mm to the surface, negative inside."""
        a, b = np.array(self.start, np.float32), np.array(self.end, np.float32)
        step = b - a
        dx, dy, dz = x - a[0], y - a[1], z - a[2]
        t = np.clip((dx * step[0] + dy * step[1] + dz * step[2]) / max(float(step @ step), 1e-6), 0.0, 1.0)
        dx, dy, dz = dx - t * step[0], dy - t * step[1], (dz - t * step[2]) / np.float32(self.flat)
        return np.sqrt(dx * dx + dy * dy + dz * dz) - np.float32(self.radius)


Solid = Blob | Tube


@dataclass(frozen=True, eq=False)
class Plane:
    """The coordinates in millimetres of one slice's pixel centres, tilted and warped as the patient lies.

    rough: noise of about unit variance, by which surfaces stray. axes_mm: where rows and columns lie before the warp.
    z_mm: height of the slice before it. rotation: of the warp. slack_mm: bound of what the warp adds to the rotation.
    """

    x: Canvas
    y: Canvas
    z: Canvas
    rough: Canvas
    axes_mm: tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " cols"]]
    z_mm: float
    rotation: Float[np.ndarray, "3 3"]
    slack_mm: float

    def distance(self, solid: Solid) -> Canvas:
        """Approximate distance in mm to the surface of a solid, negative inside (exact on the surface)."""
        return solid.distance(self.x, self.y, self.z)

    def cut(self, window: Window) -> Plane:
        """The part of the slice in a window, as views."""
        rows, cols = window
        return replace(
            self, x=self.x[window], y=self.y[window], z=self.z[window], rough=self.rough[window],
            axes_mm=(self.axes_mm[0][rows], self.axes_mm[1][cols]),
        )  # fmt: skip

    def window(self, solid: Solid, margin_mm: float = 1.0) -> Window | None:
        """Rows and columns that bound the solid, or None if the slice misses it."""
        (cx, cy, cz), (rx, ry, rz) = solid.box
        slack = self.slack_mm + solid.shell_mm + 3 * solid.rough_mm + margin_mm
        if abs(self.z_mm - cz) > rz + slack + 25.0:  # cheap, and enough for nearly all: tilts move less than 25 mm
            return None
        turn = self.rotation
        det = turn[0, 0] * turn[1, 1] - turn[0, 1] * turn[1, 0]
        px, py = cx - turn[0, 2] * self.z_mm, cy - turn[1, 2] * self.z_mm
        x, y = (turn[1, 1] * px - turn[0, 1] * py) / det, (turn[0, 0] * py - turn[1, 0] * px) / det
        lean = abs(turn[2, 0]) * rx + abs(turn[2, 1]) * ry  # how much the slice rises over the solid
        if abs(turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * self.z_mm - cz) > rz + lean + slack:
            return None
        half_x = (abs(turn[1, 1]) * rx + abs(turn[0, 1]) * ry) / det + slack
        half_y = (abs(turn[0, 0]) * ry + abs(turn[1, 0]) * rx) / det + slack
        rows, cols = self.axes_mm
        low_row, high_row = np.searchsorted(rows, (y - half_y, y + half_y)).tolist()
        low_col, high_col = np.searchsorted(cols, (x - half_x, x + half_x)).tolist()
        if low_row >= high_row or low_col >= high_col:
            return None
        return slice(low_row, high_row), slice(low_col, high_col)


@dataclass(frozen=True, eq=False)
class Warp:
    """A smooth random displacement of space, a few waves for each axis, and a small rotation."""

    rotation: Float[np.ndarray, "3 3"]
    waves: Float[np.ndarray, "n 3"]
    phases: Float[np.ndarray, "n 3"]
    amplitude_mm: float

    def plane(self, rows: Float[np.ndarray, " r"], cols: Float[np.ndarray, " c"], z_mm: float, rough: Canvas) -> Plane:
        """Body coordinates of the slice at height ``z_mm`` whose pixel centres are at ``cols`` (x), ``rows`` (y) mm."""
        x, y = np.meshgrid(cols.astype(np.float32), rows.astype(np.float32))
        turned = [r[0] * x + r[1] * y + r[2] * np.float32(z_mm) for r in self.rotation.astype(np.float32)]
        for wave, phase in zip(self.waves.astype(np.float32), self.phases.astype(np.float32), strict=True):
            # separable: waves along rows and along columns are computed on vectors, not images
            base_x, base_y = wave[0] * cols.astype(np.float32), wave[1] * rows.astype(np.float32)
            for k in range(3):
                lift = wave[2] * np.float32(z_mm) + phase[k]
                bump = np.sin(base_y + lift)[:, None] * np.cos(base_x + lift)[None, :]
                turned[k] += np.float32(self.amplitude_mm) * bump
        slack = len(self.waves) * self.amplitude_mm
        return Plane(turned[0], turned[1], turned[2], rough, (rows, cols), z_mm, self.rotation, slack)


def random_warp(rng: np.random.Generator, amplitude_mm: float, wavelength_mm: float, tilt_rad: float) -> Warp:
    """A warp of ``amplitude_mm`` with waves of about ``wavelength_mm`` and a tilt of about ``tilt_rad``."""
    vector = np.clip(rng.normal(0.0, tilt_rad, 3), -2.5 * tilt_rad, 2.5 * tilt_rad)
    rotation, _ = cv2.Rodrigues(vector)
    waves = rng.normal(0.0, 2 * np.pi / wavelength_mm, (4, 3))
    return Warp(np.asarray(rotation), waves, rng.uniform(0, 2 * np.pi, (4, 3)), amplitude_mm / 2)


def paint(canvas: Canvas, plane: Plane, solid: Solid, soft_mm: float = 0.8) -> None:
    """Paints a solid over the canvas in place, its rim ``soft_mm`` wide so that slices show no staircase edges."""
    window = plane.window(solid)
    if window is None:
        return
    region = canvas[window]
    distance = solid.distance(plane.x[window], plane.y[window], plane.z[window])
    if solid.rough_mm > 0:
        distance += np.float32(solid.rough_mm) * plane.rough[window]
    distance *= np.float32(-1 / soft_mm)
    if solid.shell_mm > 0:
        wall = np.clip(distance + np.float32(0.5 + solid.shell_mm / soft_mm), 0.0, 1.0)
        region += wall * (np.float32(solid.shell_hu) - region)
    distance += np.float32(0.5)
    region += np.clip(distance, 0.0, 1.0, out=distance) * (np.float32(solid.hu) - region)


def paint_all(canvas: Canvas, plane: Plane, solids: Iterable[Solid]) -> None:
    """Paints solids over the canvas in order, the last on top."""
    for solid in solids:
        paint(canvas, plane, solid)


def blend(canvas: Canvas, share: Canvas, hu: Canvas | float | int) -> None:
    """Moves the canvas in place towards ``hu`` by ``share`` in [0, 1]."""
    canvas += share * (np.asarray(hu, np.float32) - canvas)


def bounds(mask: Bool[np.ndarray, "rows cols"]) -> Window | None:
    """The smallest window around the set pixels, or None."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)) if len(rows) else None


def ramp(values: Canvas, width: float | int = 1.0) -> Canvas:
    """0 below 0, 1 above ``width``, linear in between."""
    return np.clip(values * np.float32(1.0 / width), 0.0, 1.0)


def smooth_min(a: Canvas, b: Canvas, width_mm: float) -> Canvas:
    """The union of two distance fields with a fillet of ``width_mm``."""
    h = np.clip(0.5 + (0.5 / width_mm) * (b - a), 0.0, 1.0)
    return b + (a - b) * h - np.float32(width_mm) * h * (1.0 - h)


def both(*solids: Solid) -> list[Solid]:
    """Each solid and its mirror image."""
    return [side for solid in solids for side in (solid, solid.mirrored())]


def chain(points: Iterable[Triple], radii: Iterable[float], hu: float, **wall: float | int) -> list[Solid]:
    """Tubes from point to point, each of its own radius; ``wall``: fields of a Tube."""
    ends = [(float(x), float(y), float(z)) for x, y, z in points]
    return [Tube(a, b, float(r), hu, **wall) for (a, b), r in zip(pairwise(ends), radii, strict=True)]


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int, int], cells: tuple[int, int, int]) -> np.ndarray:
    """Noise (slices, rows, cols) float32 of about unit variance, correlated over 1 / ``cells`` of each axis."""
    small = rng.standard_normal(cells).astype(np.float32)
    planes = [cv2.resize(s, shape[2:0:-1], interpolation=cv2.INTER_CUBIC) for s in small]
    position = np.linspace(0, cells[0] - 1, shape[0])
    out = np.empty(shape, np.float32)
    for k, at in enumerate(position.tolist()):
        lower = min(int(at), max(cells[0] - 2, 0))
        upper = min(lower + 1, cells[0] - 1)
        out[k] = cv2.addWeighted(planes[lower], 1.0 - at + lower, planes[upper], at - lower, 0.0)
    return out
