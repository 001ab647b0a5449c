"""Random numbers, and sides of the film, as several augmentations draw them."""

from __future__ import annotations

import numpy as np

from hybrid.strips import SIDES, Side


def log_uniform(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """A number between bounds whose logarithm is as likely anywhere between theirs."""
    return float(np.exp(rng.uniform(*np.log(bounds))))


def one_side_or_two(rng: np.random.Generator) -> list[Side]:
    """Sides of the film, as often one as two."""
    return [SIDES[k] for k in rng.permutation(4)[: rng.integers(1, 3)]]
