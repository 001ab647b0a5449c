"""Flat prints alone, for the network that reads films: ``python -m data_gen.flat_prints --count N --out DIR``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import tyro
from tqdm import tqdm

from data_gen.prints import make_print
from data_gen.sources import SourceConfig, draw_volume
from hybrid.errors import HybridError
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


def flat_prints(config: FlatPrintsConfig) -> None:
    """Write the prints that are missing, those with texts only: a film without any may be read either way up."""
    config.out.mkdir(parents=True, exist_ok=True)
    sources = config.sources
    for k in tqdm(range(config.count), unit="print"):
        path = config.out / f"{k:06d}.jpg"
        if path.exists():
            continue
        rng = np.random.default_rng([config.seed, k, 1])  # no film of a data set of that seed
        film_print = make_print(draw_volume(sources, rng), rng)
        while not film_print.parameters["text"]:
            film_print = make_print(draw_volume(sources, rng), rng)
        pixels = np.rint(film_print.image * 255).astype(np.uint8)
        write_bytes(path, cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes())


def main() -> None:
    """Command line."""
    try:
        flat_prints(tyro.cli(FlatPrintsConfig, prog="python -m data_gen.flat_prints"))
    except (HybridError, OSError) as error:
        raise SystemExit(f"error: {error}") from None


if __name__ == "__main__":
    main()
