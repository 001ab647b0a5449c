"""What the film solver is worth: ``python -m benchmarks.simulate --json OUT [--picture PNG] [--quick]``.

It checks strain and drift of a hanging sheet, analytic bending problems, developability of the recipes, units,
determinism, thousands of random scenes, and speed with where the time goes. Run it with ``OMP_NUM_THREADS=1``: the
matrices are too narrow to gain from threads, and waiting threads disturb each other where cores are shared.
"""

from __future__ import annotations

import cProfile
import pstats
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from tqdm import tqdm

from benchmarks.command import require_picture, run_command, write_figures, write_picture
from benchmarks.scenes.mechanics import SZE_TIP, heavy_strip, lattice_sheet, sheared_cantilever
from benchmarks.scenes.recipe_picture import contact_sheet, picture_of
from benchmarks.scenes.stress import StressResult, outcomes, run_scene
from hybrid.errors import require_at_least
from hybrid.mesh.contact import Plane
from hybrid.mesh.film import FilmMesh, film_mesh
from hybrid.mesh.forces import gravity
from hybrid.mesh.loads import Loads
from hybrid.mesh.material import FilmMaterial
from hybrid.mesh.network import MassSpring, clamped, mass_spring
from hybrid.mesh.recipes import RECIPES, BendConfig, simulate
from hybrid.mesh.solver import Frame, SettleConfig, StepConfig, at_rest, settle, step, still

SIDE_MM = 430.0
RECIPE_FRAME = 7
"""The frame of a recipe that is measured and drawn."""


def hanging_loads(side: int, tilt_rad: float, unit: float = 1e-3) -> tuple[MassSpring, Loads]:
    """A square film clamped along its upper edge; its weight pulls ``tilt_rad`` off the film's plane."""
    size = SIDE_MM * 1e-3 / unit
    film = lattice_sheet((size, size), (side - 1, side - 1))
    held = np.zeros(film.shape, bool)
    held[0] = True
    network = clamped(mass_spring(film, FilmMaterial(), unit), held)
    pull = gravity(network, np.array([0.0, np.cos(tilt_rad), np.sin(tilt_rad)]))
    return network, Loads(pull, film.vertices.reshape(-1, 3), np.where(held, np.inf, 0.0).ravel())


def hanging_sheet(seconds: float) -> dict[str, float]:
    """Strain in every frame of a sheet that swings from 53 degrees, and the drift of one that hangs at rest."""
    network, loads = hanging_loads(21, np.arctan(4 / 3))
    frame, swinging = at_rest(network.film), []
    for _ in range(round(30 * seconds)):
        frame = step(network, frame, loads, StepConfig())
        swinging.append(frame.max_strain)
    network, loads = hanging_loads(21, 0.2)
    rest = settle(network, at_rest(network.film), loads, SettleConfig())
    frame, hanging, drift = still(rest), [], 0.0
    for _ in range(round(30 * seconds)):
        frame = step(network, frame, loads, StepConfig())
        hanging.append(frame.max_strain)
        drift = max(drift, _largest_turn(rest.mesh, frame.mesh))
    return {
        "max_strain": max(swinging + hanging),
        "max_strain_at_rest": max(hanging),
        "drift_rad": drift,
        "seconds": seconds,
    }


def _largest_turn(before: FilmMesh, after: FilmMesh) -> float:
    """Largest angle (rad) by which a lattice edge has turned."""
    angles = []
    for axis in (0, 1):
        p, q = np.diff(before.vertices, axis=axis), np.diff(after.vertices, axis=axis)
        angles.append(np.arctan2(np.linalg.norm(np.cross(p, q), axis=-1), (p * q).sum(axis=-1)).max())
    return float(max(angles))


def elastica(cells: Sequence[int]) -> dict[str, Any]:
    """Heavy strips against the analytic solution."""
    table = [asdict(heavy_strip(gamma, n)) for gamma in (1.0, 3.0, 10.0, 30.0, 52.0, 100.0) for n in cells]
    errors = [max(row["error"] for row in table if row["cells"] == n) for n in cells]
    return {
        "max_error": errors[-1],
        "max_error_by_cells": dict(zip(map(str, cells), errors, strict=True)),
        "falls_with_refinement": bool(np.all(np.diff(errors) < 0)),
        "table": table,
    }


def sze(cells: int) -> dict[str, Any]:
    """Cantilevers under end shear against Sze et al. 2004."""
    table = [asdict(sheared_cantilever(share, cells)) for share in SZE_TIP]
    return {"max_error": max(row["error"] for row in table), "table": table}


def recipe_frames(levels: int, seeds: int, names: Sequence[str] = tuple(RECIPES)) -> dict[str, list[Frame]]:
    """One frame of each recipe and seed on a PET film with 4 x 4 slices."""
    lines = np.linspace(0.02, 0.98, 5)
    found: dict[str, list[Frame]] = {}
    for name in names:
        recipe = RECIPES[name][1]
        network = mass_spring(film_mesh((430.0, 350.0), lines, lines, levels), FilmMaterial())
        config = BendConfig(frames=RECIPE_FRAME + 1, max_iterations=20)
        found[name] = [simulate(recipe(network, np.random.default_rng(seed)), config)[-1] for seed in range(seeds)]
    return found


def developability(frames: dict[str, list[Frame]]) -> dict[str, Any]:
    """99th percentiles of |Gaussian curvature| x area (rad) and of edge strain over the recipes, and of each."""
    meshes = {name: [frame.mesh for frame in found] for name, found in frames.items()}
    everything = [mesh for found in meshes.values() for mesh in found]
    return _percentiles(everything) | {"recipes": {name: _percentiles(found) for name, found in meshes.items()}}


def _percentiles(meshes: list[FilmMesh]) -> dict[str, float]:
    curvature = np.concatenate([np.abs(mesh.angle_defects()).ravel() for mesh in meshes])
    strain = np.concatenate([np.abs(mesh.edge_strain()) for mesh in meshes])
    return {
        "gauss_area_p99_rad": float(np.quantile(curvature, 0.99)),
        "edge_strain_p99": float(np.quantile(strain, 0.99)),
        "edge_strain_median": float(np.median(strain)),
    }


def units() -> dict[str, float]:
    """One scene (clamp, weight, table, curl) in metres and centimetres against millimetres; relative to its size."""

    def bent(unit: float) -> np.ndarray:
        network, loads = hanging_loads(13, 1.2, unit)
        per_mm = 1e-3 / unit
        table = Plane(np.array([0.0, 0.0, 60.0 * per_mm]), np.array([0.0, 0.0, -1.0]))
        loads = replace(loads, bodies=(table,), rest_curvature=(0.001 / per_mm, 0.0))
        frame = at_rest(network.film)
        for _ in range(8):
            frame = step(network, frame, loads, StepConfig(dt_s=0.05, tolerance=1e-9, max_iterations=60))
        return frame.mesh.vertices / network.size

    shapes = {name: bent(unit) for name, unit in (("mm", 1e-3), ("cm", 1e-2), ("m", 1.0))}
    return {"max_relative": max(float(np.abs(shapes[name] - shapes["mm"]).max()) for name in ("cm", "m"))}


def determinism() -> dict[str, bool]:
    """Whether two runs of every recipe with one seed agree in every bit."""
    first, second = (recipe_frames(1, 1) for _ in range(2))
    same = all(np.array_equal(first[name][0].mesh.vertices, second[name][0].mesh.vertices) for name in first)
    return {"identical": same}


def stress(count: int, largest: int) -> dict[str, Any]:
    """Run random scenes; failures are listed with their seed."""
    results: list[StressResult] = [run_scene(seed, largest) for seed in tqdm(range(count), desc="stress", unit="scene")]
    failed = [asdict(result) for result in results if result.failure]
    messages = {result.outcome: result.message for result in results}
    return {
        "scenes": count,
        "failures": len(failed),
        "failed": failed,
        "outcomes": outcomes(results),
        "messages": messages,
        "largest_side": largest,
    }


def speed(side: int, frames: int) -> dict[str, Any]:
    """Frames a second of a sheet that swings down from 53 degrees, at 1/30 s a frame, and where the time goes."""
    network, loads = hanging_loads(side, np.arctan(4 / 3))
    config = StepConfig(tolerance=BendConfig().tolerance)
    frame = exact = step(network, at_rest(network.film), loads, config)
    wall, cpu, strains, iterations = [], [], [], []
    for _ in range(frames):
        exact = step(network, exact, loads, replace(config, tolerance=1e-7))
        began, began_cpu = time.perf_counter(), time.process_time()
        frame = step(network, frame, loads, config)
        wall.append(time.perf_counter() - began)
        cpu.append(time.process_time() - began_cpu)
        strains.append(frame.max_strain)
        iterations.append(frame.iterations)
    profile = cProfile.Profile()
    profile.runcall(partial(_some_frames, network, frame, loads, config))
    return {
        "fps": 1 / float(np.median(wall)),
        "fps_best": 1 / min(wall),
        "fps_cpu": 1 / float(np.median(cpu)),
        "ms_median": 1e3 * float(np.median(wall)),
        "ms_iqr": [1e3 * float(np.quantile(wall, q)) for q in (0.25, 0.75)],
        "max_strain": max(strains),
        "tolerance_mm": config.tolerance * network.size,
        "off_converged_mm": float(np.abs(frame.mesh.vertices - exact.mesh.vertices).max()),
        "iterations_mean": float(np.mean(iterations)),
        "share_of_time": _shares(profile),
    }


def _some_frames(network: MassSpring, frame: Frame, loads: Loads, config: StepConfig) -> None:
    for _ in range(4):
        frame = step(network, frame, loads, config)


def _shares(profile: cProfile.Profile) -> dict[str, float]:
    """Share of the time of the functions that take most, including what they call."""
    stats: dict[Any, Any] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    spent: dict[str, float] = {}
    for (path, _, name), (_, _, _, cumulative, _) in stats.items():
        if "mesh" in Path(path).parts:
            spent[name] = max(spent.get(name, 0.0), cumulative)
    parts = ("factor", "solve", "add_cells", "_material_blocks", "_with_each_axis", "gradient", "energy", "strain")
    return {name: round(spent[name] / spent["step"], 3) for name in parts}


@dataclass(frozen=True)
class Options:
    """Check the film solver."""

    json_path: Annotated[Path, tyro.conf.arg(name="json")]
    """File for the figures."""
    picture: Path | None = None
    """File for a picture of the recipes."""
    quick: bool = False
    """Fewer and smaller scenes."""
    scenes: int = 2000
    """Number of random scenes."""
    only: tuple[str, ...] = ()
    """Names of the checks to run; all if none is given."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "scenes")
        require_picture(self, "picture")


def measured(options: Options) -> dict[str, Any]:
    """All figures."""
    quick = options.quick
    frames = cache(partial(recipe_frames, 2, 1 if quick else 2))
    checks: dict[str, Callable[[], dict[str, Any]]] = {
        "speed": lambda: _speeds(6 if quick else 20),
        "hanging_sheet": lambda: hanging_sheet(1.0 if quick else 10.0),
        "elastica": lambda: elastica((8, 16, 32) if quick else (8, 16, 32, 64)),
        "sze": lambda: sze(32),
        "developability": lambda: _refinement(frames(), 1 if quick else 2),
        "units": units,
        "determinism": determinism,
        "stress": lambda: stress(min(options.scenes, 100) if quick else options.scenes, 17 if quick else 65),
    }
    figures: dict[str, Any] = {}
    for name, check in checks.items():
        if not options.only or name in options.only:
            figures[name] = check()
            print(f"{name}: {_short(figures[name])}", flush=True)
    if options.picture is not None:
        tiles = [picture_of(found[0].mesh, name, 620.0) for name, found in frames().items()]
        write_picture(options.picture, contact_sheet(tiles, 5))
    return figures


def _speeds(frames: int) -> dict[str, Any]:
    by_side = {side: speed(side, max(frames // (1 if side < 65 else 3), 3)) for side in (21, 33, 65)}
    return {f"fps_{side}": found["fps"] for side, found in by_side.items()} | {
        f"sides_{side}": found for side, found in by_side.items()
    }


def _refinement(fine: dict[str, list[Frame]], seeds: int) -> dict[str, Any]:
    coarse = developability(recipe_frames(1, seeds))
    refined = developability(fine)
    names = ("gauss_area_p99_rad", "edge_strain_p99")
    return {"coarse": coarse, "fine": refined, "shrinks": all(refined[name] < coarse[name] for name in names)}


def _short(figures: dict[str, Any]) -> str:
    return ", ".join(f"{key} {value:.4g}" for key, value in figures.items() if isinstance(value, int | float))


def run(options: Options, command: list[str]) -> dict[str, Any]:
    """Measure, and write the figures."""
    figures = measured(options)
    write_figures(options.json_path, command, figures)
    return figures


BOUNDS: dict[str, tuple[tuple[str, Callable[[Any], bool]], ...]] = {
    "hanging_sheet": (("max_strain", lambda x: x < 1e-4), ("drift_rad", lambda x: x < 0.01)),
    "elastica": (("max_error", lambda x: x < 0.02), ("falls_with_refinement", bool)),
    "sze": (("max_error", lambda x: x < 0.02),),
    "developability": (("shrinks", bool),),
    "units": (("max_relative", lambda x: x < 1e-6),),
    "determinism": (("identical", bool),),
    "stress": (("failures", lambda x: x == 0),),
}
"""Bounds on the figures of each check."""


def broken_bounds(figures: dict[str, Any]) -> list[str]:
    """The figures that are out of bounds, of the checks that were run."""
    return [
        f"{check}.{name}: {figures[check][name]}"
        for check, bounds in BOUNDS.items()
        if check in figures
        for name, holds in bounds
        if not holds(figures[check][name])
    ]


def _verdict(figures: dict[str, Any]) -> int:
    broken = broken_bounds(figures)
    print("\n".join(f"out of bounds: {one}" for one in broken) or "all bounds are kept")
    return 2 if broken else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if the solver keeps its bounds, 2 otherwise."""
    return run_command("benchmarks.simulate", Options, run, arguments, _verdict)


if __name__ == "__main__":
    sys.exit(main())
