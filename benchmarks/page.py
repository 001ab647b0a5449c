"""The page and the README's table, made from results: ``python -m benchmarks.page --out OUT``.

OUT holds run.json and, if they were made, surroundings.json, stability.json and soak.json.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.command import run_command
from benchmarks.lineup import CONFIGURATIONS, MAIN
from benchmarks.report.pictures import write_pictures
from benchmarks.report.results import Report
from benchmarks.report.schema import Record, read_record
from benchmarks.report.stress_records import SoakReport, StabilityReport
from benchmarks.report.summary import FLOOR, rows_of, split_rows
from benchmarks.report.surroundings_records import SurroundingsReport
from benchmarks.report.tables import number, table
from benchmarks.report.text import Results, page_text
from hybrid.files import make_folder, write_bytes

BEGIN, END = "<!-- figures: begin -->", "<!-- figures: end -->"
PICTURES, GALLERY = ("time_error.png", "bend.png", "stages.png"), "gallery.jpg"
PREFIX = "benchmarks_"


def read_results(folder: Path, prefix: str = "") -> Results:
    """The results in a folder; ``prefix``: what their names start with.

    Raises:
        DataError: no run.json there, or one that is not as it should be.
    """

    def further(name: str, kind: type[Record]) -> Record | None:
        path = folder / f"{prefix}{name}.json"
        return read_record(path, kind) if path.exists() else None

    return Results(
        read_record(folder / f"{prefix}run.json", Report),
        further("stability", StabilityReport),
        further("soak", SoakReport),
        further("surroundings", SurroundingsReport),
        (folder / ("images" if prefix else "pictures") / f"{prefix}{GALLERY}").exists(),
    )


# ---------------------------------------------------------------- README, files


ON_THE_PAGE_ALONE = frozenset({*CONFIGURATIONS, FLOOR, "scanner", "dewarpnet_full"})
"""Methods that the README leaves out, as it has others of their kind."""


def readme_table(report: Report) -> str:
    """The README's block: most methods at the first size, and `hybrid` by cell style."""
    size = report.settings.sizes[0]
    rows = [r for r in rows_of(report, size) if r.method.name not in ON_THE_PAGE_ALONE]
    cells = [
        [
            r.method.label,
            r.method.unscored or f"{number(r.error, 2)} px ({number(r.worst_px, 1)})",
            f"{number(r.figures.get('psnr'), 1)} dB, {number(r.figures.get('ms_ssim'), 3)}"
            if r.error is not None
            else "-",
            f"{r.seconds[0]:.2g}",
        ]
        for r in rows
    ]
    kinds = split_rows(report, MAIN, size) if any(m.name == MAIN for m in report.methods) else []
    styles = "; ".join(f"{kind} {number(row.error, 2)} px" for title, kind, row in kinds if title == "cell style")
    photos = max((r.photos for r in rows), default=0)
    head = ("", "end-point error, median photo (worst)", "paper's protocol, raw: PSNR, MS-SSIM", "seconds")
    return (
        f"{photos} photos of about {size:g} megapixel with truth, threads: {report.settings.threads}, no GPU:\n\n"
        + table(head, cells)
        + (f"\n\n`hybrid` by what separates the slices: {styles}." if styles else "")
        + f"\n\nMade by `{report.run['command']}`."
    )


def with_table(readme: str, block: str) -> str:
    """The README with the block between its marks; as it is, if it has none."""
    if BEGIN not in readme or END not in readme:
        return readme
    before, _, rest = readme.partition(BEGIN)
    return f"{before}{BEGIN}\n{block}\n{END}{rest.partition(END)[2]}"


def write_page(page: Path, out: Path, readme: Path | None = None) -> None:
    """Write the page, its figures and pictures beside it, and the table of a README.

    Raises:
        DataError: the results in ``out`` are not complete.
    """
    results = read_results(out)
    make_folder(page.parent / "images")
    write_pictures(results.run, out / "pictures")  # those that lie there may be of another run
    write_bytes(page, page_text(results).encode())
    for name in ("run", "surroundings", "stability", "soak"):
        if (out / f"{name}.json").exists():
            shutil.copyfile(out / f"{name}.json", page.parent / f"{PREFIX}{name}.json")
    for name in (*PICTURES, GALLERY):
        if (out / "pictures" / name).exists():
            shutil.copyfile(out / "pictures" / name, page.parent / "images" / f"{PREFIX}{name}")
    if readme is not None:
        write_bytes(readme, with_table(readme.read_text(), readme_table(results.run)).encode())


@dataclass(frozen=True)
class Options:
    """Make the page from existing results."""

    out: Path
    """Folder of run.json and, if made, surroundings.json, stability.json and soak.json."""
    page: Path = Path("docs/benchmarks.md")
    """The file to write."""
    readme: Path | None = None
    """A README whose table is made anew as well."""


def run(options: Options, command: list[str]) -> None:
    """Make the page; its text does not depend on the command that makes it."""
    write_page(options.page, options.out, options.readme)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns 0 if it succeeded."""
    return run_command("benchmarks.page", Options, run, arguments)


__all__ = ["PREFIX", "read_results", "readme_table", "with_table", "write_page"]

if __name__ == "__main__":
    sys.exit(main())
