"""The same work on many photos, shared among processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

from hybrid.errors import HybridError, describe

Tool = TypeVar("Tool")
Task = TypeVar("Task")
Done = TypeVar("Done")


def shared_out(
    work: Callable[[Tool, Task], Done], make_tool: Callable[[], Tool], tasks: Sequence[Task], workers: int
) -> Iterator[Done | HybridError]:
    """``work(tool, task)`` for each task, in order; for a task that ends its process, an error that says so.

    Each worker makes its own tool and uses its share of the processors. One worker is this process itself; more are new
    processes, so it must be possible to send all arguments to them. If the caller stops early or is interrupted,
    running tasks are finished and no others are started.
    """
    count = min(workers, len(tasks))
    if count < 2:
        tool = make_tool()
        for task in tasks:
            yield work(tool, task)
        return
    at, ready = 0, dict[int, Done | HybridError]()
    while at < len(tasks):
        left = [number for number in range(at, len(tasks)) if number not in ready]
        with _pool(make_tool, count) as pool:
            with deaf_to_interrupts():  # a task that finds no idle process starts one
                futures = {number: pool.submit(_do, work, tasks[number]) for number in left}
            try:
                while at < len(tasks):
                    yield ready.pop(at) if at in ready else futures[at].result()
                    at += 1
                return
            except BrokenProcessPool:  # this ends all that were running or waiting, whichever of them is to blame
                ended = [number for number in left if number >= at and futures[number].exception() is None]
        ready |= {number: futures[number].result() for number in ended}
        under_way = [number for number in left if number >= at and number not in ready][:count]
        ready |= {number: _alone(work, make_tool, tasks[number]) for number in under_way}


def _alone(work: Callable[[Tool, Task], Done], make_tool: Callable[[], Tool], task: Task) -> Done | HybridError:
    """Run a task in a process of its own, which it may end without harm to others."""
    with _pool(make_tool, 1) as pool:
        with deaf_to_interrupts():
            future = pool.submit(_do, work, task)
        try:
            return future.result()
        except BrokenProcessPool:
            do = "Take a smaller photo, or fewer --workers, if memory is short."
            return HybridError(describe(what="worker", got="a process that died", do=do))


@contextmanager
def _pool(make_tool: Callable[[], Any], count: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that share the processors, each with its own tool."""
    starting = partial(_start, make_tool, max(_processors() // count, 1))
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), starting)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Processes started inside ignore Ctrl-C: their parent receives it, and ends them or waits for them; otherwise each
    of them would print a stack trace. Outside the main thread, which alone may do this, nothing changes.
    """
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGINT, handler)


def leave_with_parent() -> None:
    """End this process when its parent is gone, killed perhaps: otherwise it would wait for tasks for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:

        def watch() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=watch, daemon=True).start()


_TOOL: Any = None
"""What this worker works with."""
_NO_TOOL: HybridError | None = None
"""Why it has none."""


def _start(make_tool: Callable[[], Any], threads: int) -> None:
    """Make the tool; Ctrl-C is for the process that asked for the work, which lets this one finish its task."""
    leave_with_parent()
    import cv2
    import torch

    global _TOOL, _NO_TOOL
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(threads)
    torch.set_num_threads(threads)
    try:
        _TOOL = make_tool()
    except HybridError as error:  # raised here, it would be reported as a process that died
        _NO_TOOL = error


def _do(work: Callable[[Any, Task], Done], task: Task) -> Done:
    if _NO_TOOL is not None:
        raise _NO_TOOL
    return work(_TOOL, task)


def _processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


__all__ = ["deaf_to_interrupts", "leave_with_parent", "shared_out"]
