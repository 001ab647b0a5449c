"""Imports run one way, and rectifying a photo needs neither Open3D nor the trainer."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("hybrid.mesh", "hybrid.learn", "hybrid.rectify")
OUTER = (
    "hybrid.pipeline",
    "hybrid.effort",
    "hybrid.cli",
    "data_gen",
    "benchmarks",
    "tests",
)

MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for room in ("hybrid", "data_gen", "benchmarks")
    for path in sorted((ROOT / room).rglob("*.py"))
}


def imported_by(path: Path) -> set[str]:
    """Every module that a file imports, inside functions as well; relative imports are refused."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def within(module: str, packages: tuple[str, ...]) -> bool:
    return any(module == package or module.startswith(package + ".") for package in packages)


@pytest.mark.parametrize("module", [m for m in MODULES if within(m, ROOMS)])
def test_rooms_import_neither_each_other_nor_outwards(module: str) -> None:
    own = next(room for room in ROOMS if within(module, (room,)))
    others = tuple(room for room in ROOMS if room != own)
    wrong = {name for name in imported_by(MODULES[module]) if within(name, others + OUTER)}
    assert not wrong, f"{module} imports {sorted(wrong)}"


ORDERS = {
    "hybrid.learn": ("networks", "reading", "datasets", "paper", "training"),
    "hybrid.rectify": (
        "splines",
        "edges",
        "grid",
        "coarse",
        "sheet",
        "margins",
        "refine",
        "film",
        "fusion",
        "verdict",
    ),
    "hybrid.pipeline": ("job", "looks", "starts", "geometry", "whole_sheet", "doubt", "finish", "rectifier"),
    "data_gen": ("ct", "prints", "light", "camera", "scene", "render"),
}
"""The parts of these packages, each of which imports only itself and those before it."""
ORDERED = [
    (package, module)
    for package, parts in ORDERS.items()
    for module in MODULES
    if within(module, tuple(f"{package}.{part}" for part in parts))
]


def part_of(module: str, package: str) -> str:
    """The part of a package that a module belongs to."""
    return module.removeprefix(f"{package}.").split(".")[0]


@pytest.mark.parametrize(("package", "module"), ORDERED)
def test_the_parts_of_a_package_import_one_way(package: str, module: str) -> None:
    parts = ORDERS[package]
    before = tuple(f"{package}.{part}" for part in parts[: parts.index(part_of(module, package)) + 1])
    imported = {name for name in imported_by(MODULES[module]) if within(name, (package,)) and name != package}
    wrong = {name for name in imported if not within(name, before)}
    assert not wrong, f"{module} imports {sorted(wrong)}"


@pytest.mark.parametrize("package", ORDERS)
def test_every_folder_has_its_place_in_the_order(package: str) -> None:
    folders = {name for name, path in MODULES.items() if path.name == "__init__.py" and within(name, (package,))}
    assert {part_of(folder, package) for folder in folders - {package}} <= set(ORDERS[package])


CORE = ("records", "coords", "errors", "backward", "files", "jpeg", "image_io", "metrics", "draw", "pyramid")


@pytest.mark.parametrize("module", CORE)
def test_the_core_imports_no_room(module: str) -> None:
    wrong = {name for name in imported_by(MODULES[f"hybrid.{module}"]) if within(name, ROOMS + OUTER)}
    assert not wrong, f"hybrid.{module} imports {sorted(wrong)}"


@pytest.mark.parametrize("module", [m for m in MODULES if within(m, ("hybrid",))])
def test_hybrid_never_imports_benchmarks_or_tests(module: str) -> None:
    wrong = {name for name in imported_by(MODULES[module]) if within(name, ("benchmarks", "tests"))}
    assert not wrong


def loaded_after(code: str) -> set[str]:
    """Names of all modules that are loaded in a fresh interpreter after it ran ``code``."""
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print('\\n'.join(['MODULES', *sys.modules]))"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    return set(done.stdout.split("MODULES\n")[1].split())


def test_importing_the_package_loads_nothing_heavy() -> None:
    heavy = {"torch", "cv2", "scipy", "numpy", "open3d", "kornia"}
    assert not heavy & loaded_after("import hybrid")


def test_help_is_quick() -> None:
    assert not {"torch", "cv2", "open3d", "kornia"} & loaded_after(
        "import hybrid.cli, contextlib, io\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n"
        "    hybrid.cli.main(['--help'])"
    )


def test_rectifying_loads_neither_open3d_nor_the_trainer() -> None:
    modules = loaded_after(
        "import numpy as np, hybrid\n"
        "ramp = np.linspace(0, 255, 128 * 128 * 3).reshape(128, 128, 3).astype(np.uint8)\n"
        "hybrid.rectify(ramp)"
    )
    others = ("open3d", "kornia", "data_gen", "hybrid.mesh", *(f"hybrid.learn.{x}" for x in ORDERS["hybrid.learn"][2:]))
    assert not {m for m in modules if within(m, others)}
