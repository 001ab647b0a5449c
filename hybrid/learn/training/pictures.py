"""Pictures of what a network has learnt: views with the quarter lines of the film, true and predicted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8
from skimage.measure import find_contours
from torch import Tensor

from hybrid.backward import BackwardMap
from hybrid.coords import node_centres_1d, photo_from_opencv, rescale_points
from hybrid.draw import contact_sheet, draw_curves, resized

Picture = UInt8[np.ndarray, "h w 3"]
Curves = list[Float[np.ndarray, "_ 2"]]
"""Curves in a view, as fractions of its sides."""

PICTURE_VIEWS, COLUMNS, TILE_PX = 8, 4, 288
QUARTERS = (0.25, 0.5, 0.75)
"""Film coordinates whose lines are drawn, of u and of v."""
TRUE_COLOUR, PREDICTED_COLOUR = (0, 220, 90), (255, 96, 32)
CURVE_POINTS = 33


def lines_of_uv(uv: Float[Tensor, "2 h w"], mask: Bool[Tensor, "h w"]) -> Curves:
    """The quarter lines of a uv map, and the outline of its mask."""
    film = mask.cpu().numpy()
    found = [(film.astype(np.float32), 0.5, None)]
    found += [(values, level, film) for values in uv.float().cpu().numpy() for level in QUARTERS]
    return [
        _in_view(curve, film.shape)
        for values, level, where in found
        for curve in find_contours(values, level, mask=where)
    ]


def _in_view(curve: Float[np.ndarray, "_ 2"], size: tuple[int, ...]) -> Float[np.ndarray, "_ 2"]:
    """A curve of (row, column) indices, as points (x, y) in fractions of the sides."""
    return rescale_points(photo_from_opencv(np.stack([curve[:, 1], curve[:, 0]], axis=-1)), (size[0], size[1]), (1, 1))


def lines_of_backward(backward: Float[Tensor, "2 n m"]) -> Curves:
    """The quarter lines and the edges of a backward map in units of the view's sides."""
    film = BackwardMap(np.nan_to_num(backward.float().cpu().permute(1, 2, 0).numpy()))
    along = node_centres_1d(CURVE_POINTS)
    levels = (0.0, *QUARTERS, 1.0)
    lines = [np.stack([np.full_like(along, level), along], axis=-1) for level in levels]
    lines += [np.stack([along, np.full_like(along, level)], axis=-1) for level in levels]
    return [film.photo_from_film(line) for line in lines]


def sample_sheet(images: Float[Tensor, "b 3 n n"], true: Sequence[Curves], predicted: Sequence[Curves]) -> Picture:
    """All views on one sheet, true lines in green below predicted ones in orange."""
    size, tiles = (TILE_PX, TILE_PX), []
    for image, *lines in zip(images, true, predicted, strict=True):
        tile = resized((image.clamp(0, 1) * 255).byte().permute(1, 2, 0).contiguous().numpy(), size)
        for curves, colour in zip(lines, (TRUE_COLOUR, PREDICTED_COLOUR), strict=True):
            tile = draw_curves(tile, [rescale_points(curve, (1, 1), size) for curve in curves], colour)
        tiles.append(tile)
    return contact_sheet(tiles, [f"{k}" for k in range(len(tiles))], COLUMNS)


__all__ = ["PICTURE_VIEWS", "Picture", "lines_of_backward", "lines_of_uv", "sample_sheet"]
