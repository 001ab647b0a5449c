"""``hybrid rectify`` over many photos: each is rectified and written, and what a person should know is reported."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from tqdm import tqdm

from hybrid.camera import told_focal
from hybrid.errors import HybridError, told
from hybrid.files import make_folder
from hybrid.image_io import pictures_in, read_photo
from hybrid.outputs import FOLDERS, RectifiedFormat, write_result
from hybrid.records import RectifyResult, StageReport
from hybrid.workers import shared_out


@runtime_checkable
class Rectify(Protocol):
    """Rectifies a photo, as Rectifier does. focal: as its file tells it (camera.py)."""

    def __call__(self, source: np.ndarray, /, *, focal: float | None) -> RectifyResult: ...


Say = Callable[[str], Any]


@dataclass(frozen=True)
class Outcome:
    """How one photo ended.

    ok: a film was found and every file is written. unsure: that film may be off.
    message: the status, or the error, as a sentence.
    files: what was written, in order.
    warnings: what a person should look at, one sentence each.
    """

    photo: Path
    ok: bool
    message: str
    files: tuple[Path, ...] = ()
    warnings: tuple[str, ...] = ()
    unsure: bool = False


def rectify_files(
    photos: Sequence[Path],
    out: Path,
    make_rectify: Callable[[], Rectify],
    rectified_format: RectifiedFormat,
    say: Say,
    made: Mapping[str, Any] | None = None,
    verbose: bool = False,
    workers: int = 1,
    dicom: bool = False,
) -> list[Outcome]:
    """Rectify photos into the folder ``out``; a photo that fails is reported, and the next one follows.

    made: what the JSON says of how a film was made. verbose: whether to report each stage, too. workers: processes that
    share the photos. Photos of one name are one task, so that they are numbered in their order. dicom: as in
    write_result.
    """
    make_folder(out)
    named: dict[str, list[Path]] = {}
    for path in photos:
        named.setdefault(path.stem, []).append(path)
    task = partial(_all_rectified, out, rectified_format, made or {}, verbose, dicom)
    outcomes: dict[Path, Outcome] = {}
    with tqdm(total=len(photos), desc="rectify", unit="photo", disable=True if len(photos) < 2 else None) as bar:
        for group, done in zip(
            named.values(), shared_out(task, make_rectify, list(named.values()), workers), strict=True
        ):
            for path, (outcome, lines) in zip(
                group, done if isinstance(done, list) else _lost(group, done), strict=True
            ):
                outcomes[path] = outcome
                say(lines)
                bar.update()
    return [outcomes[path] for path in photos]


def _all_rectified(
    out: Path, rectified_format: RectifiedFormat, made: Mapping[str, Any], verbose: bool, dicom: bool, rectify: Rectify,
    paths: Sequence[Path],
) -> list[tuple[Outcome, str]]:  # fmt: skip
    return [_rectified(path, out, rectify, rectified_format, made, verbose, dicom) for path in paths]


def _lost(paths: Sequence[Path], error: HybridError) -> list[tuple[Outcome, str]]:
    """Outcomes of photos whose worker died, and what is printed about them."""
    return [(Outcome(path, False, str(error)), f"{path}\n  ERROR  {error}") for path in paths]


def _rectified(
    path: Path, out: Path, rectify: Rectify, rectified_format: RectifiedFormat, made: Mapping[str, Any], verbose: bool,
    dicom: bool,
) -> tuple[Outcome, str]:  # fmt: skip
    """How a photo ended, and what is printed about it."""
    try:
        start = time.perf_counter()
        photo = read_photo(path)
        read = StageReport("file", True, f"{path.stat().st_size / 1e6:.1f} MB", time.perf_counter() - start)
        result = rectify(photo, focal=told_focal(path))
        result = replace(result, stages=(read, *result.stages))
        files = write_result(out, [path], photo, result, rectified_format, made=made, dicom=dicom)
        status, warnings = result.status, (*warnings_of(result), *further_pictures([path]))
        outcome = Outcome(path, status.has_film, str(status), files, warnings, status.has_film and not status.ok)
        return outcome, "\n".join(report_lines(path, result, files, warnings, verbose))
    except (HybridError, OSError, MemoryError) as error:
        outcome = Outcome(path, False, told(error, out))
        return outcome, f"{path}\n  ERROR  {outcome.message}"
    except Exception as error:  # a bug in this program must not cost the photos that are still to come
        outcome = Outcome(path, False, f"internal error: {type(error).__name__}: {error}")
        return outcome, f"{path}\n  ERROR  {outcome.message}\n{traceback.format_exc()}"


def report_lines(
    path: Path, result: RectifyResult, files: Iterable[Path], warnings: Iterable[str], verbose: bool = True
) -> list[str]:
    """What is printed for one photo: its status, what to look at, and where the pictures are; with ``verbose``, first a
    line for each stage."""
    seconds = sum(stage.seconds for stage in result.stages)
    lines = [str(path), *(f"  {stage}" for stage in result.stages if verbose)]
    grid = f"{result.grid.rows} x {result.grid.cols} slices" if result.grid is not None else "no grid of slices"
    found = f"{grid}, {seconds:.2f} s" if result.status.has_film else f"{seconds:.2f} s"
    lines.append(f"  {status_word(result)}  {result.status}  ({found})")
    lines += [f"  LOOK  {warning}" for warning in warnings]
    folders = dict.fromkeys(file.parent if file.parent.name.endswith(FOLDERS) else file for file in files)
    return lines + [f"  -> {path}" for path in folders]


TELL_LOST = 0.03
"""Share of the film above which parts lost to glare, or hidden, are reported."""
SURE_UPRIGHT = 0.95
"""A film that reads right with a probability below this is one to look at: of 84 photos turned or mirrored, with small
writing, 2 were not put upright, both of them with less; of 12 that lay right none had less."""


def warnings_of(result: RectifyResult) -> list[str]:
    """What a person should look at: why the film is not sure, and whether it may read wrong."""
    look_at = []
    if result.status.has_film and not result.status.ok:
        look_at.append(": ".join(filter(None, ("It may be off", "; ".join(result.status.doubts)))) + ".")
    if result.upright_probability is not None and result.upright_probability < SURE_UPRIGHT:
        said = "; ".join(stage.reason for stage in result.stages if stage.name == "upright")
        ways = "--upright.turn 90 (or 0, 180, 270, from how it lies in the photo; with --upright.mirror from behind)"
        look_at.append(f"It may lie on its side or mirrored: {said}. {ways} gives it otherwise.")
    for lost, what in ((result.glare, "lost to glare or darkness"), (result.covered, "hidden by something before it")):
        if lost is not None and lost.mean() > TELL_LOST:
            look_at.append(f"{lost.mean():.0%} of it is {what}: black in the picture of its confidence.")
    return look_at


def left_out_photos(paths: Sequence[Path], result: RectifyResult) -> list[str]:
    """Which of the photos to be fused the film is not made of, and why."""
    return [f"{paths[one.photo].name} is left out: {one.why}." for one in result.left_out]


def further_pictures(paths: Sequence[Path]) -> list[str]:
    """Which photos have files with more pictures, which were not read."""
    names = ["It"] if len(paths) == 1 else [path.name for path in paths]
    return [
        f"{name} is the first of {count} pictures in its file."
        for name, path in zip(names, paths, strict=True)
        if (count := pictures_in(path)) > 1
    ]


def status_word(result: RectifyResult) -> str:
    """How a photo ended, in a word."""
    if result.status.ok:
        return "ok"
    return "UNSURE" if result.status.has_film else "FAILED"


__all__ = [
    "Outcome",
    "Rectify",
    "Say",
    "further_pictures",
    "left_out_photos",
    "rectify_files",
    "report_lines",
    "status_word",
    "warnings_of",
]
