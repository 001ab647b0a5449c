"""How many threads work on a photo: one in linear algebra, and on strips of a picture as many as OpenCV may use."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import lru_cache
from threading import Lock

import cv2
from threadpoolctl import LibController, ThreadpoolController


class _OneThread:
    """Limits linear algebra to one thread. The limit is the process's: of calls that overlap, the first sets it and the
    last lifts it. So no call continues with more threads, which would change the last digits of results, and the
    process is left as it was."""

    def __init__(self) -> None:
        self._calls, self._counting = 0, Lock()
        self._before: list[tuple[LibController, int]] = []

    def __enter__(self) -> None:
        with self._counting:
            if self._calls == 0:
                self._before = [(library, library.info()["num_threads"]) for library in _linear_algebra()]
                for library, _ in self._before:
                    _set_threads(library, 1)
            self._calls += 1

    def __exit__(self, *error: object) -> None:
        with self._counting:
            self._calls -= 1
            if self._calls == 0:
                for library, threads in self._before:
                    _set_threads(library, threads)


def _set_threads(library: LibController, threads: int) -> None:
    """As the library itself does: from threadpoolctl 3.8 on, no thread can take back what another has set, and it is
    not known which call ends last."""
    getattr(library, "_real_set_num_threads", library.set_num_threads)(threads)


_ONE_THREAD = _OneThread()


def one_thread() -> AbstractContextManager[None]:
    """Linear algebra uses one thread meanwhile: on matrices this small, several threads wait more than they work."""
    return _ONE_THREAD


def in_strips(work: Callable[[slice], None], height: int, rows: int) -> None:
    """Run ``work`` on each strip of so many rows of a picture, so that all its steps stay in the processor's cache.

    As many strips run at a time as OpenCV has threads, which is a worker's share of the processors if several work.
    """
    strips = (slice(top, min(top + rows, height)) for top in range(0, height, rows))
    with ThreadPoolExecutor(max_workers=max(cv2.getNumThreads(), 1)) as pool:
        list(pool.map(work, strips))


@lru_cache(maxsize=1)
def _linear_algebra() -> tuple[LibController, ...]:
    """Find the libraries once; they are loaded by then."""
    return tuple(x for x in ThreadpoolController().lib_controllers if x.user_api == "blas")


__all__ = ["in_strips", "one_thread"]
