"""Which of several maps of one film is likely nearest to the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid.errors import FittedWeights
from hybrid.records import Signs


@dataclass(frozen=True)
class NearnessConfig(FittedWeights):
    """By how much each sign of a map raises its log-odds of being nearer to the truth than another one of the same
    film: a logistic regression over pairs of up to 14 maps each of 138 films that are in doubt, by other renderers and
    simulated, in which pairs count by the logarithm of how much nearer one is.

    alike: for the logarithm of the share of detail that cells have in common. support: for that of the probability of
    the least likely edge. stated: for that of the error that refinement itself expects.

    The probability that a map is right to a limit (``chance_right``) tells films apart, which have different cells; of
    two maps of one film, that through which its cells look more alike is mostly the nearer one.
    """

    alike: float = 0.75
    support: float = 1.75
    stated: float = -0.61


def nearness(signs: Signs, config: NearnessConfig | None = None) -> float:
    """The larger, the nearer a map is to the truth, compared with others of the same film."""
    config = config or NearnessConfig()
    return float(
        config.alike * np.log(signs.alike + 0.05)
        + config.support * np.log(signs.support + 0.02)
        + config.stated * np.log(np.clip(signs.stated, 3e-4, 0.05))
    )


__all__ = ["NearnessConfig", "nearness"]
