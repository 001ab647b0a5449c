"""The README runs: its Python blocks are executed, its commands exist, its links lead somewhere."""

from __future__ import annotations

import importlib
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import tyro

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PAGES = ["README.md", "CHANGELOG.md", *sorted(f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md"))]
PYTHON_BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_there_are_python_blocks() -> None:
    assert PYTHON_BLOCKS


@pytest.mark.parametrize("block", PYTHON_BLOCKS)
def test_python_blocks_compile(block: str) -> None:
    compile(block, "README.md", "exec")


@pytest.mark.parametrize("block", PYTHON_BLOCKS)
def test_python_blocks_run(block: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), names)
    assert names["film"] is not None, "the example photo gives a film"


def test_options_set_from_python_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """The example in docs/using.md, as it stands there."""
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/using.md").read_text(), flags=re.DOTALL)
    monkeypatch.chdir(ROOT)
    names: dict[str, Any] = {}
    exec(compile(block, "docs/using.md", "exec"), names)
    config, result = names["config"], names["result"]
    assert (config.tries, config.light.print_white, config.refine.sheet_rounds) == (1, 1.0, 2)
    assert (config.refine.sheet.focal, config.refine.matched) == (1.0, False)  # set explicitly; set by the effort
    assert result.status.has_film
    assert (result.film == 0).mean() > 0.01


@pytest.mark.parametrize("page", PAGES)
def test_commands_exist(page: str) -> None:
    text = (ROOT / page).read_text()
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    named = re.findall(r"(?:`|^)make (\w+)", text, flags=re.MULTILINE)
    assert set(named) <= targets
    for module in re.findall(r"python -m ([\w.]+)", text):
        assert (ROOT / Path(*module.split("."))).with_suffix(".py").exists(), f"python -m {module}"


COMMAND = re.compile(r"(?:^|[\s/])(?:python -m ((?:benchmarks|data_gen)\.\w+)|hybrid(?:\.cli)?(?= \w))(?: (.*))?$")
"""Matches a command of the project; the groups are its module (none for ``hybrid``) and its words."""

WHOLE = re.compile(r"`(python -m [^`]* --[^`]*|(?:\.venv/bin/)?hybrid \w[^`]* (?:-o|--out) [^`]*)`")
"""A command in running text that can be run as it stands; others only name an option."""


def documented_commands(page: str) -> Iterator[tuple[str, str]]:
    """Modules and words of the commands on a page: those in its code blocks, and whole ones in its running text."""
    text = (ROOT / page).read_text()
    blocks = re.findall(r"```bash\n(.*?)```", text, flags=re.DOTALL)
    lines = [line for block in blocks for line in looped(block.replace("\\\n", " ")).splitlines()]
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    lines += [" ".join(code.split()) for code in WHOLE.findall(prose)]
    for line in lines:
        found = COMMAND.search(line)
        if found:
            yield found[1] or "hybrid.cli", found[2] or ""


def looped(block: str) -> str:
    """Shell lines with each loop unrolled: every network named in a loop gives a command of its own."""

    def unrolled(loop: re.Match[str]) -> str:
        return "\n".join(loop[3].replace(f"${loop[1]}", value) for value in loop[2].split())

    return re.sub(r"for (\w+) in ([^;]*); do\n(.*?)\ndone", unrolled, block, flags=re.DOTALL)


class Parsed(BaseException):
    """Raised once the words have been understood."""


def parsing_alone(cli: Callable[..., Any]) -> Callable[..., Any]:
    """tyro's ``cli``, made to end the command once its words are understood."""

    def parse(*arguments: Any, **named: Any) -> Any:
        raise Parsed(cli(*arguments, **named))

    return parse


DOCUMENTED = sorted({command for page in PAGES if page != "CHANGELOG.md" for command in documented_commands(page)})


def test_there_are_documented_commands() -> None:
    assert {"hybrid.cli", "benchmarks.run", "data_gen.generate"} <= {module for module, _ in DOCUMENTED}


@pytest.mark.parametrize(("module", "words"), DOCUMENTED)
def test_documented_options_are_understood(module: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is run, so files need not exist; ``N`` stands for a number, other capitals for paths."""
    given = ["1" if word == "N" else word for word in shlex.split(words, comments=True)]
    monkeypatch.setattr(sys, "argv", [module, *given])
    monkeypatch.setattr(tyro, "cli", parsing_alone(tyro.cli))
    with pytest.raises(Parsed):
        importlib.import_module(module).main()


def anchors(page: Path) -> set[str]:
    """The anchors by which links name the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    path = ROOT / page
    for link, anchor in re.findall(r"\]\(\s*([^)#\s]*)(?:#([^)\s]+))?\s*\)", path.read_text()):
        if link.startswith("http"):
            continue
        to = path.parent / link if link else path
        assert to.exists(), link
        assert not anchor or anchor in anchors(to), f"{link}#{anchor}"


@pytest.mark.parametrize("page", PAGES)
def test_code_that_is_named_exists(page: str) -> None:
    for name in re.findall(r"`((?:\w+/)*\w+\.py)\b", (ROOT / page).read_text()):
        places = [ROOT / name, ROOT / "hybrid" / name, ROOT / "data_gen" / name]
        assert any(place.exists() for place in places), name


def test_readme_fits_a_screen_or_two() -> None:
    assert len(README.splitlines()) <= 90
