"""Photos with truth for benchmarks that are given none: made by the project's own generator, kept for the next run."""

from __future__ import annotations

from pathlib import Path

from data_gen.generate import GenerateConfig, generate
from data_gen.sample import SampleConfig
from data_gen.sources import PHANTOMS, SourceConfig
from hybrid.files import write_bytes

PHOTO_PX, MAP_PX = 1080, 256
SHARD = 8
OTHER_FILMS = 1_000_000
"""Added to the seed: no data set used for training has these films by chance."""
PHANTOMS_SHOWN = (PHANTOMS, PHANTOMS + 4)
"""Embedded phantoms that data sets print only if they name them."""


def make_photos(folder: Path, count: int, seed: int) -> Path:
    """Make a data set of at least ``count`` photos, each of another film, unless it exists already."""
    done = folder / f".made_{count}_{seed}"
    if not done.exists():
        sample = SampleConfig(photos_per_film=1)
        generate(
            GenerateConfig(
                count,
                folder,
                seed=OTHER_FILMS + seed,
                size=PHOTO_PX,
                map_size=MAP_PX,
                sources=SourceConfig(phantoms=PHANTOMS_SHOWN),
                workers=2,
                shard_size=SHARD,
                sample=sample,
            )
        )
        write_bytes(done, b"")
    return folder


__all__ = ["make_photos"]
