"""Reading shards: folders of JPEG photos and memory-mapped maps (written by data_gen, see data_gen/shards.py)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.coords import CONVENTIONS_VERSION
from hybrid.errors import DataError, describe

UV_LEVELS = 65535
"""uv in [0, 1] is stored in 16 bits: steps of 1.5e-5, far below a hundredth of a pixel."""

MAP_NAMES = ("mask", "uv", "xyz", "normal", "albedo")


@dataclass(frozen=True, eq=False)
class Shard:
    """One shard, opened without reading its maps.

    photos: JPEG bytes. maps: memory-mapped arrays by name, samples first. backward: (n, gh, gw, 2) nodes.
    samples: the JSON records.
    """

    folder: Path
    maps: dict[str, np.ndarray]
    backward: np.ndarray
    samples: list[dict[str, Any]]

    @cached_property
    def photos(self) -> list[bytes]:
        return [path.read_bytes() for path in sorted((self.folder / "photos").glob("*.jpg"))]

    def __len__(self) -> int:
        return len(self.samples)


def open_shard(folder: Path) -> Shard:
    """Open one shard folder.

    Raises:
        DataError: a file of the shard is missing.
    """
    try:
        maps = {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in MAP_NAMES}
        backward = np.load(folder / "backward.npy", mmap_mode="r")
        samples = [json.loads(line) for line in (folder / "samples.jsonl").read_text().splitlines()]
    except (OSError, ValueError) as error:
        raise DataError(describe(what="shard", where=folder, got=error, do="Make the data set again.")) from error
    return Shard(folder, maps, backward, samples)


def open_dataset(folder: Path) -> list[Shard]:
    """All shards of a data set folder, in order.

    Raises:
        DataError: no data set there, none of its shards is finished, or it follows other conventions.
    """
    described = folder / "dataset.json"
    shards = sorted(path for path in folder.glob("shard_*") if path.suffix != ".part")
    if not described.exists() or not shards:
        raise DataError(
            describe(
                what="data set", where=folder, got="no finished shard", do="Make one: python -m data_gen.generate."
            )
        )
    version = json.loads(described.read_text())["conventions"]
    if version != CONVENTIONS_VERSION:
        raise DataError(
            describe(
                what="data set",
                where=folder,
                got=f"conventions {version}",
                allowed=CONVENTIONS_VERSION,
                do="Make it again.",
            )
        )
    return [open_shard(path) for path in shards]
