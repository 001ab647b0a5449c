"""What a film lies on, what is stuck on it, and what that costs.

``python -m benchmarks.surroundings --photos DIR [DIR ...] --json OUT`` changes photos with truth around their film
(photos/grounds.py) or on it (photos/marks.py) and flattens them again: by the network alone, as refinement starts from
it, and by the whole pipeline. Errors are mean end-point errors in pixels of the original photo, scaled to 1080. The
JSON file, named surroundings.json, may lie beside run.json for ``benchmarks.page``.
"""

from __future__ import annotations

import sys
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from tqdm import tqdm

from benchmarks.command import run_command
from benchmarks.machine import describe_run
from benchmarks.photos.cases import Case, photo_cases, read_alike, sample_cases
from benchmarks.photos.damage import Damaged
from benchmarks.photos.grounds import CHANGES as AROUND
from benchmarks.photos.grounds import Sheet
from benchmarks.photos.marks import MARKS
from benchmarks.report.schema import write_record
from benchmarks.report.surroundings_records import ChangeCount, Ended, SurroundingsReport
from benchmarks.report.tables import surroundings_table
from benchmarks.scores import LATTICE
from hybrid.backward import BackwardMap, end_point_error
from hybrid.draw import annotated, contact_sheet, fitted
from hybrid.effort import Effort, RectifyConfig
from hybrid.errors import ConfigError, DataError, HybridError, describe, require_at_least
from hybrid.files import make_folder
from hybrid.image_io import write_rgb
from hybrid.pipeline import Rectifier
from hybrid.workers import shared_out

CHANGES = AROUND | MARKS
"""All changes: what each is called, in words, and how it is made."""

SHOWN = 2
"""Number of photos of each change that are drawn."""


@dataclass(frozen=True)
class Options:
    """Change photos with truth around their film or on it, and measure the effect."""

    json_path: Annotated[Path, tyro.conf.arg(name="json")]
    """File for the figures."""

    photos: tuple[Path, ...] = ()
    """Folders of NAME.jpg, NAME.npz (the true lattice) and textures/."""

    data: tuple[Path, ...] = ()
    """Data sets made by data_gen.generate."""

    only: tuple[str, ...] = ()
    """Names of changes; all if none is given."""

    every: int = 1
    """Take every so many of the photos."""

    network_alone: bool = False
    """Skip the whole pipeline."""

    effort: Effort = "default"
    """How much work to spend on a photo."""

    weights: Path | None = None
    """A network to use in place of the packaged one."""

    workers: int = 2
    """Photos flattened at a time, each by a process."""

    pictures: Path | None = None
    """Folder for surroundings.jpg, which shows some of the changed photos with what was found in them."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "every", "workers")
        unknown = [name for name in self.only if name not in CHANGES]
        if unknown:
            allowed = ", ".join(CHANGES)
            raise ConfigError(describe(what="--only", got=unknown[0], allowed=allowed, do="Name some of these."))


# ---------------------------------------------------------------- one photo


@dataclass(frozen=True, eq=False)
class Task:
    """A case, another whose film is laid beside it, and the change."""

    change: str
    case: Case
    other: Case

    def made(self) -> Damaged:
        """The changed photo and its truth; the same each time."""
        rng = np.random.default_rng(zlib.crc32(f"{self.change} {self.case.name}".encode()))
        sheet, other = (Sheet(case.photo(), case.backward) for case in (self.case, self.other))
        return replace(CHANGES[self.change][1](sheet, other, rng), before_px=max(sheet.photo.shape[:2]))


@dataclass(frozen=True, eq=False)
class Rectifiers:
    """alone: its network looks from one side, as refinement starts from it. whole: does what its effort says."""

    alone: Rectifier
    whole: Rectifier

    @staticmethod
    def of(config: RectifyConfig) -> Rectifiers:
        """The rectifiers for the options."""
        predict = replace(config.predict, sides=config.predict.sides[:1])
        return Rectifiers(Rectifier(replace(config, predict=predict)), Rectifier(config))


def tried(whole: bool, rectifiers: Rectifiers, task: Task) -> Ended:
    """Flatten a changed photo."""
    it = task.made()

    def error_px(found: BackwardMap | None) -> float | None:
        if found is None:
            return None
        near = read_alike(found, it.backward)[0]
        return it.to_reference * float(end_point_error(near, it.backward.lattice(LATTICE)).mean())

    network = error_px(rectifiers.alone.network_map(it.photo))
    if not whole:
        return Ended(task.change, task.case.name, network)
    result = rectifiers.whole(it.photo)
    found = error_px(result.backward)
    limit = np.inf if result.limit_px is None else it.to_reference * result.limit_px
    wrong = result.status.ok and found is not None and found > limit
    return Ended(task.change, task.case.name, network, found, result.status.code.name, wrong)


def tasks_of(options: Options) -> list[Task]:
    """Every photo with every change; the next photo's film is laid beside it.

    Raises:
        ConfigError: no photos are named. DataError: they cannot be read, or there are fewer than two.
    """
    if not options.photos and not options.data:
        do = "Name --photos or --data."
        raise ConfigError(describe(what="benchmarks.surroundings", got="nothing to change", do=do))
    cases = [case for folder in options.photos for case in photo_cases(folder)]
    cases = (cases + (sample_cases(options.data) if options.data else []))[:: options.every]
    if len(cases) < 2:
        do = "Name more of them, or a smaller --every."
        raise DataError(describe(what="photos", got=f"{len(cases)}", allowed="two or more", do=do))
    names = options.only or tuple(CHANGES)
    return [Task(name, case, cases[(k + 1) % len(cases)]) for name in names for k, case in enumerate(cases)]


# ---------------------------------------------------------------- figures


def counted(ended: Sequence[Ended]) -> tuple[ChangeCount, ...]:
    """Counts of the photos of each change, in the order of the changes."""
    names = dict.fromkeys(one.change for one in ended)
    return tuple(_count(name, [one for one in ended if one.change == name]) for name in names)


def _count(change: str, ended: Sequence[Ended]) -> ChangeCount:
    network = [one.network_px for one in ended if one.network_px is not None]
    film = [one.film_px for one in ended if one.film_px is not None]
    return ChangeCount(
        change=change,
        what=CHANGES[change][0],
        photos=len(ended),
        network_found=len(network),
        network_px=_geometric_mean(network),
        network_to_10=sum(px < 10 for px in network),
        found=len(film),
        film_px=_geometric_mean(film),
        to_1=sum(px < 1 for px in film),
        to_5=sum(px < 5 for px in film),
        ok=sum(one.status == "OK" for one in ended),
        wrong=sum(one.wrong for one in ended),
    )


def _geometric_mean(errors: Sequence[float]) -> float | None:
    return float(np.exp(np.mean(np.log(np.maximum(errors, 1e-6))))) if errors else None


# ---------------------------------------------------------------- the command


def run(options: Options, command: list[str]) -> SurroundingsReport:
    """Change, flatten, write the figures as JSON and print them."""
    tasks, config = tasks_of(options), replace(RectifyConfig.of(options.effort), weights=options.weights)
    if options.pictures is not None:
        _draw(options.pictures, tasks, Rectifier(config))
    ended = tuple(tqdm(_each(options, tasks, config), total=len(tasks), unit="photo"))
    report = SurroundingsReport(describe_run(command), not options.network_alone, counted(ended), ended, sides=1)
    write_record(options.json_path, report)
    print(surroundings_table(report))
    return report


def _each(options: Options, tasks: Sequence[Task], config: RectifyConfig) -> Iterator[Ended]:
    for answer in shared_out(
        partial(tried, not options.network_alone), partial(Rectifiers.of, config), tasks, options.workers
    ):
        if isinstance(answer, HybridError):
            raise answer
        yield answer


def _draw(folder: Path, tasks: Sequence[Task], rectifier: Rectifier) -> None:
    """Draw some photos of each change, with what is found in them."""
    make_folder(folder, "--pictures")
    tiles, captions = [], []
    for name in dict.fromkeys(task.change for task in tasks):
        for task in [one for one in tasks if one.change == name][:SHOWN]:
            photo = task.made().photo
            tiles.append(fitted(annotated(photo, rectifier(photo)), (360, 360)))
            captions.append(f"{CHANGES[name][0]}: {task.case.name}")
    write_rgb(folder / "surroundings.jpg", contact_sheet(tiles, captions, 6))


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if it went through."""
    return run_command("benchmarks.surroundings", Options, run, arguments)


__all__ = ["Options", "Rectifiers", "counted", "main", "run", "tasks_of", "tried"]

if __name__ == "__main__":
    sys.exit(main())
