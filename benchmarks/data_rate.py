"""How fast samples are made: ``python -m benchmarks.data_rate --json OUT [--ct DIR --hdri DIR] [--quick]``.

It measures samples a second from two worker processes on the generator's own path (films as tasks, coded samples,
shards on disk), for photos of 1080 px with maps of 448 and of 256 px with maps of 256; memory after 2,000 samples
against 200; processor seconds by part; rays for a sample, and rays a second against what Open3D reaches here.
"""

from __future__ import annotations

import cProfile
import multiprocessing
import os
import pstats
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, count, islice
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import tyro
from threadpoolctl import threadpool_limits

from benchmarks.command import run_command, write_figures
from data_gen.manifest import shard_name, write_shard
from data_gen.sample import SampleConfig
from data_gen.sources import SourceConfig, draw_volume
from data_gen.work import Workers, film_bytes, workers
from hybrid.coords import node_centres_1d
from hybrid.errors import require_at_least
from hybrid.mesh.camera import Camera, look_at
from hybrid.mesh.film import film_mesh
from hybrid.mesh.raycast import FilmCaster

WORKERS = 2
SHARD = 64
"""Samples in a shard here: few, so that closing shards is timed, too."""

REQUIRED = {"rate_1080": 5.0, "rate_256": 20.0, "rss_growth": 0.05}

PARTS: dict[str, tuple[str, ...]] = {
    "print": ("draw_volume", "make_print", "print_levels"),
    "solve": ("bend",),
    "cast": ("__init__ raycast", "view", "annotate", "true_backward_map"),
    "room": ("draw_environment", "prefilter"),
    "shade": ("lit_film", "light_before", "light_through", "room_behind", "behind_film", "at_photo_scale", "composite"),
    "background": ("surroundings", "put_over", "hidden_share"),
    "develop and encode": ("develop",),
    "truth": ("_glare", "_albedo", "_uncovered", "view_parameters"),
    "write": ("sample_bytes", "write_shard"),
}
"""Functions whose time, with all that they call, is a part. Hardly any calls another: ``put_over`` and
``at_photo_scale`` do, for less than a hundredth of the time."""


@dataclass(frozen=True)
class Options:
    """Measure how fast samples are made."""

    json_path: Annotated[Path, tyro.conf.arg(name="json")]
    """File for the figures."""
    quick: bool = False
    """A shorter run, with fewer phantoms, and memory measured after 128 samples only."""
    seconds: float = 40.0
    """Duration of each rate measurement."""
    sources: tyro.conf.OmitArgPrefixes[SourceConfig] = field(default_factory=SourceConfig)
    """CT volumes and environments; without them, everything is built in."""

    def __post_init__(self) -> None:
        require_at_least(self, 0, "seconds")


def measured(options: Options) -> dict[str, Any]:
    """All figures."""
    sources = options.sources
    ct, hdri = (folder and folder.absolute() for folder in (sources.ct, sources.hdri))
    sources = replace(sources, ct=ct, hdri=hdri)
    seconds, marks = options.seconds, (200, 2000)
    if options.quick:
        sources, seconds, marks = replace(sources, phantoms=(0, 1)), min(seconds, 4.0), (64, 128)
    small = SampleConfig(size=256, map_size=256, sources=sources)
    large = replace(small, size=1080, map_size=448)
    with workers(WORKERS, None) as those:
        list(those.in_order(touch_sources, [(small.sources,)] * WORKERS))
        at_1080 = rate(those, large, seconds)
        at_256 = rate(those, small, seconds, marks)
    films = 1 if options.quick else 4
    figures = {
        "rate_1080": at_1080["rate"],
        "rate_256": at_256["rate"],
        "rss_growth": at_256["rss_growth"],
        "required": REQUIRED,
        "runs": {"1080": at_1080, "256": at_256},
        "parts_1080": parts(large, films),
        "parts_256": parts(small, films),
        "open3d_mray_per_s": open3d_peak(1_000_000 if not options.quick else 100_000),
    }
    for size in ("1080", "256"):
        casting = figures[f"parts_{size}"]
        casting["share_of_open3d_peak"] = casting["mray_per_s"] / figures["open3d_mray_per_s"]
    return figures


# ---------------------------------------------------------------- rate and memory


def touch_sources(config: SourceConfig) -> None:
    """Load or make every volume in this process: they are kept from then on, and count as neither rate nor growth."""
    for seed in range(40 * (config.phantoms[1] - config.phantoms[0]) // 4):
        draw_volume(config, np.random.default_rng(seed))


def rate(those: Workers, config: SampleConfig, seconds: float, marks: tuple[int, ...] = ()) -> dict[str, Any]:
    """Samples a second in a steady state, and the resident memory of all processes after ``marks`` samples.

    core_seconds: processor time of all processes for a sample. The rate says little where other work runs on the
    machine; two idle cores make at most 2 / core_seconds.
    """
    films = those.in_order(film_bytes, ((1, number, config) for number in count()))
    list(islice(films, 3 * WORKERS))  # imports, first allocations, and filling the queue
    stream, memory, made = chain.from_iterable(films), {}, 0
    with tempfile.TemporaryDirectory() as folder:
        began, busy = time.perf_counter(), processor_seconds()
        timed: tuple[int, float, float] | None = None
        while timed is None or made < max(marks, default=0):
            path = Path(folder) / shard_name(made // SHARD)
            made += write_shard(path, made, islice(stream, SHARD)).count
            path.unlink()
            if timed is None and time.perf_counter() - began >= seconds:
                timed = made, time.perf_counter() - began, processor_seconds() - busy
            memory |= {mark: resident_mib() for mark in marks if mark <= made and mark not in memory}
    samples, elapsed, busy = timed
    found = {"samples": samples, "seconds": elapsed, "rate": samples / elapsed, "core_seconds": busy / samples}
    if marks:
        found |= {"rss_mib": memory, "rss_growth": memory[max(marks)] / memory[min(marks)] - 1}
    return found


def resident_mib() -> float:
    """Resident memory of this process and its workers."""
    return sum(_resident_kib(pid) for pid in _processes()) / 1024


def processor_seconds() -> float:
    """Processor time that this process and its workers have used."""
    fields = (Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split() for pid in _processes())
    return sum(int(field[11]) + int(field[12]) for field in fields) / os.sysconf("SC_CLK_TCK")


def _processes() -> list[int]:
    processes = [multiprocessing.current_process(), *multiprocessing.active_children()]
    return [process.pid for process in processes if process.pid]


def _resident_kib(pid: int) -> int:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


# ---------------------------------------------------------------- where the time goes


def parts(config: SampleConfig, films: int) -> dict[str, Any]:
    """Processor seconds for a sample by part, in this process alone; rays cast and their rate."""
    list(_written(config, films))  # makes the phantoms
    profile = cProfile.Profile(time.process_time)
    rays = _RayCount()
    with rays, threadpool_limits(1):
        before = cv2.getNumThreads()
        cv2.setNumThreads(1)
        samples = profile.runcall(lambda: sum(_written(config, films)))
        cv2.setNumThreads(before)
    stats = pstats.Stats(profile)
    spent = {name: sum(_seconds(stats, function) for function in each) / samples for name, each in PARTS.items()}
    whole = _seconds(stats, "_written") / samples
    spent["rest"] = whole - sum(spent.values())
    casting = _seconds(stats, "_cast")
    return {
        "samples": samples,
        "seconds": whole,
        "seconds_by_part": {name: round(value, 5) for name, value in spent.items()},
        "percent_by_part": {name: round(100 * value / whole, 1) for name, value in spent.items()},
        "rays": rays.cast / samples,
        "mray_per_s": rays.cast / casting / 1e6,
    }


def _written(config: SampleConfig, films: int) -> Iterator[int]:
    """Make films and write them as a shard; yields the number of samples."""
    with tempfile.TemporaryDirectory() as folder:
        made = [photo for number in range(films) for photo in film_bytes(2, number, config)]
        yield write_shard(Path(folder) / shard_name(0), 0, made).count


class _RayCount:
    """Counts the rays that all casters cast while the context is active."""

    def __init__(self) -> None:
        self.cast = 0

    def __enter__(self) -> _RayCount:
        self._original = original = FilmCaster._cast

        def counted(caster: FilmCaster, camera: Camera, directions: np.ndarray) -> Any:
            self.cast += directions[..., 0].size
            return original(caster, camera, directions)

        FilmCaster._cast = counted  # type: ignore[method-assign]
        return self

    def __exit__(self, *_: object) -> None:
        FilmCaster._cast = self._original  # type: ignore[method-assign]


def _seconds(stats: pstats.Stats, function: str) -> float:
    """Cumulative seconds of this project's functions of one name; 'name module' tells methods apart."""
    name, _, module = function.partition(" ")
    total = 0.0
    table: dict[Any, Any] = stats.stats  # type: ignore[attr-defined]
    for (path, _, found), (_, _, _, cumulative, _) in table.items():
        ours = {"hybrid", "data_gen", "benchmarks"} & set(Path(path).parts)
        if found == name and ours and module in Path(path).stem:
            total += cumulative
    return total


def open3d_peak(rays: int) -> float:
    """Million rays a second on one thread that Open3D's own call reaches: all rays ready, all meeting a bent film."""
    import open3d as o3d

    t = node_centres_1d(5)
    flat = film_mesh((430.0, 350.0), t, t, 3)
    x, y = flat.vertices[..., 0], flat.vertices[..., 1]
    caster = FilmCaster(flat.bent(np.stack([x, y, 20 * np.sin(x / 80)], axis=-1)))
    side = int(np.sqrt(rays))
    focal = np.array([[4.0 * side, 0, side / 2], [0, 4.0 * side, side / 2], [0, 0, 1]])
    camera = Camera(
        focal, look_at(np.array([0, 0, -1200.0]), np.zeros(3), np.array([0, 1.0, 0])), (0.0, 0.0), (side, side)
    )
    lines = np.empty((side, side, 6), np.float32)
    lines[..., :3] = camera.centre_world
    lines[..., 3:] = camera.pixel_rays() @ camera.camera_from_world[:3, :3]
    tensor, best = o3d.core.Tensor.from_numpy(lines), np.inf
    for _ in range(5):
        began = time.process_time()
        caster.scene.cast_rays(tensor)
        best = min(best, time.process_time() - began)
    return side**2 / best / 1e6


def run(options: Options, command: list[str]) -> dict[str, Any]:
    """Measure, and write the figures."""
    figures = measured(options)
    write_figures(options.json_path, command, figures)
    return figures


def _verdict(figures: dict[str, Any]) -> int:
    for name, bound in REQUIRED.items():
        print(f"{name}: {figures[name]:.4g} (required {'<=' if name == 'rss_growth' else '>='} {bound})")
    for size in ("1080", "256"):
        print(size, figures[f"parts_{size}"])
    fast = all(figures[name] >= REQUIRED[name] for name in ("rate_1080", "rate_256"))
    return 0 if fast and figures["rss_growth"] <= REQUIRED["rss_growth"] else 2


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if every required figure is reached, 2 otherwise."""
    return run_command("benchmarks.data_rate", Options, run, arguments, _verdict)


if __name__ == "__main__":
    sys.exit(main())
