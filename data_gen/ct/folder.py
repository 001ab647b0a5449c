"""A folder of CT volumes: ``.npz`` and NIfTI files, DICOM folders and zips, and what is left out of it and why."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from data_gen.ct.volumes import CtVolume, as_hounsfield
from hybrid.errors import NPZ_ERRORS, DataError, describe, install_extra

Found = TypeVar("Found")

LOG = logging.getLogger(__name__)
"""Reports each file that is left out, and what was done to uneven series."""

LEFT_OUT = logging.getLogger(f"{__name__}.left_out")
"""Reports in one message what is left out of a folder. If logging is not set up, it goes to stderr: a warning, except
in worker processes, each of which reads the same folder."""

MOST_TOLD = 5
"""At most this many are reported with the reason, the first ones of a folder."""

MIN_PRINT_SLICES = 3
"""A folder may hold single images; a film needs a few slices of the same series."""

NIFTI_SUFFIXES = (".nii", ".nii.gz")


def read_npz(path: Path) -> CtVolume:
    """The volume in a ``.npz`` file with ``hu`` (slices, rows, cols), ``spacing_mm`` (3,) and optional JSON ``meta``.

    Raises DataError if the file cannot be read or lacks an array.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            hu = np.asarray(data["hu"])
            z, y, x = (float(s) for s in data["spacing_mm"].ravel())
            meta = json.loads(str(data["meta"])) if "meta" in data.files else {}
    except NPZ_ERRORS as error:
        raise DataError(
            describe(
                what="CT file",
                where=path,
                got=f"{type(error).__name__}: {error}",
                allowed="an .npz with 'hu' int16 (slices, rows, cols) and 'spacing_mm' (z, y, x)",
                do="Export the volume again or take the file out of the folder",
            )
        ) from error
    numbers = np.issubdtype(hu.dtype, np.integer) or np.issubdtype(hu.dtype, np.floating)
    if hu.ndim != 3 or not numbers:
        raise DataError(
            describe(
                what="CT file",
                where=path,
                got=f"'hu' of shape {hu.shape}, {hu.dtype}",
                allowed="numbers of shape (slices, rows, cols)",
                do="Export the volume again",
            )
        )
    name = meta.get("name", path.stem) if isinstance(meta, dict) else path.stem
    label = f"npz_{hashlib.sha256(str(name).encode()).hexdigest()[:8]}"
    return CtVolume(as_hounsfield(hu), (z, y, x), str(name), label)


def load_volumes(folder: Path | str) -> list[CtVolume]:
    """Every volume under ``folder``: ``.npz`` and NIfTI files, DICOM folders and zips of DICOM files, in sorted order.

    NIfTI files and contents of DICOM folders that are no CT, and volumes with too few slices, are reported with the
    reason (``LEFT_OUT``). Raises DataError if the folder is missing, an ``.npz`` is damaged, the reader's package is
    not installed, or nothing is found.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise DataError(
            describe(what="CT folder", where=folder, got="no such folder", do="Give a folder with CT volumes in it")
        )
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    refusals: list[str] = []
    found = [read_npz(path) for path in files if path.suffix.lower() == ".npz"]
    found += _read_nifti([path for path in files if path.name.lower().endswith(NIFTI_SUFFIXES)], refusals)
    if any(path.suffix.lower() == ".zip" or _looks_like_dicom(path) for path in files):
        found += _read_dicom(folder, refusals)
    volumes = [volume for volume in found if len(volume.hu) >= MIN_PRINT_SLICES]
    few = f"fewer than {MIN_PRINT_SLICES} slices"
    refusals += [f"{volume.name}: {few}" for volume in found if len(volume.hu) < MIN_PRINT_SLICES]
    if not volumes:
        nothing = f"{len(files)} files, no volume of {MIN_PRINT_SLICES} or more axial CT slices"
        raise DataError(
            describe(
                what="CT folder",
                where=folder,
                got="\n  ".join([nothing, *_first(refusals)]),
                allowed=".npz or NIfTI volumes, DICOM folders, zips of DICOM files",
                do="Check the path, or leave the option out to use the built-in phantoms",
            )
        )
    _tell_left_out(folder, refusals)
    return volumes


def _looks_like_dicom(path: Path) -> bool:
    if path.suffix.lower() in {".dcm", ".ima"}:
        return True
    with path.open("rb") as file:
        return file.read(132)[128:] == b"DICM"


def _tell_left_out(folder: Path, refusals: list[str]) -> None:
    """Say how many sources of a folder are left out, and why."""
    for refusal in refusals:
        LOG.info("left out: %s", refusal)
    if refusals:
        told = f"{len(refusals)} of the CT sources in {folder} {'is' if len(refusals) == 1 else 'are'} left out:"
        level = logging.WARNING if parent_process() is None else logging.INFO
        LEFT_OUT.log(level, "%s", "\n  ".join([told, *_first(refusals)]))


def _first(refusals: list[str]) -> list[str]:
    """All of them, or the first ones and how many more."""
    more = len(refusals) - MOST_TOLD
    return [*refusals[:MOST_TOLD], *([f"and {more} more"] if more > 0 else [])]


def with_left_out(task: Callable[..., Found], *arguments: Any) -> tuple[Found, list[str]]:
    """The result of a task, and what it would report as left out of the folders that it reads: itself a task, for
    workers, whose stderr nobody may see."""
    with _heard() as told:
        return task(*arguments), told


@contextmanager
def _heard() -> Iterator[list[str]]:
    """Catch the messages on what is left out that are logged within; they go nowhere else."""
    told: list[str] = []
    handler, before = logging.Handler(), (LEFT_OUT.level, LEFT_OUT.propagate)
    handler.emit = lambda record: told.append(record.getMessage())  # type: ignore[method-assign]
    LEFT_OUT.addHandler(handler)
    LEFT_OUT.setLevel(logging.INFO)
    LEFT_OUT.propagate = False
    try:
        yield told
    finally:
        LEFT_OUT.removeHandler(handler)
        LEFT_OUT.setLevel(before[0])
        LEFT_OUT.propagate = before[1]


def _read_nifti(paths: list[Path], refusals: list[str]) -> list[CtVolume]:
    if not paths:
        return []
    try:
        from data_gen.ct.nifti import NotCtError, read_nifti
    except ModuleNotFoundError as error:
        raise _not_installed("NIfTI data", paths[0], "nibabel") from error
    volumes = []
    for path in paths:
        try:
            volumes.append(read_nifti(path))
        except NotCtError as refusal:  # segmentations lie beside the CT they belong to
            refusals.append(str(refusal))
    return volumes


def _read_dicom(source: Path, refusals: list[str]) -> list[CtVolume]:
    try:
        from data_gen.ct.dicom import read_all
    except ModuleNotFoundError as error:
        raise _not_installed("DICOM data", source, "pydicom") from error
    reading = read_all(source)
    refusals += [f"{refusal.source}: {refusal.reason}" for refusal in reading.refusals]
    for note in reading.notes:
        LOG.info("%s", note)
    return list(reading.volumes)


def _not_installed(what: str, source: Path, package: str) -> DataError:
    got = f"{package} is not installed"
    return DataError(describe(what=what, where=source, got=got, do=install_extra("data")))
