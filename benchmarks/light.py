"""How well light is removed: ``python -m benchmarks.light [--photos DIR] [--data DIR] --json OUT [--pictures DIR]``.

Photos are flattened with their true map, so that geometry plays no part, or by the whole pipeline (``--end-to-end``,
photos only). The film is compared with its print after one gain and offset: photos of a folder with textures/ at 512 x
512, samples of a data set at the pixels of their maps, where the truth is stored. For comparison, it reports the best
that simpler means could do if they knew the print: one gain and offset, one monotone curve, a smooth local gain and
offset, and that with a curve.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import tyro
from jaxtyping import Bool, Float, UInt8
from scipy.optimize import isotonic_regression

from benchmarks.command import run_command, write_figures
from benchmarks.photos.cases import read_alike
from benchmarks.photos.truth import TruePhoto, load_photos
from hybrid.backward import BackwardMap
from hybrid.coords import pixel_from_film, sample_bilinear
from hybrid.draw import contact_sheet, fitted, rgb_from_film, side_by_side
from hybrid.errors import ConfigError, describe, require_at_least
from hybrid.files import make_folder
from hybrid.image_io import write_rgb
from hybrid.learn.datasets.samples import Place, film_of, open_places, photo_of
from hybrid.learn.networks.inference import ready
from hybrid.learn.networks.lightnet import level_reader
from hybrid.learn.networks.weights import packaged_light_net
from hybrid.levels import LevelReader
from hybrid.metrics import ssim
from hybrid.pipeline import Rectifier
from hybrid.records import RectifyResult
from hybrid.rectify.film.deilluminate import Deillumination, deilluminate
from hybrid.rectify.film.resample import read_film

PRINT_SIZE = (512, 512)
MAX_SIDE_PX = 2048
LOCAL_SHARE = 1 / 8
"""Spread of the smooth local gain and offset, as a part of the picture's side."""
RUNS = 3

Grey = Float[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class Compared:
    """Pictures and truth in display grey, compared where ``seen``."""

    lit: Grey
    film: Grey
    truth: Grey
    seen: Bool[np.ndarray, "h w"]


@dataclass(frozen=True)
class LightScore:
    """dB (and SSIM) against the print after one gain and offset, of the photo with its light, of the film, and of the
    photo after the best curve, local gain and offset, and both.

    glare_both, glare_any: pixels that are glare in both truth and result, and in either; None without truth.
    milliseconds: least of a few runs of the light stage alone; None end to end.
    """

    name: str
    lit: float
    film: float
    lit_ssim: float
    film_ssim: float
    best_curve: float
    best_local: float
    best_both: float
    glare_share: float
    glare_both: int | None = None
    glare_any: int | None = None
    milliseconds: float | None = None
    film_px: tuple[int, int] = (0, 0)


# ---------------------------------------------------------------- what is compared


def flat_size(backward: BackwardMap, aspect: float) -> tuple[int, int]:
    """Size (h, w) of the film that keeps the photo's pixels. aspect: height over width."""
    down, across = backward.mean_film_pixels()
    width = max(across, down / aspect)
    width *= min(1.0, MAX_SIDE_PX / max(width, width * aspect))
    return round(width * aspect), round(width)


def score_photo(truth: TruePhoto, rectifier: Rectifier | None) -> tuple[LightScore, Compared] | None:
    """Score one photo with textures; None where the pipeline finds no film."""
    printed = truth.read_print()
    if rectifier is None:
        size = flat_size(truth.backward, printed.shape[0] / printed.shape[1])
        flat = read_film(truth.read(), truth.backward, size)
        light, milliseconds = timed(flat.image, flat.valid)
        image, film, glare = flat.image, light.film, light.glare
    else:
        result: RectifyResult = rectifier(truth.read())
        if result.film is None or result.rectified is None or result.glare is None or result.backward is None:
            return None
        way = read_alike(result.backward, truth.backward)[1]  # which side is up is another question
        image, film, glare = (way.moved(each) for each in (result.rectified, result.film, result.glare))
        milliseconds = None
    lit, film, small = (cv2.resize(x, PRINT_SIZE[::-1], interpolation=cv2.INTER_AREA)
                        for x in (grey_of(image), film, printed))  # fmt: skip
    compared = Compared(lit, film, small, np.ones(PRINT_SIZE, bool))
    return scored(truth.name, compared, glare, milliseconds), compared


def score_sample(place: Place) -> tuple[LightScore, Compared]:
    """Score one sample of a data set."""
    shard, k = place
    record, backward, photo = shard.record(k), film_of(place), photo_of(place)
    size = flat_size(backward, record["size_mm"][0] / record["size_mm"][1])
    flat = read_film(photo, backward, size)
    light, milliseconds = timed(flat.image, flat.valid)
    seen, uv, true_glare = (shard.field(name, k) for name in ("mask", "uv", "glare"))
    truth = np.nan_to_num(shard.field("albedo", k))
    share = seen.shape[0] / photo.shape[0]
    down, across = (max(round(px * share), 1) for px in backward.mean_film_pixels())

    def as_seen(picture: Float[np.ndarray, "a b"]) -> Grey:
        small = cv2.resize(picture, (across, down), interpolation=cv2.INTER_AREA)
        return np.where(seen, sample_bilinear(small, pixel_from_film(np.nan_to_num(uv), (down, across))), 0)

    at = pixel_from_film(np.nan_to_num(uv), size)
    found = seen & (sample_bilinear(light.glare.astype(np.float32), at) > 0.5)
    compared = Compared(as_seen(grey_of(flat.image)), as_seen(light.film), truth, seen)
    both, either = int((found & true_glare).sum()), int((found | true_glare).sum())
    name = f"{record['film']:03d}_{record['photo']}"
    return scored(name, compared, light.glare, milliseconds, both, either), compared


def grey_of(image: UInt8[np.ndarray, "h w 3"]) -> Grey:
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255


@lru_cache(maxsize=1)
def reader() -> LevelReader:
    """The packaged network."""
    return level_reader(ready(packaged_light_net()))


def timed(image: UInt8[np.ndarray, "h w 3"], valid: Bool[np.ndarray, "h w"]) -> tuple[Deillumination, float]:
    """The film without its light, and the fewest milliseconds of a few runs."""
    least, light = np.inf, deilluminate(image, valid, reader())
    for _ in range(RUNS):
        start = time.perf_counter()
        light = deilluminate(image, valid, reader())
        least = min(least, time.perf_counter() - start)
    return light, 1e3 * float(least)


# ---------------------------------------------------------------- figures


def scored(
    name: str, compared: Compared, glare: Bool[np.ndarray, "a b"], milliseconds: float | None,
    both: int | None = None, either: int | None = None,
) -> LightScore:  # fmt: skip
    """All figures of one picture."""
    seen, truth = compared.seen, compared.truth
    lit, film = (affine(x, truth, seen) for x in (compared.lit, compared.film))
    curve = best_curve(compared.lit, truth, seen)
    local = best_local(compared.lit, truth, seen)
    curve_local = best_curve(np.clip(best_local(curve, truth, seen), 0, 1), truth, seen)
    return LightScore(
        name=name,
        lit=decibels(lit, truth, seen),
        film=decibels(film, truth, seen),
        lit_ssim=similarity(lit, truth, seen),
        film_ssim=similarity(film, truth, seen),
        best_curve=decibels(curve, truth, seen),
        best_local=decibels(local, truth, seen),
        best_both=decibels(curve_local, truth, seen),
        glare_share=float(glare.mean()),
        glare_both=both,
        glare_any=either,
        milliseconds=milliseconds,
        film_px=(glare.shape[0], glare.shape[1]),
    )


def decibels(a: Grey, b: Grey, seen: Bool[np.ndarray, "h w"]) -> float:
    return float(-10 * np.log10(max(float(np.mean(np.square(a[seen] - b[seen]))), 1e-10)))


def similarity(a: Grey, b: Grey, seen: Bool[np.ndarray, "h w"]) -> float:
    """SSIM; what is not seen is black in both."""
    x, y = (255 * np.where(seen, z, 0)[..., None].astype(np.float64) for z in (a, b))
    return ssim(x, y)


def affine(x: Grey, y: Grey, seen: Bool[np.ndarray, "h w"]) -> Grey:
    """x after the best non-negative gain and offset."""
    spread = float(np.var(x[seen]))
    gain = max(float(np.mean((x[seen] - x[seen].mean()) * (y[seen] - y[seen].mean()))) / max(spread, 1e-12), 0.0)
    return gain * (x - x[seen].mean()) + y[seen].mean()


def best_curve(x: Grey, y: Grey, seen: Bool[np.ndarray, "h w"]) -> Grey:
    """x after the monotone curve over 256 levels that comes closest to y."""
    level = np.clip(np.rint(255 * x), 0, 255).astype(int)
    count = np.bincount(level[seen], minlength=256).astype(float)
    mean = np.bincount(level[seen], y[seen], minlength=256) / np.maximum(count, 1)
    used = count > 0
    fitted_levels = isotonic_regression(mean[used], weights=count[used]).x
    return np.interp(level, np.flatnonzero(used), fitted_levels).astype(np.float32)


def best_local(x: Grey, y: Grey, seen: Bool[np.ndarray, "h w"]) -> Grey:
    """x after a smooth local gain and offset: windowed regression on y, with smoothed coefficients."""
    weight = seen.astype(np.float64)
    sigma = LOCAL_SHARE * max(x.shape)

    def smooth(z: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(z * weight, (0, 0), sigma) / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-6)

    x, y = x.astype(np.float64), y.astype(np.float64)
    mean_x, mean_y = smooth(x), smooth(y)
    gain = (smooth(x * y) - mean_x * mean_y) / (smooth(x * x) - mean_x**2 + 1e-4)
    return smooth(gain) * x + smooth(mean_y - gain * mean_x)


def summarise(scores: Sequence[LightScore]) -> dict[str, Any]:
    """Medians and means of all figures, the gain of film over lit, and the pooled overlap of glare."""
    names = ("lit", "film", "lit_ssim", "film_ssim", "best_curve", "best_local", "best_both")
    summary: dict[str, Any] = {"count": len(scores)}
    for name in names:
        values = [getattr(score, name) for score in scores]
        summary[name] = {"median": statistics.median(values), "mean": statistics.fmean(values), "worst": min(values)}
    either = sum(score.glare_any or 0 for score in scores)
    summary["glare_iou"] = sum(score.glare_both or 0 for score in scores) / either if either else None
    times = [score.milliseconds for score in scores if score.milliseconds is not None]
    summary["milliseconds"] = statistics.median(times) if times else None
    return summary


# ---------------------------------------------------------------- the command


@dataclass(frozen=True)
class Options:
    """Measure how well light is removed from photos whose print is known."""

    json_path: Annotated[Path, tyro.conf.arg(name="json")]
    """File for the figures."""

    photos: Path | None = None
    """Folder of NAME.jpg, NAME.npz (the true lattice) and textures/."""

    data: Path | None = None
    """Data set made by data_gen.generate."""

    every: int = 1
    """Take every so many samples of the data set."""

    end_to_end: bool = False
    """Flatten the photos by the whole pipeline, not with their true maps."""

    pictures: Path | None = None
    """Folder for light.jpg: photo with its light, film and print, worst first."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "every")


def measure(options: Options) -> Iterator[tuple[str, LightScore, Compared]]:
    """Every photo and sample, with the name of its set."""
    if options.photos is None and options.data is None:
        do = "Name --photos or --data."
        raise ConfigError(describe(what="benchmarks.light", got="nothing to measure", do=do))
    rectifier = Rectifier() if options.end_to_end else None
    for truth in load_photos(options.photos) if options.photos else ():
        found = score_photo(truth, rectifier)
        if found is None:
            print(f"{truth.name}: no film found")
            continue
        yield "photos", *found
    for place in open_places([options.data])[:: options.every] if options.data else ():
        yield "data", *score_sample(place)


def run(options: Options, command: list[str]) -> dict[str, Any]:
    """Measure, print a line for each picture and each set, write JSON and pictures."""
    scores: dict[str, list[LightScore]] = {}
    tiles: list[tuple[float, str, UInt8[np.ndarray, "h w 3"]]] = []
    for kind, score, compared in measure(options):
        scores.setdefault(kind, []).append(score)
        print(f"{score.name:<10} lit {score.lit:5.2f}  film {score.film:5.2f} dB  SSIM {score.lit_ssim:.3f} "
              f"{score.film_ssim:.3f}  curve {score.best_curve:5.2f}  local {score.best_local:5.2f}  both "
              f"{score.best_both:5.2f}  glare {score.glare_share:.1%}")  # fmt: skip
        if options.pictures is not None:
            views = [fitted(rgb_from_film(np.clip(x, 0, 1).astype(np.float32)), (400, 400))
                     for x in (compared.lit, compared.film, compared.truth)]  # fmt: skip
            tiles.append((score.film, f"{score.name}  lit {score.lit:.1f}  film {score.film:.1f} dB",
                          side_by_side(views, height=400)))  # fmt: skip
    summary = {kind: summarise(of_kind) for kind, of_kind in scores.items()}
    listed = {kind: [asdict(score) for score in of_kind] for kind, of_kind in scores.items()}
    write_figures(options.json_path, command, {"summary": summary, "scores": listed})
    if options.pictures is not None:
        make_folder(options.pictures, "--pictures")
        tiles.sort(key=lambda tile: tile[0])
        sheet = contact_sheet([tile for *_, tile in tiles], [caption for _, caption, _ in tiles], 2)
        write_rgb(options.pictures / "light.jpg", sheet)
    for kind, figures in summary.items():
        medians = "  ".join(f"{k} {v['median']:.3f}" for k, v in figures.items() if isinstance(v, dict))
        print(f"{kind}: {figures['count']}, medians: {medians}; glare IoU {figures['glare_iou']}; "
              f"{figures['milliseconds']} ms")  # fmt: skip
    return summary


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if it went through."""
    return run_command("benchmarks.light", Options, run, arguments)


if __name__ == "__main__":
    sys.exit(main())
