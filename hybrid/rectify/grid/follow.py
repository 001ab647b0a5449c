"""Follow detected lines along their length: this observes the coordinate across them at many points."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from hybrid.coords import film_centres_1d
from hybrid.film_view import FilmView
from hybrid.rectify.edges.curves import best_paths, smooth_curve_weights
from hybrid.rectify.grid.lines import Comb, GridConfig, line_response, narrowed
from hybrid.rectify.splines.sightings import Sightings


def follow_comb(view: FilmView, comb: Comb, config: GridConfig) -> Sightings | None:
    """Each line that was seen, observed at many places along its length; None where too little is left.

    Straightness and equal spacing are expressed by the constants shared by all: the offset of the comb's middle from
    the film's, the error of its pitch, and how far inwards the outermost lines are: where each cell has its own frame,
    an inner line is two cells' frames side by side.
    """
    image = narrowed(view.image[..., 0], comb.axis)
    response = comb.sign * line_response(image, comb.width_px)
    h, n = response.shape
    lines = comb.lines()
    inside = (lines[comb.seen] > config.edge) & (lines[comb.seen] < 1.0 - config.edge)
    inner, tracks = comb.seen[inside], comb.tracks[inside]
    if len(inner) == 0:
        return None
    stations = film_centres_1d(n)
    start = np.stack([np.interp(stations, film_centres_1d(tracks.shape[1]), track) for track in tracks])
    start = np.rint(start * h).astype(int) - config.reach_px
    rows = np.clip(start[:, None, :] + np.arange(2 * config.reach_px + 1)[:, None], 0, h - 1)
    bands = response[rows, np.arange(n)]  # (lines, rows around each line, stations)
    smooth = cv2.GaussianBlur(bands.reshape(-1, n).astype(np.float32), (5, 1), 1.0).reshape(bands.shape)
    typical = np.maximum(np.median(smooth.max(axis=1), axis=1), config.min_levels)[:, None, None]
    paths = best_paths(np.clip(smooth / typical, 0.0, 1.2), max_step=1, cost=0.1)
    peaks, good = _peaks_on_paths(smooth, paths, config)
    row = start + peaks
    on_curve = good & (smooth_curve_weights(stations, row, good, np.full(len(row), 0.4)) > 0.2)
    covered = on_curve.mean(axis=1) >= config.coverage
    if covered.mean() < 0.7:
        return None
    index, station = np.nonzero(on_curve & covered[:, None])
    along = stations[station]
    across = np.interp(row[index, station], np.arange(h), film_centres_1d(h))
    uv = np.column_stack([along, across] if comb.axis == 1 else [across, along])
    sigma = np.full(len(across), config.sigma_px / h * np.sqrt(max(1.0, n / config.stations)))
    from_centre = inner[index] - 0.5 * comb.cells
    pitch, known = comb.before(config)
    inset_sigma = config.snug_sigma if comb.fills_film(config) else config.inset_sigma
    first, last = inner[index] == 0, inner[index] == comb.cells
    shared = np.column_stack([np.ones(len(across)), from_centre, first, last])
    shared_sigma = np.array([*known, inset_sigma, inset_sigma])
    return Sightings(comb.axis, uv, 0.5 + from_centre * pitch, sigma, shared, shared_sigma)


def _peaks_on_paths(
    bands: Float[np.ndarray, "b d n"], paths: Int[np.ndarray, "b n"], config: GridConfig
) -> tuple[Float[np.ndarray, "b n"], Bool[np.ndarray, "b n"]]:
    """Subpixel row of the response's peaks along the paths, and where there is a peak that is strong enough."""
    b, d, n = bands.shape
    near = np.clip(paths[:, None, :] + np.arange(-1, 2)[:, None], 1, d - 2)
    row = np.take_along_axis(near, np.take_along_axis(bands, near, axis=1).argmax(axis=1)[:, None], axis=1)[:, 0]
    band, station = np.meshgrid(np.arange(b), np.arange(n), indexing="ij")
    above, here, below = (bands[band, row + k, station] for k in (-1, 0, 1))
    curvature = above - 2 * here + below
    peak = (curvature < 0) & (here >= above) & (here >= below)
    shift = np.where(peak, 0.5 * (above - below) / np.where(peak, curvature, 1.0), 0.0)
    typical = np.median(here, axis=1, keepdims=True)
    good = peak & (here >= np.maximum(0.4 * typical, 0.7 * config.min_levels)) & (here <= 3.0 * typical + 3.0)
    return row + shift, good


__all__ = ["follow_comb"]
