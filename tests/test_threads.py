"""Linear algebra has the caller's threads back once no photo is being worked on, however the calls overlap."""

from threading import Barrier, Thread

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_info

from hybrid.threads import in_strips, one_thread


def blas_threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def fail() -> None:
    assert blas_threads() == {1}
    raise ZeroDivisionError


def test_calls_that_overlap_leave_the_threads_as_they_were():
    before, steps, inside = blas_threads(), Barrier(2), []

    def first() -> None:
        with one_thread():
            steps.wait()
            steps.wait()  # both are inside
        steps.wait()

    def second() -> None:
        steps.wait()
        with one_thread():
            inside.append(blas_threads())
            steps.wait()
            steps.wait()  # the first has left
            inside.append(blas_threads())

    threads = [Thread(target=first), Thread(target=second)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert inside == [{1}, {1}]
    assert blas_threads() == before


def test_an_error_inside_gives_the_threads_back():
    before = blas_threads()
    with pytest.raises(ZeroDivisionError), one_thread():
        fail()
    assert blas_threads() == before
    with one_thread():
        assert blas_threads() == {1}


@pytest.mark.parametrize("threads", [1, 3])
def test_strips_cover_a_picture_once_and_their_errors_are_told(threads: int):
    before, counted = cv2.getNumThreads(), np.zeros(131)

    def count(rows: slice) -> None:
        assert rows.stop - rows.start <= 32
        counted[rows] += 1

    def refuse(rows: slice) -> None:
        if rows.start:
            raise ZeroDivisionError

    try:
        cv2.setNumThreads(threads)
        in_strips(count, 131, 32)
        with pytest.raises(ZeroDivisionError):
            in_strips(refuse, 131, 32)
    finally:
        cv2.setNumThreads(before)
    assert (counted == 1).all()
