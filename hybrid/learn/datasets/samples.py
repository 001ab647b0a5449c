"""One sample of a data set, read at the points of a view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from hybrid.backward import BackwardMap, orientation
from hybrid.coords import inside_outline, opencv_from_photo, rescale_points
from hybrid.errors import DataError, describe
from hybrid.learn.datasets.coding import ALBEDO_LEVELS, UV_LEVELS, decode_normal, xyz_from_stored
from hybrid.learn.datasets.shards import Shard, open_dataset
from hybrid.round_corners import RoundCorners

Place = tuple[Shard, int]
"""A sample: its shard and its number in it."""

CHANNELS = {"uv": 2, "xyz": 3, "albedo": 1}
"""Channels of the maps that are interpolated."""


@dataclass(frozen=True, eq=False)
class Truth:
    """The maps of a sample at some photo points; 0 where the mask is False.

    uv: film coordinates. xyz: camera axes, relative to the film's centre, in film diagonals. normal: unit, camera axes,
    towards the side that is seen. albedo: display grey of the print. covered: something lies in front of the film; not
    where the mask is True. A map that the sample lacks is 0 everywhere; has_shape: whether it has xyz and normal, and
    thus covered; has_print: whether it has albedo. vertices: film coordinates of the corners of the cells; None where
    these are not known.
    """

    mask: Bool[np.ndarray, "h w"]
    uv: Float[np.ndarray, "h w 2"]
    xyz: Float[np.ndarray, "h w 3"]
    albedo: Float[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]
    covered: Bool[np.ndarray, "h w"]
    has_shape: bool
    has_print: bool
    vertices: Float[np.ndarray, "r c 2"] | None

    def without(self, cut: Bool[np.ndarray, "h w"]) -> Truth:
        """The truth for the sheet with these film points cut off."""
        left = self.mask & ~cut
        maps = {name: np.where(left[..., None], getattr(self, name), 0) for name in ("uv", "xyz", "normal")}
        return replace(self, mask=left, albedo=np.where(left, self.albedo, 0), **maps)


def open_places(folders: Sequence[Path]) -> list[Place]:
    """All samples of some data sets, in order.

    Raises:
        DataError: a data set cannot be read.
    """
    return [(shard, k) for folder in folders for shard in open_dataset(folder) for k in range(len(shard))]


def photo_of(place: Place) -> UInt8[np.ndarray, "h w 3"]:
    """The photo of a sample, RGB.

    Raises:
        DataError: it cannot be decoded.
    """
    shard, index = place
    photo = cv2.imdecode(shard.member("photo.jpg", index), cv2.IMREAD_COLOR_RGB)
    if photo is None:
        raise DataError(describe(what="shard", where=shard.path, got=f"photo {index} unreadable", do="Make it again."))
    return photo


def film_of(place: Place) -> BackwardMap:
    """The true backward map of a sample."""
    shard, index = place
    return BackwardMap(shard.stored("backward", index))


def film_mask(place: Place) -> Bool[np.ndarray, "h w"]:
    """Where the photo of a sample shows film, at the resolution of its maps."""
    shard, index = place
    return np.asarray(shard.stored("mask", index), dtype=bool)


def round_corners_of(place: Place) -> RoundCorners | None:
    """The round corners of a sample's film; None where they are sharp."""
    shard, index = place
    return _round_corners(shard.record(index))


def _round_corners(record: dict) -> RoundCorners | None:
    radii = record.get("round_corners")
    return None if radii is None else RoundCorners(*radii)


def sheet_outline(film: BackwardMap, corners: RoundCorners | None) -> Float[np.ndarray, "n 2"]:
    """Photo points once around the edge of a film with round or sharp corners."""
    return film.outline() if corners is None else film.photo_from_film(corners.outline())


def vertices_of(place: Place) -> Float[np.ndarray, "r c 2"] | None:
    """Film coordinates of the corners of a sample's cells; None where these are not known."""
    shard, index = place
    record = shard.record(index)
    return np.array(record["grid"]["film"]) if "grid" in record else None


def truth_at(place: Place, points: Float[np.ndarray, "h w 2"], photo_size: tuple[int, int]) -> Truth:
    """The maps of a sample at photo points: bilinear, over film pixels only; the normal is that of the nearest one.

    Only the four neighbours of each point are read: the rest of the maps stays on disk. Where some of the four show no
    film, the mean of the others belongs to a different place; uv and xyz are extrapolated from there.
    """
    shard, index = place
    mask = shard.stored("mask", index)
    maps = {name: shard.stored(name, index) for name in CHANNELS if shard.has(name)}
    at = opencv_from_photo(rescale_points(points, photo_size, (mask.shape[0], mask.shape[1])))
    corner = np.floor(at).astype(np.int64)
    part = (at - corner).astype(np.float32)
    inside = np.zeros(at.shape[:2], np.float32)
    sums = {name: np.zeros((*at.shape[:2], k), np.float32) for name, k in CHANNELS.items()}
    place_of_mean = np.zeros((*at.shape[:2], 2), np.float32)
    for dy in (0, 1):
        for dx in (0, 1):
            x, y = corner[..., 0] + dx, corner[..., 1] + dy
            within = (x >= 0) & (x < mask.shape[1]) & (y >= 0) & (y < mask.shape[0])
            x, y = np.clip(x, 0, mask.shape[1] - 1), np.clip(y, 0, mask.shape[0] - 1)
            film = within & mask[y, x]
            share = (part[..., 0] if dx else 1 - part[..., 0]) * (part[..., 1] if dy else 1 - part[..., 1]) * film
            inside += share
            for name, stored in maps.items():
                values = stored[y, x].reshape(*film.shape, -1)
                sums[name] += share[..., None] * np.where(film[..., None], values, 0)
            place_of_mean += share[..., None] * np.stack([x, y], axis=-1)
    seen = inside > 0.5
    uv, xyz, albedo, place_of_mean = (
        np.where(seen[..., None], t / np.maximum(inside, 0.5)[..., None], 0) for t in (*sums.values(), place_of_mean)
    )
    off = np.where(seen[..., None], at - place_of_mean, 0).astype(np.float32)
    uv, xyz = (_carried_on(values, off, at, seen) for values in (uv, xyz))
    has_shape, nothing = "xyz" in maps and shard.has("normal"), np.zeros((*seen.shape, 3), np.float32)
    record = shard.record(index)
    return Truth(
        seen,
        uv / np.float32(UV_LEVELS),
        _relative(xyz, seen, record) if has_shape else nothing,
        albedo[..., 0] / np.float32(ALBEDO_LEVELS),
        _nearest_normal(place, at, seen) * _side_seen(place) if has_shape else nothing,
        _covered(place, at, photo_size, _round_corners(record)) & ~seen,
        has_shape,
        has_print="albedo" in maps,
        vertices=vertices_of(place),
    )


def _carried_on(values: np.ndarray, off: np.ndarray, at: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Values extrapolated by ``off`` map pixels along their mean slope over the film."""
    if seen.sum() < 8:
        return values
    rows = np.column_stack([at[seen], np.ones(int(seen.sum()))])
    slope = np.linalg.lstsq(rows, values[seen], rcond=None)[0][:2]
    return values + off @ slope.astype(np.float32)


def _nearest_normal(place: Place, at: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Normals of the film pixels nearest to OpenCV coordinates of the maps; stored normals cannot be averaged."""
    shard, index = place
    mask, stored = shard.stored("mask", index), shard.stored("normal", index)
    x, y = (np.clip(np.rint(at[..., k]).astype(np.int64), 0, mask.shape[1 - k] - 1) for k in (0, 1))
    beside = seen & ~mask[y, x]
    x[beside], y[beside] = _nearest_film(mask, at[beside])
    return np.where(seen[..., None], decode_normal(stored[y, x], seen), np.float32(0))


def _side_seen(place: Place) -> np.float32:
    """Factor that turns a normal of the side that reads right towards the side that the photo shows."""
    return np.float32(-1 if orientation(film_of(place)).mirrored else 1)


def _nearest_film(mask: np.ndarray, at: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "2 n"]:
    """Column and row of the nearest of the four pixels around a point that shows film; one of them must."""
    around = np.floor(at)[:, None] + np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
    pixels = np.clip(around, 0, np.array(mask.shape[::-1]) - 1).astype(np.int64)
    film = mask[pixels[..., 1], pixels[..., 0]]
    nearest = np.where(film, np.square(around - at[:, None]).sum(axis=-1), np.inf).argmin(axis=1)
    return pixels[np.arange(len(at)), nearest].T


def _covered(
    place: Place, at: np.ndarray, photo_size: tuple[int, int], corners: RoundCorners | None
) -> Bool[np.ndarray, "h w"]:
    """Whether map pixels at OpenCV coordinates lie well within the sheet's outline but show no film."""
    mask = film_mask(place)
    size = (mask.shape[0], mask.shape[1])
    edge = sheet_outline(film_of(place), corners)
    inside = inside_outline(rescale_points(edge, photo_size, size), size)
    hidden = cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) & ~mask
    x, y = (np.rint(at[..., k]).astype(np.int64) for k in (0, 1))
    within = (x >= 0) & (x < size[1]) & (y >= 0) & (y < size[0])
    return within & hidden[np.clip(y, 0, size[0] - 1), np.clip(x, 0, size[1] - 1)]


def _relative(stored: np.ndarray, seen: np.ndarray, record: dict) -> np.ndarray:
    """Stored 3D coordinates made relative to the film's centre, in film diagonals."""
    xyz = xyz_from_stored(stored, record["coding"]["xyz"])
    centre = np.asarray(record["grid"]["camera"]).reshape(-1, 3).mean(axis=0)
    return np.where(seen[..., None], (xyz - centre) / np.hypot(*record["size_mm"]), 0).astype(np.float32)
