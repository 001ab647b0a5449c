"""Photos shared out among processes: results in order, whatever happens to a worker."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hybrid.cli.rectify_files import rectify_files
from hybrid.errors import DataError, HybridError
from hybrid.image_io import write_rgb
from hybrid.records import RectifyResult, Status, StatusCode
from hybrid.workers import shared_out


class Tool:
    """Records in which process it works."""

    def __init__(self) -> None:
        self.process = os.getpid()

    def __call__(self, photo: np.ndarray, *, focal: float | None) -> RectifyResult:
        return RectifyResult(Status(StatusCode.NO_FILM), ())


def work(tool: Tool, task: int) -> tuple[int, int]:
    """Dies on negative tasks; takes long enough for others to be under way."""
    if task < 0:
        os._exit(1)
    time.sleep(0.05)
    return tool.process, task


class NoTool:
    """Cannot be made."""

    def __init__(self) -> None:
        raise DataError("no such weights")


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_tasks(workers):
    done = list(shared_out(work, Tool, range(6), workers))
    assert [task for _, task in done] == list(range(6))
    here = {process == os.getpid() for process, _ in done}
    assert here == {workers == 1}


def test_a_worker_that_dies_is_told_and_ends_nothing_else():
    tasks = [0, 1, -1, 2, 3, 4, -1, 5]
    done = list(shared_out(work, Tool, tasks, 2))
    assert len(done) == len(tasks)
    for task, one in zip(tasks, done, strict=True):
        if task < 0:
            assert isinstance(one, HybridError)
            assert "--workers" in str(one)
        else:
            assert one[1] == task


def test_workers_leave_with_a_parent_that_is_killed(tmp_path: Path):
    """Otherwise they would wait for tasks for ever, holding all that they have loaded."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from test_workers import Tool, work\n"
        "from hybrid.workers import shared_out\n"
        "if __name__ == '__main__':\n"
        "    for process, task in shared_out(work, Tool, range(400), 2):\n"
        "        print(process, flush=True)\n"
    )
    (tmp_path / "parent.py").write_text(code)
    command = [sys.executable, tmp_path / "parent.py", Path(__file__).parent]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        workers = {int(parent.stdout.readline()) for _ in range(20)}
        parent.kill()
    for _ in range(200):
        if not any(map(is_running, workers)):
            break
        time.sleep(0.1)
    assert not any(map(is_running, workers))


def is_running(process: int) -> bool:
    """Whether a process runs; one that has ended but was not waited for does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.parametrize("workers", [1, 2])
def test_a_tool_that_cannot_be_made_is_told_as_that(workers):
    with pytest.raises(DataError, match="no such weights"):
        list(shared_out(work, NoTool, range(4), workers))


def test_photos_of_one_name_are_numbered_in_their_order(tmp_path: Path):
    photos = [tmp_path / f"{k}" / name for k in range(3) for name in ("a.png", "b.png")]
    for k, photo in enumerate(photos):
        photo.parent.mkdir(exist_ok=True)
        write_rgb(photo, np.full((8, 8, 3), 20 * k, np.uint8))
    told: list[str] = []
    outcomes = rectify_files(photos, tmp_path / "out", Tool, "jpg", told.append, workers=2)
    assert [outcome.photo for outcome in outcomes] == photos
    assert [outcome.files[-1].name for outcome in outcomes] == [
        *("a.json", "b.json", "a_2.json", "b_2.json", "a_3.json", "b_3.json")
    ]
    assert len(told) == len(photos)
