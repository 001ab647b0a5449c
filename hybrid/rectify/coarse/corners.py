"""A film whose four corners a person has pointed at: where it lies, exactly enough for all later steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap, film_as_seen
from hybrid.coords import film_nodes
from hybrid.errors import ConfigError, describe
from hybrid.rectify.coarse.homography import apply_homography, fit_homography

LEAST_SIDE_PX = 32
"""Corners closer together than this are not those of a film."""

Corners = Sequence[Sequence[float]] | np.ndarray
"""Four photo points (x, y), in any order."""


def film_at(corners: Corners, size: tuple[int, int]) -> BackwardMap:
    """The map of a plane sheet with these corners, as it lies in the photo (``backward.film_as_seen``).

    Args:
        corners: (4, 2) photo points (x, y) in pixels, in any order; they may lie beyond the photo.
        size: height and width of the photo.

    Raises:
        ConfigError: these are not the corners of a sheet that the photo shows.
    """
    points = _around(_points(corners), size)
    middle = points.mean(axis=0)
    unit = float(np.abs(points - middle).max())
    top_left, top_right, bottom_right, bottom_left = (points - middle) / unit
    ends = np.array([top_left, top_right, bottom_left, bottom_right])
    homography = fit_homography(film_nodes((2, 2)).reshape(-1, 2), ends, np.ones(4))
    return film_as_seen(BackwardMap.from_function(lambda uv: apply_homography(homography, uv) * unit + middle))


def put_on_corners(film: BackwardMap, told: BackwardMap) -> BackwardMap:
    """A map displaced so that its corners are those of ``told``: in between, the displacement is bilinear."""
    ends = np.ix_([0, -1], [0, -1])
    apart = told.nodes[ends] - film.nodes[ends]
    u, v = np.moveaxis(film_nodes((film.nodes.shape[0], film.nodes.shape[1])), -1, 0)
    shares = np.stack([(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u], axis=-1)
    return BackwardMap(film.nodes + shares @ apart.reshape(4, 2))


def _points(corners: Corners) -> Float[np.ndarray, "4 2"]:
    """The corners as an array, if they are four finite points."""
    try:
        points = np.asarray(corners, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.shape != (4, 2) or not np.isfinite(points).all():
        _refuse(f"{corners!r}", "four points (x, y)", "Name each corner of the sheet once, in pixels of the photo.")
    return points


def _around(points: Float[np.ndarray, "4 2"], size: tuple[int, int]) -> Float[np.ndarray, "4 2"]:
    """The corners one after the other, clockwise in the photo."""
    middle = points.mean(axis=0)
    points = points[np.argsort(np.arctan2(*(points - middle).T[::-1]))]
    sides = np.roll(points, -1, axis=0) - points
    following = np.roll(sides, -1, axis=0)
    turns = sides[:, 0] * following[:, 1] - sides[:, 1] * following[:, 0]
    lengths = np.linalg.norm(sides, axis=1)
    got = ", ".join(f"({x:g}, {y:g})" for x, y in points)
    if lengths.min() < LEAST_SIDE_PX or (turns < 0.01 * lengths * np.roll(lengths, -1)).any():
        allowed = f"a convex quadrilateral, its sides {LEAST_SIDE_PX} pixels or longer"
        _refuse(got, allowed, "Name each corner of the sheet once.")
    if not (0 <= middle[0] <= size[1] and 0 <= middle[1] <= size[0]):
        _refuse(got, f"a film in a photo of {size[1]} x {size[0]} pixels", "Count pixels in the upright photo.")
    return points


def _refuse(got: str, allowed: str, do: str) -> None:
    raise ConfigError(describe(what="Corners of the film", got=got, allowed=allowed, do=do))


__all__ = ["Corners", "film_at", "put_on_corners"]
