"""Put the film into the photo: look up print and light at the film points that pixels see, over the background."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32

from data_gen.render.shade import FilmLight
from hybrid.coords import linear_from_srgb, opencv_from_photo
from hybrid.gsdf import light_through
from hybrid.mesh.raycast import PixelView

LEAST_SAMPLING = 2.0
"""Fewest print pixels per photo pixel, along both axes, that a reduced print keeps."""

_LONGEST = 16384
"""Most points looked up at once: OpenCV's remap takes no side longer than 32767."""

_GREYS = np.arange(256) / 255


@dataclass(frozen=True, eq=False)
class PrintLevels:
    """A print at full resolution, at a half, a quarter and so on, made once for all photos of it.

    A pixel averages light, so ``reflectance`` is reduced in linear light; ``grey``, the true print, is reduced in
    display grey.
    """

    reflectance: tuple[Float32[np.ndarray, "_ _"], ...]
    grey: tuple[Float32[np.ndarray, "_ _"], ...]


def print_levels(image: Float[np.ndarray, "h w"], densest: float | None = None) -> PrintLevels:
    """The levels of a print (display grey). densest: optical density of its black, printed as medical printers do
    (``hybrid.gsdf``); None for a print with a display's greys (sRGB)."""
    grey = image.astype(np.float32)
    table = linear_from_srgb(_GREYS) if densest is None else light_through(_GREYS, densest)
    reflectance = cv2.LUT(cv2.convertScaleAbs(grey, alpha=255), table.astype(np.float32)[None])
    return PrintLevels(_halved(reflectance), _halved(grey))


def _halved(image: Float32[np.ndarray, "h w"]) -> tuple[Float32[np.ndarray, "_ _"], ...]:
    """An image and its area averages by powers of two, down to 64 pixels."""
    levels = [image]
    while min(levels[-1].shape) >= 128:
        h, w = levels[-1].shape
        levels.append(cv2.resize(levels[-1], (w // 2, h // 2), interpolation=cv2.INTER_AREA))
    return tuple(levels)


def at_photo_scale(
    levels: tuple[Float32[np.ndarray, "_ _"], ...], film_px: tuple[float, float]
) -> Float32[np.ndarray, "h w"]:
    """The print as a pixel of the photo sees it: blurred to a photo pixel's mean size, sampled twice as finely.

    film_px: mean height and width of the film in photo pixels. One bilinear lookup then stands for the mean over the
    pixel. Where a film is steeply foreshortened, a photo pixel covers more of the print than the mean and samples it
    too sparsely by that ratio, like a camera with small photosites.
    """
    steps = [tuple(n / px for n, px in zip(level.shape, film_px, strict=True)) for level in levels]
    chosen = max([0, *(k for k, step in enumerate(steps) if min(step) >= LEAST_SAMPLING)])
    down, across = (_box(step) for step in steps[chosen])
    return cv2.sepFilter2D(levels[chosen], -1, across, down, borderType=cv2.BORDER_REPLICATE)


def _box(width: float) -> Float32[np.ndarray, " n"]:
    """Weights of the pixels that a box of ``width`` pixels around a pixel's centre covers."""
    reach = int(np.ceil(max(width - 1, 0) / 2))
    ends = np.clip(np.arange(2 * reach + 2) * 2 - (2 * reach + 1), -width, width) / 2
    weights = np.diff(ends)
    return (weights / weights.sum()).astype(np.float32)


def composite(
    view: PixelView, reflectance: Float[np.ndarray, "a b"], light: FilmLight, behind: Float32[np.ndarray, "h w 3"]
) -> Float32[np.ndarray, "h w 3"]:
    """Linear light of the photo: ``behind`` (which is overwritten) with the film in front of it.

    reflectance: linear, at the photo's scale (``at_photo_scale``). A pixel that the film covers in part gets the mean
    colour of the film points seen in it, mixed with what is behind by their share of the pixel.
    """
    film = film_radiance_at(view.uv, reflectance, light)
    if len(view.rim):
        parts = np.array_split(np.arange(len(view.rim)), -(-len(view.rim) // _LONGEST))
        means = [_mean(film_radiance_at(view.rim_uv[k], reflectance, light), view.rim_hit[k]) for k in parts]
        film.reshape(-1, 3)[view.rim] = np.concatenate(means)
    part = behind[view.box]
    film -= part
    film *= cv2.merge([view.coverage] * 3)
    part += film
    return behind


def film_radiance_at(
    uv: Float32[np.ndarray, "h w 2"], reflectance: Float[np.ndarray, "a b"], light: FilmLight
) -> Float32[np.ndarray, "h w 3"]:
    """Radiance of film points: the light's gain times the print's reflectance, and its veil."""
    print_, radiance, veil = on_film((reflectance, light.gain, light.veil), uv)
    radiance *= cv2.merge([print_] * 3)
    radiance += veil
    return radiance


def on_film(images: Sequence[Float[np.ndarray, "..."]], uv: Float32[np.ndarray, "h w 2"]) -> list[np.ndarray]:
    """Bilinear values of film images of any sizes at film points; NaN counts as 0.

    The points are split into coordinates once for all images: that costs as much as a lookup.
    """
    points = cv2.split(cv2.patchNaNs(uv.copy(), 0.0))
    found = []
    for image in images:
        h, w = image.shape[:2]
        x, y = (opencv_from_photo(t * np.float32(n)) for t, n in zip(points, (w, h), strict=True))
        found.append(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
    return found


def _mean(values: Float32[np.ndarray, "m k 3"], counted: np.ndarray) -> Float32[np.ndarray, "m 3"]:
    """Mean of the values that count; 0 where none does."""
    total = np.einsum("mkc,mk->mc", values, counted.astype(np.float32))
    return total / np.maximum(np.count_nonzero(counted, axis=1), 1).astype(np.float32)[:, None]
