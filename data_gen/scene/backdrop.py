"""What lies behind the film: a record of it, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.light.lighting import Light
from data_gen.scene.materials import TABLES, VARIANTS, WALLS

SEEDS = 2**31

KINDS = ("room", "table", "wall", "panel", "dark")
"""room: the environment alone. table: below the film, wall: upright behind it, both with things on them.
panel: a light box with its frame and what is around it. dark: too dark to be told apart from the film's own black."""


@dataclass(frozen=True)
class Backdrop:
    """The background of one photo.

    kind: one of KINDS. material, variant: of the table or wall. gap_mm: from it to the nearest part of the film.
    turn_deg: rotation of the material's grain. tilt: slopes of the plane relative to the film's own. tint: factor on
    the material's colour. things: how many lie on it. blur: defocus in pixels of a photo 1000 px wide.
    level: brightness of a dark background, relative to the film's base. seed: of everything else.
    """

    kind: str
    material: str
    variant: int
    gap_mm: float
    turn_deg: float
    tilt: tuple[float, float]
    tint: tuple[float, float, float]
    things: int
    blur: float
    level: float
    seed: int


def sample_backdrop(light: Light, rng: np.random.Generator) -> Backdrop:
    """Light boxes show their panel or are masked to the film; a third of the other photos show the room itself."""
    if light.light_box:
        kind = str(rng.choice(["panel", "dark"], p=[0.55, 0.45]))
    else:
        plane = "table" if light.lying else "wall"
        kind = str(rng.choice(["room", plane, "dark"], p=[0.15, 0.72, 0.13] if light.lying else [0.5, 0.37, 0.13]))
    touching = rng.random() < (0.65 if kind == "table" else 0.3)
    gap = rng.uniform(0, 12) if touching else 10 ** rng.uniform(1.2, 2.9)
    focus = (
        10 ** rng.uniform(-0.6, 0.2) if gap < 40 else 10 ** rng.uniform(-0.3, 0.4) + gap / 60 * rng.uniform(0.1, 1.5)
    )
    if kind == "room":
        focus = 10 ** rng.uniform(0.0, 1.4)
    tint = rng.uniform(0.75, 1.2) * np.exp2(rng.normal(0, 0.08, 3))
    red, green, blue = (float(c) for c in tint)
    slope = 0.02 if touching else 0.12
    return Backdrop(
        kind=kind,
        material=str(rng.choice(WALLS if kind in ("wall", "panel") else TABLES)),
        variant=int(rng.integers(VARIANTS)),
        gap_mm=float(gap),
        turn_deg=float(rng.normal(0, 12) + 90 * rng.integers(2)) if rng.random() < 0.7 else float(rng.uniform(0, 360)),
        tilt=(float(rng.normal(0, slope)), float(rng.normal(0, slope))),
        tint=(red, green, blue),
        things=int(rng.integers(1, 9)) if rng.random() < 0.7 else 0,
        blur=float(focus),
        level=float(np.exp(rng.normal(0, 0.3))),
        seed=int(rng.integers(SEEDS)),
    )
