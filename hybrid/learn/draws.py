"""Random numbers as several augmentations draw them."""

from __future__ import annotations

import numpy as np


def log_uniform(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """A number between bounds whose logarithm is as likely anywhere between theirs."""
    return float(np.exp(rng.uniform(*np.log(bounds))))
