"""The shell of all commands: messages name options as on the command line, however they are nested."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import pytest
import tyro
from test_imports import loaded_after

from hybrid.command import Ending, ended, run_options, with_flags
from hybrid.errors import ConfigError, DataError, require_at_least


@dataclass(frozen=True)
class Inner:
    few_steps: int = 3

    def __post_init__(self) -> None:
        require_at_least(self, 1, "few_steps")


@dataclass(frozen=True)
class Outer:
    inner: Inner = field(default_factory=Inner)
    flat: tyro.conf.OmitArgPrefixes[Inner] = field(default_factory=Inner)


@dataclass(frozen=True)
class Other:
    most_px: int = 9

    def __post_init__(self) -> None:
        require_at_least(self, 1, "most_px")


@dataclass(frozen=True)
class Options:
    """All ways in which an option may be named."""

    folder: tyro.conf.Positional[Path]
    json_path: Annotated[Path, tyro.conf.arg(name="json")] = Path("a.json")
    to_do: int = 1
    inner: Inner = field(default_factory=Inner)
    other: tyro.conf.OmitArgPrefixes[Other] = field(default_factory=Other)
    hidden: tyro.conf.Suppress[int] = 0

    def __post_init__(self) -> None:
        if self.to_do < 1:
            raise ConfigError(f"to_do: got {self.to_do}. Choose another.")


def ending(*words: str) -> Ending:
    return run_options(Options, lambda options: options.to_do, words, "python -m x", "nothing is kept")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--to-do", "0"], "--to-do: got 0. Choose another."),
        (["--inner.few-steps", "0"], "--inner.few-steps: got 0; allowed: >= 1. Choose another."),
        (["--most-px", "0"], "--most-px: got 0; allowed: >= 1. Choose another."),
    ],
)
def test_options_that_cannot_be_are_called_as_they_were_given(words: list[str], told: str) -> None:
    assert ending("folder", *words) == Ending(2, told)


def test_the_exit_code_is_that_of_the_work() -> None:
    assert ending("folder", "--to-do", "7") == Ending(7)


def test_messages_call_options_by_their_flags() -> None:
    assert with_flags("Options.json_path and Inner.few_steps", Options) == "--json and --inner.few-steps"
    for other in ("Options.folder is no flag", "a.json", "Options.hidden", "np.float32", "Stranger.few_steps"):
        assert with_flags(other, Options) == other
    assert with_flags("Inner.few_steps of two", Outer) == "Inner.few_steps of two"  # it is not known which of the two


def test_errors_of_the_work_keep_their_kind_and_name_the_folder() -> None:
    def refused(options: Options) -> int:
        raise DataError("Other.most_px is too much")

    def full(options: Options) -> int:
        raise OSError(28, "No space left on device")

    assert run_options(Options, refused, ["folder"], "x", "") == Ending(1, "--most-px is too much")
    assert run_options(Options, full, ["folder"], "x", "").told.startswith(
        "A file cannot be read or written: got No sp"
    )


def test_ctrl_c_and_lack_of_memory_are_a_line() -> None:
    def stopped() -> int:
        raise KeyboardInterrupt

    def short() -> int:
        raise MemoryError

    assert ended(stopped, "nothing is kept") == Ending(130, "stopped; nothing is kept")
    assert ended(short, "") == Ending(1, "MemoryError")


def test_the_shell_loads_nothing_heavy() -> None:
    assert not {"torch", "cv2", "open3d", "numpy"} & loaded_after("import hybrid.command")
