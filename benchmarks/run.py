"""Run time against error: ``python -m benchmarks.run [--photos DIR] [--data SHARDS] --out DIR``.

Every method sees the same photos at the same sizes on the same threads, one after the other on each photo, so that a
machine that slows down slows all of them. Before it is timed, each method is called once at each size. Every result is
kept in OUT as it comes: a run that was cut off continues with the same command. Without --photos and --data it makes
its own photos. It writes run.json and the pictures to OUT, and with --page the page made from both.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import torch
from torch import nn
from tqdm import tqdm

from benchmarks.command import GOES_ON, run_command
from benchmarks.lineup import CONFIGURATIONS, lineup
from benchmarks.machine import commit, describe_run, shown_contents, shown_data, use_threads, used_machine
from benchmarks.measure import forward_time, measure, peak_memory
from benchmarks.methods import Method
from benchmarks.page import write_page
from benchmarks.photos.cases import Case, photo_cases, sample_cases
from benchmarks.photos.own import make_photos
from benchmarks.report.pictures import write_gallery, write_pictures
from benchmarks.report.results import Forward, Measured, Memory, MethodNote, Report, Settings
from benchmarks.report.schema import keep_settings, kept, write_record
from benchmarks.report.summary import spread
from benchmarks.report.tables import figures_text
from benchmarks.report.traits import note_of
from hybrid.errors import ConfigError, describe, require_at_least, require_at_most
from hybrid.learn.networks.filmnet import FilmNet, FilmNetConfig
from hybrid.learn.paper.dewarpnet import DewarpNet, DewarpNetConfig
from hybrid.learn.paper.firenet import FiReNet, FiReNetConfig

NETWORKS: dict[str, Callable[[], nn.Module]] = {
    "FilmNet": lambda: FilmNet(FilmNetConfig()),
    "DewarpNet": lambda: DewarpNet(DewarpNetConfig()),
    "FiReNet": lambda: FiReNet(FiReNetConfig()),
}
"""Networks as wide as published, whose forward pass is timed alone."""

STEADY_PHOTOS = 2
"""Number of photos of each size, with one timed call each, for methods whose run time hardly depends on the photo."""

CUDA_BATCHES = (1, 32)

FEWEST_PASSES = 5
"""Fewest passes of each network alone; the quickest counts, since any other load on the machine only slows it."""


@dataclass(frozen=True)
class Options:
    """Compare methods: run time, memory and error, on photos whose truth is known."""

    out: Path
    """Folder for all results; run.json and pictures/ when the run is complete."""

    photos: Path | None = None
    """Folder of photos with truth (NAME.jpg, NAME.npz, textures/)."""

    data: tuple[Path, ...] = ()
    """Data sets from which some samples are taken."""

    sizes: tuple[float, ...] = (1.0, 3.0, 12.0, 48.0)
    """Megapixels to which the photos are resized; a photo within a quarter of that stays as it is."""

    counts: tuple[int, ...] = (8, 4, 2, 2)
    """How many photos are used for each size."""

    repeats: int = 3
    """Timed calls of each method on each photo."""

    methods: tuple[str, ...] = ()
    """Which methods; all by default. Configurations of hybrid are measured at the first size only."""

    add: tuple[Path, ...] = ()
    """Files with further methods; benchmarks/methods.py describes their format."""

    weights: Path | None = None
    """Folder of NAME.safetensors or NAME/NAME.safetensors; what it lacks is taken from the package, if that has it."""

    threads: int = 2
    """Threads that every method may use."""

    seed: int = 0
    """Seed of the photos that are made where none are named."""

    networks: tuple[str, ...] = tuple(NETWORKS)
    """Networks that are timed alone."""

    gpu: bool = True
    """Whether they are timed on a GPU as well, where one is at hand: one photo and 32 at a time."""

    memory: tuple[float, ...] = (12.0,)
    """Megapixels at which peak memory is measured, each method in a process of its own; give none to skip it."""

    gallery: int = 3
    """How many photos are drawn, from best to worst; 0 for photos that must not be published."""

    page: Path | None = None
    """Where the page goes, for example docs/benchmarks.md; pictures go beside it into images/."""

    def __post_init__(self) -> None:
        if len(self.sizes) != len(self.counts) or not self.sizes or min(*self.sizes, *self.counts, self.repeats) <= 0:
            got = f"--sizes {self.sizes} --counts {self.counts} --repeats {self.repeats}"
            do = "Give as many counts as sizes, for example --sizes 1 12 --counts 8 2."
            raise ConfigError(describe(what="sizes", got=got, allowed="positive numbers", do=do))
        require_at_least(self, 1, "threads")
        require_at_least(self, 0, "seed")
        require_at_most(self, 2**64 - 1, "seed")
        known = lineup(self.add)
        unknown = [name for name in self.methods if name not in known]
        if unknown:
            allowed = ", ".join(known)
            raise ConfigError(describe(what="--methods", got=", ".join(unknown), allowed=allowed, do="Name these."))
        strangers = sorted(set(self.networks) - set(NETWORKS))
        if strangers:
            allowed = ", ".join(NETWORKS)
            raise ConfigError(describe(what="--networks", got=", ".join(strangers), allowed=allowed, do="Name these."))
        if min((self.gallery, *self.memory)) < 0:
            got = f"--gallery {self.gallery} --memory {self.memory}"
            raise ConfigError(describe(what="options", got=got, allowed="no negative numbers", do="Choose others."))


def run(options: Options, command: list[str]) -> Report:
    """Measure what has not been measured yet; write and return the report."""
    settings = _settings(options)
    keep_settings(
        options.out / "run_settings.json",
        settings,
        options.out / "measured",
        options.out / "memory",
        options.out / "forward",
    )
    cases = load_cases(options)
    methods = make_methods(options)
    measured = tuple(_all_measured(options, methods, cases))
    memory = tuple(_all_memory(options, methods))
    used = {one.case for one in measured}
    report = Report(
        run=describe_run(command),
        settings=settings,
        methods=tuple(
            MethodNote(m.name, m.label or m.name, m.parameters, m.says_up, m.unscored, m.training)
            for m in methods.values()
        ),
        cases=tuple(note_of(case) for case in cases if case.name in used),
        measured=measured,
        memory=memory,
        forward=tuple(_networks_alone(options)),
    )
    write_record(options.out / "run.json", report)
    print(figures_text(report))
    if options.gallery:
        write_gallery(report, cases, options.weights, options.gallery, options.out / "pictures")
    if options.page is None:
        write_pictures(report, options.out / "pictures")
    else:
        write_page(options.page, options.out)  # draws the pictures as well
    return report


def load_cases(options: Options) -> list[Case]:
    """All photos that are named, or those made for this run.

    Raises:
        ConfigError: two have the same name.
    """
    cases = [] if options.photos is None else photo_cases(options.photos)
    if options.data or options.photos is None:
        cases += sample_cases(options.data or [make_photos(options.out / "photos", max(options.counts), options.seed)])
    if len({case.name for case in cases}) < len(cases):
        do = "Score data sets whose samples have the same numbers in runs of their own."
        raise ConfigError(describe(what="--data", got="two photos of the same name", do=do))
    return cases


def make_methods(options: Options) -> dict[str, Method]:
    """The methods that are named, or all whose weights are there.

    Raises:
        ConfigError: a named method needs weights that are not there.
    """
    known = lineup(options.add)
    made = {name: known[name](options.weights) for name in options.methods or known}
    missing = [name for name, method in made.items() if method is None and name in options.methods]
    if missing:
        do = "Name the folder of its weights by --weights."
        raise ConfigError(describe(what="--methods", got=", ".join(missing), do=do))
    return {name: method for name, method in made.items() if method is not None}


def _settings(options: Options) -> Settings:
    source = shown_data(options.photos, *options.data)
    weights = shown_contents(options.weights, *options.add)
    sizes, counts = options.sizes, options.counts
    made_by = source or "made for this", weights, commit(), used_machine()
    return Settings(sizes, counts, options.repeats, options.threads, options.seed, *made_by)


def _all_measured(options: Options, methods: dict[str, Method], cases: Sequence[Case]) -> Iterator[Measured]:
    """Every method on every photo of every size; those with one thing changed at the first size only."""
    use_threads(options.threads)
    by_name = {case.name: case for case in cases}

    @lru_cache(maxsize=1)
    def sized(megapixels: float, name: str) -> Case:
        return by_name[name].at(megapixels).in_memory()

    jobs = [
        (megapixels, case.name, method)
        for megapixels, count in zip(options.sizes, options.counts, strict=True)
        for k, case in enumerate(spread(cases, count))
        for method in methods.values()
        if not (method.steady and k >= STEADY_PHOTOS)
        if megapixels == options.sizes[0] or method.name not in CONFIGURATIONS
    ]
    warm: set[tuple[float, str]] = set()
    for megapixels, name, method in tqdm(jobs, desc="photos x methods", unit="call"):
        path = options.out / "measured" / f"{megapixels:g}_{name}_{method.name}.json"
        repeats = 1 if method.steady else options.repeats
        known = (megapixels, method.name) in warm
        if not path.exists():
            warm.add((megapixels, method.name))
        case = partial(sized, megapixels, name)
        result = kept(path, Measured, partial(_measure_at, method, case, megapixels, repeats, known))
        if result is not None:
            yield result


def _measure_at(method: Method, case: Callable[[], Case], megapixels: float, repeats: int, warm: bool) -> Measured:
    return measure(method, case(), megapixels, repeats, warm)


def _first_case(options: Options) -> Case:
    return load_cases(options)[0]


def _the_method(options: Options, name: str) -> Method:
    return make_methods(replace(options, methods=(name,)))[name]


def _all_memory(options: Options, methods: dict[str, Method]) -> Iterator[Memory]:
    jobs = [(name, size) for size in options.memory for name in methods if name not in CONFIGURATIONS]
    for name, size in tqdm(jobs, desc="memory", unit="process"):
        load, make = partial(_first_case, options), partial(_the_method, options, name)
        path = options.out / "memory" / f"{size:g}_{name}.json"
        result = kept(path, Memory, partial(peak_memory, load, make, size, options.threads))
        if result is not None:
            yield result


def _networks_alone(options: Options) -> Iterator[Forward]:
    """Forward passes of the networks; the values of the weights do not matter for the time."""
    on_gpu = CUDA_BATCHES if options.gpu and torch.cuda.is_available() else ()
    for name in options.networks:
        for device, batch in (("cpu", 1), *(("cuda", batch) for batch in on_gpu)):
            path = options.out / "forward" / f"{name}_{device}_{batch}.json"
            result = kept(path, Forward, partial(_network_alone, options, name, device, batch))
            if result is not None:
                yield result


def _network_alone(options: Options, name: str, device: str, batch: int) -> Forward:
    torch.manual_seed(options.seed)
    return forward_time(name, NETWORKS[name](), device, batch, max(options.repeats, FEWEST_PASSES))


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if it went through."""
    return run_command("benchmarks.run", Options, run, arguments, stopped=GOES_ON)


__all__ = ["Options", "load_cases", "main", "run"]

if __name__ == "__main__":
    sys.exit(main())
