"""The paper's three tables: ``python -m benchmarks.tables --data TEST_SHARDS --json OUT [--weights DIR]``.

Every method sees the same photos, one at a time, on the same threads. Its map is scored by the paper's protocol
(hybrid.metrics.paper_protocol, raw and de-shifted) and by its end-point error, whichever side of the film it takes to
be up; photos in which it finds no film are counted and left out of the means. Methods whose weights are not in the
folder are listed as not trained. The paper's figures, from its own test set, stand beside ours.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tqdm import tqdm

from benchmarks.command import run_command, write_figures
from benchmarks.methods import METHODS, Method
from benchmarks.paper_tables import TABLES, table_text
from benchmarks.photos.cases import Case, photo_cases, sample_cases
from benchmarks.scores import CaseScore, score, summarise
from hybrid.errors import ConfigError, describe

NEEDS_SHAPE = frozenset({"net_bw", "net_uv"})
"""Methods whose input is the true 3D map, which photos outside data sets do not have."""


@dataclass(frozen=True)
class Options:
    """Score networks on samples that none of them was trained on; print the paper's tables, write JSON."""

    json_path: Annotated[Path, tyro.conf.arg(name="json")]
    """File for the figures of every method and photo, and the machine."""

    data: tuple[Path, ...] = ()
    """Data sets of the test split."""

    weights: Path | None = None
    """Folder of NAME.safetensors or NAME/NAME.safetensors; what it lacks is taken from the package, if that has it."""

    photos: Path | None = None
    """Folder of photos with truth (NAME.jpg, NAME.npz), scored apart; they have no 3D maps for table 2."""

    methods: tuple[str, ...] = tuple(METHODS)
    """Which methods; all by default."""

    count: int | None = None
    """Take only the first so many samples."""

    def __post_init__(self) -> None:
        unknown = [name for name in self.methods if name not in METHODS]
        if unknown:
            allowed = ", ".join(METHODS)
            raise ConfigError(describe(what="--methods", got=", ".join(unknown), allowed=allowed, do="Name these."))
        if not self.data and self.photos is None:
            raise ConfigError(describe(what="tables", got="nothing to score on", do="Give --data or --photos."))
        if self.count is not None and self.count < 1:
            raise ConfigError(describe(what="--count", got=self.count, allowed=">= 1", do="Choose another."))


def score_method(method: Method, cases: Sequence[Case]) -> list[CaseScore]:
    """Scores of a method on all cases; a first call, which pays for caches and threads, is not timed."""
    method.find_or_lose(method.given(cases[0]))
    return [score(method, case) for case in tqdm(cases, desc=method.name, unit="photo", leave=False)]


def score_methods(methods: Mapping[str, Method | None], cases: Sequence[Case]) -> dict[str, Any]:
    """Summary and single scores of each method by name; ``trained`` is False for one without weights."""
    rows: dict[str, Any] = {}
    for name, method in methods.items():
        if method is None:
            rows[name] = {"trained": False}
            continue
        scores = score_method(method, cases)
        summary = summarise(scores, says_up=method.says_up)
        scored = [asdict(one) for one in scores]
        known = {"trained": True, "parameters": method.parameters, "training": method.training}
        rows[name] = known | summary | {"photos": scored}
    return rows


def run(options: Options, command: list[str]) -> dict[str, Any]:
    """Score all methods, print the tables, write the report; return the rows of each set of photos."""
    methods = {name: METHODS[name](options.weights) for name in options.methods}
    sets: dict[str, Any] = {}
    if options.data:
        cases = sample_cases(options.data)[: options.count]
        sets["samples"] = score_methods(methods, cases)
    if options.photos is not None:
        whole = {name: method for name, method in methods.items() if name not in NEEDS_SHAPE}
        sets["photos"] = score_methods(whole, photo_cases(options.photos)[: options.count])
    write_figures(options.json_path, command, {"sets": sets})
    for name, rows in sets.items():
        for table in TABLES:
            if any(row in rows for row in table.rows):
                print(f"\n{name}: {table_text(table, rows)}")
    return sets


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if it went through."""
    return run_command("benchmarks.tables", Options, run, arguments)


if __name__ == "__main__":
    sys.exit(main())
