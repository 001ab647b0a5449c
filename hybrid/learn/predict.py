"""FilmNet applied to a photo: a look at the whole, then a few at the film alone."""

from __future__ import annotations

from collections.abc import Sequence
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

    margins: around the film in the further looks, in parts of its longer side; within what the training views have.
    The looks see the film at different scales, so that their errors differ and their mean is nearer to the truth.
    mask_threshold: where film is.
    """

    margins: tuple[float, ...] = (0.03, 0.06, 0.09, 0.12)
    mask_threshold: float = 0.5


@dataclass(frozen=True)
class Window:
    """A square of the photo: centre (x, y) and side, in photo pixels. It may reach beyond the photo."""

    centre: tuple[float, float]
    side: float


def whole(size: tuple[int, int]) -> Window:
    """The smallest square around a photo of ``size`` (height, width)."""
    return Window((size[1] / 2, size[0] / 2), float(max(size)))


def look(network: FilmNet, photo: UInt8[np.ndarray, "H W 3"], windows: Sequence[Window]) -> list[CoarseMaps]:
    """The network's maps of what each window of the photo shows; one pass for all."""
    n = network.config.input_px
    images = torch.from_numpy(np.stack([_cut(photo, window, n) for window in windows])).permute(0, 3, 1, 2)
    with torch.inference_mode():
        output = network(images.float().div_(255).contiguous(memory_format=torch.channels_last))
        mask = torch.sigmoid(output.mask_logit).numpy()
    uv, xyz = (maps.permute(0, 2, 3, 1).numpy() for maps in (output.uv, output.xyz))
    albedo = output.albedo.clamp(0, 1).numpy()
    centres = pixel_centres((n // STRIDE, n // STRIDE)) / (n // STRIDE) - 0.5
    return [
        CoarseMaps(mask[k], uv[k], xyz[k], albedo[k], centres * window.side + np.asarray(window.centre))
        for k, window in enumerate(windows)
    ]


def film_windows(maps: CoarseMaps, config: PredictConfig) -> list[Window]:
    """Squares around the film, one for each margin; none if no pixel shows film."""
    film = maps.mask >= config.mask_threshold
    if not film.any():
        return []
    # The largest connected part: stray pixels elsewhere must not widen the window.
    _, labels, stats, _ = cv2.connectedComponentsWithStats(film.astype(np.uint8))
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    points = maps.photo_points[labels == largest]
    pixel = float(maps.photo_points[0, 1, 0] - maps.photo_points[0, 0, 0])
    low, high = points.min(axis=0) - pixel / 2, points.max(axis=0) + pixel / 2
    centre = (low + high) / 2
    longer = float((high - low).max())
    return [Window((float(centre[0]), float(centre[1])), longer * (1 + 2 * margin)) for margin in config.margins]


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
