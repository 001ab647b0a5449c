"""Training views of UprightNet: patches of flat prints as a flattened photo shows them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from hybrid.coords import opencv_from_photo
from hybrid.errors import DataError, describe
from hybrid.learn.datasets.draws import log_uniform
from hybrid.learn.networks.upright_patches import text_patches
from hybrid.learn.networks.uprightnet import UprightNetConfig


@dataclass(frozen=True)
class PrintAugment:
    """How a flat print is turned into what a flattened photo shows.

    photo_px: range of the film's longer side in the photo. squeeze: least square of the factor by which one side of a
    slanted film is foreshortened. zoom: range of the factor on the size of the letters. stretch, roll_deg: one sigma of
    the errors of aspect and angle that flattening leaves. gain: range. gamma: one sigma of log2. veil: most light added
    (white is 1), half of it even. blur_px: range of one sigma, in the photo's pixels. sharpen: most that a phone
    oversharpens. noise: range of one sigma, in grey levels of 255. quality: range of the JPEG's. shown: patches of a
    view, drawn from all patches of the film.
    """

    photo_px: tuple[float, float] = (480.0, 1400.0)
    squeeze: float = 0.55
    zoom: tuple[float, float] = (0.75, 1.35)
    stretch: float = 0.03
    roll_deg: float = 1.2
    gain: tuple[float, float] = (0.35, 1.1)
    gamma: float = 0.35
    veil: float = 0.4
    blur_px: tuple[float, float] = (0.25, 0.9)
    sharpen: float = 1.0
    noise: tuple[float, float] = (0.4, 7.0)
    quality: tuple[int, int] = (55, 97)
    shown: int = 16


def print_paths(folder: Path) -> list[Path]:
    """The flat prints of a folder made by ``python -m data_gen.flat_prints``, in order.

    Raises:
        DataError: there are none, or it is a data set of photos, whose contact sheet is no print.
    """
    paths = sorted(folder.glob("*.jpg"))
    shards = any(folder.glob("*.tar"))
    if shards or not paths:
        got = "a data set of photos" if shards else "no .jpg"
        raise DataError(describe(what="prints", where=folder, got=got, do="Make some: python -m data_gen.flat_prints."))
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
    flat: UInt8[np.ndarray, "h w"], config: UprightNetConfig, rng: np.random.Generator, augment: PrintAugment
) -> Float32[np.ndarray, "n p p"]:
    """Patches of a print as a flattened photo shows it; upright, since the network itself looks at them in all ways."""
    cut = replace(config.cut, film_px=config.film_px * rng.uniform(*augment.zoom))
    patches = text_patches(photographed(flat, rng, augment), cut)
    return patches[rng.permutation(len(patches))[: augment.shown]]


def photographed(
    flat: UInt8[np.ndarray, "h w"], rng: np.random.Generator, augment: PrintAugment
) -> UInt8[np.ndarray, "h2 w2"]:
    """A print at the photo's resolution, slightly skewed, with uneven light, a veil, a tone curve, blur and noise."""
    scale = min(1.0, log_uniform(rng, augment.photo_px) / max(flat.shape))
    size = (round(flat.shape[1] * scale), round(flat.shape[0] * scale))
    seen = np.array([1.0, rng.uniform(augment.squeeze, 1.0) ** 0.5])[rng.permutation(2)]
    film = _exposed(_reduced(flat, scale * seen, rng, augment), rng, augment)
    film = cv2.GaussianBlur(film, (0, 0), rng.uniform(*augment.blur_px))
    film += _noise(film.shape, rng) * np.float32(log_uniform(rng, augment.noise))
    if rng.random() < 0.5:
        amount = rng.uniform(0, augment.sharpen)
        film = cv2.addWeighted(film, 1 + amount, cv2.GaussianBlur(film, (0, 0), 1.0), -amount, 0)
    pixels = cv2.convertScaleAbs(np.maximum(film, 0, out=film))
    code = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(*augment.quality))])[1]
    pixels = np.asarray(cv2.imdecode(code, cv2.IMREAD_GRAYSCALE), np.uint8)
    return cv2.resize(pixels, size, interpolation=cv2.INTER_LINEAR)


def _reduced(
    flat: np.ndarray, scale: Float[np.ndarray, " 2"], rng: np.random.Generator, augment: PrintAugment
) -> np.ndarray:
    """The print at the photo's resolution; slightly stretched and turned. scale: across and down."""
    size = np.rint(np.array(flat.shape[::-1]) * scale).astype(int).tolist()
    angle, skew = np.deg2rad(rng.normal(0, augment.roll_deg, 2))
    linear = (
        np.diag(np.exp(rng.normal(0, augment.stretch, 2)))
        @ np.array([[1.0, skew - angle], [angle, 1.0]])
        @ np.diag(scale)
    )
    middle, print_middle = (opencv_from_photo(np.array(each) / 2) for each in (size, flat.shape[::-1]))
    affine = np.column_stack([linear, middle - linear @ print_middle])
    # A blur and linear interpolation stand for the mean over a pixel's area, in a third of the time.
    soft = cv2.GaussianBlur(flat, (0, 0), 0.4 / scale[0], sigmaY=0.4 / scale[1])
    return cv2.warpAffine(soft, affine, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _noise(size: tuple[int, ...], rng: np.random.Generator) -> Float32[np.ndarray, "h w"]:
    """White noise of spread 1 that repeats over the film; no patch sees the repetition."""
    height, width = (-(-n // 2) for n in size)
    return np.tile(rng.standard_normal((height, width), dtype=np.float32), (2, 2))[: size[0], : size[1]]


def _exposed(film: np.ndarray, rng: np.random.Generator, augment: PrintAugment) -> Float32[np.ndarray, "h w"]:
    """Grey levels (0 to 255, or more where they will be clipped) of a film in uneven light."""
    tone = (np.arange(256) / 255) ** np.exp2(rng.normal(0, augment.gamma))
    exposed = cv2.LUT(film, (255 * rng.uniform(*augment.gain) * tone).astype(np.float32))
    field = cv2.resize(rng.random((4, 4), dtype=np.float32), film.shape[::-1], interpolation=cv2.INTER_LINEAR)
    even, uneven = 255 * augment.veil * rng.random(2) ** 2 / 2
    exposed *= 1 - np.float32(rng.uniform(0, 0.6)) * field
    field *= np.float32(2 * uneven)
    exposed += field
    exposed += np.float32(even)
    return exposed
