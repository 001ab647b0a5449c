"""Training samples: a random view of a photo and the truth in the same view, with the colours disturbed."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8

from hybrid.coords import opencv_from_photo, pixel_centres, rescale_points, rgb_from_bgr
from hybrid.errors import DataError, describe
from hybrid.learn.coding import ALBEDO_LEVELS, UV_LEVELS, xyz_from_stored
from hybrid.learn.losses import Targets
from hybrid.learn.network import STRIDE
from hybrid.learn.shards import Shard


@dataclass(frozen=True)
class AugmentConfig:
    """How the view and the colours are varied.

    crop_share: views cut to the film's bounding box, as in the second pass of a rectification. margin: of that box.
    zoom: range of the other views' scale. roll_deg, shift: one sigma of rotation and of shift (photo sides).
    """

    crop_share: float = 0.5
    margin: tuple[float, float] = (0.02, 0.14)
    zoom: tuple[float, float] = (0.55, 1.25)
    roll_deg: float = 8.0
    shift: float = 0.03


@dataclass(frozen=True, eq=False)
class View:
    """A training view: image (n, n, 3) uint8 and the truth on the pixel centres of the network's output."""

    image: UInt8[np.ndarray, "n n 3"]
    mask: np.ndarray
    uv: np.ndarray
    xyz: np.ndarray
    albedo: np.ndarray


def training_view(shard: Shard, index: int, px: int, rng: np.random.Generator, config: AugmentConfig | None) -> View:
    """Sample ``index`` seen in a random view of ``px`` pixels; with no ``config``, as it is and undisturbed."""
    photo = _decoded(shard, index)
    side = photo.shape[0]
    mask, record = shard.stored("mask", index), shard.record(index)
    map_size = (mask.shape[0], mask.shape[1])
    photo_from_view, turn = _view(mask, side, px, rng, config)
    image = _warped(photo, photo_from_view, px)
    if config is not None:
        image = _disturbed(image, rng)
    n = px // STRIDE
    centres = rescale_points(pixel_centres((n, n)), (n, n), (px, px))
    in_photo = centres @ photo_from_view[:, :2].T + photo_from_view[:, 2]
    in_map = opencv_from_photo(rescale_points(in_photo, (side, side), map_size))
    seen, uv, xyz, albedo = _sampled(shard, index, mask, in_map)
    return View(image, seen, uv, _relative(xyz_from_stored(xyz, record["coding"]["xyz"]), seen, record, turn), albedo)


def batch_of(views: list[View]) -> tuple[torch.Tensor, Targets]:
    """Images (B, 3, n, n) float32 in [0, 1], channels last, and targets."""
    images = torch.from_numpy(np.stack([v.image for v in views])).permute(0, 3, 1, 2).float().div_(255)

    def stacked(name: str) -> torch.Tensor:
        return torch.from_numpy(np.stack([getattr(v, name) for v in views]))

    return images.contiguous(memory_format=torch.channels_last), Targets(
        stacked("mask"), stacked("uv").permute(0, 3, 1, 2), stacked("xyz").permute(0, 3, 1, 2), stacked("albedo")
    )


def _decoded(shard: Shard, index: int) -> UInt8[np.ndarray, "n n 3"]:
    """The photo of a sample, RGB."""
    photo = cv2.imdecode(shard.member("photo.jpg", index), cv2.IMREAD_COLOR)
    if photo is None:
        raise DataError(describe(what="shard", where=shard.path, got=f"photo {index} unreadable", do="Make it again."))
    return rgb_from_bgr(photo)


# ---------------------------------------------------------------- geometry


def _view(
    mask: np.ndarray, side: int, px: int, rng: np.random.Generator, config: AugmentConfig | None
) -> tuple[Float[np.ndarray, "2 3"], float]:
    """Affine map from the view's to the photo's frame (a similarity) and its turn in radians."""
    centre, span, turn = np.full(2, side / 2), float(side), 0.0
    if config is not None:
        if rng.random() < config.crop_share and mask.any():
            rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
            low, high = np.array([cols[0], rows[0]]), np.array([cols[-1], rows[-1]]) + 1
            centre = (low + high) / 2 * (side / mask.shape[0])
            span = float((high - low).max()) * side / mask.shape[0] * (1 + 2 * rng.uniform(*config.margin))
        else:
            span = side / rng.uniform(*config.zoom)
        centre = centre + rng.normal(0, config.shift, 2) * span
        turn = float(rng.normal(0, np.deg2rad(config.roll_deg)))
    scale = span / px
    linear = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.column_stack([linear, centre - linear @ np.full(2, px / 2)]), turn


def _warped(photo: np.ndarray, photo_from_view: np.ndarray, px: int) -> np.ndarray:
    """The photo in the view's frame, reduced by area averaging first where the view is coarser."""
    scale = float(np.hypot(*photo_from_view[:, 0]))
    size = photo.shape[0]
    if scale > 1.3:
        smaller = round(size / scale)
        photo = cv2.resize(photo, (smaller, smaller), interpolation=cv2.INTER_AREA)
        photo_from_view = photo_from_view * (smaller / size)
    matrix = photo_from_view.copy()
    matrix[:, 2] = opencv_from_photo(matrix[:, :2] @ np.full(2, 0.5) + matrix[:, 2])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(photo, matrix, (px, px), flags=flags, borderMode=cv2.BORDER_REPLICATE)


def _sampled(
    shard: Shard, index: int, mask: np.ndarray, in_map: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mask, uv, xyz (as stored) and albedo at OpenCV coordinates of the maps: bilinear, of film pixels only, else 0.

    Only the four neighbours of each point are read: the maps stay on disk where nothing looks at them.
    """
    h, w = mask.shape
    corner = np.floor(in_map).astype(np.int64)
    part = (in_map - corner).astype(np.float32)
    inside = np.zeros(in_map.shape[:2], np.float32)
    sums = [np.zeros((*in_map.shape[:2], k), np.float32) for k in (2, 3, 1)]
    maps = [shard.stored(name, index) for name in ("uv", "xyz", "albedo")]
    for dy in (0, 1):
        for dx in (0, 1):
            x, y = corner[..., 0] + dx, corner[..., 1] + dy
            within = (x >= 0) & (x < w) & (y >= 0) & (y < h)
            x, y = np.clip(x, 0, w - 1), np.clip(y, 0, h - 1)
            film = within & mask[y, x]
            share = (part[..., 0] if dx else 1 - part[..., 0]) * (part[..., 1] if dy else 1 - part[..., 1]) * film
            inside += share
            for total, stored in zip(sums, maps, strict=True):
                values = stored[y, x].reshape(*film.shape, -1)
                total += share[..., None] * np.where(film[..., None], values, 0)
    seen = inside > 0.5
    uv, xyz, albedo = (np.where(seen[..., None], t / np.maximum(inside, 0.5)[..., None], 0) for t in sums)
    return seen, (uv / UV_LEVELS).astype(np.float32), xyz, (albedo[..., 0] / ALBEDO_LEVELS).astype(np.float32)


def _relative(xyz: np.ndarray, seen: np.ndarray, record: dict, turn: float) -> np.ndarray:
    """3D coordinates relative to the film's centre, in film diagonals, in the axes of the turned camera."""
    centre = np.asarray(record["grid"]["camera"]).reshape(-1, 3).mean(axis=0)
    relative = (xyz - centre) / np.hypot(*record["size_mm"])
    # The view is turned by +turn against the photo, so directions in its frame turn back.
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = relative[..., 0], relative[..., 1]
    turned = np.stack([cos * x + sin * y, -sin * x + cos * y, relative[..., 2]], axis=-1)
    return np.where(seen[..., None], turned, 0).astype(np.float32)


# ---------------------------------------------------------------- colours


def _disturbed(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Gain per channel, gamma, grey, blur, noise and holes, each on a share of the views."""
    x = np.arange(256, dtype=np.float32) / 255
    gain = np.exp2(rng.normal(0, 0.25) + rng.normal(0, 0.06, 3))
    table = np.stack([np.clip(x ** np.exp2(rng.normal(0, 0.2)) * g, 0, 1) for g in gain], axis=-1)
    image = cv2.LUT(image, np.rint(table * 255).astype(np.uint8)[None])
    if rng.random() < 0.15:
        image = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    if rng.random() < 0.15:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.4, 1.2))
    if rng.random() < 0.3:
        noise = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(rng.uniform(1, 10))
        image = np.clip(image + noise, 0, 255).astype(np.uint8)
    if rng.random() < 0.1:
        x0, y0 = rng.integers(0, image.shape[0], 2)
        w, h = rng.integers(4, image.shape[0] // 5, 2)
        image[y0 : y0 + h, x0 : x0 + w] = rng.integers(0, 256, 3)
    return image
