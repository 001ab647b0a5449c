"""How well a displacement explains sightings that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hybrid.rectify.splines.displacement import SplineConfig, fit_displacement, lattice_rows
from hybrid.rectify.splines.sightings import Sightings

MOST_RESIDUAL = 20.0
"""Residuals are clipped to this many stated deviations."""


def held_out_residuals(sightings: Sequence[Sightings], config: SplineConfig, folds: int = 2) -> tuple[float, float]:
    """Mean clipped residual, in stated deviations, of sightings that the spline was not fitted to, before and after.

    Runs of neighbouring sightings are held out together, because neighbours share their errors. The constants that a
    list shares are estimated from the sightings that the spline was fitted to.
    """
    before, after, count = 0.0, 0.0, 0
    rows = lattice_rows(sightings, config)
    for fold in range(folds):
        out = [np.arange(len(s)) // 8 % folds == fold for s in sightings]
        seen = [s.subset(~o) for s, o in zip(sightings, out, strict=True)]
        fit = fit_displacement(seen, config, [r[~o] for r, o in zip(rows, out, strict=True)])
        for s, r, o, constants in zip(sightings, rows, out, fit.constants, strict=True):
            held = s.subset(o)
            if not len(held):
                continue
            predicted = r[o] @ fit.displacement.values[:, held.axis]
            offsets = held.offsets() - held.shared @ constants
            before += np.minimum(np.abs(_without_shared(held)) / held.sigma, MOST_RESIDUAL).sum()
            after += np.minimum(np.abs(offsets - predicted) / held.sigma, MOST_RESIDUAL).sum()
            count += len(held)
    return (before / count, after / count) if count else (0.0, 0.0)


def _without_shared(sightings: Sightings) -> Float[np.ndarray, " n"]:
    """Offsets minus what the shared constants alone explain: what is left if nothing is displaced."""
    if sightings.shared.shape[1] == 0:
        return sightings.offsets()
    best, *_ = np.linalg.lstsq(sightings.shared, sightings.offsets(), rcond=None)
    return sightings.offsets() - sightings.shared @ best


__all__ = ["held_out_residuals"]
