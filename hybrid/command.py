"""The shell of every command: errors that a user can fix become one line, with options named as on the command line,
and Ctrl-C prints no stack trace."""

from __future__ import annotations

import os
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, TypeVar, get_args, get_type_hints

from hybrid.errors import ConfigError, DataError, HybridError, told

Options = TypeVar("Options")

FAILED, NOT_UNDERSTOOD, INTERRUPTED = 1, 2, 130
"""Exit codes: for a failure, for an invalid command line, and for Ctrl-C."""


@dataclass(frozen=True)
class Ending:
    """How a command ended. code: its exit code. told: a line on what went wrong; empty if there is nothing to say."""

    code: int
    told: str = ""


class CommandLineError(HybridError):
    """Options that are invalid, named as on the command line."""


def ended(command: Callable[[], int], stopped: str) -> Ending:
    """Run a command, which returns its exit code. stopped: what a user is told of its work after Ctrl-C."""
    try:
        return Ending(command())
    except BrokenPipeError:  # the reader of the output is gone, as with ``head``
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Ending(FAILED)
    except CommandLineError as error:
        return Ending(NOT_UNDERSTOOD, str(error))
    except (HybridError, OSError, MemoryError) as error:
        return Ending(FAILED, told(error))
    except KeyboardInterrupt:
        return Ending(INTERRUPTED, f"stopped; {stopped}")


def run_options(
    options: type[Options], run: Callable[[Options], int], words: Sequence[str] | None, prog: str, stopped: str
) -> Ending:
    """Run a command whose options are a dataclass, with these words, or those of the command line if None.

    run: returns the exit code. Its errors name options as the command line does. If the system does not say which file
    it refuses, they name the place of the output (the option ``out``, if there is one).
    """

    def command() -> int:
        given: Any = parsed(options, words, prog)
        try:
            return run(given)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise DataError(told(error, getattr(given, "out", None))) from error
        except HybridError as error:
            raise type(error)(with_flags(str(error), options)) from error

    return ended(command, stopped)


def parsed(options: type[Options], words: Sequence[str] | None, prog: str) -> Options:
    """The options that the words give; tyro ends the command if it does not understand them.

    Raises:
        CommandLineError: the options are invalid.
    """
    import tyro

    try:
        return tyro.cli(options, args=words, prog=prog)
    except ConfigError as error:
        message, flags = with_flags(str(error), options), _flags(options)
        first, rest = message.partition(": ")[::2]  # an option may be called by its bare name
        flag = flags.get(f"{options.__name__}.{first}")
        raise CommandLineError(message if flag is None else f"{flag}: {rest}") from error


def with_flags(message: str, options: type) -> str:
    """A message about options (``GenerateConfig.map_size``), with their names on the command line instead."""
    flags = _flags(options)
    return re.sub(r"\b[A-Z]\w*\.\w+", lambda found: flags.get(found[0], found[0]), message)


def _flags(options: type) -> dict[str, str]:
    """``Kind.name`` and flag of each option of a dataclass and of nested ones, except for kinds that occur twice."""
    every = list(_all_flags(options))
    times = Counter(name for name, _ in every)
    return {name: flag for name, flag in every if times[name] == 1}


def _all_flags(options: type, before: str = "") -> Iterator[tuple[str, str]]:
    """The same one by one, named as tyro names them."""
    import tyro

    conf = tyro.conf
    positional, bare, hidden = (
        get_args(mark[int])[1] for mark in (conf.Positional, conf.OmitArgPrefixes, conf.Suppress)
    )
    hints = get_type_hints(options, include_extras=True)
    for one in fields(options):
        hint = hints[one.name]
        kind, *marks = get_args(hint) if hasattr(hint, "__metadata__") else (hint,)
        if positional in marks or hidden in marks:
            continue
        named = [mark.name for mark in marks if getattr(mark, "name", None) is not None]
        name = before + (named[0] if named else one.name)
        if isinstance(kind, type) and is_dataclass(kind):
            yield from _all_flags(kind, "" if bare in marks or not name else f"{name}.")
        else:
            yield f"{options.__name__}.{one.name}", flag_of(name)


def flag_of(name: str) -> str:
    """An option's name on the command line."""
    return f"--{name}".replace("_", "-")


__all__ = ["Ending", "ended", "flag_of", "parsed", "run_options", "with_flags"]
