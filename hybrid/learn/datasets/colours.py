"""What cameras and their software do to colours, for training: geometry and truth stay as they are.

``taken_badly`` is applied to a photo: low light with its noise, sharpening and strong compression; each on a share of
photos. ``disturbed`` is applied to a network's view of one: gain and gamma, grey, blur, noise.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

DIM_SHARE, SHARPENED_SHARE, COMPRESSED_SHARE = 0.1, 0.08, 0.15
"""Shares of all photos: those taken in low light, those sharpened, and those stored at a low quality."""
DIM_STOPS = (1.0, 4.0)
"""Range of the stops by which low light is darker."""
LIFTED = 0.7
"""Largest fraction of these stops that the camera makes up for afterwards, amplifying the noise as well."""
READ_NOISE, SHOT_NOISE = (0.0005, 0.004), (0.005, 0.03)
"""Ranges of one sigma of noise in linear light: the constant part, and the part that grows with the light's root."""
SHARPENING, SHARPENING_PX = (0.5, 2.0), (0.7, 2.5)
QUALITY = (8, 60)
"""Range of the JPEG quality."""
MOVED_SHARE, MOVED_PX = 0.06, (2.0, 7.0)
"""Share of views blurred by motion, and the range of its length in pixels of the view."""


def taken_badly(photo: UInt8[np.ndarray, "H W 3"], rng: np.random.Generator) -> UInt8[np.ndarray, "H W 3"]:
    """A photo as a poorer camera, or poorer light, would have given it; most photos stay as they are."""
    if rng.random() < DIM_SHARE:
        photo = in_little_light(photo, rng)
    if rng.random() < SHARPENED_SHARE:
        amount = rng.uniform(*SHARPENING)
        soft = cv2.GaussianBlur(photo, (0, 0), rng.uniform(*SHARPENING_PX))
        photo = cv2.addWeighted(photo, 1.0 + amount, soft, -amount, 0.0)
    if rng.random() < COMPRESSED_SHARE:
        photo = compressed(photo, int(rng.integers(*QUALITY)))
    return photo


def in_little_light(photo: UInt8[np.ndarray, "H W 3"], rng: np.random.Generator) -> UInt8[np.ndarray, "H W 3"]:
    """A photo with less light and more noise; the camera makes up for part of the light."""
    stops = rng.uniform(*DIM_STOPS)
    level = np.arange(256, dtype=np.float32) / 255
    light = level**2.2 * np.float32(2.0**-stops)
    deviation = rng.uniform(*READ_NOISE) + rng.uniform(*SHOT_NOISE) * np.sqrt(light)
    noise = rng.standard_normal(photo.shape, dtype=np.float32)
    seen = cv2.LUT(photo, light) + noise * cv2.LUT(photo, deviation.astype(np.float32))
    lifted = np.float32(2.0 ** (stops * rng.uniform(0.0, LIFTED)))
    grey = np.power(np.clip(lifted * seen, 0, 1), np.float32(1 / 2.2))
    return np.rint(255 * grey).astype(np.uint8)


def compressed(photo: UInt8[np.ndarray, "H W 3"], quality: int) -> UInt8[np.ndarray, "H W 3"]:
    """A photo after JPEG compression at a given quality."""
    stored = cv2.imencode(".jpg", cv2.cvtColor(photo, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    seen = cv2.imdecode(stored, cv2.IMREAD_COLOR)
    assert seen is not None  # it was encoded just now
    return cv2.cvtColor(seen, cv2.COLOR_BGR2RGB)


def disturbed(image: UInt8[np.ndarray, "h w 3"], rng: np.random.Generator) -> UInt8[np.ndarray, "h w 3"]:
    """A view with random gain and gamma per channel, and with grey, blur, motion or noise on a share of views each."""
    x = np.arange(256, dtype=np.float32) / 255
    gain = np.exp2(rng.normal(0, 0.25) + rng.normal(0, 0.06, 3))
    table = np.stack([np.clip(x ** np.exp2(rng.normal(0, 0.2)) * g, 0, 1) for g in gain], axis=-1)
    image = cv2.LUT(image, np.rint(table * 255).astype(np.uint8)[None])
    if rng.random() < 0.15:
        image = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    if rng.random() < 0.15:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.4, 1.2))
    if rng.random() < MOVED_SHARE:
        image = cv2.filter2D(image, -1, _trace(rng.uniform(*MOVED_PX), rng.uniform(0, np.pi)))
    if rng.random() < 0.3:
        noise = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(rng.uniform(1, 10))
        image = np.rint(np.clip(image + noise, 0, 255)).astype(np.uint8)
    return image


def _trace(length: float, direction: float) -> Float[np.ndarray, "k k"]:
    """The blur kernel of a straight motion of some length (pixels) in a direction (radians)."""
    reach = int(np.ceil(length / 2))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(np.float32)
    along, across = (np.cos(a) * x + np.sin(a) * y for a in (direction, direction + np.pi / 2))
    weights = np.clip(length / 2 + 0.5 - np.abs(along), 0, 1) * np.clip(1 - np.abs(across), 0, 1)
    return (weights / weights.sum()).astype(np.float32)


__all__ = ["compressed", "disturbed", "in_little_light", "taken_badly"]
