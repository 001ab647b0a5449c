"""The same work on many photos, shared out among processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any, TypeVar

from hybrid.errors import HybridError, describe

Tool = TypeVar("Tool")
Task = TypeVar("Task")
Done = TypeVar("Done")


def shared_out(
    work: Callable[[Tool, Task], Done], make_tool: Callable[[], Tool], tasks: Sequence[Task], workers: int
) -> Iterator[Done | HybridError]:
    """``work(tool, task)`` for each task, in their order; an error that says so for those of a process that died.

    Each worker makes a tool of its own, and uses its share of the processors. One worker is this process itself;
    more are new ones, so all arguments have to be such as can be sent to them. Where the caller stops early, or is
    interrupted, tasks under way are finished and no others begun.
    """
    count = min(workers, len(tasks))
    if count < 2:
        tool = make_tool()
        for task in tasks:
            yield work(tool, task)
        return
    threads = max(_processors() // count, 1)
    starting = partial(_start, make_tool, threads)
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), starting)
    try:
        for future in [pool.submit(_do, work, task) for task in tasks]:
            try:
                yield future.result()
            except BrokenProcessPool:
                yield HybridError(
                    describe(what="worker", got="a process that died", do="Take fewer --workers if memory is short.")
                )
    finally:
        pool.shutdown(cancel_futures=True)


_TOOL: Any = None
"""What this worker works with."""


def _start(make_tool: Callable[[], Any], threads: int) -> None:
    """Make the tool; Ctrl-C is for the process that asked for the work, which lets this one finish its task."""
    import cv2
    import torch

    global _TOOL
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(threads)
    torch.set_num_threads(threads)
    _TOOL = make_tool()


def _do(work: Callable[[Any, Task], Done], task: Task) -> Done:
    return work(_TOOL, task)


def _processors() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


__all__ = ["shared_out"]
