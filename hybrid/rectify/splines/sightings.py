"""Observations of the film along one axis each.

A sighting says: the photo, looked at through the current map, shows at film point ``seen`` something whose true film
coordinate along one axis is ``known``. An edge or a rule says nothing about the other axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from hybrid.backward import BackwardMap
from hybrid.rectify.splines.tps import MAD_TO_SIGMA

PRIOR_COUNT = 4.0
"""Number of residuals of a group that the stated deviations count as."""
ANATOMY_VARIANCE = 2.5
"""Factor by which the variance of anatomy grows: that of one slice is shifted as a whole, mostly to the front or the
back, so that the sightings in a cell are off together, and count as if there were fewer."""
LONE_FACTOR = 2.0
"""Factor by which stated deviations grow where a group is too small to show its spread."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """Places on the film whose true coordinate along one axis is known, up to a few shared unknowns.

    axis: 0 where u is known, 1 where v is known.
    seen: film uv at which the things are seen through some map.
    known: their true coordinate along the axis.
    sigma: standard deviation of ``seen`` along the axis, in film units.
    shared: columns of unknown constants that add to ``known`` (the pitch of a grid, the place of a text in its
        cell): known + shared @ constants.
    shared_sigma: prior standard deviation of these constants around 0, in film units.
    group: a number for each sighting, or None. Sightings of one number show the same thing in different places: a
        text, which is alike everywhere, or anatomy, which is not. How alike it is follows from how well they agree.
    has_rule: for one of the sheet's edges, whether a rule is printed along it. rule_expected: whether there may be one
        that was not told apart from the edge, so that the edge's place is uncertain (refine/course.py). has_frame:
        whether there is a bright band wider than a rule, so that the print ends inside it.
    along: film coordinate of the things along the other axis, where it is known better than from ``seen``.
    """

    axis: int
    seen: Float[np.ndarray, "n 2"]
    known: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]
    shared: Float[np.ndarray, "n g"]
    shared_sigma: Float[np.ndarray, " g"]
    group: Int[np.ndarray, " n"] | None = None
    has_rule: bool = False
    rule_expected: bool = False
    has_frame: bool = False
    along: Float[np.ndarray, " n"] | None = None

    def __len__(self) -> int:
        return len(self.known)

    def places(self) -> Float[np.ndarray, "n 2"]:
        """The film points as far as known: ``seen``, with both coordinates corrected where they are known better."""
        uv = self.seen.copy()
        uv[:, self.axis] = self.known
        if self.along is not None:
            uv[:, 1 - self.axis] = self.along
        return uv

    def offsets(self) -> Float[np.ndarray, " n"]:
        """What the displacement has to be along the axis, up to the shared constants."""
        return self.seen[:, self.axis] - self.known

    def subset(self, chosen: np.ndarray) -> Sightings:
        """The chosen sightings only."""
        return replace(
            self,
            seen=self.seen[chosen],
            known=self.known[chosen],
            sigma=self.sigma[chosen],
            shared=self.shared[chosen],
            group=None if self.group is None else self.group[chosen],
            along=None if self.along is None else self.along[chosen],
        )


def carried(sightings: Sequence[Sightings], before: BackwardMap, after: BackwardMap) -> tuple[Sightings, ...]:
    """Sightings made through one map, as if they had been made through another that is near (Newton's method)."""
    if after is before or not sightings:
        return tuple(sightings)
    seen = np.concatenate([s.seen for s in sightings])
    moved = np.split(after.film_near(before.photo_from_film(seen), seen), np.cumsum([len(s) for s in sightings])[:-1])
    return tuple(replace(s, seen=part, along=None) for s, part in zip(sightings, moved, strict=True))


def group_noise(
    stated: Float[np.ndarray, " n"],
    groups: Int[np.ndarray, " n"],
    residual: Float[np.ndarray, " n"],
    text_sigma: float,
) -> Float[np.ndarray, " n"]:
    """Stated deviations, those of each group multiplied by a factor found from how well its sightings agree.

    groups: a number for each sighting, -1 for none. The spread of few residuals tells little: the stated deviations
    count as ``PRIOR_COUNT`` more of them. text_sigma: what is less exact than this, in the units of the deviations, is
    anatomy; only what exceeds it grows by ``ANATOMY_VARIANCE``.
    """
    grouped = groups >= 0
    group, size = groups[grouped], np.bincount(groups[grouped])
    spread = MAD_TO_SIGMA * group_medians(np.abs(residual[grouped] / stated[grouped]), group)
    variance = (size * spread**2 + PRIOR_COUNT) / (size + PRIOR_COUNT)
    found = stated[grouped] * np.where(size > 2, np.sqrt(variance), LONE_FACTOR)[group]
    sigma = stated.copy()
    sigma[grouped] = np.sqrt(found**2 + (ANATOMY_VARIANCE - 1.0) * np.maximum(found**2 - text_sigma**2, 0.0))
    return sigma


def group_medians(values: Float[np.ndarray, " n"], group: Int[np.ndarray, " n"]) -> Float[np.ndarray, " g"]:
    """Median of the values of each group, numbered from 0; an empty group gives 0."""
    size = np.bincount(group)
    order = np.argsort(values)
    order = order[np.argsort(group[order].astype(np.uint16), kind="stable")]  # a radix sort, quicker than np.lexsort
    ordered = np.append(values[order], 0.0)
    first = np.cumsum(size) - size
    return np.where(size > 0, 0.5 * (ordered[first + (size - 1) // 2] + ordered[first + size // 2]), 0.0)


__all__ = ["Sightings", "carried", "group_medians", "group_noise"]
