"""The work: each film is a task, done by processes on this machine or by the workers of a Dask cluster."""

from __future__ import annotations

import asyncio
import ctypes
import multiprocessing
import os
import socket
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

import cv2
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from data_gen.render.clutter import draw_sprites
from data_gen.sample import SampleConfig, film_samples
from data_gen.shards import sample_bytes
from data_gen.sources import SourceConfig, loaded
from hybrid.command import FAILED, NOT_UNDERSTOOD, run_options
from hybrid.errors import ConfigError, DataError, HybridError, describe, install_extra
from hybrid.workers import deaf_to_interrupts, leave_with_parent

Options = TypeVar("Options")

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

KEPT_ARRAY_BYTES = 2**25
"""Larger arrays than this are returned to the system at once; glibc accepts no larger value."""

_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD = -3, -1  # of glibc's malloc.h

CLUSTER_AHEAD = 16
"""At least this many films are sent to a cluster at a time, for clusters that add workers when work is waiting."""

CLUSTER_PATIENCE = "20s"
"""How long a scheduler may take to answer."""

FINISHED_IS_KEPT = "what is finished is kept, and the same command goes on"
"""What is true after Ctrl-C, where files are written one after the other."""

_AGAIN = "Run the same command again: finished shards are kept."


def check_open3d() -> None:
    """Check for Open3D, which bends films and casts rays on them, before work begins: the error says how to install it.

    Raises:
        ConfigError: there is no Open3D, which needs an installation with the extra ``data``.
    """
    if find_spec("open3d") is None:
        raise ConfigError(describe(what="Making data", got="no Open3D", do=install_extra("data")))


def run_command(
    module: str, kind: type[Options], run: Callable[[Options], Any], stopped: str = FINISHED_IS_KEPT
) -> None:
    """Run ``python -m MODULE``: an error that a user can fix, including wrong options, prints one line; so does Ctrl-C.

    kind: a dataclass from which tyro makes the command line. Its field ``out``, if any, is where things are written.
    stopped: what is true of the work after Ctrl-C.
    """

    def done(config: Options) -> int:
        run(config)
        return 0

    ending = run_options(kind, done, None, f"python -m {module}", stopped)
    if ending.code == FAILED and ending.told:
        raise SystemExit(f"error: {ending.told}")
    if ending.told:
        print(f"error: {ending.told}" if ending.code == NOT_UNDERSTOOD else ending.told, file=sys.stderr)
    if ending.code:
        raise SystemExit(ending.code)


# ---------------------------------------------------------------- tasks


def film_bytes(seed: int, number: int, config: SampleConfig) -> list[bytes]:
    """The photos of film ``number`` with all their maps, each as its part of a shard.

    Raises:
        DataError: a source cannot be read.
    """
    start_worker()
    first = number * config.photos_per_film
    return [sample_bytes(sample, first + k) for k, sample in enumerate(film_samples(seed, number, config))]


def source_names(config: SourceConfig) -> dict[str, list[str]]:
    """Labels of the volumes and names of the environments that samples are made from, besides embedded ones."""
    volumes, environments = loaded(config)
    return {"volumes": [v.label for v in volumes], "environments": [e.name for e in environments]}


@lru_cache(maxsize=1)
def start_worker() -> None:
    """Use one thread in this process from now on: the tasks are the parallelism, and sums keep their order.

    All pictures of things are drawn now, in a quarter of a second: drawn on demand, they would make memory grow for
    hundreds of samples.
    """
    cv2.setNumThreads(1)
    threadpool_limits(1)
    _keep_memory()
    draw_sprites()


def _keep_memory() -> None:
    """Let the C library, if it is glibc, keep the memory of freed arrays for new ones.

    Otherwise each picture's memory is returned to the system and fetched anew, page by page: a sixth of the time at
    1080 px.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if set_option is not None:
        set_option(_M_MMAP_THRESHOLD, KEPT_ARRAY_BYTES)
        set_option(_M_TRIM_THRESHOLD, 16 * KEPT_ARRAY_BYTES)


# ---------------------------------------------------------------- who does them


@dataclass(frozen=True)
class Workers:
    """What does the tasks. submit: as of an executor. ahead: how many tasks to have submitted at a time."""

    submit: Callable[..., Any]
    ahead: Callable[[], int]

    def in_order(self, task: Callable[..., Any], each: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
        """``task(*arguments)`` for each tuple in turn; only ``ahead`` tasks are under way, so memory stays flat."""
        under_way: deque[Any] = deque()
        for arguments in each:
            under_way.append(self.submit(task, *arguments))
            while len(under_way) >= self.ahead():
                yield under_way.popleft().result()
        while under_way:
            yield under_way.popleft().result()


@contextmanager
def workers(count: int, scheduler: str | None) -> Iterator[Workers]:
    """The workers of the Dask cluster at ``scheduler``, ``count`` processes, or for 0 this process itself.

    Raises:
        ConfigError: there is no such cluster. HybridError: workers were lost.
    """
    if scheduler is not None:
        with _cluster(scheduler) as those:
            yield those
    elif count == 0:
        yield Workers(_done_here, lambda: 1)
    else:
        with _processes(count) as those:
            yield those


def write_missing(
    write: Callable[[Any, int], None], config: Any, path_of: Callable[[Any, int], Path], unit: str
) -> None:
    """``write(config, number)`` for those of the first ``config.count`` files that are missing, with a progress bar."""
    missing = [number for number in range(config.count) if not path_of(config, number).exists()]
    with workers(config.workers, None) as those, tqdm(total=len(missing), unit=unit) as bar:
        for _ in those.in_order(write, ((config, number) for number in missing)):
            bar.update()


def _done_here(task: Callable[..., Any], *arguments: Any) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_result(task(*arguments))
    return future


@contextmanager
def _processes(count: int) -> Iterator[Workers]:
    others = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), initializer=leave_with_parent)
    try:
        with _starting_processes():
            for _ in range(count):  # a task that finds no idle process starts one
                executor.submit(start_worker)
        yield Workers(executor.submit, lambda: 2 * count + 1)
    except BrokenProcessPool as error:
        do = f"Take fewer --workers if memory is short. {_AGAIN}"
        raise HybridError(describe(what="workers", got="a process that died", do=do)) from error
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()  # their work will not be used
        raise
    finally:
        executor.shutdown(cancel_futures=True)


@contextmanager
def _starting_processes() -> Iterator[None]:
    """Set what processes inherit that are started within: one thread in each library, and Ctrl-C ignored."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        with deaf_to_interrupts():
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _cluster(address: str) -> Iterator[Workers]:
    try:
        from distributed import Client
        from distributed.comm.addressing import get_address_host_port
        from distributed.comm.core import CommClosedError
        from distributed.scheduler import KilledWorker
    except ModuleNotFoundError as error:
        raise ConfigError(describe(what="--scheduler", got=error, do=install_extra("cluster"))) from error
    try:
        get_address_host_port(address)  # a client with a refused address ends only after 40 s
        client = Client(address, timeout=CLUSTER_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        do = "Give the address that the Dask scheduler shows, such as tcp://host:8786."
        raise ConfigError(describe(what="--scheduler", where=address, got=error, do=do)) from error

    def submit(task: Callable[..., Any], *arguments: Any) -> Any:
        return client.submit(_on_cluster, task, *arguments, pure=False)

    def ahead() -> int:
        threads: Any = client.nthreads()
        return max(CLUSTER_AHEAD, 2 * sum(threads.values()))

    try:
        with client:
            yield Workers(submit, ahead)
    except (CommClosedError, KilledWorker, asyncio.CancelledError) as error:
        got = f"work that was lost ({type(error).__name__})"
        raise HybridError(describe(what="cluster", where=address, got=got, do=_AGAIN)) from error


def _on_cluster(task: Callable[..., Any], *arguments: Any) -> Any:
    """A task whose errors say where they arose."""
    try:
        return task(*arguments)
    except HybridError as error:
        do = "Every worker needs the folders of --ct and --hdri at the same paths."
        raise DataError(describe(what="Dask worker", where=socket.gethostname(), got=error, do=do)) from error
