"""``hybrid info``: what a bug report should say about this installation."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from importlib.resources import files

import tyro

from hybrid import __version__
from hybrid.coords import CONVENTIONS_VERSION

PACKAGES = ("torch", "numpy", "scipy", "opencv-contrib-python-headless", "pillow", "open3d-cpu")


def run(arguments: list[str]) -> int:
    """Print versions, weights and machine."""
    tyro.cli(_no_options, args=arguments, prog="hybrid info", description=run.__doc__)
    print(f"hybrid       {__version__} (conventions {CONVENTIONS_VERSION})")
    print(f"python       {platform.python_version()} on {platform.system()} {platform.machine()}")
    print(f"processors   {os.cpu_count()}")
    for package in PACKAGES:
        print(f"{package:<12} {version_of(package)}")
    folder = files("hybrid.learn") / "packaged"
    weights = sorted(w.name for w in folder.iterdir() if w.name.endswith(".safetensors")) if folder.is_dir() else []
    print(f"weights      {', '.join(weights) or 'none'}")
    return 0


def version_of(package: str) -> str:
    """The installed version of a package, or 'not installed'."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def _no_options() -> None:
    """The command takes no options."""
