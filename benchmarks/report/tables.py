"""The tables of the page and of the terminal, in Markdown, made from the figures of ``benchmarks.run``."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from benchmarks.lineup import CONFIGURATIONS, EFFORTS, MAIN, OWN
from benchmarks.report.results import Report
from benchmarks.report.summary import FLOOR, Duel, Row, duels, rows_of, split_rows, spread
from benchmarks.report.surroundings_records import SurroundingsReport

PHOTOS_SHOWN = 24
"""Photos that are listed one by one: the best, the worst and those between, evenly."""


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def number(value: float | None, places: int) -> str:
    """A figure, or a dash where there is none."""
    return "-" if value is None else f"{value:.{places}f}"


def pair(value: float | None, other: float | None, places: int) -> str:
    """A figure and, in brackets, its other version."""
    return "-" if value is None and other is None else f"{number(value, places)} ({number(other, places)})"


def rivals_of(report: Report) -> list[str]:
    """All methods but this project's and the floor."""
    return [m.name for m in report.methods if m.name not in OWN and m.name != FLOOR]


def efforts_of(report: Report) -> list[str]:
    """The pipeline at the efforts that were measured."""
    return [m.name for m in report.methods if m.name in EFFORTS]


# ---------------------------------------------------------------- methods


def size_section(report: Report, megapixels: float) -> str:
    """All methods at one size, as a table."""
    rows = [row for row in rows_of(report, megapixels) if row.method.name not in CONFIGURATIONS]
    floor = next((row for row in rows if row.method.name == FLOOR), None)
    head = ("", "photos", "lost", "upright", "error, px", "worst", "%", "distortion", "PSNR", "SSIM", "MS-SSIM")
    head += ("film, dB", "sides, %", "seconds", "processor s", "times the floor", "output, MP")
    shown = [_cells(row, floor) for row in rows]
    if any(row.ok is not None for row in rows):
        head += ("`OK` (wrongly)",)
        called = ("-" if row.ok is None else f"{row.ok} ({row.wrongly_ok})" for row in rows)
        shown = [[*cells, cell] for cells, cell in zip(shown, called, strict=True)]
    return f"### {megapixels:g} megapixels\n\n" + table(head, shown)


def _cells(row: Row, floor: Row | None) -> list[str]:
    f, t = row.figures, row.seconds
    both = [pair(f.get(name), f.get(f"{name}_deshifted"), d) for name, d in (("psnr", 1), ("ssim", 3), ("ms_ssim", 3))]
    return [
        row.method.label,
        str(row.photos),
        row.method.unscored or str(row.lost),
        f"{row.up} of {row.photos - row.lost}" if row.method.says_up and not row.method.unscored else "-",
        number(row.error, 2),
        number(row.worst_px, 2),
        number(f.get("end_point_percent"), 2),
        number(f.get("distortion_px"), 2),
        *both,
        pair(f.get("film"), f.get("film_lit"), 1),
        number(f.get("sides_percent"), 2),
        f"{t[0]:.3g} ({t[1]:.3g} to {t[2]:.3g})",
        f"{row.cpu_seconds:.3g}",
        "-" if floor is None else f"{t[0] / floor.seconds[0]:.3g} ({row.cpu_seconds / floor.cpu_seconds:.3g})",
        number(row.output, 2),
    ]


def surroundings_table(report: SurroundingsReport) -> str:
    """A row for each change, in Markdown."""
    head = ("", "photos", "network alone, px", "to 10 px")
    rows = [[c.what, str(c.photos), number(c.network_px, 2), str(c.network_to_10)] for c in report.counts]
    if report.whole:
        head += ("found", "film, px", "to 1 px", "to 5 px", "`OK` (wrongly)")
        for row, c in zip(rows, report.counts, strict=True):
            row += [str(c.found), number(c.film_px, 2), str(c.to_1), str(c.to_5), f"{c.ok} ({c.wrong})"]
    return table(head, rows)


def memory_text(report: Report) -> str:
    """Memory of each method beyond the libraries and the photo, at each size."""
    sizes = list(dict.fromkeys(m.megapixels for m in report.memory))
    known = {(m.method, m.megapixels): f"{m.own_mib:.0f}" for m in report.memory}
    labels = {m.name: m.label for m in report.methods}
    names = list(dict.fromkeys(m.method for m in report.memory))
    rows = [[labels.get(name, name), *(known.get((name, size), "-") for size in sizes)] for name in names]
    return table(("MiB at", *(f"{size:g} megapixels" for size in sizes)), rows) if rows else "Not measured."


def forward_text(report: Report) -> str:
    """Times of the networks alone, with columns for a GPU if one was at hand."""
    times = {(f.network, f.device, f.batch): (min(f.seconds), min(f.cpu_seconds)) for f in report.forward}
    columns = list(dict.fromkeys((f.device, f.batch) for f in report.forward))
    kinds = {f.network: (f"{f.parameters / 1e6:.1f}", str(f.input_px)) for f in report.forward}
    rows = [
        [name, *kind, *(_forward_ms(times.get((name, *column)), column[0]) for column in columns)]
        for name, kind in kinds.items()
    ]
    head = [f"{'GPU' if device == 'cuda' else 'processor'}, batch of {batch}, ms" for device, batch in columns]
    none = "" if any(f.device == "cuda" for f in report.forward) else " No GPU was at hand."
    note = f"\n\nThe fastest of several passes; in brackets processor time over all threads.{none}"
    return table(("network", "million parameters", "input, px", *head), rows) + note


def _forward_ms(seconds: tuple[float, float] | None, device: str) -> str:
    """Milliseconds, with processor time if the network runs on the processor."""
    if seconds is None:
        return "-"
    clock, cpu = (number(1e3 * value, 1) for value in seconds)
    return clock if device == "cuda" else f"{clock} ({cpu})"


# ---------------------------------------------------------------- who wins


def duel_text(found: Sequence[Duel]) -> str:
    """A method compared with each rival, at every size."""
    sizes = list(dict.fromkeys(d.megapixels for d in found))
    rows = []
    for of_rival in _by_rival(found):
        at, rival = {d.megapixels: d for d in of_rival}, of_rival[0].rival
        times = (f"{at[size].faster:.2g} ({at[size].cheaper:.2g})" if size in at else "-" for size in sizes)
        near = ", ".join(f"{d.closer:.2g}" for d in of_rival if d.closer is not None)
        nearer, both = of_rival[0].nearer, of_rival[0].both  # larger photos are the same ones scaled up
        rows.append([rival.label, *times, rival.unscored or near or "-", f"{nearer} of {both}" if both else "-"])
    head = (f"`{found[0].method.label}` against" if found else "against", *(f"times as fast, {s:g} MP" for s in sizes))
    return table((*head, "times as near to the truth", "photos on which it is nearer"), rows)


def losses_text(report: Report) -> str:
    """Every rival that some effort does not beat in both time and error, and kinds of photos on which one is nearer."""
    if not efforts_of(report):
        return "`hybrid` was not run."
    lines = []
    for name in efforts_of(report):
        lost = [duel for duel in duels(report, rivals_of(report), name) if duel.lost]
        lines += [_losses(of_rival) for of_rival in _by_rival(lost)]
        lines += _lost_kinds(report, name)
        lines += _lost_films(report, name)
    if not lines:
        return "Nothing: it is faster than every rival, and more accurate wherever two errors can be compared."
    return "\n".join(lines)


def _by_rival(found: Sequence[Duel]) -> list[list[Duel]]:
    """The same, grouped by rival."""
    names = dict.fromkeys(d.rival.name for d in found)
    return [[d for d in found if d.rival.name == name] for name in names]


def _losses(found: Sequence[Duel]) -> str:
    """What a method loses to one rival, and at which sizes."""
    slower = [d for d in found if min(d.faster, d.cheaper) < 1]
    further = [(d.megapixels, 1 / d.closer) for d in found if d.closer is not None and d.closer < 1]
    said = []
    if slower:
        times = ", ".join(f"{1 / d.faster:.2g} ({1 / d.cheaper:.2g})" for d in slower)
        sizes = ", ".join(f"{d.megapixels:g}" for d in slower)
        said.append(f"{times} times its seconds (processor seconds) at {sizes} MP")
    if further:
        times, sizes = ", ".join(f"{t:.2g}" for _, t in further), ", ".join(f"{s:g}" for s, _ in further)
        said.append(f"{times} times its error at {sizes} MP")
    return f"- `{found[0].method.label}` against {found[0].rival.label}: {'; '.join(said)}"


def _lost_films(report: Report, name: str) -> list[str]:
    """Films that a method did not find, or did not put upright, at the first size."""
    rows = [row for row in rows_of(report, report.settings.sizes[0]) if row.method.name == name]
    told = []
    for row in rows:
        turned = row.photos - row.lost - row.up if row.method.says_up else 0
        if row.lost or turned:
            told.append(f"- `{row.method.label}`: of {row.photos} films {row.lost} not found, {turned} not upright")
    return told


def _lost_kinds(report: Report, name: str) -> list[str]:
    size, label = report.settings.sizes[0], next(m.label for m in report.methods if m.name == name)
    mine = {(title, kind): row.error for title, kind, row in split_rows(report, name, size)}
    lines = []
    for rival in rivals_of(report):
        for title, kind, row in split_rows(report, rival, size):
            error = mine.get((title, kind))
            if error is not None and row.error is not None and row.error < error:
                lines.append(
                    f"- `{label}` on photos of one kind ({title}: {kind}): {error:.2f} px; {row.method.label}: "
                    f"{row.error:.2f} px"
                )
    return lines


# ---------------------------------------------------------------- photos


def split_text(report: Report) -> str:
    """The median error of every scored method on each kind of photo, and how many films it lost of them."""
    size = report.settings.sizes[0]
    scored = [m for m in report.methods if not m.unscored and m.name not in CONFIGURATIONS]
    cells: dict[tuple[str, str], dict[str, Row]] = {}
    for method in scored:
        for title, kind, row in split_rows(report, method.name, size):
            cells.setdefault((title, kind), {})[method.name] = row
    rows = []
    for (title, kind), of_kind in cells.items():
        errors = [of_kind.get(m.name) for m in scored]
        photos = max(row.photos for row in of_kind.values())
        rows.append([title, kind, str(photos), *("-" if row is None else _error(row) for row in errors)])
    head = ("", f"at {size:g} megapixels", "photos", *(m.label for m in scored))
    return table(head, rows)


def _error(row: Row) -> str:
    return number(row.error, 2) + (f", {row.lost} lost" if row.lost else "")


def photos_text(report: Report, method: str = MAIN) -> str:
    """A method at the first size, photo by photo, from best to worst; films that were lost last."""
    size, cases = report.settings.sizes[0], {case.name: case for case in report.cases}
    found = [m for m in report.measured if (m.method, m.megapixels) == (method, size)]
    found.sort(key=lambda m: float("inf") if m.score is None else m.score.end_point_px)
    rows = []
    for m in spread(found, PHOTOS_SHOWN):
        case, score = cases[m.case], m.score
        bend = "-" if case.bend_deg is None else f"{case.bend_deg:.0f}"
        figures = ["lost", m.message, "-"]
        if score is not None:
            figures = [number(value, 2) for value in (score.end_point_px, score.end_point_p95_px)]
            figures.append(number(score.paper.raw.psnr, 1))
        film = None if m.film is None else m.film.psnr
        shape = [case.style, case.light, bend, f"{100 * case.coverage:.0f}", f"{case.grid or '-'}, {m.grid or '-'}"]
        rows.append([m.case, *shape, *figures, number(film, 1), f"{statistics.median(m.seconds):.3g}"])
    head = ("photo", "cells", "light", "bend, degrees", "% of the photo", "slices: true, found")
    return table((*head, "error, px", "95th percentile", "PSNR", "film, dB", "seconds"), rows)


def configuration_text(report: Report) -> str:
    """The pipeline as it is, and with one thing changed at a time."""
    size = report.settings.sizes[0]
    rows = [r for r in rows_of(report, size) if r.method.name in OWN]
    cells = [
        [
            r.method.label,
            number(r.error, 2),
            number(r.worst_px, 2),
            str(r.lost),
            pair(r.figures.get("film"), r.figures.get("film_lit"), 1),
            f"{r.cpu_seconds:.3g}",
        ]
        for r in rows
    ]
    return table((f"at {size:g} megapixels", "error, px", "worst", "lost", "film, dB", "processor s"), cells)


def stages_text(report: Report, method: str = MAIN) -> str:
    """Median milliseconds of each stage of the pipeline, at every size."""
    found = {size: [m for m in report.measured if (m.method, m.megapixels) == (method, size)]
             for size in report.settings.sizes}  # fmt: skip
    names = list(dict.fromkeys(name for of_size in found.values() for m in of_size for name in m.parts))
    rows = []
    for name in names:
        seconds = [[m.parts.get(name, 0.0) for m in of_size] for of_size in found.values()]
        rows.append([name, *(number(1e3 * statistics.median(s) if s else None, 1) for s in seconds)])
    return table(("stage, ms", *(f"{size:g} megapixels" for size in found)), rows)


def figures_text(report: Report) -> str:
    """What the terminal shows of a run: methods by size, `hybrid` by kind of photo and photo by photo."""
    parts = [*(size_section(report, size) for size in report.settings.sizes), split_text(report)]
    if MAIN in efforts_of(report):
        parts.append(photos_text(report))
    return "\n\n".join(parts)


__all__ = [
    "configuration_text",
    "duel_text",
    "efforts_of",
    "figures_text",
    "forward_text",
    "losses_text",
    "memory_text",
    "number",
    "pair",
    "photos_text",
    "rivals_of",
    "size_section",
    "split_text",
    "stages_text",
    "table",
]
