"""Cells that look alike: what a film without rules still tells about its grid.

Corner texts, scale bars and tables are printed at the same place of every cell, and slices of one series look
alike. The pitch shows in the autocorrelation of the flat film. Then windows of each cell are matched to the mean
cell. A match observes where the cell's content lies relative to the other cells; distortions that all cells
share stay unknown constants, one for each window, which the sheet's outline has to pin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float

from hybrid.coords import opencv_from_photo
from hybrid.rectify.film_view import FilmView
from hybrid.rectify.sightings import Sightings


@dataclass(frozen=True)
class MatchRound:
    """How cells are matched in one round."""

    reach_px: int
    """How far a window is searched, in pixels of the view."""
    fine_px: float
    """Details below this size are smoothed away."""
    window_share: float
    """Side of a window, as a fraction of the cell's."""
    agreement: float
    """Power of the share that all cells have in common, by which details of the mean cell are weighted."""
    sigma_px: float
    """Least noise stated for a match, in pixels of the view."""
    windows: int
    """Windows of a cell that are tried: those with most detail."""
    match_slack: float
    """How far a window's typical correlation may lie below the best one's: texts are alike, anatomy is similar, but
    a view that is still crooked blurs both."""


@dataclass(frozen=True)
class RepeatConfig:
    """Options of the search for cells that repeat."""

    max_cells: int = 10
    """Most cells along one side."""
    margin: float = 0.06
    """Widest margin on either side of the grid, in film units."""
    stretch: float = 0.12
    """How much longer than the mean cell a cell may look through a map that is not yet straight."""
    min_correlation: float = 0.2
    """Least autocorrelation of the film at one pitch."""
    octave_ratio: float = 0.7
    """Of the pitches that correlate at least this well relative to the best, the smallest counts."""
    first: MatchRound = MatchRound(9, 1.5, 0.22, 0.0, 2.0, 16, 1.0)
    """What is done in the first round, against one cell."""
    second: MatchRound = MatchRound(8, 1.5, 0.25, 1.0, 1.5, 12, 0.3)
    """What is done in the second round, against the mean cell; then the cells are registered (congeal.py)."""
    min_match: float = 0.6
    """Least normalised correlation of a window with the mean cell."""
    worst_sigma_px: float = 1.5
    """A match less exact than this, beside the least noise of its round, does not count."""
    constant_sigma: float = 0.05
    """Prior standard deviation of what all cells share in one window, in film units."""
    pitch_sigma: float = 0.02
    """Prior standard deviation of the pitch, in film units."""
    snug: float = 0.992
    """A grid that fills more than this fraction of the film is taken to have no margins."""


@dataclass(frozen=True)
class Repeats:
    """Cells that repeat along one axis (0: u, 1: v): cell i starts at ``first + i * pitch``, in film units."""

    axis: int
    first: float
    pitch: float
    cells: int
    correlation: float

    def lines(self) -> Float[np.ndarray, " n"]:
        """Film coordinates of the cells' ends."""
        return self.first + self.pitch * np.arange(self.cells + 1)

    def adjusted(self, constants: Float[np.ndarray, " g"]) -> Repeats:
        """With the pitch that a fit of its matches found; the place, which texts do not tell, stays centred."""
        pitch = float(np.clip(self.pitch + constants[-1], 0.5 * self.pitch, 1.0 / self.cells))
        return replace(self, first=0.5 * (1.0 - self.cells * pitch), pitch=pitch)


def detail(image: Float[np.ndarray, "h w"], fine: float, coarse: float) -> Float[np.ndarray, "h w"]:
    """The image without its light (scales above ``coarse`` px) and noise (below ``fine`` px), strong contrasts cut."""
    # What is smooth over ``coarse`` px is as smooth on a copy a third of the size, and nine times as quick to find.
    third = cv2.resize(image, None, fx=1 / 3, fy=1 / 3, interpolation=cv2.INTER_AREA)
    light = cv2.resize(cv2.GaussianBlur(third, (0, 0), coarse / 3), image.shape[::-1], interpolation=cv2.INTER_LINEAR)
    band = cv2.GaussianBlur(image, (0, 0), fine) - light
    cap = 3.0 * float(np.mean(np.abs(band))) + 1e-3
    return np.clip(band, -cap, cap)


def find_repeats(grey: Float[np.ndarray, "h w"], axis: int, config: RepeatConfig) -> Repeats | None:
    """The pitch at which the flat film looks like itself along one axis; None where it does not."""
    small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    band = detail(small, 2.0, 8.0)
    curve = _autocorrelation(band if axis == 0 else band.T)
    found = []
    for cells in range(2, config.max_cells + 1):
        chain = _peak_chain(curve, cells, config)
        if chain is not None:
            found.append((chain[0], cells, chain[1]))
    top = max((f[0] for f in found), default=0.0)
    if top < config.min_correlation:
        return None
    correlation, cells, pitch = [f for f in found if f[0] >= config.octave_ratio * top][-1]
    pitch = 1.0 / cells if pitch * cells > config.snug else pitch
    return Repeats(axis, 0.5 * (1.0 - cells * pitch), pitch, cells, min(correlation, 1.0))


def _peak_chain(curve: Float[np.ndarray, " n"], cells: int, config: RepeatConfig) -> tuple[float, float] | None:
    """Correlation at one pitch, and the pitch in film units, if the film repeats ``cells`` times; else None.

    The peaks at 1, 2, ... pitches are followed, each from the last: the map is not yet straight, and the longest
    lag averages over most of the film. A peak must be one (not a slope), and lie where ``cells`` cells fit best.
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
        lag, count = peak + 0.5 * (left - right) / min(left - 2 * here + right, -1e-9), multiple
    if first == 0.0:
        return None
    pitch = lag / count / n
    return (first, min(pitch, 1.0 / cells)) if round(0.98 / pitch) == cells else None


def _autocorrelation(band: Float[np.ndarray, "h w"]) -> Float[np.ndarray, " n"]:
    """Correlation of the image with itself shifted by 0, 1, ... w - 1 columns, over what overlaps."""
    w = band.shape[1]
    size = 2 * cv2.getOptimalDFTSize(w)
    spectrum = np.fft.rfft(band, size, axis=1)
    products = np.fft.irfft(np.sum(np.abs(spectrum) ** 2, axis=0), size)[:w]
    energy = np.cumsum(np.sum(band**2, axis=0))
    # Energy of the first and of the last w - lag columns
    first, last = energy[::-1], energy[-1] - np.concatenate([[0.0], energy[:-1]])
    return products / np.sqrt(np.maximum(first * last, 1e-9))


# ---------------------------------------------------------------- matching


def match_cells(
    view: FilmView, columns: Repeats, rows: Repeats, search: MatchRound, config: RepeatConfig
) -> tuple[Sightings, ...]:
    """Where the content of each cell lies against the mean cell: sightings of u and of v.

    view: the flat grey film, covering [0, 1]^2.
    """
    image = detail(view.image[..., 0], search.fine_px, 4.0 * search.fine_px + 4.0)
    return _match_template(image, _mean_cell(image, columns, rows, search.agreement), columns, rows, search, config)


def match_to_one_cell(
    view: FilmView, columns: Repeats, rows: Repeats, search: MatchRound, config: RepeatConfig
) -> tuple[Sightings, ...]:
    """The same against the cell in the middle of the film: for a view so crooked that the mean cell is a blur."""
    image = detail(view.image[..., 0], search.fine_px, 4.0 * search.fine_px + 4.0)
    cell = cell_image(image, columns, rows, columns.cells // 2, rows.cells // 2)
    return _match_template(image, cell, columns, rows, search, config)


def _match_template(
    image: Float[np.ndarray, "h w"],
    template: Float[np.ndarray, "ch cw"],
    columns: Repeats,
    rows: Repeats,
    search: MatchRound,
    config: RepeatConfig,
) -> tuple[Sightings, ...]:
    """Windows of one cell matched in all cells. A window counts if the cells show it about as well as the best."""
    h, w = image.shape
    cell_px = np.array([columns.pitch * w, rows.pitch * h])
    half = np.maximum(np.rint(0.5 * search.window_share * cell_px).astype(int), 6)
    size = (2 * int(half[0]) + 1, 2 * int(half[1]) + 1)
    tables = []
    for number, xy_px in enumerate(_choose_windows(template, half, search.windows)):
        window = cv2.getRectSubPix(template, size, _opencv_point(xy_px))
        x, y = xy_px / cell_px
        matches = []
        for i in range(rows.cells):
            for j in range(columns.cells):
                uv = np.array([columns.first + (j + x) * columns.pitch, rows.first + (i + y) * rows.pitch])
                area = _patch(image, uv * (w, h), half + search.reach_px)
                if area is not None:
                    matches.append((*uv, number, j, i, *_match(window, area, search.reach_px)))
        if len(matches) >= 4:
            tables.append(np.array(matches))
    typical = [float(np.median(t[:, 9])) for t in tables]
    least = max(config.min_match, max(typical, default=0.0) - search.match_slack)
    table = np.vstack([np.zeros((0, 10)), *(t for t, m in zip(tables, typical, strict=True) if m >= least)])
    made = [_match_sightings(table, axis, (h, w), search, config) for axis in (0, 1)]
    return tuple(s for s in made if s is not None)


def cell_image(
    image: Float[np.ndarray, "h w"], columns: Repeats, rows: Repeats, column: int, row: int
) -> Float[np.ndarray, "ch cw"]:
    """One cell in pixels of the view, shifted by the fraction of a pixel that brings its corner to a pixel's."""
    h, w = image.shape
    size = (max(8, round(columns.pitch * w)), max(8, round(rows.pitch * h)))
    x = (columns.first + (column + 0.5) * columns.pitch) * w - 0.5 * size[0]
    y = (rows.first + (row + 0.5) * rows.pitch) * h - 0.5 * size[1]
    shift = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    return cv2.warpAffine(
        image, shift, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
    )


def cell_agreement(view: FilmView, columns: Repeats, rows: Repeats, fine_px: float = 1.2) -> float:
    """Share of the fine detail that all cells have in common, in [0, 1]: largest where the cells are straight.

    Texts and scale bars a pixel off lower it, and it knows nothing of the matches that a map was made from:
    an independent judge of maps made from them.
    """
    image = detail(view.image[..., 0], fine_px, 4.0 * fine_px + 4.0)
    mean, square = _cell_moments(image, columns, rows)
    return float(np.mean(mean * mean) / max(float(np.mean(square)), 1e-9))


def _mean_cell(
    image: Float[np.ndarray, "h w"], columns: Repeats, rows: Repeats, power: float
) -> Float[np.ndarray, "ch cw"]:
    """The cells' mean in pixels of the view, weighted by how far the cells agree: texts stay, anatomy fades.

    The weight is (mean^2 / mean square)^power of each pixel's neighbourhood: 1 where all cells are the same.
    """
    mean, square = _cell_moments(image, columns, rows)
    agreement = cv2.GaussianBlur(mean * mean, (0, 0), 2.0) / (cv2.GaussianBlur(square, (0, 0), 2.0) + 1e-2)
    return mean * np.clip(agreement, 0.0, 1.0) ** power


def _cell_moments(
    image: Float[np.ndarray, "h w"], columns: Repeats, rows: Repeats
) -> tuple[Float[np.ndarray, "ch cw"], Float[np.ndarray, "ch cw"]]:
    """Mean and mean square over all cells, in pixels of the view."""
    cells = [cell_image(image, columns, rows, j, i) for i in range(rows.cells) for j in range(columns.cells)]
    total, squares = np.zeros_like(cells[0]), np.zeros_like(cells[0])
    for cell in cells:
        total += cell
        squares += cell * cell
    return total / len(cells), squares / len(cells)


def _choose_windows(
    mean_cell: Float[np.ndarray, "ch cw"], half: np.ndarray, count: int
) -> list[Float[np.ndarray, "2"]]:
    """Centres (x, y), in pixels of the cell, of the windows with most detail, at least half a window apart."""
    energy = cv2.boxFilter(mean_cell * mean_cell, -1, (2 * int(half[0]) + 1, 2 * int(half[1]) + 1))
    x = np.arange(half[0] + 1.0, mean_cell.shape[1] - half[0] - 1.0, max(2.0, half[0] / 3.0))
    y = np.arange(half[1] + 1.0, mean_cell.shape[0] - half[1] - 1.0, max(2.0, half[1] / 3.0))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    value = energy[points[:, 1].astype(int), points[:, 0].astype(int)]
    chosen: list[np.ndarray] = []
    floor = 0.02 * float(value.max(initial=0.0))
    for k in np.argsort(-value):
        apart = all((np.abs(points[k] - c) >= 0.9 * half).any() for c in chosen)
        if apart and value[k] > floor:
            chosen.append(points[k])
        if len(chosen) == count:
            break
    return chosen


def _patch(
    image: Float[np.ndarray, "h w"], centre: Float[np.ndarray, "2"], half: np.ndarray
) -> Float[np.ndarray, "ph pw"] | None:
    """The patch of ``2 half + 1`` pixels around a point (x, y) of the image's frame; None beyond its rim."""
    size = (2 * int(half[0]) + 1, 2 * int(half[1]) + 1)
    h, w = image.shape
    low, high = centre - half - 1.0, centre + half + 1.0
    if (low < 0).any() or high[0] > w or high[1] > h:
        return None
    return cv2.getRectSubPix(image, size, _opencv_point(centre))


def _opencv_point(xy: Float[np.ndarray, "2"]) -> tuple[float, float]:
    """OpenCV pixel coordinates of a point of an image's frame."""
    x, y = opencv_from_photo(xy)
    return float(x), float(y)


def _match(
    window: Float[np.ndarray, "wh ww"], area: Float[np.ndarray, "ah aw"], reach: int
) -> tuple[float, float, float, float, float]:
    """Shift (x, y) of the window's best place in the area, the variances of both in px^2, and the correlation."""
    score = cv2.matchTemplate(area, window, cv2.TM_CCOEFF_NORMED)
    row, column = divmod(int(np.argmax(score)), score.shape[1])
    peak = float(score[row, column])
    if not (0 < row < 2 * reach and 0 < column < 2 * reach):
        return 0.0, 0.0, np.inf, np.inf, peak
    near = score[row - 1 : row + 2, column - 1 : column + 2].astype(np.float64)
    xx = near[1, 0] - 2 * near[1, 1] + near[1, 2]
    yy = near[0, 1] - 2 * near[1, 1] + near[2, 1]
    xy = 0.25 * (near[0, 0] + near[2, 2] - near[0, 2] - near[2, 0])
    gx, gy = 0.5 * (near[1, 2] - near[1, 0]), 0.5 * (near[2, 1] - near[0, 1])
    det = xx * yy - xy * xy
    if xx >= 0 or yy >= 0 or det <= 1e-3 * xx * yy:
        return 0.0, 0.0, np.inf, np.inf, peak
    dx, dy = (xy * gy - yy * gx) / det, (xy * gx - xx * gy) / det
    # Variance of the peak of a correlation surface: residual variance over curvature, pixels correlated in tens.
    scale = max(1.0 - peak * peak, 0.02) * 10.0 / window.size
    shift = np.clip([dx, dy], -1.0, 1.0)
    return column - reach + shift[0], row - reach + shift[1], -scale * yy / det, -scale * xx / det, peak


def _match_sightings(
    table: Float[np.ndarray, "n 10"], axis: int, size: tuple[int, int], search: MatchRound, config: RepeatConfig
) -> Sightings | None:
    """Sightings along one axis from matches (u, v, window, column, row, dx, dy, variances, correlation)."""
    sigma_px = np.sqrt(table[:, 7 + axis])
    good = (table[:, 9] >= config.min_match) & (sigma_px <= config.worst_sigma_px)
    if good.sum() < 12:
        return None
    t, sigma_px = table[good], np.hypot(sigma_px[good], search.sigma_px)
    pixels = size[1 - axis]
    seen = t[:, :2].copy()
    seen += t[:, 5:7] / (size[1], size[0])
    windows = np.unique(t[:, 2])
    member = (t[:, 2][:, None] == windows).astype(np.float64)
    number = t[:, 3 + axis]
    shared = np.column_stack([member, number - number.mean()])
    shared_sigma = np.append(np.full(len(windows), config.constant_sigma), config.pitch_sigma)
    return Sightings(axis, seen, t[:, axis].copy(), sigma_px / pixels, shared, shared_sigma)


__all__ = [
    "MatchRound",
    "RepeatConfig",
    "Repeats",
    "cell_agreement",
    "cell_image",
    "detail",
    "find_repeats",
    "match_cells",
    "match_to_one_cell",
]
