"""Photos of the generator's own prints, slightly bent, on a background, with their exact maps."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
from synthetic_film import RolledFilm

from benchmarks.photos.cases import read_alike
from data_gen.ct.phantom import head_phantom
from data_gen.prints.prints import FilmPrint, PrintConfig, make_print
from hybrid.backward import BackwardMap
from hybrid.coords import (
    film_nodes,
    linear_from_srgb,
    opencv_from_photo,
    pixel_centres,
    pixel_from_film,
    srgb_from_linear,
)

PHOTO_PX = 720
RULES, GUTTERS = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@lru_cache(maxsize=8)
def film_print(seed: int = 1, style: tuple[float, float, float] = RULES, text_share: float = 1.0) -> FilmPrint:
    """A print of a head's slices without margins: the grid fills the sheet."""
    volume = head_phantom(np.random.default_rng(0), size=96, slices=24)
    config = PrintConfig(
        longer_px=1400, longer_spread=0.0, style_weights=style, margin_share=0.0, text_share=text_share,
        header_share=0.0, empty_share=0.0, scout_share=0.0,
    )  # fmt: skip
    return make_print(volume, np.random.default_rng(seed), config)


def table(level: int = 130, seed: int = 5) -> np.ndarray:
    """A patchy background of about one grey level, sRGB."""
    rng = np.random.default_rng(seed)
    patches = cv2.resize(rng.normal(size=(9, 9)), (PHOTO_PX, PHOTO_PX), interpolation=cv2.INTER_CUBIC)
    grain = rng.normal(0, 2, (PHOTO_PX, PHOTO_PX))
    grey = level + 0.12 * level * patches + grain
    return np.clip(grey[..., None] * np.array([1.0, 0.95, 0.85]), 0, 255)


@dataclass(frozen=True, eq=False)
class Shot:
    """How a print is photographed. fill: the longer side, as a fraction of the photo. at: the centre, likewise.

    roll: of the sheet, as in RolledFilm. light: colour of the light, sRGB white being 1.
    """

    fill: float = 0.8
    at: tuple[float, float] = (0.5, 0.5)
    angle: float = 0.06
    roll: tuple[float, float] = (0.4, 0.4)
    light: tuple[float, float, float] = (1.0, 1.0, 1.0)
    background: np.ndarray = field(default_factory=table)


@dataclass(frozen=True, eq=False)
class Photographed:
    """An sRGB photo, its true map, a mask of where it shows film, and the film coordinates of its pixels."""

    photo: np.ndarray
    truth: BackwardMap
    on_film: np.ndarray
    uv: np.ndarray

    def error_px(self, found: BackwardMap) -> float:
        """Mean end-point error over the part of the film that is in the photo, scaled to a photo of 1080 px."""
        return float(self.errors_px(found).mean())

    def errors_px(self, found: BackwardMap) -> np.ndarray:
        """End-point errors of the lattice's film points that are in the photo, whichever way up the map is."""
        nodes = film_nodes((33, 33))
        true = self.truth.photo_from_film(nodes)
        inside = ((true >= 0) & (true <= PHOTO_PX)).all(axis=-1)
        seen, _ = read_alike(found, self.truth)
        return np.linalg.norm(seen.photo_from_film(nodes) - true, axis=-1)[inside] * 1080 / PHOTO_PX


def photographed(sheet: FilmPrint, shot: Shot | None = None) -> Photographed:
    """A photo of a print: dark film, lit unevenly, on its background."""
    shot = shot or Shot()
    height, width = sheet.size_mm
    long_px = shot.fill * PHOTO_PX
    warp = RolledFilm(
        np.array(shot.at) * PHOTO_PX, long_px * min(1.0, height / width), width / height, shot.angle, shot.roll, 0.1
    )
    uv = warp.film_from_photo(pixel_centres((2 * PHOTO_PX, 2 * PHOTO_PX)) / 2)
    places = opencv_from_photo(pixel_from_film(uv, sheet.image.shape)).astype(np.float32)
    x, y = np.ascontiguousarray(places[..., 0]), np.ascontiguousarray(places[..., 1])
    grey = cv2.remap(sheet.image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    on_film = ((uv >= 0) & (uv <= 1)).all(axis=-1)
    light = 0.75 + 0.2 * np.sin(2.2 * uv[..., 0]) * np.cos(1.3 * uv[..., 1])
    linear = (linear_from_srgb(grey) * light + 0.006)[..., None] * np.array(shot.light)
    behind = cv2.resize(linear_from_srgb(shot.background / 255), on_film.shape, interpolation=cv2.INTER_LINEAR)
    linear = cv2.resize(
        np.where(on_film[..., None], linear, behind), (PHOTO_PX, PHOTO_PX), interpolation=cv2.INTER_AREA
    )
    noisy = 255 * srgb_from_linear(linear) + np.random.default_rng(3).normal(0, 1.2, linear.shape)
    half = (slice(None, None, 2), slice(None, None, 2))
    photo = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return Photographed(photo, warp.backward(), on_film[half], uv[half])
