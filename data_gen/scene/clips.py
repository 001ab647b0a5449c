"""What holds a film besides hands: clips, pegs, magnets, tape, the bar of a light box, the frame of a mount."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from data_gen.light.lit_sphere import LitSphere, look_up
from data_gen.scene.patches import Patch
from data_gen.scene.relief import (
    MIDDLE,
    Place,
    affine,
    coded,
    coded_shape,
    contact_shade,
    coverage,
    decoded_normals,
    seen_box,
    warped,
)
from hybrid.coords import centres_1d

PX_PER_MM = 2.5

KINDS = ("bulldog", "foldback", "peg", "magnet", "tape", "bar")
"""bulldog: sheet-steel jaws. foldback: black spring steel with wire levers. bar: along the whole edge."""

HIDING_OPACITY = 0.5
"""Tape of this opacity or less leaves the print readable and does not count as cover in the mask."""


@dataclass(frozen=True)
class Clip:
    """One holder at the film's rim.

    kind: one of KINDS. edge: place on the rim, 0 to 4 from the top-left corner clockwise. turn_deg: rotation about that
    place. width_mm: along the rim. reach_mm: how far it covers the film. colour: linear RGB reflectance. metal: share
    of metallic reflection. opacity: below 1 for see-through tape.
    """

    kind: str
    edge: float
    turn_deg: float
    width_mm: float
    reach_mm: float
    colour: tuple[float, float, float]
    metal: float
    opacity: float


def sample_clips(count: int, rng: np.random.Generator) -> tuple[Clip, ...]:
    """Holders of one kind, ``count`` of them, mostly on the upper edge."""
    kind = str(rng.choice(KINDS, p=[0.2, 0.25, 0.1, 0.15, 0.2, 0.1]))
    width, reach = {
        "bulldog": ((32, 76), (8, 16)),
        "foldback": ((19, 51), (9, 18)),
        "peg": ((8, 14), (12, 28)),
        "magnet": ((12, 36), (4, 30)),
        "tape": ((12, 26), (8, 35)),
        "bar": ((400, 401), (5, 22)),
    }[kind]
    vivid = 10 ** rng.uniform(-1.2, -0.1) * np.exp2(rng.normal(0, 1.0, 3))
    grey = np.full(3, 10 ** rng.uniform(-1.7, -0.2))
    colour = {"foldback": np.full(3, 0.02), "tape": np.array([0.8, 0.78, 0.7]) * rng.uniform(0.7, 1.1)}.get(kind, grey)
    if kind in ("peg", "magnet", "foldback") and rng.random() < 0.5:
        colour = vivid
    elif kind == "peg":
        colour = np.array([0.55, 0.38, 0.2]) * rng.uniform(0.6, 1.3)
    metal = {"bulldog": 0.9, "bar": 0.8 * (rng.random() < 0.6), "magnet": 0.9 * (rng.random() < 0.3)}.get(kind, 0.0)
    opacity = 1.0 if kind != "tape" or rng.random() < 0.3 else rng.uniform(0.12, 0.8)
    wide, deep = rng.uniform(*width), rng.uniform(*reach)
    first = rng.uniform(0.15, 0.6) if rng.random() < 0.7 else rng.uniform(0, 4)
    if kind == "bar":
        first, count = (0.5 if rng.random() < 0.75 else int(rng.integers(4)) + np.float64(1 / 2)), 1
    steps = rng.uniform(0.25, 0.4) if rng.random() < 0.6 else 1.0
    corner = {"tape": 40.0, "bar": 1.0}.get(kind, 7.0)
    red, green, blue = (float(c) for c in np.clip(colour, 0.01, 0.9))
    return tuple(
        Clip(
            kind,
            float((first + steps * k) % 4),
            float(rng.normal(0, corner)),
            float(wide),
            float(deep * rng.uniform(0.8, 1.2)),
            (red, green, blue),
            float(metal),
            float(opacity),
        )
        for k in range(count)
    )


def clip_patch(clip: Clip, place: Place, ball: LitSphere, steel: LitSphere, size: tuple[int, int]) -> Patch | None:
    """A holder in front of the film; None outside the photo. steel: the ball of polished metal."""
    shape, paint, anchor = _model(clip)
    angle = np.arctan2(place.inward[1], place.inward[0]) + np.deg2rad(clip.turn_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    forward = affine(place.px_per_mm / PX_PER_MM * turn, anchor, place.at)
    h, w = shape.shape[:2]
    far = 40.0 * h if clip.kind == "bar" else 0.0  # its rows are alike and continue beyond the picture
    box = seen_box(np.array([[0, -far], [w, h + far]]), forward, size, 10 * place.px_per_mm)
    if box is None:
        return None
    shape, paint = warped(shape, forward, box), warped(paint, forward, box)
    edge = shape[..., 3].astype(np.float32) - MIDDLE
    inside = coverage(edge, place.px_per_mm)
    if not inside.any():
        return None
    normal = decoded_normals(shape, forward)
    reached = shape[..., 2:3] * np.float32(1 / 255)
    colour = (paint[..., :3] * np.float32(1 / 255)) ** 2
    metal = paint[..., 3:] * np.float32(1 / 255)
    matt, mirror = look_up(ball.matt, normal), look_up(steel.gloss, normal)
    radiance = reached * ((1 - metal) * (colour * matt + look_up(ball.gloss, normal)) + metal * mirror)
    cover = inside * np.float32(clip.opacity)
    hides = cover if clip.opacity > HIDING_OPACITY else np.zeros_like(cover)
    shade = np.ones_like(cover) if clip.kind == "tape" else contact_shade(edge, 6.0, 0.35)
    return Patch(box, radiance, cover, hides, shade)


def _model(clip: Clip) -> tuple[UInt8[np.ndarray, "h w 4"], UInt8[np.ndarray, "h w 4"], tuple[float, float]]:
    """Relief and paint (reflectance coded by its square root, share of metal) of a holder, and its point on the rim.

    It is drawn in millimetres, with x from the rim into the film and y along the rim.
    """
    reach, half = clip.reach_mm, clip.width_mm / 2
    before = {"bulldog": 22.0, "foldback": 0.75 * clip.width_mm + 10, "peg": 48.0, "bar": 18.0, "tape": reach}.get(
        clip.kind, 2 * half - reach
    )
    before, side = max(before, 4.0) + 18.0, (6.0 if clip.kind == "bar" else half + 18.0)
    x = centres_1d(int((before + reach + 18.0) * PX_PER_MM))[None, :] / PX_PER_MM - before
    y = centres_1d(int(2 * side * PX_PER_MM))[:, None] / PX_PER_MM - side
    x, y = np.broadcast_arrays(x.astype(np.float32), y.astype(np.float32))
    height, edge, metal = _DRAWN[clip.kind](clip, x, y)
    shape = coded_shape(height.astype(np.float32), edge.astype(np.float32), PX_PER_MM)
    root = [255 * np.sqrt(np.full(x.shape, c)) for c in clip.colour]
    return shape, coded([*root, 255 * metal]), (before * PX_PER_MM, side * PX_PER_MM)


def _slab(
    x: np.ndarray, y: np.ndarray, box: tuple[float | int, float | int, float | int, float | int], corner: float
) -> np.ndarray:
    """Signed distance (positive inside) to a rectangle x0, y0, x1, y1 with rounded corners."""
    x0, y0, x1, y1 = box
    dx = np.abs(x - (x0 + x1) / 2) - (x1 - x0) / 2 + corner
    dy = np.abs(y - (y0 + y1) / 2) - (y1 - y0) / 2 + corner
    return corner - np.hypot(np.maximum(dx, 0), np.maximum(dy, 0)) - np.minimum(np.maximum(dx, dy), 0)


def _raised(edge: np.ndarray, thickness: float, bevel: float) -> np.ndarray:
    """Height of a slab with rounded rims; falls away outside."""
    t = np.clip(edge / bevel, 0, 1)
    return thickness * np.sqrt(t * (2 - t)) + np.minimum(edge, 0)


def _bulldog(clip: Clip, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """Bent sheet steel: a rolled lip on the film, a sloping body, a handle with a hole."""
    half, reach = clip.width_mm / 2, clip.reach_mm
    body = _slab(x, y, (-14.0, -half, reach, half), 2.0)
    handle = _slab(x, y, (-22.0, -0.5 * half, -8.0, 0.5 * half), 5.0)
    hole = np.hypot(x + 16, y) - 2.6
    edge = np.minimum(np.maximum(body, handle), hole)
    roll = 3.5 * np.exp(-(((x - reach + 2) / 2.2) ** 2))
    height = _raised(edge, 2.0, 1.5) + roll + 0.25 * np.maximum(reach - x, 0) * (edge > 0)
    return height, edge, np.full(x.shape, clip.metal)


def _foldback(clip: Clip, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """A painted spring-steel prism and a lever of wire that lies on it or stands away from the film."""
    half, reach = clip.width_mm / 2, clip.reach_mm
    body = _slab(x, y, (-0.35 * clip.width_mm, -half, reach, half), 1.2)
    tip, narrow = 0.75 * clip.width_mm + 8, 0.3 * half  # a wire of 1.1 mm: two arms that converge to a short bend
    loop = narrow + 0.5 * half * np.clip((x + tip) / tip, 0, 1)
    beyond = np.maximum(np.maximum(-tip - x, x - reach + 2), 0)
    arms = np.hypot(np.abs(y) - loop, beyond)
    bend = np.hypot(x + tip, np.maximum(np.abs(y) - narrow, 0))
    wire = 1.1 - np.minimum(arms, bend)
    edge = np.maximum(body, wire)
    roll = 2.5 * np.exp(-(((x - reach + 1.5) / 1.6) ** 2)) * (body > 0)
    height = np.maximum(_raised(body, 3.0, 1.2) + roll + 0.3 * np.maximum(reach - x, 0) * (body > 0), -20.0)
    height = np.where(wire > 0, np.maximum(height, 0) + np.sqrt(np.maximum(1.2 - (1.1 - wire) ** 2, 0)), height)
    return height, edge, np.where(wire > 0, 0.95, clip.metal)


def _peg(clip: Clip, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """A clothes peg seen from above: a tapering bar with a spring's coil across it."""
    half = clip.width_mm / 2
    edge = _slab(x, y, (-48.0, -half, clip.reach_mm, half), 1.5)
    spring = _slab(x, y, (-10.0, -half - 1.5, -4.0, half + 1.5), 1.0)
    height = _raised(edge, 5.0, 2.0) + 0.04 * (clip.reach_mm - x) * (edge > 0)
    coil = spring > 0
    height = np.where(coil, 8 + 0.5 * np.cos(2.6 * y) + 0.3 * (9 - (x + 7) ** 2), height)
    return height, np.maximum(edge, spring), np.where(coil, 0.9, 0.0)


def _magnet(clip: Clip, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """A round button, slightly domed."""
    half = clip.width_mm / 2
    off = np.hypot(x - clip.reach_mm + half, y)
    edge = half - off
    return _raised(edge, 5.0, 2.0) - 0.004 * off**2, edge, np.full(x.shape, clip.metal)


def _tape(clip: Clip, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """A strip with torn ends and a few creases."""
    half, reach = clip.width_mm / 2, clip.reach_mm
    torn = 0.5 * np.sin(2.1 * y) + 0.3 * np.sin(5.7 * y)
    edge = np.minimum(half - np.abs(y), np.minimum(reach + torn - x, x + reach + 12 + torn))
    height = 0.06 * np.sin(0.5 * y + 0.9 * x) + 0.05 * np.sin(2.3 * y - 0.7 * x) + np.minimum(edge, 0)
    return height, edge, np.zeros(x.shape)


def _bar(clip: Clip, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """A rail: flat with a rounded lip on the film."""
    edge = np.minimum(clip.reach_mm - x, x + 18.0)
    lip = 2.0 * np.exp(-(((x - clip.reach_mm + 3) / 2.0) ** 2))
    return _raised(edge, 6.0, 4.0) + lip, edge, np.full(x.shape, clip.metal)


_DRAWN = {
    "bulldog": _bulldog,
    "foldback": _foldback,
    "peg": _peg,
    "magnet": _magnet,
    "tape": _tape,
    "bar": _bar,
}
