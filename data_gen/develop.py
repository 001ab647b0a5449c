"""From linear light on the sensor to a JPEG: blur, exposure, white balance, vignetting, noise, tone, sharpening."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from hybrid.coords import film_centres, rgb_from_bgr, srgb_from_linear

_LUT_SIZE = 4096
_LUT_MAX = 4.0
"""Tone curves are tabulated up to four times the level that a plain sRGB curve clips."""

REFERENCE_SIDE = 1000.0
"""Photo side, in pixels, to which blur radii refer."""


@dataclass(frozen=True)
class Lens:
    """What the camera does to the light, all at random.

    exposure: linear level that the film's bright parts (95th percentile) reach. temperature: log2 red/blue gain.
    tint: log2 green gain. tone: 'srgb', 'filmic' or 'punchy'. vignette: loss in the corners. bloom: share of light
    scattered. defocus_px, motion_px: blur in pixels of a 1000 px photo. sharpen: unsharp amount.
    noise: of read and shot. jpeg: quality.
    """

    exposure: float
    temperature: float
    tint: float
    tone: str
    vignette: float
    bloom: float
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
        defocus_px=float(abs(rng.normal(0, 1.2))),
        motion_px=float(rng.uniform(1, 5)) if rng.random() < 0.15 else 0.0,
        sharpen=float(rng.uniform(0, 1.0)) if rng.random() < 0.5 else 0.0,
        noise=float(10 ** rng.uniform(-3.2, -1.8)),
        jpeg=int(rng.integers(45, 97)),
    )


def develop(linear: Float[np.ndarray, "h w 3"], lens: Lens, white: float, rng: np.random.Generator) -> bytes:
    """JPEG bytes of a photo. ``white`` is the radiance that is exposed to the level ``lens.exposure``."""
    h, w = linear.shape[:2]
    image = _blurred(linear, lens, max(h, w) / REFERENCE_SIDE, rng)
    gains = (
        np.exp2(np.array([lens.temperature / 2, lens.tint, -lens.temperature / 2])) * lens.exposure / max(white, 1e-6)
    )
    image = image * gains.astype(np.float32)
    radius2 = ((film_centres((h, w)) * 2 - 1) ** 2).sum(axis=-1)
    image *= (1 - lens.vignette * radius2 / 2)[..., None].astype(np.float32)
    sigma = np.sqrt(lens.noise**2 + lens.noise * 0.3 * np.clip(image, 0, 1))
    image += sigma * cv2.GaussianBlur(rng.standard_normal(image.shape, dtype=np.float32), (0, 0), 0.6)
    display = tone(lens.tone)[np.clip(image * (_LUT_SIZE / _LUT_MAX), 0, _LUT_SIZE - 1).astype(np.int32)]
    if lens.sharpen > 0:
        display = display + lens.sharpen * (display - cv2.GaussianBlur(display, (0, 0), 1.2))
    pixels = np.clip(display * 255 + rng.random(display.shape, dtype=np.float32), 0, 255).astype(np.uint8)
    ok, encoded = cv2.imencode(".jpg", rgb_from_bgr(pixels), [cv2.IMWRITE_JPEG_QUALITY, lens.jpeg])
    if not ok:
        raise RuntimeError("develop: OpenCV could not encode the photo as JPEG")
    return encoded.tobytes()


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
        small = cv2.resize(image, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
        spread = cv2.GaussianBlur(small, (0, 0), 25 * scale / 4 + 1)
        image = (1 - lens.bloom) * image + lens.bloom * cv2.resize(spread, image.shape[1::-1])
    if lens.defocus_px * scale > 0.3:
        image = cv2.GaussianBlur(image, (0, 0), lens.defocus_px * scale)
    if lens.motion_px * scale > 0.7:
        n = int(np.ceil(lens.motion_px * scale)) | 1
        kernel = np.zeros((n + 2, n + 2), np.float32)
        angle = rng.uniform(0, np.pi)
        half = np.array([np.cos(angle), np.sin(angle)]) * n / 2
        middle = (n + 1) / 2
        start, stop = np.rint(middle - half).astype(int), np.rint(middle + half).astype(int)
        cv2.line(kernel, start.tolist(), stop.tolist(), 1.0, 1, cv2.LINE_AA)
        image = cv2.filter2D(image, -1, kernel / kernel.sum())
    return np.array(image, dtype=np.float32)
