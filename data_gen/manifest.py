"""The finished part of a data set: named shards, manifest and description, all of which survive a kill intact."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

from data_gen.shards import END_OF_TAR
from data_gen.sources import SourceConfig
from hybrid import __version__
from hybrid.coords import CONVENTIONS_VERSION
from hybrid.errors import ConfigError, DataError, describe
from hybrid.learn.datasets.shards import FORMAT, ShardEntry, read_description, read_index, read_manifest, sha256_of

PART = ".part"

SIMULATING = (
    *("data_gen/**/*.py", "hybrid/mesh/*.py", "hybrid/backward.py", "hybrid/coords.py", "hybrid/levels.py"),
    *("hybrid/gsdf.py", "hybrid/round_corners.py", "hybrid/learn/datasets/coding.py"),
)
"""Sources that decide what is simulated and how it is stored."""


def shard_name(number: int) -> str:
    """The file name of a shard."""
    return f"shard_{number:05d}.tar"


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Make the folder and lock it: two runs that write into one data set would destroy it.

    Raises:
        ConfigError: another run holds the lock, or the path is a file.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        got, do = "a file of this name", "Choose another --out."
        raise ConfigError(describe(what="--out", where=folder, got=got, do=do)) from error
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the system releases it however this process ends
        except BlockingIOError as error:
            do = "Wait for it to end, or choose another --out."
            raise ConfigError(describe(what="--out", where=folder, got="another run writes there", do=do)) from error
        yield
    finally:
        os.close(handle)


def write_shard(path: Path, first: int, samples: Iterable[bytes]) -> ShardEntry:
    """Write a shard from the tar parts of its samples; it gets its name only once all of it is on the disk.

    Raises:
        OSError: the disk is full or fails; nothing is left behind.
    """
    part = path.with_name(path.name + PART)
    digest, count = hashlib.sha256(), 0
    try:
        with part.open("wb") as file:
            for sample in samples:
                file.write(sample)
                digest.update(sample)
                count += 1
            file.write(END_OF_TAR)
            digest.update(END_OF_TAR)
            file.flush()
            os.fsync(file.fileno())
        entry = ShardEntry(path.name, first, count, part.stat().st_size, digest.hexdigest())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    _flush_folder(path.parent)
    return entry


def write_file(path: Path, content: bytes) -> None:
    """Replace a file as a whole and, unlike ``files.write_bytes``, wait until it is on the disk."""
    part = path.with_name(path.name + PART)
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    _flush_folder(path.parent)


def _flush_folder(folder: Path) -> None:
    """Flush the folder, so that renames in it are on the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_manifest(folder: Path, entries: Iterable[ShardEntry]) -> None:
    """List the finished shards."""
    listed = sorted(entries, key=lambda entry: entry.first)
    text = {"count": sum(entry.count for entry in listed), "shards": [asdict(entry) for entry in listed]}
    write_file(folder / "manifest.json", _json(text))


def finished_shards(folder: Path, shard_size: int) -> dict[int, ShardEntry]:
    """The finished shards, by number; leftovers of an interrupted run are removed.

    A shard that is missing from the manifest (the run was interrupted before listing it) is read and hashed.

    Raises:
        DataError: a shard is damaged, or its samples do not belong under its name.
    """
    for part in folder.glob("*" + PART):
        part.unlink()
    listed = {entry.name: entry for entry in read_manifest(folder)}
    found = {}
    for path in sorted(folder.glob("shard_*.tar")):
        number = int(path.stem.removeprefix("shard_"))
        entry = listed.get(path.name)
        if entry is None or entry.bytes != path.stat().st_size:
            entry = _entry_of(path)
        if entry.first != number * shard_size or entry.count > shard_size:
            got = f"samples {entry.first} to {entry.first + entry.count - 1}"
            raise DataError(describe(what="shard", where=path, got=got, do="Delete it and run the command again."))
        found[number] = entry
    return found


def _entry_of(path: Path) -> ShardEntry:
    try:
        index = read_index(path)
    except ValueError as error:
        raise DataError(
            describe(what="shard", where=path, got=error, do="Delete it and run the command again.")
        ) from error
    return ShardEntry(path.name, index.first, index.count, path.stat().st_size, sha256_of(path))


def _differing(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    """Names of the options that differ; nested names are joined by a dot."""
    names: list[str] = []
    for name in sorted(a.keys() | b.keys()):
        x, y = a.get(name), b.get(name)
        if isinstance(x, dict) and isinstance(y, dict):
            names += [f"{name}.{inner}" for inner in _differing(x, y)]
        elif x != y:
            names.append(name)
    return names


def deciding(**options: Any) -> dict[str, Any]:
    """The content of dataset.json except the count: all that decides the bytes, in the form read back from the file."""
    versions = {"format": FORMAT, "conventions": CONVENTIONS_VERSION, "hybrid": __version__}
    return json.loads(json.dumps(versions | options))  # tuples become lists


@lru_cache(maxsize=1)
def generator_digest() -> str:
    """Digest of the sources that simulate: other versions may make other bytes from the same seed."""
    digest, root = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(path for pattern in SIMULATING for path in root.glob(pattern)):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def described_sources(config: SourceConfig, names: dict[str, list[str]]) -> dict[str, Any]:
    """Sources as dataset.json records them: by the names of what was found, without this machine's paths."""
    return {name: value for name, value in asdict(config).items() if name not in ("ct", "hdri")} | names


def describe_dataset(folder: Path, options: dict[str, Any], count: int) -> None:
    """Write dataset.json, or check that the existing one belongs to the same data set and update its count.

    Raises:
        ConfigError: a data set made with other options or by another generator, or shards without a description.
        DataError: a data set of another version.
    """
    path = folder / "dataset.json"
    if path.exists():
        there = read_description(folder)
        wrong = _differing(there, options | {"count": there.get("count")})
        if wrong:
            got = f"a data set made with another {', '.join(wrong)}"
            do = "Give the options in its dataset.json to go on with it, or choose another --out."
            if "generator" in wrong:
                do = "Go on with the version of the sources that began it, or choose another --out."
            raise ConfigError(describe(what="--out", where=folder, got=got, do=do))
    elif any(folder.glob("shard_*")):
        raise ConfigError(
            describe(what="--out", where=folder, got="shards without dataset.json", do="Choose another --out.")
        )
    write_file(path, _json(options | {"count": count}))


def _json(values: dict[str, Any]) -> bytes:
    return (json.dumps(values, indent=1) + "\n").encode()
