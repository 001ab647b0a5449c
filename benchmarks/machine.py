"""How a figure was made: machine, versions and command, stored beside every result."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from hybrid import __version__

PACKAGES = ("torch", "numpy", "scipy", "opencv-contrib-python-headless", "pillow", "kornia")
ROOT = Path(__file__).parents[1]


def describe_run(command: list[str]) -> dict[str, Any]:
    """Machine, versions, commit, threads and time of a run made by ``command`` (a program's name and its arguments)."""
    return {
        "command": relative_command(command),
        "time_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit(),
        "hybrid": __version__,
        "machine": {
            "processor": processor(),
            "usable_processors": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
            "memory_gib": memory_gib(),
            "load": load(),
            "system": f"{platform.system()} {platform.machine()}",
        },
        "python": platform.python_version(),
        "packages": {name: version_of(name) for name in PACKAGES},
        "threads": threads(),
    }


def shown_sources(*paths: Path | None) -> str:
    """Folders and files that determine results, as shown in reports; empty if there are none."""
    return relative_command([str(path.absolute()) for path in paths if path is not None])


def relative_command(command: list[str]) -> str:
    """The command in one line, without this machine's folders: paths are relative to the working directory.

    Of a path further away than beside it, only the last name is kept.
    """
    return " ".join(_relative(word) for word in command)


def _relative(word: str) -> str:
    option, equals, value = word.rpartition("=")
    if not os.path.isabs(value):
        return word
    path = Path(os.path.relpath(value))
    shown = path.as_posix() if path.parts[:2] != ("..", "..") else f".../{path.name}"
    return f"{option}{equals}{shown}"


@cache
def commit() -> str | None:
    """The commit of this process's code, with a digest of uncommitted changes; None outside a repository.

    It is read only once: by then the process has loaded the code that it runs, while others may go on working on the
    tree.
    """
    head = _git("rev-parse", "--short=12", "HEAD")
    changed = None if head is None else _git("diff", "HEAD")
    return f"{head}+changes.{hashlib.sha256(changed.encode()).hexdigest()[:8]}" if changed else head


def shown_contents(shown: Path | None, *unnamed: Path) -> str:
    """A file or folder as ``shown_sources`` gives it, and a digest of its contents and of further files, whose names do
    not matter; empty if there are none."""
    return " ".join(filter(None, (shown_sources(shown), _digest_of(shown, *unnamed))))


def shown_data(*paths: Path | None) -> str:
    """Photos and data sets as ``shown_sources`` gives them, each with a digest of its contents; empty without any."""
    return " ".join(shown_contents(path) for path in paths if path is not None)


def used_machine() -> str:
    """Processor and package versions in one line: times from other machines are not combined with these."""
    return ", ".join((processor(), *(f"{name} {version_of(name)}" for name in PACKAGES)))


def _digest_of(*paths: Path | None) -> str:
    """A short digest of the contents of files and folders; empty if there are none."""
    files = [file for path in paths if path is not None for file in ([path] if path.is_file() else path.rglob("*"))]
    contents = [_sha256_of(file) for file in sorted(files) if file.is_file()]
    return hashlib.sha256(b"".join(contents)).hexdigest()[:8] if contents else ""


def _sha256_of(file: Path) -> bytes:
    """Read piece by piece: data sets may be larger than memory."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").digest()


def _git(*arguments: str) -> str | None:
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def processor() -> str:
    """The processor's model name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown"
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def memory_gib() -> float | None:
    """Main memory in GiB; None where the system does not say."""
    try:
        return round(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30, 1)
    except (AttributeError, ValueError, OSError):
        return None


def load() -> float | None:
    """Average number of runnable processes over the last 15 minutes, this one included; None where it is not known."""
    return round(os.getloadavg()[2], 1) if hasattr(os, "getloadavg") else None


def version_of(package: str) -> str | None:
    """The installed version of a package, or None."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def use_threads(count: int) -> None:
    """Limit OpenCV, torch and the linear algebra libraries to ``count`` threads in this process from now on."""
    import cv2
    import torch
    from threadpoolctl import threadpool_limits

    cv2.setNumThreads(count)
    torch.set_num_threads(count)
    threadpool_limits(limits=count)


def memory_mib(which: Literal["VmRSS", "VmHWM"]) -> float | None:
    """Memory of this process: in use now (VmRSS) or at most so far (VmHWM); None where the system does not say.

    getrusage's maximum is not taken: on Linux a new process inherits it from the process that started it.
    """
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith(f"{which}:")), None)


def threads() -> dict[str, int | str | None]:
    """Threads that the numerical libraries may use; torch is asked only if it is loaded already."""
    import cv2

    torch = sys.modules.get("torch")
    return {
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS"),
        "opencv": cv2.getNumThreads(),
        "torch": None if torch is None else torch.get_num_threads(),
    }


__all__ = [
    "commit",
    "describe_run",
    "memory_mib",
    "relative_command",
    "shown_contents",
    "shown_data",
    "shown_sources",
    "use_threads",
    "used_machine",
]
