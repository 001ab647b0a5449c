"""Results of ``benchmarks.surroundings``, as stored in its JSON file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Ended:
    """One changed photo: errors of the network alone and of the film, None where none was found; its status.

    wrong: called ``OK``, but further off than that allows.
    """

    change: str
    case: str
    network_px: float | None
    film_px: float | None = None
    status: str = ""
    wrong: bool = False


@dataclass(frozen=True)
class ChangeCount:
    """All photos with one change. Geometric means are over the films that were found."""

    change: str
    what: str
    photos: int
    network_found: int
    network_px: float | None
    network_to_10: int
    found: int
    film_px: float | None
    to_1: int
    to_5: int
    ok: int
    wrong: int


@dataclass(frozen=True)
class SurroundingsReport:
    """A whole run.

    run: benchmarks.machine.describe_run. whole: whether the pipeline was run, too. sides: number of sides of the film
    over which the network's map is averaged; four in older reports.
    """

    run: dict[str, Any]
    whole: bool
    counts: tuple[ChangeCount, ...]
    photos: tuple[Ended, ...]
    sides: int = 4


__all__ = ["ChangeCount", "Ended", "SurroundingsReport"]
