"""Paints the procedural rooms and outdoor scenes of light/rooms.py: radiance by direction, not calibrated.

A room is a box around the film; each of its six faces is painted in its own coordinates in metres, so straight things
look straight in a reflection. Radiance 1 is a well-lit white wall.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

Face = tuple[int, int]
"""(axis, sign): (2, 1) is the ceiling, (2, -1) the floor, the others are walls."""

FLOOR, CEILING = (2, -1), (2, 1)


@dataclass(frozen=True, eq=False)
class _Hits:
    """Where rays meet one face: their flat indices, and metres along the face (a across, b up or across)."""

    index: Int[np.ndarray, " n"]
    a: Float[np.ndarray, " n"]
    b: Float[np.ndarray, " n"]
    span_a: tuple[float, float]
    span_b: tuple[float, float]


def paint_room(rng: np.random.Generator, rays: Float[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """Radiance of a room seen from where the film is, for unit ``rays``: by day, by lamps or dark, or a corridor."""
    near, far = rng.uniform(0.5, 4.0, 3), rng.uniform(0.8, 6.0, 3)
    near[2], far[2] = rng.uniform(0.6, 1.4), rng.uniform(1.0, 2.2)  # height of the film, and of the ceiling above it
    corridor = rng.random() < 0.15
    if corridor:
        near[:2], far[:2] = (rng.uniform(0.5, 1.6), rng.uniform(3, 12)), (rng.uniform(0.5, 1.6), rng.uniform(3, 25))
    out = np.zeros((rays.shape[0] * rays.shape[1], 3), np.float32)
    hits = _intersect(rays, near, far)
    light_colour = _tint(rng, 0.25)
    wall_colour = _tint(rng, 0.1 if corridor else 0.25) * (
        rng.uniform(0.6, 0.9) if corridor else rng.uniform(0.15, 0.9)
    )
    day, dark = rng.random() < 0.6, rng.random() < 0.15  # dark: shutters closed, lamps off; a screen or spot is left
    for face, hit in hits.items():
        colour = wall_colour * _tint(rng, 0.06)
        if face == FLOOR:
            colour = _tint(rng, 0.5) * rng.uniform(0.05, 0.5)
        elif face == CEILING:
            colour = _tint(rng, 0.05) * rng.uniform(0.5, 0.95)
        out[hit.index] = _surface(rng, hit) * (colour * light_colour)
    for face, hit in hits.items():
        if face == CEILING:
            _add_ceiling_lamps(rng, out, hit, light_colour, on=corridor or not (dark or (day and rng.random() < 0.5)))
        else:
            _add_wall_things(rng, out, hit, face == FLOOR, day and not dark)
        if day and not dark and face != CEILING and rng.random() < 0.12:
            _add_sunlight(rng, out, hit)
    image = out.reshape(rays.shape) * np.exp(rng.uniform(0.02, 0.12) * _noise(rng, rays.shape[:2], 120))[..., None]
    _add_lamp_spots(rng, image, rays)
    return np.roll(cv2.GaussianBlur(image, (3, 3), 0.7), int(rng.integers(rays.shape[1])), axis=1)


def paint_outdoors(rng: np.random.Generator, rays: Float[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """Radiance outdoors: sky with clouds and perhaps the sun, ground, trees or buildings at the horizon."""
    height, width = rays.shape[:2]
    up = rays[:, :1, 2:3]
    zenith, haze = np.array([0.35, 0.55, 1.0], np.float32), np.array([0.95, 0.95, 1.0], np.float32) * _tint(rng, 0.2)
    sky = (haze + (zenith - haze) * np.sqrt(np.maximum(up, 0.0)) * rng.uniform(0.2, 1.0)) * rng.uniform(1.5, 5.0)
    ground = _tint(rng, 0.5) * rng.uniform(0.1, 0.5)
    image = np.where(up > 0, sky, ground).astype(np.float32) * np.ones((1, width, 1), np.float32)
    cloud = _noise(rng, rays.shape[:2], int(rng.integers(4, 12)))
    image *= np.exp(rng.uniform(0.1, 0.7) * cloud)[..., None]
    skyline = height * 0.5 - height * rng.uniform(0.0, 0.25) * np.abs(
        _noise(rng, (1, width), int(rng.integers(6, 24)))[0]
    )
    below = (np.arange(height)[:, None] > skyline) & (np.arange(height)[:, None] <= height // 2)
    leaves = np.exp(0.6 * _noise(rng, rays.shape[:2], 40))[..., None] * (_tint(rng, 0.6) * rng.uniform(0.08, 0.6))
    image = np.where(below[..., None], leaves, image)
    if rng.random() < 0.6:
        sun = _direction(rng, rng.uniform(0.1, 1.4))
        image += _tint(rng, 0.15) * _log_uniform(rng, 500.0, 2e4) * _spot(rays, sun, rng.uniform(0.01, 0.02))
        image += rng.uniform(0.5, 3.0) * _spot(rays, sun, rng.uniform(0.1, 0.4))
    return image.astype(np.float32)


# ---------------------------------------------------------------- the box


def _intersect(
    rays: Float[np.ndarray, "H W 3"], near: Float[np.ndarray, " 3"], far: Float[np.ndarray, " 3"]
) -> dict[Face, _Hits]:
    """Hits of each face of the box [-near, far]."""
    flat = np.ascontiguousarray(rays.reshape(-1, 3).T)
    x, y, z = (
        np.where(way > 0, np.float32(far[k]), np.float32(near[k])) / np.maximum(np.abs(way), np.float32(1e-6))
        for k, way in enumerate(flat)
    )
    axis = np.where(z < np.minimum(x, y), 2, (y < x).astype(np.uint8))
    hits: dict[Face, _Hits] = {}
    for k in range(3):
        across, up = ((1, 2), (0, 2), (0, 1))[k]
        for sign in (-1, 1):
            index = np.flatnonzero((axis == k) & (flat[k] * sign > 0))
            reach = (x, y, z)[k][index]
            spans = [(-float(near[m]), float(far[m])) for m in (across, up)]
            hits[k, sign] = _Hits(index, flat[across, index] * reach, flat[up, index] * reach, spans[0], spans[1])
    return hits


def _surface(rng: np.random.Generator, hit: _Hits) -> Float[np.ndarray, "n 1"]:
    """Brightness of a bare face: darker in the corners, a gradient, blotches."""
    edge_a = np.minimum(hit.a - hit.span_a[0], hit.span_a[1] - hit.a)
    edge_b = np.minimum(hit.b - hit.span_b[0], hit.span_b[1] - hit.b)
    corner = np.exp(-edge_a / rng.uniform(0.2, 0.6)) + np.exp(-edge_b / rng.uniform(0.2, 0.6))
    centre_a, centre_b = (rng.uniform(*span) for span in (hit.span_a, hit.span_b))
    size = rng.uniform(1.0, 4.0)
    pool = np.exp(-((hit.a - centre_a) ** 2 + (hit.b - centre_b) ** 2) / (2 * size**2))
    phase = rng.uniform(0, 6.3, 4).astype(np.float32)
    blotch = np.sin(2.1 * hit.a + phase[0] + np.sin(1.7 * hit.b + phase[1])) * np.sin(2.7 * hit.b + phase[2])
    blotch = blotch + _pattern(rng, hit)
    shade = (0.4 + rng.uniform(0.2, 1.2) * pool) * (1 - rng.uniform(0.1, 0.4) * corner) * (1 + 0.06 * blotch)
    return np.maximum(shade, 0.02)[:, None].astype(np.float32)


def _pattern(rng: np.random.Generator, hit: _Hits) -> Float[np.ndarray, " n"] | float:
    """Planks, tiles or panels: steps of brightness from one to the next, dark joints; often nothing."""
    if rng.random() < 0.5:
        return 0.0
    pitch_a, pitch_b = rng.uniform(0.1, 0.8), rng.uniform(0.1, 2.5)
    row = np.floor(hit.b / pitch_b)
    a, b = hit.a / pitch_a + 0.37 * row, hit.b / pitch_b
    hashed = np.sin(12.9898 * np.floor(a) + 78.233 * row) * 43758.5453  # the usual shader hash: no table needed
    joint = (a % 1.0 < 0.02 / pitch_a) | (b % 1.0 < 0.02 / pitch_b)
    strength = rng.uniform(0.5, 4.0)
    return strength * (2.0 * (hashed % 1.0) - 1.0) - 6.0 * joint


def _rectangle(hit: _Hits, a: tuple[float, float], b: tuple[float, float]) -> Int[np.ndarray, " m"]:
    """Positions within ``hit`` of what lies inside a rectangle."""
    return np.flatnonzero((hit.a >= a[0]) & (hit.a <= a[1]) & (hit.b >= b[0]) & (hit.b <= b[1]))


def _place(rng: np.random.Generator, span: tuple[float, float], length: float) -> tuple[float, float]:
    """A random interval of ``length`` inside ``span``, clipped to it."""
    start = rng.uniform(span[0], max(span[1] - length, span[0] + 1e-3))
    return start, min(start + length, span[1])


# ---------------------------------------------------------------- things


def _add_ceiling_lamps(
    rng: np.random.Generator, out: Float[np.ndarray, "n 3"], hit: _Hits, tint: Float[np.ndarray, " 3"], on: bool
) -> None:
    """A row or a lattice of round lamps, tubes or panels."""
    if not len(hit.index):
        return
    radiance = tint * (_log_uniform(rng, 8.0, 250.0) if on else rng.uniform(0.5, 1.2))
    pitch_a, pitch_b = rng.uniform(0.8, 3.0), rng.uniform(0.8, 3.0)
    a = (hit.a - rng.uniform(0, pitch_a)) % pitch_a - pitch_a / 2
    b = (hit.b - rng.uniform(0, pitch_b)) % pitch_b - pitch_b / 2
    kind = rng.integers(4)
    if kind == 0:
        lit = a**2 + b**2 < rng.uniform(0.04, 0.2) ** 2
    elif kind == 1:
        lit = (np.abs(a) < rng.uniform(0.02, 0.06)) & (np.abs(b) < rng.uniform(0.3, 0.7))
    elif kind == 2:
        lit = (np.abs(a) < rng.uniform(0.15, 0.3)) & (np.abs(b) < rng.uniform(0.15, 0.6))
    else:
        lit = (hit.a - rng.uniform(*hit.span_a)) ** 2 + (hit.b - rng.uniform(*hit.span_b)) ** 2 < rng.uniform(
            0.1, 0.4
        ) ** 2
    out[hit.index[lit]] = radiance


def _add_wall_things(
    rng: np.random.Generator, out: Float[np.ndarray, "n 3"], hit: _Hits, floor: bool, day: bool
) -> None:
    """Clutter everywhere; on walls also doors, shelves, pictures, screens and windows."""
    for _ in range(int(rng.integers(4, 36))):
        length, height = (_log_uniform(rng, 0.03, 1.6) for _ in range(2))
        low = rng.uniform(*hit.span_b) if floor or rng.random() < 0.3 else hit.span_b[0]
        inside = _rectangle(hit, _place(rng, hit.span_a, length), (low, low + height))
        out[hit.index[inside]] = _tint(rng, 0.7) * rng.uniform(0.02, 0.9)
    if floor:
        return
    if rng.random() < 0.3:  # a door
        inside = _rectangle(hit, _place(rng, hit.span_a, 0.9), (hit.span_b[0], hit.span_b[0] + 2.0))
        out[hit.index[inside]] = _tint(rng, 0.5) * rng.uniform(0.05, 0.8)
    if rng.random() < 0.35:
        _add_shelf(rng, out, hit)
    if rng.random() < 0.15:  # a screen or light box
        low = rng.uniform(-0.4, 0.6)
        inside = _rectangle(hit, _place(rng, hit.span_a, rng.uniform(0.3, 1.2)), (low, low + rng.uniform(0.2, 0.7)))
        out[hit.index[inside]] = _tint(rng, 0.2) * rng.uniform(1.0, 8.0)
    if rng.random() < 0.45:
        _add_windows(rng, out, hit, day)


def _add_shelf(rng: np.random.Generator, out: Float[np.ndarray, "n 3"], hit: _Hits) -> None:
    inside = _rectangle(hit, _place(rng, hit.span_a, rng.uniform(0.6, 2.5)), (hit.span_b[0], rng.uniform(0.2, 1.2)))
    pitch_a, pitch_b = rng.uniform(0.04, 0.4), rng.uniform(0.25, 0.45)
    book = np.floor(hit.a[inside] / pitch_a).astype(int) * 31 + np.floor(hit.b[inside] / pitch_b).astype(int) * 57
    palette = (_tint(rng, 0.3) * rng.uniform(0.02, 0.8, (32, 1)) * rng.uniform(0.6, 1.4, (32, 3))).astype(np.float32)
    out[hit.index[inside]] = palette[book % 32]


def _add_windows(rng: np.random.Generator, out: Float[np.ndarray, "n 3"], hit: _Hits, day: bool) -> None:
    """One to four windows in a row: bright panes with a sky gradient and things outside, frames and bars."""
    width, height, sill = rng.uniform(0.4, 2.0), rng.uniform(0.7, 1.9), rng.uniform(-0.5, 0.4)
    start, bars_a, bars_b = rng.uniform(*hit.span_a), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    radiance = _log_uniform(rng, 15.0, 200.0) if day else rng.uniform(0.01, 0.3)
    sky, outside = _tint(rng, 0.25), _tint(rng, 0.6) * rng.uniform(0.05, 0.6)
    frame = _tint(rng, 0.1) * rng.uniform(0.1, 1.0)
    thickness, phase = rng.uniform(0.02, 0.06), rng.uniform(0, 6.3)
    for k in range(int(rng.integers(1, 5))):
        left = start + k * (width + 0.25)
        inside = _rectangle(hit, (left, left + width), (sill, sill + height))
        a, b = (hit.a[inside] - left) / width, (hit.b[inside] - sill) / height
        horizon = 0.35 + 0.15 * np.sin(7 * a + phase + k) + 0.05 * np.sin(23 * a)
        pane = np.where((b > horizon)[:, None], sky * (0.6 + 0.4 * b[:, None]), outside) * radiance
        bar = (np.abs((a * bars_a) % 1.0 - 1.0) * width / bars_a < thickness) | (
            np.abs((b * bars_b) % 1.0) * height / bars_b < thickness
        )
        edge = _at_edge(a, thickness / width) | _at_edge(b, thickness / height)
        out[hit.index[inside]] = np.where((bar | edge)[:, None], frame, pane)


def _add_sunlight(rng: np.random.Generator, out: Float[np.ndarray, "n 3"], hit: _Hits) -> None:
    """Sunlight that falls through a window's panes: sheared bright patches, several dozen times the shade."""
    shear, bars = rng.uniform(-1.0, 1.0), int(rng.integers(1, 4))
    (start, stop), (low, high) = (
        _place(rng, hit.span_a, rng.uniform(0.3, 1.2)),
        _place(rng, hit.span_b, rng.uniform(0.3, 1.2)),
    )
    a, b = (hit.a - shear * (hit.b - low) - start) / (stop - start), (hit.b - low) / max(high - low, 1e-3)
    lit = (a > 0) & (a < 1) & (b > 0) & (b < 1) & ~_at_edge((a * bars) % 1.0, 0.06) & ~_at_edge((b * bars) % 1.0, 0.06)
    out[hit.index[lit]] *= _tint(rng, 0.1) * _log_uniform(rng, 8.0, 50.0)


def _at_edge(t: Float[np.ndarray, " n"], share: float) -> Bool[np.ndarray, " n"]:
    return np.minimum(t, 1.0 - t) < share


def _add_lamp_spots(
    rng: np.random.Generator, image: Float[np.ndarray, "H W 3"], rays: Float[np.ndarray, "H W 3"]
) -> None:
    """Desk and floor lamps: small bright spots with a halo."""
    for _ in range(int(rng.integers(0, 3))):
        centre = _direction(rng, rng.uniform(-0.2, 0.8))
        radiance = _tint(rng, 0.3) * _log_uniform(rng, 30.0, 2000.0)
        image += radiance * _spot(rays, centre, rng.uniform(0.012, 0.05))
        image += 0.002 * radiance * _spot(rays, centre, rng.uniform(0.15, 0.5))


# ---------------------------------------------------------------- small tools


def _tint(rng: np.random.Generator, strength: float) -> Float[np.ndarray, " 3"]:
    """A colour of mean 1, whiter for small ``strength``; mostly between orange and blue, as lamps and walls are."""
    warm = rng.uniform(-1.0, 1.0) * np.array([1.0, 0.1, -1.0])
    colour = np.maximum(1.0 + strength * (warm + 0.35 * rng.uniform(-1.0, 1.0, 3)), 0.05)
    return (colour / colour.mean()).astype(np.float32)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _direction(rng: np.random.Generator, elevation: float) -> Float[np.ndarray, " 3"]:
    azimuth = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])


def _spot(
    rays: Float[np.ndarray, "H W 3"], centre: Float[np.ndarray, " 3"], radius: float
) -> Float[np.ndarray, "H W 1"]:
    """1 within ``radius`` radians of a direction, falling off smoothly beyond it."""
    squared = 2.0 - 2.0 * (rays @ centre.astype(np.float32))  # chord squared, near the angle squared
    return np.exp(-np.minimum((squared / radius**2) ** 2, 50.0))[..., None].astype(np.float32)


def _noise(rng: np.random.Generator, size: tuple[int, int], cells: int) -> Float[np.ndarray, "H W"]:
    """Smooth noise of unit variance with about ``cells`` blobs around; it is continuous across the seam."""
    small = rng.standard_normal((max(2, cells // 2) if size[0] > 1 else 1, cells)).astype(np.float32)
    wrapped = np.concatenate([small, small[:, :1]], axis=1)
    return cv2.resize(wrapped, size[::-1], interpolation=cv2.INTER_CUBIC)
