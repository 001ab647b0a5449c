"""Shadows that hands, arms, the phone and edges of the room cast on the film: factors on its light, in film space.

A silhouette stands between a lamp of some size and the film: its shadow is the silhouette blurred by the penumbra,
which is as wide as the lamp times the ratio of distances, so it grows with the height above the film. Light from
elsewhere fills it, so no shadow is quite black. Shadows are drawn in millimetres of the film.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from data_gen.scene.hand_model import GRIPS, PX_PER_MM, VARIANTS, hand_model
from data_gen.scene.patches import filled
from data_gen.scene.relief import MIDDLE, affine, coverage, warped

KINDS = ("hand", "phone", "edge", "head", "bars")
"""hand: with its arm. phone: held by a hand. edge: of a door, curtain or wall that hides lamp or sun.
head: of somebody who leans over the film. bars: of a blind or window."""


@dataclass(frozen=True)
class Shadow:
    """One shadow. at: film uv of its middle. turn_deg: where its arm comes from, or its lines run. size: factor on
    life size. penumbra_mm: blur (one sigma). depth: share of the light that it blocks. variant: of the hand's model.
    """

    kind: str
    at: tuple[float, float]
    turn_deg: float
    size: float
    penumbra_mm: float
    depth: float
    variant: int


def sample_shadows(rng: np.random.Generator) -> tuple[Shadow, ...]:
    """One shadow, sometimes with another beside it from a second lamp."""
    kind = str(rng.choice(KINDS, p=[0.25, 0.35, 0.22, 0.12, 0.06]))
    height = 10 ** rng.uniform(1.3, 2.8)  # mm above the film
    lamp = 10 ** rng.uniform(-2.2, -0.3)  # angle that the lamp fills: sun and spot lamps to windows
    first = Shadow(
        kind=kind,
        at=(float(rng.uniform(-0.15, 1.15)), float(rng.uniform(-0.15, 1.15))),
        turn_deg=float(rng.normal(-90, 60) if rng.random() < 0.7 else rng.uniform(0, 360)),
        size=float(rng.uniform(0.9, 1.3) + height / 1500),
        penumbra_mm=float(np.clip(0.3 * lamp * height, 12.0 if kind == "head" else 0.5, 60)),
        depth=float(rng.uniform(0.15, 0.85)),
        variant=int(rng.integers(VARIANTS)),
    )
    if rng.random() > 0.25:
        return (first,)
    aside = rng.normal(0, 0.15, 2)
    at = (float(first.at[0] + aside[0]), float(first.at[1] + aside[1]))
    wider = float(min(first.penumbra_mm * rng.uniform(0.7, 2.5), 60))
    second = Shadow(kind, at, first.turn_deg, first.size, wider, 0.6 * first.depth, first.variant)
    return first, second


def film_shadow(shadows: tuple[Shadow, ...], size_mm: tuple[float, float], n: int) -> Float[np.ndarray, "n n"]:
    """Factor (0, 1] on the light over the film, on the pixel centres of an n x n film image. size_mm: height, width."""
    factor = np.ones((n, n), np.float32)
    for shadow in shadows:
        factor *= 1 - np.float32(shadow.depth) * _blurred(_silhouette(shadow, size_mm, n), shadow, size_mm)
    return factor


def _blurred(mask: np.ndarray, shadow: Shadow, size_mm: tuple[float, float]) -> np.ndarray:
    """The silhouette with a penumbra of at least half a lattice step, since the lattice holds nothing finer."""
    n = len(mask)
    sigma = [max(shadow.penumbra_mm * n / mm, 0.5) for mm in (size_mm[1], size_mm[0])]
    return cv2.GaussianBlur(mask, (0, 0), sigma[0], sigmaY=sigma[1], borderType=cv2.BORDER_REPLICATE)


def _silhouette(shadow: Shadow, size_mm: tuple[float, float], n: int) -> Float[np.ndarray, "n n"]:
    """Share of each film pixel behind the silhouette."""
    per_mm = np.array([n / size_mm[1], n / size_mm[0]])
    at = np.array(shadow.at) * n
    angle = np.deg2rad(shadow.turn_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * shadow.size
    outlines = [np.array(outline, np.float64) for outline in _outlines(shadow.kind)]
    masks = [filled(outline @ turn.T * per_mm + at, (n, n)) for outline in outlines]
    if shadow.kind in ("hand", "phone"):
        grip = "fist" if shadow.kind == "phone" else GRIPS[shadow.variant % len(GRIPS)]
        model = hand_model(grip, shadow.variant)
        forward = affine(np.diag(per_mm) @ turn / PX_PER_MM, model.anchor, at)
        edge = warped(model.shape, forward, (slice(0, n), slice(0, n)))[..., 3]
        masks.append(coverage(edge.astype(np.float32) - MIDDLE, float(per_mm.min()) * shadow.size))
    return np.max(masks, axis=0)


def _outlines(kind: str) -> list:
    """Polygons of a silhouette in millimetres, x away from where its arm or shoulders are."""
    if kind == "phone":
        return [[[-20, -38], [130, -38], [130, 38], [-20, 38]]]
    if kind == "edge":
        return [[[-3000, -3000], [3000, -3000], [3000, 0], [-3000, 0]]]
    if kind == "bars":
        return [[[-3000, y], [3000, y], [3000, y + 25], [-3000, y + 25]] for y in range(-720, 721, 60)]
    if kind == "head":
        t = np.linspace(0, 2 * np.pi, 48)
        shoulders = [[-900, -230], [-150, -200], [-95, -60], [-95, 60], [-150, 200], [-900, 230]]
        return [np.stack([110 * np.cos(t), 85 * np.sin(t)], axis=-1), shoulders]
    return []
