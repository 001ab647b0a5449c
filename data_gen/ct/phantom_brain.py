"""The brain of a made-up head: folded rim, white core, deep parts, fluid, and what disease adds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.ct.phantom_head import CSF, GREY, WHITE, brain_parts, lesions
from data_gen.ct.phantom_skull import Noises
from data_gen.ct.shapes import Blob, Canvas, Plane, Solid, blend, bounds, paint_all, ramp


@dataclass(frozen=True, eq=False)
class Brain:
    """parts: ventricles, nuclei, vessels. sulci: width of the grooves, 0.25 young to 1.3 old.

    folds: number of grooves around. clot_mm, clot_hu: blood or fluid below the skull, on the left if positive.
    falx_hu, sinus_hu: of the fold between the halves, and of the vein in its root.
    """

    parts: tuple[Solid, ...]
    lesions: tuple[Blob, ...]
    sulci: float
    folds: float
    clot_mm: float
    clot_hu: float
    falx_hu: float
    sinus_hu: float


def random_brain(rng: np.random.Generator) -> Brain:
    clot = rng.uniform(4, 14) * rng.choice([-1, 1]) if rng.random() < 0.15 else 0.0
    sinus = float(rng.choice([rng.uniform(45, 65), rng.uniform(110, 200)], p=[0.7, 0.3]))
    return Brain(
        brain_parts(rng), lesions(rng), rng.uniform(0.25, 1.25), float(rng.integers(11, 16)), clot,
        float(rng.choice([18.0, 40.0, 66.0])), rng.uniform(45, 75), sinus,
    )  # fmt: skip


def draw_brain(canvas: Canvas, shape: tuple[Canvas, Canvas], plane: Plane, brain: Brain, noises: Noises) -> None:
    """Brain within the inner table, in place. shape: distance to it (negative inside), height over the base."""
    window = bounds((shape[0] < 0.5) & (shape[1] > 0.5))
    if window is None:
        return
    canvas, inside, floor = canvas[window], shape[0][window], shape[1][window]
    plane, noises = plane.cut(window), noises.cut(window)
    room = ramp(0.5 - inside) * ramp(floor - 0.5)
    tissue = np.full(canvas.shape, WHITE, np.float32)
    rim = np.maximum(inside, -0.6 * floor) + 1.0 + np.float32(1.2 * brain.sulci)  # negative inside the brain
    _draw_cortex(tissue, rim, plane, brain, noises)
    if plane.z_mm < 0:
        _draw_cerebellum(tissue, rim, plane, noises)
    paint_all(tissue, plane, brain.parts)
    paint_all(tissue, plane, brain.lesions)
    blend(tissue, ramp(rim + 0.5), CSF)
    _draw_falx(tissue, inside, plane, brain, noises)
    if brain.clot_mm:
        side = ramp(np.sign(brain.clot_mm) * plane.x - 12, 10) * ramp(plane.z + 10, 30)
        blend(tissue, ramp(inside + np.float32(abs(brain.clot_mm)) * side) * (side > 0), brain.clot_hu)
    blend(canvas, room, tissue)


def _draw_cortex(tissue: Canvas, rim: Canvas, plane: Plane, brain: Brain, noises: Noises) -> None:
    """A ribbon of grey matter along the surface and along the grooves that run in from it, with fluid in them."""
    angle = np.arctan2(plane.x, -plane.y)
    wave = np.float32(brain.folds) * angle + 1.5 * noises.broad + 0.05 * plane.z
    course = np.sin(wave) + 0.55 * np.sin(2.2 * wave + 2.0 + 1.2 * noises.folds)
    radius = np.sqrt(plane.x * plane.x + plane.y * plane.y) + 1.0
    groove = np.abs(course) * radius * np.float32(0.7 / brain.folds)  # about mm from the middle of a groove
    reach = ramp(rim + 15.0 + 6.0 * noises.folds, 7.0) * ramp(plane.z + 25 - 0.15 * plane.y, 20)
    ribbon = np.maximum(ramp(rim + 4.0 + 0.8 * noises.cells, 1.5), ramp(4.0 - groove, 1.5) * reach)
    blend(tissue, ribbon, GREY)
    open_mm = np.float32(1.5 * brain.sulci) * (0.7 + 0.5 * noises.broad)
    blend(tissue, ramp(open_mm - groove + 0.3) * reach * np.float32(min(1.0, 0.45 + 0.6 * brain.sulci)), CSF)


def _draw_cerebellum(tissue: Canvas, rim: Canvas, plane: Plane, noises: Noises) -> None:
    """Below the tent: leaves of grey, a rim of fluid."""
    body = Blob((0, 42, -46), (52, 37, 34), 0.0)
    distance = plane.distance(body) + noises.broad
    inside = ramp(0.5 - distance)
    leaves = np.sin(1.1 * np.hypot(plane.x, plane.y - 18) + 2.5 * noises.folds + 3.0 * noises.broad + 0.6 * plane.z)
    blend(tissue, inside, 34.0 + 1.8 * leaves * ramp(distance + 14, 10))
    tent = ramp(1.4 - np.abs(distance - 1.5)) * ramp(-rim) * ramp(plane.z + 45, 15)
    blend(tissue, tent * 0.8, 30.0 - 14.0 * ramp(noises.folds, 0.5))


def _draw_falx(tissue: Canvas, inside: Canvas, plane: Plane, brain: Brain, noises: Noises) -> None:
    """The cleft between the halves, the fold in it, and the vein in its root."""
    above = ramp(plane.z + 12.0 - 0.15 * plane.y, 6.0)
    off = np.abs(plane.x + 0.8 * noises.broad)
    deep = np.hypot(plane.y, 1.1 * (plane.z - 5))
    cleft = ramp(np.float32(0.7 + 1.1 * brain.sulci) + 0.5 * noises.folds - off) * ramp(deep - 36, 5) * above
    blend(tissue, cleft * 0.8, CSF)
    fold = ramp(1.3 - np.abs(plane.x)) * ramp(deep - np.float32(42), 6) * above
    blend(tissue, fold * 0.8, brain.falx_hu)
    vein = ramp(1.0 - np.abs(plane.x) / 5.0 - np.abs(inside + 3.0) / 4.5, 0.25)
    blend(tissue, vein * above * ramp(plane.y + 40, 30), brain.sinus_hu)


__all__ = ["Brain", "draw_brain", "random_brain"]
