"""The shell of every benchmark's command: options from its words, errors in a line, figures as JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import tyro

from benchmarks.machine import describe_run
from hybrid.errors import HybridError
from hybrid.image_io import write_bytes
from hybrid.outputs import make_folder

Options = TypeVar("Options")
Found = TypeVar("Found")


def run_command(
    name: str,
    options: type[Options],
    run: Callable[[Options, list[str]], Found],
    arguments: Sequence[str] | None,
    verdict: Callable[[Found], int] = lambda found: 0,
) -> int:
    """Run ``python -m NAME`` with these words, those of the command line if None; its exit code.

    options: a dataclass, of which tyro makes the command line. run: takes the options and the whole command, as
    ``benchmarks.machine.describe_run`` wants it. verdict: exit code by what was found. An error that a user can mend,
    of the options as well, is one line and exit code 1.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    command = f"python -m {name}"
    try:
        return verdict(run(tyro.cli(options, args=words, prog=command), [command, *words]))
    except HybridError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1


def write_figures(path: Path, command: list[str], figures: Mapping[str, Any]) -> None:
    """Figures as a JSON file, with the command and the machine that made them; its folder is made."""
    make_folder(path.parent)
    write_bytes(path, (json.dumps({"run": describe_run(command), **figures}, indent=1) + "\n").encode())


__all__ = ["run_command", "write_figures"]
