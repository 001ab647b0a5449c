"""The figures of a training run, a row for each test, in a CSV file that goes on where a resumed run does."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from hybrid.files import write_bytes


def cut_rows(path: Path, passes: int) -> None:
    """Remove what a run wrote after its last checkpoint: it will be written again."""
    if path.exists() and (lines := path.read_text().splitlines(keepends=True)):
        kept = [row for row in lines[1:] if int(row.split(",")[0]) <= passes]
        write_bytes(path, "".join([lines[0], *kept]).encode())


def append_row(path: Path, row: dict[str, Any]) -> None:
    """Append a row to a CSV file, with a header if it is new."""
    new = not path.exists() or not path.stat().st_size
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(row), lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()})


__all__ = ["append_row", "cut_rows"]
