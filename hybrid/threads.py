"""How many threads work on a photo: one in linear algebra, those that OpenCV may use on a picture's strips."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from threading import Lock

import cv2
from threadpoolctl import ThreadpoolController

_LIMITED = Lock()
"""Held by the call that has set the limit."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra uses one thread meanwhile: on matrices this small, several wait more than they work.

    The limit is the process's: of calls that overlap only the first sets it, and takes it back. Each putting back what
    it found would leave the process with one thread for good.
    """
    if not _LIMITED.acquire(blocking=False):
        yield
        return
    try:
        with _controller().limit(limits=1, user_api="blas"):
            yield
    finally:
        _LIMITED.release()


def in_strips(work: Callable[[slice], None], height: int, rows: int) -> None:
    """``work`` on each strip of so many rows of a picture, so that all its steps stay in the processor's cache.

    As many strips at a time as OpenCV has threads, which is a worker's share of the processors where several work.
    """
    strips = (slice(top, min(top + rows, height)) for top in range(0, height, rows))
    with ThreadPoolExecutor(max_workers=max(cv2.getNumThreads(), 1)) as pool:
        list(pool.map(work, strips))


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    """Looks for the libraries once; they are loaded by then."""
    return ThreadpoolController()


__all__ = ["in_strips", "one_thread"]
