"""A thousand films in one process: ``python -m benchmarks.soak --out DIR [--films 1000]``.

Memory must stay flat, the time of a film must not creep up, and a photo must give the same bits whenever it comes. The
test needs one process from first to last, so a run that was cut off starts again.
"""

from __future__ import annotations

import hashlib
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.command import run_command
from benchmarks.machine import describe_run, memory_mib, use_threads
from benchmarks.photos.cases import sample_cases
from benchmarks.photos.own import make_photos
from benchmarks.report.schema import write_record
from benchmarks.report.stress_records import SoakReport
from hybrid.draw import resized
from hybrid.errors import ConfigError, describe, require_at_least
from hybrid.pipeline import Rectifier, RectifyConfig
from hybrid.records import RectifyResult

MEMORY_BOUND = 0.02
"""Largest growth of memory that counts as flat."""

DRIFT_BOUND = 0.25
"""Largest growth of a film's time over the run that counts as steady; variations of a shared machine are smaller."""

LOOKS = 100
"""Number of memory readings over the run."""


@dataclass(frozen=True)
class Options:
    """Rectify many films one after the other."""

    out: Path
    """Folder for soak.json."""

    data: tuple[Path, ...] = ()
    """Data sets whose photos are used; without any, some are made."""

    films: int = 1000
    """How many films."""

    photos: int = 8
    """How many different photos, which take turns."""

    photo_px: int = 360
    """Side that they are scaled to: small, so that a thousand take minutes."""

    threads: int = 2
    """Processor threads that may be used."""

    seed: int = 0
    """Seed of the photos that are made."""

    weights: Path | None = None
    """A FilmNet file in place of the packaged one."""

    def __post_init__(self) -> None:
        if self.films < 20 or not 1 <= self.photos <= self.films // 4 or self.photo_px < 64 or self.threads < 1:
            got = f"--films {self.films} --photos {self.photos} --photo-px {self.photo_px} --threads {self.threads}"
            allowed = "films >= 20, photos from 1 to a quarter of that, photo-px >= 64, threads >= 1"
            raise ConfigError(describe(what="soak", got=got, allowed=allowed, do="Choose others."))
        require_at_least(self, 0, "seed")


def soak(
    rectify: Callable[[np.ndarray], RectifyResult], photos: Sequence[np.ndarray], films: int
) -> tuple[list[float], list[float], int]:
    """Memory (MiB) from a tenth of the films on, processor seconds of each film, and how many results differ."""
    memory, seconds, different = [], [], 0
    first: dict[int, str] = {}
    step = max(films // LOOKS, 1)
    for k in tqdm(range(films), desc="films", unit="film"):
        which = k % len(photos)
        start = time.process_time()
        result = rectify(photos[which])
        seconds.append(time.process_time() - start)
        different += first.setdefault(which, digest(result)) != digest(result)
        if k >= films // 10 and k % step == 0:
            memory.append(memory_mib("VmRSS") or 0.0)
    return memory, seconds, different


def digest(result: RectifyResult) -> str:
    """A digest of every bit of a result except its run times."""
    arrays = [result.film, result.rectified, result.glare, result.covered, result.confidence]
    arrays += [None if result.backward is None else result.backward.nodes]
    arrays += [None] * 2 if result.grid is None else [result.grid.vertices, result.grid.vertices_photo]
    told = (result.status, result.orientation, result.upright_probability, result.expected_error_px, result.limit_px)
    hashed = hashlib.sha256(repr((told, result.grid and result.grid.confidence)).encode())
    for array in arrays:
        hashed.update(b"none" if array is None else np.ascontiguousarray(array).tobytes())
    return hashed.hexdigest()


def run(options: Options, command: list[str]) -> SoakReport:
    """Rectify all films; write and return the report."""
    use_threads(options.threads)
    folders = options.data or (make_photos(options.out / "photos", options.photos, options.seed),)
    size = (options.photo_px, options.photo_px)
    photos = [resized(case.photo(), size) for case in sample_cases(folders)[: options.photos]]
    rectifier = Rectifier(RectifyConfig(weights=options.weights))
    memory, seconds, different = soak(rectifier, photos, options.films)
    settled = options.films // 10
    report = SoakReport(
        run=describe_run(command),
        films=options.films,
        photos=len(photos),
        photo_px=options.photo_px,
        settled=settled,
        memory_mib=tuple(memory),
        cpu_seconds=tuple(seconds),
        different=different,
    )
    write_record(options.out / "soak.json", report)
    return report


def _verdict(report: SoakReport) -> int:
    print(
        f"{report.films} films: memory {100 * report.memory_growth():+.2f} %, time {100 * report.time_drift():+.1f} %, "
        f"{report.different} results differ"
    )
    steady = report.memory_growth() <= MEMORY_BOUND and report.time_drift() <= DRIFT_BOUND
    return 0 if steady and not report.different else 2


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if memory and time stayed flat and no result differed, 2 otherwise."""
    return run_command("benchmarks.soak", Options, run, arguments, _verdict)


__all__ = ["Options", "digest", "main", "run", "soak"]

if __name__ == "__main__":
    sys.exit(main())
