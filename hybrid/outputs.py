"""What a result leaves in its folder: film, rectified photo, slices, side-by-side picture, a small JSON."""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import UInt8

from hybrid import __version__
from hybrid.coords import film_nodes
from hybrid.draw import annotated, rgb_from_film, side_by_side
from hybrid.errors import ConfigError, describe
from hybrid.files import make_folder, write_bytes
from hybrid.image_io import read_photo, write_film, write_grey, write_rgb
from hybrid.records import RectifyResult

RectifiedFormat = Literal["jpg", "png"]

# ---------------------------------------------------------------- names

SLICES_SUFFIX, DICOM_SUFFIX = "_slices", "_dicom"
FOLDERS = (SLICES_SUFFIX, DICOM_SUFFIX)
PICTURES = (
    *("_film.png", "_confidence.png", "_rectified.jpg", "_rectified.png", "_side_by_side.jpg"),
    *FOLDERS,
)
"""Suffixes, after NAME, of what is written beside NAME.json."""
_NUMBERED = re.compile(r"\d{2,}\.(png|dcm)|film\.dcm")
"""Names of the files in these folders."""
UNFINISHED = "UNFINISHED"
"""Status of a result whose files are still being written, or were never finished."""
FUSED_SUFFIX = "_fused"
"""Follows the first photo's name in the name of a film made of several."""


def reserved(out: Path, stem: str, about: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """The stem, numbered if it is taken, and what is known of it from an earlier run over the same photos.

    about: the photos (``photo_record``). A name is theirs if its JSON names the same photos, whichever of them its film
    is made of; it is free if nothing of that name exists. A JSON is written at once and says that the rest is
    unfinished, so that no other run takes the name, nor a later one if this run is cut off.
    """
    number = 1
    while True:
        name = stem if number == 1 else f"{stem}_{number}"
        record, number = out / f"{name}.json", number + 1
        if record.exists():
            known = _read_record(record)
            if _photos_in(known) == _photos_in(about):
                if known.get("status") == UNFINISHED:  # its JSON does not list what it wrote
                    known = {"earlier_files": sorted({*_files_in(known), *_files_of(out, name)})}
                write_bytes(record, _json_bytes(_unfinished(about, known)))
                return name, known
            continue
        if any((out / f"{name}{suffix}").exists() for suffix in PICTURES):
            continue
        try:
            with record.open("xb") as file:
                file.write(_json_bytes(_unfinished(about, {})))
        except FileExistsError:  # another run was faster
            continue
        return name, {}


def is_result(path: Path) -> bool:
    """Whether an earlier run wrote this file: the JSON beside it (for a slice, beside its folder) names it, or is of a
    run that was cut off or is still going on."""
    path = path.absolute()
    records = [
        at.with_name(f"{at.name.removesuffix(suffix)}.json")
        for at in (path, path.parent)
        for suffix in PICTURES
        if at.name.endswith(suffix)
    ]
    known = [(record.parent, _read_record(record)) for record in records]
    return any(
        one.get("status") == UNFINISHED or path.relative_to(folder).as_posix() in _files_in(one)
        for folder, one in known
    )


def _unfinished(about: dict[str, Any], known: dict[str, Any]) -> dict[str, Any]:
    return {
        "hybrid_version": __version__,
        **about,
        "ok": False,
        "status": UNFINISHED,
        "earlier_files": _files_in(known),
    }


def _files_in(record: dict[str, Any]) -> list[str]:
    """All files that a record names, relative to its folder."""
    named = [record.get(key) for key in ("files", "earlier_files")]
    return [file for files in named if isinstance(files, list) for file in files if isinstance(file, str)]


def _files_of(out: Path, name: str) -> list[str]:
    """All files in the folder that are named like those of a result of that name, relative to the folder."""
    at = [out / f"{name}{suffix}" for suffix in PICTURES]
    numbered = [file for folder in at if folder.is_dir() for file in folder.iterdir() if _NUMBERED.fullmatch(file.name)]
    return [file.relative_to(out).as_posix() for file in (*at, *numbered) if file.is_file()]


def _json_bytes(record: dict[str, Any]) -> bytes:
    return (json.dumps(record, indent=2, allow_nan=False) + "\n").encode()


def photo_record(photos: Sequence[Path], left_out: Sequence[Path] = ()) -> dict[str, Any]:
    """What distinguishes the photos of a film, and those left out of it, from others of the same name."""
    first, *further = photos
    about: dict[str, Any] = {"photo": first.name, "photo_sha256": photo_digest(first)}
    for key, those in (("further_photos", further), ("left_out", left_out)):
        if those:
            about[key] = [photo.name for photo in those]
            about[f"{key}_sha256"] = [photo_digest(photo) for photo in those]
    return about


def _photos_in(record: dict[str, Any]) -> list[str]:
    """All photos that a record names, sorted, each with what distinguishes it from others of the same name."""
    pairs: list[Any] = []
    for key in ("photo", "further_photos", "left_out"):
        of_key = (record.get(key, []), record.get(f"{key}_sha256", []))
        names, digests = (each if isinstance(each, list) else [each] for each in of_key)
        pairs += zip(names, digests, strict=False)  # the JSON may be anybody's
    return sorted(map(repr, pairs))


def photo_digest(photo: Path) -> str:
    """SHA-256 of the photo's bytes: what tells two photos of one name apart."""
    with photo.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _read_record(record: Path) -> dict[str, Any]:
    """The JSON that an earlier run left; empty if there is none, or if it is not one of ours."""
    try:
        found = json.loads(record.read_text())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


# ---------------------------------------------------------------- files


def write_result(
    out: Path,
    paths: Sequence[Path],
    photo: UInt8[np.ndarray, "h w 3"],
    result: RectifyResult,
    rectified_format: RectifiedFormat,
    made: Mapping[str, Any] | None = None,
    dicom: bool = False,
) -> tuple[Path, ...]:
    """Write everything that the result holds, named after the first photo; the JSON says when the rest is complete.

    paths: the photos that were given for it; ``photo`` is the one of ``result.photo``. made: how it was made, for the
    JSON. dicom: whether film and slices are also written as DICOM. Files of other photos are left alone. Files that an
    earlier run over the same photos left and this one does not make (slices of another grid) are removed once the new
    ones exist. They stay if this run finds no film, as DICOM files do if none are asked for, and the JSON names them
    ("earlier_files").
    """
    used = result.made_of(paths)
    about = photo_record(used, [paths[one.photo] for one in result.left_out])
    name, known = reserved(out, f"{paths[0].stem}{FUSED_SUFFIX if len(paths) > 1 else ''}", about)
    files: list[Path] = []
    if result.film is not None:
        files.append(out / f"{name}_film.png")
        write_film(files[-1], result.film)
        files += write_slices(out / f"{name}{SLICES_SUFFIX}", result)
    if result.confidence is not None:
        files.append(out / f"{name}_confidence.png")
        write_grey(files[-1], result.confidence)
    if result.rectified is not None:
        files.append(out / f"{name}_rectified.{rectified_format}")
        write_rgb(files[-1], result.rectified)
    if result.film is not None:
        files.append(out / f"{name}_side_by_side.jpg")
        write_rgb(files[-1], side_by_side([annotated(photo, result), rgb_from_film(result.film)]))
        if dicom:
            digests = [about["photo_sha256"], *about.get("further_photos_sha256", [])]
            digest = digests[used.index(paths[result.photo])]
            files += _write_dicom(out / f"{name}{DICOM_SUFFIX}", used, digest, result)
    of = {"map_of": paths[result.photo].name} if len(paths) > 1 else {}
    record = {"hybrid_version": __version__, **(made or {}), **about, **of, **result_record(photo.shape[:2], result)}
    record["files"] = [file.relative_to(out).as_posix() for file in files]
    exported = () if dicom else tuple(f for f in _files_in(known) if f.startswith(f"{name}{DICOM_SUFFIX}/"))
    kept = exported if result.status.has_film else _files_in(known)
    if kept:
        record["earlier_files"] = list(kept)
    files.append(out / f"{name}.json")
    write_bytes(files[-1], _json_bytes(record))
    ours = set(_files_in(known)) & set(_files_of(out, name))  # a JSON may name anything
    for left_over in {out / file for file in ours.difference(kept)} - set(files):
        left_over.unlink(missing_ok=True)
    return tuple(files)


def save_result(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    result: RectifyResult,
    out: str | os.PathLike[str],
    rectified_format: RectifiedFormat = "jpg",
    dicom: bool = False,
) -> tuple[Path, ...]:
    """Write what ``hybrid rectify`` (for a fused film, ``hybrid fuse``) writes into a folder; returns the files.

    Args:
        path: the photo that the result is of; for a fused film, all of its photos.
        result: what ``rectify`` or a ``Rectifier`` returned; without a film, only the JSON is written, which says why.
        out: created if needed; results of the same photo in it are replaced, other photos of its name get a number.
        rectified_format: format of the rectified photo.
        dicom: whether film and slices are also written as DICOM (``hybrid.dicom``).

    Raises:
        PhotoError: the photo cannot be read. ConfigError: nothing can be written there, photos are missing or are not
            paths, or it is a different photo (of another size).
    """
    if rectified_format not in get_args(RectifiedFormat):
        allowed = " or ".join(get_args(RectifiedFormat))
        raise ConfigError(
            describe(what="rectified_format", got=repr(rectified_format), allowed=allowed, do="Name one.")
        )
    try:
        paths = [Path(one) for one in ([path] if isinstance(path, (str, os.PathLike)) else path)]
    except TypeError:
        got, do = f"a {type(path).__name__}", "Name the photo's file: it is read for the picture beside the film."
        raise ConfigError(describe(what="Photo to save", got=got, allowed="a path, or several", do=do)) from None
    folder = Path(out)
    if len(paths) != result.photos:
        do = "Name the photo that it was made of, or all that were fused, in their order."
        raise ConfigError(describe(what="Photos of a film", got=len(paths), allowed=str(result.photos), do=do))
    photo = read_photo(paths[result.photo])
    result.of_photo(photo.shape, paths[result.photo])
    make_folder(folder, "the argument out")
    return write_result(folder, paths, photo, result, rectified_format, dicom=dicom)


def write_slices(folder: Path, result: RectifyResult) -> list[Path]:
    """Write the slices as 16-bit PNGs numbered row by row from 01."""
    slices = [cell for cell in result.slices() if cell.size]
    if slices:
        folder.mkdir(exist_ok=True)
    files = [folder / f"{number:02d}.png" for number in range(1, len(slices) + 1)]
    for file, cell in zip(files, slices, strict=True):
        write_film(file, cell)
    return files


def _write_dicom(folder: Path, paths: Sequence[Path], digest: str, result: RectifyResult) -> list[Path]:
    """Write the film as film.dcm and the slices as 01.dcm and so on. paths: the photos that the film is made of.
    digest: that of the map's photo."""
    from hybrid.dicom import PhotoFile, secondary_captures  # imports pydicom, which few need

    folder.mkdir(exist_ok=True)
    files = []
    for number, capture in enumerate(secondary_captures(result, PhotoFile.of(paths, digest))):
        files.append(folder / (f"{number:02d}.dcm" if number else "film.dcm"))
        data = io.BytesIO()
        capture.save_as(data, enforce_file_format=True)
        write_bytes(files[-1], data.getvalue())
    return files


def result_record(photo_size: tuple[int, ...], result: RectifyResult) -> dict[str, Any]:
    """The result in words and numbers, without the pictures: what goes into the JSON file, besides the photo's name."""
    grid = result.grid
    return {
        "photo_size": list(photo_size[:2]),
        "corners_photo": None
        if result.backward is None
        else np.round(result.backward.photo_from_film(film_nodes((2, 2))), 3).reshape(4, 2).tolist(),
        "ok": result.status.ok,
        "status": result.status.code.name,
        "message": str(result.status),
        "doubts": list(result.status.doubts),
        "expected_error_px": _rounded(result.expected_error_px, 2),
        "limit_px": _rounded(result.limit_px, 2),
        "film_size": None if result.film is None else list(result.film.shape),
        "orientation": None
        if result.orientation is None
        else {
            "quarter_turns_clockwise": result.orientation.turns,
            "mirrored_first": result.orientation.mirrored,
            "upright_probability": _rounded(result.upright_probability),
        },
        "glare_share": None if result.glare is None else round(float(result.glare.mean()), 5),
        "covered_share": None if result.covered is None else round(float(result.covered.mean()), 5),
        "confidence": None if result.confidence is None else round(float(result.confidence.mean()), 4),
        "grid": None
        if grid is None
        else {
            "rows": grid.rows,
            "cols": grid.cols,
            "confidence": round(grid.confidence, 4),
            "vertices_film": np.round(grid.vertices, 6).tolist(),
            "vertices_photo": np.round(grid.vertices_photo, 3).tolist(),
        },
        "stages": [
            {"name": s.name, "ran": s.ran, "reason": s.reason, "seconds": round(s.seconds, 5)} for s in result.stages
        ],
    }


def _rounded(value: float | None, digits: int = 4) -> float | None:
    return None if value is None else round(value, digits)


__all__ = [
    "FOLDERS",
    "RectifiedFormat",
    "is_result",
    "photo_digest",
    "result_record",
    "save_result",
    "write_result",
    "write_slices",
]
