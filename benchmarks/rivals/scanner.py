"""The scanner that phones have: the sheet's four corners, found by OpenCV, and one homography.

Edges and thresholds of three grey pictures give closed shapes. Those that are nearly a convex quadrilateral compete on
size and on how much of their sides lies on edges. The winner's sides are fitted once more to the strongest edge near
them. Such an app cannot follow a bend.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import FILM_CORNERS, film_nodes, node_centres_1d, photo_from_opencv, rescale_points, sample_bilinear
from hybrid.draw import resized

WORK_PX = 640
"""Longer side of the copy in which the corners are searched for, as on a phone's preview."""

MIN_SHARE, MAX_SHARE = 0.08, 0.98
"""Range of the photo's area that a sheet may take up."""

CANNY = ((20, 60), (50, 150), (100, 250))
"""Thresholds of the edge pictures, from faint to strong edges."""

MAX_COSINE = 0.55
"""Largest cosine of a corner's angle: sheets in perspective keep to between 57 and 123 degrees."""

SIDE_POINTS = 60
SEARCH_PX = 6
"""Points along each side that are fitted to the strongest edge, and how far from the side this edge may lie."""

NODES = (33, 33)

Corners = Float[np.ndarray, "4 2"]
"""Photo points, clockwise from the sheet's top left."""


def find_corners(photo: UInt8[np.ndarray, "H W 3"]) -> Corners | None:
    """The sheet's corners; None where nothing in the photo is a quadrilateral."""
    scale = min(1.0, WORK_PX / max(photo.shape[:2]))
    size = (max(1, round(photo.shape[0] * scale)), max(1, round(photo.shape[1] * scale)))
    small = cv2.bilateralFilter(resized(photo, size), 7, 40, 5)
    greys = _greys(small)
    edges = _edges(greys)
    found = {tuple(q.ravel().round().astype(int)): q for picture in _shapes(greys) for q in _quadrilaterals(picture)}
    if not found:
        return None
    best = max(found.values(), key=lambda q: _worth(q, edges))
    corners = _refined(_clockwise(best), greys[0])
    return rescale_points(photo_from_opencv(corners), size, (photo.shape[0], photo.shape[1]))


def map_of_corners(corners: Corners) -> BackwardMap:
    """The map of a plane sheet with these corners."""
    square, points = FILM_CORNERS.astype(np.float32), corners.astype(np.float32)
    homography = cv2.getPerspectiveTransform(square, points).astype(np.float64)
    nodes = film_nodes(NODES).reshape(-1, 1, 2)
    return BackwardMap(cv2.perspectiveTransform(nodes, homography).reshape(*NODES, 2))


def true_corners(backward: BackwardMap) -> Corners:
    """The corners of a sheet whose map is known."""
    return backward.photo_from_film(FILM_CORNERS)


def scan(photo: UInt8[np.ndarray, "H W 3"]) -> BackwardMap | None:
    """From photo to map, as an app does it."""
    corners = find_corners(photo)
    return None if corners is None else map_of_corners(corners)


# ---------------------------------------------------------------- shapes


def _greys(small: UInt8[np.ndarray, "h w 3"]) -> tuple[np.ndarray, ...]:
    """Lightness, saturation and the brightest channel: a sheet differs from its ground in one of them."""
    return (
        np.ascontiguousarray(cv2.cvtColor(small, cv2.COLOR_RGB2LAB)[..., 0]),
        np.ascontiguousarray(cv2.cvtColor(small, cv2.COLOR_RGB2HSV)[..., 1]),
        small.max(axis=2),
    )


def _edges(greys: tuple[np.ndarray, ...]) -> Bool[np.ndarray, "h w"]:
    """Where any of the pictures has an edge, two pixels wide."""
    edges = np.zeros(greys[0].shape, np.uint8)
    for grey in greys:
        edges = cv2.bitwise_or(edges, cv2.Canny(grey, *CANNY[0]))
    return cv2.dilate(edges, np.ones((3, 3), np.uint8)) > 0


def _shapes(greys: tuple[np.ndarray, ...]) -> Iterator[UInt8[np.ndarray, "h w"]]:
    """Pictures whose bright regions may be the sheet or its outline."""
    close, thick = np.ones((9, 9), np.uint8), np.ones((3, 3), np.uint8)
    for grey in greys:
        for low, high in CANNY:
            yield cv2.dilate(cv2.Canny(grey, low, high), thick)
        _, split = cv2.threshold(grey, 0, 255, cv2.THRESH_OTSU)
        for side in (split, cv2.bitwise_not(split)):
            yield cv2.morphologyEx(cv2.morphologyEx(side, cv2.MORPH_CLOSE, close), cv2.MORPH_OPEN, close)


def _quadrilaterals(picture: UInt8[np.ndarray, "h w"]) -> Iterator[Float[np.ndarray, "4 2"]]:
    """Convex quadrilaterals of a sheet's size that come near to an outline in the picture."""
    contours, _ = cv2.findContours(picture, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    for contour in contours:
        hull = cv2.convexHull(contour)
        if not MIN_SHARE < cv2.contourArea(hull) / picture.size < MAX_SHARE:
            continue
        length = cv2.arcLength(hull, True)
        for tolerance in (0.01, 0.02, 0.03, 0.05, 0.08):
            corners = cv2.approxPolyDP(hull, tolerance * length, True)
            if len(corners) == 4:
                quadrilateral = corners.reshape(4, 2).astype(np.float64)
                if _cosines(quadrilateral).max() < MAX_COSINE:
                    yield quadrilateral
                break


def _cosines(corners: Float[np.ndarray, "4 2"]) -> Float[np.ndarray, "4"]:
    """Absolute cosines of the angles at the corners."""
    ahead, back = np.roll(corners, -1, axis=0) - corners, np.roll(corners, 1, axis=0) - corners
    lengths = np.linalg.norm(ahead, axis=1) * np.linalg.norm(back, axis=1)
    return np.abs((ahead * back).sum(axis=1)) / np.maximum(lengths, 1e-9)


def _worth(corners: Float[np.ndarray, "4 2"], edges: Bool[np.ndarray, "h w"]) -> float:
    """How much of the outline lies on edges, times the root of its area: the larger of nested outlines wins."""
    t = node_centres_1d(100)[:, None]
    ends = np.roll(corners, -1, axis=0)
    points = np.concatenate([(1 - t) * a + t * b for a, b in zip(corners, ends, strict=True)])
    col, row = np.clip(np.rint(points), 0, np.array(edges.shape[::-1]) - 1).astype(int).T
    area = cv2.contourArea(corners.astype(np.float32)) / edges.size
    return float(edges[row, col].mean() ** 2 * np.sqrt(area))


def _clockwise(corners: Float[np.ndarray, "4 2"]) -> Float[np.ndarray, "4 2"]:
    """Clockwise as seen, the one nearest to the photo's top left first."""
    around = corners - corners.mean(axis=0)
    ordered = corners[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]
    return np.roll(ordered, -int(np.argmin(ordered.sum(axis=1))), axis=0)


def _refined(corners: Float[np.ndarray, "4 2"], grey: UInt8[np.ndarray, "h w"]) -> Float[np.ndarray, "4 2"]:
    """Each side fitted to the strongest edge near it, and the corners where the sides meet; unchanged if far off."""
    lines = [_fitted_side(a, b, grey) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    meet = np.cross(np.roll(lines, 1, axis=0), lines)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = meet[:, :2] / meet[:, 2:]
    near = np.isfinite(moved).all(axis=1) & (np.linalg.norm(moved - corners, axis=1) < 4 * SEARCH_PX)
    return np.where(near[:, None], moved, corners)


def _fitted_side(a: np.ndarray, b: np.ndarray, grey: UInt8[np.ndarray, "h w"]) -> Float[np.ndarray, "3"]:
    """The line (homogeneous) through the strongest steps of grey across the side from a to b."""
    along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
    across = np.array([-along[1], along[0]])
    t = np.linspace(0.06, 0.94, SIDE_POINTS)[:, None]
    offsets = np.arange(-SEARCH_PX, SEARCH_PX + 1.0)
    points = (a + t * (b - a))[:, None] + offsets[None, :, None] * across
    profile = sample_bilinear(grey.astype(np.float32), photo_from_opencv(points))
    step = np.abs(cv2.Sobel(profile, cv2.CV_32F, 1, 0, ksize=3))
    strongest = step.argmax(axis=1)
    edge = points[np.arange(SIDE_POINTS), strongest].astype(np.float32)
    vx, vy, x, y = cv2.fitLine(edge, cv2.DIST_HUBER, 0, 0.01, 0.01).ravel()
    return np.array([vy, -vx, vx * y - vy * x], dtype=np.float64)


__all__ = ["find_corners", "map_of_corners", "scan", "true_corners"]
