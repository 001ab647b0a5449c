"""What the page of the benchmarks says, in Markdown, read off the figures: nothing in it is written by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.lineup import CONFIGURATIONS
from benchmarks.results import Report
from benchmarks.stress_records import SoakReport, StabilityReport
from benchmarks.summary import MAIN, Duel, Row, duels, rows_of, split_rows

RIVALS = ("scanner", "scanner_true", "dewarpnet_published", "dewarpnet", "firenet")


@dataclass(frozen=True)
class Results:
    """What a page is made of. gallery: whether the photos themselves may be shown, and a picture of them is there."""

    run: Report
    stability: StabilityReport | None = None
    soak: SoakReport | None = None
    gallery: bool = False


def page_text(results: Results) -> str:
    """The whole page, in Markdown."""
    report = results.run
    parts = [
        "# Benchmarks\n\n" + _how(report),
        "## Time against error\n\n![Seconds against error at each size](images/benchmarks_time_error.png)",
        *(size_section(report, size) for size in report.settings.sizes),
        "## Who wins\n\n" + duel_text(duels(report, RIVALS)),
        "## Kinds of photos\n\n" + _split_text(report),
        "## What the parts are worth\n\n" + _configuration_text(report),
        "## Networks alone\n\n" + _forward_text(report),
    ]
    if results.gallery:
        parts.append(
            "## Best, median, worst\n\n![Photo with what was found, film, error](images/benchmarks_gallery.jpg)"
        )
    if results.stability is not None:
        parts.append("## Stability\n\n" + _stability_text(results.stability))
    if results.soak is not None:
        parts.append("## A thousand films\n\n" + _soak_text(results.soak))
    return "\n\n".join(part for part in parts if part) + "\n"


def _how(report: Report) -> str:
    run, settings = report.run, report.settings
    machine, packages = run["machine"], run["packages"]
    versions = ", ".join(f"{name} {version}" for name, version in packages.items() if version)
    untrained = sorted(m.label for m in report.methods if m.unscored == "not trained")
    upscaled = [f"{s:g}" for s in settings.sizes if any(s * 1e6 > 1.25 * c.size[0] * c.size[1] for c in report.cases)]
    lines = [
        "This page is made by a script from its own figures; no line of it is written by hand. To make it again:",
        f"\n```bash\n{run['command']}\n```\n",
        f"{machine['processor']}, {machine['usable_processors']} usable processors, {machine['memory_gib']} GiB; "
        f"threads for every method: {settings.threads}; Python {run['python']}, {versions}; commit "
        f"{run['commit']}; {run['time_utc'][:10]}.\n",
        f"**How.** {len(report.cases)} photos whose true geometry is known ({settings.source}). Timed "
        f"calls of every method on each photo: {settings.repeats}, after one at each size that does not count; the "
        "methods take turns on each photo. Seconds go from the photo in memory to the flat film in memory: median over "
        "all calls, quartiles in brackets; processor seconds are those of all threads, which other work on the machine "
        "disturbs less. Memory is the peak of a fresh process, beyond what the libraries and the photo hold.\n",
        "**Error.** *End-point error*: mean distance over the film between found and true photo points, in pixels of a "
        "photo of 1080 and in percent of the film's diagonal. *Distortion*: the same distance on the flat film, in "
        "pixels of one of 598,400. *PSNR, SSIM, MS-SSIM*: the paper's protocol, raw and (in brackets) de-shifted, "
        "which takes the truth to know. *Film*: dB of the film against its print after one gain and offset, with the "
        "light (in brackets) and without. Medians over photos; films that were not found are counted, and stay out.",
    ]
    wanted = machine.get("load")
    if wanted is not None and wanted > machine["usable_processors"] + 1:
        lines.append(
            f"\n**The machine was busy**: {wanted:g} processes shared {machine['usable_processors']} processors, so "
            "seconds by the clock are several times too long and scatter; only processor seconds can be compared."
        )
    if upscaled:
        lines.append(
            f"\nPhotos of {', '.join(upscaled)} megapixels are smaller ones scaled up, and their truth with them: good "
            "for run time and memory, but they hold no more detail."
        )
    if untrained:
        lines.append(
            f"\n**Not trained:** {', '.join(untrained)}. No weights of these were at hand. Their run time is measured "
            "with networks of the published width and random weights, on whose values it does not depend; for what "
            "follows the network, its output is replaced by the true one. They have no error until they are trained."
        )
    return "\n".join(lines)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def size_section(report: Report, megapixels: float) -> str:
    """All methods at one size, as a table."""
    rows = [row for row in rows_of(report, megapixels) if row.method.name not in CONFIGURATIONS]
    head = ("", "photos", "lost", "error, px", "worst", "%", "distortion", "PSNR", "SSIM", "MS-SSIM", "film, dB")
    head += ("seconds", "processor s", "memory, MiB")
    return f"### {megapixels:g} megapixels\n\n" + table(head, [_cells(row) for row in rows])


def _cells(row: Row) -> list[str]:
    f, t = row.figures, row.seconds
    lost = row.method.unscored or str(row.lost)
    both = [pair(f.get(name), f.get(f"{name}_deshifted"), d) for name, d in (("psnr", 1), ("ssim", 3), ("ms_ssim", 3))]
    return [
        row.method.label,
        str(row.photos),
        lost,
        number(f.get("end_point_px"), 2),
        number(row.worst_px, 2),
        number(f.get("end_point_percent"), 2),
        number(f.get("distortion_px"), 2),
        *both,
        pair(f.get("film"), f.get("film_lit"), 1),
        f"{t[0]:.3g} ({t[1]:.3g} to {t[2]:.3g})",
        f"{row.cpu_seconds:.3g}",
        number(row.own_mib, 0),
    ]


def number(value: float | None, places: int) -> str:
    return "-" if value is None else f"{value:.{places}f}"


def pair(value: float | None, other: float | None, places: int) -> str:
    return "-" if value is None and other is None else f"{number(value, places)} ({number(other, places)})"


def duel_text(found: Sequence[Duel]) -> str:
    """How `hybrid` does against each rival, and in a sentence where it loses."""
    rows = [
        [
            d.rival.label,
            f"{d.megapixels:g}",
            f"{d.faster:.2g}",
            f"{d.cheaper:.2g}",
            d.rival.unscored or ("-" if d.closer is None else f"{d.closer:.2g}"),
        ]
        for d in found
    ]
    slower = sorted({f"{d.rival.label} at {d.megapixels:g} MP" for d in found if d.faster < 1})
    farther = sorted(
        {f"{d.rival.label} at {d.megapixels:g} MP" for d in found if d.closer is not None and d.closer < 1}
    )
    said = [
        f"It is slower than: {', '.join(slower)}." if slower else "It is faster than each of them at every size.",
        f"Its error is larger than that of: {', '.join(farther)}."
        if farther
        else "Its error is the smallest wherever two errors can be compared.",
    ]
    head = ("`hybrid` against", "megapixels", "times as fast", "by processor seconds", "times as near to the truth")
    return table(head, rows) + "\n\n" + " ".join(said)


def _split_text(report: Report) -> str:
    size = report.settings.sizes[0]
    if MAIN not in {m.name for m in report.methods}:
        return "`hybrid` was not run."
    rows = [
        [title, kind, str(row.photos), str(row.lost), number(row.error, 2), number(row.worst_px, 2)]
        for title, kind, row in split_rows(report, MAIN, size)
    ]
    head = ("", f"`hybrid` at {size:g} megapixels", "photos", "lost", "error, px", "worst")
    return table(head, rows) + "\n\n![Error against bend](images/benchmarks_bend.png)"


def _configuration_text(report: Report) -> str:
    size = report.settings.sizes[0]
    rows = [r for r in rows_of(report, size) if r.method.name in {*CONFIGURATIONS, MAIN, "filmnet"}]
    cells = [
        [
            r.method.label,
            number(r.error, 2),
            number(r.worst_px, 2),
            number(r.figures.get("film"), 1),
            f"{r.cpu_seconds:.3g}",
        ]
        for r in rows
    ]
    head = (f"at {size:g} megapixels", "error, px", "worst", "film, dB", "processor s")
    return table(head, cells) + "\n\n![Seconds by stage](images/benchmarks_stages.png)"


def _forward_text(report: Report) -> str:
    rows = [
        [
            f.network,
            f"{f.parameters / 1e6:.1f}",
            f.device,
            str(f.batch),
            str(f.input_px),
            f"{1e3 * sorted(f.seconds)[len(f.seconds) // 2]:.1f}",
        ]
        for f in report.forward
    ]
    head = ("network", "million parameters", "device", "batch", "input, px", "ms")
    none = "" if any(f.device == "cuda" for f in report.forward) else "\n\nNo GPU was at hand (`--device cuda`)."
    return table(head, rows) + none


def _stability_text(stability: StabilityReport) -> str:
    rows = [
        [part.name, part.what, str(part.tried), str(part.refused), str(part.failed), f"{part.worst:.3g} {part.unit}"]
        for part in stability.parts
    ]
    counts = stability.counts()
    verdict = (
        f"Of {len(stability.photos)} damaged photos {counts['ok']} were reported ok, {counts['unsure']} flattened with "
        f"a warning ({stability.cautious} of these were right after all), {counts['refused']} refused with a reason. "
        f"Crashes: {counts['crash']}; hangs: {counts['hang']}; NaN: {counts['nan']}; reported ok but more than "
        f"{stability.truthful_px:g} px off: {counts['untruthful']}; refused though a right map was there: "
        f"{counts['lost']}."
    )
    damages = [
        [d.damage, str(d.photos), str(d.ok), str(d.unsure), str(d.refused), str(d.failed)]
        for d in stability.by_damage()
    ]
    return (
        f"```bash\n{stability.run['command']}\n```\n\n"
        + table(("part", "what", "tried", "refused", "failed", "worst residual"), rows)
        + f"\n\n{verdict}\n\n"
        + table(("damage", "photos", "ok", "unsure", "refused", "failed"), damages)
    )


def _soak_text(soak: SoakReport) -> str:
    return (
        f"```bash\n{soak.run['command']}\n```\n\n"
        f"{soak.films} films in one process: memory {soak.memory_mib[0]:.0f} MiB after {soak.settled} films, "
        f"{soak.memory_mib[-1]:.0f} MiB at the end ({100 * soak.memory_growth():+.1f} %); a film takes "
        f"{100 * soak.time_drift():+.1f} % longer in the last fifth than in the first (processor seconds); "
        f"{soak.different} results differ from those of the same photo before."
    )


__all__ = ["Results", "duel_text", "number", "page_text", "pair", "size_section", "table"]
