"""Pictures for people: outline and grid drawn on the photo, photo beside film, many on one sheet. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import opencv_from_photo, rescale_points
from hybrid.pyramid import Pyramid
from hybrid.records import RectifyResult, SliceGrid

Picture = UInt8[np.ndarray, "_ _ 3"]

OUTLINE_COLOUR = (255, 176, 0)
GRID_COLOUR = (0, 200, 255)
PAPER = (24, 24, 24)
INK = (235, 235, 235)
LINES_PER_PICTURE = 400
"""A line is this many times thinner than the picture's longer side (and at least one pixel wide)."""

CURVE_POINTS = 65
_SUBPIXEL_BITS = 4
_GAP = 8
_CAPTION_HEIGHT = 26


# ---------------------------------------------------------------- lines on the photo


def outline_curve(backward: BackwardMap) -> Float[np.ndarray, "n 2"]:
    """The film's four edges as one closed curve of photo points, clockwise from its top-left corner."""
    return backward.resized((CURVE_POINTS, CURVE_POINTS)).outline()


def grid_curves(grid: SliceGrid, backward: BackwardMap) -> list[Float[np.ndarray, "n 2"]]:
    """The lines between slices as curves of photo points: those across from the top, then those down from the left."""
    lines = [*grid.vertices, *grid.vertices.transpose(1, 0, 2)]
    return [backward.photo_from_film(_along(np.asarray(line, dtype=np.float64))) for line in lines]


def _along(vertices: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "n 2"]:
    """Film points on the straight pieces between neighbouring vertices."""
    at = np.arange(len(vertices))
    t = np.linspace(0, len(vertices) - 1, (len(vertices) - 1) * CURVE_POINTS // 4 + 1)
    return np.stack([np.interp(t, at, vertices[:, k]) for k in range(2)], axis=-1)


def draw_curves(
    picture: Picture, curves: Sequence[Float[np.ndarray, "_ 2"]], colour: tuple[int, int, int], closed: bool = False
) -> Picture:
    """A copy of the picture with curves of photo points drawn on it, smooth to a 16th of a pixel."""
    drawn = picture.copy()
    thickness = max(1, round(max(picture.shape[:2]) / LINES_PER_PICTURE))
    limit = 2.0**26  # OpenCV's fixed-point lines overflow beyond
    points = [
        np.rint(np.clip(opencv_from_photo(curve) * 2**_SUBPIXEL_BITS, -limit, limit)).astype(np.int32)
        for curve in curves
    ]
    cv2.polylines(drawn, points, closed, colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)
    return drawn


def annotated(photo: Picture, result: RectifyResult, longer_px: int = 1080) -> Picture:
    """The photo, scaled to at most ``longer_px``, with the film's outline and the slice grid that were found.

    The plain photo if no film was found.
    """
    scale = min(1.0, longer_px / max(photo.shape[:2]))
    size = (max(1, round(photo.shape[0] * scale)), max(1, round(photo.shape[1] * scale)))
    copy, _ = Pyramid(photo).reduced(1 / scale)  # halving is what OpenCV does quickest
    picture = resized(copy, size)
    if result.backward is None:
        return picture
    curves = [] if result.grid is None else grid_curves(result.grid, result.backward)
    curves = [rescale_points(curve, photo.shape[:2], size) for curve in curves]
    outline = rescale_points(outline_curve(result.backward), photo.shape[:2], size)
    return draw_curves(draw_curves(picture, curves, GRID_COLOUR), [outline], OUTLINE_COLOUR, closed=True)


# ---------------------------------------------------------------- pictures beside each other


def rgb_from_film(film: Float[np.ndarray, "h w"]) -> Picture:
    """Display grey in [0, 1] as an RGB picture."""
    grey = np.rint(np.clip(film, 0.0, 1.0) * 255).astype(np.uint8)
    return np.repeat(grey[:, :, None], 3, axis=2)


def resized(picture: Picture, size: tuple[int, int]) -> Picture:
    """The picture resized to (height, width): by area averaging when it shrinks, bilinearly when it grows."""
    shrinks = size[0] < picture.shape[0] or size[1] < picture.shape[1]
    return cv2.resize(picture, (size[1], size[0]), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)


def fitted(picture: Picture, size: tuple[int, int]) -> Picture:
    """The picture, its aspect ratio kept, as large as fits into (height, width), centred on a dark background."""
    scale = min(size[0] / picture.shape[0], size[1] / picture.shape[1])
    h, w = (max(1, min(full, round(side * scale))) for full, side in zip(size, picture.shape[:2], strict=True))
    canvas = np.full((*size, 3), PAPER, dtype=np.uint8)
    top, left = (size[0] - h) // 2, (size[1] - w) // 2
    canvas[top : top + h, left : left + w] = resized(picture, (h, w))
    return canvas


def side_by_side(pictures: Sequence[Picture], height: int = 1080) -> Picture:
    """Pictures in a row, all scaled to ``height`` pixels, their aspect ratios kept."""
    scaled = [resized(p, (height, max(1, round(p.shape[1] * height / p.shape[0])))) for p in pictures]
    gap = np.full((height, _GAP, 3), PAPER, dtype=np.uint8)
    row = [part for picture in scaled for part in (gap, picture)][1:]
    return np.concatenate(row, axis=1)


def captioned(picture: Picture, text: str) -> Picture:
    """The picture with one line of text (ASCII) on a dark strip above it."""
    strip = np.full((_CAPTION_HEIGHT, picture.shape[1], 3), PAPER, dtype=np.uint8)
    cv2.putText(strip, text, (6, _CAPTION_HEIGHT - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.5, INK, 1, cv2.LINE_AA)
    return np.concatenate([strip, picture], axis=0)


def contact_sheet(tiles: Sequence[Picture], captions: Sequence[str], columns: int) -> Picture:
    """Tiles of equal size with their captions, row by row on one dark sheet; ValueError for none or unequal ones."""
    if not tiles or len({tile.shape for tile in tiles}) != 1 or len(tiles) != len(captions) or columns < 1:
        got = f"{len(tiles)} tiles of shapes {sorted({tile.shape for tile in tiles})}, {len(captions)} captions"
        raise ValueError(f"contact_sheet: got {got}; allowed: one or more tiles of one shape, a caption each")
    cells = [np.pad(captioned(t, c), ((_GAP, 0), (_GAP, 0), (0, 0))) for t, c in zip(tiles, captions, strict=True)]
    empty = np.zeros_like(cells[0])
    cells += [empty] * (-len(cells) % columns)
    rows = [np.concatenate(cells[i : i + columns], axis=1) for i in range(0, len(cells), columns)]
    return np.pad(np.concatenate(rows, axis=0), ((0, _GAP), (0, _GAP), (0, 0)))


__all__ = [
    "annotated",
    "captioned",
    "contact_sheet",
    "draw_curves",
    "fitted",
    "grid_curves",
    "outline_curve",
    "resized",
    "rgb_from_film",
    "side_by_side",
]
