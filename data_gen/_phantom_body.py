"""A trunk without a patient: chest to abdomen, different for every random state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen._scanner import Scanner, scan
from data_gen._shapes import Blob, Canvas, Plane, blend, paint_all, random_warp, smooth_noise
from data_gen.volumes import CtVolume
from hybrid.coords import centres_1d

Number = float | int

AIR, FAT, MUSCLE, LUNG, BONE = -1000.0, -100.0, 50.0, -850.0, 700.0


@dataclass(frozen=True, eq=False)
class _Trunk:
    """One trunk: half width and depth in mm, exponent of the outline (2 is an ellipse), fat, organs, ribs, table.

    table_mm: its lowest point below the middle and its radius.
    """

    radii: tuple[float, float]
    squareness: float
    fat_mm: float
    lungs: tuple[Blob, ...]
    chest: tuple[Blob, ...]
    belly: tuple[Blob, ...]
    spine: tuple[Blob, ...]
    rib_slope: float
    rib_pitch_mm: float
    table_mm: tuple[float, float]


def body_phantom(rng: np.random.Generator, size: int = 256, slices: int = 30) -> CtVolume:
    """A made-up chest and abdomen on ``slices`` slices of ``size`` x ``size`` pixels, slice 0 lowest."""
    trunk = _random_trunk(rng)
    field_mm = 2 * trunk.radii[0] * rng.uniform(1.05, 1.3)
    warp = random_warp(rng, rng.uniform(2.0, 6.0), rng.uniform(180.0, 350.0), 0.03)
    middle, reach = rng.uniform(-110, 110), rng.uniform(60, 130)
    heights = np.linspace(middle - reach, middle + reach, slices)
    axis = (centres_1d(size) / size - 0.5) * field_mm
    shape = (slices, size, size)
    texture = smooth_noise(rng, shape, (max(2, slices // 2), 26, 26))
    fine = smooth_noise(rng, shape, (max(2, slices // 2), 70, 70))
    noise_hu = rng.uniform(5.0, 16.0)
    out = np.empty(shape, np.int16)
    for k, z_mm in enumerate(heights):
        plane = warp.plane(axis, axis, float(z_mm), texture[k])
        canvas = _draw_slice(trunk, plane, texture[k], fine[k])
        out[k] = scan(canvas, rng, Scanner(noise_hu, 0.65 * size / 256, 0.4, 10.0, 5.0))
    spacing = (float(heights[1] - heights[0]) if slices > 1 else 8.0, field_mm / size, field_mm / size)
    return CtVolume(out, spacing, "phantom_body")


def _random_trunk(rng: np.random.Generator) -> _Trunk:
    wide = rng.uniform(145, 185)
    deep = wide * rng.uniform(0.6, 0.8)
    s, t = wide / 165, deep / 110
    fat = rng.uniform(6, 28)
    vessel = rng.choice([45.0, rng.uniform(140, 320)])

    def at(x: Number, y: Number, z: Number, rx: Number, ry: Number, rz: Number, hu: Number, yaw: float = 0.0) -> Blob:
        return Blob((x * s, y * t, z), (rx * s, ry * t, rz), hu, yaw)

    lungs = (at(-68, 0, 60, 56, 78, 115, LUNG, 0.1), at(70, 4, 60, 54, 76, 112, LUNG, -0.1))
    chest = (
        at(0, -18, 60, 34, 66, 160, 20.0),
        at(24, -26, 30, 52, 42, 46, 45.0, 0.5),
        at(32, -24, 30, 26, 28, 32, vessel, 0.5),
        at(0, -30, 92, 16, 16, 34, vessel),
        at(18, 30, 40, 12, 12, 170, vessel),
        at(-20, -30, 110, 10, 10, 40, vessel),
        at(0, 8, 120, 9, 8, 62, AIR),
        at(-13, 12, 64, 6, 6, 12, AIR),
        at(13, 12, 64, 6, 6, 12, AIR),
        at(0, -86, 90, 20, 5, 90, BONE),
    )
    liver = rng.uniform(50, 65) + (vessel > 100) * 45
    belly = (
        at(-58, -14, -40, 78, 74, 66, liver, -0.25),
        at(-62, 4, -42, 8, 26, 8, liver + 30, 0.4),
        at(-30, -46, -66, 15, 22, 18, 10.0, 0.5),
        at(86, 30, -36, 30, 40, 40, liver - 5, 0.4),
        at(46, -38, -36, 40, 36, 30, 30.0, 0.4),
        at(44, -56, -34, 26, 14, 20, AIR, 0.2),
        at(-56, 46, -98, 24, 30, 48, 35 + 0.6 * vessel, 0.5),
        at(58, 44, -86, 24, 30, 48, 35 + 0.6 * vessel, -0.5),
        at(-52, 44, -98, 10, 14, 26, FAT, 0.5),
        at(54, 42, -86, 10, 14, 26, FAT, -0.5),
        at(8, 26, -80, 11, 11, 140, vessel),
        at(-16, 24, -80, 12, 9, 140, 0.5 * (vessel + 45)),
        at(0, -4, -76, 52, 11, 12, 45.0, 0.3),
    )
    vertebrae = [
        blob
        for z in np.arange(-260, 280, 27.0)
        for blob in (
            at(0, 54, z, 21, 17, 14.5, 260.0),
            at(0, 88, z - 4, 4, 22, 9, BONE),
            at(24, 74, z, 20, 5, 6, 500.0, 0.3),
            at(-24, 74, z, 20, 5, 6, 500.0, -0.3),
        )
    ]
    spine = (*vertebrae, at(0, 76, 0, 9, 8, 600, 20.0))
    return _Trunk(
        (wide, deep), rng.uniform(1.9, 2.5), fat, lungs, chest, belly, spine, rng.uniform(0.5, 1.1),
        rng.uniform(24, 32), (deep + rng.uniform(4, 16), rng.uniform(250, 900)),
    )  # fmt: skip


def _draw_slice(trunk: _Trunk, plane: Plane, texture: Canvas, fine: Canvas) -> Canvas:
    canvas = np.full(plane.x.shape, AIR, np.float32)
    wide, deep = trunk.radii
    power = np.float32(trunk.squareness)
    squircle = (np.abs(plane.x / wide) ** power + np.abs(plane.y / deep) ** power) ** (1 / power)
    skin = (squircle - 1.0) * np.float32(deep)
    wall = skin + np.float32(trunk.fat_mm) * (1.0 + 0.5 * np.clip(-plane.y / deep, -0.6, 1.0))
    blend(canvas, np.clip(0.5 - skin, 0, 1), 0.0)
    blend(canvas, np.clip(-skin - 1.5, 0, 1), FAT + 6 * texture)
    blend(canvas, np.clip(-wall, 0, 1) * np.clip(1.3 + 0.5 * texture, 0, 1), MUSCLE + 5 * texture)
    blend(canvas, np.clip(-wall - 14, 0, 1), FAT + 8 * fine)
    _draw_bowel(canvas, wall, texture, fine)
    _draw_lungs(canvas, trunk, plane, fine)
    diaphragm = np.clip((plane.z - 12 + 0.004 * (plane.x**2 + plane.y**2)) / 3.0, 0.0, 1.0)
    upper = canvas.copy()
    paint_all(upper, plane, trunk.chest)
    lower = canvas
    blend(lower, np.clip(-wall - 14, 0, 1) * np.clip((plane.z + 60) / 10, 0, 1) * (lower < -300), FAT)
    paint_all(lower, plane, trunk.belly)
    canvas = lower + (upper - lower) * diaphragm
    paint_all(canvas, plane, trunk.spine)
    _draw_ribs(canvas, trunk, plane, wall)
    blend(canvas, np.clip(skin / 1.0, 0, 1), AIR)
    _draw_table(canvas, plane, trunk.table_mm)
    return canvas


def _draw_bowel(canvas: Canvas, wall: Canvas, texture: Canvas, fine: Canvas) -> None:
    room = np.clip(-wall - 16, 0, 1)
    blend(canvas, room * np.clip((texture - 0.1) * 4, 0, 1), 35.0 + 8 * fine)
    blend(canvas, room * np.clip((texture - 1.3) * 5, 0, 1), -700.0)


def _draw_lungs(canvas: Canvas, trunk: _Trunk, plane: Plane, fine: Canvas) -> None:
    for lung in trunk.lungs:
        inside = np.clip(0.5 - plane.distance(lung), 0, 1)
        blend(canvas, inside, LUNG + 30 * fine)
        hilum = np.exp(-np.hypot(plane.x - 0.3 * lung.centre[0], plane.y) / np.float32(60.0))
        blend(canvas, inside * np.clip((fine - 2.1 + 1.5 * hilum) * 3, 0, 1), 30.0)


def _draw_ribs(canvas: Canvas, trunk: _Trunk, plane: Plane, wall: Canvas) -> None:
    """Ribs slope down from the spine to the front, so a slice cuts each of them once on each side."""
    phase = (plane.z + trunk.rib_slope * (plane.y - 60.0)) / np.float32(trunk.rib_pitch_mm)
    along = np.abs(phase - np.rint(phase)) * np.float32(trunk.rib_pitch_mm)
    across = np.abs(wall + 7.0)
    distance = np.hypot(along / 1.1, across) - 5.0
    cage = np.clip((plane.z + 90.0 - 0.6 * plane.y) / 10, 0, 1)
    blend(canvas, np.clip(0.5 - distance, 0, 1) * cage, 900.0)
    blend(canvas, np.clip(-1.5 - distance, 0, 1) * cage, 250.0)


def _draw_table(canvas: Canvas, plane: Plane, table_mm: tuple[float, float]) -> None:
    lowest, radius = table_mm
    depth = np.hypot(plane.x, plane.y - np.float32(lowest - radius)) - np.float32(radius)
    rest = (np.abs(plane.x) < 200) & (plane.y > 0) & (canvas < -600)
    blend(canvas, np.clip(1.8 - np.abs(depth), 0, 1) * rest, 80.0)
    blend(canvas, np.clip(1.5 - np.abs(depth - 16), 0, 1) * rest, 0.0)
