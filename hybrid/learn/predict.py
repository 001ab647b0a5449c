"""FilmNet applied to a photo: two looks, the second at the film alone."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import UInt8

from hybrid.coords import pixel_centres
from hybrid.learn.network import STRIDE, FilmNet
from hybrid.records import CoarseMaps


@dataclass(frozen=True)
class PredictConfig:
    """How the network looks at a photo.

    margin: of the second look around the film, in parts of the film's longer side; what the training views have.
    worth: the second look is taken if it shows the film at least this much larger. mask_threshold: where film is.
    """

    margin: float = 0.07
    worth: float = 1.1
    mask_threshold: float = 0.5


@dataclass(frozen=True)
class Window:
    """A square of the photo: centre (x, y) and side, in photo pixels. It may reach beyond the photo."""

    centre: tuple[float, float]
    side: float


def whole(size: tuple[int, int]) -> Window:
    """The smallest square around a photo of ``size`` (height, width)."""
    return Window((size[1] / 2, size[0] / 2), float(max(size)))


def look(network: FilmNet, photo: UInt8[np.ndarray, "H W 3"], window: Window) -> CoarseMaps:
    """The network's maps of what a window of the photo shows."""
    n = network.config.input_px
    image = torch.from_numpy(_cut(photo, window, n)).permute(2, 0, 1)[None]
    with torch.inference_mode():
        output = network(image.float().div_(255).contiguous(memory_format=torch.channels_last))
        mask = torch.sigmoid(output.mask_logit)[0].numpy()
    m = n // STRIDE
    points = (pixel_centres((m, m)) / m - 0.5) * window.side + np.asarray(window.centre)
    return CoarseMaps(
        mask=mask,
        uv=output.uv[0].permute(1, 2, 0).numpy(),
        xyz=output.xyz[0].permute(1, 2, 0).numpy(),
        albedo=output.albedo[0].clamp(0, 1).numpy(),
        photo_points=points,
    )


def film_window(maps: CoarseMaps, config: PredictConfig) -> Window | None:
    """The square around the film, or None if no pixel shows film."""
    film = maps.mask >= config.mask_threshold
    if not film.any():
        return None
    # The largest connected part: stray pixels elsewhere must not widen the window.
    _, labels, stats, _ = cv2.connectedComponentsWithStats(film.astype(np.uint8))
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    points = maps.photo_points[labels == largest]
    pixel = float(maps.photo_points[0, 1, 0] - maps.photo_points[0, 0, 0])
    low, high = points.min(axis=0) - pixel / 2, points.max(axis=0) + pixel / 2
    centre = (low + high) / 2
    return Window((float(centre[0]), float(centre[1])), float((high - low).max()) * (1 + 2 * config.margin))


def _cut(photo: np.ndarray, window: Window, n: int) -> UInt8[np.ndarray, "n n 3"]:
    """The window as an n x n image: area-averaged where it is reduced, the photo's rim repeated beyond the photo."""
    scale = n / window.side
    left, top = np.asarray(window.centre) - window.side / 2
    h, w = photo.shape[:2]
    # Reduce only the part of the photo within the window, then place it exactly.
    x0, y0 = max(int(np.floor(left)), 0), max(int(np.floor(top)), 0)
    x1, y1 = min(int(np.ceil(left + window.side)), w), min(int(np.ceil(top + window.side)), h)
    part = photo[y0:y1, x0:x1]
    if scale < 1:
        size = (max(1, round((x1 - x0) * scale)), max(1, round((y1 - y0) * scale)))
        part = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    sx, sy = (x1 - x0) / part.shape[1], (y1 - y0) / part.shape[0]  # photo pixels per pixel of the part
    step = window.side / n
    # part index = (photo - corner) / s - 1/2 at photo = left + (k + 1/2) step, all in one affine map
    matrix = np.array(
        [
            [step / sx, 0.0, (left + step / 2 - x0) / sx - 0.5],
            [0.0, step / sy, (top + step / 2 - y0) / sy - 0.5],
        ]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(part, matrix, (n, n), flags=flags, borderMode=cv2.BORDER_REPLICATE)
