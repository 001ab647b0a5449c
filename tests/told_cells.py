"""What a network that knows the cells would tell of a film, for tests."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres
from hybrid.rectify.grid.phases import CellPhases

Grid = tuple[tuple[float, float, int], tuple[float, float, int]]
"""Where the first cell begins, pitch and number of cells; across, then down."""


def even_grid(rows: int, cols: int, margin: float = 0.0) -> Grid:
    """So many cells on all of the film but a margin."""
    return (margin, (1 - 2 * margin) / cols, cols), (margin, (1 - 2 * margin) / rows, rows)


def told_of(
    true: BackwardMap, grid: Grid, rng: np.random.Generator, noise: float = 0.02, size: tuple[int, int] = (20, 20)
) -> CellPhases:
    """Phases at even film points, wrong by ``noise`` of a cell (one sigma); near their places, as a network is."""
    uv = film_centres(size).reshape(-1, 2)
    first, pitch, cells = (np.array([along[k] for along in grid]) for k in range(3))
    turns = np.exp(2j * np.pi * ((uv - first) / pitch + rng.normal(0, noise, uv.shape)))
    inside = ((uv >= first) & (uv <= first + pitch * cells)).all(axis=1)
    near = uv + rng.normal(0, 0.005, uv.shape)
    return CellPhases(true.photo_from_film(uv), near, turns, np.where(inside, 0.95, 0.05))


def bent_along(film: BackwardMap, along_u: tuple[float, float], along_v: tuple[float, float]) -> BackwardMap:
    """A film's map with its edges right and its inside moved along both axes by a quadratic and a cubic term."""

    def shown(uv: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        a, b = np.array([along_u, along_v]).T
        return film.photo_from_film(uv + uv * (1 - uv) * (a + b * (1 - 2 * uv)))

    return BackwardMap.from_function(shown, (33, 33))
