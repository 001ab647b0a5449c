"""From linear light on the sensor to a JPEG: blur, exposure, white balance, vignetting, noise, tone, sharpening."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from PIL import Image

from hybrid.coords import film_centres_1d, srgb_from_linear

_LUT_SIZE = 65536
"""Entries of a tone curve's table: one step is a fifth of a display level where sRGB is steepest, in its darkest
parts."""

_LUT_MAX = 4.0
"""Tone curves are tabulated up to four times the level at which a plain sRGB curve clips."""

_NOISE_BLUR = 0.6
"""Sigma, in pixels, of the blur that demosaicking gives to noise."""

_LOCAL_PX = 96
"""Longer side, in pixels, of the picture on which local tone mapping is computed."""

NO_LOCAL_TONE = np.ones((1, 1), np.float32)
"""Factors over the photo of a camera without local tone mapping."""

_NOISE_STD = float(np.sqrt((256**2 - 1) / 24))
"""Standard deviation of the mean of two random bytes."""

REFERENCE_SIDE = 1000.0
"""Photo side, in pixels, to which blur radii refer."""


White = float | Float[np.ndarray, "3"]
"""Radiance that is exposed to the level ``Lens.exposure``, grey or RGB."""


@dataclass(frozen=True)
class Lens:
    """What the camera does to the light, all drawn at random.

    exposure: linear level to which metered white is exposed. temperature: log2 red/blue gain.
    tint: log2 green gain. tone: 'srgb', 'filmic' or 'punchy'. vignette: loss in the corners. bloom: share of light
    scattered. local: exponent with which local tone mapping evens out bright and dark parts over ``local_reach`` of the
    photo's side; 0 for none. defocus_px, motion_px: blur in pixels of a 1000 px photo. sharpen: unsharp amount.
    noise: strength of read and shot noise. jpeg: quality.
    """

    exposure: float
    temperature: float
    tint: float
    tone: str
    vignette: float
    bloom: float
    local: float
    local_reach: float
    defocus_px: float
    motion_px: float
    sharpen: float
    noise: float
    jpeg: int


def sample_lens(rng: np.random.Generator) -> Lens:
    return Lens(
        exposure=float(np.exp(rng.normal(np.log(0.7), 0.55))),
        temperature=float(rng.normal(0, 0.25)),
        tint=float(rng.normal(0, 0.08)),
        tone=str(rng.choice(["srgb", "filmic", "punchy"], p=[0.45, 0.35, 0.2])),
        vignette=float(rng.uniform(0, 0.4)),
        bloom=float(rng.uniform(0, 0.06)) if rng.random() < 0.4 else 0.0,
        local=float(rng.uniform(0.1, 0.45)) if rng.random() < 0.4 else 0.0,
        local_reach=float(np.exp(rng.uniform(np.log(0.02), np.log(0.15)))),
        defocus_px=float(abs(rng.normal(0, 1.2))),
        motion_px=float(rng.uniform(1, 5)) if rng.random() < 0.15 else 0.0,
        sharpen=float(rng.uniform(0, 1.0)) if rng.random() < 0.5 else 0.0,
        noise=float(10 ** rng.uniform(-3.2, -1.8)),
        jpeg=int(rng.integers(45, 97)),
    )


def local_tone(linear: Float[np.ndarray, "h w 3"], lens: Lens) -> Float32[np.ndarray, "a b"]:
    """Factors over the photo by which the camera darkens bright parts and brightens dark ones.

    Phones do that to show a wide range of light at once: halos appear along the edges between such parts.
    """
    if lens.local == 0.0:
        return NO_LOCAL_TONE
    height, width = linear.shape[:2]
    size = [max(round(n * _LOCAL_PX / max(height, width)), 2) for n in (width, height)]
    level = cv2.resize(linear, size, interpolation=cv2.INTER_AREA).mean(axis=-1)
    log = np.log(np.maximum(level, 1e-3 * float(level.mean()) + 1e-9))
    factor = np.exp(-lens.local * (cv2.GaussianBlur(log, (0, 0), lens.local_reach * _LOCAL_PX) - log.mean()))
    return np.clip(factor, 0.25, 4.0).astype(np.float32)


def develop(
    linear: Float[np.ndarray, "h w 3"],
    lens: Lens,
    white: White,
    rng: np.random.Generator,
    local: Float32[np.ndarray, "a b"] = NO_LOCAL_TONE,
) -> bytes:
    """JPEG bytes of a photo. local: as ``local_tone`` gives it."""
    size = linear.shape[:2]
    exposed = cv2.transform(
        _blurred(linear, lens, max(size) / REFERENCE_SIDE, rng), np.diag(_gains(lens, white)).astype(np.float32)
    )
    exposed = cv2.multiply(exposed, _in_each_channel(_vignette(lens, size)))
    if local.size > 1:
        exposed = cv2.multiply(exposed, _in_each_channel(cv2.resize(local, size[::-1], interpolation=cv2.INTER_CUBIC)))
    variance = np.clip(exposed, 0, 1)
    variance *= np.float32(lens.noise * 0.3)
    variance += np.float32(lens.noise**2)
    exposed += cv2.multiply(cv2.sqrt(variance), _noise(size, rng))
    display = _toned(exposed, lens.tone)
    if lens.sharpen > 0:
        display = cv2.addWeighted(display, 1 + lens.sharpen, cv2.GaussianBlur(display, (0, 0), 1.2), -lens.sharpen, 0)
    return _jpeg(cv2.convertScaleAbs(np.maximum(display, 0), alpha=255), lens.jpeg)


def displayed(radiance: Float[np.ndarray, "h w 3"], lens: Lens, white: White) -> Float32[np.ndarray, "h w 3"]:
    """Display values in [0, 1] that the camera gives to radiances, without blur, noise and vignetting."""
    exposed = radiance * _gains(lens, white).astype(np.float32)
    return _toned(np.ascontiguousarray(exposed, np.float32), lens.tone)


def vignetting(place: Float[np.ndarray, "h w 2"], lens: Lens) -> Float32[np.ndarray, "h w 1"]:
    """Share of the light that reaches points of the photo. place: in units of the photo's sides, 0 to 1."""
    fall = np.maximum(1 - _lost_along(place[..., 0], lens) - _lost_along(place[..., 1], lens), 0)
    return fall[..., None].astype(np.float32)


def _gains(lens: Lens, white: White) -> Float[np.ndarray, "3"]:
    """Exposure and white balance: display-linear level for each unit of radiance."""
    balance = np.exp2(np.array([lens.temperature / 2, lens.tint, -lens.temperature / 2]))
    return balance * lens.exposure / np.maximum(white, 1e-6)


def _vignette(lens: Lens, size: tuple[int, int]) -> Float32[np.ndarray, "h w"]:
    """``vignetting`` of each pixel, a sum over rows and columns: ``lens.vignette`` is lost in the corners."""
    down, across = (_lost_along(film_centres_1d(n), lens) for n in size)
    return (1 - down[:, None]).astype(np.float32) - across.astype(np.float32)


def _lost_along(place: Float[np.ndarray, "*n"], lens: Lens) -> Float[np.ndarray, "*n"]:
    """Share of the light that is lost towards the ends of one side of the photo. place: along it, 0 to 1."""
    return lens.vignette / 2 * (2 * place - 1) ** 2


def _noise(size: tuple[int, int], rng: np.random.Generator) -> Float32[np.ndarray, "h w 3"]:
    """Noise that had unit variance before its demosaicking blur.

    The blurred mean of two random bytes: as good as Gaussian (excess kurtosis -0.4), at a fifth of the cost.
    """
    count = 3 * size[0] * size[1]
    first, second = (np.frombuffer(rng.bytes(count), np.uint8).reshape(*size, 3) for _ in range(2))
    blurred = cv2.GaussianBlur(cv2.add(first, second, dtype=cv2.CV_16U), (0, 0), _NOISE_BLUR).astype(np.float32)
    blurred -= np.float32(255)
    blurred *= np.float32(1 / (2 * _NOISE_STD))
    return blurred


def _toned(exposed: Float32[np.ndarray, "h w 3"], name: str) -> Float32[np.ndarray, "h w 3"]:
    """Display values of exposed light."""
    index = cv2.multiply(exposed, np.full(4, (_LUT_SIZE - 1) / _LUT_MAX), dtype=cv2.CV_16U)  # rounds and clips
    return cv2.LUT(index, tone(name)[None])


def _in_each_channel(values: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w 3"]:
    return cv2.merge([values, values, values])


def _jpeg(pixels: UInt8[np.ndarray, "h w 3"], quality: int) -> bytes:
    """JPEG bytes by Pillow, which encodes twice as fast as OpenCV."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=quality)
    return file.getvalue()


@lru_cache
def tone(name: str) -> Float[np.ndarray, " n"]:
    """Display values for linear light from 0 to 4: 'srgb' clips at 1, 'filmic' rolls off, 'punchy' adds contrast."""
    x = np.linspace(0, _LUT_MAX, _LUT_SIZE)
    if name == "filmic":  # Hable's curve (2010), white at 4

        def curve(v: np.ndarray) -> np.ndarray:
            return (v * (0.15 * v + 0.05) + 0.004) / (v * (0.15 * v + 0.5) + 0.06) - 0.02 / 0.3

        y = srgb_from_linear(curve(2 * x) / curve(np.array([2 * _LUT_MAX])))
    elif name == "punchy":
        display = srgb_from_linear(x)
        y = display + 0.12 * np.sin(2 * np.pi * (display - 0.5)) / (2 * np.pi) * 4 * 0.5
    else:
        y = srgb_from_linear(x)
    return np.clip(y, 0, 1).astype(np.float32)


def _blurred(linear: np.ndarray, lens: Lens, scale: float, rng: np.random.Generator) -> np.ndarray:
    """Bloom, defocus and motion blur."""
    image = linear
    if lens.bloom > 0:
        image = (1 - lens.bloom) * image + lens.bloom * scattered(image, scale)
    if lens.defocus_px * scale > 0.3:
        image = cv2.GaussianBlur(image, (0, 0), lens.defocus_px * scale)
    if lens.motion_px * scale > 0.7:
        image = cv2.filter2D(image, -1, _streak(lens.motion_px * scale, rng.uniform(0, np.pi)))
    return np.array(image, dtype=np.float32)


def scattered(linear: np.ndarray, scale: float) -> np.ndarray:
    """The light that the lens scatters: spread widely. scale: longer side of the photo, in REFERENCE_SIDE."""
    small = cv2.resize(linear, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    return cv2.resize(cv2.GaussianBlur(small, (0, 0), 25 * scale / 4 + 1), linear.shape[1::-1])


def _streak(length_px: float, angle: float) -> Float[np.ndarray, "k k"]:
    """Image of a point that moves evenly over this length: a kernel of weights, an odd number of pixels wide."""
    reach = int(np.ceil(length_px / 2))
    pixels, along = np.arange(-reach, reach + 1), (film_centres_1d(64) - 0.5) * length_px
    x, y = (np.maximum(1 - np.abs(along[:, None] * f(angle) - pixels), 0) for f in (np.cos, np.sin))
    return (y.T @ x / len(along)).astype(np.float32)
