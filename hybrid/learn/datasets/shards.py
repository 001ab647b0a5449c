"""Reading a data set: memory-mapped tar shards, whose arrays are read in place (written by data_gen).

DIR/dataset.json      what made it: seed, count, every option, format and conventions version
DIR/manifest.json     each finished shard: name, count of samples, bytes, sha256
DIR/shard_00000.tar   samples in the WebDataset layout (data_gen/shards.py), coded as datasets/coding.py says
"""

from __future__ import annotations

import hashlib
import json
import mmap
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.coords import CONVENTIONS_VERSION
from hybrid.errors import DataError, describe
from hybrid.learn.datasets.coding import decode_albedo, decode_normal, decode_uv, decode_xyz

FORMAT = 2
"""Version of the data set's files; raised with each change that makes old files unreadable."""

FILM_MAPS = "film_maps.npy"
"""File beside a data set's shards: FilmNet's maps of its samples, (samples, n, m, 2) nodes; NaN where it saw none."""

TAR_BLOCK = 512

OPEN_SHARDS = 256
"""Shards kept mapped at a time: each keeps a file open, and a process may commonly open 1024."""


@dataclass(frozen=True)
class ShardEntry:
    """A shard's line in the manifest. first, count: numbers of its samples in the data set. bytes: of the file."""

    name: str
    first: int
    count: int
    bytes: int
    sha256: str


@dataclass(frozen=True, eq=False)
class Shard:
    """One shard; its file is opened at the first access to it. Samples are counted from 0 here."""

    path: Path
    entry: ShardEntry

    def __len__(self) -> int:
        return self.entry.count

    def photo(self, k: int) -> bytes:
        """The photo of a sample as JPEG."""
        return self.member("photo.jpg", k).tobytes()

    def record(self, k: int) -> dict[str, Any]:
        """All metadata of a sample: size_mm, camera, grid, coding, the parameters that were drawn."""
        return json.loads(self.member("json", k).tobytes())

    def stored(self, name: str, k: int) -> np.ndarray:
        """A map (mask, uv, xyz, normal, albedo, glare or backward) as it is stored, read-only and without a copy."""
        raw = self.member(f"{name}.npy", k)
        start = 10 + int.from_bytes(raw[8:10], "little")
        dtype, shape = _npy_layout(raw[:start].tobytes())
        return raw[start:].view(dtype).reshape(shape)

    def has(self, name: str) -> bool:
        """Whether the samples hold a map: photos of one's own (data_gen/own_photos.py) lack some."""
        return f"{name}.npy" in self._index

    def field(self, name: str, k: int) -> np.ndarray:
        """A map as the conventions define it: float32, NaN where the mask is False; mask and glare are boolean.

        uv (h, w, 2), xyz (h, w, 3) mm in camera axes, normal (h, w, 3) unit, albedo (h, w), depth (h, w) mm, backward
        (gh, gw, 2) nodes in pixels of the photo.
        """
        if name in ("mask", "glare", "backward"):
            return self.stored(name, k)
        if name == "depth":
            return self.field("xyz", k)[..., 2]
        mask = self.stored("mask", k)
        if name == "xyz":
            return decode_xyz(self.stored("xyz", k), mask, self.record(k)["coding"]["xyz"])
        return {"uv": decode_uv, "normal": decode_normal, "albedo": decode_albedo}[name](self.stored(name, k), mask)

    def member(self, suffix: str, k: int) -> np.ndarray:
        """The bytes of a sample's file KEY.suffix, in place."""
        offset, size = self._index[suffix][k]
        return _mapped(self.path, self.entry.sha256)[offset : offset + size]

    @cached_property
    def _index(self) -> dict[str, np.ndarray]:
        """Offset and size of each sample's files, (count, 2), by suffix."""
        try:
            index = read_index(self.path)
        except (OSError, ValueError) as error:
            raise DataError(describe(what="shard", where=self.path, got=error, do=_AGAIN)) from error
        if index.first != self.entry.first or index.count != self.entry.count:
            got = f"samples {index.first} to {index.first + index.count - 1}"
            allowed = f"{self.entry.first} to {self.entry.first + self.entry.count - 1}"
            raise DataError(describe(what="shard", where=self.path, got=got, allowed=allowed, do=_AGAIN))
        return index.places


_AGAIN = "Delete it and run python -m data_gen.generate of the same version with the options of its data set again."


@dataclass(frozen=True, eq=False)
class TarIndex:
    """Where everything in a shard is. first: number of its first sample. places: (count, 2) offset, size by suffix."""

    first: int
    count: int
    places: dict[str, np.ndarray]


def read_index(path: Path) -> TarIndex:
    """One pass over a shard's headers.

    Raises:
        OSError, ValueError: not a whole tar file of samples that follow each other and have the same members.
    """
    by_key: dict[str, dict[str, tuple[int, int]]] = {}
    for name, offset, size in _tar_members(path):
        key, _, suffix = name.partition(".")
        by_key.setdefault(key, {})[suffix] = (offset, size)
    if not by_key:
        raise ValueError("no samples in it")
    first = int(next(iter(by_key)))
    suffixes = next(iter(by_key.values())).keys()
    if list(by_key) != [key_of(first + k) for k in range(len(by_key))]:
        raise ValueError("samples do not follow each other")
    if any(files.keys() != suffixes for files in by_key.values()):
        raise ValueError("samples lack members")
    places = {suffix: np.array([files[suffix] for files in by_key.values()]) for suffix in suffixes}
    return TarIndex(first, len(by_key), places)


def _tar_members(path: Path) -> Iterator[tuple[str, int, int]]:
    """Name, offset and size of each file in an uncompressed USTAR tar."""
    file = os.open(path, os.O_RDONLY)  # plain reads: touching mapped pages would also read those around them
    try:
        at = 0
        while (header := os.pread(file, TAR_BLOCK, at))[:1] != b"\0":
            if len(header) < TAR_BLOCK or header[257:262] != b"ustar":
                raise ValueError(f"cut off or damaged at byte {at}")
            size = int(header[124:135], 8)
            yield header[: header.index(0)].decode("ascii"), at + TAR_BLOCK, size
            at += TAR_BLOCK + size + -size % TAR_BLOCK
    finally:
        os.close(file)


@lru_cache(maxsize=OPEN_SHARDS)
def _mapped(path: Path, sha256: str) -> np.ndarray:
    """The bytes of a shard. The hash distinguishes a shard from one that replaced it under the same name."""
    with path.open("rb") as file:
        return np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), np.uint8)


@lru_cache(maxsize=64)
def _npy_layout(header: bytes) -> tuple[np.dtype, tuple[int, ...]]:
    file = BytesIO(header)
    np.lib.format.read_magic(file)
    shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    return dtype, shape


def key_of(number: int) -> str:
    """The key of a sample, from its number in the data set."""
    return f"{number:09d}"


def sha256_of(path: Path) -> str:
    """The hash of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# ---------------------------------------------------------------- data sets


def read_description(folder: Path) -> dict[str, Any]:
    """dataset.json of a data set of this format and these conventions.

    Raises:
        DataError: no data set there, or one of another version.
    """
    path = folder / "dataset.json"
    try:
        described = json.loads(path.read_text())
        version = (described.get("format"), described["conventions"])
    except (OSError, ValueError, KeyError) as error:
        got = "no data set" if isinstance(error, FileNotFoundError) else error
        raise DataError(
            describe(what="data set", where=folder, got=got, do="Make one: python -m data_gen.generate.")
        ) from error
    if version != (FORMAT, CONVENTIONS_VERSION):
        got, allowed = ("format {}, conventions {}".format(*v) for v in (version, (FORMAT, CONVENTIONS_VERSION)))
        raise DataError(
            describe(what="data set", where=folder, got=got, allowed=allowed, do="Make it again in another folder.")
        )
    return described


def read_manifest(folder: Path) -> list[ShardEntry]:
    """The finished shards of a data set, in order; none where there is no manifest yet.

    Raises:
        DataError: the file is not a manifest.
    """
    path = folder / "manifest.json"
    if not path.exists():
        return []
    try:
        return [ShardEntry(**entry) for entry in json.loads(path.read_text())["shards"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        do = "Delete it; python -m data_gen.generate makes it anew."
        raise DataError(describe(what="manifest", where=path, got=error, do=do)) from error


def open_dataset(folder: Path, verify: bool = False) -> list[Shard]:
    """The finished shards of a data set folder, in order, none of them opened yet.

    Raises:
        DataError: no data set there, or none of its shards is finished; another version; a shard is missing or differs
            from the manifest in its size or, with ``verify``, in its sha256.
    """
    read_description(folder)
    shards = [Shard(folder / entry.name, entry) for entry in read_manifest(folder)]
    if not shards:
        raise DataError(describe(what="data set", where=folder, got="no finished shard", do=_without_shards(folder)))
    for shard in shards:
        size = shard.path.stat().st_size if shard.path.exists() else 0
        if size != shard.entry.bytes:
            raise DataError(
                describe(what="shard", where=shard.path, got=f"{size} bytes", allowed=shard.entry.bytes, do=_AGAIN)
            )
        if verify and sha256_of(shard.path) != shard.entry.sha256:
            raise DataError(describe(what="shard", where=shard.path, got="another sha256 than listed", do=_AGAIN))
    return shards


def data_digest(folders: Sequence[Path]) -> str:
    """Digest of what some folders hold, in their order, wherever they lie: of the hashes of shards that the manifest
    lists and of FilmNet's maps of their photos, or of the names and sizes of numbered files and their dataset.json."""
    digest = hashlib.sha256()
    for folder in folders:
        held = [f"{entry.name} {entry.sha256}" for entry in read_manifest(folder)]
        maps = folder / FILM_MAPS
        held += [f"{maps.name} {sha256_of(maps)}"] if held and maps.exists() else []
        if not held:
            held = [f"{path.name} {path.stat().st_size}" for path in sorted(folder.glob("[0-9]*"))]
            described = folder / "dataset.json"
            held += [described.read_text()] if described.exists() else []
        digest.update("\n".join([*held, ""]).encode() + b"\0")
    return digest.hexdigest()[:16]


def _without_shards(folder: Path) -> str:
    """What to do with a data set that has no shard: flat prints and lit films are numbered files."""
    if any(folder.glob("[0-9]*.jpg")):
        return "These are flat prints: train on them with --preset upright or --preset slices."
    if any(folder.glob("[0-9]*.npz")):
        return "These are flat films under many lights: train on them with --preset light."
    return "Run python -m data_gen.generate again."
