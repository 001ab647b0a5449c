"""Things as relief pictures in 8 bit: normals, creases and outline from a height field, and placing them in a photo."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from data_gen.scene.patches import Box, frame_box
from hybrid.coords import opencv_from_photo

EDGE_PER_MM = 8.0
"""Distances to the outline are stored in eighths of a millimetre around 128, so up to 16 mm."""

MIDDLE = 128
"""Code of a zero normal component and of the outline."""


@dataclass(frozen=True, eq=False)
class Place:
    """Where a thing sits: ``at`` on the rim and unit ``inward``, in the photo; pixels per millimetre there."""

    at: Float[np.ndarray, "2"]
    inward: Float[np.ndarray, "2"]
    px_per_mm: float


def coded_shape(
    height: Float[np.ndarray, "h w"], edge: Float[np.ndarray, "h w"], px_per_mm: float
) -> UInt8[np.ndarray, "h w 4"]:
    """Normal x and y (128 + 127 n), share of light that reaches creases (255: all), distance inside the outline.

    height (mm, towards the viewer) and edge (mm, positive inside) on pixels of ``px_per_mm``.
    """
    gx, gy = (cv2.Sobel(height, cv2.CV_32F, *d, ksize=3, scale=px_per_mm / 8) for d in ((1, 0), (0, 1)))
    length = np.sqrt(gx**2 + gy**2 + 1)
    reached = np.ones_like(height)
    for sigma, depth in ((2.0, 0.10), (7.0, 0.045)):  # mm: folds and joints, the gaps between fingers
        around = cv2.GaussianBlur(height, (0, 0), sigma * px_per_mm)
        reached *= np.exp(-depth * np.maximum(around - height, 0))
    channels = [-127 * gx / length + MIDDLE, -127 * gy / length + MIDDLE, 255 * np.maximum(reached, 0.15)]
    return coded([*channels, EDGE_PER_MM * edge + MIDDLE])


def coded(channels: list[np.ndarray]) -> UInt8[np.ndarray, "h w c"]:
    """Channels in [0, 255], rounded to 8 bit and stacked."""
    return np.clip(np.rint(np.stack(channels, axis=-1)), 0, 255).astype(np.uint8)


def smooth_max(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Maximum, rounded where the two differ by less than ``width``."""
    return np.maximum(a, b) + np.maximum(width - np.abs(a - b), 0) ** 2 / (4 * width)


def decoded_normals(shape: UInt8[np.ndarray, "h w 4"], forward: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "h w 2"]:
    """First two camera coordinates of the normals of a relief that ``forward`` brings into the photo."""
    turn = forward[:, :2] / np.sqrt(abs(np.linalg.det(forward[:, :2])))
    normal = (shape[..., :2].astype(np.float32) - MIDDLE) * np.float32(1 / 127)
    return normal @ turn.T.astype(np.float32)


def affine(linear: Float[np.ndarray, "2 2"], anchor: tuple[float, float], at: np.ndarray) -> Float[np.ndarray, "2 3"]:
    """Map from picture points to photo points that brings ``anchor`` to ``at``."""
    return np.concatenate([linear, (at - linear @ np.array(anchor))[:, None]], axis=1)


def seen_box(low_high: np.ndarray, forward: np.ndarray, size: tuple[int, int], margin: float) -> Box | None:
    """The part of a photo of ``size`` in which a picture's rectangle, given by two corners, may be seen."""
    (x0, y0), (x1, y1) = low_high
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) @ forward[:, :2].T + forward[:, 2]
    frame = np.array([[0, 0], [size[1], 0], [size[1], size[0]], [0, size[0]]], np.float32)
    area, shared = cv2.intersectConvexConvex(corners.astype(np.float32), frame)
    return frame_box(shared.reshape(-1, 2), size, margin) if area > 4 else None


def warped(
    picture: UInt8[np.ndarray, "h w c"], forward: Float[np.ndarray, "2 3"], box: Box
) -> UInt8[np.ndarray, "a b c"]:
    """The picture within ``box`` of the photo; its rim is repeated beyond it."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], np.float32)
    seen = (corners @ forward[:, :2].T + forward[:, 2] - [box[1].start, box[0].start]).astype(np.float32)
    matrix = cv2.getAffineTransform(opencv_from_photo(corners), opencv_from_photo(seen))
    size = (box[1].stop - box[1].start, box[0].stop - box[0].start)
    return cv2.warpAffine(picture, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def coverage(edge: Float[np.ndarray, "h w"], px_per_mm: float) -> Float[np.ndarray, "h w"]:
    """Share of each pixel within the outline, from its coded distance less the middle."""
    return np.clip(edge * np.float32(px_per_mm / EDGE_PER_MM) + np.float32(1 / 2), 0, 1)


def contact_shade(edge: Float[np.ndarray, "h w"], reach_mm: float, depth: float) -> Float[np.ndarray, "h w"]:
    """Factor on the light near what touches the film; ``edge`` is the coded distance less its middle."""
    outside = np.maximum(-edge, 0) * np.float32(1 / EDGE_PER_MM)
    return 1 - np.float32(depth) * np.maximum(1 - outside * np.float32(1 / reach_mm), 0) ** 2
