"""Flat prints alone, for the network that reads films: ``python -m data_gen.flat_prints --count N --out DIR``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import tyro
from tqdm import tqdm

from data_gen.manifest import deciding, describe_dataset, described_sources, sole_writer
from data_gen.prints import make_print
from data_gen.sources import SourceConfig, draw_volume
from data_gen.work import source_names
from hybrid.errors import HybridError, require_at_least
from hybrid.image_io import write_bytes


@dataclass(frozen=True)
class FlatPrintsConfig:
    """Write flat prints as grey JPEG files.

    count: prints to make; those that are there already stay. out: their folder, one for each seed. seed: the same seed
    gives the same prints. sources: of CT volumes.
    """

    count: int
    out: Path
    seed: int = 0
    sources: tyro.conf.OmitArgPrefixes[SourceConfig] = field(default_factory=SourceConfig)

    def __post_init__(self) -> None:
        require_at_least(self, 1, "count")
        require_at_least(self, 0, "seed")


def flat_prints(config: FlatPrintsConfig) -> None:
    """Write the prints that are missing, those with texts only: a film without any may be read either way up.

    Raises:
        ConfigError: ``out`` holds prints made with other options, or another run writes there.
    """
    with sole_writer(config.out):
        sources = described_sources(config.sources, source_names(config.sources))
        options = deciding(sources=sources, seed=config.seed)
        describe_dataset(config.out, options, max(config.count, sum(1 for _ in config.out.glob("*.jpg"))))
        for k in tqdm(range(config.count), unit="print"):
            path = config.out / f"{k:06d}.jpg"
            if not path.exists():
                write_bytes(path, _print_bytes(config, k))


def _print_bytes(config: FlatPrintsConfig, number: int) -> bytes:
    """The JPEG file of a print; no film of a data set of that seed."""
    rng = np.random.default_rng([config.seed, number, 1])
    film_print = make_print(draw_volume(config.sources, rng), rng)
    while not film_print.parameters["text"]:
        film_print = make_print(draw_volume(config.sources, rng), rng)
    pixels = np.rint(film_print.image * 255).astype(np.uint8)
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()


def main() -> None:
    """Command line."""
    try:
        flat_prints(tyro.cli(FlatPrintsConfig, prog="python -m data_gen.flat_prints"))
    except (HybridError, OSError) as error:
        raise SystemExit(f"error: {error}") from None


if __name__ == "__main__":
    main()
