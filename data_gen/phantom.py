"""A head without a patient: procedural CT volumes, different for every random state, good enough to train on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from data_gen._phantom_body import body_phantom
from data_gen._shapes import Blob, Canvas, Plane, Triple, blend, paint_all, random_warp, scan, smooth_noise, streaks
from data_gen.volumes import CtVolume
from hybrid.coords import centres_1d

AIR, FAT, MUSCLE, CSF, WHITE, GREY, MARROW, CORTEX = -1000.0, -95.0, 55.0, 8.0, 28.0, 38.0, 450.0, 1350.0


@dataclass(frozen=True, eq=False)
class _Head:
    """One head: everything that does not depend on the slice."""

    skull: Blob
    skull_mm: float
    scalp_mm: float
    soft: tuple[Blob, ...]
    face: tuple[Blob, ...]
    brain: tuple[Blob, ...]
    table: tuple[float, float, float]
    teeth: tuple[Blob, ...]
    metal: tuple[Triple, ...]
    sulci: float


def head_phantom(rng: np.random.Generator, size: int = 256, slices: int = 40) -> CtVolume:
    """A made-up head from the chin to the crown on ``slices`` slices of ``size`` x ``size`` pixels."""
    head = _random_head(rng)
    field_mm = rng.uniform(215.0, 260.0)
    warp = random_warp(rng, rng.uniform(0.5, 3.0), rng.uniform(120.0, 220.0), 0.05)
    low, high = rng.uniform(-128.0, -70.0), rng.uniform(72.0, 92.0)
    heights = np.linspace(low, high, slices)
    axis = (centres_1d(size) / size - rng.uniform(0.49, 0.51)) * field_mm
    shape, noise_hu = (slices, size, size), rng.uniform(1.0, 4.5)
    texture = smooth_noise(rng, shape, (max(2, slices // 3), 22, 22))
    folds = smooth_noise(rng, shape, (max(2, slices // 4), 15, 15))
    blur_px = rng.uniform(0.5, 0.9) * size / 256
    out = np.empty(shape, np.int16)
    for k, z_mm in enumerate(heights):
        plane = warp.plane(axis, axis, float(z_mm))
        canvas = _draw_slice(head, plane, texture[k], folds[k])
        for x, y, z in head.metal:
            if abs(z - z_mm) < 6.0:
                canvas += streaks(plane, (x, y), rng, float(rng.uniform(100, 500)))
        _draw_table(canvas, axis, axis, head.table)
        out[k] = scan(canvas, rng, noise_hu, blur_px)
    spacing = (float(heights[1] - heights[0]) if slices > 1 else 5.0, field_mm / size, field_mm / size)
    return CtVolume(out, spacing, "phantom_head")


# ---------------------------------------------------------------- one head


def _random_head(rng: np.random.Generator) -> _Head:
    wide, long, tall = 68 * rng.normal(1, 0.04), 88 * rng.normal(1, 0.04), 84 * rng.normal(1, 0.03)
    skull = Blob((0.0, 0.0, 0.0), (wide, long, tall), CORTEX)
    scalp = rng.uniform(3.5, 8.0)
    jaw = rng.normal(1, 0.05)
    soft = (
        Blob((0, -38, -62), (57 * jaw, 55, 62), MUSCLE),
        Blob((0, 18, -100), (50 * jaw, 55, 70), MUSCLE),
        Blob((0, -98, -52), (13, 16, 24), MUSCLE),
        Blob((0, -88, -62), (17, 14, 12), MUSCLE),
    )
    teeth = tuple(
        Blob((24 * np.sin(t), -46 - 38 * np.cos(t), z), (3.6, 3.6, 9.0), rng.uniform(1800, 2900))
        for z in (-84.0, -100.0)
        for t in np.linspace(-1.45, 1.45, 12)
    )
    metal = tuple(teeth[i].centre for i in rng.integers(0, len(teeth), rng.integers(0, 4)))
    table = (rng.uniform(98, 110), rng.uniform(120, 260), rng.uniform(1.2, 3.0))
    return _Head(
        skull, rng.uniform(5.0, 8.5), scalp, soft, _face(rng), _brain(rng), table, teeth, metal, rng.uniform(0.3, 1.2)
    )


def _both(*blobs: Blob) -> list[Blob]:
    return [side for blob in blobs for side in (blob, blob.mirrored())]


def _face(rng: np.random.Generator) -> tuple[Blob, ...]:
    """Bones and air of face, skull base, jaw and neck, in painting order."""
    air = rng.uniform(0.85, 1.15)
    bones = [
        Blob((0, -42, -104), (45, 46, 13), CORTEX),  # lower jaw, hollowed below
        Blob((0, -32, -104), (39, 48, 17), MUSCLE),
        *_both(Blob((49, -18, -78), (4.5, 15, 28), CORTEX, -0.3)),
        Blob((0, -52, -80), (33, 36, 14), 900.0),  # upper jaw
        Blob((0, -46, -84), (26, 34, 16), MUSCLE),
        *_both(Blob((50, -52, -52), (16, 6, 8), 950.0, 0.8), Blob((60, -28, -50), (3.5, 28, 5), CORTEX, -0.1)),
        *_both(Blob((36, 8, -44), (12, 34, 13), 1000.0, 0.75)),  # petrous bones
        Blob((0, -8, -50), (20, 20, 14), 700.0),
    ]
    cavities = [
        *_both(
            Blob((32, -64, -32), (17, 26, 17), FAT, 0.3, CORTEX, 2.0),  # orbits
            Blob((33, -78, -32), (12, 12.5, 12), 12.0, 0.0, 60.0, 1.2),
            Blob((34, -87, -32), (4.5, 2.6, 4.5), 85.0),
            Blob((26, -52, -32), (2.0, 18, 2.2), 40.0, 0.38),
            Blob((26, -58, -66), (14 * air, 16 * air, 17 * air), AIR, 0.2, 850.0, 1.6),  # maxillary sinuses
            Blob((5, -60, -66), (3.4, 24, 20), AIR, 0.05, 400.0, 1.0),
            Blob((6, -50, -38), (5.0, 22, 13), AIR, 0.0, 500.0, 1.0),
            Blob((10, -85, -12), (9 * air, 4.5, 12 * air), AIR, 0.35),
            Blob((58, 24, -52), (5, 9, 11), -500.0),
            Blob((62, 4, -46), (9, 2.6, 2.6), AIR, 0.15),  # ear canals
        ),
        Blob((0, -20, -48), (12 * air, 11 * air, 10), AIR, 0.0, 700.0, 1.2),
        Blob((0, -26, -88), (rng.uniform(6, 14), 9, 34), AIR),  # pharynx
    ]
    spine = [
        Blob((0, 14, -115), (11, 9, 55), 650.0, 0.0, CORTEX, 1.2),
        *_both(Blob((17, 18, -100), (8, 9, 32), 700.0, 0.3, CORTEX, 1.0)),
        Blob((0, 40, -108), (19, 14, 28), 900.0),
        Blob((0, 33, -100), (11.5, 11, 70), CSF),
        Blob((0, 33, -100), (6.5, 6, 70), GREY),
    ]
    return tuple(bones + cavities + spine)


def _brain(rng: np.random.Generator) -> tuple[Blob, ...]:
    """Ventricles, nuclei, cerebellum, sometimes a bleeding, a tumour or calcified spots."""
    wide = rng.uniform(0.5, 1.8)
    blobs = [
        *_both(
            Blob((13, -22, 12), (4.5 * wide, 17, 11), CSF, -0.35),
            Blob((11, 8, 24), (5.5 * wide, 24, 8), CSF, 0.1),
            Blob((22, 36, 12), (5 * wide, 20, 9), CSF, 0.3),
            Blob((20, -4, 6), (8, 16, 12), 41.0, -0.3),
            Blob((11, 8, 8), (8, 11, 9), 40.0),
            Blob((34, -6, 4), (2.5, 22, 14), CSF, 0.1),
        ),
        Blob((0, 2, 6), (1.6 * wide, 13, 10), CSF),
        Blob((0, 38, -28), (46, 32, 24), 34.0),
        Blob((0, 20, -26), (12, 14, 26), 33.0),
        Blob((0, 30, -28), (5 * wide, 5, 8), CSF),
        Blob((0, 2, -22), (14, 10, 5), CSF),
    ]
    if rng.random() < 0.4:
        blobs += _both(Blob((22, 34, 12), (2.5, 3.5, 2.5), rng.uniform(80, 300)))
    if rng.random() < 0.5:
        blobs.append(Blob((rng.normal(0, 1), 20, 6), (2, 2.5, 2), rng.uniform(80, 300)))
    if rng.random() < 0.45:
        side, radius = rng.choice([-1.0, 1.0]), rng.uniform(5, 22)
        centre = (side * rng.uniform(20, 42), rng.uniform(-45, 45), rng.uniform(-5, 45))
        blobs.append(Blob(centre, (1.5 * radius, 1.4 * radius, 1.3 * radius), rng.uniform(14, 26), 0.5))
        blobs.append(Blob(centre, (radius, 0.8 * radius, 0.8 * radius), rng.choice([18.0, 60.0, 72.0]), 0.5))
    return tuple(blobs)


# ---------------------------------------------------------------- one slice


def _draw_slice(head: _Head, plane: Plane, texture: Canvas, folds: Canvas) -> Canvas:
    canvas = np.full(plane.x.shape, AIR, np.float32)
    depth = plane.distance(head.skull)  # 0 on the outer table, negative inwards
    skin = depth - np.float32(head.scalp_mm + 0.8 * texture.mean())
    for blob in head.soft:
        skin = _smooth_min(skin, plane.distance(blob) - np.float32(head.scalp_mm * 0.5), 8.0)
    ears = [Blob((s * (head.skull.radii[0] + 9), 14, -42), (2.2, 11, 17), MUSCLE, -0.35 * s) for s in (-1, 1)]
    for ear in ears:
        skin = np.minimum(skin, plane.distance(ear))
    _draw_soft_tissue(canvas, skin, texture)
    inner = np.float32(head.skull_mm) * (1 + 0.12 * texture)
    _draw_skull(canvas, depth, inner, plane)
    paint_all(canvas, plane, head.face)
    paint_all(canvas, plane, head.teeth)
    _draw_mastoid(canvas, plane, texture)
    _draw_brain(canvas, depth + inner, plane, head, folds)
    blend(canvas, np.clip(skin / np.float32(0.8), 0.0, 1.0), AIR)  # nothing sticks out of the skin
    return canvas


def _smooth_min(a: Canvas, b: Canvas, width_mm: float) -> Canvas:
    """The union of two distance fields with a fillet of ``width_mm``."""
    h = np.clip(0.5 + 0.5 * (b - a) / np.float32(width_mm), 0.0, 1.0)
    return b + (a - b) * h - np.float32(width_mm) * h * (1.0 - h)


def _draw_soft_tissue(canvas: Canvas, skin: Canvas, texture: Canvas) -> None:
    blend(canvas, np.clip(0.5 - skin / np.float32(0.8), 0, 1), 20.0)
    blend(canvas, np.clip((-skin - 1.8) / 0.8, 0, 1), FAT)
    muscle = np.clip((-skin - 4.5 - 1.5 * texture) / 1.5, 0, 1) * np.clip(1.2 + texture, 0.0, 1.0)
    blend(canvas, muscle, MUSCLE + 6 * texture)


def _draw_skull(canvas: Canvas, depth: Canvas, thick: Canvas, plane: Plane) -> None:
    """Two tables of hard bone with marrow between; open below the skull base."""
    relative = np.clip(-depth / thick, 0.0, 1.0)
    profile = MARROW + (CORTEX - MARROW) * np.abs(2 * relative - 1.0) ** 1.5
    above = np.clip((plane.z + 58.0 + 0.35 * plane.y) / 4.0, 0.0, 1.0)  # the base rises towards the face
    bone = np.clip(0.5 - depth, 0, 1) * np.clip(0.5 + depth + thick, 0, 1) * above
    blend(canvas, bone, profile)


def _draw_mastoid(canvas: Canvas, plane: Plane, texture: Canvas) -> None:
    for side in (-1.0, 1.0):
        cell = plane.distance(Blob((side * 56, 22, -50), (10, 18, 16), 0.0))
        spots = np.clip((np.sin(plane.x * 1.3) * np.sin(plane.y * 1.1 + plane.z) + 0.3 * texture - 0.1) * 4, 0, 1)
        blend(canvas, np.clip(-cell, 0, 1), 600.0)
        blend(canvas, np.clip(-cell, 0, 1) * spots, -850.0)


def _draw_brain(canvas: Canvas, inside: Canvas, plane: Plane, head: _Head, folds: Canvas) -> None:
    """Brain within the inner table (``inside`` < 0): fluid rim, folded grey rim, white core, then the blobs."""
    floor = np.clip((plane.z + 52.0 + 0.45 * plane.y) / 3.0, 0.0, 1.0)
    room = np.clip(0.5 - inside, 0.0, 1.0) * floor
    if not room.any():
        return
    tissue = np.full(canvas.shape, WHITE, np.float32)
    cortex = np.clip((inside + 9.0 + 7.0 * folds) / 2.0, 0.0, 1.0)
    blend(tissue, cortex, GREY)
    paint_all(tissue, plane, head.brain)
    groove = np.abs(folds + 0.25 * np.sin(0.22 * plane.x + 3 * folds))
    near_rim = np.clip(1.0 + (inside + 4.0) / 20.0, 0.0, 1.0)
    sulcus = np.clip(1.0 - groove / np.float32(0.2 * head.sulci), 0.0, 1.0) * near_rim
    blend(tissue, sulcus * np.float32(min(1.0, 0.5 + 0.4 * head.sulci)), CSF)
    blend(tissue, np.clip((inside + 0.8 + 1.6 * head.sulci) / 1.0, 0.0, 1.0), CSF)
    midline = np.clip(1.6 - np.abs(plane.x + 1.5 * folds), 0.0, 1.0) * np.clip(
        (np.hypot(plane.y, plane.z) - 32) / 6, 0, 1
    )
    midline *= np.clip((plane.z + 10.0) / 5.0, 0.0, 1.0)
    blend(tissue, midline * 0.7, CSF)
    blend(tissue, midline * np.clip(1.0 - np.abs(plane.x) * 1.4, 0.0, 1.0), 58.0)
    blend(canvas, room, tissue)


def _draw_table(
    canvas: Canvas, rows: Float[np.ndarray, " r"], cols: Float[np.ndarray, " c"], table: tuple[float, float, float]
) -> None:
    """The head rest: a curved shell below the head with foam in it."""
    lowest, radius, thick = table
    x, y = np.meshgrid(cols.astype(np.float32), rows.astype(np.float32))
    depth = np.hypot(x, y - np.float32(lowest - radius)) - np.float32(radius)
    rest = (np.abs(x) < 0.35 * radius + 40) & (y > lowest - radius)
    shell = (np.clip(thick / 2 + 0.5 - np.abs(depth), 0, 1) + np.clip(thick / 2 + 0.5 - np.abs(depth - 9), 0, 1)) * rest
    foam = ((depth > 0) & (depth < 9) & rest).astype(np.float32)
    free = (canvas < -600).astype(np.float32)
    blend(canvas, foam * free, -880.0)
    blend(canvas, np.clip(shell, 0, 1) * free, 60.0)


__all__ = ["body_phantom", "head_phantom"]
