"""Figures over photos: medians, quartiles and counts of what ``benchmarks.run`` measured."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.results import CaseNote, Measured, MethodNote, Report

FLOOR = "remap"
MAIN = "hybrid"

FIGURES: dict[str, Callable[[Measured], float | None]] = {
    "end_point_px": lambda m: m.score and m.score.end_point_px,
    "end_point_percent": lambda m: m.score and m.score.end_point_percent,
    "distortion_px": lambda m: m.score and m.score.distortion_px,
    "psnr": lambda m: m.score and m.score.paper.raw.psnr,
    "ssim": lambda m: m.score and m.score.paper.raw.ssim,
    "ms_ssim": lambda m: m.score and m.score.paper.raw.ms_ssim,
    "psnr_deshifted": lambda m: m.score and m.score.paper.deshifted.psnr,
    "ssim_deshifted": lambda m: m.score and m.score.paper.deshifted.ssim,
    "ms_ssim_deshifted": lambda m: m.score and m.score.paper.deshifted.ms_ssim,
    "film_lit": lambda m: m.film and m.film.lit_psnr,
    "film": lambda m: m.film and m.film.psnr,
}
"""Figures of one photo; None where it has none."""


@dataclass(frozen=True)
class Row:
    """A method at a size, over the photos. figures: medians over photos with a film; worst_px: of end_point_px.

    seconds: median, first and third quartile, and least of all calls.
    """

    method: MethodNote
    megapixels: float
    photos: int
    lost: int
    up: int
    figures: dict[str, float]
    worst_px: float | None
    seconds: tuple[float, float, float, float]
    cpu_seconds: float
    own_mib: float | None

    @property
    def error(self) -> float | None:
        """Median end-point error, if the method is scored and found a film."""
        return self.figures.get("end_point_px")


def rows_of(report: Report, megapixels: float) -> list[Row]:
    """All methods measured at a size, in the order of the report."""
    memory = {(m.method, m.megapixels): m.own_mib for m in report.memory}
    rows = []
    for method in report.methods:
        found = [m for m in report.measured if (m.method, m.megapixels) == (method.name, megapixels)]
        if found:
            rows.append(row_of(method, found, memory.get((method.name, megapixels))))
    return rows


def row_of(method: MethodNote, measured: Sequence[Measured], own_mib: float | None = None) -> Row:
    """The figures of one method over some photos of one size."""
    times = [t for m in measured for t in m.seconds]
    low, middle, high = (float(q) for q in np.quantile(times, (0.25, 0.5, 0.75)))
    values = {name: _known(figure, measured) for name, figure in FIGURES.items()}
    return Row(
        method=method,
        megapixels=measured[0].megapixels,
        photos=len(measured),
        lost=0 if method.unscored else sum(not m.found for m in measured),
        up=sum(m.score is not None and m.score.up for m in measured),
        figures={name: statistics.median(known) for name, known in values.items() if known},
        worst_px=max(values["end_point_px"], default=None),
        seconds=(middle, low, high, min(times)),
        cpu_seconds=statistics.median(t for m in measured for t in m.cpu_seconds),
        own_mib=own_mib,
    )


def _known(figure: Callable[[Measured], float | None], measured: Sequence[Measured]) -> list[float]:
    return [value for m in measured if (value := figure(m)) is not None]


# ---------------------------------------------------------------- splits

SPLITS: dict[str, Callable[[CaseNote], str]] = {
    "cell style": lambda c: c.style,
    "light": lambda c: c.light,
    "bend": lambda c: "unknown" if c.bend_deg is None else _range(c.bend_deg, (10.0, 30.0), "degrees"),
    "coverage": lambda c: _range(100 * c.coverage, (25.0, 50.0), "% of the photo"),
}
"""Kinds of photos by what they are split by."""


def _range(value: float, bounds: tuple[float, float], unit: str) -> str:
    low, high = bounds
    if value < low:
        return f"under {low:g} {unit}"
    return f"{low:g} to {high:g} {unit}" if value < high else f"over {high:g} {unit}"


def split_rows(report: Report, method: str, megapixels: float) -> list[tuple[str, str, Row]]:
    """A method's figures apart for each kind of photo: what is split by, the kind, the figures."""
    note = next(m for m in report.methods if m.name == method)
    cases = {c.name: c for c in report.cases}
    chosen = [m for m in report.measured if (m.method, m.megapixels) == (method, megapixels)]
    rows = []
    for title, kind_of in SPLITS.items():
        kinds: dict[str, list[Measured]] = {}
        for one in chosen:
            kinds.setdefault(kind_of(cases[one.case]), []).append(one)
        rows += [(title, kind, row_of(note, kinds[kind])) for kind in sorted(kinds)]
    return rows


# ---------------------------------------------------------------- who wins


@dataclass(frozen=True)
class Duel:
    """A method against a rival at a size: ratios above 1 are in the method's favour.

    faster: by the clock. cheaper: by processor seconds. closer: None where one has no error.
    """

    rival: MethodNote
    megapixels: float
    faster: float
    cheaper: float
    closer: float | None


def duels(report: Report, rivals: Sequence[str], method: str = MAIN) -> list[Duel]:
    """How many times as fast, by the clock and by processor seconds, and as near to the truth, a method is."""
    found = []
    for megapixels in report.settings.sizes:
        rows = {row.method.name: row for row in rows_of(report, megapixels)}
        for rival in rivals:
            if method in rows and rival in rows:
                mine, other = rows[method], rows[rival]
                closer = None if not mine.error or other.error is None else other.error / mine.error
                found.append(
                    Duel(
                        other.method,
                        megapixels,
                        other.seconds[0] / mine.seconds[0],
                        other.cpu_seconds / mine.cpu_seconds,
                        closer,
                    )
                )
    return found


__all__ = ["FIGURES", "FLOOR", "MAIN", "SPLITS", "Duel", "Row", "duels", "row_of", "rows_of", "split_rows"]
