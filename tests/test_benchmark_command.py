"""The shell of the benchmarks' commands: options, errors, exit codes, figures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from benchmarks.command import run_command, write_figures
from hybrid.errors import ConfigError


@dataclass(frozen=True)
class Options:
    """count: at most 9. out: the file for the figures."""

    count: int
    out: Path

    def __post_init__(self) -> None:
        if self.count > 9:
            raise ConfigError("--count: too many")


def run(options: Options, command: list[str]) -> int:
    write_figures(options.out, command, {"count": options.count})
    return options.count


def test_a_command_ends_with_its_verdict_and_leaves_its_figures(tmp_path: Path) -> None:
    out = tmp_path / "made" / "figures.json"
    words = ["--count", "3", "--out", str(out)]
    assert run_command("benchmarks.x", Options, run, words) == 0
    assert run_command("benchmarks.x", Options, run, words, lambda found: found - 1) == 2
    figures = json.loads(out.read_text())
    assert figures["count"] == 3
    assert figures["run"]["command"].startswith("python -m benchmarks.x --count 3")
    assert str(tmp_path) not in out.read_text()


def test_an_error_of_the_options_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command("benchmarks.x", Options, run, ["--count", "10", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == "benchmarks.x: --count: too many\n"


def test_words_that_are_no_options_end_as_every_command_does(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="2"):
        run_command("benchmarks.x", Options, run, ["--surprise"])
