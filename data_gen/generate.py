"""The data set from one command: ``python -m data_gen.generate --count N --seed S --out DIR``."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import tyro
from tqdm import tqdm

from data_gen.sample import Sample, SampleConfig, film_samples
from data_gen.shards import ShardWriter
from data_gen.sources import SourceConfig
from hybrid.coords import CONVENTIONS_VERSION
from hybrid.errors import ConfigError, HybridError, describe

MAX_MAP_SIZE = 448
"""Maps are stored at the photo's size up to this (the published data set's)."""


@dataclass(frozen=True)
class GenerateConfig:
    """Make photos of bent CT films with all their maps.

    count: photos to make. out: folder for the data set; finished shards in it are kept, so a run that was cut off
        goes on. seed: the same seed gives the same photos.
    size: side of the photos in pixels. map_size: side of the maps (photo size, at most 448).
    sources: of CT volumes and of light. workers: processes (all cores).
    shard_size: photos in a shard. sample: everything else.
    """

    count: int
    out: Path
    seed: int = 0
    size: int = 256
    map_size: int | None = None
    sources: tyro.conf.OmitArgPrefixes[SourceConfig] = field(default_factory=SourceConfig)
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    shard_size: int = 512
    sample: tyro.conf.Suppress[SampleConfig] = field(default_factory=SampleConfig)


def generate(config: GenerateConfig) -> None:
    """Write the data set; a progress bar shows rate and time left.

    Raises:
        ConfigError: a count, size or folder that cannot be; a folder that holds a data set made otherwise.
    """
    sample_config = _sample_config(config)
    config.out.mkdir(parents=True, exist_ok=True)
    _describe_dataset(config, sample_config)
    per_film = sample_config.photos_per_film
    with tqdm(total=config.count, unit="photo", smoothing=0.05) as bar:
        for shard in range(-(-config.count // config.shard_size)):
            folder = config.out / f"shard_{shard:05d}"
            first = shard * config.shard_size
            count = min(config.shard_size, config.count - first)
            if folder.exists():
                bar.update(count)
                continue
            shutil.rmtree(folder.with_name(folder.name + ".part"), ignore_errors=True)
            writer = ShardWriter(folder, count, sample_config.map_size)
            films = range(first // per_film, -(-(first + count) // per_film))
            for sample in _samples(films, config, sample_config):
                if writer.written < count:
                    writer.add(sample)
                    bar.update()


def _samples(films: range, config: GenerateConfig, sample_config: SampleConfig) -> Iterator[Sample]:
    """The films' photos in order, made by the workers."""
    make = partial(_film, config.seed, sample_config)
    if config.workers <= 1:
        for number in films:
            yield from make(number)
        return
    for photos in _pool(config.workers).imap(make, films):
        yield from photos


_POOLS: dict[int, Any] = {}


def _pool(workers: int) -> Any:
    """Worker processes, started once: what they load (volumes, phantoms, environments) serves all shards."""
    if workers not in _POOLS:
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            os.environ.setdefault(name, "1")  # the workers are the parallelism
        _POOLS[workers] = multiprocessing.get_context("spawn").Pool(workers, initializer=_one_thread)
    return _POOLS[workers]


def _one_thread() -> None:
    import cv2

    cv2.setNumThreads(1)


def _film(seed: int, config: SampleConfig, number: int) -> list[Sample]:
    return list(film_samples(seed, number, config))


def _sample_config(config: GenerateConfig) -> SampleConfig:
    """The samples' configuration with the command's options in it, checked."""
    if config.count < 1 or config.size < 32 or config.workers < 1 or config.shard_size < config.sample.photos_per_film:
        raise ConfigError(
            describe(
                what="generate",
                got=[config.count, config.size, config.workers, config.shard_size],
                allowed=f"count >= 1, size >= 32, workers >= 1, shard_size >= {config.sample.photos_per_film}",
                do="Change the option.",
            )
        )
    for name in ("ct", "hdri"):
        folder = getattr(config.sources, name)
        if folder is not None and not folder.is_dir():
            raise ConfigError(
                describe(what=f"--{name}", where=folder, do="Name a folder that exists, or leave it out.")
            )
    map_size = config.map_size or min(config.size, MAX_MAP_SIZE)
    return replace(config.sample, size=config.size, map_size=map_size, sources=config.sources)


def _describe_dataset(config: GenerateConfig, sample_config: SampleConfig) -> None:
    """Write dataset.json, or check that the one there belongs to the same data set."""
    path = config.out / "dataset.json"
    options = json.loads(json.dumps(asdict(sample_config), default=str))
    options["sources"] |= {name: getattr(config.sources, name) is not None for name in ("ct", "hdri")}
    made = {"seed": config.seed, "shard_size": config.shard_size, "conventions": CONVENTIONS_VERSION, "sample": options}
    if path.exists() and json.loads(path.read_text()) != made:
        raise ConfigError(
            describe(what="generate", where=path, got="a data set made with other options", do="Choose another --out.")
        )
    path.write_text(json.dumps(made, indent=1))


def main() -> None:
    """Command line."""
    try:
        generate(tyro.cli(GenerateConfig, prog="python -m data_gen.generate"))
    except HybridError as error:
        raise SystemExit(f"error: {error}") from None


if __name__ == "__main__":
    main()
