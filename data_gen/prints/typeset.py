"""Texts and scale bars of a film: cached sprites of coverage, put onto a grey canvas."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

Sprite = UInt8[np.ndarray, "_ _"]

HERSHEY = {
    "simplex": cv2.FONT_HERSHEY_SIMPLEX,
    "plain": cv2.FONT_HERSHEY_PLAIN,
    "duplex": cv2.FONT_HERSHEY_DUPLEX,
    "complex": cv2.FONT_HERSHEY_COMPLEX,
    "italic": cv2.FONT_HERSHEY_SIMPLEX | cv2.FONT_ITALIC,
}
OUTLINES = {"sans": ("sans", 400), "sans_bold": ("sans", 700), "sans_light": ("sans", 250), "slanted": ("italic", 400)}
"""OpenCV's embedded outline fonts: name and weight."""

FAMILIES = (*HERSHEY, *OUTLINES, "pillow", "bitmap")
TEXT_STYLES = ("plain", "boxed", "inverted")


@dataclass(frozen=True)
class Font:
    """A family of FAMILIES, height of a capital letter in pixels, width relative to the usual one, and bold strokes."""

    family: str
    height_px: int
    stretch: float = 1.0
    bold: bool = False


@lru_cache(maxsize=512)
def text_sprite(text: str, font: Font) -> Sprite:
    """Coverage (0 to 255) of one line of text, cropped to its ink; read-only because it is shared."""
    if font.family == "pillow":
        ink = _pillow_ink(text, _pillow_font(font.height_px), 2 * font.height_px)
    elif font.family == "bitmap":
        small = _pillow_ink(text, ImageFont.load_default_imagefont(), 16)
        factor = max(1, round(font.height_px / 8))
        ink = np.repeat(np.repeat(small, factor, axis=0), factor, axis=1)
    elif font.family in OUTLINES:
        ink = _outline_ink(text, font)
    else:
        ink = _opencv_ink(text, font)
    if font.stretch != 1.0 and ink.shape[1] > 3:
        ink = cv2.resize(ink, (max(2, round(ink.shape[1] * font.stretch)), ink.shape[0]), interpolation=cv2.INTER_AREA)
    ink.setflags(write=False)
    return ink


def _opencv_ink(text: str, font: Font) -> Sprite:
    face = HERSHEY[font.family]
    thickness = 2 if font.bold else 1
    (_, cap), _ = cv2.getTextSize("H", face, 4.0, thickness)
    scale = 4.0 * font.height_px / max(cap, 1)
    (width, height), below = cv2.getTextSize(text, face, scale, thickness)
    canvas = np.zeros((height + below + 8, width + 12), np.uint8)
    cv2.putText(canvas, text, (4, height + 3), face, scale, 255, thickness, cv2.LINE_AA)
    return _trim(canvas)


@lru_cache(maxsize=8)
def _outline_face(name: str) -> cv2.FontFace:
    return cv2.FontFace(name)


def _outline_ink(text: str, font: Font) -> Sprite:
    name, weight = OUTLINES[font.family]
    size = round(font.height_px * 1.35)
    canvas = np.zeros((2 * size + 4, size * (len(text) + 1)), np.uint8)
    cv2.putText(canvas, text, (2, size + 2), (255,), _outline_face(name), size, weight + (200 if font.bold else 0))
    return _trim(canvas)


@lru_cache(maxsize=64)
def _pillow_font(height_px: int) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    return ImageFont.load_default(size=height_px * 1.4)


def _pillow_ink(text: str, font: ImageFont.ImageFont | ImageFont.FreeTypeFont, height: int) -> Sprite:
    image = Image.new("L", (int(font.getlength(text)) + 8, height + 6))
    ImageDraw.Draw(image).text((2, 2), text, fill=255, font=font)
    return _trim(np.array(image))


def _trim(canvas: UInt8[np.ndarray, "H W"]) -> Sprite:
    """The part that has ink, or one empty pixel."""
    rows, cols = np.flatnonzero(canvas.max(axis=1)), np.flatnonzero(canvas.max(axis=0))
    if not len(rows):
        return np.zeros((1, 1), np.uint8)
    return canvas[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1].copy()


def stamp(image: Float[np.ndarray, "H W"], sprite: Sprite, x: int, y: int, grey: float) -> None:
    """Puts ``grey`` onto the image in place where the sprite, top-left pixel at (x, y), covers it; clips at the rim."""
    height, width = image.shape
    x0, y0 = max(x, 0), max(y, 0)
    x1, y1 = min(x + sprite.shape[1], width), min(y + sprite.shape[0], height)
    if x0 >= x1 or y0 >= y1:
        return
    share = sprite[y0 - y : y1 - y, x0 - x : x1 - x] * np.float32(1 / 255)
    region = image[y0:y1, x0:x1]
    region += share * (np.float32(grey) - region)


def stamp_text(image: Float[np.ndarray, "H W"], sprite: Sprite, at: tuple[int, int], grey: float, style: str) -> None:
    """Puts a line of text at (x, y): plain, on a black box, or black on a box of ``grey``."""
    x, y = at
    if style != "plain":
        pad = max(1, sprite.shape[0] // 6)
        box = image[
            max(y - pad, 0) : max(y + sprite.shape[0] + pad, 0), max(x - pad, 0) : max(x + sprite.shape[1] + pad, 0)
        ]
        box[:] = grey if style == "inverted" else 0.0
    stamp(image, sprite, x, y, 0.0 if style == "inverted" else grey)


def cross_sprite(arm_px: int, thick_px: int) -> Sprite:
    """A plus sign of two strokes."""
    canvas = np.zeros((2 * arm_px + thick_px, 2 * arm_px + thick_px), np.uint8)
    canvas[arm_px : arm_px + thick_px] = 255
    canvas[:, arm_px : arm_px + thick_px] = 255
    return canvas


def wedge_greys(height_px: int, width_px: int, steps: int, white: float) -> Float[np.ndarray, "h w"]:
    """A grey wedge, white at the top; in ``steps`` equal steps, or smooth if 0."""
    ramp = np.linspace(1.0, 0.0, height_px, dtype=np.float32)
    if steps > 1:
        ramp = np.minimum(np.floor(ramp * steps), steps - 1) / np.float32(steps - 1)
    return np.repeat(np.float32(white) * ramp[:, None], width_px, axis=1)


def ruler_sprite(length_px: float, ticks: int, tick_px: int, thick_px: int, vertical: bool) -> Sprite:
    """A scale bar with ``ticks`` intervals; every fifth tick and the ends are longer. Vertical ticks point left."""
    length = round(length_px)
    canvas = np.zeros((length + thick_px, 2 * tick_px + thick_px), np.uint8)
    canvas[:, -thick_px:] = 255
    for k in range(ticks + 1):
        at = round(k * length_px / ticks)
        reach = 2 * tick_px if k % 5 == 0 or k == ticks else tick_px
        canvas[at : at + thick_px, -reach - thick_px :] = 255
    return canvas if vertical else np.ascontiguousarray(canvas.T)
