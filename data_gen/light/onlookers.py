"""What is in front of the film: the phone that photographs it and the person who holds it, as its gloss mirrors them.

They are flat shapes that face the film, fixed relative to the camera: a reflection shows only their outline, dark
against the room or, for a white coat, bright against a dark room.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32

from data_gen.light.lamps import Vector
from hybrid.mesh.camera import Camera

PERSON_SHARE = 0.75
"""Share of photos with a person behind the phone; otherwise it stands by itself or is held at arm's length."""

PHONE_HALF_MM = (37.0, 76.0)

FLASH_MM = 60.0
"""A lamp this near to the camera is the phone's flash, which the phone does not hide."""


@dataclass(frozen=True)
class Billboard:
    """A flat shape that faces the film.

    shape: of its outline. centre_mm: in camera axes; z < 0 is behind the camera. half_mm: its half width and height.
    reflectance: linear RGB share of the room's mean light that it scatters.
    """

    shape: Literal["ellipse", "box"]
    centre_mm: Vector
    half_mm: tuple[float, float]
    reflectance: Vector

    def outside_mm(self, x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Approximate distance by which points of its plane lie outside it; negative within."""
        dx, dy = x - np.float32(self.centre_mm[0]), y - np.float32(self.centre_mm[1])
        wide, high = (np.float32(half) for half in self.half_mm)
        if self.shape == "ellipse":
            return (np.hypot(dx / wide, dy / high) - 1) * min(wide, high)
        return np.maximum(np.abs(dx) - wide, np.abs(dy) - high)


def sample_onlookers(rng: np.random.Generator) -> tuple[Billboard, ...]:
    """A phone, its camera near one of its ends, and in most cases a person behind it; farthest first."""
    upright = rng.random() < 0.5
    half = PHONE_HALF_MM if upright else (PHONE_HALF_MM[1], PHONE_HALF_MM[0])
    off = [float(rng.choice([-1, 1]) * rng.uniform(0.4, 0.85) * side) for side in half]
    phone = Billboard("box", (off[0], off[1], 0.0), half, _grey(rng, 0.02, 0.15))
    if rng.random() >= PERSON_SHARE:
        return (phone,)
    back, aside, level = -rng.uniform(180, 450), rng.normal(0, 70), rng.normal(-40, 80)
    head_high = float(rng.uniform(105, 135))
    head = Billboard("ellipse", (aside, level, back), (0.75 * head_high, head_high), _skin(rng))
    wide, high = float(rng.uniform(190, 270)), 400.0
    coat = _grey(rng, 0.4, 0.8) if rng.random() < 0.3 else _cloth(rng)
    torso = Billboard("ellipse", (aside, level + head_high + 0.9 * high, back - 40), (wide, high), coat)
    return torso, head, phone


def mirrored_onlookers(
    onlookers: tuple[Billboard, ...],
    camera: Camera,
    points: Float[np.ndarray, "m n 3"],
    mirror: Float[np.ndarray, "m n 3"],
    alpha: float,
    around: Float[np.ndarray, "m n 3"],
    mean: Float[np.ndarray, "3"],
) -> Float32[np.ndarray, "m n 3"]:
    """What a film mirrors: ``around``, with the onlookers that the mirror directions hit in front, blurred by the lobe.

    points, mirror: film points and mirror directions, in the world. alpha: the lobe's half width. mean: the room's
    mean light.
    """
    seen, rays = around.astype(np.float32), _rays(camera, points, mirror)
    for one in onlookers:
        colour = (np.array(one.reflectance) * mean).astype(np.float32)
        seen += _share(one, *rays, alpha)[..., None] * (colour - seen)
    return seen


def left_free(
    onlookers: tuple[Billboard, ...],
    camera: Camera,
    points: Float[np.ndarray, "m n 3"],
    mirror: Float[np.ndarray, "m n 3"],
    alpha: float,
    lamp_mm: Float[np.ndarray, "3"],
) -> Float32[np.ndarray, "m n"]:
    """Share of a lamp's reflection that no onlooker between lamp and film hides. lamp_mm: in the world."""
    lamp = camera.camera_points(lamp_mm[None])[0]
    free, rays = np.ones(points.shape[:2], np.float32), _rays(camera, points, mirror)
    for one in onlookers if np.linalg.norm(lamp) > FLASH_MM else ():
        if one.centre_mm[2] > lamp[2]:
            free *= 1 - _share(one, *rays, alpha)
    return free


def _rays(
    camera: Camera, points: Float[np.ndarray, "m n 3"], mirror: Float[np.ndarray, "m n 3"]
) -> tuple[Float32[np.ndarray, "m n 3"], Float32[np.ndarray, "m n 3"]]:
    """The film's points and their mirror directions, in camera axes."""
    start, way = camera.camera_points(points), mirror @ camera.camera_from_world[:3, :3].T
    return start.astype(np.float32), way.astype(np.float32)


def _share(
    one: Billboard, start: Float32[np.ndarray, "m n 3"], way: Float32[np.ndarray, "m n 3"], alpha: float
) -> Float32[np.ndarray, "m n"]:
    """How much of what the film's points mirror, along ``way`` from ``start`` in camera axes, a shape covers."""
    ahead = (np.float32(one.centre_mm[2]) - start[..., 2]) / np.minimum(way[..., 2], np.float32(-1e-3))
    x, y = (start[..., k] + ahead * way[..., k] for k in (0, 1))
    soft = np.maximum(np.float32(2 * alpha) * ahead, 3)
    return (np.clip(0.5 - one.outside_mm(x, y) / soft, 0, 1) * (way[..., 2] < 0)).astype(np.float32)


def _grey(rng: np.random.Generator, low: float, high: float) -> Vector:
    level = float(rng.uniform(low, high))
    return level, level, level


def _skin(rng: np.random.Generator) -> Vector:
    level = float(rng.uniform(0.08, 0.5))
    return level, 0.7 * level, 0.55 * level


def _cloth(rng: np.random.Generator) -> Vector:
    red, green, blue = (float(level) for level in rng.uniform(0.02, 0.4, 3))
    return red, green, blue
