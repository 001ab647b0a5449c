"""A data set of your own photos, to train a network further: ``python -m data_gen.own_photos PAIRS --out DIR``.

Beside each photo (NAME.jpg, .jpeg or .png) lies NAME.npz with the array ``lattice`` (n, m, 2). It holds the photo
points (x, y) of a regular lattice of film points, in pixels from the photo's top-left corner with pixel centres at
+0.5. The lattice includes the film's edges; row 0 is its top. Mask, uv and the backward map are computed from it. 3D
coordinates, normals and the print are unknown, so training leaves out their losses for such samples
(hybrid.learn.networks.losses.Targets).
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import tyro
from jaxtyping import Float, UInt8
from tqdm import tqdm

from data_gen.generate import MAX_MAP_SIZE
from data_gen.manifest import deciding, describe_dataset, shard_name, sole_writer, write_manifest, write_shard
from data_gen.shards import npy_bytes, packed
from data_gen.work import run_command
from hybrid.backward import MIN_NODES, BackwardMap
from hybrid.coords import opencv_from_photo, pixel_centres, rescale_points, rgb_from_bgr
from hybrid.draw import outline_curve, resized
from hybrid.errors import NPZ_ERRORS, ConfigError, DataError, describe
from hybrid.image_io import read_photo
from hybrid.learn.datasets.coding import encode_uv

SUFFIXES = (".jpg", ".jpeg", ".png")
"""Of photos, in lower or upper case."""
JPEG_QUALITY = 95
STORED_NODES = (65, 65)
"""Nodes of stored backward maps, as in generated data sets."""


@dataclass(frozen=True)
class OwnPhotosConfig:
    """Make a data set of photos whose true maps are known."""

    pairs: Annotated[Path, tyro.conf.Positional]
    """Folder of NAME.jpg (.jpeg, .png) and NAME.npz with the film's lattice."""
    out: Path
    """Folder for the data set."""
    size: int = 1024
    """Longer side, in pixels, to which photos are reduced; training uses no more than a few hundred."""

    def __post_init__(self) -> None:
        if self.size < 64:
            raise ConfigError(describe(what="--size", got=self.size, allowed=">= 64", do="Choose another."))


@dataclass(frozen=True, eq=False)
class Pair:
    """A photo and the true backward map into it, in pixels."""

    name: str
    photo: UInt8[np.ndarray, "h w 3"]
    backward: BackwardMap


def pair_paths(folder: Path) -> list[tuple[Path, Path]]:
    """All photos of a folder that have a truth, by name, each with its truth.

    Raises:
        DataError: there is no truth, or one without exactly one photo.
    """
    pairs, every = [], photos_in(folder)
    for truth in sorted(folder.glob("*.npz")):
        photos = [path for path in every if path.stem == truth.stem]
        if len(photos) != 1:
            got, allowed = f"{len(photos)} photos of that name", "one: " + ", ".join(SUFFIXES)
            raise DataError(
                describe(what="truth", where=truth, got=got, allowed=allowed, do="Put its photo beside it.")
            )
        pairs.append((photos[0], truth))
    if not pairs:
        do = "Name a folder of photos with NAME.npz beside each, which holds the film's lattice."
        raise DataError(describe(what="pairs", where=folder, got="no .npz file", do=do))
    return pairs


def photos_in(folder: Path) -> list[Path]:
    """All photos of a folder, by name."""
    return sorted(path for path in folder.glob("*") if path.suffix.lower() in SUFFIXES)


def read_pair(photo: Path, truth: Path, longer: int) -> Pair:
    """A photo, its longer side reduced to ``longer`` pixels, and its map.

    Raises:
        PhotoError: the photo cannot be read. DataError: the truth cannot be read, or is no map of a film in this photo.
    """
    picture = read_photo(photo)
    lattice = _read_lattice(truth)
    size = (picture.shape[0], picture.shape[1])
    scale = min(1.0, longer / max(size))
    reduced = (max(1, round(scale * size[0])), max(1, round(scale * size[1])))
    backward = BackwardMap(rescale_points(lattice, size, reduced))
    if backward.folds():
        got = "a lattice that folds over itself"
        raise DataError(describe(what="lattice", where=truth, got=got, do="Check the order of its rows and columns."))
    return Pair(photo.stem, resized(picture, reduced), backward)


def _read_lattice(truth: Path) -> Float[np.ndarray, "n m 2"]:
    try:
        with np.load(truth, allow_pickle=False) as data:
            lattice = np.asarray(data["lattice"], dtype=np.float64)
    except NPZ_ERRORS as error:
        do = "Save it with numpy.savez(NAME, lattice=points)."
        raise DataError(describe(what="truth", where=truth, got=error, allowed="an array 'lattice'", do=do)) from error
    if lattice.ndim != 3 or lattice.shape[2] != 2 or min(lattice.shape[:2]) < MIN_NODES:
        allowed = f"(n, m, 2), n and m >= {MIN_NODES}"
        do = "Give photo points (x, y) of a regular lattice."
        raise DataError(describe(what="lattice", where=truth, got=lattice.shape, allowed=allowed, do=do))
    if not np.isfinite(lattice).all():
        do = "Give all its points, also those beyond the photo or hidden in it."
        raise DataError(describe(what="lattice", where=truth, got="NaN or infinity", allowed="numbers", do=do))
    return lattice


def pair_members(pair: Pair) -> dict[str, bytes]:
    """The files of a sample, as data_gen.shards.members, without those whose content is unknown.

    Raises:
        DataError: the photo shows nothing of the film.
    """
    size = (pair.photo.shape[0], pair.photo.shape[1])
    scale = min(1.0, MAX_MAP_SIZE / max(size))
    maps = (max(1, round(scale * size[0])), max(1, round(scale * size[1])))
    uv = _film_seen(pair.backward.cropped((0.0, 0.0), (maps[1] / size[1], maps[0] / size[0])), maps)
    mask = np.asarray(np.isfinite(uv).all(axis=-1))
    if not mask.any():
        do = "Check that the points are (x, y) in pixels of this photo."
        raise DataError(describe(what="lattice", where=pair.name, got="no film within the photo", do=do))
    encoded = cv2.imencode(".jpg", rgb_from_bgr(pair.photo), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    arrays = {
        "mask": mask,
        "uv": encode_uv(uv, mask),
        "backward": pair.backward.resized(STORED_NODES).nodes.astype(np.float32),
    }
    record = {"name": pair.name, "coverage": float(mask.mean())}
    files = {f"{name}.npy": npy_bytes(array) for name, array in arrays.items()}
    return {"photo.jpg": encoded.tobytes()} | files | {"json": json.dumps(record).encode()}


def _film_seen(backward: BackwardMap, size: tuple[int, int]) -> Float[np.ndarray, "h w 2"]:
    """Film uv of all pixel centres of an image of ``size``; NaN off the film. Only pixels near it are inverted."""
    outline = np.rint(opencv_from_photo(outline_curve(backward))).astype(np.int32)
    near = cv2.dilate(cv2.fillPoly(np.zeros(size, np.uint8), [outline], (1,)), np.ones((5, 5), np.uint8)) > 0
    uv = np.full((*size, 2), np.nan)
    if near.any():
        uv[near] = backward.film_from_photo(pixel_centres(size)[near])
    return uv


def make_dataset(config: OwnPhotosConfig) -> int:
    """Write all pairs as one shard and return the number of samples. The same pairs give the same bytes.

    Raises:
        PhotoError, DataError: a pair cannot be used. ConfigError: ``out`` holds another data set.
    """
    paths = pair_paths(config.pairs)

    def samples() -> Iterator[bytes]:
        for number, (photo, truth) in enumerate(tqdm(paths, unit="photo")):
            yield packed(pair_members(read_pair(photo, truth, config.size)), number)

    names = hashlib.sha256(b"\n".join(os.fsencode(photo.name) for photo, _ in paths)).hexdigest()
    options = deciding(sources="own photos", size=config.size, pairs=names)
    with sole_writer(config.out):
        describe_dataset(config.out, options, len(paths))
        write_manifest(config.out, [write_shard(config.out / shard_name(0), 0, samples())])
    return len(paths)


def _make_and_tell(config: OwnPhotosConfig) -> None:
    count = make_dataset(config)
    without = len(photos_in(config.pairs)) - count
    print(f"{count} samples written{f'; {without} photos have no .npz' if without else ''}", file=sys.stderr)


def main() -> None:
    """Command line."""
    stopped = "no samples are written, and the same command begins anew"
    run_command("data_gen.own_photos", OwnPhotosConfig, _make_and_tell, stopped)


if __name__ == "__main__":
    main()
