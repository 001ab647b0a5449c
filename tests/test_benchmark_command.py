"""The shell of the benchmarks' commands: options, errors, exit codes, figures."""

from __future__ import annotations

import importlib
import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from benchmarks.command import GOES_ON, run_command, write_figures
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


def test_what_the_system_refuses_and_ctrl_c_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def full(options: Options, command: list[str]) -> int:
        raise OSError(28, "No space left on device")

    def stopped(options: Options, command: list[str]) -> int:
        raise KeyboardInterrupt

    words = ["--count", "3", "--out", str(tmp_path)]
    assert run_command("benchmarks.x", Options, full, words) == 1
    told = f"benchmarks.x: A file cannot be read or written ({tmp_path}): got No space left on device. Mend that"
    assert capsys.readouterr().err.startswith(told)
    assert run_command("benchmarks.x", Options, stopped, words) == 130
    told = "what is not written yet is lost, and the same command begins anew"
    assert capsys.readouterr().err == f"benchmarks.x: stopped; {told}\n"
    assert run_command("benchmarks.x", Options, stopped, words, stopped=GOES_ON) == 130
    assert capsys.readouterr().err == f"benchmarks.x: stopped; {GOES_ON}\n"


@pytest.mark.parametrize(
    ("module", "words", "told"),
    [
        ("curves", ["c.csv", "--picture", "x.gif"], "--picture: got x.gif; allowed: .png, .jpg, .jpeg"),
        ("run", ["--out", "OUT", "--threads", "0"], "--threads: got 0; allowed: >= 1"),
        ("run", ["--out", "OUT", "--seed", "-1"], "--seed: got -1; allowed: >= 0"),
        ("soak", ["--out", "OUT", "--seed", "-1"], "--seed: got -1; allowed: >= 0"),
        ("stability", ["--out", "OUT", "--seed", "-1"], "--seed: got -1; allowed: >= 0"),
        ("light", ["--json", "OUT", "--every", "0"], "--every: got 0; allowed: >= 1"),
        ("verdict", ["--data", "D", "--json", "OUT", "--every", "0"], "--every: got 0; allowed: >= 1"),
        ("consistency", ["--json", "OUT", "--samples", "0"], "--samples: got 0; allowed: >= 1"),
        ("consistency", ["--json", "OUT", "--size", "8"], "--size: got 8; allowed: >= 32"),
        ("simulate", ["--json", "OUT", "--picture", "a.bmp"], "--picture: got a.bmp; allowed: .png, .jpg, .jpeg"),
        ("simulate", ["--json", "OUT", "--scenes", "0"], "--scenes: got 0; allowed: >= 1"),
        ("data_rate", ["--json", "OUT", "--seconds", "nan"], "--seconds: got nan; allowed: >= 0"),
    ],
)
def test_options_that_cannot_be_are_told_by_their_flags_before_work_begins(
    module: str, words: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(tmp_path / "out") if word == "OUT" else word for word in words]
    assert importlib.import_module(f"benchmarks.{module}").main(words) == 1
    assert capsys.readouterr().err.startswith(f"benchmarks.{module}: {told}. ")
    assert not list(tmp_path.iterdir())


def test_the_folder_of_a_picture_is_made(tmp_path: Path) -> None:
    curves, picture = tmp_path / "curves.csv", tmp_path / "made" / "curves.png"
    curves.write_text("passes,train_uv,test_uv_percent\n1000,3,2\n2000,2,1\n")
    assert importlib.import_module("benchmarks.curves").main([str(curves), "--picture", str(picture)]) == 0
    assert picture.exists()


def test_a_picture_whose_folder_cannot_be_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    curves = tmp_path / "curves.csv"
    curves.write_text("passes,train_uv\n1000,3\n2000,2\n")
    words = [str(curves), "--picture", str(curves / "curves.png")]
    assert importlib.import_module("benchmarks.curves").main(words) == 1
    told = f"Nothing can be written there ({curves}): got a file of this name. Name a folder that can be written, with"
    assert capsys.readouterr().err == f"benchmarks.curves: {told} --picture.\n"
