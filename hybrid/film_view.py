"""The photo seen through a backward map: on any rows and columns of film coordinates, beyond the edges too."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap, spline_weights
from hybrid.coords import film_centres_1d, opencv_from_photo
from hybrid.pyramid import Pyramid

MOST_SIDE = 32_766
"""OpenCV's remap cannot read pictures with more pixels per side."""


LEAST_SIDE = 64
"""Fewest pixels of either side of ``grey_view``."""


@dataclass(frozen=True, eq=False)
class FilmView:
    """Pixels of the photo on a lattice of film points.

    image: (h, w, c) float32, grey levels 0..255; 0 where the lattice leaves the photo.
    u, v: film coordinates of the columns and rows; may lie beyond [0, 1], off the film.
    inside: where the photo covers the lattice point.
    """

    image: Float[np.ndarray, "h w c"]
    u: Float[np.ndarray, " w"]
    v: Float[np.ndarray, " h"]
    inside: Bool[np.ndarray, "h w"]


def _lattice_xy(
    nodes: Float[np.ndarray, "gh gw 2"], u: Float[np.ndarray, " w"], v: Float[np.ndarray, " h"]
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """x and y (float32) of all points (u[j], v[i]) of a map with these nodes, in two arrays, as OpenCV reads them
    fastest. Rows and columns are interpolated in turn."""
    gh, gw = nodes.shape[:2]
    columns = np.tensordot(spline_weights(gh, v), nodes, axes=(1, 0)).astype(np.float32)
    weights_u = spline_weights(gw, u).astype(np.float32).T
    return columns[..., 0] @ weights_u, columns[..., 1] @ weights_u


def _reached(
    photo: UInt8[np.ndarray, "H W *c"], x: Float[np.ndarray, "h w"], y: Float[np.ndarray, "h w"]
) -> tuple[UInt8[np.ndarray, "ph pw *c"], Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """The part of the photo that OpenCV's maps reach, and the maps into it."""
    (left, right), (top, bottom) = (
        (int(np.clip(np.floor(at.min()), 0, n - 1)), int(np.clip(np.ceil(at.max()) + 1, 1, n)))
        for at, n in ((x, photo.shape[1]), (y, photo.shape[0]))
    )
    right, bottom = max(right, left + 1), max(bottom, top + 1)
    return photo[top:bottom, left:right], x - np.float32(left), y - np.float32(top)


def view_film(
    photo: UInt8[np.ndarray, "H W *c"],
    backward: BackwardMap,
    u: Float[np.ndarray, " w"],
    v: Float[np.ndarray, " h"],
) -> FilmView:
    """The photo (grey or RGB) at the film points (u[j], v[i]), bilinear."""
    # The nodes' weights add up to 1: what is converted at the nodes is converted everywhere.
    x, y = _lattice_xy(opencv_from_photo(backward.nodes), u, v)
    if max(photo.shape[:2]) > MOST_SIDE:
        photo, x, y = _reached(photo, x, y)
    image = cv2.remap(photo, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    low, right, bottom = opencv_from_photo(np.array([0.0, photo.shape[1], photo.shape[0]])).tolist()
    if min(x.min(), y.min()) >= low and x.max() <= right and y.max() <= bottom:  # nearly always, and quicker
        inside = np.ones(x.shape, dtype=bool)
    else:
        inside = (x >= low) & (x <= right) & (y >= low) & (y <= bottom)
        image = cv2.copyTo(image, inside.view(np.uint8))  # 0 elsewhere
    return FilmView(np.atleast_3d(image).astype(np.float32), u, v, inside)


def grey_view(pyramid: Pyramid, film: BackwardMap, side_px: int) -> FilmView:
    """The flat grey film, its longer side of ``side_px`` and no side below LEAST_SIDE, from a copy of the photo that is
    large enough for it."""
    photo, scale = pyramid.scaled(side_px / max(film.mean_film_pixels()))
    film = film.cropped((0.0, 0.0), scale)
    v, u = (film_centres_1d(max(round(side), LEAST_SIDE)) for side in film.mean_film_pixels())
    return view_film(cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY), film, u, v)


__all__ = ["FilmView", "grey_view", "view_film"]
