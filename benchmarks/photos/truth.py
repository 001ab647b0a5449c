"""Photos with the truth: read from a folder of NAME.jpg, NAME.npz and textures/."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.errors import NPZ_ERRORS, DataError, describe
from hybrid.image_io import read_photo

TEXTURE_NAME = re.compile(r"_(?P<rows>\d+)x(?P<cols>\d+)_(?P<style>[a-z]+)_m(?P<margin>\d+)\.png$")


@dataclass(frozen=True, eq=False)
class TruePhoto:
    """A rendered photo whose true geometry and print are known.

    lattice: (n, n, 2) true photo points of a regular lattice of film points, edges included, row 0 the film's top.
    xyz: the same points in space; None where the file has none.
    texture: the print's file; style, rows, cols: its cell style and number of slices down and across.
    meta: what was simulated.
    """

    name: str
    path: Path
    lattice: Float[np.ndarray, "n n 2"]
    xyz: Float[np.ndarray, "n n 3"] | None
    texture: Path
    style: str
    rows: int
    cols: int
    meta: dict[str, Any]

    def read(self) -> UInt8[np.ndarray, "h w 3"]:
        """The photo itself."""
        return read_photo(self.path)

    def read_print(self) -> Float[np.ndarray, "h w"]:
        """The print as it was sent to the film: display grey in [0, 1]."""
        return read_photo(self.texture)[..., 0].astype(np.float32) / 255

    @cached_property
    def backward(self) -> BackwardMap:
        """The true map: a cubic spline through the lattice."""
        return BackwardMap(self.lattice)


def load_photos(folder: Path) -> list[TruePhoto]:
    """All photos with truth in a folder, by name; DataError if there are none or one is incomplete."""
    truths = sorted(folder.glob("*.npz"))
    if not truths:
        do = "Name a folder that holds NAME.jpg, NAME.npz with the true lattice, and textures/."
        raise DataError(describe(what="No photos with truth", where=folder, got="no .npz file", do=do))
    return [load_photo(path) for path in truths]


def load_photo(truth: Path) -> TruePhoto:
    """One photo with truth, by the path of its .npz file."""
    try:
        with np.load(truth, allow_pickle=False) as data:
            lattice = data["lattice"].astype(np.float64)
            xyz = data["xyz"].astype(np.float64) if "xyz" in data else None
            texture = truth.parent / "textures" / str(data["texture"])
            meta = json.loads(str(data["meta"]))
    except NPZ_ERRORS as error:
        do = "Copy the file again, or leave it out."
        raise DataError(describe(what="Truth cannot be read", where=truth, got=f"'{error}'", do=do)) from error
    parts = TEXTURE_NAME.search(texture.name)
    path = truth.with_suffix(".jpg")
    for needed in (path, texture):
        if not needed.exists():
            raise DataError(describe(what="Photo is incomplete", where=needed, got="no such file", do="Add it."))
    if parts is None:
        allowed = "..._ROWSxCOLS_STYLE_mMARGIN.png"
        raise DataError(
            describe(what="Print's name", where=texture, got=texture.name, allowed=allowed, do="Rename it.")
        )
    return TruePhoto(
        truth.stem, path, lattice, xyz, texture, parts["style"], int(parts["rows"]), int(parts["cols"]), meta
    )


__all__ = ["TruePhoto", "load_photo", "load_photos"]
