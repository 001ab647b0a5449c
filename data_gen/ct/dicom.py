"""CT volumes from DICOM folders, zips and files, separated by series; unusable data is refused with a reason."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from data_gen.ct.dicom_frame import Frame, RefusedError, read_frames
from data_gen.ct.volumes import CtVolume, not_ct, resample_slices
from hybrid.errors import DataError, describe

MAX_FILE_BYTES = 2**30
"""No CT file is larger; a zip entry that claims more is not unpacked."""

TOO_LARGE = f"larger than {MAX_FILE_BYTES >> 20} MiB"

SAME_PLACE_MM = 1e-3
SKIPPED_NAMES = {"dicomdir", ".ds_store", "thumbs.db"}
OTHER_SUFFIXES = {".npz", ".nii", ".gz", ".json", ".txt", ".md", ".csv"}

EVEN_SHARE = 0.1
"""Slice distances within this share of their median count as even (headers round, couches slip)."""

LARGEST_GAP = 2.5
"""Gaps of up to this many slice distances are bridged; across wider ones a mixture of two slices would show neither."""


@dataclass(frozen=True)
class Refusal:
    """A file, or a slice of it, that was left out, and why."""

    source: str
    reason: str

    def __str__(self) -> str:
        return f"{self.source}: left out, {self.reason}"


@dataclass(frozen=True, eq=False)
class DicomReading:
    """All volumes found, the largest first, everything that was left out, and what was done to uneven series."""

    volumes: tuple[CtVolume, ...]
    refusals: tuple[Refusal, ...]
    notes: tuple[str, ...] = ()


def read_all(path: Path | str) -> DicomReading:
    """Every axial CT series in a folder (with its folders and zips), a zip or a file; no error if there is none.

    Raises DataError only if ``path`` does not exist.
    """
    path = Path(path)
    if not path.exists():
        raise DataError(describe(what="DICOM data", where=path, got="no such file or folder", do="Check the path"))
    frames: dict[tuple[object, ...], list[tuple[str, Frame]]] = {}
    refusals: list[Refusal] = []
    for source, container, content in _files(path, refusals):
        try:
            for frame in read_frames(content):
                frames.setdefault((container, *frame.series), []).append((source, frame))
        except RefusedError as error:
            refusals.append(Refusal(source, str(error)))
    notes: list[str] = []
    volumes = [volume for group in frames.values() for volume in _stacks(group, refusals, notes)]
    volumes.sort(key=lambda volume: -len(volume.hu))
    return DicomReading(tuple(volumes), tuple(refusals), tuple(notes))


def _files(path: Path, refusals: list[Refusal]) -> Iterator[tuple[str, str, bytes]]:
    """(name for messages, container, bytes) of everything that might be DICOM."""
    paths = [p for p in sorted(path.rglob("*")) if p.is_file()] if path.is_dir() else [path]
    for file in paths:
        if path.is_dir() and (file.name.lower() in SKIPPED_NAMES or file.suffix.lower() in OTHER_SUFFIXES):
            continue
        if file.suffix.lower() == ".zip":
            yield from _zip_entries(file, refusals)
            continue
        try:
            too_large = file.stat().st_size > MAX_FILE_BYTES
            content = b"" if too_large else file.read_bytes()
        except OSError as error:
            refusals.append(Refusal(str(file), f"cannot be read ({type(error).__name__})"))
            continue
        if too_large:
            refusals.append(Refusal(str(file), TOO_LARGE))
        else:
            yield str(file), "", content


def _zip_entries(path: Path, refusals: list[Refusal]) -> Iterator[tuple[str, str, bytes]]:
    try:
        archive = zipfile.ZipFile(path)
    except (OSError, zipfile.BadZipFile):
        refusals.append(Refusal(str(path), "a damaged zip"))
        return
    with archive:
        for entry in archive.infolist():
            name = f"{path}/{entry.filename}"
            if entry.is_dir() or Path(entry.filename).name.lower() in SKIPPED_NAMES:
                continue
            if entry.file_size > MAX_FILE_BYTES:
                refusals.append(Refusal(name, TOO_LARGE))
                continue
            try:
                content = archive.read(entry)
            except Exception as error:  # zlib, encryption and unknown methods each raise their own kind
                refusals.append(Refusal(name, f"cannot be unpacked ({type(error).__name__})"))
                continue
            yield name, str(path), content


def _stacks(group: list[tuple[str, Frame]], refusals: list[Refusal], notes: list[str]) -> list[CtVolume]:
    """The frames of one series, in order from below, as evenly spaced volumes: one, or more if it has wide gaps.

    A second slice at the same place is left out, and so is any volume that does not hold Hounsfield units.
    """
    ordered = sorted(group, key=lambda item: item[1].height_mm)
    kept = [ordered[0]]
    for source, frame in ordered[1:]:
        if frame.height_mm - kept[-1][1].height_mm < SAME_PLACE_MM:
            refusals.append(Refusal(source, "a second slice at the same position"))
        else:
            kept.append((source, frame))
    steps = np.diff([frame.height_mm for _, frame in kept])
    wide = np.flatnonzero(steps > LARGEST_GAP * np.median(steps)) + 1 if len(steps) else []
    name = f"dicom_{kept[0][1].series[0]}"
    if len(wide):
        notes.append(f"{name}: {len(wide)} gap(s) of more than {LARGEST_GAP:g} slice distances, cut there")
    volumes = []
    for first, last in pairwise([0, *wide, len(kept)]):
        volume = _even_volume([frame for _, frame in kept[first:last]], name, notes)
        reason = not_ct(volume.hu)
        if reason:
            refusals.append(Refusal(kept[first][0], reason))
        else:
            volumes.append(volume)
    return volumes


def _even_volume(frames: list[Frame], name: str, notes: list[str]) -> CtVolume:
    """Sorted frames as a volume; uneven distances are resampled to their median, linearly between neighbours."""
    heights = np.array([frame.height_mm for frame in frames])
    hu, steps = np.stack([frame.hu for frame in frames]), np.diff(heights)
    step_mm = float(np.median(steps)) if len(steps) else (frames[0].thickness_mm or 1.0)
    if len(steps) and np.abs(steps - step_mm).max() > EVEN_SHARE * step_mm:
        notes.append(
            f"{name}: slice distances from {steps.min():.3g} to {steps.max():.3g} mm, resampled at {step_mm:.3g} mm"
        )
        wanted = np.arange(heights[0], heights[-1] + 0.5 * step_mm, step_mm).clip(max=heights[-1])
        hu = resample_slices(hu, np.interp(wanted, heights, np.arange(len(heights), dtype=np.float64)))
    return CtVolume(hu, (step_mm, *frames[0].spacing_mm), name)


__all__ = ["DicomReading", "Refusal", "read_all"]
