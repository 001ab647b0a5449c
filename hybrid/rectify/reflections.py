"""Reflections with edges, such as windows: what lies across the borders of slices where every other slice is black.

The smooth veil (``light``) follows broad reflections. What is left of a window or a lamp is brighter than black at
places that are black in most slices of the film. So may be print (a larger organ, a scout view), but print ends at the
border of its slice, and a reflection does not know of borders: only what crosses one is taken for a reflection. How
bright it may be is told by places that are black in nearly all slices: what is brighter, an organ on which it lies, is
print.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from hybrid.coords import centres_1d, film_centres_1d, pixel_from_film, sample_bilinear
from hybrid.errors import require_at_least
from hybrid.records import SliceGrid

Grey = Float32[np.ndarray, "h w"]

CELL_SAMPLES = 40
"""Places along each side of a slice at which the slices are compared."""


@dataclass(frozen=True)
class ReflectionConfig:
    """What counts as a reflection. Light is in units of the print's white."""

    side_px: int = 256
    """Longer side of the copy on which reflections are found."""
    black: float = 0.07
    """Light up to which print is called black."""
    black_share: float = 0.6
    """A place within the slice is known to be black if it is so in this share of the slices."""
    sure_share: float = 0.8
    """The same of the places that tell how bright a reflection is: what is brighter elsewhere in it is print."""
    brightest: tuple[float, float] = (0.95, 1.3)
    """Quantile of these places that counts, and by how much a reflection may be brighter than that."""
    margin_px: int = 1
    """Pixels at the rim of such places that are not believed: texts and organs are blurred and not quite alike."""
    least: float = 0.02
    """Light that a reflection adds at least; less is left to the smooth veil."""
    bridge_px: int = 1
    """Gaps up to twice this wide, as rules between slices leave, do not part a reflection."""
    least_pixels: int = 20
    """Pixels of a reflection in each of two slices, at least."""
    min_cells: int = 6
    """Fewer slices than this do not tell what is usual."""

    def __post_init__(self) -> None:
        require_at_least(self, 16, "side_px")


@dataclass(frozen=True, eq=False)
class _Cells:
    """Which slice each pixel belongs to (-1 outside the grid), and the place in it, rows and columns apart.

    row, row_place: (h,). col, col_place: (w,).
    """

    row: np.ndarray
    row_place: np.ndarray
    col: np.ndarray
    col_place: np.ndarray


def find_reflections(
    light: Grey, valid: Bool[np.ndarray, "h w"], grid: SliceGrid | None, config: ReflectionConfig
) -> Grey:
    """What reflections with edges add to even light (1: the print's white, 0: its black), 0 where none was found."""
    none = np.zeros(light.shape, np.float32)
    if grid is None or grid.rows * grid.cols < config.min_cells:
        return none
    # Thin strokes are no reflections, wherever they are.
    dark = cv2.morphologyEx(light.astype(np.float32), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    cells = _cells(grid, light.shape)
    black = np.where(valid, _share_black(dark, valid, cells, grid, config), np.float32(0.0))
    black = cv2.erode(black, np.ones((2 * config.margin_px + 1,) * 2, np.uint8))
    known = black >= config.black_share
    brightest = _across_borders(np.where(known, dark, 0.0), black >= config.sure_share, cells, grid, config)
    if not brightest.any():
        return none
    reflected = np.minimum(np.maximum(dark, 0.0), cv2.dilate(brightest, np.ones((3, 3), np.uint8)))
    return _spread(reflected, known)


def _cells(grid: SliceGrid, size: tuple[int, ...]) -> _Cells:
    """Slices and places of the pixel centres of a film of ``size``."""
    lines_v, lines_u = _lines(grid)
    row, row_place = _place(film_centres_1d(size[0]), lines_v)
    col, col_place = _place(film_centres_1d(size[1]), lines_u)
    return _Cells(row, row_place, col, col_place)


def _place(at: Float[np.ndarray, " n"], lines: Float[np.ndarray, " k"]) -> tuple[np.ndarray, np.ndarray]:
    """The interval between lines in which each coordinate lies (-1: outside), and the number of its place there."""
    position = np.interp(at, lines, np.arange(len(lines)))
    interval = np.minimum(position.astype(int), len(lines) - 2)
    place = np.minimum(((position - interval) * CELL_SAMPLES).astype(int), CELL_SAMPLES - 1)
    return np.where((at >= lines[0]) & (at <= lines[-1]), interval, -1), place


def seen_slices(film: Grey, grid: SliceGrid, samples: int) -> Float32[np.ndarray, "rows n cols n"]:
    """A film's slices, each at ``samples`` x ``samples`` places."""
    along_v, along_u = (_places(lines, samples) for lines in _lines(grid))
    points = pixel_from_film(np.stack(np.meshgrid(along_u, along_v), axis=-1), (film.shape[0], film.shape[1]))
    return sample_bilinear(film, points).reshape(grid.rows, samples, grid.cols, samples)


def _lines(grid: SliceGrid) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, " c"]]:
    """Film v and u of the grid's lines, which are straight on the flat film."""
    return grid.vertices[..., 1].mean(axis=1), grid.vertices[..., 0].mean(axis=0)


def _places(lines: Float[np.ndarray, " k"], samples: int) -> Float[np.ndarray, " n"]:
    """Film coordinates of the places between lines, interval after interval."""
    return np.interp(centres_1d(samples * (len(lines) - 1)) / samples, np.arange(len(lines)), lines)


def _share_black(
    dark: Grey, valid: Bool[np.ndarray, "h w"], cells: _Cells, grid: SliceGrid, config: ReflectionConfig
) -> Grey:
    """In which share of the slices seen there the place of each pixel is black; 0 outside the grid, and where too few
    are seen to tell."""
    seen = seen_slices(valid.astype(np.float32), grid, CELL_SAMPLES) > 0.5
    black = seen & (seen_slices(dark, grid, CELL_SAMPLES) < config.black)
    count = seen.sum(axis=(0, 2))
    share = np.where(count >= config.min_cells, black.sum(axis=(0, 2)) / np.maximum(count, 1), 0.0).astype(np.float32)
    within = (cells.row >= 0)[:, None] & (cells.col >= 0)[None]
    return np.where(within, share[np.ix_(cells.row_place, cells.col_place)], np.float32(0.0))


def _across_borders(
    light: Grey, sure: Bool[np.ndarray, "h w"], cells: _Cells, grid: SliceGrid, config: ReflectionConfig
) -> Grey:
    """How bright each reflection is at most, on its pixels; 0 elsewhere.

    light: where print is known to be black, else 0. Reflections are the connected bright parts of it that lie in two
    slices or more. sure: places that tell how bright they are.
    """
    bright = light > config.least
    joined = cv2.dilate(bright.astype(np.uint8), np.ones((2 * config.bridge_px + 1,) * 2, np.uint8))
    count, found = cv2.connectedComponents(joined)
    label = np.asarray(found, dtype=np.intp)
    cell = cells.row[:, None] * grid.cols + cells.col[None]
    pixels = np.bincount(label[bright] * grid.rows * grid.cols + cell[bright], minlength=count * grid.rows * grid.cols)
    spans = (pixels.reshape(count, -1) >= config.least_pixels).sum(axis=1)
    quantile, brighter = config.brightest
    brightest, told = np.zeros(count, np.float32), np.where(bright & sure, label, 0)
    for k in np.flatnonzero(spans >= 2):
        values = light[told == k]
        if values.size:
            brightest[k] = brighter * np.quantile(values, quantile, method="lower")
    return np.where(bright, brightest[label], np.float32(0.0))


def _spread(values: Grey, known: Bool[np.ndarray, "h w"]) -> Grey:
    """Values where they are known, and a smooth continuation between them (a pyramid of weighted means)."""
    levels = [(np.where(known, values, 0.0).astype(np.float32), known.astype(np.float32))]
    while min(levels[-1][0].shape) > 2:
        value, weight = levels[-1]
        size = ((value.shape[1] + 1) // 2, (value.shape[0] + 1) // 2)
        value, weight = (cv2.resize(x, size, interpolation=cv2.INTER_AREA) for x in (value, weight))
        levels.append((value, weight))
    filled = levels[-1][0] / np.maximum(levels[-1][1], 1e-6)
    for value, weight in reversed(levels[:-1]):
        filled = value + (1.0 - weight) * cv2.resize(filled, value.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return filled


__all__ = ["ReflectionConfig", "find_reflections", "seen_slices"]
