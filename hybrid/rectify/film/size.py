"""How large the flat film is made: as many pixels as the photo holds, in the aspect ratio of the real sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.errors import require_at_least
from hybrid.records import SliceGrid
from hybrid.rectify.coarse.homography import survey_plane
from hybrid.rectify.sheet.shape import Frame, SheetConfig, inner, nearest_homography

FORMATS_CM = ((35, 43), (28, 35), (25, 30), (20, 25))
"""Sheet sizes on sale, used in either orientation."""

FOCALS = 60
"""Number of focal lengths tried, each 3 % longer than the one before."""

MAIN_FOCAL, MAIN_SIGMA = 0.75, 0.1
"""Focal length of phones' main lenses (24 to 28 mm for 35 mm film), in sides of the photo, and its logarithm's standard
deviation."""

SIGMAS, LOOSEST = 3.0, 0.1
"""How many standard deviations a known ratio may lie from one that the photo leaves open, and how far at most."""

RIGHT_ANGLE = 0.01
"""Standard deviation of the cosine of the angle between a flat film's sides, as measured through a map."""


@dataclass(frozen=True)
class FilmSizeConfig:
    """Bounds of the flat film's size, and how far its aspect ratio may be snapped to a known one."""

    max_side_px: int = 2048
    """The longer side is never longer than this."""
    min_side_px: int = 64
    """The shorter side is never shorter than this."""
    max_aspect: float = 3.0
    """Sheets are never longer than this times their width; a larger measured ratio is clipped."""
    snap: float = 0.04
    """Largest relative difference between the measured aspect ratio and a film format to which it is snapped."""
    snap_grid: float = 0.06
    """The same for square slice cells, which are better evidence than a format."""
    snap_exact: float = 0.01
    """The limit for both where the sheet was fitted to its edges and print, or is flat: its aspect ratio is then exact
    to 0.5 %."""
    flat: float = 0.003
    """Largest deviation from a plane at which a film counts as flat, as a fraction of its size."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "min_side_px", "max_aspect")
        require_at_least(self, self.min_side_px, "max_side_px")
        require_at_least(self, 0.0, "snap", "snap_grid", "snap_exact", "flat")


def known_by_plane(
    backward: BackwardMap, size: tuple[int, int], config: SheetConfig | None = None
) -> tuple[float, float]:
    """Height over width of the sheet, assumed to be flat, and the standard deviation of its logarithm.

    size: (height, width) of the photo; its centre is taken as the principal point.
    Once the focal length is known, the homography nearest to the map gives the lengths of both sides. The focal length
    follows from a prior on phone cameras and from the right angle between the sides (Zhang and He 2007, "Whiteboard
    scanning and image enhancement"). Where the sheet is tilted about only one of its axes, that angle is right for
    every focal length, and the ratio stays uncertain.
    """
    config = config or SheetConfig()
    homography = nearest_homography(backward, Frame.of(size))
    focal = np.geomspace(*config.focal_range, FOCALS)
    unseen = np.stack([1.0 / focal, 1.0 / focal, np.ones(FOCALS)], axis=1)
    across, down = (unseen * homography[:, k] for k in (0, 1))
    squares = inner(across, across), inner(down, down)
    cosine = inner(across, down) / np.sqrt(squares[0] * squares[1])
    cost = (cosine / RIGHT_ANGLE) ** 2 - 2.0 * np.log(_likelihood(np.log(focal), config))
    aspects, best = 0.5 * np.log(squares[1] / squares[0]), int(np.argmin(cost))
    weight = np.exp(-0.5 * (cost - cost[best]))
    variance = float(weight @ np.square(aspects - aspects[best]) / weight.sum())
    return float(np.exp(aspects[best])), float(np.sqrt(variance))


def _likelihood(log_focal: Float[np.ndarray, " n"], config: SheetConfig) -> Float[np.ndarray, " n"]:
    """How likely these log focal lengths are: a mixture of main lenses and lenses of any kind."""

    def normal(middle: float, sigma: float) -> Float[np.ndarray, " n"]:
        return np.exp(-0.5 * np.square((log_focal - np.log(middle)) / sigma)) / sigma

    main, any_lens = normal(MAIN_FOCAL, MAIN_SIGMA), normal(config.focal, config.focal_sigma[1])
    return config.main_lens * main + (1.0 - config.main_lens) * any_lens + 1e-12


def snap_aspect(
    aspect: float, grid: SliceGrid | None, config: FilmSizeConfig, exact: bool = False, sigma: float = 0.0
) -> float:
    """The aspect ratio (height over width) that square cells give, else that of the nearest film format, if close.

    exact: whether the sheet was fitted, or is flat: then the nearest of all these ratios is taken. sigma: standard
    deviation of the logarithm of ``aspect``; the larger it is, the farther an exact ratio may be snapped.
    """
    formats = [long / short for short, long in FORMATS_CM]
    known = [*formats, *(1.0 / ratio for ratio in formats)]
    square = _of_square_cells(grid)
    if exact:
        within = max(config.snap_exact, min(SIGMAS * sigma, LOOSEST))
        return _nearest(aspect, known if square is None else [square, *known], within)
    if square is not None and _apart(aspect, square) <= config.snap_grid:
        return square
    return _nearest(aspect, known, config.snap)


def _of_square_cells(grid: SliceGrid | None) -> float | None:
    """Height over width of the film if the cells of its grid are square; None where the grid is uncertain."""
    if grid is None or grid.confidence <= 0.5:
        return None
    across, down = grid.vertices[-1, -1] - grid.vertices[0, 0]
    return float((grid.rows / grid.cols) * (across / down)) if min(across, down) > 0 else None


def _nearest(aspect: float, known: Sequence[float], within: float) -> float:
    """The nearest known ratio if it is near enough, else the ratio itself."""
    nearest = min(known, key=lambda ratio: _apart(aspect, ratio))
    return nearest if _apart(aspect, nearest) <= within else aspect


def _apart(one: float, other: float) -> float:
    """Distance between the logarithms of two ratios."""
    return abs(float(np.log(one / other)))


def film_size(
    backward: BackwardMap,
    photo_size: tuple[int, int],
    grid: SliceGrid | None,
    config: FilmSizeConfig | None = None,
    aspect: float | None = None,
    camera: SheetConfig | None = None,
    sigma: float = 0.0,
) -> tuple[int, int]:
    """Size (h, w) in pixels of the flat film: nothing that the photo resolves is lost, within the bounds.

    photo_size: (height, width). aspect: height over width, if known from a fitted sheet (refine/refine.py); else it is
    measured on the nearest plane, exactly if the film is flat. camera: prior on the focal length. sigma: standard
    deviation of the logarithm of ``aspect``.
    """
    config = config or FilmSizeConfig()
    exact = aspect is not None or survey_plane(backward, config.flat)[0].yes
    measured, sigma = known_by_plane(backward, photo_size, camera) if aspect is None else (aspect, sigma)
    snapped = snap_aspect(measured, grid, config, exact, sigma)
    return bounded_size(backward, float(np.clip(snapped, 1.0 / config.max_aspect, config.max_aspect)), config)


def bounded_size(backward: BackwardMap, aspect: float, config: FilmSizeConfig) -> tuple[int, int]:
    """Size (h, w) in pixels of a film of this height over width, with about as many pixels as the photo has of it. The
    longer side never exceeds its limit, even if that makes the shorter one too short."""
    down, across = backward.mean_film_pixels()
    width = max(across, down / aspect)
    width *= max(1.0, config.min_side_px / min(width, width * aspect))
    width *= min(1.0, config.max_side_px / max(width, width * aspect))
    return max(round(width * aspect), 1), max(round(width), 1)
