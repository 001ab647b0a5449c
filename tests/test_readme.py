"""The README runs: its Python blocks are executed, its commands exist, its links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

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


@pytest.mark.parametrize("page", PAGES)
def test_commands_exist(page: str) -> None:
    text = (ROOT / page).read_text()
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    named = re.findall(r"(?:`|^)make (\w+)", text, flags=re.MULTILINE)
    assert set(named) <= targets
    for module in re.findall(r"python -m ([\w.]+)", text):
        assert (ROOT / Path(*module.split("."))).with_suffix(".py").exists(), f"python -m {module}"


def anchors(page: Path) -> set[str]:
    """What the headings of a page are called in links."""
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
    for name in re.findall(r"`((?:rectify|learn)/\w+\.py|\w+\.py)`", (ROOT / page).read_text()):
        places = [ROOT / "hybrid" / name, ROOT / "data_gen" / name]
        assert any(place.exists() for place in places), name


def test_readme_fits_a_screen_or_two() -> None:
    assert len(README.splitlines()) <= 90
