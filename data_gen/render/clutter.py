"""Pictures of what lies on tables and hangs on walls, drawn flat in millimetres: paper, books, films, screens, cups."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import UInt8

from data_gen.render.clutter_paint import PAINTED

PX_PER_MM = 1.0
VARIANTS = 4

ON_TABLE = ("paper", "paper", "book", "keyboard", "cup", "pen", "cable", "film", "film", "folder", "phone", "scrap")
ON_WALL = ("paper", "poster", "socket", "film", "film", "screen", "shelf", "window", "rail")
ON_PANEL = ("film", "film", "film", "scrap")

_SIZE_MM = {  # height, width and how far it rises above what it lies on
    "paper": (297, 210, 0.3),
    "book": (240, 170, 18),
    "keyboard": (140, 440, 20),
    "cup": (95, 120, 90),
    "pen": (9, 145, 9),
    "cable": (300, 420, 6),
    "film": (430, 350, 1.0),
    "folder": (310, 225, 4),
    "phone": (150, 74, 8),
    "poster": (700, 500, 1),
    "socket": (84, 160, 10),
    "screen": (330, 560, 40),
    "shelf": (380, 900, 60),
    "window": (900, 700, 20),
    "rail": (120, 1500, 25),
    "scrap": (76, 76, 0.5),
}


@dataclass(frozen=True, eq=False)
class Sprite:
    """A flat thing.

    levels: square root of reflectance in 8 bit, then coverage; the same at half the size and so on.
    size_mm: (height, width). rise_mm: above its ground.
    glow: radiance of a white pixel if the thing emits light, relative to a well-lit white wall; else 0.
    """

    levels: tuple[UInt8[np.ndarray, "_ _ 4"], ...]
    size_mm: tuple[float, float]
    rise_mm: float
    glow: float


@lru_cache(maxsize=len(_SIZE_MM) * VARIANTS)
def sprite(kind: str, variant: int) -> Sprite:
    """One of the pictures of a kind."""
    rng = np.random.default_rng([variant, *kind.encode()])
    high, wide, rise = (float(mm) for mm in _SIZE_MM[kind])
    scale = rng.uniform(0.85, 1.15, 2)
    size = (high * scale[0], wide * scale[1])
    picture = np.zeros((max(8, round(float(size[0]) * PX_PER_MM)), max(8, round(size[1] * PX_PER_MM)), 4), np.uint8)
    picture[..., 3] = 255
    PAINTED[kind](picture, rng)
    glow = {"screen": float(rng.uniform(0.6, 2.0)), "window": float(rng.uniform(1.5, 8.0))}.get(kind, 0.0)
    levels = [picture]
    while min(levels[-1].shape[:2]) > 16:
        h, w = levels[-1].shape[:2]
        half = cv2.resize(levels[-1], (w // 2, h // 2), interpolation=cv2.INTER_AREA)
        levels.append(half.astype(np.uint8))
    return Sprite(tuple(levels), size, rise, glow)


def draw_sprites() -> None:
    """Draw every picture of every kind and keep them."""
    for kind in _SIZE_MM:
        for variant in range(VARIANTS):
            sprite(kind, variant)
