"""What the network says about the cells, gathered along both axes of the film through any map of it.

For every place, FilmNet says how far along its cell the place lies, as an angle: a full turn from cell to cell. Through
a map that is about right, the angles grow evenly along an axis, so how well they agree with a grid tells whether it is
the right one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Complex, Float

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d, node_centres_1d
from hybrid.records import CoarseMaps
from hybrid.strips import StripReader

STEPS = 96
"""Parts into which the film is divided along an axis."""
MIDDLES = film_centres_1d(STEPS)
"""Their middles, in film units."""
SPREAD = (2, 5)
"""One of every 5 pixels in a row is used, two columns on from the previous row's: neighbours say the same."""
SLACK = 0.01
"""Places this far beyond the film's edges count as on it, in film units."""
LEAST_CHANCE = 0.02
"""Lower bound on the probability that a place lies in a cell, and on the probability that it does not."""


@dataclass(frozen=True, eq=False)
class CellPhases:
    """What the network says about the cells at places that show film.

    points: photo points. near: their film coordinates, as the network gives them. turns: e^(2 pi i t) where a place
    lies t of a cell from where its cell begins, across and down; shorter where that is less certain.
    in_grid: probability that it lies in a cell at all.
    borders: reads the borders between cells (grid/borders.py), once their places are roughly known.
    """

    points: Float[np.ndarray, "n 2"]
    near: Float[np.ndarray, "n 2"]
    turns: Complex[np.ndarray, "n 2"]
    in_grid: Float[np.ndarray, " n"]
    borders: StripReader | None = None

    @staticmethod
    def of(maps: CoarseMaps, borders: StripReader | None = None) -> CellPhases | None:
        """Phases from the network's maps; None where these say nothing about cells."""
        if maps.phases is None or maps.in_grid is None:
            return None
        rows, columns = np.indices(maps.mask.shape)
        film = maps.film & ((rows + SPREAD[0] * columns) % SPREAD[1] == 0)
        if not film.any():
            return None
        phases = maps.phases[film].astype(np.float64)
        points, near = (values[film].astype(np.float64) for values in (maps.photo_points, maps.uv))
        turns = phases[..., 0] + 1j * phases[..., 1]
        return CellPhases(points, near, turns, maps.in_grid[film].astype(np.float64), borders)

    def scaled(self, scale_xy: tuple[float, float]) -> CellPhases:
        """The same for the photo scaled along x and y."""
        return replace(self, points=self.points * np.array(scale_xy))

    def inside(self, film: BackwardMap) -> PlacedPhases:
        """Phases placed on the film by a map of it; places beyond its edges are left out."""
        uv = film.film_near(self.points, self.near, iterations=2, most_step=0.1)
        on = ((uv > -SLACK) & (uv < 1.0 + SLACK)).all(axis=1)
        return PlacedPhases(uv[on], self.turns[on], self.in_grid[on])


@dataclass(frozen=True, eq=False)
class PlacedPhases:
    """Phases at film points."""

    uv: Float[np.ndarray, "n 2"]
    turns: Complex[np.ndarray, "n 2"]
    in_grid: Float[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.uv)

    def axes(self) -> tuple[AxisPhases, AxisPhases]:
        """The phases gathered along u and along v."""
        return self._along(0), self._along(1)

    def in_step(self, first: Float[np.ndarray, "2"], pitch: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        """How well a grid agrees with the phases of places in cells, along u and along v: 1 at most, 0 by chance."""
        return self.in_grid @ np.real(self._turned(first, pitch)) / np.maximum(self.in_grid @ np.abs(self.turns), 1e-9)

    def _turned(self, first: Float[np.ndarray, "2"], pitch: Float[np.ndarray, "2"]) -> Complex[np.ndarray, "n 2"]:
        """The phases, turned back by those of a grid: real where the two agree."""
        return self.turns * np.exp(-2j * np.pi * (self.uv - first) / pitch)

    def _along(self, axis: int) -> AxisPhases:
        step = np.clip((self.uv[:, axis] * STEPS).astype(np.intp), 0, STEPS - 1)
        turns = self.turns[:, axis]
        count = np.bincount(step, minlength=STEPS)
        total = np.bincount(step, np.real(turns), STEPS) + 1j * np.bincount(step, np.imag(turns), STEPS)
        inside = np.bincount(step, self.in_grid, STEPS) / np.maximum(count, 1)
        # margins along the other axis lower every step alike
        most = max(float(np.quantile(inside[count > 0], 0.9)) if len(step) else 1.0, 0.3)
        return AxisPhases(total / max(len(step), 1), np.where(count > 0, np.minimum(inside / most, 1.0), 0.5))


@dataclass(frozen=True, eq=False)
class AxisPhases:
    """The phases along one axis, in equal steps from one edge to the other.

    turns: sums over the places in each step, divided by the number of all places. in_grid: probability that a step lies
    between the grid's ends.
    """

    turns: Complex[np.ndarray, " s"]
    in_grid: Float[np.ndarray, " s"]

    def agreement(self, first: Float[np.ndarray, " c"], pitch: Float[np.ndarray, " c"]) -> Float[np.ndarray, " c"]:
        """How well grids with these pitches agree with the phases: 1 at most, 0 by chance."""
        pitches, which = np.unique(pitch, return_inverse=True)  # many grids share few pitches
        told = np.exp(-2j * np.pi * MIDDLES / pitches[:, None]) @ self.turns
        return np.real(np.exp(2j * np.pi * first / pitch) * told[which])

    def ends(self, first: Float[np.ndarray, " c"], last: Float[np.ndarray, " c"]) -> Float[np.ndarray, " c"]:
        """Mean log-likelihood, over the film, of what the network says if grids reach from first to last."""
        inside = np.log(np.clip(self.in_grid, LEAST_CHANCE, 1 - LEAST_CHANCE))
        outside = np.log(np.clip(1 - self.in_grid, LEAST_CHANCE, 1 - LEAST_CHANCE))
        gain = np.concatenate([[0.0], np.cumsum(inside - outside)])
        gained = np.interp(last, _BORDERS, gain) - np.interp(first, _BORDERS, gain)
        return np.asarray((gained + outside.sum()) / len(inside))

    def pitch(self, longest: float, shortest: float) -> float:
        """The pitch that agrees best with the phases."""
        pitches, turns = _pitches(longest, shortest)
        return float(pitches[int(np.abs(turns @ self.turns).argmax())])

    def firsts(self, pitch: float, least: float, most: float) -> list[float]:
        """Where, between two bounds, cells of this pitch begin according to the phases."""
        turn = float(np.angle(np.exp(2j * np.pi * MIDDLES / pitch) @ np.conj(self.turns))) / (2 * math.pi)
        number = range(math.ceil(least / pitch - turn), math.floor(most / pitch - turn) + 1)
        return [pitch * (turn + k) for k in number]


@lru_cache(maxsize=2)
def _pitches(longest: float, shortest: float) -> tuple[Float[np.ndarray, " k"], Complex[np.ndarray, "k s"]]:
    """Pitches to try, and the conjugate turns of their cells at the steps of a film: the same for every film."""
    per_film = np.linspace(1 / longest, 1 / shortest, 400)
    return 1 / per_film, np.exp(-2j * np.pi * per_film[:, None] * MIDDLES)


_BORDERS = node_centres_1d(STEPS + 1)

__all__ = ["MIDDLES", "AxisPhases", "CellPhases", "PlacedPhases"]
