"""Loss and test curves of a training, as a picture: ``python -m benchmarks.curves RUN/curves.csv --picture PNG``."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from benchmarks.command import require_picture, run_command, write_picture
from benchmarks.report.charts import Axis, Chart, Points, page_of, scatter
from hybrid.errors import DataError, describe

Curve = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class CurvesConfig:
    """Draw the curves of a training."""

    curves: tyro.conf.Positional[Path]
    """Its ``curves.csv``."""
    picture: Path = Path("curves.png")
    """The picture to write, .png or .jpg."""

    def __post_init__(self) -> None:
        require_picture(self, "picture")


def read_curves(path: Path) -> dict[str, Curve]:
    """Points (passes in thousands, value) of each column, by name.

    Raises:
        DataError: no such file, or not one that a training wrote.
    """
    try:
        with path.open(newline="") as file:
            rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    except (OSError, ValueError, TypeError) as error:
        raise DataError(describe(what="curves", where=path, got=error, do="Name a training's curves.csv.")) from error
    if not rows or "passes" not in rows[0]:
        raise DataError(describe(what="curves", where=path, got="no rows", do="Wait for the training's first test."))
    return {name: tuple((row["passes"] / 1e3, row[name]) for row in rows) for name in rows[0] if name != "passes"}


def charts(curves: dict[str, Curve]) -> list[Chart]:
    """One chart of the losses and one of the held-out errors, of those that are in percent."""
    losses = {name.removeprefix("train_"): c for name, c in curves.items() if name.startswith("train_")}
    positive = {name: curve for name, curve in losses.items() if min(y for _, y in curve) > 0}
    tests = {
        name.removeprefix("test_").removesuffix("_percent"): curve
        for name, curve in curves.items()
        if name.startswith("test_") and name.endswith("_percent")
    }
    titled = (
        ("Loss terms, last batch", "unweighted", positive),
        ("Samples held out", "mean error, %", tests),
    )
    return [_chart(title, unit, named) for title, unit, named in titled if named]


def _chart(title: str, unit: str, curves: dict[str, Curve]) -> Chart:
    values = [y for curve in curves.values() for _, y in curve]
    last = max(x for curve in curves.values() for x, _ in curve)
    return Chart(
        title,
        Axis("thousands of images shown", 0.0, 1.05 * last, log=False),
        Axis(unit, 0.8 * min(values), 1.25 * max(values)),
        tuple(Points(name, curve) for name, curve in curves.items()),
        legend=True,
    )


def run(config: CurvesConfig, command: list[str]) -> None:
    """Draw the curves."""
    drawn = [scatter(chart) for chart in charts(read_curves(config.curves))]
    write_picture(config.picture, page_of(drawn, columns=len(drawn)))


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if it went through."""
    return run_command("benchmarks.curves", CurvesConfig, run, arguments)


if __name__ == "__main__":
    sys.exit(main())
