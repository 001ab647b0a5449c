"""How right and how fast rectification is: ``python -m benchmarks.rectify --photos DIR --json OUT [--pictures DIR]``.

The public API is run on photos whose truth is known. For each: end-point error of the backward map on the true
lattice, the paper's protocol (hybrid.metrics.paper_protocol), the film against its print, and the run time of each
stage, array in to result out. Photos that fail are counted and listed, and stay out of the medians.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import tyro
from jaxtyping import UInt8
from tqdm import tqdm

from benchmarks.machine import describe_run
from benchmarks.measure import at_print_size
from benchmarks.photos import TruePhoto, load_photos
from hybrid.backward import end_point_error
from hybrid.draw import annotated, contact_sheet, fitted, rgb_from_film, side_by_side
from hybrid.errors import HybridError
from hybrid.image_io import write_bytes, write_rgb
from hybrid.metrics import EndPointError, PaperScores, end_point_statistics, paper_protocol, psnr_after_gain_offset
from hybrid.outputs import make_folder
from hybrid.records import RectifyResult

Rectify = Callable[[np.ndarray], RectifyResult]

TILE_PX = 420
SHEET_COLUMNS = 3


# ---------------------------------------------------------------- one photo


@dataclass(frozen=True)
class PhotoScore:
    """What was measured on one photo; the parts that need a film are None where none was found.

    print_psnr_lit, print_psnr: dB of the rectified photo's grey and of the film against the print, one global gain
        and offset fitted: before and after light removal.
    seconds, fastest_seconds: median and least over the runs, array in to result out.
    stages: for each stage its median seconds, whether it ran, and why.
    """

    name: str
    style: str
    true_grid: str
    ok: bool
    status: str
    seconds: float
    fastest_seconds: float
    stages: dict[str, dict[str, Any]]
    grid: str | None = None
    end_point: EndPointError | None = None
    paper: PaperScores | None = None
    print_psnr_lit: float | None = None
    print_psnr: float | None = None
    glare_share: float | None = None


def score_photo(truth: TruePhoto, rectify: Rectify, runs: int) -> tuple[PhotoScore, RectifyResult]:
    """Rectify one photo ``runs`` times and score the result."""
    photo = truth.read()
    seconds, results = [], []
    for _ in range(runs):
        start = time.perf_counter()
        results.append(rectify(photo))
        seconds.append(time.perf_counter() - start)
    result = results[-1]
    return PhotoScore(
        name=truth.name,
        style=truth.style,
        true_grid=f"{truth.rows}x{truth.cols}",
        ok=result.status.has_film,
        status=str(result.status),
        seconds=statistics.median(seconds),
        fastest_seconds=min(seconds),
        stages=stage_times(results),
        **geometry_scores(truth, photo, result),
        **print_scores(truth, result),
    ), result


def stage_times(results: Sequence[RectifyResult]) -> dict[str, dict[str, Any]]:
    """For each stage of the last result: median seconds over all results, whether it ran, and why."""
    return {
        stage.name: {
            "seconds": statistics.median(s.seconds for r in results for s in r.stages if s.name == stage.name),
            "ran": stage.ran,
            "reason": stage.reason,
        }
        for stage in results[-1].stages
    }


def geometry_scores(truth: TruePhoto, photo: UInt8[np.ndarray, "h w 3"], result: RectifyResult) -> dict[str, Any]:
    """End-point error and the paper's scores of the result's backward map, and the grid that was found."""
    if result.backward is None:
        return {}
    distances = end_point_error(result.backward, truth.lattice)
    return {
        "end_point": end_point_statistics(distances, photo.shape[:2]),
        "paper": paper_protocol(photo, result.backward, truth.backward),
        "grid": None if result.grid is None else f"{result.grid.rows}x{result.grid.cols}",
    }


def print_scores(truth: TruePhoto, result: RectifyResult) -> dict[str, Any]:
    """The film against its print, before and after light removal."""
    if result.film is None or result.rectified is None:
        return {}
    true_print = at_print_size(truth.read_print())
    lit = cv2.cvtColor(result.rectified, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    return {
        "print_psnr_lit": psnr_after_gain_offset(at_print_size(lit), true_print),
        "print_psnr": psnr_after_gain_offset(at_print_size(result.film), true_print),
        "glare_share": None if result.glare is None else float(result.glare.mean()),
    }


# ---------------------------------------------------------------- all photos

FIGURES: dict[str, Callable[[PhotoScore], float | None]] = {
    "end_point_px": lambda s: s.end_point and s.end_point.mean_px,
    "end_point_p95_px": lambda s: s.end_point and s.end_point.p95_px,
    "end_point_percent": lambda s: s.end_point and s.end_point.mean_percent,
    "paper_psnr": lambda s: s.paper and s.paper.raw.psnr,
    "paper_ssim": lambda s: s.paper and s.paper.raw.ssim,
    "paper_ms_ssim": lambda s: s.paper and s.paper.raw.ms_ssim,
    "paper_psnr_deshifted": lambda s: s.paper and s.paper.deshifted.psnr,
    "paper_ssim_deshifted": lambda s: s.paper and s.paper.deshifted.ssim,
    "paper_ms_ssim_deshifted": lambda s: s.paper and s.paper.deshifted.ms_ssim,
    "print_psnr_lit": lambda s: s.print_psnr_lit,
    "print_psnr": lambda s: s.print_psnr,
    "seconds": lambda s: s.seconds,
}
LOWER_IS_BETTER = frozenset({"end_point_px", "end_point_p95_px", "end_point_percent", "seconds"})


def summarise(scores: Sequence[PhotoScore]) -> dict[str, Any]:
    """Number of photos, how many ended ok, and median, mean and worst of each figure over those that have it."""
    summary: dict[str, Any] = {"photos": len(scores), "ok": sum(score.ok for score in scores)}
    for name, figure in FIGURES.items():
        values = [value for score in scores if (value := figure(score)) is not None]
        worst = max if name in LOWER_IS_BETTER else min
        if values:
            summary[name] = {
                "median": statistics.median(values),
                "mean": statistics.fmean(values),
                "worst": worst(values),
            }
    return summary


def by_style(scores: Sequence[PhotoScore]) -> dict[str, dict[str, Any]]:
    """The summary of each cell style apart, and of all photos."""
    styles = sorted({score.style for score in scores})
    return {style: summarise([s for s in scores if s.style == style]) for style in styles} | {"all": summarise(scores)}


# ---------------------------------------------------------------- for people

HEADER = f"{'photo':<12} {'style':<7} {'true':<5} {'found':<6} {'px':>6} {'p95':>6} {'%':>6} {'dB':>6} {'SSIM':>6}"
HEADER += f" {'MS':>6} {'dB ds':>6} {'lit':>6} {'film':>6} {'s':>6}"


def table(scores: Sequence[PhotoScore]) -> str:
    """One line for each photo, then median and worst by style and over all."""
    lines = [HEADER, *(_photo_line(score) for score in scores), ""]
    for style, summary in by_style(scores).items():
        for kind in ("median", "worst"):
            head = f"{style} {kind} ({summary['ok']}/{summary['photos']})"
            lines.append(f"{head:<33}" + _figures({name: v[kind] for name, v in summary.items() if name in FIGURES}))
    return "\n".join(lines)


def _photo_line(score: PhotoScore) -> str:
    head = f"{score.name:<12} {score.style:<7} {score.true_grid:<5} {score.grid or '-':<6}"
    line = f"{head:<33}" + _figures({name: figure(score) for name, figure in FIGURES.items()})
    return line if score.ok else f"{line}  FAILED: {score.status}"


def _figures(values: dict[str, float | None]) -> str:
    columns = {
        "end_point_px": ".2f",
        "end_point_p95_px": ".2f",
        "end_point_percent": ".3f",
        "paper_psnr": ".2f",
        "paper_ssim": ".3f",
        "paper_ms_ssim": ".3f",
        "paper_psnr_deshifted": ".2f",
        "print_psnr_lit": ".2f",
        "print_psnr": ".2f",
        "seconds": ".3f",
    }
    shown = [(values.get(name), places) for name, places in columns.items()]
    return " ".join(f"{'-':>6}" if value is None else f"{value:>6{places}}" for value, places in shown)


def one_line(scores: Sequence[PhotoScore]) -> str:
    """The whole run in a line."""
    summary = summarise(scores)
    if "end_point_px" not in summary:
        return f"{summary['ok']} of {summary['photos']} photos ok; no film was found in any"
    epe, paper = summary["end_point_px"], summary["paper_psnr"]["median"]
    film = summary.get("print_psnr", {}).get("median", float("nan"))
    lit = summary.get("print_psnr_lit", {}).get("median", float("nan"))
    return (
        f"{summary['ok']} of {summary['photos']} photos ok; end-point error median {epe['median']:.2f} px, worst "
        f"{epe['worst']:.2f} px; paper {paper:.2f} dB / {summary['paper_ssim']['median']:.4f} / "
        f"{summary['paper_ms_ssim']['median']:.4f}; film {film:.2f} dB (lit {lit:.2f}); "
        f"{summary['seconds']['median']:.3f} s"
    )


def tile(photo: UInt8[np.ndarray, "h w 3"], result: RectifyResult) -> UInt8[np.ndarray, "a b 3"]:
    """The photo with what was found drawn on it, beside the film."""
    film = np.zeros((TILE_PX, TILE_PX, 3), np.uint8) if result.film is None else rgb_from_film(result.film)
    pictures = [fitted(annotated(photo, result), (TILE_PX, TILE_PX)), fitted(film, (TILE_PX, TILE_PX))]
    return side_by_side(pictures, height=TILE_PX)


def caption(score: PhotoScore) -> str:
    """One line above a tile."""
    if score.end_point is None or score.paper is None:
        return f"{score.name}  {score.style} {score.true_grid}  FAILED"
    film = "-" if score.print_psnr is None else f"{score.print_psnr:.1f}"
    found = f"found {score.grid or 'no grid'}"
    figures = f"{score.end_point.mean_px:.2f} px  {score.paper.raw.psnr:.1f} dB  film {film} dB  {score.seconds:.2f} s"
    return f"{score.name}  {score.style} {score.true_grid} {found}  {figures}"


# ---------------------------------------------------------------- the command


@dataclass(frozen=True)
class Options:
    """Rectify photos whose truth is known; print a table, write JSON and pictures."""

    photos: Path
    """Folder of NAME.jpg, NAME.npz (the true lattice) and textures/."""

    json_path: Annotated[Path, tyro.conf.arg(name="json")]
    """File for the figures of every photo, the summary, and the machine."""

    pictures: Path | None = None
    """Folder for contact_sheet.jpg: every photo with what was found, beside its film."""

    runs: int = 3
    """Runs of each photo; their median is the run time."""

    weights: Path | None = None
    """Another network than the packaged one."""


def run(options: Options, rectify: Rectify, command: list[str]) -> list[PhotoScore]:
    """Score all photos, print the table, write JSON and pictures."""
    truths = load_photos(options.photos)
    rectify(truths[0].read())  # the first call pays for threads, caches and lazy imports
    scores, tiles = [], []
    for truth in tqdm(truths, desc="photos", unit="photo"):
        score, result = score_photo(truth, rectify, options.runs)
        scores.append(score)
        if options.pictures is not None:
            tiles.append(tile(truth.read(), result))
    report = {"run": describe_run(command), "summary": by_style(scores), "photos": [asdict(score) for score in scores]}
    make_folder(options.json_path.parent)
    write_bytes(options.json_path, (json.dumps(report, indent=1) + "\n").encode())
    if options.pictures is not None:
        make_folder(options.pictures)
        sheet = contact_sheet(tiles, [caption(score) for score in scores], SHEET_COLUMNS)
        write_rgb(options.pictures / "contact_sheet.jpg", sheet)
    print(table(scores))
    print(one_line(scores))
    return scores


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if every photo ended ok."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    options = tyro.cli(Options, args=arguments, prog="python -m benchmarks.rectify")
    import hybrid

    try:
        rectifier = hybrid.Rectifier(hybrid.RectifyConfig(weights=options.weights))
        scores = run(options, rectifier, ["python -m benchmarks.rectify", *arguments])
    except HybridError as error:
        print(f"benchmarks.rectify: {error}", file=sys.stderr)
        return 1
    return 0 if all(score.ok for score in scores) else 1


if __name__ == "__main__":
    sys.exit(main())
