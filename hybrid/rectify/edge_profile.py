"""Where the sheet ends across its edge, to a fraction of a pixel: at a step, or at the outer flank of a printed rule.

A bright rule along the very edge of the print has two steps, and the inner one, to the black film, is mostly steeper.
So profiles across the edge are explained twice by least squares: as a blurred step between two levels, and with a thin
band of a third level at the sheet's end. The band counts where it explains the whole side far better and is brighter
than what lies on both sides of it: then it is neither a shadow nor the bright seam that a camera's sharpening leaves.
Where a rule lies along another edge of the sheet, less tells of one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr

from hybrid.coords import linear_from_srgb
from hybrid.rectify.curves import parabola_peak

REACH = 4
"""Pixels from the path within which the edge lies."""
ROWS = np.arange(-REACH - 5, REACH + 6)
"""Pixels around the path that are explained."""
PLACES = np.arange(-REACH, REACH + 1e-9, 0.25)
"""Places of the edge that are tried, from the path, in pixels; inwards is positive."""
BLURS_PX = (0.45, 0.8, 1.3)
"""Standard deviations of the blur that are tried."""
RULES_PX = (0.9, 2.0)
"""Widths of rules that are tried. Thinner ones look alike but for their level, so that a level tells no width."""
WIDER = 0.6
"""By how much the wider rule has to explain better what the thinner one explains, as LEAST_GAIN."""
LEAST_GAIN = 1.4
"""Natural logarithm by which a rule must lower what is left unexplained, at the median of a side's profiles."""
LEAST_EXCESS = 0.35
"""How much brighter a rule must be than what lies beside it, in parts of the contrast of both sides."""
EXPECTED_GAIN, EXPECTED_EXCESS = 0.8, 0.2
"""The same where a rule is expected: it must be brighter than the film, and may be darker than what lies behind."""
JUDGED_EVERY = 3
"""One profile in so many is asked whether there is a rule."""
UNEXPLAINED = 2e-3
"""Share of a profile's variance that no model is asked to explain."""
BESIDE = 8
"""Pixels beyond REACH of which the levels of both sides of a step are the medians."""

CLIPPED = 248.0
"""Grey level from which the photo is taken to be clipped."""


@dataclass(frozen=True, eq=False)
class EndOfSheet:
    """Where the sheet ends in a strip across its edge.

    rows: of each profile, to a fraction. has_rule: whether a rule is printed along it, and its outer flank was found.
    clipped: whether the photo is clipped in all colours outside, for each profile.
    """

    rows: Float[np.ndarray, " p"]
    has_rule: bool
    clipped: Bool[np.ndarray, " p"]


def end_of_sheet(image: Float[np.ndarray, "d p 3"], path: Int[np.ndarray, " p"], expected: bool) -> EndOfSheet:
    """Where the sheet ends in a strip across its edge, inwards down, within REACH of a path.

    expected: whether a rule may well be printed along it, as one is along other edges.
    """
    beyond = REACH + BESIDE
    padded = np.pad(image, ((beyond, beyond), (0, 0), (0, 0)), mode="edge")
    grey = padded[path + np.arange(2 * beyond + 1)[:, None], np.arange(len(path))]
    # Blur adds up light, not grey levels: in these the steepest place of a blurred step lies on its dark side.
    local = linear_from_srgb(grey / 255.0)
    ruled = ruled_edge(local[beyond + ROWS[0] : beyond + ROWS[-1] + 1], expected)
    clipped = np.median(grey[: beyond - 3], axis=0).min(axis=-1) >= CLIPPED
    return EndOfSheet(path + (stepped_edge(local) if ruled is None else ruled), ruled is not None, clipped)


def stepped_edge(local: Float[np.ndarray, "n p 3"]) -> Float[np.ndarray, " p"]:
    """Pixels from the middle row of linear profiles to the steepest place of the step near it."""
    middle = len(local) // 2
    outer, inner = (np.median(side, axis=0) for side in (local[: middle - 3], local[middle + 4 :]))
    step = outer - inner
    direction = step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-6)
    slope = -gaussian_filter1d(np.einsum("dpc,pc->dp", local, direction), 1.0, axis=0, order=1)
    return parabola_peak(slope[middle - REACH - 1 : middle + REACH + 2]) - REACH - 1


def ruled_edge(local: Float[np.ndarray, "n p 3"], expected: bool) -> Float[np.ndarray, " p"] | None:
    """Pixels from the middle row of linear profiles to the outer flank of a rule along the edge; None without one."""
    bases, inverses = _models()
    some = local[:, 1::JUDGED_EVERY]
    score = np.median(_unexplained(bases[:, :, ::2], some).min(axis=2), axis=2)  # of models by width and blur
    best = score.min(axis=1) + np.array([0.0, 0.0, WIDER])
    width = 1 + int(np.argmin(best[1:]))
    if best[0] - best[width] < (EXPECTED_GAIN if expected else LEAST_GAIN):
        return None
    model = width, int(np.argmin(score[width]))
    at = parabola_peak(-_unexplained(bases[model], local))
    nearest = np.rint(at).astype(np.intp)
    outer, inner, rule = np.einsum("pkn,npc->kpc", inverses[model][nearest], local)
    contrast = np.linalg.norm(outer - inner, axis=-1)
    if expected:
        excess, least = (rule - inner).mean(axis=-1), EXPECTED_EXCESS
    else:
        excess, least = np.linalg.norm(np.maximum(rule - np.maximum(outer, inner), 0.0), axis=-1), LEAST_EXCESS
    if np.median(excess - least * contrast) <= 0.0:
        return None
    return PLACES[0] + at * (PLACES[1] - PLACES[0])


def _unexplained(bases: Float[np.ndarray, "*models k n"], local: Float[np.ndarray, "n p 3"]) -> np.ndarray:
    """(*models, p) logarithm of the share of each profile's variance that each model leaves unexplained."""
    coefficients = bases.reshape(-1, len(local)) @ local.reshape(len(local), -1)
    explained = np.square(coefficients).reshape(*bases.shape[:-1], -1, 3).sum(axis=(-3, -1))
    total, variance = (np.square(y).sum(axis=(0, 2)) for y in (local, local - local.mean(axis=0)))
    return np.log(np.maximum(total - explained, 0.0) / np.maximum(variance, 1e-5) + UNEXPLAINED)


@lru_cache(maxsize=1)
def _models() -> tuple[Float[np.ndarray, "w s x k n"], Float[np.ndarray, "w s x k n"]]:
    """Of each width of the rule (0: none), blur and place: an orthonormal basis of the profiles, and what gives their
    levels outside, inside and of the rule."""
    shape = (1 + len(RULES_PX), len(BLURS_PX), len(PLACES), 3, len(ROWS))
    bases, inverses = np.zeros(shape), np.zeros(shape)
    for w, width in enumerate((0.0, *RULES_PX)):
        for s, blur in enumerate(BLURS_PX):
            for x, place in enumerate(PLACES):
                begins, ends = (ndtr((ROWS - place - offset) / blur) for offset in (0.0, width))
                levels = np.stack([1 - begins, ends, begins - ends][: 3 if width else 2], axis=-1)
                bases[w, s, x, : levels.shape[1]] = np.linalg.qr(levels)[0].T
                inverses[w, s, x, : levels.shape[1]] = np.linalg.pinv(levels)
    return bases, inverses


__all__ = ["EndOfSheet", "end_of_sheet", "ruled_edge", "stepped_edge"]
