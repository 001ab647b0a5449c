"""Shards: folders of JPEG photos and memory-mappable maps, written once and read without decoding what is not needed.

DIR/dataset.json                      what made it: seed, configuration, conventions version
DIR/shard_00000/photos/000000.jpg     the photos
DIR/shard_00000/mask.npy ...          one array for each map, samples first (FIELDS)
DIR/shard_00000/samples.jsonl         one line for each sample: camera, grid, every parameter
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from data_gen.sample import Sample
from hybrid.learn.shards import UV_LEVELS


def _zero_filled(values: np.ndarray, scale: int, dtype: type) -> np.ndarray:
    return np.rint(np.nan_to_num(values) * scale).astype(dtype)


FIELDS: dict[str, tuple[type, tuple[int, ...], Callable[[Sample], np.ndarray]]] = {
    "mask": (np.bool_, (), lambda s: s.maps.mask),
    "uv": (np.uint16, (2,), lambda s: _zero_filled(s.maps.uv, UV_LEVELS, np.uint16)),
    "xyz": (np.float32, (3,), lambda s: s.maps.xyz.astype(np.float32)),
    "normal": (np.int8, (3,), lambda s: _zero_filled(s.maps.normal, 127, np.int8)),
    "albedo": (np.uint8, (), lambda s: _zero_filled(s.albedo, 255, np.uint8)),
}
"""Name: (type, trailing shape, stored values of a sample). Integers are 0 and floats NaN where the mask is False;
depth is xyz[..., 2]."""


class ShardWriter:
    """Writes the samples of one shard; the shard appears under its name only when it is whole."""

    def __init__(self, folder: Path, count: int, map_size: int) -> None:
        self.folder, self.count, self.written = folder, count, 0
        self._part = folder.with_name(folder.name + ".part")
        (self._part / "photos").mkdir(parents=True, exist_ok=True)
        self._arrays = {
            name: np.lib.format.open_memmap(
                self._part / f"{name}.npy", mode="w+", dtype=dtype, shape=(count, map_size, map_size, *trailing)
            )
            for name, (dtype, trailing, _) in FIELDS.items()
        }
        self._nodes: list[np.ndarray] = []
        self._lines: list[str] = []

    def add(self, sample: Sample) -> None:
        """Store one more sample; the last one completes the shard."""
        k = self.written
        (self._part / "photos" / f"{k:06d}.jpg").write_bytes(sample.photo)
        for name, (_, _, stored) in FIELDS.items():
            self._arrays[name][k] = stored(sample)
        self._nodes.append(sample.backward.nodes.astype(np.float32))
        self._lines.append(json.dumps(_record(sample)))
        self.written += 1
        if self.written == self.count:
            self._finish()

    def _finish(self) -> None:
        for array in self._arrays.values():
            array.flush()
        np.save(self._part / "backward.npy", np.stack(self._nodes))
        (self._part / "samples.jsonl").write_text("\n".join(self._lines) + "\n")
        self._part.rename(self.folder)


def _record(sample: Sample) -> dict[str, Any]:
    """The JSON line of a sample."""
    camera = sample.camera
    return {
        "size_mm": list(sample.size_mm),
        "camera": {
            "intrinsics": camera.intrinsics.tolist(),
            "camera_from_world": camera.camera_from_world.tolist(),
            "distortion": list(camera.distortion),
            "size": list(camera.size),
        },
        "grid": {
            "film": sample.grid_film.tolist(),
            "world": sample.grid_world.tolist(),
            "camera": sample.grid_camera.tolist(),
            "photo": sample.grid_photo.tolist(),
        },
        **sample.parameters,
    }
