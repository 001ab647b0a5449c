"""How unevenly a map shows what is printed evenly: the network's commonest large error, measured from the cells.

Where a sheet turns away from the camera, its slices look narrower. A map that underestimates this has all its edges
right and the inside wrong, by half a slice or more: too far for cells to be matched. The phases that the network
predicts in the cells (grid/phases.py) are wrong by only a fiftieth of a cell, wherever the map puts the cells. So, of
all smooth spacings of the cells along an axis, the one is chosen along which the phases run evenly at some pitch. Every
place is then moved to where its phase says that it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Complex, Float

from hybrid.backward import BackwardMap
from hybrid.coords import node_centres_1d
from hybrid.errors import require_at_least, require_at_most
from hybrid.rectify.grid.phases import MIDDLES, AxisPhases, CellPhases
from hybrid.rectify.splines.displacement import SplineConfig, fit_displacement
from hybrid.rectify.splines.sightings import Sightings, carried

Bend = tuple[float, float]
"""A spacing along one axis, a and b of ``t + t (1 - t) (a + b (1 - 2 t))``."""


@dataclass(frozen=True)
class ForeshorteningConfig:
    """Options of the spacing of the print."""

    most: Bend = (0.4, 0.24)
    """Largest a and b."""
    steps: Bend = (0.1, 0.12)
    """Their steps."""
    least_slope: float = 0.25
    """Least slope of a spacing: no cell is stretched to more than four times its width, and nothing folds."""
    doubt: float = 0.3
    """How much a bend of 1 must raise the agreement of the phases: the network seldom errs so far."""
    pitches: tuple[float, float, float] = (0.096, 1.05, 0.1)
    """Shortest and longest pitch, in film units, and the step of their inverse."""
    sigma: float = 0.08
    """Stated deviation of one phase, in cells."""
    least_length: float = 0.35
    """Phases shorter than this do not count."""
    most_off: float = 0.35
    """Phases further than this from the spacing do not count, in cells: beyond half a cell the next one is nearer."""
    edge_sigma: float = 0.0015
    """Stated deviation of the sheet's edges, in film units."""
    shared_sigma: tuple[float, float] = (0.02, 0.004)
    """Prior standard deviations of the grid's place and pitch, in film units."""
    spline: SplineConfig = field(default_factory=SplineConfig)

    def __post_init__(self) -> None:
        require_at_least(self, 0, "most")
        require_at_least(self, 1e-3, "steps", "pitches")
        require_at_least(self, 1e-6, "sigma", "edge_sigma", "shared_sigma")
        require_at_most(self, 1, "least_slope", "least_length")


@dataclass(frozen=True)
class Spacing:
    """Evenly spaced cells along an axis, which a map shows with a bend. first: where one of them begins."""

    bend: Bend
    first: float
    pitch: float


def even(
    film: BackwardMap, phases: CellPhases, edges: Sequence[Sightings], config: ForeshorteningConfig
) -> BackwardMap:
    """The map through which the phases run evenly; ``film`` itself where there are none, or where it would fold.

    edges: of the sheet, as far as they are seen, through ``film``; they are left in place.
    """
    told = phases.inside(film)
    if len(told) == 0:
        return film
    found = [spacing(along, config) for along in told.axes()]
    bends = (found[0].bend, found[1].bend)
    straight = unbent(film, bends)
    uv = np.stack([bent(told.uv[:, axis], bends[axis]) for axis in (0, 1)], axis=-1)
    seen = [_sightings(uv, told.turns[:, axis], found[axis], axis, config) for axis in (0, 1)]
    held = [replace(edge, sigma=np.full(len(edge), config.edge_sigma)) for edge in carried(edges, film, straight)]
    moved = fit_displacement([*held, *seen], config.spline).displacement.composed(straight)
    return film if moved.folds((17, 17)) else moved


def spacing(along: AxisPhases, config: ForeshorteningConfig) -> Spacing:
    """The spacing along which the phases run most evenly."""
    bends, frequencies, turns = _spacings(config)
    agreement = np.abs(turns @ along.turns.astype(np.complex64)).reshape(len(bends), len(frequencies))
    agreement -= config.doubt * np.array([np.hypot(a, np.sqrt(3.0) * b) for a, b in bends])[:, None]
    which, at = np.unravel_index(int(agreement.argmax()), agreement.shape)
    bend = bends[which]
    near = frequencies[at] + config.pitches[2] * np.linspace(-1.0, 1.0, 21)
    sums = np.exp(-2j * np.pi * near[:, None] * bent(MIDDLES, bend)) @ along.turns
    best = int(np.abs(sums).argmax())
    pitch = float(1.0 / near[best])
    return Spacing(bend, -pitch * float(np.angle(sums[best])) / (2 * np.pi), pitch)


def bent(t: Float[np.ndarray, "*n"], bend: Bend) -> Float[np.ndarray, "*n"]:
    """The true places of what is seen at ``t``; beyond the edges they stay as they are."""
    inside = np.clip(t, 0.0, 1.0)
    return t + inside * (1.0 - inside) * (bend[0] + bend[1] * (1.0 - 2.0 * inside))


def unbent(film: BackwardMap, bends: tuple[Bend, Bend]) -> BackwardMap:
    """The map through which places seen at ``t`` appear where they truly are, at ``bent(t)``, along both axes."""
    fine = node_centres_1d(401)
    v, u = (np.interp(node_centres_1d(33), bent(fine, bends[axis]), fine) for axis in (1, 0))
    return BackwardMap(film.photo_from_film(np.stack(np.meshgrid(u, v), axis=-1)))


def turned_away(film: BackwardMap, bends: Sequence[Bend]) -> list[BackwardMap]:
    """The maps by which one end of the sheet turns away from the camera more than ``film`` says: each of the four ends,
    by each of these bends along its axis."""
    straight = (0.0, 0.0)
    both = [(sign * a, b) for a, b in bends for sign in (-1, 1)]
    return [unbent(film, pair) for bend in both for pair in ((bend, straight), (straight, bend))]


# ---------------------------------------------------------------- steps


@lru_cache(maxsize=2)
def _spacings(config: ForeshorteningConfig) -> tuple[tuple[Bend, ...], np.ndarray, Complex[np.ndarray, "k s"]]:
    """All bends, frequencies, and the conjugate turns of their cells at the steps of a film."""
    t, (shortest, longest, step) = node_centres_1d(41), config.pitches
    i, j = (round(most / each) for most, each in zip(config.most, config.steps, strict=True))
    every = [(config.steps[0] * a, config.steps[1] * b) for a in range(-i, i + 1) for b in range(-j, j + 1)]
    bends = tuple(bend for bend in every if np.diff(bent(t, bend)).min() >= config.least_slope * (t[1] - t[0]))
    frequencies = np.arange(1.0 / longest, 1.0 / shortest, step)
    places = np.stack([bent(MIDDLES, bend) for bend in bends])
    turns = np.exp(-2j * np.pi * places[:, None] * frequencies[:, None]).astype(np.complex64)
    return bends, frequencies, turns.reshape(-1, len(MIDDLES))


def _sightings(
    uv: Float[np.ndarray, "n 2"],
    turns: Complex[np.ndarray, " n"],
    cells: Spacing,
    axis: int,
    config: ForeshorteningConfig,
) -> Sightings:
    """Each place seen at ``uv``, and where its phase puts it within the cell assumed for it."""
    cell = (uv[:, axis] - cells.first) / cells.pitch
    off = np.angle(turns * np.exp(-2j * np.pi * cell)) / (2 * np.pi)
    length = np.abs(turns)
    counts = (length > config.least_length) & (np.abs(off) < config.most_off)
    known = cells.first + cells.pitch * (cell + off)[counts]
    shared = np.column_stack([np.ones(len(known)), (known - 0.5) / cells.pitch])
    sigma = config.sigma * cells.pitch / length[counts]
    return Sightings(axis, uv[counts], known, sigma, shared, np.array(config.shared_sigma))


__all__ = ["Bend", "ForeshorteningConfig", "Spacing", "bent", "even", "spacing", "turned_away", "unbent"]
