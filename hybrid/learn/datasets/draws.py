"""Random numbers, and random sides of the film, for several augmentations."""

from __future__ import annotations

import numpy as np

from hybrid.strips import SIDES, Side


def log_uniform(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """A number between the bounds whose logarithm is uniformly distributed."""
    return float(np.exp(rng.uniform(*np.log(bounds))))


def one_side_or_two(rng: np.random.Generator) -> list[Side]:
    """One or two random sides of the film, with equal probability."""
    return [SIDES[k] for k in rng.permutation(4)[: rng.integers(1, 3)]]
