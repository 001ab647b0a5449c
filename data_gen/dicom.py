"""CT volumes out of DICOM: folders, zips and files, series apart, everything unusable refused with a reason."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_gen._dicom_frame import Frame, RefusedError, read_frames
from data_gen.volumes import CtVolume
from hybrid.errors import DataError, describe

MAX_FILE_BYTES = 2**30
"""No CT file is larger; a zip entry that claims more is not unpacked."""

TOO_LARGE = f"larger than {MAX_FILE_BYTES >> 20} MiB"

SAME_PLACE_MM = 1e-3
SKIPPED_NAMES = {"dicomdir", ".ds_store", "thumbs.db"}
OTHER_SUFFIXES = {".npz", ".json", ".txt", ".md", ".csv"}


@dataclass(frozen=True)
class Refusal:
    """A file, or a slice of it, that was left out, and why."""

    source: str
    reason: str

    def __str__(self) -> str:
        return f"{self.source}: left out, {self.reason}"


@dataclass(frozen=True, eq=False)
class DicomReading:
    """All volumes found, the largest first, and everything that was left out."""

    volumes: tuple[CtVolume, ...]
    refusals: tuple[Refusal, ...]


def read_all(path: Path | str) -> DicomReading:
    """Every axial CT series in a folder (with its folders and zips), a zip or a file; no error where there is none.

    Raises DataError only where ``path`` does not exist.
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
    volumes = [_stack(group, refusals) for group in frames.values()]
    volumes.sort(key=lambda volume: -len(volume.hu))
    return DicomReading(tuple(volumes), tuple(refusals))


def read_series(path: Path | str) -> list[CtVolume]:
    """The axial CT series in a folder, a zip or a file, the one with most slices first.

    Raises DataError where there is none, with the reasons why the files were left out.
    """
    reading = read_all(path)
    if not reading.volumes:
        reasons = "; ".join(str(refusal) for refusal in reading.refusals[:3]) or "no files"
        more = f"; and {len(reading.refusals) - 3} more" if len(reading.refusals) > 3 else ""
        raise DataError(
            describe(
                what="DICOM data",
                where=path,
                got=f"no axial CT slice ({reasons}{more})",
                allowed="CT images, axial",
                do="Export the axial CT series, uncompressed if decoders are missing",
            )
        )
    return list(reading.volumes)


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


def _stack(group: list[tuple[str, Frame]], refusals: list[Refusal]) -> CtVolume:
    """Frames of one series in order from below; a second slice at the same place is left out."""
    ordered = sorted(group, key=lambda item: item[1].height_mm)
    kept = [ordered[0][1]]
    for source, frame in ordered[1:]:
        if frame.height_mm - kept[-1].height_mm < SAME_PLACE_MM:
            refusals.append(Refusal(source, "a second slice at the same position"))
        else:
            kept.append(frame)
    first = kept[0]
    steps = np.diff([frame.height_mm for frame in kept])
    step_mm = float(np.median(steps)) if len(steps) else (first.thickness_mm or 1.0)
    return CtVolume(np.stack([frame.hu for frame in kept]), (step_mm, *first.spacing_mm), f"dicom_{first.series[0]}")


__all__ = ["DicomReading", "Refusal", "read_all", "read_series"]
