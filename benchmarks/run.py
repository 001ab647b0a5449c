"""Run time against error: ``python -m benchmarks.run [--photos DIR] [--data SHARDS] --out DIR``.

Every method sees the same photos at the same sizes on the same threads, one after the other on each photo, so that a
machine that slows down slows all. Before it is timed, each is called once at each size. Every result is kept in OUT as
it comes: a run that was cut off goes on with the same command. Without --photos and --data it makes its own photos.
OUT gets run.json, the pictures, and with --page the page that is made of both.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import torch
from tqdm import tqdm

from benchmarks.cases import Case, photo_cases, sample_cases
from benchmarks.command import run_command
from benchmarks.lineup import CONFIGURATIONS, LINEUP, lineup
from benchmarks.machine import commit, describe_run, relative_command, use_threads
from benchmarks.measure import forward_times, measure, peak_memory
from benchmarks.methods import Method
from benchmarks.own_photos import make_photos
from benchmarks.page import write_page
from benchmarks.page_text import size_section
from benchmarks.pictures import write_gallery, write_pictures
from benchmarks.results import Forward, Measured, Memory, MethodNote, Report, Settings
from benchmarks.schema import kept, read_record, write_record
from benchmarks.traits import note_of
from hybrid.errors import ConfigError, describe
from hybrid.learn.presets import PRESETS

NETWORKS = ("filmnet", "dewarpnet", "firenet")
"""Presets whose forward pass is timed alone."""

CUDA_BATCHES = (1, 32)


@dataclass(frozen=True)
class Options:
    """Compare methods: run time, memory and error, on photos whose truth is known."""

    out: Path
    """Folder for all results; run.json and pictures/ when the run is complete."""

    photos: Path | None = None
    """Folder of photos with truth (NAME.jpg, NAME.npz, textures/)."""

    data: tuple[Path, ...] = ()
    """Data sets, of which some samples are taken."""

    sizes: tuple[float, ...] = (1.0, 3.0, 12.0, 48.0)
    """Megapixels to which the photos are resized; a photo within a quarter of that stays as it is."""

    counts: tuple[int, ...] = (8, 4, 2, 2)
    """How many photos are looked at, for each size."""

    repeats: int = 3
    """Timed calls of each method on each photo."""

    methods: tuple[str, ...] = ()
    """Which methods; all if not said. Configurations of hybrid are measured at the first size only."""

    add: tuple[Path, ...] = ()
    """Files of further methods; benchmarks/methods.py says what they hold."""

    weights: Path | None = None
    """Folder of NAME.safetensors or NAME/NAME.safetensors; networks that are not in it run untrained."""

    threads: int = 2
    """That every method may use."""

    seed: int = 0
    """Of the photos that are made where none are named."""

    device: Literal["cpu", "cuda"] = "cpu"
    """cuda: the networks alone are timed there as well, one photo and 32 at a time."""

    memory: bool = True
    """Whether peak memory is measured, each method in a process of its own."""

    gallery: bool = True
    """Whether best, median and worst photo are drawn; not for photos that must not be published."""

    page: Path | None = None
    """Where the page goes, for example docs/benchmarks.md; pictures go beside it into images/."""

    def __post_init__(self) -> None:
        if len(self.sizes) != len(self.counts) or not self.sizes or min(*self.sizes, *self.counts, self.repeats) <= 0:
            got = f"--sizes {self.sizes} --counts {self.counts} --repeats {self.repeats}"
            do = "Give as many counts as sizes, for example --sizes 1 12 --counts 8 2."
            raise ConfigError(describe(what="sizes", got=got, allowed="positive numbers", do=do))
        known = lineup(self.add)
        unknown = [name for name in self.methods if name not in known]
        if unknown:
            allowed = ", ".join(known)
            raise ConfigError(describe(what="--methods", got=", ".join(unknown), allowed=allowed, do="Name these."))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the methods that run."""
        return self.methods or tuple(lineup(self.add))


def run(options: Options, command: list[str]) -> Report:
    """Measure what is not measured yet; write and return the report."""
    settings = _settings(options)
    _keep_settings(options.out / "settings.json", settings)
    cases = load_cases(options)
    methods = {name: make_method(options, name) for name in options.names}
    measured = tuple(_all_measured(options, methods, cases))
    memory = tuple(_all_memory(options)) if options.memory else ()
    used = {one.case for one in measured}
    report = Report(
        run=describe_run(command),
        settings=settings,
        methods=tuple(
            MethodNote(m.name, m.label or m.name, m.parameters, m.says_up, m.unscored) for m in methods.values()
        ),
        cases=tuple(note_of(case) for case in cases if case.name in used),
        measured=measured,
        memory=memory,
        forward=tuple(_networks_alone(options)),
    )
    write_record(options.out / "run.json", report)
    print(*(size_section(report, size) for size in options.sizes), sep="\n\n")
    write_pictures(report, options.out / "pictures")
    if options.gallery:
        write_gallery(report, cases, options.weights, options.out / "pictures")
    if options.page is not None:
        write_page(options.page, options.out)
    return report


def load_cases(options: Options) -> list[Case]:
    """All photos that are named, or those that are made for this."""
    cases = [] if options.photos is None else photo_cases(options.photos)
    if options.data or options.photos is None:
        cases += sample_cases(options.data or [make_photos(options.out / "photos", max(options.counts), options.seed)])
    return cases


def spread(cases: Sequence[Case], count: int) -> list[Case]:
    """So many of the cases, evenly from first to last."""
    chosen = min(count, len(cases))
    return [cases[k * len(cases) // chosen] for k in range(chosen)]


def make_method(options: Options, name: str) -> Method:
    """A method by name.

    Raises:
        ConfigError: it needs weights that are not there.
    """
    method = lineup(options.add)[name](options.weights)
    if method is None:
        raise ConfigError(describe(what="--methods", got=name, do="Name the folder of its weights by --weights."))
    return method


def _settings(options: Options) -> Settings:
    source = [str(path) for path in (options.photos, *options.data) if path is not None]
    shown = relative_command([str(Path(path).absolute()) for path in source]) if source else "made for this"
    weights = "" if options.weights is None else relative_command([str(options.weights.absolute())])
    sizes, counts = options.sizes, options.counts
    return Settings(sizes, counts, options.repeats, options.threads, options.seed, shown, weights, commit())


def _keep_settings(path: Path, settings: Settings) -> None:
    """Refuse to go on with results that were made otherwise."""
    if path.exists() and read_record(path, Settings) != settings:
        do = "Name another folder by --out, or run with the options and the commit that are in that file."
        raise ConfigError(describe(what="--out", where=path, got="results of other settings", do=do))
    write_record(path, settings)


def _sizes_of(options: Options, name: str) -> Iterator[tuple[float, int]]:
    """Sizes at which a method is measured, and on how many photos."""
    pairs = list(zip(options.sizes, options.counts, strict=True))
    yield from pairs[:1] if name in CONFIGURATIONS else pairs


def _all_measured(options: Options, methods: dict[str, Method], cases: Sequence[Case]) -> Iterator[Measured]:
    use_threads(options.threads)
    jobs = [
        (megapixels, case, method)
        for megapixels, count in zip(options.sizes, options.counts, strict=True)
        for case in spread(cases, count)
        for method in methods.values()
        if (megapixels, count) in _sizes_of(options, method.name)
    ]
    warm: set[tuple[float, str]] = set()
    for megapixels, case, method in tqdm(jobs, desc="photos x methods", unit="call"):
        path = options.out / "measured" / f"{megapixels:g}_{case.name}_{method.name}.json"
        known = (megapixels, method.name) in warm
        now = partial(_measure_at, method, case, megapixels, options.repeats, known)
        if not path.exists():
            warm.add((megapixels, method.name))
        result = kept(path, Measured, now)
        if result is not None:
            yield result


def _measure_at(method: Method, case: Case, megapixels: float, repeats: int, warm: bool) -> Measured:
    return measure(method, case.at(megapixels), megapixels, repeats, warm)


def _first_case(options: Options) -> Case:
    return load_cases(options)[0]


def _all_memory(options: Options) -> Iterator[Memory]:
    jobs = [
        (name, size) for name in options.names if name not in CONFIGURATIONS for size, _ in _sizes_of(options, name)
    ]
    for name, size in tqdm(jobs, desc="memory", unit="process"):
        load, make = partial(_first_case, options), partial(make_method, options, name)
        path = options.out / "memory" / f"{size:g}_{name}.json"
        result = kept(path, Memory, partial(peak_memory, load, make, size, options.threads))
        if result is not None:
            yield result


def _networks_alone(options: Options) -> Iterator[Forward]:
    """Forward passes of the networks; the values of the weights do not matter for the time."""
    for name in NETWORKS:
        preset = PRESETS[name]
        px = preset.config.input_px
        torch.manual_seed(options.seed)
        yield from forward_times(name, preset.network(), px, "cpu", (1,), options.repeats)
        if options.device == "cuda":
            yield from forward_times(name, preset.network(), px, "cuda", CUDA_BATCHES, options.repeats)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if it went through."""
    return run_command("benchmarks.run", Options, run, arguments)


__all__ = ["LINEUP", "Options", "load_cases", "main", "run", "spread"]

if __name__ == "__main__":
    sys.exit(main())
