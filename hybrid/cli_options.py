"""Command lines whose options' own values depend on one of them: ``--effort``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any, TypeVar

import tyro

from hybrid.errors import ConfigError

Options = TypeVar("Options")


def parse(kind: type[Options], arguments: list[str], prog: str, config_of: Callable[[Any], Any]) -> Options:
    """The options that the arguments give; ``--help`` and whatever is not named show those of the effort that is.

    kind: a dataclass with ``photos``, ``effort`` and ``config``. config_of: the configuration of an effort; an effort
    that it does not know is told as any wrong option is.
    """
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first.add_argument("--effort", nargs="?", default="default")
    effort = first.parse_known_args(arguments)[0].effort
    try:
        config_of(effort)
    except ConfigError:
        effort = "default"
    default: Any = kind(photos=(), effort=effort, config=config_of(effort))  # type: ignore[call-arg]
    return tyro.cli(kind, args=arguments, prog=prog, default=default)
