"""What ``benchmarks.run`` measures, as stored in its JSON files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from benchmarks.claims import Claim
from benchmarks.scores import MapScore


@dataclass(frozen=True)
class FilmScore:
    """dB of the flat picture's grey, with its light, and of the film without it, against the print (512 px).

    After one gain and offset; psnr is None for methods that take no light away.
    """

    lit_psnr: float
    psnr: float | None


@dataclass(frozen=True)
class Measured:
    """One method on one photo at one size.

    megapixels: as asked for. size: (height, width) of the photo. seconds, cpu_seconds: of every call, from the photo
    in memory to the flat film; the second counts what all threads of the process worked. parts: median seconds of the
    parts that the method tells apart. score: None where no film was found or the method is not scored. film: None
    where the print is not known. grid: slices found, ROWSxCOLS. output: (height, width) of the flat film. claim: what
    the method says of its result; None from methods that say nothing, and in results older than this. sides: logarithm
    of the flat film's ratio of sides over the sheet's, without sign; None from methods that are told the film's size.
    """

    method: str
    case: str
    megapixels: float
    size: tuple[int, int]
    seconds: tuple[float, ...]
    cpu_seconds: tuple[float, ...]
    parts: dict[str, float]
    found: bool
    message: str
    score: MapScore | None = None
    film: FilmScore | None = None
    grid: str = ""
    output: tuple[int, int] | None = None
    claim: Claim | None = None
    sides: float | None = None

    @property
    def wrongly_ok(self) -> bool:
        """Whether the film is called flattened, but its error is larger than that allows."""
        return self.claim is not None and self.score is not None and self.claim.broken_by(self.score.end_point_px)


@dataclass(frozen=True)
class Memory:
    """Peak memory of a fresh process that calls a method once. own: beyond what libraries and photo hold before."""

    method: str
    megapixels: float
    peak_mib: float
    own_mib: float


@dataclass(frozen=True)
class Forward:
    """A network alone, from a batch on the device to its output.

    seconds, cpu_seconds: of every call, of the whole batch; the latter of the process, all its threads together.
    """

    network: str
    device: str
    batch: int
    input_px: int
    parameters: int
    seconds: tuple[float, ...]
    cpu_seconds: tuple[float, ...]


@dataclass(frozen=True)
class MethodNote:
    """A method, as benchmarks.methods.Method describes it."""

    name: str
    label: str
    parameters: int | None
    says_up: bool
    unscored: str
    training: str = ""


@dataclass(frozen=True)
class CaseNote:
    """What kind of photo a case is.

    style: of the cells (rules, gutter, none). light: "light box", "room" or "room and lamps". bend_deg: the largest
    angle between the sheet and its mean plane. coverage: share of the photo that the sheet takes up. size: its own.
    grid: the slices that are there, ROWSxCOLS. What the data do not tell is "unknown", None or empty.
    """

    name: str
    style: str
    light: str
    bend_deg: float | None
    coverage: float
    size: tuple[int, int]
    grid: str = ""


@dataclass(frozen=True)
class Settings:
    """What decides the figures; results made with others are not put together.

    source: photos and data sets, with digests of their contents. weights: their folder, and a digest of its contents
    and of the files of added methods. machine: processor and packages; empty in reports of before.
    """

    sizes: tuple[float, ...]
    counts: tuple[int, ...]
    repeats: int
    threads: int
    seed: int
    source: str
    weights: str
    commit: str | None
    machine: str = ""


@dataclass(frozen=True)
class Report:
    """A whole run. run: benchmarks.machine.describe_run."""

    run: dict[str, Any]
    settings: Settings
    methods: tuple[MethodNote, ...]
    cases: tuple[CaseNote, ...]
    measured: tuple[Measured, ...]
    memory: tuple[Memory, ...] = ()
    forward: tuple[Forward, ...] = ()


__all__ = ["CaseNote", "FilmScore", "Forward", "Measured", "Memory", "MethodNote", "Report", "Settings"]
