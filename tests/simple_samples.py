"""Samples made in a millisecond, for tests of code that uses samples: a cylinder in front of a camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import data_gen.generate
import data_gen.work
from data_gen.sample import Sample, SampleConfig
from hybrid.backward import BackwardMap
from hybrid.coords import film_centres, film_nodes
from hybrid.mesh.camera import Camera
from hybrid.mesh.raycast import AnnotationMaps

CONFIG = SampleConfig(size=48, map_size=32, photos_per_film=2)
SIZE_MM = (350.0, 430.0)


def cylinder(uv: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Points in mm and normals of a sheet rolled about its v axis."""
    angle = (uv[..., 0] - 0.5) * SIZE_MM[1] / radius
    y = (uv[..., 1] - 0.5) * SIZE_MM[0]
    points = np.stack([radius * np.sin(angle), y, 700 + radius * np.cos(angle)], axis=-1)
    return points, np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)


def simple_film(seed: int, number: int, config: SampleConfig) -> list[Sample]:
    """Stands in for ``film_samples``."""
    rng = np.random.default_rng([seed, number])
    return [_simple_sample(rng, config, {"film": number, "photo": k}) for k in range(config.photos_per_film)]


def _simple_sample(rng: np.random.Generator, config: SampleConfig, parameters: dict[str, Any]) -> Sample:
    n, size, radius = config.map_size, config.size, float(rng.uniform(200, 900))
    uv = film_centres((n, n)) * rng.uniform(0.8, 1.2)
    mask = (uv < 1).all(axis=-1) & (rng.random((n, n)) > 0.1)
    xyz, normal = cylinder(uv, radius)
    for values in (uv, xyz, normal):
        values[~mask] = np.nan
    vertices = film_nodes((5, 4))
    photo = cv2.imencode(".jpg", rng.integers(0, 256, (size, size, 3), dtype=np.uint8))[1].tobytes()
    intrinsics = np.array([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1.0]])
    return Sample(
        photo=photo,
        maps=AnnotationMaps(mask, uv, xyz, normal),
        albedo=np.where(mask, rng.random((n, n)), np.nan),
        glare=mask & (rng.random((n, n)) > 0.9),
        backward=BackwardMap(film_nodes((5, 5)) * size),
        grid_world=cylinder(vertices, radius)[0],
        grid_camera=cylinder(vertices, radius)[0],
        grid_photo=vertices * size,
        grid_film=vertices,
        camera=Camera(intrinsics, np.eye(4), (0.0, 0.0), (size, size)),
        size_mm=SIZE_MM,
        parameters=parameters | {"light": {"box": float(rng.random())}, "radius": radius},
    )


def simple_dataset(out: Path, count: int = 4, shard_size: int = 4) -> Path:
    """The folder of a data set of simple samples, made without its card."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(data_gen.work, "film_samples", simple_film)
        patch.setattr(data_gen.generate, "write_card", lambda folder: None)
        _generate(out, count, shard_size)
    return out


def generate_simple(out: Path, count: int, shard_size: int, started: Any) -> None:
    """``generate`` with simple samples, for a process that will be killed; ``started`` is set when it begins."""
    data_gen.work.film_samples = simple_film  # type: ignore[assignment]
    data_gen.generate.write_card = lambda folder: None
    started.set()
    _generate(out, count, shard_size)


def _generate(out: Path, count: int, shard_size: int) -> None:
    data_gen.generate.generate(
        data_gen.generate.GenerateConfig(
            count=count, out=out, size=48, map_size=32, workers=0, shard_size=shard_size, sample=CONFIG
        )
    )
