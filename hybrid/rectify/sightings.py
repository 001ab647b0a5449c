"""One-sided observations of the film, and the smooth displacement that explains them.

A sighting says: the photo, looked at through the current map, shows at film point ``seen`` something whose
true film coordinate along one axis is ``known``. An edge or a rule says nothing about the other axis.
The displacement d makes ``photo_from_film(uv + d(uv))`` right: at the true place of a sighting, d's component
along its axis is ``seen - known``. u and v are never coupled, so that there are two small systems.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import cho_factor, cho_solve, eigvalsh

from hybrid.backward import BackwardMap
from hybrid.rectify.tps import MAD_TO_SIGMA, LatticeSpline, lattice_spline, tukey_weights

PRIOR_COUNT = 4.0
"""Residuals of a group that the stated deviations count as."""
LONE_FACTOR = 2.0
"""By how much stated deviations grow where a group is too small to show its spread."""


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
        text, which is alike everywhere, or anatomy, which is not. How alike is found from how well they agree.
    """

    axis: int
    seen: Float[np.ndarray, "n 2"]
    known: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]
    shared: Float[np.ndarray, "n g"]
    shared_sigma: Float[np.ndarray, " g"]
    group: Int[np.ndarray, " n"] | None = None

    def __len__(self) -> int:
        return len(self.known)

    def places(self) -> Float[np.ndarray, "n 2"]:
        """The film points as far as known: ``seen`` with the coordinate along the axis put right."""
        uv = self.seen.copy()
        uv[:, self.axis] = self.known
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
        )


@dataclass(frozen=True)
class SplineConfig:
    """Options of the displacement spline."""

    lattice: tuple[int, int] = (9, 9)
    """Rows and columns of the lattice of kernels; finer than any error of a smooth coarse map."""
    prior_px: float = 40.0
    """Expected size of the coarse map's error, in pixels of a film 1000 pixels long: holds what nothing observes, and
    is wide, as edges tell more of the film's inside than the coarse map does."""
    stiffness: tuple[float, float, int] = (5e3, 5e5, 5)
    """Lowest and highest bending weight tried, and how many; the evidence chooses. In 1 / (squared film units)."""
    reweightings: int = 5
    """Rounds of robust reweighting."""


@dataclass(frozen=True, eq=False)
class Displacement:
    """A smooth displacement of the film plane, ``uv -> uv + d(uv)``: a thin-plate spline on a lattice.

    values: d at the lattice's nodes, in film units.
    """

    lattice: LatticeSpline
    values: Float[np.ndarray, "n 2"]

    def __call__(self, uv: Float[np.ndarray, "*m 2"]) -> Float[np.ndarray, "*m 2"]:
        """Displaced film points; beyond the edges the displacement is that of the nearest edge point."""
        flat = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
        return (flat + self.lattice.rows(np.clip(flat, 0.0, 1.0)) @ self.values).reshape(np.shape(uv))

    def composed(self, coarse: BackwardMap, size: tuple[int, int] = (33, 33)) -> BackwardMap:
        """``coarse.photo_from_film(uv + d(uv))`` on nodes."""
        return BackwardMap.from_function(lambda uv: coarse.photo_from_film(self(uv)), size)

    def lift(self, sightings: Sightings) -> Sightings:
        """Sightings made through the displaced map, as if they had been made through the coarse map."""
        places = sightings.seen
        lifted = places.copy()
        lifted[:, sightings.axis] = self(places)[:, sightings.axis]
        return replace(sightings, seen=lifted)


def no_displacement(config: SplineConfig) -> Displacement:
    """The displacement that leaves all where it is."""
    lattice = lattice_spline(config.lattice)
    return Displacement(lattice, np.zeros((len(lattice.nodes), 2)))


@dataclass(frozen=True, eq=False)
class DisplacementFit:
    """A displacement, and how well it explains the sightings.

    weights: for each list of sightings, the robust weight of each in [0, 1].
    constants: for each list of sightings, the shared constants found.
    stiffness: bending weight that the evidence chose for u and for v; 0 where nothing was seen.
    """

    displacement: Displacement
    weights: tuple[Float[np.ndarray, " _"], ...]
    constants: tuple[Float[np.ndarray, " _"], ...]
    stiffness: tuple[float, float]


def fit_displacement(sightings: Sequence[Sightings], config: SplineConfig) -> DisplacementFit:
    """The smooth displacement that explains the sightings (all made through the same map), outliers set aside."""
    lattice = lattice_spline(config.lattice)
    values = np.zeros((len(lattice.nodes), 2))
    weights = [np.zeros(len(s)) for s in sightings]
    constants = [np.zeros(s.shared.shape[1]) for s in sightings]
    stiffness = [0.0, 0.0]
    for axis in (0, 1):
        chosen = [k for k, s in enumerate(sightings) if s.axis == axis and len(s)]
        if not chosen:
            continue
        system = _assemble([sightings[k] for k in chosen], lattice)
        solution, weight, stiffness[axis] = _solve_robust(system, config)
        values[:, axis] = solution[: len(values)]
        ends = np.cumsum([len(sightings[k]) for k in chosen])
        shared_ends = len(values) + np.cumsum([len(constants[k]) for k in chosen])
        for k, w, c in zip(
            chosen, np.split(weight, ends[:-1]), np.split(solution, [len(values), *shared_ends])[1:-1], strict=True
        ):
            weights[k], constants[k] = w, c
    return DisplacementFit(
        Displacement(lattice, values), tuple(weights), tuple(constants), (stiffness[0], stiffness[1])
    )


# ---------------------------------------------------------------- inside


@dataclass(frozen=True, eq=False)
class _System:
    """Linear observations ``rows @ unknowns = right +- sigma``; unknowns are node values, then shared constants."""

    rows: Float[np.ndarray, "n m"]
    right: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]
    shared_sigma: Float[np.ndarray, " g"]
    groups: tuple[Int[np.ndarray, " _"], ...]
    lattice: LatticeSpline

    def prior(self, stiffness: float, config: SplineConfig) -> Float[np.ndarray, "m m"]:
        """Precision of the unknowns before any observation."""
        n = len(self.lattice.nodes)
        prior = np.zeros((self.rows.shape[1],) * 2)
        prior[:n, :n] = stiffness * self.lattice.bending
        prior[range(n), range(n)] += _ridge(n, config)
        shared = range(n, self.rows.shape[1])
        prior[shared, shared] = 1.0 / self.shared_sigma**2
        return prior


def _ridge(n_nodes: int, config: SplineConfig) -> float:
    """Precision of one node value: all nodes together tell as much as the dozen or so independent values of a
    smooth field, hence the factor."""
    return 12.0 / n_nodes / (1e-3 * config.prior_px) ** 2


def _assemble(sightings: Sequence[Sightings], lattice: LatticeSpline) -> _System:
    """One row for each sighting."""
    n = len(lattice.nodes)
    total = sum(len(s) for s in sightings)
    rows = np.zeros((total, n + sum(s.shared.shape[1] for s in sightings)))
    rows[:, :n] = lattice.rows(np.clip(np.concatenate([s.places() for s in sightings]), 0.0, 1.0))
    row, column, groups = 0, n, []
    for s in sightings:
        if s.group is not None:
            groups += [row + np.flatnonzero(s.group == number) for number in np.unique(s.group)]
        rows[row : row + len(s), column : column + s.shared.shape[1]] = s.shared
        row, column = row + len(s), column + s.shared.shape[1]
    return _System(
        rows,
        np.concatenate([s.offsets() for s in sightings]),
        np.concatenate([s.sigma for s in sightings]),
        np.concatenate([s.shared_sigma for s in sightings]),
        tuple(groups),
        lattice,
    )


def _solve_robust(system: _System, config: SplineConfig) -> tuple[np.ndarray, np.ndarray, float]:
    """Unknowns, weights and stiffness: Tukey's biweight with a tolerance that falls, stiffness by evidence."""
    low, high, count = config.stiffness
    candidates = np.geomspace(low, high, count)
    weights = np.ones(len(system.right))
    stiffness = float(candidates[count // 2])
    noise = max(1.0, MAD_TO_SIGMA * float(np.median(np.abs(system.right) / system.sigma)))
    solution = np.zeros(system.rows.shape[1])
    sigma = system.sigma
    for step in range(config.reweightings):
        scaled = weights / (noise * sigma) ** 2
        data = (system.rows * scaled[:, None]).T @ system.rows
        right = system.rows.T @ (scaled * system.right)
        if step == 1 and count > 1:
            stiffness = max(candidates, key=lambda c: _log_evidence(system, data, right, float(c), config))
        solution = _solve(data + system.prior(float(stiffness), config), right)
        residual = system.rows @ solution - system.right
        if step >= 1 and system.groups:
            sigma = _group_noise(system, residual)
        residual = residual / sigma
        spread = MAD_TO_SIGMA * float(np.median(np.abs(residual)))
        noise = max(1.0, min(0.5 * noise, 1.5 * spread))
        weights = tukey_weights(residual / noise)
    return solution, weights, float(stiffness)


def _group_noise(system: _System, residual: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Stated deviations, with those of each group multiplied by what its sightings' agreement says.

    The spread of few residuals tells little: the stated deviations count as ``PRIOR_COUNT`` more of them.
    """
    sigma = system.sigma.copy()
    for rows in system.groups:
        spread = MAD_TO_SIGMA * float(np.median(np.abs(residual[rows] / system.sigma[rows])))
        variance = (len(rows) * spread**2 + PRIOR_COUNT) / (len(rows) + PRIOR_COUNT)
        sigma[rows] *= np.sqrt(variance) if len(rows) > 2 else LONE_FACTOR
    return sigma


def _solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    return cho_solve(cho_factor(matrix, check_finite=False), right, check_finite=False)


@lru_cache(maxsize=4)
def _bending_eigenvalues(size: tuple[int, int]) -> np.ndarray:
    return np.maximum(eigvalsh(lattice_spline(size).bending), 0.0)


def _log_evidence(
    system: _System, data: np.ndarray, right: np.ndarray, stiffness: float, config: SplineConfig
) -> float:
    """Log marginal likelihood of the stiffness, up to a constant (the noise is stated, so this is not scale-free)."""
    factor = cho_factor(data + system.prior(stiffness, config), lower=True, check_finite=False)
    log_det = 2.0 * np.sum(np.log(np.diag(factor[0])))
    ridge = _ridge(len(system.lattice.nodes), config)
    log_prior = np.sum(np.log(stiffness * _bending_eigenvalues(config.lattice) + ridge))
    return float(0.5 * (log_prior - log_det + right @ cho_solve(factor, right, check_finite=False)))


__all__ = [
    "Displacement",
    "DisplacementFit",
    "Sightings",
    "SplineConfig",
    "fit_displacement",
    "no_displacement",
]
