"""Hands that hold or touch the film: what a hand looks like, where it grips, and its picture in a photo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from data_gen.light.lit_sphere import LitSphere, look_up
from data_gen.scene.hand_model import GRIPS, PX_PER_MM, VARIANTS, HandModel, hand_model
from data_gen.scene.patches import Patch
from data_gen.scene.relief import MIDDLE, Place, affine, contact_shade, coverage, decoded_normals, seen_box, warped
from hybrid.coords import linear_from_srgb

SKIN_SRGB = np.array(
    ["f6ede4", "f3e7db", "f7ead0", "eadaba", "d7bd96", "a07e56", "825c43", "604134", "3a312a", "292420"]
)
"""The ten tones of the Monk Skin Tone scale (Monk 2019, skintone.google), as hexadecimal sRGB."""

SKIN_UNDER_WHITE = 0.72
"""The swatches are printed brighter than skin reflects: light skin reflects about 0.6 of red light."""


GLOVE_SRGB = np.array([[0.16, 0.38, 0.74], [0.87, 0.87, 0.85], [0.45, 0.35, 0.65]])
"""Blue nitrile, white latex, violet nitrile."""


@dataclass(frozen=True)
class Hand:
    """One hand at the film's rim.

    grip, variant: the model. edge: place on the rim, 0 to 4 from the top-left corner clockwise. turn_deg: rotation of
    the hand about that place. mirrored: a left hand's picture made from a right one's. size: factor on the model's.
    skin, sleeve: linear RGB reflectance. glove: likewise, of a glove, or None.
    """

    grip: str
    variant: int
    edge: float
    turn_deg: float
    mirrored: bool
    size: float
    skin: tuple[float, float, float]
    sleeve: tuple[float, float, float]
    glove: tuple[float, float, float] | None

    @property
    def behind(self) -> bool:
        """Part of the hand is behind the film."""
        return self.grip in ("pinch", "fist")


def sample_hands(count: int, lying: bool, rng: np.random.Generator) -> tuple[Hand, ...]:
    """Hands of one person, ``count`` of them; nobody reaches behind a film that lies on something."""
    skin, sleeve = _tuple(skin_reflectance(rng.uniform(0, 1), rng)), _tuple(_cloth(rng))
    glove = None
    if rng.random() < 0.12:
        glove = _tuple(linear_from_srgb(GLOVE_SRGB[rng.choice(3, p=[0.7, 0.2, 0.1])]))
    shares = [0.0, 0.0, 0.45, 0.25, 0.3] if lying else [0.42, 0.2, 0.22, 0.06, 0.1]
    usual = rng.choice([1.5, 3.5, 2.5], p=[0.4, 0.4, 0.2]) + rng.normal(0, 0.3)  # the sides and the lower edge
    first = rng.uniform(0, 4) if rng.random() < 0.5 else usual
    return tuple(
        Hand(
            grip=str(rng.choice(GRIPS, p=shares)),
            variant=int(rng.integers(VARIANTS)),
            edge=float((first + k * 2 + (rng.normal(0, 0.25) if k else 0.0)) % 4),
            turn_deg=float(rng.normal(0, 16)),
            mirrored=bool(rng.random() < 0.5),
            size=float(np.clip(rng.normal(1.0, 0.08), 0.8, 1.2)),
            skin=skin,
            sleeve=sleeve,
            glove=glove,
        )
        for k in range(count)
    )


def skin_reflectance(tone: float, rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """Linear reflectance of skin; ``tone`` from 0 (lightest of the Monk scale) to 1."""
    swatches = np.array([[int(code[k : k + 2], 16) / 255 for k in (0, 2, 4)] for code in SKIN_SRGB])
    linear = linear_from_srgb(swatches) * SKIN_UNDER_WHITE
    base = np.array([np.interp(tone * (len(linear) - 1), np.arange(len(linear)), linear[:, c]) for c in range(3)])
    warm = np.array([1.06, 0.95, 0.86])  # blood: photographed hands are redder than the swatches of faces
    return np.clip(base * warm * np.exp2(rng.normal(0, 0.06, 3)), 0.01, 0.9)


def hand_patch(hand: Hand, place: Place, ball: LitSphere, size: tuple[int, int], *, front: bool) -> Patch | None:
    """The part of a hand in front of the film, or the whole hand as seen beyond the rim; None outside the photo."""
    model = hand_model(hand.grip, hand.variant)
    forward = _photo_from_model(model, hand, place)
    h, w = model.shape.shape[:2]
    box = seen_box(np.array([[-40.0 * w, 0], [w, h]]), forward, size, 14 * place.px_per_mm)
    if box is None:
        return None
    shape, skin = (warped(picture, forward, box) for picture in (model.shape, model.skin))
    edge = (skin[..., 0] if front else shape[..., 3]).astype(np.float32) - MIDDLE
    cover = coverage(edge, place.px_per_mm * hand.size)
    if not cover.any():
        return None
    radiance = np.zeros((*cover.shape, 3), np.float32)
    rows = np.flatnonzero(cover.any(axis=1))
    part = slice(int(rows[0]), int(rows[-1]) + 1)
    radiance[part] = _lit(shape[part], skin[part], hand, forward, ball)
    shade = contact_shade(edge, 14.0, 0.5) if front else np.ones_like(cover)
    return Patch(box, radiance, cover, cover, shade)


def _photo_from_model(model: HandModel, hand: Hand, place: Place) -> Float[np.ndarray, "2 3"]:
    """Affine map from model pixels to photo points: anchor to the rim, the model's inward direction to the film's."""
    scale = place.px_per_mm * hand.size / PX_PER_MM
    flip = np.diag([1.0, -1.0 if hand.mirrored else 1.0])
    inward = -model.inward if hand.mirrored else model.inward
    angle = np.arctan2(place.inward[1], place.inward[0]) + np.deg2rad(hand.turn_deg) - inward
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return affine(scale * turn @ flip, model.anchor, place.at)


def _lit(shape: np.ndarray, skin: np.ndarray, hand: Hand, forward: np.ndarray, ball: LitSphere) -> np.ndarray:
    """Radiance of the hand: matt light on skin, nails, glove or cloth, and a little gloss."""
    normal = decoded_normals(shape, forward)
    reached = shape[..., 2:3] * np.float32(1 / 255)
    kind, blush = skin[..., 3:4] * np.float32(1 / 255), skin[..., 2:3] * np.float32(1 / 255)
    base = np.array(hand.glove or hand.skin, np.float32)
    warm = np.array([1.04, 0.92, 0.92], np.float32) if hand.glove is None else np.ones(3, np.float32)
    colour = base * (1 + blush * (warm - 1)) * (skin[..., 1:2] * np.float32(1 / 128))
    colour = np.where(kind > 0.7, np.array(hand.sleeve, np.float32), colour)
    matt = look_up(ball.matt, normal)
    if hand.glove is None:  # light wanders under the skin, red light farthest, so red shadows are softer
        matt = matt + np.array([0.22, 0.08, 0.05], np.float32) * (ball.facing - matt)
    shine = np.where(kind > 0.7, 0.0, np.where((kind > 0.3) | (hand.glove is not None), 1.6, 0.7)).astype(np.float32)
    tint = 1 - 0.4 * (1 - reached) * (1 - base)  # light in creases has met skin before
    return colour * matt * reached**tint + shine * reached * look_up(ball.gloss, normal)


def _cloth(rng: np.random.Generator) -> np.ndarray:
    """Reflectance of a sleeve: a doctor's coat, scrubs, or any dark or coloured cloth."""
    kind = rng.random()
    if kind < 0.3:
        return np.array([0.80, 0.81, 0.82]) * rng.uniform(0.85, 1.0)
    if kind < 0.45:
        return linear_from_srgb(np.array([[0.20, 0.45, 0.55], [0.25, 0.35, 0.60], [0.30, 0.55, 0.45]])[rng.integers(3)])
    return np.clip(10 ** rng.uniform(-1.9, -0.3) * np.exp2(rng.normal(0, 0.4, 3)), 0.01, 0.85)


def _tuple(colour: np.ndarray) -> tuple[float, float, float]:
    r, g, b = (float(c) for c in colour)
    return r, g, b
