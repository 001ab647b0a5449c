"""The parts of a made-up head: solids of face, skull base, neck and brain, in painting order.

Millimetres: x to the patient's left, y backwards, z up; the origin lies in the middle of the brain.
"""

from __future__ import annotations

import numpy as np

from data_gen.ct.shapes import Blob, Solid, Tube, both, chain

AIR, FAT, MUSCLE, CSF, WHITE, GREY, MARROW, CORTEX = -1000.0, -95.0, 55.0, 8.0, 28.0, 38.0, 480.0, 1350.0
BLOOD = 45.0


def soft_parts(rng: np.random.Generator) -> tuple[Solid, ...]:
    """Muscles and glands of face and neck, to be painted onto fat."""
    m = float(MUSCLE + rng.normal(0, 4))
    big = rng.uniform(0.85, 1.2)
    return (
        *both(
            Blob((54, -34, -72), (6 * big, 15, 24), m, 0.25, rough_mm=1.0),  # chewing muscles
            Blob((63, -18, -18), (4 * big, 24, 34), m, 0.1, rough_mm=0.8),
            Blob((34, -26, -70), (7 * big, 15, 20), m, -0.35, rough_mm=1.2),
            Blob((54, -4, -82), (10, 13, 20), 5.0, 0.2, rough_mm=2.0),  # parotid glands
            Blob((30, -46, -118), (10, 13, 9), 38.0, 0.3, rough_mm=1.5),
            Blob((48, 20, -112), (9 * big, 17, 34), m, 0.5, rough_mm=1.0),  # neck
            Blob((30, 52, -100), (20 * big, 10, 40), m, -0.35, rough_mm=1.0),
            Blob((17, 60, -98), (13 * big, 13, 42), m, 0.15, rough_mm=1.0),
            Blob((19, 44, -104), (13 * big, 9, 36), m, 0.0, rough_mm=1.0),
            Blob((40, 38, -106), (10, 9, 34), m, 0.6, rough_mm=1.2),
            Blob((15, 6, -108), (9, 7, 40), m, 0.3, rough_mm=0.8),
            Tube((31, -2, -125), (26, 2, -60), 3.6, BLOOD),  # vessels
            Tube((36, 5, -125), (29, 8, -60), 5.0, BLOOD),
            Blob((13, -92, -72), (11, 5, 10), m, -0.3, rough_mm=1.0),
            Blob((44, -70, -70), (3, 15, 6), m, 0.6, rough_mm=1.0),
        ),
        Blob((0, -46, -102), (22 * big, 27, 16), m, rough_mm=1.5),  # tongue and floor of the mouth
        Blob((0, -86, -84), (19, 5, 6), m, rough_mm=0.6),
        Blob((0, -14, -112), (17, 9, 30), m, rough_mm=1.0),
    )


def face_bones(rng: np.random.Generator) -> tuple[Solid, ...]:
    """Jaws, cheek bones, palate, spine."""
    return (*_jaws(rng), *_cheeks(), *_spine(rng))


def _jaws(rng: np.random.Generator) -> list[Solid]:
    long = rng.uniform(0.93, 1.07)
    turns = np.linspace(0.0, 1.32, 7)
    arch = [(40 * np.sin(t) ** 0.9, -38 - 48 * long * np.cos(t), -110 + 4.6 * t * t) for t in turns]
    wall = {"shell_hu": CORTEX, "shell_mm": 1.8, "flat": 1.7}
    body = chain(arch, [4.0] * 6, MARROW, **wall)
    back = arch[-1]
    branch = chain(
        [back, (47, -24, -88), (49, -18, -68), (50, -14, -57)], [3.2, 2.4, 2.4], MARROW,
        shell_hu=CORTEX, shell_mm=1.4,
    )  # fmt: skip
    crown = chain([(47, -26, -84), (46, -36, -62)], [1.6], 900.0)
    upper = [(29 * np.sin(t), -46 - 38 * long * np.cos(t), -84.0) for t in np.linspace(0.0, 1.45, 6)]
    ridge = chain(upper, [3.6] * 5, MARROW, shell_hu=950.0, shell_mm=1.2, flat=1.8)
    palate = Blob((0, -58, -75), (26, 24, 2.2), 750.0, rough_mm=0.5)
    hyoid = chain([(0, -42, -124), (14, -34, -123), (21, -22, -120)], [1.8, 1.3], 500.0)
    return [*both(*body, *branch, *crown, *ridge, *hyoid), palate]


def _cheeks() -> list[Solid]:
    arch = [(44, -66, -52), (56, -52, -51), (62, -36, -50), (62, -22, -49), (58, -10, -48)]
    rim = [
        (20, -84, -22),
        (36, -82, -16),
        (47, -74, -22),
        (50, -68, -34),
        (44, -74, -46),
        (28, -80, -49),
        (17, -82, -40),
    ]
    return both(
        *chain(arch, [3.6, 2.0, 1.7, 2.2], 500.0, shell_hu=CORTEX, shell_mm=0.9),
        *chain(rim, [2.2, 2.2, 2.6, 2.6, 2.4, 1.8], 900.0),
        *chain([(49, -64, -30), (50, -52, -26), (54, -40, -18)], [1.6, 1.8], 1000.0),
        Blob((47, -66, -53), (10, 5, 7), 800.0, 0.7, rough_mm=1.0),
        Tube((6, -88, -36), (5, -98, -46), 1.5, 800.0),
        Tube((17, -28, -60), (20, -24, -80), 1.3, 800.0),  # pterygoid plates
        Tube((20, -28, -60), (27, -20, -78), 1.2, 800.0),
    )


def _spine(rng: np.random.Generator) -> list[Solid]:
    parts: list[Solid] = []
    dens = Blob((0, 8, -88), (5.0, 5.5, 20), 600.0, 0.0, CORTEX, 1.2)
    atlas = [(21 * np.sin(t), 22 + 20 * np.cos(t), -84.0) for t in np.linspace(-np.pi, np.pi, 11)]
    parts += chain(atlas, [2.4] * 10, 700.0, shell_hu=CORTEX, shell_mm=1.0, flat=1.5)
    parts += both(Blob((20, 16, -82), (8, 9, 8), 500.0, 0.4, CORTEX, 1.2, 0.6), Blob((34, 20, -84), (6, 4, 4), 600.0))
    for z in (-104.0, -122.0):
        parts += [
            Blob((0, 11, z), (10.5, 8, 7.5), 420.0, 0.0, 1000.0, 1.3, 0.5),
            *both(
                Blob((16, 17, z), (7, 7, 8), 480.0, 0.3, 1000.0, 1.2, 0.5),
                Tube((16, 24, z), (4, 40, z - 3), 2.2, 600.0, 1100.0, 0.9),
                Tube((3, 42, z - 3), (float(rng.uniform(2, 7)), 54, z - 5), 2.4, 600.0, 1000.0, 0.8),
                Tube((13, 10, z), (23, 12, z), 2.0, 600.0, 1000.0, 0.8),
            ),
        ]
    return [*parts, dens, Tube((0, 29, -140), (0, 26, -58), 9.0, CSF), Tube((0, 29, -140), (0, 26, -58), 5.2, GREY)]


def teeth(rng: np.random.Generator) -> tuple[Tube, ...]:
    """Two rows, some teeth missing."""
    angles = np.linspace(-1.42, 1.42, 14)
    lower = [(37 * np.sin(t), -42 - 42 * np.cos(t), -99.0, -109.0) for t in angles]
    upper = [(29 * np.sin(t), -47 - 38 * np.cos(t), -84.0, -94.0) for t in angles]
    kept = rng.random(28) < rng.choice([1.0, 0.9, 0.5, 0.0], p=[0.5, 0.3, 0.12, 0.08])
    return tuple(
        Tube((x, y, low), (x, y, high), float(rng.uniform(2.4, 3.4)), float(rng.uniform(1700, 2700)))
        for (x, y, low, high), there in zip(lower + upper, kept, strict=True)
        if there
    )


def cavities(rng: np.random.Generator, front_mm: float) -> tuple[Solid, ...]:
    """Orbits with eyes, sinuses, nose and throat; the forehead lies at y = -``front_mm``."""
    a = rng.uniform(0.85, 1.15, 6)
    lens = rng.uniform(70, 110)
    eyes = both(
        Blob((31, -60, -32), (16, 25, 16), FAT, 0.36, 1000.0, 1.4, 0.6),
        Blob((33, -79, -32), (11.6, 12.2, 11.6), 12.0, 0.0, 48.0, 1.2),
        Blob((34, -87.5, -32), (4.4, 2.3, 4.4), lens),
        Tube((32, -67, -32), (20, -42, -31), 2.0, 36.0),
        Tube((24, -72, -32), (17, -44, -31), 1.7, 52.0, flat=2.4),  # muscles of the eye
        Tube((43, -70, -32), (25, -42, -31), 1.6, 52.0, flat=2.4),
        Tube((33, -72, -21), (22, -44, -26), 1.7, 52.0),
        Tube((33, -72, -43), (22, -44, -38), 1.7, 52.0),
        Blob((43, -80, -25), (3, 6, 5), 45.0, 0.5),
    )
    filled = rng.choice([AIR, 25.0], 2, p=[0.88, 0.12])
    sinuses = [
        Blob((27, -60, -62), (14 * a[0], 16 * a[1], 15), filled[0], 0.25, 800.0, 1.3, 1.4),
        Blob((-27, -60, -62), (14 * a[0], 16 * a[2], 15), filled[1], -0.25, 800.0, 1.3, 1.4),
        *both(Blob((4.5, -62, -62), (4.6, 27, 18), AIR, 0.05, 350.0, 0.8, 0.5)),
        Blob((float(rng.normal(0, 1)), -62, -62), (0.9, 27, 18), 250.0, float(rng.normal(0, 0.03)), rough_mm=0.3),
        *both(
            Blob((5.0, -56, -66), (1.9, 17, 4.5), 40.0, 0.1, rough_mm=0.8),
            Blob((4.6, -54, -55), (1.5, 14, 3.5), 40.0, 0.1, rough_mm=0.8),
            Blob((7 * a[3], -28, -44), (7.5 * a[3], 10, 9), AIR, 0.2, 600.0, 1.2, 0.9),
            Blob((9, 10 - front_mm, -16), (9 * a[4], 4.0, 12 * a[4]), AIR, 0.35, CORTEX, 1.4, 1.2),
        ),
    ]
    throat = [
        Blob((0, -24, -74), (rng.uniform(9, 14), 9, 14), AIR, rough_mm=0.8),
        Blob((0, -25, -104), (rng.uniform(6, 12), rng.uniform(4, 8), 34), AIR, rough_mm=0.8),
    ]
    return tuple(eyes + sinuses + throat)


def brain_parts(rng: np.random.Generator) -> tuple[Solid, ...]:
    """Ventricles, cisterns, nuclei, vessels."""
    w = float(rng.choice([rng.uniform(0.45, 1.0), rng.uniform(1.0, 2.0)]))
    d = rng.uniform(0.8, 1.15)
    fluid = both(
        Blob((9.5, -24, 12), (3.6 * w, 11 * d, 8), CSF, -0.5, rough_mm=0.4),  # front horns, then the nuclei beside them
        Blob((9.0, -4, 21), (3.8 * w, 20 * d, 5.5 * w), CSF, 0.12, rough_mm=0.4),
        Blob((17, 20, 18), (4.4 * w, 14, 7), CSF, 0.6, rough_mm=0.5),
        Blob((24, 32, 8), (4.6 * w, 14 * d, 8), CSF, 0.15, rough_mm=0.6),
        Blob((34, -8, -18), (2.6 * w, 8, 3 * w), CSF, 0.5),
        Blob((15.5, -21, 12), (4.5, 10, 9), 40.0, -0.45, rough_mm=0.5),
        Blob((23, -7, 5), (6.5, 14, 10), 40.5, -0.3, rough_mm=0.6),
        Blob((10, 6, 7), (7, 11, 8), 39.5, -0.25, rough_mm=0.5),
        Blob((33, -8, 4), (1.1, 19, 12), GREY + 1, -0.05, rough_mm=0.6),
        Blob((40, -10, 2), (1.5 * w + 0.5, 17, 11), CSF, 0.05, rough_mm=1.2),  # the cleft beside the insula
        Tube((38, -24, -6), (56, -30, 0), 1.1 * w + 0.4, CSF, flat=3.0),
        Tube((42, 6, 8), (58, 14, 16), 1.0 * w + 0.3, CSF, flat=3.0),
    )
    middle: list[Solid] = [
        Blob((0, 4, 3), (1.3 * w, 11, 9), CSF),
        Blob((0, 17, 12), (0.7, 3.5, 3), CSF),
        Blob((0, 2, 20), (2.5 * w, 1.0, 6), CSF),
        *both(Tube((0, 20, 2), (13, 15, 0), 1.8, CSF), Tube((13, 15, -2), (16, 2, -10), 1.6, CSF)),
        *[Tube((0, -8, -18), (18 * np.sin(t), -8 + 17 * np.cos(t), -18), 2.4, CSF) for t in np.arange(6) * 1.047 + 0.5],
        Tube((0, 12, -40), (0, 10, -8), 12.0, 33.0, flat=1.0),
        Blob((0, 26, -30), (4.5 * w, 4.5, 8), CSF),
        Tube((0, 46, -48), (0, 50, -30), 5.5, 36.0),
        Tube((0, -2, -44), (0, -1, -16), 2.0, 50.0),
    ]
    return (*fluid, *middle, *_vessels(rng), *_calcified(rng))


def _vessels(rng: np.random.Generator) -> list[Solid]:
    """Bright after contrast medium, hardly visible without."""
    hu = float(rng.choice([50.0, rng.uniform(120, 260)], p=[0.7, 0.3]))
    pairs = both(
        Tube((7, -14, -18), (22, -16, -15), 1.3, hu),
        Tube((22, -16, -15), (38, -14, -6), 1.1, hu),
        Tube((4, -16, -16), (1.5, -34, 0), 0.9, hu),
        Tube((3, 0, -17), (14, 10, -12), 1.0, hu),
        Tube((50, 40, -40), (28, 72, -30), 2.6, hu),
    )
    return [*pairs, Tube((0, 22, 6), (0, 30, 14), 1.5, hu), Tube((0, 30, 14), (0, 70, -8), 2.0, hu)]


def _calcified(rng: np.random.Generator) -> list[Solid]:
    spots: list[Solid] = []
    if rng.random() < 0.55:
        spots += both(Blob((20, 30, 14), (2.2, 4.0, 3.0), rng.uniform(70, 300), 0.6, rough_mm=0.8))
    if rng.random() < 0.6:
        spots.append(Blob((rng.normal(0, 0.8), 21, 6), (1.8, 2.2, 2), rng.uniform(80, 350)))
    if rng.random() < 0.15:
        spots += both(Blob((18, -5, 5), (2.5, 5, 3), rng.uniform(60, 110), rough_mm=1.0))
    return spots


def lesions(rng: np.random.Generator) -> tuple[Blob, ...]:
    """In about half of the heads: a haemorrhage, an infarct, or a growth with oedema around it."""
    if rng.random() < 0.5:
        return ()
    side, radius = rng.choice([-1.0, 1.0]), rng.uniform(5, 17)
    centre = (side * rng.uniform(20, 42), rng.uniform(-42, 42), rng.uniform(-5, 42))
    yaw = float(rng.uniform(-1, 1))
    kind = rng.choice(["bleeding", "infarct", "growth"])
    if kind == "infarct":
        return (Blob(centre, (1.7 * radius, 1.3 * radius, 1.3 * radius), rng.uniform(12, 22), yaw, rough_mm=3.0),)
    core = rng.uniform(58, 74) if kind == "bleeding" else rng.uniform(20, 34)
    rim, rim_mm = (0.0, 0.0) if kind == "bleeding" else (rng.uniform(40, 75), 2.0)
    return (
        Blob(centre, (1.5 * radius, 1.3 * radius, 1.2 * radius), rng.uniform(16, 23), yaw, rough_mm=2.5),
        Blob(centre, (0.9 * radius, 0.7 * radius, 0.7 * radius), core, yaw, rim, rim_mm, 1.2),
    )
