"""Results of ``benchmarks.stability`` and ``benchmarks.soak``, as stored in their JSON files."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from statistics import median
from typing import Any

OUTCOMES = ("ok", "unsure", "refused", "untruthful", "lost", "nan", "crash", "hang")
"""How a damaged photo can end: flattened and right, flattened with a warning, refused with a reason; or, as it should
not: called right but off, refused though it was there and right, not a number, dead, hanging."""

GOOD = OUTCOMES[:3]


@dataclass(frozen=True)
class StressSettings:
    """What determines the results; results of other settings are not combined. The number of results does not count.

    source: data sets, with digests of their contents. machine: processor and packages, which determine seconds and the
    last bits.
    """

    seed: int
    threads: int
    source: str
    weights: str
    commit: str | None
    machine: str = ""


@dataclass(frozen=True)
class Part:
    """Random problems for one part of the code.

    refused: how many ended in a typed refusal; failed: in anything that should not be, with some of them in failures.
    worst: the largest ``unit`` among those that were solved.
    """

    name: str
    what: str
    tried: int
    refused: int
    failed: int
    worst: float
    unit: str
    refusals: dict[str, int]
    failures: tuple[str, ...]


@dataclass(frozen=True)
class DamagedPhoto:
    """One damaged photo: what was done to it, and how it ended.

    size: (height, width), of the file if it was cut off. end_point_px: mean error over the part of the film that is in
    the photo, in pixels of the photo of 1080 before it was damaged; allowed_px: the largest that counts as truthful.
    """

    number: int
    damage: tuple[str, ...]
    size: tuple[int, int]
    outcome: str
    message: str
    seconds: float
    end_point_px: float | None = None
    allowed_px: float | None = None


@dataclass(frozen=True)
class DamageCount:
    """How photos with one kind of damage ended."""

    damage: str
    photos: int
    ok: int
    unsure: int
    refused: int
    failed: int


@dataclass(frozen=True)
class StabilityReport:
    """A whole run of ``benchmarks.stability``. truthful_px: end-point error above which "ok" is not a true status."""

    run: dict[str, Any]
    seed: int
    truthful_px: float
    parts: tuple[Part, ...]
    photos: tuple[DamagedPhoto, ...]

    def counts(self) -> dict[str, int]:
        """How many photos ended in each way."""
        found = Counter(photo.outcome for photo in self.photos)
        return {outcome: found[outcome] for outcome in OUTCOMES}

    def by_damage(self) -> list[DamageCount]:
        """The same for each kind of damage; a photo counts for each kind that was done to it."""
        kinds = sorted({kind for photo in self.photos for kind in photo.damage})
        rows = []
        for kind in kinds:
            ends = Counter(photo.outcome for photo in self.photos if kind in photo.damage)
            total = sum(ends.values())
            ok, unsure, refused = (ends[outcome] for outcome in GOOD)
            rows.append(DamageCount(kind, total, ok, unsure, refused, total - ok - unsure - refused))
        return rows

    @property
    def cautious(self) -> int:
        """Films returned with a warning that was not needed: their error is small."""
        unsure = [photo for photo in self.photos if photo.outcome == "unsure"]
        return sum((photo.end_point_px or 0.0) <= (photo.allowed_px or 0.0) for photo in unsure)

    @property
    def failures(self) -> int:
        """Number of problems and photos that ended as none should."""
        good = sum(count for outcome, count in self.counts().items() if outcome in GOOD)
        return sum(part.failed for part in self.parts) + len(self.photos) - good


@dataclass(frozen=True)
class SoakReport:
    """Many films in one process.

    settled: films after which memory is first read. memory_mib: in use, at equal steps from there to the end.
    cpu_seconds: of every film. different: results that differ in any bit from what the same photo gave before.
    """

    run: dict[str, Any]
    films: int
    photos: int
    photo_px: int
    settled: int
    memory_mib: tuple[float, ...]
    cpu_seconds: tuple[float, ...]
    different: int

    def memory_growth(self) -> float:
        """Memory at the end over that after settling, less 1: medians of the last and the first tenth of readings."""
        tenth = max(len(self.memory_mib) // 10, 1)
        return median(self.memory_mib[-tenth:]) / median(self.memory_mib[:tenth]) - 1

    def time_drift(self) -> float:
        """Processor seconds of a film in the last fifth over those in the first, less 1: medians."""
        fifth = max(len(self.cpu_seconds) // 5, 1)
        return median(self.cpu_seconds[-fifth:]) / median(self.cpu_seconds[:fifth]) - 1


__all__ = ["GOOD", "OUTCOMES", "DamageCount", "DamagedPhoto", "Part", "SoakReport", "StabilityReport"]
