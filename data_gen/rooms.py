"""Light from all around: environments, lookup by direction, and versions blurred for rough surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Complex, Float

from data_gen._room_paint import paint_outdoors, paint_room
from hybrid.coords import centres_1d, opencv_from_photo, rgb_from_bgr
from hybrid.errors import DataError, describe

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
"""Rec. 709 weights of linear RGB."""

ENVIRONMENT_SIZE = (256, 512)
FILTERED_SIZE = (64, 128)

MAX_RELATIVE_RADIANCE = 3000.0
"""The sun of an HDR file is cut here (times the mean): brighter points only add noise to a blurred reflection."""

REMAP_COLUMNS = 2048
"""OpenCV's remap takes no side longer than 32767, so lists of points are folded into rows."""


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
    stack: (levels, h, w, 3) radiance seen by a GGX lobe of that roughness around the mirror direction.
    irradiance: (h, w, 3) integral of radiance times cosine over the hemisphere around a normal.
    """

    environment: Environment
    roughness: tuple[float, ...]
    stack: Float[np.ndarray, "levels h w 3"]
    irradiance: Float[np.ndarray, "h w 3"]


def directions(size: tuple[int, int]) -> Float[np.ndarray, "H W 3"]:
    """Unit world directions (float32, z up) of the pixel centres of an environment of ``size`` (height, width)."""
    polar, azimuth = centres_1d(size[0]) * (np.pi / size[0]), centres_1d(size[1]) * (2 * np.pi / size[1])
    sin = np.sin(polar)[:, None]
    z = np.broadcast_to(np.cos(polar)[:, None], size)
    return np.stack([sin * np.cos(azimuth), sin * np.sin(azimuth), z], axis=-1).astype(np.float32)


def solid_angles(size: tuple[int, int]) -> Float[np.ndarray, " H"]:
    """Solid angle in steradians of one pixel of each row, exact: they sum to 4 pi over the sphere."""
    edges = np.cos(np.linspace(0.0, np.pi, size[0] + 1))
    return (edges[:-1] - edges[1:]) * (2 * np.pi / size[1])


def mean_luminance(radiance: Float[np.ndarray, "H W 3"]) -> float:
    """Luminance averaged over the sphere."""
    weights = solid_angles(radiance.shape[:2]) / (4 * np.pi)
    return float(weights @ (radiance @ LUMINANCE).sum(axis=1))


def resize_environment(radiance: Float[np.ndarray, "H W 3"], size: tuple[int, int]) -> Float[np.ndarray, "h w 3"]:
    """Averages over the new pixels, by area in the picture and by solid angle on the sphere."""
    if radiance.shape[:2] == size:
        return radiance
    weight = solid_angles(radiance.shape[:2])[:, None].astype(np.float32)
    both = cv2.resize(radiance * weight[..., None], size[::-1], interpolation=cv2.INTER_AREA)
    return both / cv2.resize(weight, (1, size[0]), interpolation=cv2.INTER_AREA).reshape(-1, 1, 1)


def scaled_environment(radiance: Float[np.ndarray, "H W 3"], name: str) -> Environment:
    """The environment at mean luminance 1, its brightest points cut."""
    mean = mean_luminance(radiance)
    if not mean > 0:
        raise DataError(describe(what="Environment", where=name, got="no light at all", do="Drop the file"))
    limited = np.minimum(radiance / np.float32(mean), np.float32(MAX_RELATIVE_RADIANCE))
    return Environment(limited / np.float32(mean_luminance(limited)), name)


def load_hdri(path: Path | str, size: tuple[int, int] = ENVIRONMENT_SIZE) -> Environment:
    """An equirectangular Radiance RGBE (or other float) image, averaged down to ``size`` and scaled to mean 1.

    Raises DataError where OpenCV cannot read it.
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
    rgb = np.maximum(np.nan_to_num(rgb_from_bgr(image[..., :3])), 0.0).astype(np.float32)
    return scaled_environment(resize_environment(rgb, size), path.stem)


def load_environments(folder: Path | str) -> list[Environment]:
    """Every ``.hdr`` file under ``folder`` in sorted order; DataError where there is none."""
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
    return sample_sphere(env.radiance, directions)


def sample_sphere(
    image: Float[np.ndarray, "H W 3"], directions: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Bilinear lookup of any equirectangular image by unit world direction; clamped at the poles."""
    height, width = image.shape[:2]
    shape = directions.shape
    flat = np.ascontiguousarray(directions.reshape(-1, 3), dtype=np.float32)
    count = len(flat)
    if count == 0:
        return np.zeros(shape, np.float32)
    columns = min(count, REMAP_COLUMNS)
    x, y = np.zeros((2, -(-count // columns), columns), np.float32)
    radius, azimuth = cv2.cartToPolar(flat[:, 0].copy(), flat[:, 1].copy())
    polar = np.arctan2(radius.ravel(), flat[:, 2])
    x.reshape(-1)[:count] = opencv_from_photo(azimuth.ravel() * np.float32(width / (2 * np.pi))) + np.float32(1.0)
    y.reshape(-1)[:count] = opencv_from_photo(polar * np.float32(height / np.pi))
    padded = cv2.copyMakeBorder(image, 0, 0, 1, 1, cv2.BORDER_WRAP)
    out = cv2.remap(padded, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return out.reshape(-1, 3)[:count].reshape(shape)


# ---------------------------------------------------------------- procedural


def procedural_room(rng: np.random.Generator, size: tuple[int, int] = ENVIRONMENT_SIZE) -> Environment:
    """A made-up surrounding with a high dynamic range: mostly indoors (windows, lamps, clutter), sometimes outdoors."""
    rays = directions(size)
    if rng.random() < 0.15:
        return scaled_environment(paint_outdoors(rng, rays), "outdoors")
    return scaled_environment(paint_room(rng, rays), "room")


# ---------------------------------------------------------------- rough surfaces


def prefilter(
    env: Environment,
    roughness_levels: tuple[float, ...] = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0),
    size: tuple[int, int] = FILTERED_SIZE,
) -> FilteredEnvironment:
    """What GGX lobes of the given roughness (alpha = roughness^2, ascending) and a matt surface see of ``env``.

    A lobe depends only on the angle to its axis, so along azimuth the blur is a circular convolution: one product of
    (h, h) matrices for each azimuthal frequency. Weights are normalised: constant light stays constant, and the
    irradiance of constant radiance L is pi L exactly.
    """
    levels = tuple(float(level) for level in roughness_levels)
    if list(levels) != sorted(set(levels)) or not levels or not 0 < levels[0] <= levels[-1] <= 1:
        raise ValueError(f"prefilter: got roughness levels {levels}; allowed: ascending, in (0, 1]")
    spectrum = np.fft.rfft(resize_environment(env.radiance, size), axis=1)
    stack = np.stack([_convolve(_lobe_spectrum(level, size), spectrum, size[1]) for level in levels])
    irradiance = np.pi * _convolve(_lobe_spectrum(None, size), spectrum, size[1])
    return FilteredEnvironment(env, levels, stack.astype(np.float32), irradiance.astype(np.float32))


def sample_filtered(
    filtered: FilteredEnvironment, directions: Float[np.ndarray, "*n 3"], roughness: float
) -> Float[np.ndarray, "*n 3"]:
    """Radiance (float32) that a surface of one ``roughness`` in [0, 1] reflects from around mirror ``directions``."""
    levels = (0.0, *filtered.roughness)
    above = int(np.clip(np.searchsorted(levels, roughness), 1, len(levels) - 1))
    share = float(np.clip((roughness - levels[above - 1]) / (levels[above] - levels[above - 1]), 0.0, 1.0))
    upper = filtered.stack[above - 1]
    if above == 1:
        sharp = sample_environment(filtered.environment, directions)
        return (1 - share) * sharp + share * sample_sphere(upper, directions)
    mixed = (1 - share) * filtered.stack[above - 2] + share * upper
    return sample_sphere(mixed.astype(np.float32), directions)


def sample_irradiance(filtered: FilteredEnvironment, normals: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Irradiance (float32) on surfaces with unit world ``normals``: pi times the radiance where light is constant."""
    return sample_sphere(filtered.irradiance, normals)


def _convolve(
    kernel: Float[np.ndarray, "m h h"], spectrum: Complex[np.ndarray, "h m 3"], width: int
) -> Float[np.ndarray, "h w 3"]:
    mixed = np.matmul(kernel, spectrum.transpose(1, 0, 2))
    return np.maximum(np.fft.irfft(mixed.transpose(1, 0, 2), n=width, axis=1), 0.0)


@lru_cache(maxsize=32)
def _lobe_spectrum(roughness: float | None, size: tuple[int, int]) -> Float[np.ndarray, "m h h"]:
    """Azimuthal spectrum (m, row out, row in) of a normalised lobe: GGX, or the cosine lobe for None."""
    height, width = size
    polar = centres_1d(height) * (np.pi / height)
    azimuth = np.arange(width) * (2 * np.pi / width)
    cos, sin = np.cos(polar), np.sin(polar)
    dot = cos[:, None, None] * cos[None, :, None] + sin[:, None, None] * sin[None, :, None] * np.cos(azimuth)
    lobe = np.maximum(dot, 0.0)
    if (
        roughness is not None
    ):  # view, normal and mirror direction taken as one (Karis 2013): half vector halves the angle
        alpha_sq = roughness**4
        cos_half_sq = 0.5 * (1.0 + np.clip(dot, -1.0, 1.0))
        lobe = lobe * alpha_sq / (np.pi * (cos_half_sq * (alpha_sq - 1.0) + 1.0) ** 2)
    lobe = lobe * solid_angles(size)[None, :, None]
    lobe = lobe / lobe.sum(axis=(1, 2), keepdims=True)
    return np.fft.rfft(lobe, axis=2).real.transpose(2, 0, 1)  # even in azimuth: the spectrum is real


__all__ = [
    "Environment",
    "FilteredEnvironment",
    "directions",
    "load_environments",
    "load_hdri",
    "prefilter",
    "procedural_room",
    "sample_environment",
    "sample_filtered",
    "sample_irradiance",
]
