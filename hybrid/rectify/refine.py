"""A coarse backward map made exact to a fraction of a pixel by what the photo shows of the sheet and its print.

The coarse map is kept and corrected by a smooth displacement of the film plane (sightings.py): the film's shape
is the network's, only its smooth error is fitted. Sightings are the sheet's edges (outline.py) and the rules or
gutters between the slices (grid.py). All are looked for again through the improved map, and count only if they
agree: the spline is fitted to half of them and must explain the other half better than the map before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d
from hybrid.records import SliceGrid, StageReport
from hybrid.rectify.film_view import FilmView, view_film
from hybrid.rectify.grid import Comb, GridConfig, find_comb, follow_comb
from hybrid.rectify.outline import OutlineConfig, find_outline
from hybrid.rectify.sightings import (
    Displacement,
    DisplacementFit,
    Sightings,
    SplineConfig,
    fit_displacement,
    no_displacement,
)


@dataclass(frozen=True)
class RefineConfig:
    """Options of the refinement of a coarse map."""

    outline: OutlineConfig = field(default_factory=OutlineConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    spline: SplineConfig = field(default_factory=SplineConfig)
    working_px: int = 1000
    """Longer side of the film, in pixels, at which the photo is looked at; larger films are scaled down to it."""
    near_band: float = 0.015
    """Half width of the search band for edges once the map has been improved, in film units."""
    max_move: float = 0.08
    """Largest displacement believed, in film units."""
    min_gain: float = 0.9
    """The spline counts only if held-out sightings disagree with it by less than this fraction of before."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """A refined map, the slice grid if one was found, and what was done."""

    backward: BackwardMap
    grid: SliceGrid | None
    stages: tuple[StageReport, ...]


@dataclass(frozen=True, eq=False)
class _Scene:
    """The photo at working size and the coarse map into it."""

    photo: UInt8[np.ndarray, "H W 3"]
    grey: UInt8[np.ndarray, "H W"]
    coarse: BackwardMap
    film_size: tuple[int, int]


def refine(photo: UInt8[np.ndarray, "H W 3"], coarse: BackwardMap, config: RefineConfig) -> Refinement:
    """The coarse map, corrected where the photo shows how.

    photo: RGB, the one that ``coarse`` maps into. Returns the coarse map itself where nothing was seen, where
    the correction does not explain the photo better, or where it would fold the film or move it too far; the
    report of stage ``spline`` says which. Raises nothing on any photo.
    """
    start = perf_counter()
    scene = _working_scene(photo, coarse, config)
    nothing = no_displacement(config.spline)
    outline = find_outline(scene.photo, scene.coarse, config.outline)
    rough = fit_displacement(outline, config.spline).displacement if outline else nothing
    outline_seconds = perf_counter() - start

    start = perf_counter()
    combs, grid_sightings = _find_grid(scene, rough, config)
    grid_seconds = perf_counter() - start

    start = perf_counter()
    first = [*outline, *(rough.lift(s) for s in grid_sightings)]
    if not first:
        return _unchanged(coarse, "no edge, rule or gutter was seen", (outline_seconds, grid_seconds, 0.0))
    better = fit_displacement(first, config.spline).displacement
    near = replace(config.outline, band=config.near_band)
    again = find_outline(scene.photo, better.composed(scene.coarse), near)
    sightings = [better.lift(s) for s in (*again, *_follow(scene, better, combs, config))]
    fit = fit_displacement(sightings, config.spline)
    backward, verdict = _judge(coarse, sightings, fit, config)
    seconds = (outline_seconds, grid_seconds, perf_counter() - start)
    if backward is None:
        return _unchanged(coarse, verdict, seconds)
    grid = _slice_grid(combs, sightings, fit, backward)
    stages = (
        StageReport("outline", bool(again), _outline_reason(again), seconds[0]),
        StageReport("grid", any(combs), _grid_reason(combs), seconds[1]),
        StageReport("spline", True, verdict, seconds[2]),
    )
    return Refinement(backward, grid, stages)


# ---------------------------------------------------------------- steps


def _working_scene(photo: UInt8[np.ndarray, "H W 3"], coarse: BackwardMap, config: RefineConfig) -> _Scene:
    """The photo scaled down, if need be, until the film's longer side has ``working_px`` pixels."""
    film_px = max(coarse.mean_film_pixels())
    if film_px > 1.15 * config.working_px:
        scale = config.working_px / film_px
        height, width = photo.shape[:2]
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        photo = cv2.resize(photo, size, interpolation=cv2.INTER_AREA)
        coarse = coarse.cropped((0.0, 0.0), (size[0] / width, size[1] / height))
    down, across = coarse.mean_film_pixels()
    film_size = (int(np.clip(round(down), 64, 4096)), int(np.clip(round(across), 64, 4096)))
    return _Scene(photo, cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY), coarse, film_size)


def _view(scene: _Scene, displacement: Displacement) -> FilmView:
    """The flat grey film as the displaced map sees it."""
    height, width = scene.film_size
    return view_film(scene.grey, displacement.composed(scene.coarse), film_centres_1d(width), film_centres_1d(height))


def _find_grid(
    scene: _Scene, displacement: Displacement, config: RefineConfig
) -> tuple[tuple[Comb | None, Comb | None], list[Sightings]]:
    """Combs of columns (lines u = const) and rows (v = const), each only if it can be followed, and their sightings."""
    view = _view(scene, displacement)
    combs: list[Comb | None] = []
    found = []
    for axis in (0, 1):
        comb = find_comb(view.image[..., 0], axis, config.grid)
        sightings = follow_comb(view, comb, config.grid) if comb is not None else None
        combs.append(comb if sightings is not None else None)
        found += [sightings] if sightings is not None else []
    return (combs[0], combs[1]), found


def _follow(
    scene: _Scene, displacement: Displacement, combs: tuple[Comb | None, Comb | None], config: RefineConfig
) -> list[Sightings]:
    """The combs' lines observed again through a better map."""
    if not any(combs):
        return []
    view = _view(scene, displacement)
    again = [follow_comb(view, comb.straight(), config.grid) for comb in combs if comb is not None]
    return [s for s in again if s is not None]


def _judge(
    coarse: BackwardMap, sightings: list[Sightings], fit: DisplacementFit, config: RefineConfig
) -> tuple[BackwardMap | None, str]:
    """The corrected map if it is to be believed, and why or why not."""
    before, after = held_out_residuals(sightings, config.spline)
    size = tuple(max(33, n) for n in coarse.nodes.shape[:2])
    move = float(np.linalg.norm(fit.displacement.values, axis=1).max())
    if not sightings or after > config.min_gain * before:
        return None, f"held-out residual {after:.2f} sigma against {before:.2f} before: no better"
    if move > config.max_move:
        return None, f"the film would move by {move:.3f} of its size"
    backward = fit.displacement.composed(coarse, (size[0], size[1]))
    if backward.folds() and not coarse.folds():
        return None, "the film would fold"
    return backward, f"held-out residual {before:.1f} -> {after:.1f} sigma, moved by up to {100 * move:.1f} %"


def held_out_residuals(sightings: Sequence[Sightings], config: SplineConfig, folds: int = 2) -> tuple[float, float]:
    """Mean clipped residual in stated deviations, before and after, of sightings that the spline did not see.

    Runs of neighbouring sightings are held out together, because neighbours share their errors. The constants
    that a list shares are taken from the sightings that the spline did see.
    """
    clip = 20.0
    before, after, count = 0.0, 0.0, 0
    for fold in range(folds):
        out = [np.arange(len(s)) // 8 % folds == fold for s in sightings]
        fit = fit_displacement([s.subset(~o) for s, o in zip(sightings, out, strict=True)], config)
        for s, o, constants in zip(sightings, out, fit.constants, strict=True):
            held = s.subset(o)
            if not len(held):
                continue
            predicted = fit.displacement(held.places())[:, held.axis] - held.places()[:, held.axis]
            offsets = held.offsets() - held.shared @ constants
            before += np.minimum(np.abs(_without_shared(held)) / held.sigma, clip).sum()
            after += np.minimum(np.abs(offsets - predicted) / held.sigma, clip).sum()
            count += len(held)
    return (before / count, after / count) if count else (0.0, 0.0)


def _without_shared(sightings: Sightings) -> Float[np.ndarray, " n"]:
    """Offsets less what the shared constants alone can explain: what is left if nothing is displaced."""
    if sightings.shared.shape[1] == 0:
        return sightings.offsets()
    best, *_ = np.linalg.lstsq(sightings.shared, sightings.offsets(), rcond=None)
    return sightings.offsets() - sightings.shared @ best


# ---------------------------------------------------------------- reports


def _slice_grid(
    combs: tuple[Comb | None, Comb | None], sightings: list[Sightings], fit: DisplacementFit, backward: BackwardMap
) -> SliceGrid | None:
    """The grid of two combs at the place and pitch that the fit found; None where one of them is missing."""
    columns, rows = combs
    if columns is None or rows is None:
        return None
    lines = []
    for comb in (columns, rows):
        place = comb.lines()
        for s, constants in zip(sightings, fit.constants, strict=True):
            if s.axis == comb.axis and s.shared.shape[1] == 2:
                number, mean = np.arange(comb.cells + 1), _mean_line(s, comb)
                place = place + constants[0] + constants[1] * (number - mean)
        lines.append(np.clip(place, 0.0, 1.0))
    u, v = np.meshgrid(lines[0], lines[1])
    vertices = np.stack([u, v], axis=-1)
    confidence = float(min(columns.strength, rows.strength, 1.0))
    return SliceGrid(rows.cells, columns.cells, vertices, backward.photo_from_film(vertices), confidence)


def _mean_line(sightings: Sightings, comb: Comb) -> float:
    """Mean index of the lines sighted: where the comb's place and pitch were made independent."""
    return float(np.mean((sightings.known - comb.first) / comb.pitch))


def _outline_reason(outline: Sequence[Sightings]) -> str:
    return f"{len(outline)} of 4 edges, {sum(len(s) for s in outline)} points"


def _grid_reason(combs: tuple[Comb | None, Comb | None]) -> str:
    names = [f"{c.cells} {name}" for c, name in zip(combs, ("columns", "rows"), strict=True) if c is not None]
    return " x ".join(names) if names else "no rules or gutters seen"


def _unchanged(coarse: BackwardMap, reason: str, seconds: tuple[float, float, float]) -> Refinement:
    names = ("outline", "grid", "spline")
    return Refinement(
        coarse, None, tuple(StageReport(name, False, reason, s) for name, s in zip(names, seconds, strict=True))
    )


__all__ = ["RefineConfig", "Refinement", "held_out_residuals", "refine"]
