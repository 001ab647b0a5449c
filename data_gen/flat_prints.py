"""Flat prints alone, for networks that tell which way is up: ``python -m data_gen.flat_prints --count N --out DIR``."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import tyro

from data_gen.manifest import deciding, describe_dataset, described_sources, generator_digest, sole_writer
from data_gen.prints.prints import FilmPrint, make_print
from data_gen.sources import SourceConfig, draw_volume
from data_gen.work import run_command, source_names, start_worker, write_missing
from hybrid.errors import require_at_least
from hybrid.files import write_bytes


@dataclass(frozen=True)
class FlatPrintsConfig:
    """Write flat prints as grey JPEG files, each with a JSON file that says where its slices are."""

    count: int
    """Prints to make; existing ones are kept."""
    out: Path
    """Their folder, one for each seed."""
    seed: int = 0
    """The same seed gives the same prints."""
    workers: int = os.cpu_count() or 1
    """Number of processes; 0 does everything in this one."""
    sources: tyro.conf.OmitArgPrefixes[SourceConfig] = field(default_factory=SourceConfig)
    """Sources of CT volumes."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "count")
        require_at_least(self, 0, "seed", "workers")


def flat_prints(config: FlatPrintsConfig) -> None:
    """Write the prints that are missing, those with text only: a film without any may be read either way up.

    Raises:
        ConfigError: ``out`` holds prints made with other options, or another run writes there.
    """
    with sole_writer(config.out):
        sources = described_sources(config.sources, source_names(config.sources))
        options = deciding(generator=generator_digest(), sources=sources, seed=config.seed)
        describe_dataset(config.out, options, max(config.count, sum(1 for _ in config.out.glob("*.jpg"))))
        write_missing(_write_print, config, _path, "print")


def _path(config: FlatPrintsConfig, number: int) -> Path:
    return config.out / f"{number:06d}.jpg"


def _write_print(config: FlatPrintsConfig, number: int) -> None:
    start_worker()
    film_print, path = written_print(config.seed, number, config.sources), _path(config, number)
    pixels = np.rint(film_print.image * 255).astype(np.uint8)
    about = {"vertices": film_print.vertices.tolist(), **film_print.parameters}
    write_bytes(path.with_suffix(".json"), json.dumps(about).encode())
    write_bytes(path, cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes())


def written_print(seed: int, number: int, sources: SourceConfig) -> FilmPrint:
    """Print ``number`` of a seed, with text; no data set of that seed contains it."""
    rng = np.random.default_rng([seed, number, 1])
    film_print = make_print(draw_volume(sources, rng), rng)
    while not film_print.parameters["text"]:
        film_print = make_print(draw_volume(sources, rng), rng)
    return film_print


def main() -> None:
    """Command line."""
    run_command("data_gen.flat_prints", FlatPrintsConfig, flat_prints)


if __name__ == "__main__":
    main()
