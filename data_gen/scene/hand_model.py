"""Hands as relief pictures: a skeleton of tapered capsules in a pose, seen along the camera's axis.

A model is drawn once for each (grip, variant) and kept; placing it in a photo takes one affine warp, lighting it one
lookup by normal. Frame of a model: millimetres, x from the forearm to the fingers, y across, z towards the camera; the
forearm leaves through x = left, and the picture's first column repeats beyond it, so an arm never ends within a photo.
Lengths and widths of bones: means of adults (Buchholz et al. 1992, Ergonomics 35:261), varied by 8 %.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import UInt8

from data_gen.scene.relief import EDGE_PER_MM, MIDDLE, coded, coded_shape, smooth_max
from hybrid.coords import centres_1d

PX_PER_MM = 1.6
VARIANTS = 6
"""Different models of each grip; they are also mirrored and turned."""

GRIPS = ("pinch", "fist", "fingers", "flat", "point")
"""pinch: thumb in front of the film, hand behind. fist: likewise, fingers curled, the film beside the index finger.
fingers: finger tips in front of the film. flat: a hand laid on it. point: one finger on it."""

_BEHIND = ("pinch", "fist")
_FINGERS = (  # base of the finger (x, y), direction (deg), lengths of the three phalanges, radius at base and at tip
    ((92.0, 29.0), 7.0, (44.0, 25.0, 21.0), 9.6, 7.0),
    ((97.0, 9.0), 1.0, (48.0, 29.0, 22.0), 9.8, 7.2),
    ((92.0, -11.0), -4.0, (45.0, 27.0, 22.0), 9.2, 6.8),
    ((84.0, -29.0), -11.0, (35.0, 20.0, 20.0), 8.0, 6.0),
)


@dataclass(frozen=True, eq=False)
class HandModel:
    """Relief of a hand, (h, w) pictures at ``PX_PER_MM``, 8 bit.

    shape: as coded_shape makes it.
    skin: distance inside the outline of what is in front of the film, brightness (128: as the skin's), blush, and what
        it is (0 skin, 128 nail, 255 cloth or, for a glove, its cuff).
    anchor: model point (pixels) that lies on the film's rim. inward: angle (rad) of the direction into the film.
    """

    shape: UInt8[np.ndarray, "h w 4"]
    skin: UInt8[np.ndarray, "h w 4"]
    anchor: tuple[float, float]
    inward: float


@dataclass(frozen=True, eq=False)
class _Bone:
    """A tapered capsule from ``start`` to ``stop`` (mm, xyz).

    front: in front of the film. nail: it carries one. creases: places along it (0: start) with folds of skin.
    blend: difference of height (mm) over which it joins its neighbours.
    """

    start: np.ndarray
    stop: np.ndarray
    radii: tuple[float, float]
    front: bool
    nail: bool = False
    creases: tuple[float, ...] = ()
    blend: float = 3.0


@dataclass
class _Canvas:
    """Relief being drawn. origin: mm of the picture's corner."""

    origin: np.ndarray
    size: tuple[int, int]
    height: np.ndarray = field(init=False)
    edge: np.ndarray = field(init=False)
    front: np.ndarray = field(init=False)
    nail: np.ndarray = field(init=False)
    blush: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.height, self.edge, self.front = (np.full(self.size, -90.0, np.float32) for _ in range(3))
        self.nail, self.blush = (np.zeros(self.size, np.float32) for _ in range(2))

    def window(self, low: np.ndarray, high: np.ndarray) -> tuple[tuple[slice, slice], np.ndarray, np.ndarray]:
        """Slices of the pixels between two corners (mm), and their x (1, w) and y (h, 1)."""
        first = np.maximum(np.floor((low - self.origin) * PX_PER_MM), 0).astype(int)
        last = np.minimum(np.ceil((high - self.origin) * PX_PER_MM), self.size[::-1]).astype(int)
        box = (slice(first[1], max(last[1], first[1])), slice(first[0], max(last[0], first[0])))
        x = (centres_1d(self.size[1])[box[1]] / PX_PER_MM + self.origin[0]).astype(np.float32)
        y = (centres_1d(self.size[0])[box[0]] / PX_PER_MM + self.origin[1]).astype(np.float32)
        return box, x[None, :], y[:, None]

    @property
    def ramp(self) -> np.ndarray:
        """(1, w) from 0 to 1 over the first 20 mm: the picture is straight where it is repeated beyond its side."""
        return np.clip(centres_1d(self.size[1]) / (20 * PX_PER_MM), 0, 1).astype(np.float32)[None, :]


@lru_cache(maxsize=len(GRIPS) * VARIANTS)
def hand_model(grip: str, variant: int) -> HandModel:
    """The relief of one hand in one pose."""
    rng = np.random.default_rng([GRIPS.index(grip), variant])
    bones, anchor, inward = _posed(grip, rng)
    wrist_angle = np.deg2rad(rng.normal(0, 14))
    bones = [_turned(b, wrist_angle) for b in bones]
    anchor = _rotation(wrist_angle)[:2, :2] @ anchor
    points = np.array([p for b in bones for p in (b.start, b.stop)])
    low, high = points[:, :2].min(axis=0) - 26, points[:, :2].max(axis=0) + 26
    low[0], low[1], high[1] = -90.0, min(low[1], -66.0), max(high[1], 66.0)
    size = np.ceil((high - low) * PX_PER_MM).astype(int)
    canvas = _Canvas(low, (int(size[1]), int(size[0])))
    for bone in sorted(bones, key=lambda b: b.front):
        _draw(canvas, bone)
    cloth = _forearm(canvas, rng, front=grip not in _BEHIND)
    at = (anchor - low) * PX_PER_MM
    return HandModel(*_pictures(canvas, cloth, rng), (float(at[0]), float(at[1])), inward + wrist_angle)


def _posed(grip: str, rng: np.random.Generator) -> tuple[list[_Bone], np.ndarray, float]:
    """Bones of a hand whose wrist is the origin, the point on the film's rim, and the direction into the film."""
    size = 1 + rng.normal(0, 0.04)
    palm_seen = grip in _BEHIND
    curl = {"pinch": (8, 14, 10), "fist": (72, 88, 50), "fingers": (14, 22, 16), "flat": (2, 5, 4), "point": (5, 10, 8)}
    fist = {"point": (58, 80, 50)}.get(grip)
    spread = rng.uniform(1.6, 2.6) if grip == "flat" else rng.uniform(0.5, 1.2)
    bones = []
    for k, (base, angle, lengths, wide, thin) in enumerate(_FINGERS):
        flex = np.array(fist if fist and k > 0 else curl[grip]) * rng.uniform(0.75, 1.25) + rng.normal(0, 3, 3)
        start = np.array([base[0], base[1], 0.0]) * size
        bones.append(_Bone(start * [0.08, 0.55, 1] + [0, 0, -2], start, (15.0, 11.5), not palm_seen, blend=16.0))
        sizes = np.array(lengths) * size * rng.uniform(0.95, 1.05)
        way = np.deg2rad(angle * spread + rng.normal(0, 1.5))
        bones += _finger(start, way, sizes, np.deg2rad(flex) * (1 if palm_seen else -1), (wide, thin), not palm_seen)
    bones += _thumb(grip, size, rng)
    ball = 3.0 if palm_seen else -8.0
    bones.append(_Bone(np.array([18.0, 14, ball]), np.array([62.0, 20, ball]), (17.0, 14.0), not palm_seen, blend=11.0))
    reach = rng.uniform(16, 40)
    tip = max(b.stop[0] for b in bones if b.front)
    anchor = np.array([tip - reach, rng.uniform(-6, 10)])
    if grip == "flat":
        anchor = np.array([rng.uniform(60, 130), 0.0])
    elif grip == "point":
        anchor = np.array([tip - reach, 33.0])
    elif grip == "pinch":
        anchor[1] = 34.0
    elif grip == "fist":
        return bones, np.array([bones[-2].stop[0] - 6, 48.0]), np.pi / 2 + np.deg2rad(rng.normal(0, 12))
    return bones, anchor, np.deg2rad(rng.normal(0, 10))


def _finger(
    start: np.ndarray, way: float, lengths: np.ndarray, flex: np.ndarray, radii: tuple[float, float], front: bool
) -> list[_Bone]:
    """Three phalanges from ``start`` along ``way`` (rad, in the picture's plane), bent by ``flex`` towards z."""
    bones, pitch, widths = [], 0.0, np.linspace(radii[0], radii[1], 4)
    for k in range(3):
        pitch += flex[k]
        step = np.array([np.cos(pitch) * np.cos(way), np.cos(pitch) * np.sin(way), np.sin(pitch)]) * lengths[k]
        nail = bool(k == 2 and front and abs(pitch) < 1.0)
        bones.append(_Bone(start, start + step, (widths[k], widths[k + 1]), front, nail, (0.0,) if k else ()))
        start = start + step
    return bones


def _thumb(grip: str, size: float, rng: np.random.Generator) -> list[_Bone]:
    """Metacarpal and two phalanges of the thumb: over the film, or beside it where only finger tips reach over it."""
    if grip == "pinch":
        joints = [(14, 26, 4), (52, 46, 14), (86, 46 + rng.normal(0, 4), 24), (114, 40 + rng.normal(0, 5), 22)]
    elif grip == "fist":
        joints = [(18, 24, 6), (60, 40, 18), (92, 46, 28), (104 + rng.normal(0, 5), 72 + rng.normal(0, 4), 26)]
    elif grip == "flat":
        joints = [(14, 26, -2), (44, 52, -4), (66, 74, -6), (84, 88, -6)]
    else:
        joints = [(14, 26, -8), (50, 42, -18), (84, 40, -24), (108, 34, -22)]
    p = np.array(joints, np.float64) * size
    return [
        _Bone(p[0], p[1], (17.0, 13.5), True, blend=9.0),
        _Bone(p[1], p[2], (12.5, 10.5), True),
        _Bone(p[2], p[3], (10.8, 8.4), True, grip in (*_BEHIND, "flat"), (0.0,)),
    ]


def _rotation(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def _turned(bone: _Bone, angle: float) -> _Bone:
    turn = _rotation(angle)
    return _Bone(turn @ bone.start, turn @ bone.stop, bone.radii, bone.front, bone.nail, bone.creases, bone.blend)


def _draw(canvas: _Canvas, bone: _Bone) -> None:
    """Joins a capsule to the relief, smoothly where the heights are similar."""
    margin = max(bone.radii) + 16
    a, b = bone.start, bone.stop
    box, x, y = canvas.window(np.minimum(a, b)[:2] - margin, np.maximum(a, b)[:2] + margin)
    axis = b - a
    along2 = max(float(axis[:2] @ axis[:2]), 1e-6)
    t = np.clip(((x - a[0]) * axis[0] + (y - a[1]) * axis[1]) / along2, 0, 1)
    off = np.hypot(x - a[0] - t * axis[0], y - a[1] - t * axis[1])
    radius = bone.radii[0] + t * (bone.radii[1] - bone.radii[0])
    edge = radius - off
    length = np.sqrt(along2)
    across = ((y - a[1]) * axis[0] - (x - a[0]) * axis[1]) / length
    arch = np.sqrt(np.maximum(radius**2 - off**2, 0)) + 3 * np.minimum(edge, 0)
    height = a[2] + t * axis[2] + arch
    for at in bone.creases:  # folds of skin over a joint
        for shift in (-2.4, 0.0, 2.6):
            fold = (t - at) * length - shift + 0.02 * across**2
            height = height - 0.35 * np.exp(-((fold / 0.7) ** 2)) * (np.abs(across) < 0.8 * radius)
    if bone.nail:
        oval = ((t * length - length - 0.5) / 6.5) ** 2 + (across / (0.68 * bone.radii[1])) ** 2
        nail = np.clip((1 - oval) * 3.0, 0, 1) * (edge > 0.4)
        height = height + 0.25 * nail - 0.25 * np.exp(-(((oval - 1.05) / 0.12) ** 2))
        canvas.nail[box] = np.where(height > canvas.height[box], nail, canvas.nail[box])
    canvas.height[box] = smooth_max(canvas.height[box], height, bone.blend)
    canvas.edge[box] = smooth_max(canvas.edge[box], edge, 3.0)
    if bone.front:
        canvas.front[box] = smooth_max(canvas.front[box], edge, 3.0)
    warm = np.exp(-(((t - 1) * length / 9) ** 2)) * (edge > -2)
    canvas.blush[box] = np.maximum(canvas.blush[box], warm)


def _forearm(canvas: _Canvas, rng: np.random.Generator, *, front: bool) -> np.ndarray:
    """Draw the forearm and, in most cases, a sleeve with folds; return a mask of the cloth, of 0 and 1."""
    box, x, y = canvas.window(canvas.origin, np.array([30.0, 200.0]))
    arm = 27 + 0.10 * np.maximum(-x, 0) - 0.0006 * x**2
    end = rng.uniform(-70, 0) if rng.random() < 0.75 else -500.0
    wide = arm + rng.uniform(5, 12)
    folds = cv2.GaussianBlur(rng.normal(0, 1, canvas.size), (0, 0), 11.0, sigmaY=26.0)[box]
    folds = folds / max(float(folds.std()), 1e-6) * canvas.ramp[:, box[1]]
    cloth = (x < end + 0.0015 * y**2) & (np.abs(y) < wide + 2)
    edge = np.where(x < end, wide + folds, np.where(x < 8, arm, -60.0)) - np.abs(y)
    edge = edge.astype(np.float32)
    half = np.where(cloth, wide + folds, arm)
    height = 0.75 * np.sqrt(np.maximum(edge * (2 * half - edge), 0)) - 6 + np.where(cloth, 2 + 1.5 * folds, 0)
    height = height + 3 * np.minimum(edge, 0)
    canvas.height[box] = np.where(
        cloth, np.maximum(height, canvas.height[box]), smooth_max(canvas.height[box], height, 5.0)
    )
    canvas.edge[box] = np.where(cloth, np.maximum(edge, canvas.edge[box]), smooth_max(canvas.edge[box], edge, 5.0))
    if front:
        canvas.front[box] = np.maximum(canvas.front[box], canvas.edge[box] * (x < 40) - 60 * (x >= 40))
    mask = np.zeros(canvas.size, np.float32)
    mask[box] = cloth & (edge > -1)
    return mask


def _pictures(canvas: _Canvas, cloth: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The stored 8-bit pictures of a relief."""
    pores = cv2.GaussianBlur(rng.normal(0, 1, canvas.size), (0, 0), 1.0).astype(np.float32)
    height = cv2.GaussianBlur(np.maximum(canvas.height, -75), (0, 0), 0.8) + 0.06 * canvas.ramp * pores
    blotches = cv2.GaussianBlur(rng.normal(0, 1, canvas.size), (0, 0), 9.0).astype(np.float32)
    spots = 0.05 * blotches / blotches.std() + 0.03 * pores / pores.std()
    bright = 1 + canvas.ramp * spots + 0.12 * canvas.nail
    kind = np.maximum(128 * canvas.nail, 255 * cloth)
    skin = coded([EDGE_PER_MM * canvas.front + MIDDLE, 128 * bright, 255 * canvas.blush, kind])
    return coded_shape(height, canvas.edge, PX_PER_MM), skin
