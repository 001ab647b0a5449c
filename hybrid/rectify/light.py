"""The smooth light on a flat film: its gain from the brightest parts, its veil from the darkest."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from hybrid.coords import film_centres, film_centres_1d
from hybrid.errors import require_at_least
from hybrid.records import SliceGrid
from hybrid.rectify import bspline
from hybrid.rectify.bspline import NormalEquations

FIELD_SIZE = (64, 64)
"""Nodes (pixel centres) at which gain and veil are kept; between them they are linear."""

MIN_CELLS = 9
"""Fewer bright places than this do not tell how the light varies."""
FREEDOM = 16.0
"""About how many numbers the smooth gain takes from the tiles that it is fitted to."""


@dataclass(frozen=True)
class LightConfig:
    """How the light is told from the print."""

    veil_tiles: int = 28
    """The darkest part of each of this many tiles a side is a witness of the veil."""
    veil_quantile: float = 0.05
    """Which part of a tile's pixels counts as its darkest."""
    veil_intervals: int = 8
    """Knot intervals of the veil: reflections have edges, so it is finer than the gain."""
    veil_smoothing: float = 1e-6
    veil_above: float = 0.02
    """Weight of tiles brighter than the veil against tiles darker: a tile without black must not lift it."""
    gain_tiles: int = 8
    """The brightest part of each of this many tiles a side is a witness of the gain: about one per slice."""
    gain_quantile: float = 0.985
    gain_intervals: int = 3
    gain_smoothing: float = 1e-4
    gain_above: float = 0.8
    """Weight of tiles brighter than the gain against tiles darker: a tile without white must not lower it much."""
    gain_range: float = 3.0
    """The gain leaves its median by at most this factor: beyond, noise would be amplified more than it is worth."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "veil_tiles", "veil_intervals", "gain_tiles", "gain_intervals", "gain_range")


@dataclass(frozen=True, eq=False)
class Light:
    """Gain and veil on small lattices of pixel centres, in linear grey; pedestal: the part of the veil that is kept."""

    gain: Float32[np.ndarray, "gh gw"]
    veil: Float32[np.ndarray, "vh vw"]
    pedestal: float

    @staticmethod
    def even(pedestal: float) -> Light:
        """Light that is the same everywhere."""
        return Light(np.ones(FIELD_SIZE, np.float32), np.full(FIELD_SIZE, pedestal, np.float32), pedestal)


def find_light(
    grey: Float[np.ndarray, "h w"],
    valid: Bool[np.ndarray, "h w"],
    grid: SliceGrid | None,
    config: LightConfig,
) -> Light:
    """Gain and veil of the whole film from its darkest and brightest parts."""
    n = config.veil_tiles
    dark, weight = _tile_quantile(grey, valid, (n, n), config.veil_quantile)
    if weight.sum() < 0.1 * weight.size:
        return Light.even(0.0)
    veil = _envelope(dark, weight, config.veil_intervals, config.veil_smoothing, config.veil_above)
    veil = np.clip(veil, np.float32(dark[weight > 0].min()), np.float32(dark[weight > 0].max()))
    # A film has some grey of its own where it is blackest: what is even over the sheet is kept, not called a veil.
    pedestal = float(np.quantile(veil, 0.05))
    lifted = cv2.resize(veil, grey.shape[::-1], interpolation=cv2.INTER_LINEAR)
    tiles = (config.gain_tiles, config.gain_tiles)
    if grid is not None and grid.rows * grid.cols >= MIN_CELLS:
        tiles = (grid.rows, grid.cols)
    bright, weight = _tile_quantile(np.maximum(grey - lifted, 0.0), valid, tiles, config.gain_quantile)
    typical = float(np.median(bright[weight > 0])) if (weight > 0).any() else 0.0
    weight = weight * (bright > 0.2 * typical)  # tiles without any print say nothing about the light
    if typical <= 0 or np.count_nonzero(weight) < MIN_CELLS:
        return Light(np.ones(FIELD_SIZE, np.float32), veil, pedestal)
    logs = np.log(np.maximum(bright, 0.02 * typical))
    gain = _envelope(logs, weight, config.gain_intervals, config.gain_smoothing, config.gain_above)
    limit = np.float32(np.log(config.gain_range))
    return Light(np.exp(np.clip(_beyond_scatter(gain, logs, weight), -limit, limit)), veil, pedestal)


def _beyond_scatter(
    field: Float32[np.ndarray, "n n"], value: Float[np.ndarray, "th tw"], weight: Float[np.ndarray, "th tw"]
) -> Float32[np.ndarray, "n n"]:
    """By how much the field differs from its median, shrunk by what the scatter of the tiles around it explains (James
    and Stein 1961): the brightest parts of a print are not equally bright, and a fit to those varies without any light.
    """
    seen, at_tiles = weight > 0, cv2.resize(field, value.shape[::-1], interpolation=cv2.INTER_AREA)
    scatter = float(np.square(value - at_tiles)[seen].mean()) * min(1.0, FREEDOM / np.count_nonzero(seen))
    kept = max(0.0, 1.0 - scatter / max(float(at_tiles[seen].var()), 1e-12))
    return np.float32(kept) * (field - np.median(field))


def _tile_quantile(
    grey: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"], tiles: tuple[int, int], quantile: float
) -> tuple[Float[np.ndarray, "th tw"], Float[np.ndarray, "th tw"]]:
    """A quantile of the grey in each of ``tiles`` (rows, columns), and its weight: 0 where pixels are missing."""
    rows, cols = tiles
    height, width = max(grey.shape[0] // rows, 1), max(grey.shape[1] // cols, 1)
    size = (cols * width, rows * height)
    fitted = cv2.resize(grey, size, interpolation=cv2.INTER_AREA) if grey.shape != size[::-1] else grey
    order = fitted.reshape(rows, height, cols, width).swapaxes(1, 2).reshape(rows, cols, -1)
    rank = min(int(quantile * order.shape[2]), order.shape[2] - 1)
    value = np.partition(order, rank, axis=2)[..., rank].astype(np.float64)
    return value, np.where(share_seen(valid, (cols, rows)) > 0.99, 1.0, 0.0)


def share_seen(valid: Bool[np.ndarray, "h w"], size: tuple[int, int]) -> Float32[np.ndarray, "sh sw"]:
    """Share of each pixel of a picture of ``size`` (width, height) that is valid; mostly all is, which is quick."""
    if valid.all():
        return np.ones(size[::-1], np.float32)
    return cv2.resize(valid.astype(np.float32), size, interpolation=cv2.INTER_AREA)


@cache
def _tile_design(tiles: tuple[int, int], intervals: int) -> np.ndarray:
    """Spline rows at the centres of a tiling."""
    rows = bspline.design(film_centres(tiles).reshape(-1, 2), intervals)
    rows.setflags(write=False)
    return rows


@cache
def _field_weights(intervals: int) -> np.ndarray:
    """Spline weights at the pixel centres of the gain and veil fields, along either axis."""
    weights = bspline.axis_weights(film_centres_1d(FIELD_SIZE[0]), intervals)
    weights.setflags(write=False)
    return weights


def _envelope(
    value: Float[np.ndarray, "th tw"],
    weight: Float[np.ndarray, "th tw"],
    intervals: int,
    smoothing: float,
    above: float,
) -> Float32[np.ndarray, "n n"]:
    """A smooth surface (64, 64) that leaves most values on one side: those above it weigh ``above``, those below the
    rest (asymmetric least squares)."""
    rows = _tile_design(value.shape, intervals)
    data, base = value.reshape(-1, 1), weight.ravel()
    unit = max(float(np.abs(data[base > 0]).max()), 1e-9)
    side = np.ones_like(base)
    for _ in range(6):
        fit = NormalEquations.of(rows, base * side, data / unit, intervals).solve(smoothing)
        last, side = side, np.where((data / unit - rows @ fit)[:, 0] > 0, above, 1.0 - above)
        if np.array_equal(last, side):
            break
    along = _field_weights(intervals)
    return (along @ fit.reshape(intervals + 3, intervals + 3) @ along.T * unit).astype(np.float32)
