"""The verdict's two regressions, ``ChanceConfig`` and ``ErrorConfig``, fitted to films whose error is known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hybrid.records import Signs
from hybrid.rectify.verdict.trust import (
    ChanceConfig,
    ErrorConfig,
    TrustConfig,
    chance_features,
    features,
    film_verdict,
    largest_error_px,
)

LIMITS = (0.8, 1.0, 1.2)
"""Limits of the error to which the probability is fitted, in those of the effort: together they teach more."""
RIDGE = 3.0
"""Precision of a weight's prior, with signs in their standard deviations: signs that tell the same share the weight."""
FOLDS = 8
STEPS = 60
"""Reweighted least-squares steps: several times as many as it takes to converge."""
LEAST_DEVIATION = 0.05
"""Deviations of a logarithm below this are counted by their squares."""

Scores = Float[np.ndarray, " n"]
Reweighted = Callable[[Scores], tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]]
"""Weights and targets of the next least-squares step, from the scores of the last."""


@dataclass(frozen=True)
class Judged:
    """A film that was found in a photo, and its true mean end-point error in pixels of the photo.

    sheet: names the film, of which there may be several photos. first: its first result, if that was in doubt, so that
    it was refined again.
    """

    sheet: str
    photo: int
    error_px: float
    signs: Signs
    first: Judged | None = None

    def that_counts(self, trust: TrustConfig) -> Judged:
        """The first result if these options leave no doubt about it, else the last."""
        return self.first if self.first is not None and film_verdict(self.first.signs, trust).ok else self

    def right(self, trust: TrustConfig) -> bool:
        """Whether it may be called ``OK``."""
        return self.error_px < largest_error_px(self.signs.photo_px, trust)


def fit_chance(films: Sequence[Judged], trust: TrustConfig) -> ChanceConfig:
    """The probability of a right map: a logistic regression on its features, by Newton's method."""
    films = _refinements(films)
    cases = [(one, share * largest_error_px(one.signs.photo_px, trust)) for share in LIMITS for one in films]
    right = np.array([one.error_px < limit for one, limit in cases], dtype=np.float64)

    def reweighted(scores: Scores) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        chance = 1.0 / (1.0 + np.exp(-np.clip(scores, -30.0, 30.0)))
        weight = np.maximum(chance * (1.0 - chance), 1e-9)
        return weight, scores + (right - chance) / weight

    table = [chance_features(one.signs, limit) for one, limit in cases]
    return ChanceConfig(**_fitted(table, reweighted, ("constant", "limit"), len(LIMITS) * RIDGE))


def fit_error(films: Sequence[Judged]) -> ErrorConfig:
    """The error that is expected: least absolute deviations of its logarithm."""
    films = _refinements(films)
    logs = np.log([max(one.error_px / one.signs.film_px, 1e-6) for one in films])

    def reweighted(scores: Scores) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        return 1.0 / np.maximum(np.abs(logs - scores), LEAST_DEVIATION), logs

    return ErrorConfig(**_fitted([features(one.signs) for one in films], reweighted, ("constant",), RIDGE))


def trust_of_others(films: Sequence[Judged], trust: TrustConfig) -> list[TrustConfig]:
    """For each film, the options with weights fitted to other sheets."""
    number = {sheet: k % FOLDS for k, sheet in enumerate(sorted({one.sheet for one in films}))}
    fitted = [
        replace(trust, chance=fit_chance(others, trust), error=fit_error(others))
        for others in ([one for one in films if number[one.sheet] != fold] for fold in range(FOLDS))
    ]
    return [fitted[number[one.sheet]] for one in films]


def _refinements(films: Sequence[Judged]) -> list[Judged]:
    """The first and last results of films, except for photos that are the flat film themselves, of which nothing else
    is asked."""
    every = [one for film in films for one in (film.first, film) if one is not None]
    return [one for one in every if not one.signs.flat]


def _fitted(
    features: Sequence[dict[str, float]], reweighted: Reweighted, free: Sequence[str], ridge: float
) -> dict[str, float]:
    """Weights of features by iterated least squares. free: features whose weight has no prior."""
    names = list(features[0])
    table = np.array([[one[name] for name in names] for one in features])
    is_free = np.array([name in free for name in names])
    middle = np.where(is_free, 0.0, table.mean(axis=0))
    scale = np.where(is_free, 1.0, np.maximum(table.std(axis=0), 1e-9))
    rows, prior = (table - middle) / scale, np.diag(np.where(is_free, 0.0, ridge))
    weights = np.zeros(len(names))
    for _ in range(STEPS):
        weight, target = reweighted(rows @ weights)
        weighted = rows * weight[:, None]
        weights = np.linalg.solve(rows.T @ weighted + prior, weighted.T @ target)
    weights /= scale
    weights[names.index("constant")] -= weights @ middle
    return dict(zip(names, np.round(weights, 3).tolist(), strict=True))


__all__ = ["Judged", "fit_chance", "fit_error", "trust_of_others"]
