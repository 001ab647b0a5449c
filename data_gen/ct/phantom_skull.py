"""The skull of a made-up head: an egg of two tables with marrow, a base in three steps, air cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.ct.phantom_head import AIR, MARROW
from data_gen.ct.shapes import Blob, Canvas, Plane, Window, blend, ramp


@dataclass(frozen=True)
class Skull:
    """radii: outer half axes, mm. egg: how much narrower the forehead is than the back of the head.

    thick_mm: of the vault. hard_hu: of its tables.
    """

    radii: tuple[float, float, float]
    egg: float
    thick_mm: float
    hard_hu: float


@dataclass(frozen=True, eq=False)
class Noises:
    """Textures of one slice, of about unit variance: over about 12 mm, 8 mm and 3 mm."""

    broad: Canvas
    folds: Canvas
    cells: Canvas

    def cut(self, window: Window) -> Noises:
        """The part in a window, as views."""
        return Noises(self.broad[window], self.folds[window], self.cells[window])


def skull_distance(skull: Skull, plane: Plane) -> Canvas:
    """Distance in mm to the outer table of an egg: narrow in front, blunt behind."""
    wide, long, tall = skull.radii
    along = plane.y / np.float32(long)
    narrow = 1.0 + np.float32(skull.egg) * np.tanh(1.6 * along + 0.15)
    blunt = np.float32(1.0 + 0.25 * skull.egg)
    x, y, z = plane.x / (np.float32(wide) * narrow), along * blunt, plane.z / np.float32(tall)
    level = np.sqrt(x * x + y * y + z * z)
    slope = np.sqrt((x / np.float32(wide)) ** 2 + (y / np.float32(long)) ** 2 + (z / np.float32(tall)) ** 2)
    return level * (level - 1.0) / np.maximum(slope, np.float32(1e-4)) + 0.5 * plane.rough


def skull_thickness(skull: Skull, plane: Plane, noises: Noises) -> Canvas:
    """In mm: thick behind and in front, thin at the temples, with a crest inside at the midline."""
    away = np.abs(plane.y) * np.float32(1 / skull.radii[1])
    crest = np.exp(-((plane.x / 9.0) ** 2)) * away
    return np.float32(skull.thick_mm) * (0.75 + 0.35 * away * away + 0.07 * noises.broad + 0.4 * crest)


def base_clearance(plane: Plane, noises: Noises) -> Canvas:
    """Height in mm over the skull base, which goes down in three steps from front to back, with ridges and bumps."""
    if plane.z_mm > 25:
        return plane.z
    across = np.abs(plane.x)
    wing, rock = plane.y + 24.0 + 0.5 * across, plane.y + 6.0 - 0.5 * across
    middle, behind = ramp(wing + 4.0, 8.0), ramp(rock + 5.0, 10.0)
    saddle = ramp(17.0 - across, 8.0) * (1.0 - behind) * middle
    base = -20.0 - 27.0 * middle - 30.0 * behind + 13.0 * saddle
    base += 8.0 * np.exp(-((wing / 3.0) ** 2)) * ramp(60 - across, 30)
    base += 19.0 * np.exp(-((rock / 5.5) ** 2)) * middle * ramp(across - 8, 6)
    base += 2.2 * noises.folds + 0.002 * across * across + 9.0 * ramp(plane.y - 50, 30)
    return plane.z - base


def draw_skull(canvas: Canvas, shape: tuple[Canvas, Canvas, Canvas], skull: Skull, noises: Noises) -> None:
    """Two tables of hard bone with marrow between, and the plate of the base. shape: depth, thickness, clearance."""
    depth, thick, floor = shape
    marrow = ramp(np.minimum(-depth, depth + thick) - 1.6, 1.2) * (0.85 + 0.25 * noises.cells)
    bone = ramp(0.5 - depth) * ramp(0.5 + depth + thick) * ramp(floor + 6.0, 5.0)
    hard = np.float32(skull.hard_hu)
    blend(canvas, bone, hard + marrow * (np.float32(MARROW) - hard))
    if floor.min() < 0.5:
        plate = ramp(0.5 - depth) * ramp(0.5 - floor) * ramp(floor + 4.5 + 1.5 * noises.broad)
        blend(canvas, plate, hard * np.float32(0.75) + 150 * noises.cells)


def draw_temporal_bones(canvas: Canvas, plane: Plane, noises: Noises, depth: Canvas) -> None:
    """Petrous bones with the inner ear in them, mastoids full of cells, ear canals."""
    for side in (-1.0, 1.0):
        rock = Blob((side * 32, 9, -46), (25, 8.5, 9), 0.0, side * 0.5)
        window = plane.window(rock)
        if window is not None:
            part = plane.cut(window)
            dense = ramp(0.5 - part.distance(rock) - 1.3 * part.rough)
            blend(canvas[window], dense, 1150 + 260 * noises.cells[window])
            for x_mm, y_mm, hu in ((34, 6, 100.0), (26, 8, 150.0), (40, 11, 100.0)):
                ear = Blob((side * x_mm, y_mm, -46), (3.4, 1.6, 4), 0.0, side * 0.9)
                blend(canvas[window], ramp(0.5 - part.distance(ear)), hu)
        mastoid = Blob((side * 54, 24, -50), (13, 17, 17), 0.0)
        window = plane.window(mastoid)
        if window is not None:
            part = plane.cut(window)
            inside = ramp(-1.2 * part.rough - part.distance(mastoid)) * ramp(-depth[window])
            cells = ramp(np.abs(noises.cells[window]) - 0.35, 0.25) * ramp(-depth[window] - 2.5)
            blend(canvas[window], inside, 850.0 - 1750.0 * cells)
            canal = Blob((side * 58, 2, -47), (14, 3.0, 3.2), 0.0, side * 0.12)
            blend(canvas[window], ramp(0.5 - part.distance(canal)), AIR)


def draw_ethmoid(canvas: Canvas, plane: Plane, noises: Noises) -> None:
    """Cells of air with thin walls between the orbits."""
    block = Blob((0, -60, -36), (14, 27, 13), 0.0)
    window = plane.window(block)
    if window is not None:
        part = plane.cut(window)
        inside = ramp(0.5 - part.distance(block) - part.rough)
        walls = ramp(0.42 - np.minimum(np.abs(noises.cells[window]), 0.12 * np.abs(part.x)), 0.3)
        blend(canvas[window], inside, AIR + 1350.0 * walls)


__all__ = [
    "Noises", "Skull", "base_clearance", "draw_ethmoid", "draw_skull", "draw_temporal_bones", "skull_distance",
    "skull_thickness",
]  # fmt: skip
