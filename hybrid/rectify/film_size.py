"""How large the flat film is made: the pixels that the photo holds, in the aspect ratio of the real sheet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid.backward import BackwardMap
from hybrid.errors import require_at_least
from hybrid.records import SliceGrid
from hybrid.rectify.sheet import Frame, SheetConfig, inner, nearest_homography
from hybrid.rectify.survey import survey_plane

FORMATS_CM = ((35, 43), (28, 35), (25, 30), (20, 25))
"""Sheets on sale; used either way round."""

FOCALS = 60
"""Focal lengths that are tried, each 3 % longer than the one before."""

RIGHT_ANGLE = 0.01
"""Standard deviation of the cosine of the angle between a flat film's sides, as a map has it."""


@dataclass(frozen=True)
class FilmSizeConfig:
    """Bounds of the flat film's size, and how far its aspect ratio may be snapped to a known one."""

    max_side_px: int = 2048
    """The longer side is never longer than this."""
    min_side_px: int = 64
    """The shorter side is never shorter than this."""
    max_aspect: float = 3.0
    """Sheets are never longer than this times their width; a map that says so is not believed."""
    snap: float = 0.04
    """Largest relative difference of the measured aspect ratio from a film format that it is taken for."""
    snap_grid: float = 0.06
    """The same for square slice cells, which are better evidence than a format."""
    snap_exact: float = 0.01
    """Both, where the sheet was fitted to its edges and print, or is flat: its ratio of sides is exact to 0.5 %."""
    flat: float = 0.003
    """Largest distance from a plane of a film that is flat, as a part of its size."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "min_side_px", "max_aspect")
        require_at_least(self, self.min_side_px, "max_side_px")
        require_at_least(self, 0.0, "snap", "snap_grid", "snap_exact", "flat")


def plane_aspect(backward: BackwardMap, size: tuple[int, int], config: SheetConfig | None = None) -> float:
    """Height over width of the sheet, taken for flat, before a camera that looks at the photo's centre.

    size: (height, width) of the photo. The homography nearest to the map tells both sides' lengths once the focal
    length is known; which one it is, beside what is usual of phones, the right angle between the sides tells (Zhang and
    He 2007, "Whiteboard scanning and image enhancement").
    """
    config = config or SheetConfig()
    homography = nearest_homography(backward, Frame.of(size))
    focal = np.geomspace(*config.focal_range, FOCALS)
    unseen = np.stack([1.0 / focal, 1.0 / focal, np.ones(FOCALS)], axis=1)
    across, down = (unseen * homography[:, k] for k in (0, 1))
    squares = inner(across, across), inner(down, down)
    cosine = inner(across, down) / np.sqrt(squares[0] * squares[1])
    unusual = np.log(focal / config.focal) / config.focal_sigma[1]
    best = int(np.argmin((cosine / RIGHT_ANGLE) ** 2 + unusual**2))
    return float(np.sqrt(squares[1][best] / squares[0][best]))


def snap_aspect(aspect: float, grid: SliceGrid | None, config: FilmSizeConfig, exact: bool = False) -> float:
    """The aspect ratio (height over width) that square cells give, or else the film format nearest, if close."""
    to_cells, to_format = 2 * [config.snap_exact] if exact else (config.snap_grid, config.snap)
    if grid is not None and grid.confidence > 0.5:
        span = grid.vertices[-1, -1] - grid.vertices[0, 0]
        square = float((grid.rows / grid.cols) * (span[0] / span[1])) if min(span) > 0 else 0.0
        if square > 0 and abs(np.log(aspect / square)) <= to_cells:
            return square
    formats = np.array([long / short for short, long in FORMATS_CM])
    known = np.concatenate([formats, 1.0 / formats])
    nearest = float(known[np.argmin(np.abs(np.log(known / aspect)))])
    return nearest if abs(np.log(aspect / nearest)) <= to_format else aspect


def film_size(
    backward: BackwardMap,
    photo_size: tuple[int, int],
    grid: SliceGrid | None,
    config: FilmSizeConfig | None = None,
    aspect: float | None = None,
    camera: SheetConfig | None = None,
) -> tuple[int, int]:
    """Size (h, w) in pixels of the flat film: nothing that the photo resolves is lost, within the bounds.

    photo_size: (height, width). aspect: height over width, where it is known from the sheet that was fitted
    (refine.py); else it is told by the nearest plane, exactly if the film is one. camera: which focal
    lengths are usual.
    """
    config = config or FilmSizeConfig()
    exact = aspect is not None or survey_plane(backward, config.flat)[0].yes
    measured = plane_aspect(backward, photo_size, camera) if aspect is None else aspect
    snapped = snap_aspect(measured, grid, config, exact)
    return bounded_size(backward, float(np.clip(snapped, 1.0 / config.max_aspect, config.max_aspect)), config)


def bounded_size(backward: BackwardMap, aspect: float, config: FilmSizeConfig) -> tuple[int, int]:
    """Size (h, w) in pixels of a film of that height over width, of about as many pixels as the photo has of it; its
    longer side is never longer than allowed, whatever that makes of the shorter."""
    down, across = backward.mean_film_pixels()
    width = max(across, down / aspect)
    width *= max(1.0, config.min_side_px / min(width, width * aspect))
    width *= min(1.0, config.max_side_px / max(width, width * aspect))
    return max(round(width * aspect), 1), max(round(width), 1)
