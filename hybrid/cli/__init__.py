"""The command ``hybrid``: chooses the subcommand; each one loads what it needs, so that ``--help`` is quick."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Sequence
from functools import partial

USAGE = """\
usage: hybrid {rectify,fuse,train,info} [options]

Photo of a bent CT film in, flat print out.

  hybrid rectify PHOTO... -o DIR   flatten photos; writes films, slices and side-by-side pictures into DIR
  hybrid fuse PHOTO PHOTO... -o DIR
                                   one film of several photos of it, without the glare that moved between them
  hybrid train --data DIR... --out DIR
                                   train the network on data made by python -m data_gen.generate
  hybrid info                      versions, weights and machine, for a report of a defect

  hybrid COMMAND --help            the options of a command; of rectify and fuse those that most need
  hybrid COMMAND --help-all        every option of rectify or fuse, those of their stages too
  hybrid --version
"""


STOPPED = {
    "rectify": "what is finished is kept (a film whose JSON says UNFINISHED is not)",
    "fuse": "the film is not finished (its JSON says UNFINISHED, if files of it are written)",
    "train": "what is learnt is saved, and the same command goes on",
    "info": "nothing is lost",
}
"""What a user is told after Ctrl-C."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one subcommand; returns the exit code: 0 for success, 1 if anything failed, 2 for an invalid command line."""
    for stream in (sys.stdout, sys.stderr):  # a file name that cannot be printed must not stop the photos after it
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    commands: dict[str, Callable[[list[str]], int]] = {
        "rectify": _rectify,
        "fuse": _fuse,
        "train": _train,
        "info": _info,
    }
    if arguments and arguments[0] in commands:
        return _guarded(arguments[0], partial(commands[arguments[0]], arguments[1:]))
    if arguments in (["--help"], ["-h"]):
        print(USAGE, end="")
        return 0
    if arguments == ["--version"]:
        from hybrid import __version__

        print(f"hybrid {__version__}")
        return 0
    wrong = f"unknown command {arguments[0]!r}" if arguments else "no command"
    print(f"{USAGE}\nhybrid: {wrong}; allowed: {', '.join(commands)}", file=sys.stderr)
    return 2


def _guarded(name: str, command: Callable[[], int]) -> int:
    """Run a subcommand; an error that a user can fix becomes one line, and Ctrl-C prints no stack trace."""
    from hybrid.command import NOT_UNDERSTOOD, ended

    ending = ended(command, STOPPED[name])
    if ending.told:
        said_by = f"hybrid {name}" if ending.code == NOT_UNDERSTOOD else "hybrid"
        print(f"{said_by}: {ending.told}", file=sys.stderr)
    return ending.code


def _rectify(arguments: list[str]) -> int:
    from hybrid.cli.rectify import run

    return run(arguments)


def _fuse(arguments: list[str]) -> int:
    from hybrid.cli.fuse import run

    return run(arguments)


def _train(arguments: list[str]) -> int:
    from hybrid.command import parsed
    from hybrid.learn.training.plan import TrainConfig
    from hybrid.learn.training.train import train

    train(parsed(TrainConfig, arguments, "hybrid train"))
    return 0


def _info(arguments: list[str]) -> int:
    from hybrid.cli.info import run

    return run(arguments)
