"""Random problems for single parts of the code: splines, uv maps, grids. Each must be solved, or refused for a reason.

An outcome (``End``) is a residual, a refusal, or a failure: an exception that is no refusal, a number that is not
finite, a law that is broken.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from benchmarks.report.stress_records import Part
from benchmarks.scenes.stress import run_scene
from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, pixel_centres
from hybrid.errors import HybridError
from hybrid.records import CoarseMaps
from hybrid.rectify.coarse.invert import NotInverted, fit_backward
from hybrid.rectify.grid.lines import GridConfig, find_comb
from hybrid.rectify.splines.tps import affine_basis, choose_smoothing, fit_tps, fit_tps_robust

SHOWN = 8
"""Number of failures that are described."""

ROUNDING = 1e-6
"""How much a fit may violate a law of exact arithmetic, relative to the spread of the fitted values."""


@dataclass(frozen=True)
class End:
    """How a problem ended: its residual if it was solved; else the type of refusal, or what failed."""

    residual: float = 0.0
    refusal: str = ""
    failure: str = ""


Problem = Callable[[np.random.Generator], End]


def ended(problem: Problem, seed: int) -> End:
    """Run a problem; any exception but the project's own is a failure."""
    try:
        with np.errstate(all="ignore"):
            return problem(np.random.default_rng(seed))
    except HybridError as refusal:
        readable = len(str(refusal)) > 30 and "got" in str(refusal)
        return End(refusal=type(refusal).__name__) if readable else End(failure=f"seed {seed}: unreadable '{refusal}'")
    except Exception as error:
        return End(failure=f"seed {seed}: {type(error).__name__}: {error}")


def part_of(name: str, what: str, unit: str, ends: Iterable[End]) -> Part:
    """Summarise many ends in numbers."""
    found = list(ends)
    failures = [end.failure for end in found if end.failure]
    refusals = Counter(end.refusal for end in found if end.refusal)
    solved = [end.residual for end in found if not end.failure and not end.refusal]
    return Part(
        name=name,
        what=what,
        tried=len(found),
        refused=sum(refusals.values()),
        failed=len(failures),
        worst=max(solved, default=0.0),
        unit=unit,
        refusals=dict(sorted(refusals.items())),
        failures=tuple(failures[:SHOWN]),
    )


# ---------------------------------------------------------------- solver


def solver(rng: np.random.Generator) -> End:
    """A sheet under loads; stiffness over nine decades, meshes of 2 to 17 vertices a side."""
    result = run_scene(int(rng.integers(2**32)), largest=17)
    if result.failure:
        return End(failure=f"scene {result.seed}: {result.failure}")
    return End(residual=result.growth) if result.outcome.isupper() else End(refusal=result.outcome)


# ---------------------------------------------------------------- spline


def spline(rng: np.random.Generator) -> End:
    """4 to 400 points, some of them repeated, nearly so, or on a line, at any scale, some of them wrong.

    A spline explains its points at least as well as the best affine map, which does not bend at all. The residual: what
    an interpolating spline leaves; where points repeat, that is their disagreement.
    """
    points = _random_points(rng)
    values = points @ rng.normal(size=(2, 2)) + 0.2 * np.ptp(points) * np.sin(points / max(np.ptp(points), 1e-9))
    spread = float(np.ptp(values)) or 1.0
    values = values + rng.normal(0, 10 ** rng.uniform(-6, -1) * spread, values.shape)
    wrong = rng.random(len(points)) < rng.uniform(0, 0.3)
    values[wrong] += rng.normal(0, spread, (int(wrong.sum()), 2))
    if rng.random() < 0.03:
        values[0, 0] = np.nan
    kind = rng.choice(["interpolating", "smooth", "robust"])
    if kind == "robust":
        fitted = fit_tps_robust(points, values, smoothing=float(10 ** rng.uniform(-3, 3)), sigma=0.01 * spread)
    else:
        fitted = fit_tps(points, values, 0.0 if kind == "interpolating" else choose_smoothing(points, values))
    residuals = fitted.residuals(points, values)
    if not np.isfinite(residuals).all():
        return End(failure=f"{kind}: not finite")
    if kind == "robust":
        return End()  # a robust fit need not explain what it rejects
    spline_rms, affine_rms = _rms(residuals), _rms(_affine_residuals(points, values))
    if spline_rms > affine_rms + ROUNDING * spread:
        return End(failure=f"{kind}: residual {spline_rms:.3g} above the affine map's {affine_rms:.3g}")
    return End(residual=spline_rms / spread if kind == "interpolating" else 0.0)


def _random_points(rng: np.random.Generator) -> Float[np.ndarray, "n 2"]:
    count = int(4 * 100 ** rng.random())
    points = rng.uniform(0, 1, (count, 2))
    kind = rng.choice(["scattered", "lattice", "line", "nearly a line", "repeated", "close"])
    if kind == "lattice":
        side = max(2, int(np.sqrt(count)))
        points = film_nodes((side, side)).reshape(-1, 2)
    elif kind in ("line", "nearly a line"):
        points[:, 1] = points[:, 0] + (0 if kind == "line" else 1e-7 * rng.normal(size=count))
    elif kind in ("repeated", "close"):
        twin = rng.integers(0, count, count // 2)
        points[: count // 2] = points[twin] + (0 if kind == "repeated" else 1e-9 * rng.normal(size=(count // 2, 2)))
    return points * 10 ** rng.uniform(-3, 6) + rng.normal(size=2) * 10 ** rng.uniform(-3, 6)


def _affine_residuals(points: np.ndarray, values: np.ndarray) -> Float[np.ndarray, " n"]:
    basis = affine_basis((points - points.mean(axis=0)) / max(float(points.std()), 1e-300))
    return np.linalg.norm(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0], axis=1)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


# ---------------------------------------------------------------- inversion


def inversion(rng: np.random.Generator) -> End:
    """uv maps of random sheets with noise, holes, wrong pixels and NaN, up to nonsense.

    The residual counts only for maps with no defect but noise: error in % of the film's diagonal.
    """
    true = random_sheet(rng)
    points = pixel_centres((32, 32)) * (1080 / 32)
    uv = true.film_from_photo(points)
    mask = np.asarray(np.isfinite(uv).all(axis=-1), dtype=np.float64)
    uv = np.nan_to_num(uv) + rng.normal(0, 10 ** rng.uniform(-5, -2), uv.shape)
    kind = rng.choice(["noise", "holes", "wrong", "nan", "nonsense", "constant", "empty"])
    bad = rng.random(mask.shape) < rng.uniform(0.05, 0.6)
    if kind == "holes":
        mask[bad] = 0.0
    elif kind in ("wrong", "nan"):
        uv[bad] = rng.normal(0.5, 1.0, (int(bad.sum()), 2)) if kind == "wrong" else np.nan
    elif kind in ("nonsense", "constant"):
        uv = rng.normal(0.5, 0.5, uv.shape) if kind == "nonsense" else np.full_like(uv, 0.3)
    elif kind == "empty":
        mask[:] = 0.0
    maps = CoarseMaps(mask, uv, np.zeros((*mask.shape, 3)), np.zeros(mask.shape), points)
    found = fit_backward(maps)
    if isinstance(found, NotInverted):
        return End(refusal="NotInverted") if found.reason else End(failure=f"{kind}: refused without a reason")
    if not np.isfinite([found.residual_px, found.coverage, found.inlier_share]).all():
        return End(failure=f"{kind}: not finite")
    error = np.linalg.norm(found.backward.photo_from_film(film_nodes((9, 9))) - _lattice(true), axis=-1).mean()
    return End(residual=100 * float(error / np.hypot(*true.mean_film_pixels())) if kind == "noise" else 0.0)


def random_sheet(rng: np.random.Generator) -> BackwardMap:
    """A sheet in a photo of 1080 px: turned, seen in perspective, bent smoothly without a fold."""
    angle, size = rng.uniform(-np.pi, np.pi), rng.uniform(350, 750, 2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    tilt, waves, phase = rng.normal(0, 0.12, 2), rng.uniform(0, 0.05, 2), rng.uniform(0, 2 * np.pi, 2)

    def photo_from_film(uv: np.ndarray) -> np.ndarray:
        centred = uv - 0.5 + waves * np.sin(3 * uv[:, ::-1] + phase)
        plane = (centred * size) @ turn.T
        return 540 + plane / (1 + (centred @ tilt)[:, None])

    return BackwardMap.from_function(photo_from_film)


def _lattice(true: BackwardMap) -> Float[np.ndarray, "9 9 2"]:
    return true.photo_from_film(film_nodes((9, 9)))


# ---------------------------------------------------------------- grid


def grid(rng: np.random.Generator) -> End:
    """Combs of lines of any number, contrast and noise, and pictures without any.

    The residual: how far a found line lies from the nearest drawn one, in % of the film. It is a failure if a comb is
    found that refinement would believe by itself, where nothing is drawn or with the wrong number of cells.
    """
    height, width = (int(n) for n in rng.integers(40, 700, 2))
    image = rng.normal(rng.uniform(10, 120), 10 ** rng.uniform(-1, 1.2), (height, width)).astype(np.float32)
    cells = int(rng.integers(2, 9)) if rng.random() < 0.7 else 0
    margin = float(rng.choice([0.0, rng.uniform(0.01, 0.05)]))
    true = np.linspace(margin, 1 - margin, cells + 1)
    thick, contrast = int(rng.integers(1, 4)), float(rng.choice([-1, 1]) * 10 ** rng.uniform(0, 2))
    for line in true if cells else ():
        at = int(np.clip(line * width, 0, width - thick))
        image[:, at : at + thick] += contrast
    kind = rng.choice(["plain", "plain", "constant", "gradient"])
    if kind == "constant" and not cells:
        image[:] = 7.0
    elif kind == "gradient":
        image += cv2.resize(
            rng.normal(0, 40, (3, 3)).astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC
        )
    comb = find_comb(image, 0, GridConfig())
    if comb is None or comb.cells < 3 or comb.strength < GridConfig().sure_share:
        return End(refusal="no comb" if comb is None else "not sure")
    lines = comb.lines()
    if not np.isfinite(lines).all():
        return End(failure="not finite")
    if comb.cells != cells:
        return End(failure=f"{comb.cells} cells found, {cells} drawn ({width} x {height} px, contrast {contrast:.1f})")
    return End(residual=100 * float(np.abs(lines[:, None] - true).min(axis=1).max()))


PROBLEMS: dict[str, tuple[Problem, str, str]] = {
    "solver": (solver, "sheets under loads, nine decades of stiffness", "relative growth of energy"),
    "spline": (
        spline,
        "repeated, close and collinear points, 30 % outliers, any scale",
        "of the spread (interpolating)",
    ),
    "inversion": (inversion, "uv maps with noise, holes, wrong pixels, NaN, nonsense", "% of the film (noise only)"),
    "grid": (grid, "combs of lines in noise, and pictures without", "% of the film"),
}
"""Name: problem, description, unit of the residual."""

__all__ = ["PROBLEMS", "End", "ended", "part_of", "random_sheet"]
