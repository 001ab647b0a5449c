"""The film's glossy surface: exact Fresnel reflection, the GGX distribution and the integrals of its lobe.

Notation of Walter et al. 2007 (Microfacet models for refraction through rough surfaces): o towards the eye, i towards
the light, h half way between them, n the normal, alpha = roughness^2, D the GGX density of h, G1 Smith's masking:

    f(i, o) = F(o.h) D(h) G1(i) G1(o) / (4 n.i n.o)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Values = np.ndarray | np.floating
"""An array, or the scalar that numpy returns for one without axes."""

ALBEDO_COSINES = np.linspace(0.0, 1.0, 33) ** 1.5
"""Cosines of the view at which directional albedos are tabulated: denser where the Fresnel term is steep."""

_ALBEDO_SAMPLES = 256

GRAZING_MEAN = 1 / 21
"""Mean of (1 - c)^5 over the cosine-weighted hemisphere."""


@dataclass(frozen=True, eq=False)
class Gloss:
    """Integrated reflection of a rough surface.

    alpha: GGX's width. ior: of the film. surfaces: number of parallel dielectric surfaces above the print.
    albedo: share of even light that the surface reflects towards each of ALBEDO_COSINES.
    mean: cosine-weighted mean of albedo. entry: (a, b) with (1 - albedo(c)) / (1 - mean) ~ a + b (1 - c)^5 for light
    that comes in at cosine c; its cosine-weighted mean a + b / 21 is 1.
    """

    alpha: float
    ior: float
    surfaces: int
    albedo: Float[np.ndarray, " cosines"]
    mean: float
    entry: tuple[float, float]

    def reflected(self, cosine: Values) -> Values:
        """Directional albedo at cosines of the view."""
        return np.interp(cosine, ALBEDO_COSINES, self.albedo).astype(np.float32)

    def entering(self, cosine: Values) -> Values:
        """(1 - albedo) / (1 - mean) at cosines of the light."""
        return (1 - self.reflected(cosine)) / np.float32(1 - self.mean)


def fresnel(cosine: Values, ior: float, surfaces: int = 1) -> Values:
    """Unpolarised reflectance of parallel dielectric surfaces of one refractive index; light bounces between them.

    One surface by Fresnel's equations; n of them reflect n F / (1 + (n - 1) F) (Stokes 1862, without absorption).
    """
    g = np.sqrt(ior**2 - 1 + cosine**2)
    across, along = ((cosine - g) / (cosine + g)) ** 2, ((ior**2 * cosine - g) / (ior**2 * cosine + g)) ** 2
    one = (across + along) / 2
    return one if surfaces == 1 else surfaces * one / (1 + (surfaces - 1) * one)


def smith(cosine: Values, alpha: float) -> Values:
    """Smith's masking G1 of GGX at cosines to the normal; 0 below the horizon."""
    c = np.maximum(cosine, 0.0)
    return 2 * c / (c + np.sqrt(alpha**2 + (1 - alpha**2) * c**2) + 1e-12)


def visible_half(
    cosine: np.ndarray, alpha: float, across: np.ndarray | np.floating | float, aside: np.ndarray | np.floating | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Components (towards the eye's foot, aside, normal) of the half vector for a point of the unit disc.

    cosine: of the view; it and the point (across, aside) are broadcast against each other.

    Points spread evenly over the disc give half vectors distributed like the normals that the eye sees (Heitz 2018,
    Sampling the GGX distribution of visible normals): each then carries the same weight F G1(i).
    """
    sine = np.sqrt(np.maximum(1 - cosine**2, 0.0))
    length = np.sqrt((alpha * sine) ** 2 + cosine**2)
    vx, vz = alpha * sine / length, cosine / length
    s = (1 + vz) / 2
    t2 = (1 - s) * np.sqrt(1 - aside**2) + s * across
    t3 = np.sqrt(np.maximum(1 - aside**2 - t2**2, 0.0))
    # The frame about the stretched view: (-vz, 0, vx) leans away from the eye, (0, 1, 0) lies aside.
    hx, hy, hz = alpha * (t3 * vx - t2 * vz), alpha * aside + 0 * t3, np.maximum(t3 * vz + t2 * vx, 1e-9)
    norm = np.sqrt(hx**2 + hy**2 + hz**2)
    return hx / norm, hy / norm, hz / norm


def spiral_disc(count: int) -> Float[np.ndarray, "count 2"]:
    """Points spread evenly over the unit disc (Vogel's spiral)."""
    k = np.arange(count)
    radius, angle = np.sqrt((2 * k + 1) / (2 * count)), k * np.pi * (3 - np.sqrt(5))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def gloss(roughness: float, ior: float, surfaces: int = 1) -> Gloss:
    """The integrals for one surface."""
    alpha, cosine = roughness**2, np.maximum(ALBEDO_COSINES, 1e-4)
    across, aside = spiral_disc(_ALBEDO_SAMPLES).T[..., None]
    hx, _, hz = visible_half(cosine, alpha, across, aside)
    o_h = np.sqrt(1 - cosine**2) * hx + cosine * hz
    albedo = (fresnel(o_h, ior, surfaces) * smith(2 * o_h * hz - cosine, alpha)).mean(axis=0)
    fine = (np.arange(512) + 1) / 512
    at = np.interp(fine, ALBEDO_COSINES, albedo)
    mean = float((at * fine).sum() / fine.sum())
    basis = np.stack([np.ones_like(fine), (1 - fine) ** 5], axis=1) * np.sqrt(fine)[:, None]
    a, b = np.linalg.lstsq(basis, (1 - at) * np.sqrt(fine), rcond=None)[0]
    scale = a + b * GRAZING_MEAN
    return Gloss(alpha, ior, surfaces, albedo, mean, (float(a / scale), float(b / scale)))
