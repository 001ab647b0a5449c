"""The text of the benchmark page, in Markdown, made from the figures: nothing in it is written by hand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from benchmarks.lineup import MAIN
from benchmarks.report.results import Report
from benchmarks.report.stress_records import SoakReport, StabilityReport
from benchmarks.report.summary import FLOOR, duels, rows_of
from benchmarks.report.surroundings_records import SurroundingsReport
from benchmarks.report.tables import (
    configuration_text,
    duel_text,
    efforts_of,
    forward_text,
    losses_text,
    memory_text,
    number,
    photos_text,
    rivals_of,
    size_section,
    split_text,
    stages_text,
    surroundings_table,
    table,
)
from benchmarks.rivals.published import TIME_ONLY


@dataclass(frozen=True)
class Results:
    """What a page is made from. gallery: whether the photos may be shown and a picture of them exists."""

    run: Report
    stability: StabilityReport | None = None
    soak: SoakReport | None = None
    surroundings: SurroundingsReport | None = None
    gallery: bool = False


def page_text(results: Results) -> str:
    """The whole page, in Markdown."""
    report = results.run
    parts = [
        "# Benchmarks\n\n" + _in_short(report),
        "## Time against error\n\n![Seconds against error at each size](images/benchmarks_time_error.png)\n\n"
        "Further left is faster, further down is more accurate; rings mark methods with a run time but no error.",
        *(size_section(report, size) for size in report.settings.sizes),
        "## Against each method\n\n" + _duels_text(report),
        "## Where it loses\n\nEvery rival that is faster or more accurate, be it on one kind of photo only:\n\n"
        + losses_text(report),
        "## Kinds of photos\n\nMedian error, px:\n\n"
        + split_text(report)
        + "\n\n![Error against bend](images/benchmarks_bend.png)",
        *_own_parts(report),
        "## Networks alone\n\n" + forward_text(report),
        "## Memory\n\n" + memory_text(report),
    ]
    if results.gallery:
        parts.append(
            "## Best, median, worst\n\n![Photo with what was found, film, error](images/benchmarks_gallery.jpg)"
        )
    if results.surroundings is not None:
        parts.append("## Surroundings\n\n" + _surroundings_text(results.surroundings))
    if results.stability is not None:
        parts.append("## Stability\n\n" + _stability_text(results.stability))
    if results.soak is not None:
        parts.append(f"## {results.soak.films} films in one process\n\n" + _soak_text(results.soak))
    parts.append("## How it is measured\n\n" + _how(report))
    return "\n\n".join(part for part in parts if part) + "\n"


def _in_short(report: Report) -> str:
    """The pipeline at the first size: a sentence for each effort."""
    size = report.settings.sizes[0]
    rows = {row.method.name: row for row in rows_of(report, size)}
    floor, lines = rows.get(FLOOR), []
    for name in efforts_of(report):
        row = rows[name]
        found = f"films not found: {row.lost} of {row.photos}"
        if row.error is not None:
            found = (
                f"{row.error:.2f} px of error on the median photo, {number(row.worst_px, 2)} px on the worst; {found}"
            )
        if row.ok is not None:
            found += f"; called `OK`: {row.ok}, of which beyond the limit: {row.wrongly_ok}"
        times = "" if floor is None else f", {row.seconds[0] / floor.seconds[0]:.3g} times `cv2.remap` alone"
        lines.append(
            f"`{row.method.label}` on {row.photos} photos of {size:g} megapixels: {found}; {row.seconds[0]:.2g} s "
            f"({row.cpu_seconds:.2g} processor seconds){times}."
        )
    lines.append(
        "A script makes this page from measured figures; no line of it is written by hand. [How it is "
        "measured](#how-it-is-measured) says how, and what the figures mean."
    )
    return "\n\n".join([*lines, *_warnings(report)])


def _duels_text(report: Report) -> str:
    if MAIN not in efforts_of(report):
        return "`hybrid` was not run."
    return duel_text(duels(report, rivals_of(report), MAIN))


def _own_parts(report: Report) -> list[str]:
    """The parts that need a run of the pipeline."""
    if MAIN not in efforts_of(report):
        return []
    return [
        "## Photo by photo\n\n" + photos_text(report),
        "## What the parts are worth\n\n" + configuration_text(report),
        "## Seconds by stage\n\n![Seconds by stage](images/benchmarks_stages.png)\n\n" + stages_text(report),
    ]


def _how(report: Report) -> str:
    run, settings = report.run, report.settings
    machine, packages = run["machine"], run["packages"]
    versions = ", ".join(f"{name} {version}" for name, version in packages.items() if version)
    trained = [f"{m.label}: {m.training}" for m in report.methods if m.training and m.name in rivals_of(report)]
    timed = sorted(m.label for m in report.methods if m.unscored == TIME_ONLY)
    lines = [
        f"To reproduce these figures:\n\n```bash\n{run['command']}\n```\n\nThe results of the other commands "
        "(`surroundings.json`, `stability.json` and `soak.json`) go into the same folder; `python -m benchmarks.page "
        "--out DIR` then makes the page.",
        f"{machine['processor']}, {machine['usable_processors']} usable processors, {machine['memory_gib']} GiB; "
        f"threads for every method: {settings.threads}; Python {run['python']}, {versions}; {_made(run)}.",
        f"**Equal footing.** {len(report.cases)} photos whose true geometry is known ({settings.source}). Only a "
        "rendered photo has a truth at every point. The project's check photos, rendered by a program that is not its "
        "own, were looked at while `hybrid` was developed, so other photos are the fairer test. Every method gets the "
        "same photos in memory and leaves the flat film in memory; the methods take turns on each photo. Where a "
        "method gives a map, the photo is interpolated through it as by `hybrid`, to a film of the size that the photo "
        "resolves. The floor is one bilinear `cv2.remap` to that film, through a map that exists already. The networks "
        "of `hybrid` compute in bfloat16 where the processor has instructions for it, the others in single precision, "
        "as published. `hybrid` folds normalisation into convolutions and lays out weights once, at loading; the rest "
        "run as PyTorch runs a trained network, which takes those of full width up to a third of their time. "
        f"Timed calls on each photo: {settings.repeats}, after one at each size that does not count; "
        "networks of full width run once on each of two photos. Seconds: median over all calls, quartiles in brackets; "
        "processor seconds add up all threads and suffer less from other work on the machine. *Times the floor*: by "
        "the clock, in brackets by processor seconds. Memory is the peak of a fresh process, beyond what the libraries "
        "and the photo hold.",
        "**Error.** *End-point error*: mean distance over the film between found and true photo points, in pixels of a "
        "photo of 1080 and in percent of the film's diagonal, whichever side of the film a method takes to be up. "
        "*Distortion*: the same distance on the flat film, in pixels of one of 598,400. *PSNR, SSIM, MS-SSIM*: the "
        "paper's protocol, raw and (in brackets) de-shifted, which needs the truth. *Film*: dB of the film against its "
        "print after one gain and offset, without the light and (in brackets) with it. *Sides*: error of the flat "
        "film's ratio of sides, in percent; none for methods that are given it. Figures are medians over photos; films "
        "that were not found are counted and left out of them.",
    ]
    limits = sorted({m.claim.limit_px for m in report.measured if m.claim and m.claim.ok and m.claim.limit_px})
    if limits:
        stated = ", ".join(dict.fromkeys(f"{limit:.3g}" for limit in limits))
        lines.append(
            "**Status.** *`OK` (wrongly)*: films that a method calls flattened and, in brackets, those of them whose "
            f"end-point error is above the limit that it states for such films ({stated} px)."
        )
    if timed:
        lines.append(
            f"**Run time of the paper's networks:** {'; '.join(timed)}. As wide as published, with random weights, as "
            "run time does not depend on their values; the steps after the network get the true map instead of its "
            "output. These rows have no error."
        )
    if trained:
        lines.append(
            f"**Error of the paper's networks:** {'; '.join(trained)}. These rows have the error of this project's "
            "weights, not of the authors', and the run time of a network of that width."
        )
    return "\n\n".join(lines)


def _made(run: dict[str, Any]) -> str:
    """The commit and the date, as some parts of the page may be older than others."""
    return f"commit {run['commit']}; {run['time_utc'][:10]}"


def _warnings(report: Report) -> list[str]:
    """What this run's figures cannot show."""
    settings, machine = report.settings, report.run["machine"]
    upscaled = [f"{s:g}" for s in settings.sizes if any(s * 1e6 > 1.25 * c.size[0] * c.size[1] for c in report.cases)]
    lines, wanted = [], machine.get("load")
    if wanted is not None and wanted > machine["usable_processors"] + 1:
        lines.append(
            f"**The machine was busy**: {wanted:g} processes shared {machine['usable_processors']} processors, so "
            "seconds by the clock are several times too long and scatter; compare processor seconds only."
        )
    if upscaled:
        lines.append(
            f"Photos of {', '.join(upscaled)} megapixels are smaller ones scaled up, along with their truth: right for "
            "run time and memory, but without more detail."
        )
    return lines


def _surroundings_text(surroundings: SurroundingsReport) -> str:
    alone = "the map that refinement starts from"
    if surroundings.sides > 1:
        alone = f"the mean of its maps from {surroundings.sides} sides; refinement starts from one of them"
    return (
        "Photos with truth, changed around the film, or by what lies on it or in the lens. Errors are geometric means, "
        "over the films found, of end-point errors in pixels of the photo before the change, scaled to 1080. "
        f"The network alone: {alone}.\n\n"
        f"```bash\n{surroundings.run['command']}\n```\n\n{_made(surroundings.run).capitalize()}.\n\n"
        + surroundings_table(surroundings)
    )


def _stability_text(stability: StabilityReport) -> str:
    rows = [
        [part.name, part.what, str(part.tried), str(part.refused), str(part.failed), f"{part.worst:.3g} {part.unit}"]
        for part in stability.parts
    ]
    counts = stability.counts()
    verdict = (
        f"Of {len(stability.photos)} damaged photos {counts['ok']} were reported ok, {counts['unsure']} were flattened "
        f"with a warning ({stability.cautious} of these were right after all), and {counts['refused']} were refused "
        f"with a reason. Crashes: {counts['crash']}; hangs: {counts['hang']}; NaN: {counts['nan']}; reported ok but "
        f"more than {stability.truthful_px:g} px off: {counts['untruthful']}; refused although a right map had been "
        f"found: {counts['lost']}."
    )
    damages = [
        [d.damage, str(d.photos), str(d.ok), str(d.unsure), str(d.refused), str(d.failed)]
        for d in stability.by_damage()
    ]
    return (
        f"```bash\n{stability.run['command']}\n```\n\n{_made(stability.run).capitalize()}.\n\n"
        + table(("part", "what", "tried", "refused", "failed", "worst residual"), rows)
        + f"\n\n{verdict}\n\n"
        + table(("damage", "photos", "ok", "unsure", "refused", "failed"), damages)
        + "\n\n*Failed* counts what must not happen: a crash, a hang, NaN, an untruthful status, or a refusal although "
        "a right map had been found."
    )


def _soak_text(soak: SoakReport) -> str:
    return (
        f"```bash\n{soak.run['command']}\n```\n\n{_made(soak.run).capitalize()}.\n\n"
        f"{soak.photos} photos of {soak.photo_px} px, rectified over and over, {soak.films} films in all: "
        f"memory {soak.memory_mib[0]:.0f} MiB after {soak.settled} films, "
        f"{soak.memory_mib[-1]:.0f} MiB at the end ({100 * soak.memory_growth():+.1f} %); a film takes "
        f"{100 * soak.time_drift():+.1f} % longer in the last fifth than in the first (processor seconds); "
        f"{soak.different} results differ from earlier ones of the same photo."
    )


__all__ = ["Results", "page_text"]
