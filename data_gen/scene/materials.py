"""Tiles of table and wall materials that repeat without a seam: wood, laminate, stone, cloth, metal, plaster, tiles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from data_gen.scene.relief import coded
from hybrid.coords import linear_from_srgb

TILE = 512
VARIANTS = 5
TABLES = ("wood", "planks", "laminate", "stone", "cloth", "metal", "black")
WALLS = ("plaster", "plaster", "tiles", "planks", "metal", "laminate", "black")

_MM = {"wood": 700.0, "planks": 900.0, "laminate": 400.0, "stone": 600.0, "cloth": 160.0, "metal": 400.0}
_MM |= {"plaster": 500.0, "tiles": 600.0, "black": 500.0}
_ROUGHNESS = {"wood": 0.4, "planks": 0.5, "laminate": 0.3, "stone": 0.18, "cloth": 1.0, "metal": 0.3}
_ROUGHNESS |= {"plaster": 1.0, "tiles": 0.12, "black": 0.35}


@dataclass(frozen=True, eq=False)
class Tile:
    """A square of material: the square root of its reflectance in 8 bit, the same at half the size and so on.

    mm: its side. roughness, f0: of its surface.
    """

    levels: tuple[UInt8[np.ndarray, "_ _ 3"], ...]
    mm: float
    roughness: float
    f0: float


@lru_cache(maxsize=len(_MM) * VARIANTS)
def tile(material: str, variant: int) -> Tile:
    """One of the tiles of a material."""
    rng = np.random.default_rng([variant, *material.encode()])
    colour = np.clip(_PAINTED[material](rng), 0.004, 0.92)
    levels = [coded([255 * np.sqrt(colour[..., c]) for c in range(3)])]
    while len(levels[-1]) > 16:
        half = len(levels[-1]) // 2
        levels.append(cv2.resize(levels[-1], (half, half), interpolation=cv2.INTER_AREA))
    scale, rough = rng.uniform(0.75, 1.35), float(np.clip(_ROUGHNESS[material] * rng.uniform(0.6, 1.6), 0.08, 1))
    f0 = 0.55 if material == "metal" else 0.0 if _ROUGHNESS[material] == 1 else 0.04
    return Tile(tuple(levels), _MM[material] * scale, rough, f0)


def noise(rng: np.random.Generator, slope: float, stretch: float = 1.0) -> Float[np.ndarray, "t t"]:
    """Periodic noise of mean 0 and deviation 1 whose amplitude falls as frequency^-slope; longer along x by stretch."""
    f = np.fft.fftfreq(TILE, 1 / TILE)[:, None]
    g = np.fft.rfftfreq(TILE, 1 / TILE)[None, :] * stretch
    amplitude = (1.0 + f**2 + g**2) ** (-slope / 2)
    amplitude[0, 0] = 0
    wave = np.fft.rfft2(rng.standard_normal((TILE, TILE), dtype=np.float32))
    field = np.fft.irfft2(wave * amplitude, s=(TILE, TILE))
    return (field / field.std()).astype(np.float32)


def _mixed(a: np.ndarray, b: np.ndarray, share: np.ndarray) -> np.ndarray:
    return a + (b - a) * np.clip(share, 0, 1)[..., None]


def _wood_colours(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Early and late wood, from birch to walnut, or painted grey."""
    light = np.array(
        [[0.86, 0.74, 0.56], [0.76, 0.58, 0.38], [0.62, 0.42, 0.26], [0.42, 0.28, 0.18], [0.66, 0.63, 0.6]]
    )
    base = linear_from_srgb(light[rng.integers(len(light))]) * rng.uniform(0.8, 1.1)
    return base, base * np.array([0.62, 0.55, 0.48]) * rng.uniform(0.8, 1.2)


def _wood(rng: np.random.Generator) -> np.ndarray:
    """Veneer: grain along x, rings cut at a slant, pores."""
    early, late = _wood_colours(rng)
    y = np.arange(TILE, dtype=np.float32)[:, None] / TILE
    rings = np.sin(2 * np.pi * (int(rng.integers(5, 16)) * y + 0.9 * noise(rng, 2.2, 9.0)))
    fibre, pores = noise(rng, 0.6, 40.0), noise(rng, 0.9, 14.0)
    share = 0.35 + 0.25 * rings + 0.12 * fibre + 0.25 * (pores > 1.7)
    return _mixed(early, late, share) * np.exp2(0.1 * noise(rng, 2.0))[..., None]


def _planks(rng: np.random.Generator) -> np.ndarray:
    """Boards side by side, each with its own tone, dark joints between them."""
    wood = _wood(rng)
    rows = int(rng.integers(4, 9))
    edges = np.linspace(0, TILE, rows + 1).astype(int)
    for k in range(rows):
        band = np.roll(wood[edges[k] : edges[k + 1]], int(rng.integers(TILE)), axis=1)
        joints = [int(rng.integers(TILE))]
        band = band * np.exp2(rng.normal(0, 0.25))
        band[:, joints] *= 0.35
        band[0] *= 0.35
        wood[edges[k] : edges[k + 1]] = band
    return wood


def _laminate(rng: np.random.Generator) -> np.ndarray:
    """Plain or speckled board: white, grey, beige, or a colour."""
    base = np.array([0.55, 0.54, 0.5]) if rng.random() < 0.5 else rng.uniform(0.1, 0.6) * np.exp2(rng.normal(0, 0.2, 3))
    speckle = noise(rng, 0.3) * rng.uniform(0.0, 0.12) + noise(rng, 1.8) * 0.03
    return base * np.exp2(speckle)[..., None]


def _stone(rng: np.random.Generator) -> np.ndarray:
    """Granite: grains of three minerals; marble: veins; concrete: clouds and pits."""
    kind = int(rng.integers(3))
    base = rng.uniform(0.12, 0.6) * np.exp2(rng.normal(0, 0.1, 3))
    if kind == 0:
        grains, other = noise(rng, 0.9), noise(rng, 0.9)
        stone = _mixed(base, base * 0.25, (grains - 0.6) * 4)
        return _mixed(stone, np.minimum(base * 2.2, 0.8), (other - 0.9) * 4)
    if kind == 1:
        vein = np.exp(-np.abs(noise(rng, 1.9)) * rng.uniform(6, 14)) * (0.5 + 0.5 * np.tanh(noise(rng, 1.6)))
        return _mixed(np.minimum(base * 1.6, 0.75), base * 0.4, vein) * np.exp2(0.08 * noise(rng, 1.5))[..., None]
    pits = noise(rng, 0.7) > 2.6
    return (base * np.exp2(0.16 * noise(rng, 1.5) + 0.05 * noise(rng, 0.4))[..., None]) * np.where(pits, 0.6, 1)[
        ..., None
    ]


def _cloth(rng: np.random.Generator) -> np.ndarray:
    """Plain weave, in one colour or checked; drapes, sheets, table cloths."""
    threads = int(rng.integers(60, 120))
    t = np.arange(TILE) * (2 * np.pi * threads / TILE)
    weave = np.sin(t)[:, None] * np.sin(t)[None, :] + 0.4 * (np.cos(2 * t)[:, None] + np.cos(2 * t)[None, :])
    base = rng.uniform(0.04, 0.6) * np.exp2(rng.normal(0, 0.5, 3))
    cloth = np.ones((TILE, TILE, 3)) * base
    if rng.random() < 0.35:
        other = rng.uniform(0.04, 0.7) * np.exp2(rng.normal(0, 0.5, 3))
        stripe = (np.arange(TILE) // (TILE // int(2 * rng.integers(1, 5)))) % 2
        cloth = _mixed(base, other, 0.5 * stripe[:, None] + 0.5 * stripe[None, :] * (rng.random() < 0.7))
    return cloth * np.exp2(0.18 * weave + 0.06 * noise(rng, 0.8, 3.0))[..., None]


def _metal(rng: np.random.Generator) -> np.ndarray:
    """Brushed steel; most of its light is reflection."""
    brushed = noise(rng, 0.5, 60.0) * 0.14 + noise(rng, 1.6) * 0.08
    return rng.uniform(0.15, 0.3) * np.exp2(rng.normal(0, 0.03, 3)) * np.exp2(brushed)[..., None]


def _plaster(rng: np.random.Generator) -> np.ndarray:
    """A painted wall, rough or smooth."""
    tone = rng.uniform(0.35, 0.8) if rng.random() < 0.8 else rng.uniform(0.05, 0.35)
    base = tone * np.exp2(rng.normal(0, 0.12, 3))
    grain = noise(rng, float(rng.uniform(0.3, 1.2))) * rng.uniform(0.01, 0.07) + noise(rng, 1.8) * 0.03
    return base * np.exp2(grain)[..., None]


def _tiles(rng: np.random.Generator) -> np.ndarray:
    """Glazed tiles with joints, each slightly different."""
    count = int(rng.integers(3, 7))
    step, joint = TILE / count, rng.uniform(0.012, 0.03)
    place = np.arange(TILE) / step
    tone = np.exp2(rng.normal(0, 0.06, (count, count)))[np.ix_(place.astype(int), place.astype(int))]
    base = rng.uniform(0.15, 0.7) * np.exp2(rng.normal(0, 0.2, 3))
    inside = (place % 1 > joint)[:, None] & (place % 1 > joint)[None, :]
    return _mixed(np.full(3, rng.uniform(0.1, 0.5)), base * tone[..., None], inside.astype(np.float32))


def _black(rng: np.random.Generator) -> np.ndarray:
    """Black or nearly black: velvet, a dark desk, slate."""
    base = 10 ** rng.uniform(-2.3, -1.4) * np.exp2(rng.normal(0, 0.1, 3))
    return base * np.exp2(noise(rng, float(rng.uniform(0.4, 1.4))) * rng.uniform(0.03, 0.2))[..., None]


_PAINTED = {
    "wood": _wood,
    "planks": _planks,
    "laminate": _laminate,
    "stone": _stone,
    "cloth": _cloth,
    "metal": _metal,
    "plaster": _plaster,
    "tiles": _tiles,
    "black": _black,
}
