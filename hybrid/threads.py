"""How many threads work on a photo: one in linear algebra, those that OpenCV may use on a picture's strips."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import lru_cache
from threading import Event, Lock, Thread

import cv2
from threadpoolctl import ThreadpoolController


class _Keeper(Thread):
    """Holds the limit until it is let go, in a thread of its own: what one thread has set no other may take back
    (threadpoolctl), and which call ends last is not known."""

    def __init__(self) -> None:
        super().__init__(name="one thread of linear algebra", daemon=True)
        self._holds, self._ends = Event(), Event()
        self.start()
        self._holds.wait()

    def run(self) -> None:
        try:
            with _controller().limit(limits=1, user_api="blas"):
                self._holds.set()
                self._ends.wait()
        finally:
            self._holds.set()  # nobody waits for a limit that could not be set

    def let_go(self) -> None:
        """Returns once the process has its threads back."""
        self._ends.set()
        self.join()


class _OneThread:
    """The limit of linear algebra to one thread, which is the process's: of calls that overlap the first sets it and
    the last takes it back. So none goes on with more, by which results would differ in their last digits, and the
    process is left as it was."""

    def __init__(self) -> None:
        self._calls, self._counting = 0, Lock()
        self._keeper: _Keeper | None = None

    def __enter__(self) -> None:
        with self._counting:
            if self._keeper is None:
                self._keeper = _Keeper()
            self._calls += 1

    def __exit__(self, *error: object) -> None:
        with self._counting:
            self._calls -= 1
            if self._calls == 0 and self._keeper is not None:
                self._keeper.let_go()
                self._keeper = None


_ONE_THREAD = _OneThread()


def one_thread() -> AbstractContextManager[None]:
    """Linear algebra uses one thread meanwhile: on matrices this small, several wait more than they work."""
    return _ONE_THREAD


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
