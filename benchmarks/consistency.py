"""Whether the truth of a data set agrees with itself: ``python -m benchmarks.consistency --json OUT --samples 200``.

They are read back from shards, as a trainer reads them: the 3D map projected by the camera hits its pixel; the uv map
and the backward map are inverse; and no pixel at the film's edge, or at a fold, mixes film with anything else. Errors
are in pixels of the photo.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import tyro
from jaxtyping import Bool, Float
from tqdm import tqdm

from benchmarks.command import run_command, write_figures
from data_gen.generate import GenerateConfig, generate
from data_gen.sources import SourceConfig
from hybrid.backward import BackwardMap
from hybrid.coords import pixel_centres, rescale_points
from hybrid.errors import require_at_least
from hybrid.learn.datasets.shards import Shard, open_dataset
from hybrid.mesh.camera import Camera

BOUNDS = {"projection_max_px": 0.05, "inverse_max_px": 0.1, "mixed_pixels": 0}
"""Required of every film pixel."""

MIXED_PX = 0.5
"""An edge value that is off by more than this is not due to rounding: it is a mixture, or another pixel's value."""

STRETCH, SLACK_MM = 1.5, 0.2
"""No chord between neighbours is longer than the film between them, except for stretch and rounding."""


@dataclass(frozen=True, eq=False)
class Truth:
    """The decoded truth of a sample's film.

    mask, uv, xyz: maps; backward: into the photo, as is camera. size_mm: (height, width).
    """

    mask: Bool[np.ndarray, "h w"]
    uv: Float[np.ndarray, "h w 2"]
    xyz: Float[np.ndarray, "h w 3"]
    backward: BackwardMap
    camera: Camera
    size_mm: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Errors:
    """Of one sample. projection, inverse: in photo pixels, for each film pixel. mixed: number of wrong edge pixels."""

    projection: Float[np.ndarray, " n"]
    inverse: Float[np.ndarray, " n"]
    mixed: int
    edge: int


def truth_of(shard: Shard, k: int) -> Truth:
    """Sample ``k`` of a shard."""
    record = shard.record(k)
    camera = record["camera"]
    return Truth(
        mask=shard.field("mask", k),
        uv=shard.field("uv", k),
        xyz=shard.field("xyz", k),
        backward=BackwardMap(shard.field("backward", k)),
        camera=Camera(
            np.array(camera["intrinsics"]),
            np.array(camera["camera_from_world"]),
            tuple(camera["distortion"]),
            tuple(camera["size"]),
        ),
        size_mm=tuple(record["size_mm"]),
    )


def errors_of(truth: Truth) -> Errors:
    """How far the maps of a sample disagree."""
    mask, size = truth.mask, truth.camera.size
    centres = rescale_points(pixel_centres(mask.shape), mask.shape, size)
    projection, inverse = np.zeros(mask.shape), np.zeros(mask.shape)
    projected = truth.camera.photo_from_camera(truth.xyz[mask].astype(np.float64))
    projection[mask] = np.linalg.norm(projected - centres[mask], axis=-1)
    inverse[mask] = np.linalg.norm(truth.backward.photo_from_film(truth.uv[mask]) - centres[mask], axis=-1)
    edge = edge_pixels(truth)
    wrong = edge & ((projection > MIXED_PX) | (inverse > MIXED_PX) | stretched(truth))
    return Errors(projection[mask], inverse[mask], int(wrong.sum()), int(edge.sum()))


def edge_pixels(truth: Truth) -> Bool[np.ndarray, "h w"]:
    """Film pixels with a neighbour that sees no film, or film from elsewhere on the sheet."""
    inner = cv2.erode(truth.mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE) > 0
    jump = np.zeros(truth.mask.shape, bool)
    usual = np.nanmedian(np.abs(np.diff(truth.uv, axis=1)).max(axis=-1)) if truth.mask.any() else 0.0
    for rows, cols in _neighbours():
        here, there = _pair(truth.uv, rows, cols)
        far = np.nan_to_num(np.abs(here - there).max(axis=-1)) > 8 * usual
        for part in _pair(jump, rows, cols):
            part |= far
    return truth.mask & (~inner | jump)


def stretched(truth: Truth) -> Bool[np.ndarray, "h w"]:
    """Pixels whose 3D point is further from a neighbour's than the film between the two is long.

    The film does not stretch, so a chord cannot be longer than the film. A 3D point mixed with background still lies on
    its ray, so its projection is right; this check finds it.
    """
    found = np.zeros(truth.mask.shape, bool)
    on_film_mm = truth.uv * np.array(truth.size_mm[1::-1])
    for rows, cols in _neighbours():
        chord = np.linalg.norm(np.subtract(*_pair(truth.xyz, rows, cols)), axis=-1)
        film = np.linalg.norm(np.subtract(*_pair(on_film_mm, rows, cols)), axis=-1)
        too_long = np.nan_to_num(chord - STRETCH * film) > SLACK_MM
        for part in _pair(found, rows, cols):
            part |= too_long
    return found


def _neighbours() -> tuple[tuple[int, int], ...]:
    """One of each pair of directions to the four direct neighbours."""
    return (0, 1), (1, 0)


def _pair(values: np.ndarray, rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    """Views of all pixels that have a neighbour this many rows and columns further on, and of those neighbours."""
    h, w = values.shape[:2]
    return values[: h - rows, : w - cols], values[rows:, cols:]


def summary(errors: Sequence[Errors]) -> dict[str, Any]:
    """The figures over all samples."""
    figures: dict[str, Any] = {"samples": len(errors), "film_pixels": sum(e.projection.size for e in errors)}
    for name in ("projection", "inverse"):
        every = np.concatenate([getattr(e, name) for e in errors])
        figures |= {f"{name}_max_px": float(every.max()), f"{name}_p99_px": float(np.quantile(every, 0.99))}
        figures[f"{name}_p9999_px"] = float(np.quantile(every, 0.9999))
    mixed, edge = sum(e.mixed for e in errors), sum(e.edge for e in errors)
    worst = np.argsort([-e.inverse.max(initial=0.0) for e in errors])[:5].tolist()
    return figures | {"edge_pixels": edge, "mixed_pixels": mixed, "worst_inverse_samples": worst}


@dataclass(frozen=True)
class Options:
    """Check that the truth of samples agrees with itself."""

    json_path: Annotated[Path, tyro.conf.arg(name="json")]
    """File for the figures."""
    samples: int = 200
    """How many samples."""
    size: int = 256
    """Side of their photos in pixels."""
    data: Path | None = None
    """An existing data set to check."""
    workers: int = 2
    """Processes that make the samples."""
    sources: tyro.conf.OmitArgPrefixes[SourceConfig] = field(default_factory=SourceConfig)
    """What is printed and what lights it."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "samples")
        require_at_least(self, 0, "workers")
        require_at_least(self, 32, "size")


def measured(options: Options) -> dict[str, Any]:
    """The figures of a data set, or of one made for this."""
    if options.data is not None:
        return summary(_errors(options.data, options.samples))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "data"
        generate(
            GenerateConfig(
                options.samples, out, size=options.size, sources=options.sources, workers=options.workers, shard_size=64
            )
        )
        return summary(_errors(out, options.samples))


def _errors(folder: Path, samples: int) -> list[Errors]:
    places = [(shard, k) for shard in open_dataset(folder) for k in range(len(shard))]
    return [errors_of(truth_of(shard, k)) for shard, k in tqdm(places[:samples], desc="samples")]


def run(options: Options, command: list[str]) -> dict[str, Any]:
    """Measure, and write the figures."""
    figures = measured(options)
    write_figures(options.json_path, command, {"required": BOUNDS, **figures})
    return figures


def _verdict(figures: dict[str, Any]) -> int:
    print("\n".join(f"{name}: {value}" for name, value in figures.items()))
    return 0 if all(figures[name] <= bound for name, bound in BOUNDS.items()) else 2


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if every bound is kept, 2 otherwise."""
    return run_command("benchmarks.consistency", Options, run, arguments, _verdict)


if __name__ == "__main__":
    sys.exit(main())
