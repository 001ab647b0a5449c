"""FilmNet's maps of a data set's photos, for EdgeNet and BorderNet: ``python -m data_gen.film_maps DATA``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro
from jaxtyping import Float32
from tqdm import tqdm

from data_gen.shards import npy_bytes
from data_gen.work import run_command, start_worker, workers
from hybrid.backward import end_point_error, film_as_seen
from hybrid.effort import RectifyConfig
from hybrid.errors import require_at_least
from hybrid.files import write_bytes
from hybrid.learn.datasets.samples import Place, film_of, open_places, photo_of
from hybrid.learn.datasets.shards import FILM_MAPS
from hybrid.learn.networks.filmnet import FilmNet
from hybrid.learn.networks.inference import ready
from hybrid.learn.networks.weights import packaged_film_net
from hybrid.pipeline.looks import see
from hybrid.pyramid import Pyramid
from hybrid.rectify.coarse.invert import NotInverted
from hybrid.stages import Clock

NODES = (33, 33)
"""Nodes of the maps."""

FAR = 0.2
"""Mean distance from the true map, as a share of the film's longer side, from which on a map is not the film's."""


@dataclass(frozen=True)
class FilmMapsConfig:
    """Write FilmNet's maps of a data set's photos beside its shards, where training of edges and borders finds them."""

    data: Annotated[Path, tyro.conf.Positional]
    """Folder of the data set."""
    workers: int = os.cpu_count() or 1
    """Number of processes; 0 does everything in this one."""

    def __post_init__(self) -> None:
        require_at_least(self, 0, "workers")


def write_film_maps(config: FilmMapsConfig) -> Path:
    """The file with the maps of all samples, in their order.

    Raises:
        DataError: a data set that cannot be read.
    """
    path, count = config.data / FILM_MAPS, len(open_places([config.data]))
    with workers(config.workers, None) as those:
        found = those.in_order(_film_map, ((config.data, number) for number in range(count)))
        maps = np.stack(list(tqdm(found, total=count, unit="photo")))
    write_bytes(path, npy_bytes(maps))
    return path


def film_map(network: FilmNet, place: Place) -> Float32[np.ndarray, "n m 2"]:
    """Nodes of the map that FilmNet finds in a sample's photo, turned as the film is seen; NaN if it finds none, or one
    so far off that its edges are not the film's."""
    found, true = see(network, Pyramid(photo_of(place)), RectifyConfig(), Clock()).inversion, film_of(place)
    if not isinstance(found, NotInverted):
        seen = film_as_seen(found.backward).resized(NODES)
        if end_point_error(seen, film_as_seen(true).nodes).mean() < FAR * max(true.mean_film_pixels()):
            return seen.nodes.astype(np.float32)
    return np.full((*NODES, 2), np.nan, np.float32)


@lru_cache(maxsize=1)
def _network(folder: Path) -> tuple[FilmNet, list[Place]]:
    """The network and all samples of a data set; from now on this process uses one thread only."""
    start_worker()
    torch.set_num_threads(1)
    return ready(packaged_film_net()), open_places([folder])


def _film_map(folder: Path, number: int) -> Float32[np.ndarray, "n m 2"]:
    network, places = _network(folder)
    return film_map(network, places[number])


def main() -> None:
    """Command line."""
    stopped = "no maps are written, and the same command begins anew"
    run_command("data_gen.film_maps", FilmMapsConfig, lambda config: print(write_film_maps(config)), stopped)


if __name__ == "__main__":
    main()
