"""How many threads linear algebra uses while a photo is worked on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from threading import Lock

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


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    """Looks for the libraries once; they are loaded by then."""
    return ThreadpoolController()


__all__ = ["one_thread"]
