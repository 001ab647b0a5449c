"""Lamps near the film: bulbs, discs and rectangles, the light they shed on it and their highlights in it.

Everything is in closed form. Light on a matt surface: Lambert's formula for a polygon's vector irradiance, and the
irradiance of a sphere cut by the horizon in place of the polygon's (Hill and Heitz 2016, Real-time area lighting).
Highlights: GGX's density of slopes m of the half vector, alpha^2 / (pi (alpha^2 + m^2)^2), is that of a cosine lobe
seen from height alpha, so the share of it that a lamp's outline encloses is a form factor in the space of half vectors.
Units: mm, radiance relative to the environment's mean of 1, the film's world (x right, y down, z away).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from data_gen.light.gloss import Gloss, fresnel, smith
from hybrid.mesh.vectors import cross, dot, unit

Vector = tuple[float, float, float]
Shape = Literal["sphere", "disc", "rectangle"]

DISC_SIDES = 24
"""Sides of the polygon of equal area that stands for a disc."""

PATCH_SIZE = 0.27
"""Half side of a patch, relative to its lamp's distance."""

_TINY = 1e-20

_ANGLE_OVER_SINE = (
    1.57079558, -0.99990356, 0.78329788, -0.64862699, 0.50905460, -0.32393202, 0.13595128, -0.02663715,
)  # fmt: skip
"""Coefficients, constant term first, of the Chebyshev interpolant on [0, 1]."""


@dataclass(frozen=True)
class Lamp:
    """An emitter of even radiance.

    kind: 'sphere', or a flat 'disc' or 'rectangle' that shines to one side.
    centre_mm: in the film's world, or from the camera's centre where ``at_camera`` (a flash).
    axis: unit, the way a flat lamp shines. across: unit, along its first side. half_mm: half its sides, or radii.
    radiance: linear RGB.
    """

    kind: Shape
    centre_mm: Vector
    axis: Vector
    across: Vector
    half_mm: tuple[float, float]
    radiance: Vector
    at_camera: bool = False

    def placed(self, camera_mm: Float[np.ndarray, "3"]) -> Lamp:
        """The same lamp in the world's frame."""
        if not self.at_camera:
            return self
        centre = tuple((np.array(self.centre_mm) + camera_mm).tolist())
        return replace(self, centre_mm=centre, at_camera=False)

    def patches(self) -> tuple[Lamp, ...]:
        """A rectangle cut into pieces small relative to their distance from the world's origin, the film's place.

        The closed forms evaluate masking, Fresnel term and horizon at one point of a lamp. Other lamps are left whole.
        """
        if self.kind != "rectangle":
            return (self,)
        reach = PATCH_SIZE * float(np.linalg.norm(self.centre_mm))
        columns, rows = (max(1, int(np.ceil(half / reach))) for half in self.half_mm)
        across = np.array(self.across)
        along = cross(np.array(self.axis), across)
        half = (self.half_mm[0] / columns, self.half_mm[1] / rows)
        centres = [
            self.centre_mm + (2 * i + 1 - columns) * half[0] * across + (2 * j + 1 - rows) * half[1] * along
            for i in range(columns)
            for j in range(rows)
        ]
        return tuple(replace(self, centre_mm=tuple(centre.tolist()), half_mm=half) for centre in centres)

    @property
    def corners(self) -> Float[np.ndarray, "m 3"]:
        """Outline of a flat lamp, counter-clockwise as seen from where it shines."""
        across, axis = np.array(self.across), np.array(self.axis)
        if self.kind == "rectangle":
            outline = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self.half_mm
        else:
            turn = np.arange(DISC_SIDES) * (2 * np.pi / DISC_SIDES)
            area = DISC_SIDES / 2 * np.sin(2 * np.pi / DISC_SIDES)
            outline = np.stack([np.cos(turn), np.sin(turn)], axis=1) * self.half_mm * np.sqrt(np.pi / area)
        return self.centre_mm + outline @ np.stack([across, cross(axis, across)])


# ---------------------------------------------------------------- light on a matt surface


def vector_irradiance(lamp: Lamp, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Integral of the direction to the lamp over the solid angle it fills: its dot product with a normal is the
    irradiance from a lamp of radiance 1 that is wholly above the horizon. 0 behind a flat lamp."""
    points = points.astype(np.float32)
    centre = np.array(lamp.centre_mm, np.float32) - points
    if lamp.kind == "sphere":
        squared = np.maximum(dot(centre, centre), np.float32(lamp.half_mm[0] ** 2))[..., None]
        return np.float32(np.pi * lamp.half_mm[0] ** 2) * centre / squared**1.5
    total = _edge_sum(unit(_to_corners(lamp, points)))
    lit = (dot(centre, np.array(lamp.axis, np.float32)) < 0)[..., None]
    return np.where(lit, total * np.float32(-0.5), np.float32(0.0))


def surface_irradiance(
    vector: Float[np.ndarray, "*n 3"], normals: Float[np.ndarray, "*n 3"]
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Irradiance on surfaces for radiance 1, and the cosine of the lamp's direction, from the vector irradiance.

    A lamp that the horizon cuts is replaced by the sphere of the same vector irradiance, whose integral has a closed
    form.
    """
    size = np.sqrt(dot(vector, vector)) + np.float32(_TINY)
    cosine = np.clip(dot(vector, normals) / size, -1.0, 1.0)
    squared_sine = np.clip(size / np.float32(np.pi), 1e-12, 0.9999)  # of the sphere's angular radius
    whole = np.float32(np.pi) * np.maximum(cosine, 0.0) * squared_sine
    cut = np.flatnonzero(cosine**2 < squared_sine)
    if len(cut):
        whole.reshape(-1)[cut] = _cut_sphere(cosine.reshape(-1)[cut], squared_sine.reshape(-1)[cut])
    return whole, cosine


def _cut_sphere(cosine: np.ndarray, squared_sine: np.ndarray) -> np.ndarray:
    """Irradiance for radiance 1 of a sphere that the horizon cuts (Quilez 2014, after Snyder's area formulas)."""
    c, squared = cosine.astype(np.float64), 1 / squared_sine.astype(np.float64)  # (distance / radius)^2
    root = np.sqrt(np.maximum(1 - squared * c**2, 1e-12))
    inner = np.clip(-c * np.sqrt((squared - 1) / np.maximum(1 - c**2, 1e-12)), -1, 1)
    part = (c * np.arccos(inner) - root * np.sqrt(squared - 1)) / squared + np.arctan(root / np.sqrt(squared - 1))
    return np.maximum(part, 0.0).astype(np.float32)


# ---------------------------------------------------------------- highlights


def highlight(
    lamp: Lamp,
    points: Float[np.ndarray, "*n 3"],
    normals: Float[np.ndarray, "*n 3"],
    view: Float[np.ndarray, "*n 3"],
    gloss: Gloss,
    alpha: float,
) -> Float[np.ndarray, "*n"]:
    """Radiance towards ``view`` that a glossy surface reflects from a lamp of radiance 1.

    alpha: width of the lobe, that of the surface or wider where the lattice could not resolve it.
    """
    cosine = np.maximum(dot(normals, view), np.float32(1e-3))
    offset = np.array(lamp.centre_mm, np.float32) - points
    above = dot(offset, normals) > 0
    if lamp.kind == "sphere":
        share, half = _sphere_share(lamp, offset, normals, view, unit(offset), alpha)
    else:
        share, half = _polygon_share(lamp, points, normals, view, alpha)
        above &= dot(offset, np.array(lamp.axis, np.float32)) < 0
    o_h, n_h = np.maximum(dot(view, half), np.float32(1e-4)), np.maximum(dot(normals, half), np.float32(1e-3))
    n_i = 2 * o_h * n_h - cosine
    masking = smith(n_i, gloss.alpha) * smith(cosine, gloss.alpha)
    weight = fresnel(o_h, gloss.ior, gloss.surfaces) * masking * o_h / (cosine * n_h)
    return np.where(above, share * weight, np.float32(0)).astype(np.float32)


def _sphere_share(
    lamp: Lamp,
    offset: Float[np.ndarray, "*n 3"],
    normals: Float[np.ndarray, "*n 3"],
    view: Float[np.ndarray, "*n 3"],
    towards: Float[np.ndarray, "*n 3"],
    alpha: float,
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n 3"]]:
    """Share of the slopes that a bulb at ``offset`` (mm) fills, as a disc of equal area, and its centre's half vector.

    The form factor of a disc of radius s at offset d, seen from height 1: (1 - (1 + d^2 - s^2) / sqrt((1 + d^2 +
    s^2)^2 - 4 s^2 d^2)) / 2, rewritten to avoid the difference of nearly equal numbers.
    """
    half = unit(towards + view)
    n_h, o_h = np.maximum(dot(normals, half), np.float32(1e-3)), np.maximum(dot(view, half), np.float32(1e-3))
    squared = dot(offset, offset)
    solid_angle = np.pi * lamp.half_mm[0] ** 2 / np.maximum(squared, lamp.half_mm[0] ** 2)
    s2 = solid_angle / (4 * o_h * n_h**3 * np.pi * alpha**2)
    d2 = (1 / n_h**2 - 1) / alpha**2
    q = 1 + d2 - s2
    root = np.sqrt(q**2 + 4 * s2)  # (1 + d^2 + s^2)^2 - 4 s^2 d^2
    return np.where(q > 0, 2 * s2 / (root * (root + np.maximum(q, 0))), (1 - q / root) / 2), half


def _polygon_share(
    lamp: Lamp,
    points: Float[np.ndarray, "*n 3"],
    normals: Float[np.ndarray, "*n 3"],
    view: Float[np.ndarray, "*n 3"],
    alpha: float,
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n 3"]]:
    """Share of the slopes that a flat lamp's outline encloses, and their mean half vector.

    Half vectors are shrunk along the normal by alpha: there GGX is a cosine lobe and Lambert's formula holds.
    """
    half = unit(_to_corners(lamp, points)) + view
    along = np.maximum(dot(half, normals), np.float32(1e-4))
    total = _edge_sum(unit(half - ((1 - np.float32(alpha)) * along)[..., None] * normals))
    along = dot(total, normals)
    half = total + ((1 / np.float32(alpha) - 1) * along)[..., None] * normals
    return np.abs(along) / np.float32(2 * np.pi), unit(half * np.sign(along)[..., None])


def _to_corners(lamp: Lamp, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "m *n 3"]:
    """From the points to each corner of a flat lamp's outline (mm, float32, planar)."""
    corners = lamp.corners.astype(np.float32).reshape(-1, *(1,) * (points.ndim - 1), 3)
    return np.moveaxis(np.stack([corners[..., k] - points[..., k] for k in range(3)]), 0, -1)


def _edge_sum(outline: Float[np.ndarray, "m *n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Sum over a spherical polygon's edges of their angle times their axis: minus twice the vector irradiance."""
    after = np.roll(outline, -1, axis=0)
    return (cross(outline, after) * _angle_over_sine(dot(outline, after))[..., None]).sum(axis=0)


def _angle_over_sine(cosine: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """arccos(c) / sqrt(1 - c^2): a polynomial accurate to 1e-6 for c >= 0, and pi / sqrt(1 - c^2) minus that below."""
    size = np.minimum(np.abs(cosine), np.float32(1))
    value = np.full_like(size, _ANGLE_OVER_SINE[-1])
    for coefficient in _ANGLE_OVER_SINE[-2::-1]:
        value *= size
        value += np.float32(coefficient)
    blunt = cosine < 0
    if blunt.any():
        sine = np.sqrt(np.maximum(1 - size[blunt] ** 2, np.float32(1e-7)))
        value[blunt] = np.float32(np.pi) / sine - value[blunt]
    return value


def lamp_seen(lamp: Lamp, points: Float[np.ndarray, "*n 3"], rays: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
    """Whether unit rays from the points meet the lamp's bright side."""
    centre = np.array(lamp.centre_mm, rays.dtype) - points.astype(rays.dtype)
    if lamp.kind == "sphere":
        along = dot(centre, rays)
        return (along > 0) & (dot(centre, centre) - along**2 < lamp.half_mm[0] ** 2)
    axis, across = np.array(lamp.axis, rays.dtype), np.array(lamp.across, rays.dtype)
    facing, depth = dot(rays, axis), dot(centre, axis)
    reach = depth / np.where(np.abs(facing) < 1e-9, rays.dtype.type(1e-9), facing)
    offset = rays * reach[..., None] - centre
    a, b = dot(offset, across) / lamp.half_mm[0], dot(offset, cross(axis, across)) / lamp.half_mm[1]
    inside = np.maximum(np.abs(a), np.abs(b)) < 1 if lamp.kind == "rectangle" else a**2 + b**2 < 1
    return (facing < 0) & (depth < 0) & inside


# ---------------------------------------------------------------- colour, random lamps


def planckian(kelvin: float) -> Float[np.ndarray, "3"]:
    """Linear sRGB, luminance 1, of a black body, with daylight (6504 K) white.

    Chromaticity by Kang et al. 2002 (1667 to 25000 K), within 0.002 of the exact locus.
    """
    t = 1e3 / kelvin
    if kelvin < 4000:
        x = -0.2661239 * t**3 - 0.2343589 * t**2 + 0.8776956 * t + 0.179910
    else:
        x = -3.0258469 * t**3 + 2.1070379 * t**2 + 0.2226347 * t + 0.240390
    if kelvin < 2222:
        y = -1.1063814 * x**3 - 1.34811020 * x**2 + 2.18555832 * x - 0.20219683
    elif kelvin < 4000:
        y = -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867
    else:
        y = 3.0817580 * x**3 - 5.87338670 * x**2 + 3.75112997 * x - 0.37001483
    xyz = np.array([x / y, 1.0, (1 - x - y) / y])
    rgb = np.maximum(_SRGB_FROM_XYZ @ xyz, 0.02)
    return rgb / (_SRGB_FROM_XYZ_LUMINANCE @ rgb)


_SRGB_FROM_XYZ = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
)
_SRGB_FROM_XYZ_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
