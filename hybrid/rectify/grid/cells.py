"""The cells of a film that lies nearly flat: the regular grid that explains the print best.

Combs of lines (grid/lines.py) and repetition (grid/repeat.py) each look at one axis and one kind of evidence. How many
cells there are and where the first begins is decided here, for both axes at once. Every regular grid with some evidence
is weighed: by the lines seen between its cells or the gaps that the print leaves there, by how well the film repeats at
its pitch, by the print outside it, by its margins, and by how square its cells are. The weights are those of a
conditional logit (McFadden 1974) over simulated films with known grids, so that the result is a probability.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from hybrid.errors import FittedWeights, require_at_least, require_at_most
from hybrid.rectify.grid.lines import MAX_CELLS, GridConfig, line_votes, narrowed
from hybrid.rectify.grid.phases import AxisPhases
from hybrid.rectify.grid.repeat import Repeats, autocorrelation, detail, highest

SAME_PLACE = 0.012
"""Grids with as many cells are the same if their first cells begin this near to each other, in film units. So are a
grid as it was read and one as it was fitted, if their lines are this near to each other."""
LEAST_PROBABILITY = 0.3
"""A grid less probable than this does not count."""


@dataclass(frozen=True)
class Weights(FittedWeights):
    """By how much each sign of a grid along one axis raises its log-odds, for a sign of 1.

    line: share of the film's length on which the lines between its cells are seen. clear: strength of the print there,
    1 being the film's mean. outside: share of the print beyond the grid. echo, half: correlation of the film with
    itself, shifted by a cell and by half a cell. best: the former, relative to the largest there is. centre: how far
    the grid's middle is from the film's, in tenths of the film. wide: the wider margin, in tenths. least: print in the
    emptiest row of cells, relative to the mean. cells: the logarithm of their number. beyond: by how much the grid
    extends beyond the film, in fiftieths. phase, ends: how well the grid agrees with what the network says
    (grid/phases.py).
    oblong: for both axes together, weights of the logarithm of the ratio of a cell's sides: pairs of a value above
    which it counts no more, and a weight.
    """

    line: float = 5.53
    clear: float = -3.62
    outside: float = -6.06
    echo: float = 3.68
    half: float = -1.50
    best: float = 3.84
    centre: float = -2.61
    wide: float = -0.88
    least: float = 3.05
    cells: float = 0.83
    beyond: float = -6.31
    phase: float = 6.44
    ends: float = 2.06
    oblong: tuple[tuple[float, float], ...] = ((1.0, -0.21), (0.15, -1.37), (0.05, -3.12))


UNTOLD = Weights(
    line=7.67,
    clear=-4.46,
    outside=-7.98,
    echo=4.91,
    half=-5.26,
    best=4.16,
    centre=-3.69,
    wide=-1.45,
    least=2.75,
    cells=1.31,
    beyond=-3.56,
    phase=0.0,
    ends=0.0,
    oblong=((1.0, -1.24), (0.15, -4.03), (0.05, -3.70)),
)
"""The weights where the network says nothing about the cells."""


@dataclass(frozen=True)
class CellsConfig:
    """Options for reading the cells."""

    side_px: int = 400
    """Longer side of the view of the film."""
    widths_px: tuple[int, ...] = (1, 2, 4, 8)
    """Widths of lines looked for, in pixels of the view."""
    detail_px: tuple[float, float] = (1.0, 5.0)
    """Scales between which the print's detail lies, in pixels of the view."""
    least_filled: float = 0.62
    """Least share of the film that the grid covers along each axis."""
    weights: Weights = Weights()
    untold: Weights = UNTOLD
    kept: int = 48
    """Grids along one axis that are weighed together with those along the other: the best ones by their own scores."""
    counts: tuple[int, int] = (0, 0)
    """Numbers of columns and rows that are taken for granted; 0: none."""

    def __post_init__(self) -> None:
        require_at_least(self, 64, "side_px")
        require_at_least(self, 0.1, "detail_px")
        require_at_least(self, 1, "kept", "widths_px")
        require_at_most(self, 1, "least_filled")


@dataclass(frozen=True, eq=False)
class Reading:
    """The cells along both axes, and the probability that they are right."""

    columns: Repeats
    rows: Repeats
    probability: float

    @property
    def is_likely(self) -> bool:
        """Whether they count as the film's grid."""
        return self.probability >= LEAST_PROBABILITY


@dataclass(frozen=True, eq=False)
class Profile:
    """What the flat film shows along one axis, in equal steps from one edge to the other.

    lines: share of the film's length on which a line of each kind is seen. ink: strength of the print's detail, 1 on
    average. echo: correlation of the film with itself, shifted by so many steps. told: what the network says.
    """

    lines: Float[np.ndarray, "n k"]
    ink: Float[np.ndarray, " n"]
    echo: Float[np.ndarray, " n"]
    told: AxisPhases | None = None


def read_cells(
    grey: Float[np.ndarray, "h w"],
    aspect: float,
    pitches: tuple[Sequence[float], Sequence[float]],
    told: tuple[AxisPhases, AxisPhases] | None,
    grid: GridConfig,
    config: CellsConfig,
) -> Reading | None:
    """The most probable cells of a film; None where its view is too small to tell.

    grey: view of [0, 1]^2, in grey levels. aspect: the film's height over its width. pitches: of columns and of rows,
    as known from elsewhere, in film units; others are tried, too. told: what the network says about columns and rows.
    """
    weighed = _weighed(grey, aspect, pitches, told, grid, config)
    if weighed is None:
        return None
    grids, chance = weighed
    best = np.unravel_index(int(chance.argmax()), chance.shape)
    alike = [_alike(tried, tried[k]) for tried, k in zip(grids, best, strict=True)]
    probability = float(chance[np.ix_(*alike)].sum() / chance.sum())
    columns, rows = (
        Repeats(axis, float(first), float(pitch), int(cells))
        for axis, (cells, first, pitch) in enumerate(tried[k] for tried, k in zip(grids, best, strict=True))
    )
    return Reading(columns, rows, min(1.0, probability))


def weighed_counts(
    grey: Float[np.ndarray, "h w"],
    aspect: float,
    told: tuple[AxisPhases, AxisPhases] | None,
    grid: GridConfig,
    config: CellsConfig,
) -> list[tuple[tuple[int, int], float]]:
    """Numbers of columns and rows, and their probability, the most probable first. Arguments as for ``read_cells``."""
    weighed = _weighed(grey, aspect, ((), ()), told, grid, config)
    if weighed is None:
        return []
    grids, chance = weighed
    (columns, column), (rows, row) = (np.unique(tried[:, 0].astype(int), return_inverse=True) for tried in grids)
    sums = np.eye(len(columns))[column].T @ chance @ np.eye(len(rows))[row] / chance.sum()
    ordered = [np.unravel_index(k, sums.shape) for k in np.argsort(-sums, axis=None)]
    return [((int(columns[j]), int(rows[i])), float(sums[j, i])) for j, i in ordered]


def _weighed(
    grey: Float[np.ndarray, "h w"],
    aspect: float,
    pitches: tuple[Sequence[float], Sequence[float]],
    told: tuple[AxisPhases, AxisPhases] | None,
    grid: GridConfig,
    config: CellsConfig,
) -> tuple[list[Float[np.ndarray, "_ 3"]], Float[np.ndarray, "c r"]] | None:
    """Grids along each axis (as ``candidates``), and the odds of each pair of them; None where the view is too small to
    tell."""
    scale = config.side_px / max(grey.shape)
    if scale < 1:
        size = [round(scale * n) for n in grey.shape[::-1]]  # not fx and fy: these leave odd pixels over
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    if min(grey.shape) < 4 * MAX_CELLS:
        return None
    weights = config.untold if told is None else config.weights
    band = detail(grey, *config.detail_px)
    profiles = [profile_of(grey, band, axis, told and told[axis], grid, config) for axis in (0, 1)]
    grids, scores = [], []
    for profile, known in zip(profiles, pitches, strict=True):
        tried = candidates(profile, known, config)
        score = scores_of(profile, tried, config, weights)
        best = np.argsort(-score)[: config.kept]
        grids.append(tried[best])
        scores.append(score[best])
    oblong = np.abs(np.log(grids[0][:, None, 2] / (aspect * grids[1][None, :, 2])))
    odds = scores[0][:, None] + scores[1][None]
    odds += sum(weight * np.minimum(oblong, most) for most, weight in weights.oblong)
    chance = np.exp(odds - odds.max())
    granted = (grids[0][:, None, 0] == config.counts[0]) & (grids[1][None, :, 0] == config.counts[1])
    if granted.any():
        chance = np.where(granted, chance, 0.0)
    return grids, chance


def profile_of(
    grey: Float[np.ndarray, "h w"],
    band: Float[np.ndarray, "h w"],
    axis: int,
    told: AxisPhases | None,
    grid: GridConfig,
    config: CellsConfig,
) -> Profile:
    """What a view and its detail show of borders across one axis, and what the network says about them."""
    ink = np.abs(band).mean(axis=axis)
    narrow = narrowed(grey, axis)
    votes = np.concatenate([line_votes(narrow, width, grid) for width in config.widths_px], axis=2)
    shares = maximum_filter1d(votes, 3, axis=1).mean(axis=0)
    ink = minimum_filter1d(ink / max(float(ink.mean()), 1e-6), 3)
    return Profile(maximum_filter1d(shares, 3, axis=0), ink, autocorrelation(band if axis == 0 else band.T), told)


def candidates(profile: Profile, known: Sequence[float], config: CellsConfig) -> Float[np.ndarray, "c 3"]:
    """Grids along one axis that there is some evidence for: number of cells, where the first begins, pitch."""
    n, shown = len(profile.ink), np.stack([-profile.ink, profile.lines.max(axis=1)])
    found = []
    for pitch in _pitches(profile, known, config):
        for cells in range(max(1, int(config.least_filled / pitch)), int(1.015 / pitch) + 1):
            slack = 1.0 - cells * pitch
            firsts = [0.5 * slack, 0.0, slack]
            if profile.told is not None:
                firsts += profile.told.firsts(pitch, min(slack, 0.0) - 0.01, max(slack, 0.0) + 0.01)
            if cells > 1:
                first = np.arange(min(0.0, slack) - 0.004, max(slack, 0.0) + 0.004, 1.0 / n)
                inner = _step(first[:, None] + pitch * np.arange(1, cells), n)
                clear, seen = shown[:, inner] @ np.full(cells - 1, 1.0 / (cells - 1))
                for score, number in ((clear, 3), (seen, 3), (seen + clear, 2)):
                    firsts += first[_peaks(score, number, int(0.01 * n))].tolist()
            found += [(cells, value, pitch) for value in _apart(firsts, 0.003)]
    return np.array(found)


def scores_of(
    profile: Profile, grids: Float[np.ndarray, "c 3"], config: CellsConfig, weights: Weights
) -> Float[np.ndarray, " c"]:
    """Log-odds of each grid along one axis, up to a constant."""
    signs = grid_signs(profile, grids, config)
    return np.asarray(sum(getattr(weights, name) * sign for name, sign in signs.items()))


def grid_signs(
    profile: Profile, grids: Float[np.ndarray, "c 3"], config: CellsConfig
) -> dict[str, Float[np.ndarray, " c"]]:
    """The evidence for and against each grid, by the names that Weights explains."""
    n, (cells, first, pitch) = len(profile.ink), grids.T
    border, end = np.arange(MAX_CELLS + 1), first + cells * pitch
    at = first[:, None] + pitch[:, None] * border
    inner = (border >= 1) & (border < cells[:, None])
    count, several = np.maximum(inner.sum(axis=1), 1), cells > 1
    step = _step(at, n)
    line = ((profile.lines[step] * inner[..., None]).sum(axis=1) / count[:, None]).max(axis=1)
    clear = (profile.ink[step] * inner).sum(axis=1) / count
    total = np.concatenate([[0.0], np.cumsum(profile.ink)]) / max(float(profile.ink.sum()), 1e-9)
    edges = np.linspace(0.0, 1.0, n + 1)
    outside = 1.0 - np.interp(end + 0.004, edges, total) + np.interp(first - 0.004, edges, total)
    in_cells = np.diff(np.interp(at, edges, total), axis=1) / pitch[:, None]
    least = np.where(border[:-1] < cells[:, None], in_cells, np.inf).min(axis=1)
    near = maximum_filter1d(profile.echo, 3)
    echo, half = (near[_lag(part * pitch, n)] for part in (1.0, 0.5))
    shortest, longest = n // (MAX_CELLS + 1), int(0.56 * n)
    echo = np.where(pitch < 0.75, echo, 0.0)
    return {
        "line": np.where(several, line, 0.0),
        "clear": np.where(several, clear, 1.0),
        "outside": outside,
        "echo": echo,
        "half": np.where(cells < 6, half, 0.0),
        "best": echo / max(float(profile.echo[shortest:longest].max()), 0.02),
        "centre": 10 * np.minimum(np.abs(0.5 * (first + end) - 0.5), 0.1),
        "wide": 10 * np.clip(np.maximum(first, 1.0 - end), 0.0, 0.3),
        "least": np.clip(least, 0.0, 1.0),
        "cells": np.log(cells),
        "beyond": 50 * np.clip(-np.minimum(first, 1.0 - end), 0.0, 0.02),
        "phase": np.zeros(len(grids)) if profile.told is None else profile.told.agreement(first, pitch),
        "ends": np.zeros(len(grids)) if profile.told is None else profile.told.ends(first, end),
    }


# ---------------------------------------------------------------- steps


def _pitches(profile: Profile, known: Sequence[float], config: CellsConfig) -> list[float]:
    """Pitches worth a try: those known, the peaks of the autocorrelation, and those of grids that fill the film."""
    echo, n = profile.echo, len(profile.echo)
    lags = np.arange(max(4, int(n / (MAX_CELLS + 0.8))), int(0.56 * n))
    peaks = lags[(echo[lags] >= maximum_filter1d(echo, 7)[lags]) & (echo[lags] > 0.03)]
    found = [factor * pitch for pitch in known for factor in (0.5, 1.0, 2.0)]
    found += [_sharpened(echo, int(lag)) / n for lag in peaks[np.argsort(-echo[peaks])][:8]]
    found += [1.0 / cells for cells in range(1, MAX_CELLS + 1)]
    found += [] if profile.told is None else [profile.told.pitch(1.05, 1.0 / (MAX_CELLS + 0.5))]
    kept = [0.0]
    for pitch in sorted(found):
        if 1.0 / (MAX_CELLS + 0.6) <= pitch <= 1.005 and pitch > 1.004 * kept[-1]:
            kept.append(pitch)
    return kept[1:]


def _sharpened(echo: Float[np.ndarray, " n"], lag: int) -> float:
    """A lag at which the film correlates with itself, refined to a fraction of a step by those of its multiples at
    which the film correlates, too."""
    pitch = highest(echo, lag)
    for multiple in (2, 3, 4, 5):
        near = round(multiple * pitch)
        if near + 5 > 0.8 * len(echo):
            break
        peak = near - 3 + int(np.argmax(echo[near - 3 : near + 4]))
        if abs(peak - near) == 3 or echo[peak] < 0.5 * echo[lag]:
            break
        pitch = highest(echo, peak) / multiple
    return pitch


def _peaks(score: Float[np.ndarray, " n"], number: int, apart: int) -> list[int]:
    """Where the best scores are, no two of them within ``apart`` steps of each other."""
    left, best = score.copy(), []
    for _ in range(number):
        k = int(left.argmax())
        if left[k] == -np.inf:
            break
        best.append(k)
        left[max(0, k - apart) : k + apart + 1] = -np.inf
    return best


def _apart(values: list[float], least: float) -> list[float]:
    """The values without those that lie within ``least`` of an earlier one."""
    kept: list[float] = []
    ordered = [-np.inf, np.inf]
    for value in values:
        k = bisect(ordered, value)
        if ordered[k] - value > least and value - ordered[k - 1] > least:
            ordered.insert(k, value)
            kept.append(value)
    return kept


def _step(at: Float[np.ndarray, "*n"], n: int) -> Int[np.ndarray, "*n"]:
    """The step of a profile in which a film coordinate lies."""
    return np.minimum(np.maximum((at * n).astype(np.intp), 0), n - 1)  # np.clip takes three times as long


def _lag(pitch: Float[np.ndarray, " c"], n: int) -> Int[np.ndarray, " c"]:
    return np.clip(np.round(pitch * n).astype(np.intp), 1, n - 2)


def _alike(grids: Float[np.ndarray, "c 3"], one: Float[np.ndarray, "3"]) -> Bool[np.ndarray, " c"]:
    """Which grids are the same as a given one, up to the exact place of their cells."""
    return (grids[:, 0] == one[0]) & (np.abs(grids[:, 1] - one[1]) < SAME_PLACE)


__all__ = [
    "SAME_PLACE",
    "CellsConfig",
    "Reading",
    "Weights",
    "candidates",
    "grid_signs",
    "profile_of",
    "read_cells",
    "weighed_counts",
]
