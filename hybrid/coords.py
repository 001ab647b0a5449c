"""The one place that converts between frames (docs/conventions.md).

Photo frame: points ``(x, y)``, the photo covers ``[0, W] x [0, H]``, pixel centres at +0.5.
Film frame: ``(u, v)`` in ``[0, 1]^2``, origin at the sheet's top-left corner, u right, v down.
No ``+ 0.5``, ``* 2 - 1``, ``1 - v``, ``[..., ::-1]`` or ``align_corners`` appears anywhere else.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Bool, Float

if TYPE_CHECKING:  # torch takes a second to import, and most users of this module do not need it
    import torch

CONVENTIONS_VERSION = 1
"""Stored in every weights file and shard; a file of another version is refused."""


# ---------------------------------------------------------------- pixel centres


def centres_1d(n: int) -> Float[np.ndarray, " n"]:
    """Coordinates of the n pixel centres along an axis that covers [0, n]."""
    return np.arange(n, dtype=np.float64) + 0.5


def pixel_centres(size: tuple[int, int]) -> Float[np.ndarray, "h w 2"]:
    """Photo points (x, y) of all pixel centres of an image of ``size`` (height, width)."""
    h, w = size
    x, y = np.meshgrid(centres_1d(w), centres_1d(h))
    return np.stack([x, y], axis=-1)


def film_centres_1d(n: int) -> Float[np.ndarray, " n"]:
    """Film coordinates in (0, 1) of the n pixel centres of a film image along one axis."""
    return centres_1d(n) / n


def film_centres(size: tuple[int, int]) -> Float[np.ndarray, "h w 2"]:
    """Film uv of all pixel centres of a film image of ``size`` (height, width)."""
    h, w = size
    return pixel_centres(size) / np.array([w, h], dtype=np.float64)


def pixel_from_film(uv: Float[np.ndarray, "*n 2"], size: tuple[int, int]) -> Float[np.ndarray, "*n 2"]:
    """Point (x, y) in the frame of a film image of ``size`` (height, width), for film uv."""
    h, w = size
    return uv * np.array([w, h], dtype=np.result_type(uv, np.float32))


def film_from_pixel(xy: Float[np.ndarray, "*n 2"], size: tuple[int, int]) -> Float[np.ndarray, "*n 2"]:
    """Film uv of a point (x, y) in the frame of a film image of ``size`` (height, width)."""
    h, w = size
    return xy / np.array([w, h], dtype=np.float64)


# ---------------------------------------------------------------- nodes


def node_centres_1d(n: int) -> Float[np.ndarray, " n"]:
    """Film coordinates of n nodes along one axis; the first and the last lie on the edges."""
    return np.linspace(0.0, 1.0, n)


def film_nodes(size: tuple[int, int]) -> Float[np.ndarray, "gh gw 2"]:
    """Film uv of a lattice of ``size`` (rows, columns) nodes, edges included."""
    return _film_nodes(*size).copy()


@lru_cache(maxsize=32)
def _film_nodes(rows: int, columns: int) -> Float[np.ndarray, "gh gw 2"]:
    """Cached, as the same few sizes recur."""
    u, v = np.meshgrid(node_centres_1d(columns), node_centres_1d(rows))
    return np.stack([u, v], axis=-1)


FILM_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Film points of a sheet's corners, once around from its top-left one."""


# ---------------------------------------------------------------- bridges to libraries


def opencv_from_photo(xy: np.ndarray) -> np.ndarray:
    """OpenCV pixel coordinates (centres at integers) of photo points; keeps shape, and the dtype of floats."""
    return xy - np.asarray(0.5, dtype=np.result_type(xy, np.float32))


def photo_from_opencv(xy: np.ndarray) -> np.ndarray:
    """Photo points of OpenCV pixel coordinates; keeps shape, and the dtype of floats."""
    return xy + np.asarray(0.5, dtype=np.result_type(xy, np.float32))


def grid_sample_from_photo(xy: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """``grid_sample`` coordinates (for align_corners=False) of photo points (..., 2)."""
    h, w = size
    return 2 * xy / xy.new_tensor([w, h]) - 1


def sample_photo(image: torch.Tensor, xy: torch.Tensor) -> torch.Tensor:
    """Bilinear samples (B, C, h, w) of ``image`` (B, C, H, W) at photo points (B, h, w, 2); zero outside."""
    import torch

    size = (image.shape[-2], image.shape[-1])
    return torch.nn.functional.grid_sample(
        image, grid_sample_from_photo(xy, size), mode="bilinear", padding_mode="zeros", align_corners=False
    )


def sample_bilinear(image: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Bilinear values of ``image`` (H, W[, C]) at points (h, w, 2) of its photo frame; its rim is repeated outside.

    Exact for 1, 3 or 4 channels; OpenCV rounds the points to 1/32 px for 2 channels and for float64.
    """
    # x and y apart: an empty second map, which the signature also allows, gives wrong values in OpenCV 5.0.0.
    at = opencv_from_photo(np.asarray(xy, dtype=np.float32))
    x, y = np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def rescale_points(
    xy: Float[np.ndarray, "*n 2"], from_size: tuple[int, int], to_size: tuple[int, int]
) -> Float[np.ndarray, "*n 2"]:
    """Points of an image of ``from_size`` (h, w) in the frame of the same image resized to ``to_size``."""
    return xy * np.array([to_size[1] / from_size[1], to_size[0] / from_size[0]])


def inside_outline(outline: Float[np.ndarray, "n 2"], size: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """Which pixels of a picture of ``size`` (height, width) have their centres inside a closed curve of photo points.

    Accurate to a tenth of a pixel: fillPoly, which also draws the curve itself, runs on a picture 9 times as fine.
    """
    fine = 9
    large = (size[0] * fine, size[1] * fine)
    at = opencv_from_photo(outline * fine)
    # fillPoly takes integers with fractional bits; clipping several picture widths away loses nothing
    fixed = np.rint(np.clip(at, -10.0 * max(large), 10.0 * max(large)) * 16).astype(np.int32)
    drawn = np.zeros(large, dtype=np.uint8)
    cv2.fillPoly(drawn, [fixed], 1, shift=4)
    return drawn[fine // 2 :: fine, fine // 2 :: fine].astype(bool)


# ---------------------------------------------------------------- colour


def linear_from_srgb(srgb: np.ndarray) -> np.ndarray:
    """Linear light in [0, 1] of sRGB values in [0, 1] (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((np.maximum(srgb, 0.04045) + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """sRGB values in [0, 1] of linear light, which is clipped to [0, 1] (IEC 61966-2-1)."""
    clipped = np.clip(linear, 0.0, 1.0)
    low = clipped <= 0.0031308
    return np.where(low, clipped * 12.92, 1.055 * np.maximum(clipped, 0.0031308) ** (1 / 2.4) - 0.055)


def linear_from_srgb_tensor(srgb: torch.Tensor) -> torch.Tensor:
    """``linear_from_srgb`` with gradients."""
    import torch

    return torch.where(srgb <= 0.04045, srgb / 12.92, ((srgb.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4)


def srgb_from_linear_tensor(linear: torch.Tensor) -> torch.Tensor:
    """``srgb_from_linear`` with gradients, which vanish where light is clipped."""
    import torch

    clipped = linear.clamp(1e-6, 1)  # the power's gradient is infinite at 0
    return torch.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def rgb_from_bgr(image: np.ndarray) -> np.ndarray:
    """RGB (H, W, 3) of OpenCV's BGR, and the other way round."""
    return cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_BGR2RGB)
