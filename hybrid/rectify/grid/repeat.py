"""Cells that look alike: what even a film without rules tells about its grid.

Corner texts, scale bars and tables are printed at the same place of every cell, and slices of one series look alike.
The pitch shows in the autocorrelation of the flat film. Then the cells are matched (grid/match.py) and registered
(grid/congeal.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import cv2
import numpy as np
from jaxtyping import Float, Int

from hybrid.errors import require_at_most
from hybrid.film_view import FilmView
from hybrid.rectify.grid.lines import MAX_CELLS


@dataclass(frozen=True)
class RepeatConfig:
    """Options of the search for cells that repeat."""

    margin: float = 0.06
    """Widest margin on either side of the grid, in film units."""
    stretch: float = 0.12
    """How much longer than the mean cell a cell may look through a map that is not yet straight."""
    min_correlation: float = 0.3
    """Least autocorrelation of the film at one pitch."""
    octave_ratio: float = 0.7
    """Of the pitches that correlate at least this well relative to the best, the smallest counts."""
    snug: float = 0.992
    """A grid that fills more than this fraction of the film is taken to have no margins."""

    def __post_init__(self) -> None:
        require_at_most(self, 1, "octave_ratio")


@dataclass(frozen=True)
class Repeats:
    """Cells that repeat along one axis (0: u, 1: v): cell i starts at ``first + i * pitch``, in film units.

    filling: whether they are taken to reach from edge to edge.
    """

    axis: int
    first: float
    pitch: float
    cells: int
    filling: bool = False
    pitch_at: ClassVar[int] = -1
    """Index of the pitch among the constants that its sightings share."""

    def lines(self) -> Float[np.ndarray, " n"]:
        """Film coordinates of the cells' ends."""
        return self.first + self.pitch * np.arange(self.cells + 1)

    def adjusted(self, constants: Float[np.ndarray, " g"]) -> Repeats:
        """With the pitch found by a fit of its matches; the place, which texts do not determine, stays centred."""
        pitch = float(np.clip(self.pitch + constants[self.pitch_at], 0.5 * self.pitch, 1.0 / self.cells))
        return replace(self, first=0.5 * (1.0 - self.cells * pitch), pitch=pitch)


def shrunk(image: Float[np.ndarray, "h w"], factor: int) -> Float[np.ndarray, "sh sw"]:
    """The same film on fewer pixels, each the mean of ``factor`` by ``factor``."""
    if factor == 1:
        return image
    size = [max(round(n / factor), 1) for n in image.shape[::-1]]  # not fx and fy: these leave odd pixels over
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def detail(image: Float[np.ndarray, "h w"], fine: float, coarse: float) -> Float[np.ndarray, "h w"]:
    """The image without its light (scales above ``coarse`` px) and noise (below ``fine`` px), high contrast clipped."""
    # What is smooth over ``coarse`` px is as smooth on a copy a third of the size, and found nine times as fast there.
    light = cv2.resize(
        cv2.GaussianBlur(shrunk(image, 3), (0, 0), coarse / 3), image.shape[::-1], interpolation=cv2.INTER_LINEAR
    )
    band = cv2.GaussianBlur(image, (0, 0), fine) - light
    cap = 3.0 * float(np.mean(np.abs(band))) + 1e-3
    return np.clip(band, -cap, cap)


def find_repeats(grey: Float[np.ndarray, "h w"], config: RepeatConfig) -> tuple[Repeats | None, Repeats | None]:
    """The pitch at which the flat film repeats itself along u and along v; None where it does not."""
    band = detail(shrunk(grey, 2), 2.0, 8.0)
    return _repeats_along(0, autocorrelation(band), config), _repeats_along(1, autocorrelation(band.T), config)


def _repeats_along(axis: int, curve: Float[np.ndarray, " n"], config: RepeatConfig) -> Repeats | None:
    """The cells whose pitch an autocorrelation shows; None where it shows none."""
    found = []
    for cells in range(2, MAX_CELLS + 1):
        chain = _peak_chain(curve, cells, config)
        if chain is not None:
            found.append((chain[0], cells, chain[1]))
    top = max((f[0] for f in found), default=0.0)
    if top < config.min_correlation:
        return None
    _, cells, pitch = [f for f in found if f[0] >= config.octave_ratio * top][-1]
    pitch = 1.0 / cells if pitch * cells > config.snug else pitch
    return Repeats(axis, 0.5 * (1.0 - cells * pitch), pitch, cells)


def _peak_chain(curve: Float[np.ndarray, " n"], cells: int, config: RepeatConfig) -> tuple[float, float] | None:
    """Correlation at one pitch, and the pitch in film units, if the film repeats ``cells`` times; else None.

    The peaks at 1, 2, ... pitches are followed, each from the last: the map is not yet straight, and the longest lag
    averages over most of the film. Each must be a real peak (not a slope), and ``cells`` must be the number of cells
    that fits the pitch best.
    """
    n = len(curve)
    low, high = int((1.0 - 2.0 * config.margin) / cells * n), int(np.ceil((1.0 + config.stretch) / cells * n))
    first, lag, height, count = 0.0, 0.0, 0.0, 1
    for multiple in range(1, max(2, int(0.75 * cells) + 1)):
        if multiple > 1:
            low, high = int(lag * multiple / (multiple - 1) * 0.95), int(lag * multiple / (multiple - 1) * 1.05) + 1
        if low < 8 or high > n - 2:
            break
        peak = low + int(np.argmax(curve[low : high + 1]))
        left, here, right = (float(c) for c in curve[peak - 1 : peak + 2])
        if here < max(left, right) or here < 0.5 * height:
            break
        height = max(height, here)
        first = here if multiple == 1 else first
        lag, count = highest(curve, peak), multiple
    if first == 0.0:
        return None
    pitch = lag / count / n
    return (first, min(pitch, 1.0 / cells)) if round(0.98 / pitch) == cells else None


def highest(curve: Float[np.ndarray, " n"], peak: int) -> float:
    """Where the parabola through a peak and its neighbours is highest."""
    left, here, right = (float(c) for c in curve[peak - 1 : peak + 2])
    return peak + float(np.clip(0.5 * (left - right) / min(left - 2 * here + right, -1e-9), -1.0, 1.0))


def autocorrelation(band: Float[np.ndarray, "h w"]) -> Float[np.ndarray, " n"]:
    """Correlation of the image with itself shifted by 0, 1, ... w - 1 columns, over what overlaps."""
    w = band.shape[1]
    size = 2 * cv2.getOptimalDFTSize(w)
    padded = cv2.copyMakeBorder(band, 0, 0, 0, size - w, cv2.BORDER_CONSTANT)
    spectrum = cv2.dft(padded, flags=cv2.DFT_ROWS)  # real and imaginary parts in turn, but for the first and last
    squares = cv2.reduce(cv2.multiply(spectrum, spectrum), 0, cv2.REDUCE_SUM, dtype=cv2.CV_64F)[0]
    power = np.concatenate([squares[:1], squares[1:-1:2] + squares[2:-1:2], squares[-1:]])
    products = np.fft.irfft(power, size)[:w]
    energy = np.cumsum(cv2.reduce(cv2.multiply(band, band), 0, cv2.REDUCE_SUM, dtype=cv2.CV_64F)[0])
    # Energy of the first and of the last w - lag columns
    first, last = energy[::-1], energy[-1] - np.concatenate([[0.0], energy[:-1]])
    return products / np.sqrt(np.maximum(first * last, 1e-9))


# ---------------------------------------------------------------- cells


def cell_corners(
    image: Float[np.ndarray, "h w"], columns: Repeats, rows: Repeats, number: Int[np.ndarray, "n 2"]
) -> tuple[tuple[int, int], Float[np.ndarray, "n 2"]]:
    """Size (width, height) of any cell in pixels of the image, and corners (x, y) of some cells in OpenCV's pixels.

    number: (column, row) of each of these cells.
    """
    h, w = image.shape
    size = (max(8, round(columns.pitch * w)), max(8, round(rows.pitch * h)))
    first, pitch = np.array([columns.first, rows.first]), np.array([columns.pitch, rows.pitch])
    return size, (first + (number + 0.5) * pitch) * (w, h) - 0.5 * np.array(size)


def _cell_image(
    image: Float[np.ndarray, "h w"], columns: Repeats, rows: Repeats, column: int, row: int
) -> Float[np.ndarray, "ch cw"]:
    """One cell in pixels of the view, shifted by a fraction of a pixel so that its corner falls on a pixel's."""
    size, ((x, y),) = cell_corners(image, columns, rows, np.array([[column, row]]))
    shift = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    return cv2.warpAffine(
        image, shift, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
    )


def cell_agreement(view: FilmView, columns: Repeats, rows: Repeats, fine_px: float = 0.7) -> float:
    """Share of the fine detail that all cells have in common, in [0, 1]: largest where the cells are straight.

    Texts and scale bars that are a pixel off lower it. It does not use the matches that a map was made from, so it is
    an independent judge of such maps.
    """
    image = detail(view.image[..., 0], fine_px, 4.0 * fine_px + 4.0)
    mean, square = cell_moments(image, columns, rows)
    return float(np.mean(mean * mean) / max(float(np.mean(square)), 1e-9))


def cell_moments(
    image: Float[np.ndarray, "h w"], columns: Repeats, rows: Repeats
) -> tuple[Float[np.ndarray, "ch cw"], Float[np.ndarray, "ch cw"]]:
    """Mean and mean square over all cells, in pixels of the view."""
    cells = [_cell_image(image, columns, rows, j, i) for i in range(rows.cells) for j in range(columns.cells)]
    total, squares = np.zeros_like(cells[0]), np.zeros_like(cells[0])
    for cell in cells:
        total += cell
        squares += cell * cell
    return total / len(cells), squares / len(cells)


__all__ = [
    "RepeatConfig",
    "Repeats",
    "autocorrelation",
    "cell_agreement",
    "cell_corners",
    "cell_moments",
    "detail",
    "find_repeats",
    "highest",
    "shrunk",
]
