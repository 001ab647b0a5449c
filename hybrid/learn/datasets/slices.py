"""Training views of SliceNet: slices of flat prints as a flattened photo shows them, bent and cut out slightly off."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from hybrid.coords import film_centres, opencv_from_photo
from hybrid.errors import DataError, describe
from hybrid.learn.datasets.patterns import pattern_cell, pattern_kinds
from hybrid.learn.datasets.upright import PrintAugment, photographed, print_paths, read_print
from hybrid.learn.networks.slicenet import SliceNetConfig, cell_squares, standardised

_PER_PIXEL = 1.5
"""Film pixels, at most, per pixel of a picture read there: larger films are reduced first, so that none is skipped."""


@dataclass(frozen=True)
class SliceAugment:
    """How slices are disturbed besides what a photo does to them; alike in a view, but for ``shift`` and ``hidden``.

    roll_deg, stretch: one sigma of the angle, and of the log of the aspect. zoom: range. bend: one sigma, as a fraction
    of the cell, of a smooth displacement that imitates differently shaped patients. shift: one sigma of the middle's,
    as a fraction of the cell. gamma: one sigma of its log2, for each view. hidden: share of slices with a hidden part.
    strange: share of views that show test patterns, which lie any way: the network must not prefer any turn of what is
    not anatomy. shown: slices of a view.
    """

    roll_deg: float = 5.0
    stretch: float = 0.1
    zoom: tuple[float, float] = (0.8, 1.25)
    bend: float = 0.03
    shift: float = 0.04
    gamma: float = 0.4
    hidden: float = 0.2
    strange: float = 0.08
    shown: int = 6


def sliced_prints(folder: Path) -> list[Path]:
    """The flat prints of a folder that records where their slices are.

    Raises:
        DataError: there are none, or they were made before this was recorded.
    """
    paths = print_paths(folder)
    if not paths[0].with_suffix(".json").exists():
        do = "Make the prints again: python -m data_gen.flat_prints."
        raise DataError(describe(what="prints", where=folder, got=f"no {paths[0].stem}.json", do=do))
    return paths


def grid_of(path: Path) -> Float[np.ndarray, "r c 2"]:
    """Film uv of the corners of the cells of a print.

    Raises:
        DataError: its JSON does not say.
    """
    try:
        return np.array(json.loads(path.with_suffix(".json").read_text())["vertices"], dtype=np.float64)
    except (OSError, ValueError, KeyError) as error:
        do = "Make the prints again."
        raise DataError(describe(what="print", where=path.with_suffix(".json"), got=error, do=do)) from error


def slice_view(
    path: Path, config: SliceNetConfig, rng: np.random.Generator, photo: PrintAugment, augment: SliceAugment
) -> Float32[np.ndarray, "n p p"]:
    """Slices of a print as a flattened photo shows them, right way up; all 0 where there are fewer than ``shown``."""
    if rng.random() < augment.strange:
        return _strange_view(config.input_px, rng, augment.shown)
    film = photographed(read_print(path), rng, photo)
    film = cv2.LUT(
        film, np.rint(255 * (np.arange(256) / 255) ** np.exp2(rng.normal(0, augment.gamma))).astype(np.uint8)
    )
    squares = cell_squares(grid_of(path), film.shape)
    chosen = rng.permutation(len(squares))[: augment.shown]
    bent = _bent_places(config.input_px, rng, augment)
    pictures = np.zeros((augment.shown, config.input_px, config.input_px), np.uint8)
    for picture, number in zip(pictures, chosen, strict=False):
        middle, side = squares[number]
        places = middle + side * (bent + rng.normal(0, augment.shift, 2))
        picture[:] = _read(film, places, side, config.input_px)
        if rng.random() < augment.hidden:
            _hide(picture, rng)
    return standardised(pictures)


def _strange_view(px: int, rng: np.random.Generator, shown: int) -> Float32[np.ndarray, "n p p"]:
    """Noisy cells of test patterns, all turned by the same random number of quarter turns."""
    kinds, ground, turns = pattern_kinds(rng), int(rng.integers(0, 60)), int(rng.integers(4))
    cells = np.stack([np.rot90(pattern_cell(2 * px, kinds, ground, rng), turns) for _ in range(shown)])
    cells = cells.reshape(shown, px, 2, px, 2).mean(axis=(2, 4)) + rng.normal(0, rng.uniform(1, 8), (shown, px, px))
    return standardised(np.clip(cells, 0, 255).astype(np.uint8))


def _bent_places(px: int, rng: np.random.Generator, augment: SliceAugment) -> Float[np.ndarray, "p p 2"]:
    """Where the pixels of a picture are read, from the cell's middle in fractions of its side; half are mirrored."""
    angle, aspect = np.deg2rad(rng.normal(0, augment.roll_deg)), np.exp(rng.normal(0, augment.stretch) / 2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    flip = np.diag([rng.choice([-1.0, 1.0]), 1.0])
    linear = turn @ np.diag([aspect, 1 / aspect]) @ flip / rng.uniform(*augment.zoom)
    smooth = rng.normal(0, augment.bend, (4, 4, 2))
    return (film_centres((px, px)) - 0.5) @ linear.T + cv2.resize(smooth, (px, px), interpolation=cv2.INTER_CUBIC)


def _read(
    film: UInt8[np.ndarray, "h w"], places: Float[np.ndarray, "p p 2"], side: float, px: int
) -> UInt8[np.ndarray, "p p"]:
    """The film at these places (pixels); what is larger than a picture of ``px`` is reduced first."""
    low = np.maximum(np.floor(places.min(axis=(0, 1))).astype(int) - 2, 0)
    high = np.ceil(places.max(axis=(0, 1))).astype(int) + 3
    part = film[low[1] : high[1], low[0] : high[0]]
    shrink = min(1.0, _PER_PIXEL * px / side)
    small = cv2.resize(part, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA) if shrink < 1 else part
    scale = np.array(small.shape[::-1]) / part.shape[::-1]
    x, y = np.moveaxis(opencv_from_photo((places - low) * scale), -1, 0).astype(np.float32)
    return np.asarray(cv2.remap(small, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def _hide(picture: UInt8[np.ndarray, "p p"], rng: np.random.Generator) -> None:
    """Set a part of the picture to one grey, as under a finger or in glare."""
    px = len(picture)
    middle, axes = rng.uniform(0, px, 2), rng.uniform(0.08, 0.3, 2) * px
    ellipse = (tuple(middle.tolist()), tuple((2 * axes).tolist()), float(rng.uniform(0, 180)))
    cv2.ellipse(picture, ellipse, int(rng.integers(40, 256)), -1)


__all__ = ["SliceAugment", "grid_of", "slice_view", "sliced_prints"]
