"""Training views of UprightNet: parts of flat prints as a flattened photo shows them, turned and mirrored."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap, Orientation
from hybrid.coords import film_nodes, pixel_from_film, sample_bilinear
from hybrid.errors import DataError, describe
from hybrid.learn.upright import standardised


@dataclass(frozen=True)
class PrintAugment:
    """How a flat print is turned into what a flattened photo shows.

    longer_px: range of the film's longer side. warp: one sigma, in parts of the film, of what flattening left over.
    blur_px, noise: ranges of one sigma (noise: of white 1). veil: most light added, of white 1. gamma: sigma of log2.
    """

    longer_px: tuple[float, float] = (420.0, 800.0)
    warp: float = 0.006
    blur_px: tuple[float, float] = (0.3, 1.6)
    noise: tuple[float, float] = (0.002, 0.06)
    veil: float = 0.5
    gamma: float = 0.6


def print_paths(folder: Path) -> list[Path]:
    """The flat prints of a folder made by ``python -m data_gen.flat_prints``, in order.

    Raises:
        DataError: there are none.
    """
    paths = sorted(folder.glob("*.jpg"))
    if not paths:
        raise DataError(
            describe(what="prints", where=folder, got="no .jpg", do="Make some: python -m data_gen.flat_prints.")
        )
    return paths


def read_print(path: Path) -> UInt8[np.ndarray, "h w"]:
    """A flat print.

    Raises:
        DataError: the file is no picture.
    """
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise DataError(describe(what="print", where=path, got="not a picture", do="Make the prints again."))
    return image


def upright_view(
    flat: UInt8[np.ndarray, "h w"], px: int, rng: np.random.Generator, config: PrintAugment
) -> tuple[Float[np.ndarray, "px px"], int]:
    """A random part of a print as a flattened photo shows it, standardised, and the index of its orientation."""
    longer = rng.uniform(*config.longer_px)
    part = _part(flat, longer / max(flat.shape), px, rng)
    film = standardised(_lit(_warped(part, longer, rng, config), rng, config), longer)
    film = np.pad(film, [(0, px - side) for side in film.shape])
    way = Orientation.from_index(int(rng.integers(8)))
    return way.inverse.moved(film).copy(), way.index  # the film that ``way`` would make read right


def _part(flat: np.ndarray, scale: float, px: int, rng: np.random.Generator) -> np.ndarray:
    """A random part of the print, reduced by ``scale`` with area averaging to at most ``px`` pixels a side."""
    side = px / scale
    top, left = (rng.uniform(0, max(n - side, 0)) for n in flat.shape)
    part = flat[round(top) : round(top + side), round(left) : round(left + side)]
    size = [min(px, max(1, round(n * scale))) for n in part.shape]
    return cv2.resize(part, (size[1], size[0]), interpolation=cv2.INTER_AREA).astype(np.float32) / 255


def _warped(part: np.ndarray, longer_px: float, rng: np.random.Generator, config: PrintAugment) -> np.ndarray:
    """A part of a film of ``longer_px``, slightly bent as by an imperfect map; display grey in [0, 1]."""
    size = (part.shape[0], part.shape[1])
    nodes = film_nodes((4, 4)) + rng.normal(0, config.warp, (4, 4, 2)) * (longer_px / max(size))
    return sample_bilinear(part, pixel_from_film(BackwardMap(nodes).dense(size), size))


def _lit(film: np.ndarray, rng: np.random.Generator, config: PrintAugment) -> np.ndarray:
    """Uneven light, a veil, a tone curve, blur, noise and JPEG."""
    size = film.shape[::-1]

    def field() -> np.ndarray:
        coarse = rng.normal(0, 1, (4, 4)).astype(np.float32)
        return cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)

    gain = np.exp2(0.5 * field())
    veil = rng.uniform(0, config.veil) * rng.random() / (1 + np.exp(-2 * field()))
    film = np.clip(gain * rng.uniform(0.3, 1.1) * film ** np.exp2(rng.normal(0, config.gamma)) + veil, 0, 1)
    film = cv2.GaussianBlur(film.astype(np.float32), (0, 0), rng.uniform(*config.blur_px))
    film = film + rng.standard_normal(film.shape, dtype=np.float32) * np.exp(rng.uniform(*np.log(config.noise)))
    pixels = np.clip(np.rint(film * 255), 0, 255).astype(np.uint8)
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(40, 97))]
    decoded = cv2.imdecode(cv2.imencode(".jpg", pixels, quality)[1], cv2.IMREAD_GRAYSCALE)
    return np.asarray(decoded, np.float32) / 255
