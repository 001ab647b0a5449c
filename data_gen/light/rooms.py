"""Light from all around: environments, lookup by direction, and versions blurred for rough surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Complex, Float

from data_gen.light.gloss import GRAZING_MEAN
from data_gen.light.room_paint import paint_outdoors, paint_room
from data_gen.light.sphere import SphereLookup, directions, solid_angles
from hybrid.coords import centres_1d, rgb_from_bgr
from hybrid.errors import DataError, describe

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
"""Rec. 709 weights of linear RGB."""

ENVIRONMENT_SIZE = (256, 512)
"""Of procedural rooms: 0.7 degrees per pixel."""

HDRI_SIZE = (512, 1024)
"""Of environments from files: sharp enough for a mirror-like film at 1080 px."""

ROUGHNESS_LEVELS = (0.14, 0.2, 0.28, 0.4)

MAX_RELATIVE_RADIANCE = 3000.0
"""The sun of an HDR file is clipped here (times the mean), as brighter points add noise to blurred reflections. A sunny
sky may lose three quarters of its energy by that, and a quarter of the irradiance of what faces the sun."""


@dataclass(frozen=True, eq=False)
class Environment:
    """Light that comes from infinitely far away.

    radiance: (H, W, 3) linear RGB, equirectangular; row 0 looks straight up (+z of the world), columns run over
        azimuth: column centre c is at 2 pi (c + 1/2) / W from +x towards +y. Scaled so that the mean luminance over
        the sphere is near 1.
    """

    radiance: Float[np.ndarray, "H W 3"]
    name: str

    def __post_init__(self) -> None:
        shape = self.radiance.shape
        if len(shape) != 3 or shape[2] != 3 or min(shape[:2]) < 2:
            raise DataError(
                describe(what="Environment", where=self.name, got=shape, allowed="(H, W, 3)", do="Give an RGB image")
            )
        if not np.isfinite(self.radiance).all() or self.radiance.min() < 0:
            raise DataError(
                describe(
                    what="Environment",
                    where=self.name,
                    got="NaN, infinite or negative radiance",
                    allowed="finite values >= 0",
                    do="Repair or drop the file",
                )
            )


@dataclass(frozen=True, eq=False)
class FilteredEnvironment:
    """An environment and what rough surfaces see of it.

    roughness: the levels, ascending, each in (0, 1].
    stack: for each level the radiance seen by a GGX lobe of that roughness around the mirror direction; the finer the
        lobe, the finer the image.
    irradiance: (h, w, 3) integral of radiance times c, the cosine to a normal, over the hemisphere around it.
    grazing: (h, w, 3) integral of radiance times c (1 - c)^5: what a smooth surface keeps from entering.
    coarse: (rows, columns, 3) the radiance itself at low resolution. medium: the same at a higher one.
    """

    environment: Environment
    roughness: tuple[float, ...]
    stack: tuple[Float[np.ndarray, "_ _ 3"], ...]
    irradiance: Float[np.ndarray, "h w 3"]
    grazing: Float[np.ndarray, "h w 3"]
    coarse: Float[np.ndarray, "rows columns 3"]
    medium: Float[np.ndarray, "r c 3"]


def mean_luminance(radiance: Float[np.ndarray, "H W 3"]) -> float:
    """Luminance averaged over the sphere."""
    weights = solid_angles(radiance.shape[:2]) / (4 * np.pi)
    return float(weights @ (radiance @ LUMINANCE).sum(axis=1))


def resize_environment(radiance: Float[np.ndarray, "H W 3"], size: tuple[int, int]) -> Float[np.ndarray, "h w 3"]:
    """Average over the new pixels, weighted by area in the picture and by solid angle on the sphere."""
    if radiance.shape[:2] == size:
        return radiance
    weight = solid_angles(radiance.shape[:2])[:, None].astype(np.float32)
    both = cv2.resize(radiance * weight[..., None], size[::-1], interpolation=cv2.INTER_AREA)
    return both / cv2.resize(weight, (1, size[0]), interpolation=cv2.INTER_AREA).reshape(-1, 1, 1)


def scaled_environment(radiance: Float[np.ndarray, "H W 3"], name: str) -> Environment:
    """The environment at mean luminance 1, its brightest points clipped."""
    mean = mean_luminance(radiance)
    if not mean > 0:
        raise DataError(describe(what="Environment", where=name, got="no light at all", do="Drop the file"))
    limited = np.minimum(radiance / np.float32(mean), np.float32(MAX_RELATIVE_RADIANCE))
    return Environment(limited / np.float32(mean_luminance(limited)), name)


def load_hdri(path: Path | str, size: tuple[int, int] = HDRI_SIZE) -> Environment:
    """An equirectangular Radiance RGBE (or other float) image, averaged down to ``size`` and scaled to mean 1.

    Raises DataError if OpenCV cannot read it.
    """
    path = Path(path)
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
    if image is None or image.ndim != 3 or image.shape[2] < 3 or image.dtype != np.float32:
        raise DataError(
            describe(
                what="Environment file",
                where=path,
                got="no readable high dynamic range image",
                allowed="Radiance .hdr, equirectangular",
                do="Check the path, or leave the option out to use the built-in rooms",
            )
        )
    seen = np.fliplr(image[..., :3])  # files show the room from within, where azimuth grows to the left
    rgb = np.maximum(np.nan_to_num(rgb_from_bgr(seen)), 0.0).astype(np.float32)
    return scaled_environment(resize_environment(rgb, size), path.stem)


def load_environments(folder: Path | str) -> list[Environment]:
    """Every ``.hdr`` file under ``folder`` in sorted order; DataError if there is none."""
    paths = sorted(Path(folder).rglob("*.hdr"))
    if not paths:
        raise DataError(
            describe(
                what="Environment folder",
                where=folder,
                got="no .hdr file",
                do="Give a folder with Radiance .hdr files, or leave the option out to use the built-in rooms",
            )
        )
    return [load_hdri(path) for path in paths]


# ---------------------------------------------------------------- lookup


def sample_environment(env: Environment, directions: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Radiance (float32) from unit world directions (z up), bilinear between pixel centres, wrapping in azimuth."""
    return SphereLookup(directions).values(env.radiance)


# ---------------------------------------------------------------- procedural


def procedural_room(rng: np.random.Generator, size: tuple[int, int] = ENVIRONMENT_SIZE) -> Environment:
    """Made-up surroundings with a high dynamic range: mostly indoors (windows, lamps, clutter), sometimes outdoors."""
    rays = directions(size)
    if rng.random() < 0.15:
        return scaled_environment(paint_outdoors(rng, rays), "outdoors")
    return scaled_environment(paint_room(rng, rays), "room")


# ---------------------------------------------------------------- rough surfaces


def prefilter(env: Environment, roughness_levels: tuple[float, ...] = ROUGHNESS_LEVELS) -> FilteredEnvironment:
    """What GGX lobes of the given roughness (alpha = roughness^2, ascending) and a matt surface see of ``env``.

    A lobe depends only on the angle to its axis, so along azimuth the blur is a circular convolution: one product with
    an (h, h) matrix for each azimuthal frequency. Weights are normalised: constant light stays constant, and the
    irradiance of constant radiance L is pi L exactly.
    """
    levels = tuple(float(level) for level in roughness_levels)
    if list(levels) != sorted(set(levels)) or not levels or not 0 < levels[0] <= levels[-1] <= 1:
        raise ValueError(f"prefilter: got roughness levels {levels}; allowed: ascending, in (0, 1]")
    small, spectra = env.radiance, {}
    for size in sorted({_filtered_size(level) for level in levels} | {MATT_SIZE}, reverse=True):
        small = resize_environment(small, size)
        spectra[size] = np.fft.rfft(small, axis=1).astype(np.complex64)
    stack = tuple(_convolve(_ggx_spectrum(r, _filtered_size(r)), spectra[_filtered_size(r)]) for r in levels)
    matt, grazing = (_convolve(_cosine_spectrum(power, MATT_SIZE), spectra[MATT_SIZE]) for power in (0, 5))
    matt, grazing = np.float32(np.pi) * matt, np.float32(np.pi * GRAZING_MEAN) * grazing
    coarse, medium = (resize_environment(env.radiance, size) for size in (COARSE_SIZE, MEDIUM_SIZE))
    return FilteredEnvironment(env, levels, stack, matt, grazing, coarse, medium)


MATT_SIZE = (32, 64)
"""Irradiance is smooth: 5.6 degrees per pixel."""


COARSE_SIZE = (24, 48)
"""7.5 degrees per pixel: a lobe of roughness 0.35 is 18 degrees wide."""

MEDIUM_SIZE = (64, 128)
"""2.8 degrees per pixel: finds the lights of a room that cast shadows."""

BRIGHT = 6.0
"""Luminance, relative to the mean of all directions, above which something is a lamp, a window or the sun."""


def _filtered_size(roughness: float) -> tuple[int, int]:
    """Size of the image of what a GGX lobe sees; its full width at half maximum is 2.6 roughness^2 rad."""
    return (128, 256) if roughness <= 0.2 else (64, 128) if roughness <= 0.5 else (32, 64)


def sample_filtered(
    filtered: FilteredEnvironment, directions: Float[np.ndarray, "*n 3"], roughness: float
) -> Float[np.ndarray, "*n 3"]:
    """Radiance (float32) that a surface of one ``roughness`` reflects from around mirror ``directions``.

    roughness: from 0 to the last level of ``filtered``, which is used for all higher values.
    """
    levels = (0.0, *filtered.roughness)
    above = int(np.clip(np.searchsorted(levels, roughness), 1, len(levels) - 1))
    # Interpolates in the cube: a lobe's core widens with roughness^2, its tails grow with roughness^4; the cube of
    # roughness errs least between levels.
    low, high = levels[above - 1] ** 3, levels[above] ** 3
    share = np.float32(np.clip((roughness**3 - low) / (high - low), 0.0, 1.0))
    lookup = SphereLookup(directions)
    lower = filtered.environment.radiance if above == 1 else filtered.stack[above - 2]
    if share == 1:
        return lookup.values(filtered.stack[above - 1])
    seen = lookup.values(lower)
    if share > 0:
        seen *= 1 - share
        seen += share * lookup.values(filtered.stack[above - 1])
    return seen


def sample_irradiance(
    filtered: FilteredEnvironment, normals: Float[np.ndarray, "*n 3"], entry: tuple[float, float] = (1.0, 0.0)
) -> Float[np.ndarray, "*n 3"]:
    """Irradiance (float32) on surfaces with unit world ``normals``: pi times the radiance for constant light.

    entry: (a, b) weights light at cosine c to the normal by a + b (1 - c)^5.
    """
    a, b = (np.float32(weight) for weight in entry)
    weighted = filtered.irradiance if (a, b) == (1, 0) else a * filtered.irradiance + b * filtered.grazing
    return SphereLookup(normals).values(weighted)


def room_lights(
    filtered: FilteredEnvironment, normal: Float[np.ndarray, "3"], count: int
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The light that falls on a plane from all around as at most ``count`` lights, each of nearby directions.

    What is ``BRIGHT`` is first separated from the rest, as a sun from its sky. Then, repeatedly, the part with the most
    light times variance of direction is cut at its mean, across the axis along which it varies most (after Wu 1991,
    who chooses colours this way).
    normal: unit, world. Returns unit directions, shares of the irradiance, and one sigma of the directions in radians.
    """
    size = filtered.medium.shape[:2]
    rays = directions(size).reshape(-1, 3).astype(np.float64)
    luminance = filtered.medium @ LUMINANCE
    light = (luminance * solid_angles(size)[:, None]).reshape(-1) * np.maximum(rays @ normal, 0)
    bright = luminance.reshape(-1) > BRIGHT
    parts = [_part(rays[some], light[some]) for some in (bright & (light > 0), ~bright & (light > 0)) if some.any()]
    while 0 < len(parts) < count:
        worst = max(range(len(parts)), key=lambda k: parts[k].spread)
        if parts[worst].spread <= 0:
            break
        parts[worst : worst + 1] = parts[worst].cut()
    total = max(float(light.sum()), 1e-12)
    share = np.array([p.light.sum() / total for p in parts])
    sigma = np.sqrt([p.spread / p.light.sum() / 2 for p in parts])
    return np.array([p.mean / np.linalg.norm(p.mean) for p in parts]).reshape(-1, 3), share, sigma


@dataclass(frozen=True, eq=False)
class _Part:
    """Directions and the light from each; their mean; the sum of light times squared distance from it."""

    rays: Float[np.ndarray, "m 3"]
    light: Float[np.ndarray, " m"]
    mean: Float[np.ndarray, "3"]
    spread: float

    def cut(self) -> list[_Part]:
        offset = self.rays - self.mean
        axis = np.linalg.eigh((offset * self.light[:, None]).T @ offset)[1][:, -1]
        beyond = offset @ axis > 0
        return [_part(self.rays[side], self.light[side]) for side in (beyond, ~beyond)]


def _part(rays: Float[np.ndarray, "m 3"], light: Float[np.ndarray, " m"]) -> _Part:
    mean = light @ rays / light.sum()
    spread = float(light @ ((rays - mean) ** 2).sum(axis=1)) if len(rays) > 1 else 0.0
    return _Part(rays, light, mean, spread)


def _convolve(kernel: Float[np.ndarray, "m h h"], spectrum: Complex[np.ndarray, "h m 3"]) -> Float[np.ndarray, "h w 3"]:
    parts = np.ascontiguousarray(spectrum.transpose(1, 0, 2)).view(np.float32)  # real and imaginary: the kernel is real
    mixed = np.matmul(kernel, parts).view(np.complex64)
    width = 2 * (spectrum.shape[1] - 1)
    return np.maximum(np.fft.irfft(mixed.transpose(1, 0, 2), n=width, axis=1), 0.0).astype(np.float32)


@lru_cache(maxsize=32)
def _ggx_spectrum(roughness: float, size: tuple[int, int]) -> Float[np.ndarray, "m h h"]:
    """GGX's lobe with equal view, normal and mirror direction (Karis 2013): the half vector halves the angle."""
    alpha_sq = roughness**4
    dot = _dots(size)
    cos_half_sq = 0.5 * (1.0 + dot)
    return _spectrum(np.maximum(dot, 0.0) / (cos_half_sq * (alpha_sq - 1.0) + 1.0) ** 2, size)


@lru_cache(maxsize=8)
def _cosine_spectrum(power: int, size: tuple[int, int]) -> Float[np.ndarray, "m h h"]:
    """The lobe c (1 - c)^power."""
    dot = np.maximum(_dots(size), 0.0)
    return _spectrum(dot * (1 - dot) ** power, size)


def _dots(size: tuple[int, int]) -> Float[np.ndarray, "h h w"]:
    """Cosine between the pixels (row out, column 0) and (row in, column)."""
    polar, azimuth = centres_1d(size[0]) * (np.pi / size[0]), np.arange(size[1]) * (2 * np.pi / size[1])
    cos, sin = np.cos(polar), np.sin(polar)
    return cos[:, None, None] * cos[None, :, None] + sin[:, None, None] * sin[None, :, None] * np.cos(azimuth)


def _spectrum(lobe: Float[np.ndarray, "h h w"], size: tuple[int, int]) -> Float[np.ndarray, "m h h"]:
    """Azimuthal spectrum (m, row out, row in) of a lobe, normalised over the sphere for each row out."""
    lobe = lobe * solid_angles(size)[None, :, None]
    lobe /= lobe.sum(axis=(1, 2), keepdims=True)
    spectrum = np.fft.rfft(lobe, axis=2).real.astype(np.float32)  # even in azimuth: real
    return np.ascontiguousarray(spectrum.transpose(2, 0, 1))  # otherwise the products take six times as long


__all__ = [
    "Environment",
    "FilteredEnvironment",
    "directions",
    "load_environments",
    "load_hdri",
    "prefilter",
    "procedural_room",
    "room_lights",
    "sample_environment",
    "sample_filtered",
    "sample_irradiance",
    "solid_angles",
]
