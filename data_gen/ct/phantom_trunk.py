"""The parts of a made-up trunk: solids of bones, vessels and organs, in painting order.

Millimetres: x to the patient's left, y backwards, z up; the origin lies in the middle, at the height of the diaphragm.
Positions are those of a trunk of half width 165 and half depth 110; a Frame fits them to another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from data_gen.ct.shapes import Blob, Solid, Triple, Tube, both, chain

AIR, FAT, MUSCLE, LUNG, MARROW, CORTEX = -1000.0, -100.0, 52.0, -860.0, 230.0, 900.0
RIB_PITCH_MM = 25.0


@dataclass(frozen=True)
class Frame:
    """How much wider and deeper a trunk is than the standard one. blood_hu: of vessels, bright after contrast."""

    across: float
    down: float
    blood_hu: float

    def place(self, point: Triple) -> Triple:
        """A point of the standard trunk in this one."""
        return point[0] * self.across, point[1] * self.down, point[2]

    def fit(self, solid: Solid) -> Solid:
        """A solid of the standard trunk in this one; tubes keep their thickness."""
        if isinstance(solid, Tube):
            return replace(solid, start=self.place(solid.start), end=self.place(solid.end))
        rx, ry, rz = solid.radii
        return replace(solid, centre=self.place(solid.centre), radii=(rx * self.across, ry * self.down, rz))


def ribs(rng: np.random.Generator, inner_mm: tuple[float, float], back_mm: float) -> list[Solid]:
    """Twelve pairs that slope down to the front, cartilage, breast bone; ``inner_mm``: half axes of the chest.

    back_mm: y of the joints with the spine.
    """
    a, b = inner_mm[0] + 3.5, inner_mm[1] + 3.5
    slope, parts = rng.uniform(0.8, 1.3), []
    for k in range(12):
        top, last = 168.0 - RIB_PITCH_MM * k + rng.normal(0, 1.5), (2.45 if k < 7 else 2.3 - 0.27 * (k - 6))
        fall = slope * (30.0 + 6.5 * k)
        small = min(1.0, 0.5 + 0.2 * k)  # the upper ribs form a dome
        turns = np.linspace(0.3, last, 12)
        line = [
            (small * a * np.sin(t) ** 0.85, max(-b, min(b * np.cos(t), back_mm + 4)) * (0.7 + 0.3 * small),
             top - fall * (t - 0.3) / (last - 0.3))
            for t in turns
        ]  # fmt: skip
        parts += both(
            *chain(line, [float(rng.uniform(2.2, 2.9))] * 11, MARROW, shell_hu=CORTEX, shell_mm=1.3, flat=2.2)
        )
        if k < 10:
            end = line[-1]
            breast = (9.0, -b, max(end[2] + 5.0 * max(k - 4, 0), 40.0))
            parts += both(Tube(end, breast, 4.0, float(rng.uniform(70, 180)), 120.0, 0.8, flat=1.5))
    parts.append(Blob((0, -b - 2, 78), (16, 4.0, 62), MARROW, 0.0, CORTEX, 1.2, 0.8))
    return parts


def spine(rng: np.random.Generator, back_mm: float) -> list[Solid]:
    """Vertebrae with arches and processes, discs between; ``back_mm``: y of the bodies' middle."""
    y, parts = back_mm, []
    for z in np.arange(-300.0, 280.0, 27.0):
        size = 1.0 - 0.0012 * (z + 50)
        parts += [
            Blob((0, y, z), (20 * size, 15.5 * size, 11.5), MARROW, 0.0, 620.0, 1.5, 0.7),
            Blob((0, y, z + 13.5), (19 * size, 14.5 * size, 3.0), 85.0),
            Tube((0, y + 30, z - 4), (0, y + 45, z - 14), 2.4, 300.0, 700.0, 1.0, flat=2.5),
            *both(
                Tube((12, y + 10, z + 1), (13, y + 22, z), 3.2, 300.0, 700.0, 1.2, flat=1.5),
                Tube((13, y + 22, z), (1, y + 32, z - 3), 2.0, 300.0, 750.0, 1.2, flat=3.0),
                Tube((14, y + 21, z), (36 * size, y + float(rng.uniform(20, 27)), z), 2.4, 300.0, 650.0, 1.2, flat=1.3),
                Blob((14, y + 23, z - 12), (4.5, 4, 6), 500.0, 0.3, 800.0, 0.8),
            ),
        ]
    canal = Tube((0, y + 21, -320), (0, y + 21, 300), 7.5, 22.0)
    return [canal, *parts]


def shoulders(wide_mm: float) -> list[Solid]:
    """Shoulder blades, collar bones and heads of the upper arms."""
    bone = {"shell_hu": CORTEX, "shell_mm": 1.3}
    return both(
        Tube((55, 84, 110), (wide_mm - 42, 62, 130), 1.6, 300.0, flat=20.0, **bone),
        Tube((wide_mm - 42, 62, 165), (wide_mm - 8, 22, 172), 3.5, 300.0, flat=3.0, **bone),
        Tube((14, -66, 152), (wide_mm * 0.45, -58, 168), 4.5, 300.0, **bone),
        Tube((wide_mm * 0.45, -58, 168), (wide_mm - 10, -14, 184), 4.5, 300.0, **bone),
        Blob((wide_mm + 8, 2, 178), (21, 21, 24), 250.0, 0.0, CORTEX, 1.5, 0.8),
    )


def airways_and_vessels(rng: np.random.Generator, frame: Frame) -> list[Solid]:
    """Branching vessels of the lungs, from the roots outwards."""
    tubes: list[Solid] = []
    for side in (-1.0, 1.0):
        root = np.array([side * 30.0 * frame.across, 6.0 * frame.down, 62.0])
        tips = [(root, rng.normal(0, 1, 3) * (0.7, 1.0, 1.3) + (side * 0.9, 0, 0), 4.6) for _ in range(10)]
        for length in (30.0, 27.0, 24.0):
            grown = []
            for start, heading, radius in tips:
                heading = heading / (np.linalg.norm(heading) + 1e-6)
                end = start + heading * length * rng.uniform(0.7, 1.2)
                tubes += chain([tuple(start.tolist()), tuple(end.tolist())], [radius], 42.0)
                for _ in range(2):
                    grown.append((end, heading + rng.normal(0, 0.55, 3), radius * rng.uniform(0.5, 0.72)))
            tips = grown
    return tubes


def chest_parts(rng: np.random.Generator, frame: Frame) -> list[Solid]:
    """Heart, great vessels, windpipe, gullet."""
    hu, big = frame.blood_hu, rng.uniform(0.85, 1.2)
    muscle = 48.0 + 0.25 * max(hu - 50.0, 0.0)
    calcified = [Tube((18, 20, 90), (20, 30, 60), 1.4, 600.0, rough_mm=0.8)] if rng.random() < 0.4 else []
    parts: list[Solid] = [
        Blob((14, -24, 36), (50 * big, 44, 52), -70.0, 0.5, rough_mm=1.5),  # fat around the heart
        Blob((26, -20, 22), (38 * big, 30, 38), muscle, 0.5),
        Blob((29, -18, 22), (23 * big, 17, 28), hu, 0.5, rough_mm=0.8),
        Blob((-6, -36, 24), (27 * big, 22, 32), 0.9 * hu, 0.4, rough_mm=1.5),
        Blob((-30, -16, 30), (21 * big, 24, 28), 0.85 * hu, 0.2, rough_mm=1.5),
        Blob((4, 14, 40), (32 * big, 16, 18), hu, 0.0, rough_mm=1.5),
        Tube((2, -24, 50), (-12, -32, 96), 15.0, hu, 45.0, 1.2),
        Tube((14, -36, 44), (10, -30, 76), 13.0, hu, 45.0, 1.0),
        Tube((10, -28, 78), (-34, -2, 70), 10.5, hu),
        Tube((10, -28, 80), (34, 8, 74), 10.5, hu),
        Tube((-12, -32, 98), (16, 20, 104), 13.0, hu, 50.0, 1.2),
        Tube((17, 24, 104), (15, 36, -20), 11.5, hu, 50.0, 1.2),
        *calcified,
        Tube((-26, -26, 120), (-26, -18, 50), 8.5, 1.15 * hu),
        *both(Tube((26, -40, 128), (6, -38, 116), 5.5, hu), Tube((16, -8, 108), (20, -4, 190), 4.5, hu)),
        Tube((0, 6, 82), (0, -4, 240), 8.5, AIR, 60.0, 1.4, flat=1.0),
        *both(
            Tube((0, 8, 80), (30, 14, 56), 6.2, AIR, 55.0, 1.2), Tube((30, 14, 56), (44, 20, 30), 3.4, AIR, 55.0, 1.0)
        ),
        Tube((3, 26, 220), (6, 30, 5), 6.0, 40.0, rough_mm=1.0),
        Blob((6, 29, float(rng.uniform(40, 140))), (2, 2, 14), -600.0),
        *both(Blob((17, -2, 158), (11, 12, 18), 95.0, 0.3, rough_mm=1.5)),
    ]
    for _ in range(int(rng.integers(2, 9))):
        node = (float(rng.normal(0, 18)), float(rng.normal(2, 12)), float(rng.uniform(40, 120)))
        parts.append(Blob(node, (rng.uniform(2, 6), rng.uniform(2, 5), 6), 45.0, rough_mm=0.8))
    return [frame.fit(part) for part in parts]


def belly_parts(rng: np.random.Generator, frame: Frame) -> list[Solid]:
    """Spleen, stomach, kidneys, pancreas, great vessels, gut; the liver, which fills its room, is drawn elsewhere."""
    hu = frame.blood_hu
    organ, rind = 50.0 + 0.28 * max(hu - 50, 0.0), 38.0 + 0.75 * max(hu - 45.0, 0.0)
    parts: list[Solid] = [
        Blob((88, 34, -34), (26, 42, 44), organ + 6, 0.35, rough_mm=1.5),
        Blob(
            (50, -24, -30),
            (40, 38, 36),
            float(rng.choice([20.0, 35.0, 150.0], p=[0.6, 0.25, 0.15])),
            0.5,
            55.0,
            3.0,
            2.0,
        ),
        Blob((52, -46, -28), (rng.uniform(18, 32), rng.uniform(8, 16), 24), AIR, 0.2, rough_mm=0.8),
        Tube((-24, -12, -88), (10, -16, -74), 9.0, organ - 8, rough_mm=2.5),
        Tube((10, -16, -74), (64, 12, -52), 8.0, organ - 8, rough_mm=2.5),
        *both(
            Blob((57, 42, -92), (26, 32, 56), rind, -0.5, rough_mm=1.0),
            Blob((55, 41, -92), (15, 20, 42), 0.75 * rind + 6, -0.5, rough_mm=3.0),
            Blob((48, 36, -92), (9, 14, 24), FAT, -0.5, rough_mm=1.5),
            Blob((48, 36, -94), (4, 6, 12), 8.0, -0.5, rough_mm=0.8),
            Blob((34, 34, -46), (11, 2.5, 12), 30.0, 0.9),
            Tube((32, 48, -120), (48, 40, -230), 14.0, MUSCLE, flat=1.6),  # psoas
            Tube((14, 30, -40), (46, 36, -88), 3.2, hu),
        ),
        Tube((12, 26, -10), (8, 24, -200), 9.5, hu, 55.0, 1.2),
        Tube((-18, 24, 10), (-16, 24, -200), 10.5, 0.55 * (hu + 45), flat=1.0),
        Tube((6, 14, -70), (4, -6, -160), 3.6, hu),
        Tube((-10, -6, -100), (-34, 4, -50), 6.0, 0.9 * hu),
        Blob((-42, -44, -62), (12, 20, 17), 8.0, 0.5, 40.0, 1.2),
    ]
    if rng.random() < 0.5:
        parts.append(Tube((15, 20, -60), (14, 19, -180), 1.5, 650.0, rough_mm=1.2))
    return [frame.fit(part) for part in (*_gut(rng), *parts)]


def _gut(rng: np.random.Generator) -> list[Solid]:
    """Loops of small and large bowel with gas, fluid and stool."""
    loops: list[Solid] = []
    inside = float(rng.choice([15.0, 220.0], p=[0.75, 0.25]))
    for _ in range(48):
        centre = (float(rng.uniform(-75, 85)), float(rng.uniform(-72, 22)), float(rng.uniform(-220, -62)))
        radii = (float(rng.uniform(11, 24)), float(rng.uniform(8, 14)), float(rng.uniform(9, 22)))
        loops.append(Blob(centre, radii, inside, float(rng.uniform(-1, 1)), 60.0, 2.0, 2.0))
        if rng.random() < 0.3:
            x, y, z = centre
            loops.append(
                Blob((x, y - 0.4 * radii[1], z), (0.7 * radii[0], 0.5 * radii[1], 0.6 * radii[2]), AIR, rough_mm=1.0)
            )
    for x, y, low, high in ((-104, 8, -230, -100), (108, 14, -230, -60)):
        for z in np.arange(low, high, 22.0):
            wide = float(rng.uniform(15, 24))
            loops.append(
                Blob((x, y, float(z)), (wide, wide, 14), float(rng.choice([-120.0, 20.0])), 0.0, 55.0, 2.0, 2.5)
            )
            loops.append(
                Blob((x, y - 6, float(z)), (0.7 * wide, 0.5 * wide, 10), float(rng.choice([AIR, -500.0])), rough_mm=2.5)
            )
    for x in np.arange(-80, 90, 20.0):
        loops.append(Blob((float(x), -66, -96), (15, 15, 16), -150.0, 0.0, 50.0, 1.8, 2.5))
        loops.append(Blob((float(x), -72, -96), (11, 8, 11), AIR, rough_mm=1.5))
    return loops


__all__ = [
    "AIR", "CORTEX", "FAT", "LUNG", "MARROW", "MUSCLE", "Frame", "airways_and_vessels", "belly_parts", "chest_parts",
    "ribs", "shoulders", "spine",
]  # fmt: skip
