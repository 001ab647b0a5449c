"""What breaks: ``python -m benchmarks.stability --out DIR [--damaged 500]``.

It tries random problems for the solver, the spline, the inversion and the grid, then photos damaged at random, each
rectified in a process that is watched: it may refuse with a reason, but it must not die, hang, return a number that is
not finite, call a film flattened whose points lie elsewhere (it may say that it is not sure), or refuse one whose
points it knows. Every result is kept in DIR as it comes: a run that was cut off continues with the same command, but
not with results of another commit.
"""

from __future__ import annotations

import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.command import GOES_ON, run_command
from benchmarks.machine import commit, describe_run, shown_contents, shown_data, use_threads, used_machine
from benchmarks.photos.cases import Case, read_alike, sample_cases
from benchmarks.photos.damage import CUT_OFF, Damaged, cut_file, damaged, visible_error_px
from benchmarks.photos.own import make_photos
from benchmarks.report.schema import keep_settings, kept, write_record
from benchmarks.report.stress_records import DamagedPhoto, Part, StabilityReport, StressSettings
from benchmarks.scenes.problems import PROBLEMS, ended, part_of
from hybrid.backward import BackwardMap
from hybrid.errors import ConfigError, PhotoError, describe, require_at_least
from hybrid.files import write_bytes
from hybrid.pipeline import Rectifier, RectifyConfig
from hybrid.records import RectifyResult, StatusCode
from hybrid.rectify.verdict.survey import SurveyConfig

TRUTHFUL_PX = 5.0
"""Largest end-point error of a film that is reported ok, in pixels of REFERENCE_PX for the longer side of the photo
before it was damaged; if the photo was shrunk so far that its own pixels are larger, one of those."""

LIMIT_S, LIMIT_S_PER_MEGAPIXEL = 120.0, 6.0
"""Time limit after which a photo counts as hanging; a hundred times what it takes, to allow for busy machines."""

CUT_SHARE = 0.1
"""Share of the damaged photos that are truncated files."""

OWN_PHOTOS = 12

WHOLE = 0.75
"""Share of the sheet in the photo from which a refusal may count as a loss."""

NOTHING_REFUSED = SurveyConfig(
    min_mask_share=0.0,
    min_inlier_share=0.0,
    max_residual=np.inf,
    min_coverage=0.0,
    min_overlap=0.0,
    max_expected_error=np.inf,
    min_skewness=-np.inf,
    max_stretch=np.inf,
)
"""Takes what the network sees for a film whatever it looks like; a map that turns over is still refused."""

Rectify = Callable[..., RectifyResult]
"""From a photo or its path."""

FindAnyway = Callable[[np.ndarray], BackwardMap | None]
"""From a photo to the map that would be returned if the photo were not refused; None if there is no map at all."""


@dataclass(frozen=True)
class Options:
    """Try to break every part, and the whole."""

    out: Path
    """Folder for stability.json and the single results."""

    data: tuple[Path, ...] = ()
    """Data sets whose photos are damaged; without any, some are made."""

    damaged: int = 40
    """How many photos to damage."""

    problems: int = 200
    """How many problems for each part."""

    seed: int = 0
    """Seed of problems and damage."""

    threads: int = 2
    """Threads that rectifying may use."""

    weights: Path | None = None
    """Another network than the packaged one."""

    def __post_init__(self) -> None:
        if min(self.damaged, self.problems) < 0 or self.threads < 1:
            got = f"--damaged {self.damaged} --problems {self.problems} --threads {self.threads}"
            raise ConfigError(describe(what="counts", got=got, allowed=">= 0 (threads: >= 1)", do="Choose others."))
        require_at_least(self, 0, "seed")


def run(options: Options, command: list[str]) -> StabilityReport:
    """Try everything that has not been tried yet; write and return the report.

    Raises:
        ConfigError: the results in ``options.out`` were made with other settings, at another commit, or elsewhere.
        DataError: photos or weights cannot be read.
    """
    source = shown_data(*options.data) or "made for this"
    made_by = source, shown_contents(options.weights), commit(), used_machine()
    settings = StressSettings(options.seed, options.threads, *made_by)
    keep_settings(options.out / "stability_settings.json", settings, options.out / "parts", options.out / "damaged")
    folders = _readable_photos(options)
    parts = tuple(_part(options, name) for name in PROBLEMS) if options.problems else ()
    report = StabilityReport(describe_run(command), options.seed, TRUTHFUL_PX, parts, tuple(_photos(options, folders)))
    write_record(options.out / "stability.json", report)
    return report


def _part(options: Options, name: str) -> Part:
    problem, what, unit = PROBLEMS[name]

    def solve() -> Part:
        seeds = tqdm(range(options.problems), desc=name, unit="problem")
        return part_of(name, what, unit, [ended(problem, options.seed + k) for k in seeds])

    path = options.out / "parts" / f"{name}_{options.problems}_{options.seed}.json"
    found = kept(path, Part, solve)
    assert found is not None
    return found


# ---------------------------------------------------------------- photos, in a watched process


def _readable_photos(options: Options) -> tuple[Path, ...]:
    """Folders of the photos. They and the weights are read once before any result is made: in the watched process, what
    cannot be read would end every photo as a crash."""
    folders = options.data or (make_photos(options.out / "photos", OWN_PHOTOS, options.seed),)
    sample_cases(folders)
    Rectifier(RectifyConfig(weights=options.weights))
    return folders


def _photos(options: Options, folders: tuple[Path, ...]) -> list[DamagedPhoto]:
    watched = _Watched(folders, options)
    results = []
    try:
        for number in tqdm(range(options.damaged), desc="damaged", unit="photo"):
            path = options.out / "damaged" / f"{options.seed}_{number}.json"
            found = kept(path, DamagedPhoto, partial(watched.try_photo, number))
            assert found is not None
            results.append(found)
    finally:
        watched.end()
    return results


class _Watched:
    """A process that rectifies damaged photos; it is replaced by a new one when it dies or hangs."""

    def __init__(self, folders: tuple[Path, ...], options: Options) -> None:
        self._arguments = (folders, options)
        self._process: SpawnProcess | None = None
        self._line: Connection | None = None

    def try_photo(self, number: int) -> DamagedPhoto:
        """How photo ``number`` ended."""
        line = self._start() if self._line is None else self._line
        start, told = time.perf_counter(), DamagedPhoto(number, (), (0, 0), "crash", "before the photo was made", 0.0)
        try:
            line.send(number)
            if not line.poll(10 * LIMIT_S):
                raise TimeoutError
            told = line.recv()  # what will be tried
            if told.outcome != "tried":
                return told
            if not line.poll(LIMIT_S + LIMIT_S_PER_MEGAPIXEL * told.size[0] * told.size[1] / 1e6):
                raise TimeoutError
            return line.recv()
        except TimeoutError:
            return self._lost(told, "hang", time.perf_counter() - start)
        except (EOFError, OSError):
            return self._lost(told, "crash", time.perf_counter() - start)

    def _lost(self, told: DamagedPhoto, outcome: str, seconds: float) -> DamagedPhoto:
        code = None if self._process is None else self._process.exitcode
        self.end()
        return DamagedPhoto(told.number, told.damage, told.size, outcome, f"exit code {code}", seconds)

    def _start(self) -> Connection:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(*self._arguments, theirs), daemon=True)
        process.start()
        theirs.close()
        self._line, self._process = ours, process
        return ours

    def end(self) -> None:
        """End the process, whatever it is doing."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
        self._process, self._line = None, None


def _serve(folders: tuple[Path, ...], options: Options, line: Connection) -> None:
    """Answer each number with what is tried and then with how it ended."""
    use_threads(options.threads)
    cases, rectifier = sample_cases(folders), Rectifier(RectifyConfig(weights=options.weights))
    find_anyway = partial(_map_anyway, Rectifier(RectifyConfig(weights=options.weights, survey=NOTHING_REFUSED)))
    while True:
        try:
            number = line.recv()
        except EOFError:
            return
        rng = np.random.default_rng((options.seed, number))
        case = cases[int(rng.integers(len(cases)))]
        if rng.random() < CUT_SHARE:
            line.send(_cut_off(number, case, rectifier, rng))
        else:
            it = damaged(case.photo(), case.backward, rng)
            line.send(DamagedPhoto(number, it.kinds, (it.photo.shape[0], it.photo.shape[1]), "tried", "", 0.0))
            line.send(_rectified(number, it, rectifier, find_anyway))


def _map_anyway(rectifier: Rectifier, photo: np.ndarray) -> BackwardMap | None:
    """The map of what the networks see, whether or not that is a film."""
    return rectifier(photo).backward


def _rectified(number: int, it: Damaged, rectify: Rectify, find_anyway: FindAnyway) -> DamagedPhoto:
    """How rectifying a damaged photo ended."""
    size = (it.photo.shape[0], it.photo.shape[1])
    start = time.perf_counter()
    try:
        result = rectify(it.photo)
    except PhotoError as refusal:
        return DamagedPhoto(number, it.kinds, size, "refused", str(refusal), time.perf_counter() - start)
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        return DamagedPhoto(number, it.kinds, size, "crash", text, time.perf_counter() - start)
    seconds = time.perf_counter() - start
    message = str(result.status)
    if not result.status.has_film:
        unseen = result.status.code in (StatusCode.NO_FILM, StatusCode.CUT_OFF, StatusCode.FOLDED)
        if unseen and it.visible_share() >= WHOLE and (found := find_anyway(it.photo)) is not None:
            error, allowed = _error_and_limit(found, it)
            outcome = "lost" if error <= allowed else "refused"
            return DamagedPhoto(number, it.kinds, size, outcome, message, seconds, error, allowed)
        return DamagedPhoto(number, it.kinds, size, "refused", message, seconds)
    if result.backward is None or not _finite(result):
        return DamagedPhoto(number, it.kinds, size, "nan", message, seconds)
    error, allowed = _error_and_limit(result.backward, it)
    outcome = ("ok" if error <= allowed else "untruthful") if result.status.ok else "unsure"
    return DamagedPhoto(number, it.kinds, size, outcome, message, seconds, error, allowed)


def _error_and_limit(found: BackwardMap, it: Damaged) -> tuple[float, float]:
    """Error of a map over the film in the photo, and the largest that counts as right, in pixels of REFERENCE_PX."""
    seen, _ = read_alike(found, it.backward)
    error = it.to_reference * visible_error_px(seen, it.backward, (it.photo.shape[0], it.photo.shape[1]))
    return min(error, 1e9), max(TRUTHFUL_PX, it.to_reference)


def _finite(result: RectifyResult) -> bool:
    """Whether all numbers of a result are finite, and grey is within its range."""
    arrays = [a for a in (result.film, result.confidence) if a is not None]
    return len(arrays) == 2 and all(np.isfinite(a).all() and a.min() >= 0 and a.max() <= 1 for a in arrays)


def _cut_off(number: int, case: Case, rectify: Rectify, rng: np.random.Generator) -> DamagedPhoto:
    """A truncated file has to be refused; it could only be read if no pixel were missing."""
    photo, start = case.photo(), time.perf_counter()
    size = (photo.shape[0], photo.shape[1])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "photo.jpg"
        write_bytes(path, cut_file(photo, rng))
        try:
            status = rectify(path).status
            outcome, message = ("untruthful" if status.has_film else "refused"), str(status)
        except PhotoError as refusal:
            outcome, message = "refused", str(refusal).replace(folder, "")
        except Exception as error:
            outcome, message = "crash", f"{type(error).__name__}: {error}"
    return DamagedPhoto(number, (CUT_OFF,), size, outcome, message, time.perf_counter() - start)


def _verdict(report: StabilityReport) -> int:
    for part in report.parts:
        print(
            f"{part.name}: {part.tried} tried, {part.refused} refused, {part.failed} failed", *part.failures, sep="\n  "
        )
    print("photos:", ", ".join(f"{name} {count}" for name, count in report.counts().items()))
    return 0 if report.failures == 0 else 2


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if nothing failed, 2 if something did."""
    return run_command("benchmarks.stability", Options, run, arguments, _verdict, GOES_ON)


__all__ = ["Options", "main", "run"]

if __name__ == "__main__":
    sys.exit(main())
