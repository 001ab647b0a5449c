"""Shards: tar files in the WebDataset layout, in which the members of a sample share a key.

000000012.photo.jpg     the photo
000000012.mask.npy ...  the maps as plain arrays, coded as hybrid/learn/datasets/coding.py says, and the backward map
000000012.json          camera, grid, coding, every parameter

The key is the sample's number in the data set. Nothing is compressed, so a reader maps the file into memory and uses
the arrays in place. The headers hold no time and no owner: the same sample gives the same bytes.
"""

from __future__ import annotations

import json
import tarfile
from functools import lru_cache
from io import BytesIO
from typing import Any

import numpy as np

from data_gen.sample import Sample
from hybrid.learn.datasets.coding import encode_albedo, encode_normal, encode_uv, encode_xyz
from hybrid.learn.datasets.shards import key_of

END_OF_TAR = bytes(2 * tarfile.BLOCKSIZE)

GRID_DECIMALS = {"film": 7, "world": 4, "camera": 4, "photo": 4}
"""Decimals kept of the grid vertices in film units, mm, mm and pixels."""


def sample_bytes(sample: Sample, number: int) -> bytes:
    """The part of a tar file that holds sample ``number``."""
    return packed(members(sample), number)


def packed(files: dict[str, bytes], number: int) -> bytes:
    """The files of sample ``number``, by the part of their names that follows the key: headers and padded contents."""
    key = key_of(number)
    return b"".join(_member(f"{key}.{suffix}", content) for suffix, content in files.items())


def members(sample: Sample) -> dict[str, bytes]:
    """The files of a sample by the part of their names that follows the key."""
    mask = sample.maps.mask
    xyz, xyz_coding = encode_xyz(sample.maps.xyz, mask)
    arrays = {
        "mask": mask,
        "uv": encode_uv(sample.maps.uv, mask),
        "xyz": xyz,
        "normal": encode_normal(sample.maps.normal, mask),
        "albedo": encode_albedo(sample.albedo, mask),
        "glare": sample.glare,
        "backward": sample.backward.nodes.astype(np.float32),
    }
    record = _record(sample) | {"coding": {"xyz": xyz_coding}}
    maps = {f"{name}.npy": npy_bytes(array) for name, array in arrays.items()}
    return {"photo.jpg": sample.photo} | maps | {"json": json.dumps(record).encode()}


def _record(sample: Sample) -> dict[str, Any]:
    """The content of a sample's JSON member."""
    camera, mask = sample.camera, sample.maps.mask
    return {
        "size_mm": list(sample.size_mm),
        "camera": {
            "intrinsics": camera.intrinsics.tolist(),
            "camera_from_world": camera.camera_from_world.tolist(),
            "distortion": list(camera.distortion),
            "size": list(camera.size),
        },
        "grid": {
            name: np.round(getattr(sample, f"grid_{name}"), digits).tolist() for name, digits in GRID_DECIMALS.items()
        },
        "coverage": float(mask.mean()),
        "glare_share": float(sample.glare[mask].mean()) if mask.any() else 0.0,
        **sample.parameters,
    }


def npy_bytes(array: np.ndarray) -> bytes:
    """An array as a .npy file."""
    array = np.ascontiguousarray(array)
    return _npy_header(array.dtype.str, array.shape) + array.tobytes()


@lru_cache(maxsize=64)
def _npy_header(dtype: str, shape: tuple[int, ...]) -> bytes:
    file = BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": dtype, "fortran_order": False, "shape": shape})
    return file.getvalue()


def _member(name: str, content: bytes) -> bytes:
    info = tarfile.TarInfo(name)
    info.size, info.mode = len(content), 0o644
    return info.tobuf(tarfile.USTAR_FORMAT) + content + bytes(-len(content) % tarfile.BLOCKSIZE)
