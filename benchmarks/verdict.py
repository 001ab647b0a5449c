"""Whether films that are called ``OK`` are right: ``python -m benchmarks.verdict --data DIR [DIR ...] --json OUT``.

Photos of data sets are rectified, and their errors compared with the probability that ``hybrid.rectify.verdict.trust``
gives them and with the error that it expects. The verdict's weights are also fitted anew (``verdict_fit.py``), and
judged on sheets that they were not fitted to.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from tqdm import tqdm

from benchmarks.command import run_command, write_figures
from benchmarks.machine import shown_sources
from benchmarks.photos.cases import Case, read_alike, sample_cases
from benchmarks.scores import LATTICE
from benchmarks.verdict_fit import Judged, fit_chance, fit_error, trust_of_others
from hybrid.backward import end_point_error
from hybrid.effort import Effort, RectifyConfig
from hybrid.errors import DataError, HybridError, describe, require_at_least
from hybrid.pipeline import Rectifier
from hybrid.records import RectifyResult
from hybrid.rectify.verdict.trust import TrustConfig, chance_right, expected_error_px, film_verdict
from hybrid.workers import shared_out

BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.97, np.nextafter(1.0, 2.0))
"""Bounds of the bins of probability in which films are counted."""


@dataclass(frozen=True)
class Options:
    """Judge whether films that are called OK are right, and fit the verdict's weights anew."""

    data: tuple[Path, ...]
    """Data sets made by data_gen.generate."""

    json_path: Annotated[Path, tyro.conf.arg(name="json")]
    """File for all figures, and the signs of each film."""

    effort: Effort = "default"
    """How much work to spend on a photo."""

    every: int = 1
    """Take every so many of the photos."""

    workers: int = 2
    """Photos judged at a time, each by a process."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "every", "workers")


# ---------------------------------------------------------------- judging photos


@dataclass(frozen=True, eq=False)
class Rectifiers:
    """once: does not go on where it is in doubt. whole: does what its effort says."""

    once: Rectifier
    whole: Rectifier

    @staticmethod
    def of(effort: Effort) -> Rectifiers:
        """The rectifiers for an effort."""
        config = RectifyConfig.of(effort)
        return Rectifiers(Rectifier(replace(config, tries=0)), Rectifier(config))


def judged(rectifiers: Rectifiers, case: Case) -> Judged | None:
    """The film of a data set's photo; None where none is found. A film that was refined again includes its first
    result."""
    photo = case.photo()
    found = _judged(rectifiers.whole(photo), case)
    if found is None or not found.signs.doubted:
        return found
    return replace(found, first=_judged(rectifiers.once(photo), case))


def _judged(result: RectifyResult, case: Case) -> Judged | None:
    """A film that was found, read whichever way comes nearest to the truth."""
    if result.backward is None or result.signs is None:
        return None
    near, _ = read_alike(result.backward, case.backward)
    error = float(end_point_error(near, case.backward.lattice(LATTICE)).mean())
    return Judged(_sheet(case), _record(case)["photo"], error, result.signs)


def _record(case: Case) -> dict[str, Any]:
    assert not isinstance(case.source, Path)
    shard, k = case.source
    return shard.record(k)


def _sheet(case: Case) -> str:
    """Which sheet, bent once, a data set's photo shows; distant data sets of one name are told apart by their seed.

    Raises:
        DataError: it shows none that data_gen.generate made.
    """
    assert not isinstance(case.source, Path)
    folder, record = case.source[0].path.parent, _record(case)
    if "film" not in record:
        do = "Name data sets made by data_gen.generate."
        raise DataError(describe(what="A sample that does not say which sheet it is of", where=folder, do=do))
    return f"{shown_sources(folder)} {record.get('seed', '-')} {record['film']}"


def judge_all(options: Options) -> tuple[list[Judged], int]:
    """The films that are found, and the number of photos.

    Raises:
        DataError: a data set cannot be read.
    """
    cases, found = sample_cases(options.data)[:: options.every], list[Judged]()
    if len({_sheet(case) for case in cases}) < 2:
        do = "Name more data, or a smaller --every."
        what = "Data to fit weights to, and judge others by"
        raise DataError(describe(what=what, got="photos of one sheet", allowed="two or more", do=do))
    rectifiers = partial(Rectifiers.of, options.effort)
    for answer in tqdm(shared_out(judged, rectifiers, cases, options.workers), total=len(cases), unit="photo"):
        if isinstance(answer, HybridError):
            raise answer
        found += [] if answer is None else [answer]
    return found, len(cases)


# ---------------------------------------------------------------- figures


def figures(films: Sequence[Judged], photos: int, trust: TrustConfig) -> dict[str, Any]:
    """How many films are right, called ``OK``, and called so wrongly, with the options' weights and with weights fitted
    to other sheets; how often films of a given probability are right; the error as a multiple of the expected one
    (quantiles); and the weights fitted to all films. Of a film that was refined again, the options decide which result
    counts."""
    counted_films = [one.that_counts(trust) for one in films]
    right = np.array([one.right(trust) for one in counted_films])
    chances = np.array([chance_right(one.signs, trust) for one in counted_films])
    ratios = [one.error_px / expected_error_px(one.signs, trust) for one in counted_films]
    parts = [(low, high, (chances >= low) & (chances < high)) for low, high in pairwise(BINS)]
    return {
        "photos": photos,
        "films": len(films),
        "refined_again": sum(one.signs.doubted for one in counted_films),
        "right": int(right.sum()),
        "packaged": counted(films, [trust] * len(films)),
        "fitted_to_others": counted(films, trust_of_others(films, trust)),
        "by_probability": [
            {"from": low, "to": min(high, 1.0), "films": int(part.sum()), "right": int(right[part].sum())}
            for low, high, part in parts
        ],
        "error_in_expected": {str(q): float(np.quantile(ratios, q)) for q in (0.1, 0.5, 0.9)},
        "fitted": {"chance": asdict(fit_chance(films, trust)), "error": asdict(fit_error(films))},
    }


def counted(films: Sequence[Judged], trust: Sequence[TrustConfig]) -> dict[str, int]:
    """Films called ``OK``, each with its own options, and how many of these are not right."""
    each = [(one.that_counts(options), options) for one, options in zip(films, trust, strict=True)]
    called = [one.right(options) for one, options in each if film_verdict(one.signs, options).ok]
    return {"ok": len(called), "wrong": len(called) - sum(called)}


# ---------------------------------------------------------------- the command


def run(options: Options, command: list[str]) -> dict[str, Any]:
    """Judge, print the figures, and write them as JSON."""
    films, photos = judge_all(options)
    found = figures(films, photos, RectifyConfig.of(options.effort).trust)
    write_figures(options.json_path, command, {"figures": found, "films": [asdict(one) for one in films]})
    print(f"{found['films']} films in {photos} photos, {found['right']} right, {found['refined_again']} refined again")
    for name, whose in (("packaged", "packaged weights"), ("fitted_to_others", "weights fitted to other sheets")):
        print(f"{whose}: {found[name]['ok']} OK, {found[name]['wrong']} of them wrongly")
    for part in found["by_probability"]:
        print(f"  {part['from']:.0%} to {part['to']:.0%} sure: {part['right']} of {part['films']} right")
    low, middle, high = found["error_in_expected"].values()
    print(f"error in what was expected: {middle:.2f} at the median, 80 % from {low:.2f} to {high:.2f}")
    for name, weights in found["fitted"].items():
        print(f"{name}: {', '.join(f'{key}={value}' for key, value in weights.items())}")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if it went through."""
    return run_command("benchmarks.verdict", Options, run, arguments)


if __name__ == "__main__":
    sys.exit(main())
