"""How large the flat film is made: the pixels that the photo holds, in the aspect ratio of the real sheet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.errors import require_at_least
from hybrid.records import CoarseMaps, SliceGrid
from hybrid.rectify import bspline

FORMATS_CM = ((35, 43), (28, 35), (25, 30), (20, 25))
"""Sheets on sale; used either way round."""


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
    """Both, where the sheet's shape was fitted to its edges and print: its ratio of sides is exact to 0.5 %."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "min_side_px", "max_aspect")
        require_at_least(self, self.min_side_px, "max_side_px")
        require_at_least(self, 0.0, "snap", "snap_grid", "snap_exact")


def film_aspect(maps: CoarseMaps, backward: BackwardMap) -> float:
    """Height over width of the sheet from its 3D shape; from its size in the photo where that is missing."""
    with np.errstate(invalid="ignore"):
        film = maps.film & np.isfinite(maps.uv).all(axis=-1) & np.isfinite(maps.xyz).all(axis=-1)
        film &= (np.abs(maps.uv - 0.5) < 0.55).all(axis=-1)
    down, across = backward.mean_film_pixels()
    if np.count_nonzero(film) >= 60 and np.ptp(maps.xyz[film], axis=0).max() > 1e-3:
        lengths = _sheet_lengths(maps.uv[film].astype(np.float64), maps.xyz[film].astype(np.float64))
        if min(lengths) > 0.05 * max(lengths):
            down, across = lengths
    return down / across


def _sheet_lengths(uv: Float[np.ndarray, "n 2"], xyz: Float[np.ndarray, "n 3"]) -> tuple[float, float]:
    """Mean lengths (down, across) of a surface along its film lines, from a stiff smooth fit of xyz over uv.

    Film does not stretch, so every line along v has the same length; averaging them takes out noise. The fit is
    stiff enough that noise does not lengthen the lines, which a curve through noisy points would.
    """
    intervals = 4
    rows = bspline.design(uv, intervals)
    weight = np.ones(len(uv))
    for _ in range(3):
        fit = bspline.NormalEquations.of(rows, weight, xyz, intervals).solve(1e-5)
        distance = np.linalg.norm(xyz - rows @ fit, axis=1)
        weight = 1.0 / np.maximum(distance / max(float(np.median(distance)), 1e-9), 1.0)
    points = bspline.on_lattice(fit, (17, 17), intervals)
    down = np.linalg.norm(np.diff(points, axis=0), axis=-1).sum(axis=0)
    across = np.linalg.norm(np.diff(points, axis=1), axis=-1).sum(axis=1)
    return float(np.median(down)), float(np.median(across))


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
    maps: CoarseMaps,
    grid: SliceGrid | None,
    config: FilmSizeConfig | None = None,
    aspect: float | None = None,
) -> tuple[int, int]:
    """Size (h, w) in pixels of the flat film: nothing that the photo resolves is lost, within the bounds.

    aspect: height over width, where it is known from the sheet that was fitted (refine.py); the network's 3D shape
    tells it else.
    """
    config = config or FilmSizeConfig()
    measured = film_aspect(maps, backward) if aspect is None else aspect
    snapped = snap_aspect(measured, grid, config, exact=aspect is not None)
    return bounded_size(backward, float(np.clip(snapped, 1.0 / config.max_aspect, config.max_aspect)), config)


def bounded_size(backward: BackwardMap, aspect: float, config: FilmSizeConfig) -> tuple[int, int]:
    """Size (h, w) in pixels of a film of that height over width, of about as many pixels as the photo has of it; its
    longer side is never longer than allowed, whatever that makes of the shorter."""
    down, across = backward.mean_film_pixels()
    width = max(across, down / aspect)
    width *= max(1.0, config.min_side_px / min(width, width * aspect))
    width *= min(1.0, config.max_side_px / max(width, width * aspect))
    return max(round(width * aspect), 1), max(round(width), 1)
