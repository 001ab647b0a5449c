"""The pictures of ``benchmarks.run``: time against error, error against bend, seconds by stage, a gallery."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.lineup import CONFIGURATIONS, MAIN
from benchmarks.methods import path_in
from benchmarks.photos.cases import Case, read_alike
from benchmarks.report.charts import Axis, Chart, Picture, Points, page_of, scatter, stacked_bars
from benchmarks.report.results import MethodNote, Report
from benchmarks.report.summary import FLOOR, rows_of
from hybrid.backward import end_point_error
from hybrid.coords import film_nodes
from hybrid.draw import annotated, contact_sheet, fitted, rgb_from_film, side_by_side
from hybrid.files import make_folder
from hybrid.image_io import write_rgb
from hybrid.pipeline import Rectifier, RectifyConfig
from hybrid.records import RectifyResult

TILE_PX = 420
ERROR_RANGE_PX = 10.0
"""End-point error (in a photo of 1080 px) that is drawn brightest in the gallery."""


def write_pictures(report: Report, folder: Path) -> None:
    """Write the charts of a report into a folder."""
    make_folder(folder, "--out")
    write_rgb(folder / "time_error.png", time_against_error(report))
    write_rgb(folder / "bend.png", error_against_bend(report))
    write_rgb(folder / "stages.png", seconds_by_stage(report))


def write_gallery(report: Report, cases: Sequence[Case], weights: Path | None, count: int, folder: Path) -> None:
    """Draw this many photos, from ``hybrid``'s best to its worst, on which it runs again; nothing if it was not run."""
    chosen = best_to_worst(report, count)
    if chosen:
        make_folder(folder, "--out")
        by_name = {case.name: case for case in cases}
        rectify = Rectifier(RectifyConfig(weights=path_in(weights, "filmnet")))
        picture = gallery([(label, by_name[name], rectify(by_name[name].photo())) for label, name in chosen])
        write_rgb(folder / "gallery.jpg", picture)


def time_against_error(report: Report) -> Picture:
    """A chart for each size: seconds against end-point error, both logarithmic, with the floor.

    Methods that are not scored stand as rings along the upper edge.
    """
    shown = [row for size in report.settings.sizes for row in rows_of(report, size)]
    shown = [row for row in shown if row.method.name not in CONFIGURATIONS]
    seconds = [row.seconds[0] for row in shown]
    errors = [row.error for row in shown if row.error is not None]
    low, high = min(errors, default=1.0), max(errors, default=10.0)
    x = Axis("seconds, photo in memory to flat film", 0.6 * min(seconds), 2.5 * max(seconds))
    y = Axis("median end-point error, px of a 1080 px photo", 0.6 * min(low, 1.0), 12 * high)
    names = list(dict.fromkeys(row.method.name for row in shown if row.method.name != FLOOR))
    charts = []
    for size in report.settings.sizes:
        rows = [row for row in shown if row.megapixels == size]
        points = []
        for name in names:
            for row in rows:
                if row.method.name == name:
                    hollow = row.error is None
                    label = f"{_short(row.method)} (no error)" if hollow else _short(row.method)
                    at = (row.seconds[0], y.high / 1.6 ** (1 + len(points) % 3) if row.error is None else row.error)
                    points.append(Points(name, (at,), (label,), hollow))
        marks = {row.method.label: row.seconds[0] for row in rows if row.method.name == FLOOR}
        charts.append(scatter(Chart(f"{size:g} megapixels", x, y, tuple(points), marks)))
    return page_of(charts, min(2, len(charts)))


def _short(method: MethodNote) -> str:
    """A method's label without the part in brackets: the page's tables show that."""
    return method.label.partition(" (")[0]


def error_against_bend(report: Report) -> Picture:
    """Each photo of the first size: its bend against the error of each method."""
    bend = {case.name: case.bend_deg for case in report.cases if case.bend_deg is not None}
    size = report.settings.sizes[0]
    points = []
    for method in report.methods:
        if not method.unscored and method.name not in CONFIGURATIONS:
            found = [m for m in report.measured if (m.method, m.megapixels) == (method.name, size)]
            xy = tuple((bend[m.case], m.score.end_point_px) for m in found if m.score and m.case in bend)
            if xy:
                points.append(Points(_short(method), xy))
    errors = [y for p in points for _, y in p.xy] or [1.0]
    farthest = 1.1 * max(bend.values(), default=1.0)
    return scatter(
        Chart(
            f"Error against bend, {size:g} megapixels",
            Axis("largest angle between the sheet and its mean plane, degrees", 0.0, farthest, log=False),
            Axis("end-point error, px of a 1080 px photo", 0.6 * max(min(errors), 0.05), 6 * max(errors)),
            tuple(points),
            legend=True,
        )
    )


def seconds_by_stage(report: Report) -> Picture:
    """A bar for each size: how long the stages of ``hybrid`` take."""
    bars = []
    for size in report.settings.sizes:
        found = [m for m in report.measured if (m.method, m.megapixels) == (MAIN, size)]
        if found:
            names = list(dict.fromkeys(name for m in found for name in m.parts))
            parts = [(name, float(np.median([m.parts.get(name, 0.0) for m in found]))) for name in names]
            bars.append((f"{size:g} MP", [(name, 1e3 * seconds) for name, seconds in parts]))
    return stacked_bars("hybrid by stage", bars, "ms")


def best_to_worst(report: Report, count: int) -> list[tuple[str, str]]:
    """Photos by the error of ``hybrid`` at the first size, evenly by rank: label and name; lost ones count as worst."""
    size = report.settings.sizes[0]
    found = [m for m in report.measured if (m.method, m.megapixels) == (MAIN, size)]
    ranked = sorted(found, key=lambda m: np.inf if m.score is None else m.score.end_point_px)
    last = len(ranked) - 1
    named = {last // 2: "median", last: "worst", 0: "best"}
    places = sorted({int(place) for place in np.linspace(0, last, min(count, len(ranked)))})
    return [(named.get(place, f"{place + 1} of {len(ranked)}"), ranked[place].case) for place in places]


def gallery(results: Sequence[tuple[str, Case, RectifyResult]]) -> Picture:
    """Rows of the photo with what was found, the film, and the end-point error over the film."""
    tiles, captions = [], []
    for label, case, result in results:
        photo, square = case.photo(), (TILE_PX, TILE_PX)
        film = np.zeros((TILE_PX, TILE_PX, 3), np.uint8) if result.film is None else rgb_from_film(result.film)
        error, text = _error_picture(case, result, max(photo.shape[:2]))
        row = [fitted(annotated(photo, result), square), fitted(film, square), fitted(error, square)]
        tiles.append(side_by_side(row, height=TILE_PX))
        captions.append(f"{label}: {case.name}   {text}   error from 0 to {ERROR_RANGE_PX:g} px of 1080 on the right")
    return contact_sheet(tiles, captions, 1)


def _error_picture(case: Case, result: RectifyResult, longer_px: int) -> tuple[Picture, str]:
    """The error over the true film as colours, and its mean."""
    nodes = film_nodes((65, 65))
    if result.backward is None:
        return np.zeros((65, 65, 3), np.uint8), str(result.status)
    seen, _ = read_alike(result.backward, case.backward)
    errors = end_point_error(seen, case.backward.photo_from_film(nodes)) * 1080 / longer_px
    level = np.clip(255 * errors / ERROR_RANGE_PX, 0, 255).astype(np.uint8)
    size = case.film_size()
    large = cv2.resize(cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS), size[::-1], interpolation=cv2.INTER_LINEAR)
    return cv2.cvtColor(large, cv2.COLOR_BGR2RGB), f"{errors.mean():.2f} px"


__all__ = [
    "best_to_worst",
    "error_against_bend",
    "gallery",
    "seconds_by_stage",
    "time_against_error",
    "write_gallery",
    "write_pictures",
]
