"""CT volumes: the record, the readers of ``.npz``, NIfTI and DICOM folders, and slices in other planes."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from jaxtyping import Float, Int16

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

BODY_WIDTH_MM = 235.0
"""No head is as wide as this, ears and blur included; no adult's trunk is narrower."""

THICKER_THAN_TABLES_MM = 36.0
"""A table is about 20 mm thick; the walls of a chest, front and back together, are more than this."""


DENSER_THAN_AIR_HU = -300

PATIENT_SHARE = 0.25
"""A slice with less tissue than this share of the fullest one's misses the patient or just touches them."""

LEAST_SPAN_HU = 300
"""Fat and soft tissue alone, with blur and noise, lie further apart; the values of masks and empty images do not."""

NIFTI_SUFFIXES = (".nii", ".nii.gz")

Plane = Literal["axial", "coronal", "sagittal"]
"""How the slices of a volume lie in the patient."""


@dataclass(frozen=True, eq=False)
class CtVolume:
    """A CT series.

    hu: (slices, rows, cols) Hounsfield units; slice 0 is caudal, row 0 anterior, column 0 the patient's right. For
        other planes see ``reformatted``.
    spacing_mm: (z, y, x) distances between voxel centres, along hu's axes, all positive.
    name: for messages and to choose by; that of the file, if it has one.
    label: what data sets call it, since a file's name may be a patient's; by default the name.
    plane: of the slices.
    """

    hu: Int16[np.ndarray, "slices rows cols"]
    spacing_mm: tuple[float, float, float]
    name: str
    label: str = ""
    plane: Plane = "axial"

    def __post_init__(self) -> None:
        if self.hu.ndim != 3 or self.hu.dtype != np.int16 or min(self.hu.shape) < 1:
            got = f"shape {self.hu.shape}, {self.hu.dtype}"
            raise DataError(
                describe(
                    what="CT volume",
                    where=self.name,
                    got=got,
                    allowed="(slices, rows, cols) int16, none of them 0",
                    do="Check the file's 'hu' array",
                )
            )
        z, y, x = (float(s) for s in self.spacing_mm)
        if not all(np.isfinite(s) and s > 0 for s in (z, y, x)):
            raise DataError(
                describe(
                    what="CT volume spacing",
                    where=self.name,
                    got=(z, y, x),
                    allowed="three positive lengths in mm (z, y, x)",
                    do="Check the file's 'spacing_mm'",
                )
            )
        object.__setattr__(self, "spacing_mm", (z, y, x))
        object.__setattr__(self, "label", self.label or self.name)


_AXES: dict[Plane, tuple[int, int, int]] = {"axial": (0, 1, 2), "coronal": (1, 0, 2), "sagittal": (2, 0, 1)}
"""Which axes of an axial volume (up, back, left) are the slices, rows and columns of each plane."""


def reformatted(volume: CtVolume, plane: Plane) -> CtVolume:
    """An axial volume cut in another plane, the head at the top. Coronal: slice 0 anterior, column 0 the patient's
    right; sagittal: slice 0 the patient's right, column 0 anterior."""
    if plane == volume.plane:
        return volume
    axes = _AXES[plane]
    hu = np.ascontiguousarray(volume.hu.transpose(axes)[:, ::-1])
    down, across = volume.spacing_mm[axes[1]], volume.spacing_mm[axes[2]]
    return replace(volume, hu=hu, spacing_mm=(volume.spacing_mm[axes[0]], down, across), plane=plane)


def within_patient(volume: CtVolume) -> CtVolume:
    """The longest run of slices that show a good part of the patient, without those of only air or table."""
    shown = (volume.hu[:, ::4, ::4] > DENSER_THAN_AIR_HU).mean(axis=(1, 2))
    turns = np.flatnonzero(np.diff(np.pad(shown >= PATIENT_SHARE * shown.max(), 1)))
    first, last = turns.reshape(-1, 2)[np.argmax(np.diff(turns)[::2])]
    return replace(volume, hu=volume.hu[first:last])


def tissue_width_mm(volume: CtVolume) -> float:
    """Median over axial slices of the width in mm of what is denser than fat, mostly without tables and clothes."""
    (height, depth, width), steps = np.argsort(_AXES[volume.plane]), [1, 1, 1]
    steps[height], steps[depth], steps[width] = max(1, volume.hu.shape[height] // 12), 4, 4
    rough = volume.hu[tuple(slice(None, None, step) for step in steps)].transpose(height, depth, width)
    tissue = (rough > -150).sum(axis=1) * 4 * volume.spacing_mm[depth] >= THICKER_THAN_TABLES_MM
    widths = [float(np.ptp(np.flatnonzero(row))) if row.any() else 0.0 for row in tissue]
    return float(np.median(widths)) * 4 * volume.spacing_mm[width]


def is_body(volume: CtVolume) -> bool:
    """True if the volume is as wide as a trunk, False for a head or a limb."""
    return tissue_width_mm(volume) > BODY_WIDTH_MM


def not_ct(hu: np.ndarray) -> str:
    """Why these values show no scanned body in Hounsfield units; empty if they may."""
    low, high = float(hu.min()), float(hu.max())
    if high - low < LEAST_SPAN_HU:
        return f"values from {low:g} to {high:g}: a mask or an empty image, not Hounsfield units"
    return ""


def resample_slices(
    hu: Int16[np.ndarray, "slices rows cols"], positions: Float[np.ndarray, " n"]
) -> Int16[np.ndarray, "n rows cols"]:
    """Slices at fractional positions (0 is the first), interpolated linearly between their two neighbours."""
    lower = np.clip(np.floor(positions).astype(int), 0, max(len(hu) - 2, 0))
    share = (positions - lower).astype(np.float32)[:, None, None]
    upper = np.minimum(lower + 1, len(hu) - 1)
    return np.rint(hu[lower] * (1 - share) + hu[upper] * share).astype(np.int16)


def as_hounsfield(values: np.ndarray) -> Int16[np.ndarray, "*shape"]:
    """Numbers of any type as int16; NaN becomes air."""
    if values.dtype == np.int16:
        return values
    return np.clip(np.rint(np.nan_to_num(values, nan=-1024.0)), -32768, 32767).astype(np.int16)


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
