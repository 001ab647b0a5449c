"""What every feed has. Batches are pure functions of places and a seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor, nn

from hybrid.learn.training.pictures import Picture

TEST_BATCH = 32
"""Places that are tested together."""


def _first_of(places: Sequence[Any], held_out: int) -> tuple[list[Any], list[Any]]:
    return list(places[:held_out]), list(places[held_out:])


@dataclass(frozen=True)
class Feed:
    """Data for one kind of network.

    open: the places (samples, or prints) of some folders. split: into places for testing, at least a given number, and
    places for training; photos of one film are adjacent, so both share at most the film at the cut. batch: images and
    targets of some places at an input size in pixels, each disturbed by its own random numbers. test: figures of a
    network on held-out places, by name. picture: drawing of the network's output on some of these places; None where
    there is nothing to draw.
    """

    open: Callable[[Sequence[Path]], list[Any]]
    batch: Callable[[Sequence[Any], int, Sequence[np.random.Generator]], tuple[Tensor, Any]]
    test: Callable[[nn.Module, Sequence[Any], int, str], dict[str, float]]
    picture: Callable[[nn.Module, Sequence[Any], int, str], Picture] | None = None
    split: Callable[[Sequence[Any], int], tuple[list[Any], list[Any]]] = _first_of


def in_batches(places: Sequence[Any]) -> list[Sequence[Any]]:
    """The places in groups of those that are tested together."""
    return [places[start : start + TEST_BATCH] for start in range(0, len(places), TEST_BATCH)]
