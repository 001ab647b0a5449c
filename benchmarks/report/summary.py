"""Figures over photos: medians, quartiles and counts of what ``benchmarks.run`` measured."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from benchmarks.report.results import CaseNote, Measured, MethodNote, Report

Item = TypeVar("Item")

FLOOR = "remap"
"""The method that no other can be faster than."""

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
    "sides_percent": lambda m: None if m.sides is None else 100 * m.sides,
}
"""Figures of one photo; None where it has none."""


@dataclass(frozen=True)
class Row:
    """A method at a size, over the photos. figures: medians over photos with a film; worst_px: of end_point_px.

    seconds: median, first and third quartile, and least of all calls. output: median megapixels of the flat film. ok:
    films that the method calls flattened, wrongly_ok: those of them that are further off than that allows; None for
    methods that give no status.
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
    output: float | None
    ok: int | None = None
    wrongly_ok: int | None = None

    @property
    def error(self) -> float | None:
        """Median end-point error, if the method is scored and found a film."""
        return self.figures.get("end_point_px")


def rows_of(report: Report, megapixels: float) -> list[Row]:
    """All methods measured at a size, in the order of the report."""
    rows = []
    for method in report.methods:
        found = [m for m in report.measured if (m.method, m.megapixels) == (method.name, megapixels)]
        if found:
            rows.append(row_of(method, found))
    return rows


def row_of(method: MethodNote, measured: Sequence[Measured]) -> Row:
    """The figures of one method over some photos of one size."""
    times = [t for m in measured for t in m.seconds]
    low, middle, high = (float(q) for q in np.quantile(times, (0.25, 0.5, 0.75)))
    sizes = [m.output[0] * m.output[1] / 1e6 for m in measured if m.output is not None]
    values = {name: _known(figure, measured) for name, figure in FIGURES.items()}
    claims = [m.claim for m in measured if m.claim is not None]
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
        output=statistics.median(sizes) if sizes else None,
        ok=sum(claim.ok for claim in claims) if claims else None,
        wrongly_ok=sum(m.wrongly_ok for m in measured) if claims else None,
    )


def _known(figure: Callable[[Measured], float | None], measured: Sequence[Measured]) -> list[float]:
    return [value for m in measured if (value := figure(m)) is not None]


def spread(items: Sequence[Item], count: int) -> list[Item]:
    """The given number of items, evenly spaced from first to last."""
    chosen = min(count, len(items))
    return [items[k * len(items) // chosen] for k in range(chosen)]


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


def _order(kind: str) -> tuple[int, str]:
    """What is under a bound before what is over it."""
    return kind.startswith("over ") - kind.startswith("under "), kind


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
        rows += [(title, kind, row_of(note, kinds[kind])) for kind in sorted(kinds, key=_order)]
    return rows


# ---------------------------------------------------------------- who wins


@dataclass(frozen=True)
class Duel:
    """A method against a rival at a size: ratios above 1 are in the method's favour.

    faster: by the clock. cheaper: by processor seconds. closer: by the median error; None where one has none.
    nearer, both: on how many photos the method is nearer to the truth, of how many on which both are scored.
    """

    method: MethodNote
    rival: MethodNote
    megapixels: float
    faster: float
    cheaper: float
    closer: float | None
    nearer: int = 0
    both: int = 0

    @property
    def lost(self) -> bool:
        """Whether the method does not beat the rival in both time and error, as far as they can be compared."""
        return min(self.faster, self.cheaper) < 1 or (self.closer is not None and self.closer < 1)


def duels(report: Report, rivals: Collection[str], method: str) -> list[Duel]:
    """How many times as fast, by the clock and by processor seconds, and as near to the truth, a method is."""
    found = []
    for megapixels in report.settings.sizes:
        rows = {row.method.name: row for row in rows_of(report, megapixels)}
        for rival in (row for name, row in rows.items() if method in rows and name in rivals):
            mine = rows[method]
            pairs = _errors_of_both(report, method, rival.method.name, megapixels)
            found.append(
                Duel(
                    mine.method,
                    rival.method,
                    megapixels,
                    rival.seconds[0] / mine.seconds[0],
                    rival.cpu_seconds / mine.cpu_seconds,
                    None if not mine.error or rival.error is None else rival.error / mine.error,
                    sum(a < b for a, b in pairs),
                    len(pairs),
                )
            )
    return found


def _errors_of_both(report: Report, method: str, rival: str, megapixels: float) -> list[tuple[float, float]]:
    """End-point errors of a method and its rival on the photos of a size on which both are scored."""
    errors = {
        (m.method, m.case): m.score.end_point_px for m in report.measured if m.megapixels == megapixels and m.score
    }
    cases = [case.name for case in report.cases]
    return [(errors[method, c], errors[rival, c]) for c in cases if {(method, c), (rival, c)} <= set(errors)]


__all__ = ["FIGURES", "FLOOR", "SPLITS", "Duel", "Row", "duels", "row_of", "rows_of", "split_rows", "spread"]
