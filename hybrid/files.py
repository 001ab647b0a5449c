"""Folders and files that are written: refused before any work if they cannot be, and whole or not at all."""

from __future__ import annotations

import os
import tempfile
import uuid
from pathlib import Path

from hybrid.errors import ConfigError, describe


def make_folder(out: Path, option: str = "-o") -> None:
    """Make the output folder and check that files can be made in it; ConfigError if not."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        got = "a file of this name" if out.is_file() else error.strerror
        do = f"Name a folder that can be written, with {option}."
        raise ConfigError(describe(what="Nothing can be written there", where=out, got=got, do=do)) from None


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file whole or not at all: a file of that name stays as it was until the new one is complete."""
    path = Path(path)
    unfinished = path.with_name(f".{uuid.uuid4().hex[:12]}.part")  # no longer than any name that may be asked for
    try:
        unfinished.write_bytes(data)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


__all__ = ["make_folder", "write_bytes"]
