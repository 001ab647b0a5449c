"""What is common to every benchmark's command: options from its arguments, errors in one line, figures as JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import UInt8

from benchmarks.machine import describe_run
from hybrid.command import FAILED, NOT_UNDERSTOOD, run_options
from hybrid.errors import ConfigError, describe
from hybrid.files import make_folder, write_bytes
from hybrid.image_io import write_rgb

Options = TypeVar("Options")
Found = TypeVar("Found")


BEGINS_ANEW = "what is not written yet is lost, and the same command begins anew"
GOES_ON = "what is finished is kept, and the same command goes on"
"""What a user is told after Ctrl-C: of work that is kept in memory, and of work that is kept in files on the way."""

PICTURES = (".png", ".jpg", ".jpeg")
"""Suffixes of pictures that can be written."""


def run_command(
    name: str,
    options: type[Options],
    run: Callable[[Options, list[str]], Found],
    arguments: Sequence[str] | None,
    verdict: Callable[[Found], int] = lambda found: 0,
    stopped: str = BEGINS_ANEW,
) -> int:
    """Run ``python -m NAME`` with these arguments, those of the command line if None; return its exit code.

    options: a dataclass from which tyro makes the command line. run: takes the options and the whole command, as
    ``benchmarks.machine.describe_run`` wants it. verdict: returns the exit code for the result; 2 means that something
    is not as it has to be. An error that a user can mend, in the options as well, is one line and exit code 1. stopped:
    what a user is told about the work after Ctrl-C, also in one line.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    command = f"python -m {name}"
    ending = run_options(options, lambda given: verdict(run(given, [command, *words])), words, command, stopped)
    if ending.told:
        print(f"{name}: {ending.told}", file=sys.stderr)
    return FAILED if ending.told and ending.code == NOT_UNDERSTOOD else ending.code


def require_picture(config: Any, name: str) -> None:
    """Refuse the option of a picture to write if it is set and its suffix is not in ``PICTURES``.

    Raises:
        ConfigError: the suffix is another one.
    """
    path: Path | None = getattr(config, name)
    if path is not None and path.suffix.lower() not in PICTURES:
        option, allowed = f"{type(config).__name__}.{name}", ", ".join(PICTURES)
        raise ConfigError(describe(what=option, got=path, allowed=allowed, do="Name another file."))


def write_picture(path: Path, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write a picture, creating its folder."""
    make_folder(path.parent, "--picture")
    write_rgb(path, picture)


def write_figures(path: Path, command: list[str], figures: Mapping[str, Any]) -> None:
    """Write figures as a JSON file, with the command and the machine that made them, creating its folder."""
    make_folder(path.parent, "--json")
    write_bytes(path, (json.dumps({"run": describe_run(command), **figures}, indent=1) + "\n").encode())


__all__ = ["BEGINS_ANEW", "GOES_ON", "require_picture", "run_command", "write_figures", "write_picture"]
