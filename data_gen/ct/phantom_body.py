"""A trunk without a patient: chest to abdomen, different for every random state."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from data_gen.ct.phantom_trunk import (
    AIR,
    FAT,
    LUNG,
    MUSCLE,
    Frame,
    airways_and_vessels,
    belly_parts,
    chest_parts,
    ribs,
    shoulders,
    spine,
)  # fmt: skip
from data_gen.ct.scanner import Rest, Scanner, draw_rest, scan
from data_gen.ct.shapes import (
    Blob,
    Canvas,
    Plane,
    Solid,
    blend,
    both,
    paint_all,
    ramp,
    random_warp,
    smooth_min,
    smooth_noise,
)
from data_gen.ct.volumes import CtVolume
from hybrid.coords import centres_1d

STANDARD_MM = (165.0, 110.0)
"""Half width and half depth of the standard trunk, which Frame fits to others."""


@dataclass(frozen=True, eq=False)
class _Trunk:
    """One trunk: everything that does not depend on the slice.

    radii: half width and depth. squareness: exponent of the outline (2 is an ellipse). fat_mm, wall_mm: thickness of
    fat, and of the muscles and ribs below it. liver_hu: of the liver. mediastinum_mm: half width between the lungs.
    dome_mm: how far the diaphragm's right dome rises.
    """

    radii: tuple[float, float]
    squareness: float
    fat_mm: float
    wall_mm: float
    liver_hu: float
    mediastinum_mm: float
    dome_mm: float
    outline: tuple[Solid, ...]
    muscles: tuple[Solid, ...]
    bones: tuple[Solid, ...]
    lung_vessels: tuple[Solid, ...]
    chest: tuple[Solid, ...]
    belly: tuple[Solid, ...]


@dataclass(frozen=True, eq=False)
class _Walls:
    """Distances in mm, negative inside: to the skin, to the muscles' outside, to the inner wall.

    over: height over the diaphragm.
    """

    skin: Canvas
    muscle: Canvas
    inner: Canvas
    over: Canvas


def body_phantom(rng: np.random.Generator, size: int = 256, slices: int = 30) -> CtVolume:
    """A made-up chest and abdomen in ``slices`` slices of ``size`` x ``size`` pixels, slice 0 lowest."""
    trunk = _random_trunk(rng)
    field_mm = 2 * trunk.radii[0] * rng.uniform(1.06, 1.3)
    warp = random_warp(rng, rng.uniform(2.0, 5.0), rng.uniform(180.0, 350.0), 0.03)
    middle, reach = rng.uniform(-70, 70), rng.uniform(60, 115)
    heights = np.linspace(middle - reach, middle + reach, slices)
    axis = (centres_1d(size) / size - 0.5) * field_mm
    shape = (slices, size, size)
    broad = smooth_noise(rng, shape, (max(2, slices // 2), 24, 24))
    fine = smooth_noise(rng, shape, (max(2, slices), 80, 80))
    scanner = Scanner(rng.uniform(5.0, 17.0), rng.uniform(0.5, 0.7) * size / 256, rng.uniform(0.1, 0.7),
                      rng.uniform(2.0, 14.0), rng.uniform(0.0, 12.0))  # fmt: skip
    curve = rng.uniform(250, 900)
    rest = Rest(str(rng.choice(["cradle", "flat", "none"], p=[0.75, 0.15, 0.1])), trunk.radii[1] + rng.uniform(3, 18),
                curve, rng.uniform(180, 230), rng.uniform(1.5, 3.0), rng.uniform(12, 40), -940.0)  # fmt: skip
    out = np.empty(shape, np.int16)
    for k, z_mm in enumerate(heights):
        plane = warp.plane(axis, axis, float(z_mm), broad[k])
        canvas = _draw_slice(trunk, plane, fine[k])
        draw_rest(canvas, axis, axis, rest)
        out[k] = scan(canvas, rng, scanner)
    spacing = (float(heights[1] - heights[0]) if slices > 1 else 8.0, field_mm / size, field_mm / size)
    return CtVolume(out, spacing, "phantom_body")


def _random_trunk(rng: np.random.Generator) -> _Trunk:
    fat = rng.uniform(5, 26)
    wide = rng.uniform(138, 162) + 0.9 * fat
    deep = (wide - fat) * rng.uniform(0.62, 0.76) + fat
    wall = rng.uniform(13, 19)
    frame = Frame((wide - fat) / (STANDARD_MM[0] - 15), (deep - fat) / (STANDARD_MM[1] - 15),
                  float(rng.choice([45.0, rng.uniform(130, 300)])))  # fmt: skip
    inner = (wide - fat - wall, deep - fat - wall)
    back = inner[1] - 18.0
    bulk = rng.uniform(0.85, 1.15)
    muscles = both(
        Blob((27, back + 34, 0), (23 * bulk, 15 * bulk, 600), MUSCLE, 0.15, rough_mm=1.5),  # along the spine
        Blob((inner[0] * 0.45, -inner[1] - 6, 130), (52, 11 * bulk, 60), MUSCLE, -0.25, rough_mm=2.0),
        Blob((inner[0] * 0.7, inner[1] * 0.62, 130), (38, 16 * bulk, 70), MUSCLE, -0.75, rough_mm=2.5),
    )
    outline = both(
        Blob((wide - 6, 5, 195), (46, 44, 70), 0.0),
        Blob((wide * 0.6, 0, 185), (70, 60, 55), 0.0),
        *([Blob((wide * 0.46, -deep + 8, 70), (60, rng.uniform(20, 44), 50), 0.0)] if rng.random() < 0.45 else []),
    )
    return _Trunk(
        radii=(wide, deep), squareness=rng.uniform(2.0, 2.6), fat_mm=fat, wall_mm=wall,
        liver_hu=rng.uniform(45, 62) + 0.22 * max(frame.blood_hu - 45, 0.0), mediastinum_mm=rng.uniform(23, 34),
        dome_mm=rng.uniform(45, 70), outline=tuple(outline), muscles=tuple(muscles),
        bones=(*spine(rng, back), *ribs(rng, inner, back), *shoulders(wide)),
        lung_vessels=tuple(airways_and_vessels(rng, frame)), chest=tuple(chest_parts(rng, frame)),
        belly=tuple(belly_parts(rng, frame)),
    )  # fmt: skip


# ---------------------------------------------------------------- one slice


def _draw_slice(trunk: _Trunk, plane: Plane, fine: Canvas) -> Canvas:
    canvas = np.full(plane.x.shape, AIR, np.float32)
    walls = _walls(trunk, plane)
    blend(canvas, ramp(0.5 - walls.skin), 10.0)
    blend(canvas, ramp(-walls.skin - 1.8), FAT + 7 * plane.rough)
    sheets = ramp(1.25 + 0.9 * plane.rough + 0.5 * fine, 0.6)  # fat lies between the muscles
    blend(canvas, ramp(-walls.muscle) * sheets, MUSCLE + 4 * plane.rough)
    paint_all(canvas, plane, trunk.muscles)
    below = ramp(-walls.inner)
    blend(canvas, below, FAT + 8 * fine)
    if walls.over.min() < 1:
        _draw_belly(canvas, trunk, plane, walls, fine)
    if walls.over.max() > -1:
        _draw_chest(canvas, trunk, plane, walls, fine)
    paint_all(canvas, plane, trunk.bones)
    blend(canvas, ramp(walls.skin), AIR)
    return canvas


def _walls(trunk: _Trunk, plane: Plane) -> _Walls:
    skin = _rounded(plane, trunk.radii, trunk.squareness)
    thick = np.float32(trunk.fat_mm) * (1.0 + 0.35 * np.clip(-plane.y / np.float32(trunk.radii[1]), -0.8, 1.0))
    muscle = skin + thick + plane.rough
    for solid in trunk.outline:
        if plane.window(solid, 5.0) is not None:
            skin = smooth_min(skin, plane.distance(solid) + plane.rough, 16.0)
            if solid.box[0][2] > 150:  # shoulders are muscle inside, breasts are fat
                muscle = np.minimum(muscle, skin + np.float32(trunk.fat_mm + 3))
    apex = 1.0 - 0.62 * max(0.0, (plane.z_mm - 95) / 90) ** 1.4
    wide, deep = (max(r - trunk.fat_mm - trunk.wall_mm, 20) * max(apex, 0.12) for r in trunk.radii)
    inner = _rounded(plane, (wide, deep * (0.5 + 0.5 * max(apex, 0.12)) / max(apex, 0.12)), trunk.squareness)
    spine_room = np.hypot(plane.x, plane.y - np.float32(deep - 18.0 if apex > 0.99 else trunk.radii[1] * 0.6)) - 25.0
    inner = np.maximum(inner + 0.8 * plane.rough, -spine_room)
    side = np.sign(plane.x)
    dome_x = (plane.x - side * np.float32(0.5 * wide)) / np.float32(0.62 * wide)
    dome = np.float32(trunk.dome_mm) * (1.0 - dome_x**2 - ((plane.y + 12) / np.float32(1.1 * deep)) ** 2)
    over = plane.z - np.maximum(dome, -75.0) + 30.0 + 7.0 * side + 2.5 * plane.rough
    return _Walls(skin, muscle, inner, over)


def _rounded(plane: Plane, radii: tuple[float, float], power: float) -> Canvas:
    """Approximate distance in mm to an upright cylinder over a superellipse: the level divided by its gradient."""
    a, b = np.abs(plane.x) * np.float32(1 / radii[0]), np.abs(plane.y) * np.float32(1 / radii[1])
    pa, pb = cv2.pow(a, power - 1.0), cv2.pow(b, power - 1.0)  # several times faster than NumPy's
    total = np.maximum(pa * a + pb * b, np.float32(1e-6))
    level = cv2.pow(total, 1.0 / power)
    slope = np.hypot(pa * np.float32(1 / radii[0]), pb * np.float32(1 / radii[1])) * level / total
    return (level - 1.0) / np.maximum(slope, np.float32(1e-4))


def _draw_belly(canvas: Canvas, trunk: _Trunk, plane: Plane, walls: _Walls, fine: Canvas) -> None:
    """Draw what lies under the diaphragm on a copy, which is then blended in there."""
    room = ramp(-walls.inner - 1.0) * ramp(0.5 - walls.over)
    tissue = canvas.copy()
    paint_all(tissue, plane, trunk.belly)
    wide, deep = trunk.radii
    edge = plane.x + np.float32(0.14 * wide) + 0.55 * (plane.y + 0.1 * np.float32(deep)) * np.sign(plane.y + 10) * 0.5
    edge += np.float32(0.6) * np.maximum(-plane.z - 35.0, -60.0) + 3.0 * plane.rough
    low = plane.y - np.float32(0.62 * deep) + 0.3 * np.maximum(-plane.z - 40, 0)
    liver = ramp(-edge, 2.0) * ramp(-low, 2.0) * ramp(-walls.inner - 3.0) * ramp(plane.z + 128, 6)
    vessels = ramp(np.abs(fine) - 2.1, 0.4) * 35.0 + ramp(0.12 - np.abs(plane.rough)) * 10.0
    blend(tissue, liver, trunk.liver_hu + vessels * np.float32(1.0 if trunk.liver_hu > 65 else -0.4))
    blend(canvas, room, tissue)


def _draw_chest(canvas: Canvas, trunk: _Trunk, plane: Plane, walls: _Walls, fine: Canvas) -> None:
    """Lungs with their vessels, and what lies between them, above the diaphragm."""
    room = ramp(-walls.inner) * ramp(walls.over)
    tissue = np.full(canvas.shape, FAT + 20, np.float32)
    heart = 30.0 * np.exp(-(((plane.z - 25) / 45.0) ** 2)) * ramp(15 - plane.y, 60)
    lean = np.where(plane.x > 0, heart, 0.5 * heart)
    between = np.abs(plane.x) - np.float32(trunk.mediastinum_mm) - lean - 4 * plane.rough
    lung = ramp(between, 1.5) * ramp(-walls.inner - 1.5) * ramp(walls.over - 1.0)
    air = np.float32(LUNG) + 22 * fine + 45 * ramp(plane.y + 20, 100)  # denser at the back, where the patient lies
    paint_all(tissue, plane, trunk.chest)
    blend(air, ramp(fine - 1.7, 0.5) * ramp(0.9 + plane.rough), -250.0)  # small vessels cut across
    paint_all(air, plane, trunk.lung_vessels)
    organs = ramp(30.0 - np.abs(tissue - 45.0), 10.0) + ramp(tissue - 75.0, 10.0)  # they stand out into the lungs
    blend(tissue, lung * (1.0 - ramp(organs) * ramp(22.0 - between, 4.0)), air)
    blend(canvas, room, tissue)
