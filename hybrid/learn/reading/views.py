"""Views: what the network is shown. A view maps its own unit square to the photo, as a film does (a BackwardMap).

The first view is a square window of the photo. Once the film is roughly known, the next views show it as the map so far
would flatten it, so that what is left to predict is small: by the homography nearest to that map or, in training and
where a bent film is in doubt, by the bent map itself.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, rescale_points, sample_bilinear

PLANE_NODES = (9, 9)
"""Film points to which a homography is fitted."""
VIEW_NODES = (17, 17)
"""Nodes of a view that follows a bent film."""


def square_view(centre: tuple[float, float], side: float, turn: float = 0.0) -> BackwardMap:
    """A square window of the photo: centre (x, y) and side in pixels; ``turn`` (radians) clockwise in the photo."""
    cos, sin = np.cos(turn), np.sin(turn)
    middle = film_nodes((4, 4)) - film_nodes((3, 3))[1, 1]
    return BackwardMap(side * middle @ np.array([[cos, sin], [-sin, cos]]) + np.asarray(centre))


def whole_view(size: tuple[int, int], wider: float = 1.0) -> BackwardMap:
    """The smallest square around a photo of ``size`` (height, width), widened by a factor."""
    return square_view((size[1] / 2, size[0] / 2), wider * max(size))


def near_views(size: tuple[int, int], nearer: float) -> list[BackwardMap]:
    """Squares that together show all of a photo of ``size`` (height, width).

    nearer: their side as a fraction of the photo's longer side, at least a half, at most 1. Along each axis there is
    one at either end, or just one in the middle if that shows all.
    """
    side = nearer * max(size)
    down, across = ((side / 2, length - side / 2) if side < length else (length / 2,) for length in size)
    return [square_view((x, y), side) for y in down for x in across]


def film_view(film: BackwardMap, margin: float) -> BackwardMap:
    """The film as its map flattens it, with ``margin`` (fraction of the view's side) around it."""
    return BackwardMap(film.photo_from_film(film_from_view(film_nodes(VIEW_NODES), margin)))


def film_from_view(at: Float[np.ndarray, "*n 2"], margin: float) -> Float[np.ndarray, "*n 2"]:
    """Film coordinates of points of a view that shows the film with ``margin`` on each side."""
    return (at - margin) / (1 - 2 * margin)


def plane_of(film: BackwardMap) -> BackwardMap:
    """The map of the plane sheet that lies nearest to a bent one: a homography, by least squares in the photo."""
    uv = film_nodes(PLANE_NODES).reshape(-1, 2)
    homography, _ = cv2.findHomography(uv, film.photo_from_film(uv))
    if homography is None:
        return film
    ahead = film_nodes(VIEW_NODES) @ homography[2, :2] + homography[2, 2]
    if ahead.min() <= 0.2 * ahead.max():  # runs off near the film: no plane sheet looks like this
        return film
    return BackwardMap(cv2.perspectiveTransform(film_nodes(VIEW_NODES), homography))


def view_image(photo: UInt8[np.ndarray, "H W 3"], view: BackwardMap, n: int) -> UInt8[np.ndarray, "n n 3"]:
    """The view as an n x n image: area-averaged where it is reduced, the photo's rim repeated beyond the photo."""
    points = view.dense((n, n))
    h, w = photo.shape[:2]
    x, y = points[..., 0], points[..., 1]  # apart: over both at once NumPy takes thirty times as long
    low = np.clip(np.floor([x.min(), y.min()]).astype(int) - 2, 0, [w - 1, h - 1])
    high = np.clip(np.ceil([x.max(), y.max()]).astype(int) + 2, low + 1, [w, h])
    part = photo[low[1] : high[1], low[0] : high[0]]
    points = points - low.astype(np.float32)
    scale = float(np.sqrt(np.prod(view.mean_film_pixels()))) / n
    if scale > 1.0:  # photo pixels per view pixel
        size = (max(1, round(part.shape[0] / scale)), max(1, round(part.shape[1] / scale)))
        points = rescale_points(points, (part.shape[0], part.shape[1]), size)
        part = cv2.resize(part, size[::-1], interpolation=cv2.INTER_AREA)
    return sample_bilinear(part, points)


def output_points(view: BackwardMap, n: int, stride: int) -> Float[np.ndarray, "m m 2"]:
    """Photo points of the pixel centres of the network's output for an n x n view."""
    return view.dense((n // stride, n // stride))
