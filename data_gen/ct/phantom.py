"""A head without a patient: procedural CT volumes, different for every random state, good enough to train on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.ct.phantom_body import body_phantom
from data_gen.ct.phantom_brain import Brain, draw_brain, random_brain
from data_gen.ct.phantom_head import AIR, CORTEX, FAT, cavities, face_bones, soft_parts, teeth
from data_gen.ct.phantom_skull import (
    Noises,
    Skull,
    base_clearance,
    draw_ethmoid,
    draw_skull,
    draw_temporal_bones,
    skull_distance,
    skull_thickness,
)  # fmt: skip
from data_gen.ct.scanner import Rest, Scanner, draw_rest, scan, streaks
from data_gen.ct.shapes import (
    Blob,
    Canvas,
    Plane,
    Solid,
    Triple,
    blend,
    both,
    paint_all,
    ramp,
    random_warp,
    smooth_min,
    smooth_noise,
)  # fmt: skip
from data_gen.ct.volumes import CtVolume
from hybrid.coords import centres_1d


@dataclass(frozen=True, eq=False)
class _Head:
    """One head: everything that does not depend on the slice.

    scalp_mm: its thickness. outline: solids whose union with the skull is the skin. metal: tooth fillings.
    """

    skull: Skull
    brain: Brain
    scalp_mm: float
    outline: tuple[Solid, ...]
    ears: tuple[Solid, ...]
    soft: tuple[Solid, ...]
    bones: tuple[Solid, ...]
    cavities: tuple[Solid, ...]
    teeth: tuple[Solid, ...]
    metal: tuple[Triple, ...]


def head_phantom(rng: np.random.Generator, size: int = 256, slices: int = 40) -> CtVolume:
    """A made-up head from chin to crown in ``slices`` slices of ``size`` x ``size`` pixels."""
    head = _random_head(rng)
    field_mm = rng.uniform(205.0, 260.0)
    warp = random_warp(rng, rng.uniform(0.5, 2.5), rng.uniform(120.0, 220.0), 0.05)
    low, high = rng.uniform(-124.0, -62.0), rng.uniform(70.0, 90.0)
    heights = np.linspace(low, high, slices)
    axis = (centres_1d(size) / size - rng.uniform(0.49, 0.51)) * field_mm
    shape = (slices, size, size)
    fields = [smooth_noise(rng, shape, (max(2, int(slices * share)), n, n))
              for share, n in ((0.4, 20), (0.5, 30), (1.0, 80))]  # fmt: skip
    scanner = Scanner(rng.uniform(1.5, 5.0), rng.uniform(0.5, 0.85) * size / 256, rng.uniform(0.1, 0.7),
                      rng.uniform(0.0, 6.0), rng.uniform(0.0, 14.0))  # fmt: skip
    rest = _random_rest(rng, head)
    out = np.empty(shape, np.int16)
    for k, z_mm in enumerate(heights):
        noises = Noises(*(field[k] for field in fields))
        plane = warp.plane(axis, axis, float(z_mm), noises.broad)
        canvas = _draw_slice(head, plane, noises)
        for x, y, z in head.metal:
            if abs(z - z_mm) < 6.0:
                canvas += streaks(plane.x - np.float32(x), plane.y - np.float32(y), rng, rng.uniform(100, 500))
        draw_rest(canvas, axis, axis, rest)
        out[k] = scan(canvas, rng, scanner)
    spacing = (float(heights[1] - heights[0]) if slices > 1 else 5.0, field_mm / size, field_mm / size)
    return CtVolume(out, spacing, "phantom_head")


# ---------------------------------------------------------------- one head


def _random_head(rng: np.random.Generator) -> _Head:
    wide, long, tall = 70 * rng.normal(1, 0.04), 88 * rng.normal(1, 0.04), 84 * rng.normal(1, 0.03)
    jaw, fat = rng.normal(1, 0.05), rng.uniform(0.0, 6.0)
    nose = rng.uniform(-4, 5)
    outline = (
        Blob((0, -36, -58), (57 * jaw + fat, 54, 66), 0.0),
        Blob((0, -58, -96), (40 * jaw + fat, 34, 26), 0.0),
        Blob((0, 22, -104), (54 * jaw + fat, 52 + fat, 70), 0.0),
        Blob((0, -94 - nose, -50), (11, 15, 20), 0.0),
        Blob((0, -90 - nose, -61), (16, 14, 9), 0.0),
    )
    ears = both(
        Blob((wide + 8, 12, -42), (2.0, 12, 24), 30.0, -0.45),
        Blob((wide + 4, 4, -48), (5, 4, 8), 30.0, -0.3),
        Blob((wide + 11, 17, -38), (3.0, 6, 20), 30.0, -0.5),
    )
    bite = teeth(rng)
    count = int(rng.choice([0, 0, 1, 2, 4])) if bite else 0
    metal = tuple(bite[i].start for i in rng.integers(0, max(len(bite), 1), count))
    skull = Skull((wide, long, tall), rng.uniform(0.05, 0.13), rng.uniform(4.5, 8.0), CORTEX + rng.uniform(-150, 250))
    return _Head(
        skull=skull, brain=random_brain(rng), scalp_mm=rng.uniform(3.5, 8.0), outline=outline, ears=tuple(ears),
        soft=soft_parts(rng), bones=face_bones(rng), cavities=cavities(rng, long), teeth=bite, metal=metal,
    )  # fmt: skip


def _random_rest(rng: np.random.Generator, head: _Head) -> Rest:
    """A head rest, in most cases a cradle, its shell thin or filled with foam."""
    kind = str(rng.choice(["cradle", "flat", "sides", "none"], p=[0.6, 0.15, 0.1, 0.15]))
    radius = rng.uniform(105, 260)
    half = head.skull.radii[0] + rng.uniform(14, 24) if kind == "sides" else min(rng.uniform(60, 130), 0.95 * radius)
    lowest = head.skull.radii[1] + head.scalp_mm + rng.uniform(2, 16)
    return Rest(kind, lowest, radius, half, rng.uniform(1.2, 3.0), rng.uniform(5, 22), rng.uniform(-960, -860))


# ---------------------------------------------------------------- one slice


def _draw_slice(head: _Head, plane: Plane, noises: Noises) -> Canvas:
    canvas = np.full(plane.x.shape, AIR, np.float32)
    depth = skull_distance(head.skull, plane)  # 0 on the outer table, negative inwards
    skin = _skin_distance(head, plane, depth)
    _draw_soft_tissue(canvas, skin, plane, head, noises)
    thick = skull_thickness(head.skull, plane, noises)
    floor = base_clearance(plane, noises)
    draw_skull(canvas, (depth, thick, floor), head.skull, noises)
    paint_all(canvas, plane, head.bones)
    draw_temporal_bones(canvas, plane, noises, depth)
    draw_ethmoid(canvas, plane, noises)
    paint_all(canvas, plane, head.cavities)
    paint_all(canvas, plane, head.teeth)
    draw_brain(canvas, (depth + thick, floor), plane, head.brain, noises)
    blend(canvas, ramp(skin, 0.8), AIR)  # nothing sticks out of the skin
    return canvas


def _skin_distance(head: _Head, plane: Plane, depth: Canvas) -> Canvas:
    skin = depth - np.float32(head.scalp_mm)
    for solid in head.outline:
        if plane.window(solid, 12.0) is not None:
            skin = smooth_min(skin, plane.distance(solid) + 0.5 * plane.rough, 9.0)
    for ear in head.ears:
        window = plane.window(ear)
        if window is not None:
            near = ear.distance(plane.x[window], plane.y[window], plane.z[window]) + 0.8 * plane.rough[window]
            np.minimum(skin[window], near, out=skin[window])
    return skin


def _draw_soft_tissue(canvas: Canvas, skin: Canvas, plane: Plane, head: _Head, noises: Noises) -> None:
    """Skin, fat and muscles; a thin sheet of muscle under the fat of the scalp."""
    blend(canvas, ramp(0.5 - skin / np.float32(0.8)), 25.0)
    blend(canvas, ramp(-skin - 1.8, 0.8), FAT + 8 * plane.rough)
    if plane.z_mm < 15:
        deep = ramp(-skin - 9.0 - 2.5 * plane.rough, 4.0) * ramp(0.9 + plane.rough + noises.folds, 0.8)
        blend(canvas, deep, 38.0 + 6 * plane.rough)  # between the muscles: glands, mucosa, small muscles
        paint_all(canvas, plane, head.soft)
    blend(canvas, ramp(-skin - np.float32(0.75 * head.scalp_mm)) * ramp(plane.z + 60, 20) * 0.7, 45.0)


__all__ = ["body_phantom", "head_phantom"]
