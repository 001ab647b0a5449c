"""The data set from one command: ``python -m data_gen.generate --count N --seed S --out DIR``."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import tyro
from tqdm import tqdm

from data_gen.card import write_card
from data_gen.ct.folder import with_left_out
from data_gen.manifest import (
    deciding,
    describe_dataset,
    described_sources,
    finished_shards,
    generator_digest,
    shard_name,
    sole_writer,
    write_manifest,
    write_shard,
)
from data_gen.sample import SampleConfig
from data_gen.sources import SourceConfig
from data_gen.work import check_open3d, film_bytes, run_command, source_names, workers
from hybrid.errors import ConfigError, DataError, describe, require_at_least

MAX_MAP_SIZE = 448
"""Maps are stored at the photo's size up to this (the published data set's)."""


@dataclass(frozen=True)
class GenerateConfig:
    """Make photos of bent CT films with all their maps."""

    count: int
    """Photos to make; a larger count on the same folder extends its data set."""
    out: Path
    """Folder for the data set; finished shards in it are kept, so an interrupted run resumes."""
    seed: int = 0
    """The same seed gives the same bytes, on processors of one kind."""
    size: int = 256
    """Side of the photos in pixels."""
    map_size: int | None = None
    """Side of the maps; by default that of the photos, but at most 448."""
    sources: tyro.conf.OmitArgPrefixes[SourceConfig] = field(default_factory=SourceConfig)
    """Sources of CT volumes and of light."""
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Number of processes; 0 does everything in this one."""
    scheduler: str | None = None
    """Address of a Dask scheduler whose workers do the work instead; they need this package and the folders of --ct and
    --hdri at the same paths."""
    shard_size: int = 512
    """Photos in a shard."""
    sample: tyro.conf.Suppress[SampleConfig] = field(default_factory=SampleConfig)
    """Everything else: set in Python only."""

    def __post_init__(self) -> None:
        per_film = self.sample.photos_per_film
        require_at_least(self, 0, "seed", "workers")
        require_at_least(self, 1, "count", "shard_size")
        require_at_least(self, 32, "size")
        if self.map_size is not None:
            require_at_least(self, 16, "map_size")
        if self.maps > self.size:
            got, allowed = f"map size {self.maps}", f"up to the {self.size} px of the photos"
        elif self.shard_size % per_film:
            got, allowed = f"shard size {self.shard_size}", f"multiples of the {per_film} photos of a film"
        else:
            return
        raise ConfigError(describe(what="generate", got=got, allowed=allowed, do="Change the option."))

    @property
    def maps(self) -> int:
        """Side of the maps."""
        return min(self.size, MAX_MAP_SIZE) if self.map_size is None else self.map_size

    def sample_config(self) -> SampleConfig:
        """The samples' configuration with the command's options; paths are absolute, since other machines use them."""
        ct, hdri = (folder and folder.absolute() for folder in (self.sources.ct, self.sources.hdri))
        sources = replace(self.sources, ct=ct, hdri=hdri)
        return replace(self.sample, size=self.size, map_size=self.maps, sources=sources)


def generate(config: GenerateConfig) -> None:
    """Write the data set and its card; a progress bar shows rate and time left.

    Raises:
        ConfigError: a folder that holds a data set made otherwise or that another run writes to; no such cluster; no
        Open3D, which only an installation with the extra ``data`` has.
        DataError: sources that cannot be read; a disk that is full or fails. Finished shards are kept in each case.
    """
    check_open3d()
    try:
        with sole_writer(config.out):
            _make_shards(config)
            write_card(config.out)
    except OSError as error:
        do = "Mend that (free space, permissions) and run the same command again: finished shards are kept."
        raise DataError(describe(what="data set", where=config.out, got=error.strerror or error, do=do)) from error


def _make_shards(config: GenerateConfig) -> None:
    """Make the shards that are not there yet."""
    sample, size = config.sample_config(), config.shard_size
    with workers(config.workers, config.scheduler) as those:
        names, left_out = next(those.in_order(with_left_out, [(source_names, sample.sources)]))
        for told in left_out:
            print(told, file=sys.stderr)
        options = _options(config, names)
        entries = finished_shards(config.out, size)
        there = sum(entry.count for entry in entries.values())
        describe_dataset(config.out, options, max(config.count, there))
        counts = {k: min(size, config.count - k * size) for k in range(-(-config.count // size))}
        missing = {k: n for k, n in counts.items() if k not in entries or entries[k].count < n}
        films = those.in_order(film_bytes, _tasks(config, sample, missing))
        with tqdm(total=sum(missing.values()), unit="photo", smoothing=0.05) as bar:
            write_manifest(config.out, entries.values())
            for number, count in missing.items():
                photos = _photos(films, -(-count // sample.photos_per_film), bar)
                path = config.out / shard_name(number)
                entries[number] = write_shard(path, number * size, islice(photos, count))
                write_manifest(config.out, entries.values())


def _tasks(config: GenerateConfig, sample: SampleConfig, missing: dict[int, int]) -> Iterator[tuple[Any, ...]]:
    """The arguments of ``film_bytes`` for all films of the missing shards (number: count of photos), in order."""
    for shard, count in missing.items():
        first = shard * config.shard_size // sample.photos_per_film
        for film in range(first, first - (-count // sample.photos_per_film)):
            yield config.seed, film, sample


def _photos(films: Iterator[list[bytes]], count: int, bar: Any) -> Iterator[bytes]:
    """The photos of the next ``count`` films."""
    for film in islice(films, count):
        for photo in film:
            bar.update()
            yield photo


def _options(config: GenerateConfig, names: dict[str, list[str]]) -> dict[str, Any]:
    """What dataset.json says besides the count: everything that decides the bytes, and no path of this machine."""
    made_of = config.sample_config()
    sources = described_sources(made_of.sources, names)
    sample = {name: value for name, value in asdict(made_of).items() if name != "sources"}
    return deciding(
        generator=generator_digest(), seed=config.seed, shard_size=config.shard_size, sources=sources, sample=sample
    )


def main() -> None:
    """Command line."""
    run_command("data_gen.generate", GenerateConfig, generate)


if __name__ == "__main__":
    main()
