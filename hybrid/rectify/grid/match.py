"""Match windows of each cell to the mean cell: for views too crooked for cells to be registered.

A match observes where the cell's content lies relative to the other cells. Distortions that all cells share remain
unknown constants, one for each window, which the sheet's outline has to determine.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from hybrid.coords import opencv_from_photo
from hybrid.errors import require_at_least, require_at_most
from hybrid.film_view import FilmView
from hybrid.rectify.grid.repeat import Repeats, cell_moments, detail, shrunk
from hybrid.rectify.splines.sightings import Sightings

CORRELATED_PX = 10.0
"""Number of neighbouring pixels of the view that count as one, as they are correlated."""


@dataclass(frozen=True)
class MatchConfig:
    """Options of the match of cells. Pixels are those of the view."""

    reach_px: int = 8
    """How far a window is searched for."""
    fine_px: float = 1.5
    """Details below this size are smoothed away."""
    window_share: float = 0.25
    """Side of a window, as a fraction of the cell's."""
    windows: int = 30
    """Number of windows of a cell that are tried: those with most detail."""
    min_match: float = 0.6
    """Least normalised correlation of a window with the mean cell."""
    slack: float = 0.3
    """How far a window's typical correlation may lie below the best one's: texts are alike and anatomy only similar,
    but a view that is still crooked blurs both."""
    sigma_px: float = 0.5
    """Least noise stated for a match."""
    worst_sigma_px: float = 1.5
    """A match whose own noise, without that, exceeds this does not count."""
    constant_sigma: float = 0.05
    """Prior standard deviation of the constant that all cells share in one window, in film units."""
    pitch_sigma: float = 0.02
    """Prior standard deviation of the pitch, in film units."""
    shrink: int = 2
    """The view is reduced by this factor first: a smaller view is enough for a search to a pixel or two."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "reach_px", "shrink")
        require_at_least(self, 0.1, "fine_px")
        require_at_least(self, 1e-6, "constant_sigma", "pitch_sigma")
        require_at_most(self, 1, "window_share", "min_match")


def match_cells(view: FilmView, columns: Repeats, rows: Repeats, config: MatchConfig) -> tuple[Sightings, ...]:
    """Where the content of each cell lies relative to the mean cell: sightings of u and of v.

    view: the flat grey film, covering [0, 1]^2.
    """
    small, fine_px = shrunk(view.image[..., 0], config.shrink), config.fine_px / config.shrink
    image = detail(small, fine_px, 4.0 * fine_px + 4.0 / config.shrink)
    return _match_template(image, _mean_cell(image, columns, rows, config), columns, rows, config)


def _mean_cell(
    image: Float[np.ndarray, "h w"], columns: Repeats, rows: Repeats, config: MatchConfig
) -> Float[np.ndarray, "ch cw"]:
    """The cells' mean in pixels of the image, weighted by how well the cells agree: texts stay, anatomy fades.

    The weight is mean^2 / mean square of each pixel's neighbourhood: 1 where all cells are the same.
    """
    mean, square = cell_moments(image, columns, rows)
    sigma = 2.0 / config.shrink
    agreement = cv2.GaussianBlur(mean * mean, (0, 0), sigma) / (cv2.GaussianBlur(square, (0, 0), sigma) + 1e-2)
    return mean * np.clip(agreement, 0.0, 1.0)


def _match_template(
    image: Float[np.ndarray, "h w"],
    template: Float[np.ndarray, "ch cw"],
    columns: Repeats,
    rows: Repeats,
    config: MatchConfig,
) -> tuple[Sightings, ...]:
    """Windows of one cell matched in all cells. A window counts if the cells show it about as well as the best one."""
    h, w = image.shape
    reach = -(-config.reach_px // config.shrink)
    pitch, first = np.array([columns.pitch, rows.pitch]), np.array([columns.first, rows.first])
    cell_px = pitch * (w, h)
    half = np.maximum(np.rint(0.5 * config.window_share * cell_px).astype(int), 6 // config.shrink)
    number = np.stack(np.meshgrid(np.arange(columns.cells), np.arange(rows.cells)), axis=-1).reshape(-1, 2)
    tables = []
    for k, xy_px in enumerate(_choose_windows(template, half, config.windows)):
        (window,) = _patches(template, xy_px[None], half)
        uv = first + (number + xy_px / cell_px) * pitch
        seen = _within(uv * (w, h), half + reach, (w, h))
        if seen.sum() < 4:
            continue
        areas = _patches(image, uv[seen] * (w, h), half + reach)
        scores = np.stack([cv2.matchTemplate(area, window, cv2.TM_CCOEFF_NORMED) for area in areas])
        peaks = match_peaks(scores, CORRELATED_PX / config.shrink**2 / window.size)
        tables.append(np.column_stack([uv[seen], np.full(len(areas), k), number[seen], peaks]))
    typical = [float(np.median(t[:, 9])) for t in tables]
    least = max(config.min_match, max(typical, default=0.0) - config.slack)
    table = np.vstack([np.zeros((0, 10)), *(t for t, m in zip(tables, typical, strict=True) if m >= least)])
    made = [_match_sightings(table, axis, (h, w), config) for axis in (0, 1)]
    return tuple(s for s in made if s is not None)


def _choose_windows(
    mean_cell: Float[np.ndarray, "ch cw"], half: np.ndarray, count: int
) -> list[Float[np.ndarray, "2"]]:
    """Centres (x, y), in pixels of the cell, of the windows with most detail, at least half a window apart."""
    energy = cv2.boxFilter(mean_cell * mean_cell, -1, (2 * int(half[0]) + 1, 2 * int(half[1]) + 1))
    x = np.arange(half[0] + 1.0, mean_cell.shape[1] - half[0] - 1.0, max(2.0, half[0] / 3.0))
    y = np.arange(half[1] + 1.0, mean_cell.shape[0] - half[1] - 1.0, max(2.0, half[1] / 3.0))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    value = energy[points[:, 1].astype(int), points[:, 0].astype(int)]
    chosen = np.zeros((0, 2))
    floor = 0.02 * float(value.max(initial=0.0))
    for k in np.argsort(-value):
        if len(chosen) == count or value[k] <= floor:
            break
        if (np.abs(points[k] - chosen) >= 0.9 * half).any(axis=1).all():
            chosen = np.vstack([chosen, points[k]])
    return list(chosen)


def _within(centres: Float[np.ndarray, "n 2"], half: np.ndarray, size: tuple[int, int]) -> Bool[np.ndarray, " n"]:
    """Which patches of ``2 half + 1`` pixels around points (x, y) lie in an image of ``size`` (w, h)."""
    return np.asarray(((centres - half >= 1.0) & (centres + half + 1.0 <= size)).all(axis=1))


def _patches(
    image: Float[np.ndarray, "h w"], centres: Float[np.ndarray, "n 2"], half: np.ndarray
) -> list[Float[np.ndarray, "ph pw"]]:
    """The patches of ``2 half + 1`` pixels around points (x, y) of the image's frame."""
    size = (2 * int(half[0]) + 1, 2 * int(half[1]) + 1)
    return [cv2.getRectSubPix(image, size, (x, y)) for x, y in opencv_from_photo(centres).tolist()]


def match_peaks(scores: Float[np.ndarray, "n s s"], noise: float) -> Float[np.ndarray, "n 5"]:
    """Shift (x, y) of the best place from the middle, the variances of both in px^2, and the correlation there.

    scores: correlation surfaces. noise: one over the number of pixels that count. The variances are infinite where the
    best place is no peak: at the rim or on a ridge.
    """
    n, side, _ = scores.shape
    row, column = np.divmod(scores.reshape(n, -1).argmax(axis=1), side)
    inside = (row > 0) & (row < side - 1) & (column > 0) & (column < side - 1)
    around = np.arange(-1, 2)
    y = np.clip(row, 1, side - 2)[:, None, None] + around[:, None]
    x = np.clip(column, 1, side - 2)[:, None, None] + around
    near = scores[np.arange(n)[:, None, None], y, x].astype(np.float64)
    xx = near[:, 1, 0] - 2 * near[:, 1, 1] + near[:, 1, 2]
    yy = near[:, 0, 1] - 2 * near[:, 1, 1] + near[:, 2, 1]
    xy = 0.25 * (near[:, 0, 0] + near[:, 2, 2] - near[:, 0, 2] - near[:, 2, 0])
    gx, gy = 0.5 * (near[:, 1, 2] - near[:, 1, 0]), 0.5 * (near[:, 2, 1] - near[:, 0, 1])
    det = xx * yy - xy * xy
    good = inside & (xx < 0) & (yy < 0) & (det > 1e-3 * xx * yy)
    safe = np.where(good, det, 1.0)
    shift = np.clip(np.stack([xy * gy - yy * gx, xy * gx - xx * gy], axis=1) / safe[:, None], -1.0, 1.0)
    shift += np.stack([column, row], axis=1) - side // 2
    # Variance of the peak of a correlation surface: residual variance over curvature.
    peak = scores[np.arange(n), row, column].astype(np.float64)
    variance = -np.stack([yy, xx], axis=1) * (noise * np.maximum(1.0 - peak * peak, 0.02) / safe)[:, None]
    keep = good[:, None]
    return np.column_stack([np.where(keep, shift, 0.0), np.where(keep, variance, np.inf), peak])


def _match_sightings(
    table: Float[np.ndarray, "n 10"], axis: int, size: tuple[int, int], config: MatchConfig
) -> Sightings | None:
    """Sightings along one axis from matches (u, v, window, column, row, dx, dy, variances, correlation)."""
    sigma_px = np.sqrt(table[:, 7 + axis])
    good = (table[:, 9] >= config.min_match) & (sigma_px <= config.worst_sigma_px / config.shrink)
    if good.sum() < 12:
        return None
    t, sigma_px = table[good], np.hypot(sigma_px[good], config.sigma_px / config.shrink)
    pixels = size[1 - axis]
    seen = t[:, :2].copy()
    seen += t[:, 5:7] / (size[1], size[0])
    windows = np.unique(t[:, 2])
    member = (t[:, 2][:, None] == windows).astype(np.float64)
    number = t[:, 3 + axis]
    shared = np.column_stack([member, number - number.mean()])
    shared_sigma = np.append(np.full(len(windows), config.constant_sigma), config.pitch_sigma)
    return Sightings(axis, seen, t[:, axis].copy(), sigma_px / pixels, shared, shared_sigma, t[:, 2].astype(int))


__all__ = ["MatchConfig", "match_cells", "match_peaks"]
