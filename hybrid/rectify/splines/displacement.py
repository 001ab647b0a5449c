"""The smooth displacement of the film plane that explains sightings.

The displacement d makes ``photo_from_film(uv + d(uv))`` right: at the true place of a sighting, d's component along its
axis is ``seen - known``. u and v are never coupled, so there are two small systems.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import eigvalsh, get_lapack_funcs

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.errors import require_at_least
from hybrid.rectify.splines.sightings import Sightings, group_noise
from hybrid.rectify.splines.tps import LatticeSpline, lattice_spline, mad_sigma, tukey_weights

(_POSV,) = get_lapack_funcs(("posv",), dtype=np.float64)
"""LAPACK's solver of positive definite systems."""
TEXT_SIGMA = 2e-4
"""Deviation up to which a group of sightings is text, in film units; beyond, it is anatomy."""


@dataclass(frozen=True)
class SplineConfig:
    """Options of the displacement spline."""

    lattice: tuple[int, int] = (9, 9)
    """Rows and columns of the lattice of kernels; finer than any error of a smooth coarse map."""
    prior_px: float = 40.0
    """Expected size of the coarse map's error, in pixels of a film 1000 pixels long: it constrains what nothing
    observes, and is wide, as edges tell more about the film's inside than the coarse map does."""
    stiffness: tuple[float, float, int] = (5e3, 5e5, 5)
    """Lowest and highest bending weight tried, and how many; the evidence selects. In 1 / (squared film units)."""
    reweightings: int = 5
    """Rounds of robust reweighting."""

    def __post_init__(self) -> None:
        require_at_least(self, 3, "lattice")
        require_at_least(self, 1e-3, "prior_px")
        require_at_least(self, 1e-9, "stiffness")


@dataclass(frozen=True, eq=False)
class Displacement:
    """A smooth displacement of the film plane, ``uv -> uv + d(uv)``: a thin-plate spline on a lattice.

    values: d at the lattice's nodes, in film units.
    """

    lattice: LatticeSpline
    values: Float[np.ndarray, "n 2"]

    @property
    def moves(self) -> bool:
        """Whether anything is displaced at all."""
        return bool(self.values.any())

    def __call__(self, uv: Float[np.ndarray, "*m 2"]) -> Float[np.ndarray, "*m 2"]:
        """Displaced film points; beyond the edges the displacement is that of the nearest edge point."""
        if not self.moves:
            return np.array(uv, dtype=np.float64)
        flat = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
        return (flat + self.lattice.evaluate(np.clip(flat, 0.0, 1.0), self.values)).reshape(np.shape(uv))

    def composed(self, coarse: BackwardMap, size: tuple[int, int] = (33, 33)) -> BackwardMap:
        """``coarse.photo_from_film(uv + d(uv))`` on nodes."""
        if not self.moves:
            return coarse.resized(size)
        at = film_nodes(size) + (_rows_at_nodes(self.lattice.size, size) @ self.values).reshape(*size, 2)
        return BackwardMap(coarse.photo_from_film(at))

    def lift(self, sightings: Sightings) -> Sightings:
        """Sightings made through the displaced map, as if they had been made through the coarse map."""
        return replace(sightings, seen=self(sightings.seen), along=sightings.places()[:, 1 - sightings.axis])


@lru_cache(maxsize=4)
def _rows_at_nodes(lattice: tuple[int, int], size: tuple[int, int]) -> Float[np.ndarray, "m n"]:
    """Weights of a spline's lattice values at the nodes of a map: cached, as the same few sizes recur."""
    return lattice_spline(lattice).rows(film_nodes(size).reshape(-1, 2))


def no_displacement(config: SplineConfig) -> Displacement:
    """The displacement that moves nothing."""
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


def lattice_rows(sightings: Sequence[Sightings], config: SplineConfig) -> list[Float[np.ndarray, "_ m"]]:
    """Weights of the node values in the displacement at the true places of each list's sightings."""
    places = np.concatenate([np.zeros((0, 2)), *(s.places() for s in sightings)])
    rows = lattice_spline(config.lattice).rows(np.clip(places, 0.0, 1.0))
    return np.split(rows, np.cumsum([len(s) for s in sightings])[:-1])


def fit_displacement(
    sightings: Sequence[Sightings], config: SplineConfig, rows: Sequence[Float[np.ndarray, "_ m"]] | None = None
) -> DisplacementFit:
    """The smooth displacement that explains the sightings (all made through the same map), outliers set aside.

    rows: ``lattice_rows`` of the sightings, if already known.
    """
    lattice = lattice_spline(config.lattice)
    rows = lattice_rows(sightings, config) if rows is None else rows
    values = np.zeros((len(lattice.nodes), 2))
    weights = [np.zeros(len(s)) for s in sightings]
    constants = [np.zeros(s.shared.shape[1]) for s in sightings]
    stiffness = [0.0, 0.0]
    for axis in (0, 1):
        chosen = [k for k, s in enumerate(sightings) if s.axis == axis and len(s)]
        if not chosen:
            continue
        system = _assemble([sightings[k] for k in chosen], lattice, [rows[k] for k in chosen])
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


@dataclass(frozen=True, eq=False)
class _System:
    """Linear observations ``rows @ unknowns = right +- sigma``; unknowns are node values, then shared constants.

    group: number of each row's group, counted from 0; -1 for rows of no group.
    """

    rows: Float[np.ndarray, "n m"]
    right: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]
    shared_sigma: Float[np.ndarray, " g"]
    group: Int[np.ndarray, " n"]
    lattice: LatticeSpline

    def precision(self, scaled: Float[np.ndarray, " n"], config: SplineConfig) -> Float[np.ndarray, "m m"]:
        """Precision matrix of the unknowns, from the observations with these precisions and from the priors."""
        whitened = self.rows * np.sqrt(scaled)[:, None]
        precision = whitened.T @ whitened  # only half of a matrix's product with itself is computed
        n, m = len(self.lattice.nodes), len(precision)
        precision.flat[:: m + 1] += np.append(np.full(n, _ridge(n, config)), 1.0 / self.shared_sigma**2)
        return precision

    def stiffened(self, precision: Float[np.ndarray, "m m"], stiffness: float) -> Float[np.ndarray, "m m"]:
        """The same with the prior on bending."""
        n, stiff = len(self.lattice.nodes), precision.copy()
        stiff[:n, :n] += stiffness * self.lattice.bending
        return stiff


def _ridge(n_nodes: int, config: SplineConfig) -> float:
    """Precision of one node value: all nodes together tell as much as the dozen or so independent values of a
    smooth field, hence the factor."""
    return 12.0 / n_nodes / (1e-3 * config.prior_px) ** 2


def _assemble(
    sightings: Sequence[Sightings], lattice: LatticeSpline, known: Sequence[Float[np.ndarray, "_ m"]]
) -> _System:
    """One row for each sighting. known: as from ``lattice_rows``."""
    n = len(lattice.nodes)
    total = sum(len(s) for s in sightings)
    rows = np.zeros((total, n + sum(s.shared.shape[1] for s in sightings)))
    np.concatenate(known, out=rows[:, :n])
    row, column, group = 0, n, np.full(total, -1)
    for s in sightings:
        if s.group is not None:
            group[row : row + len(s)] = np.unique(s.group, return_inverse=True)[1] + group.max() + 1
        rows[row : row + len(s), column : column + s.shared.shape[1]] = s.shared
        row, column = row + len(s), column + s.shared.shape[1]
    return _System(
        rows,
        np.concatenate([s.offsets() for s in sightings]),
        np.concatenate([s.sigma for s in sightings]),
        np.concatenate([s.shared_sigma for s in sightings]),
        group,
        lattice,
    )


def _solve_robust(system: _System, config: SplineConfig) -> tuple[np.ndarray, np.ndarray, float]:
    """Unknowns, weights and stiffness: by Tukey's biweight with a falling tolerance, and the stiffness by evidence.

    It starts as stiff as can be: only then does the noise of what differs from cell to cell show, and is not fitted.
    """
    candidates = _geometric(*config.stiffness)
    weights = np.ones(len(system.right))
    stiffness, near = candidates[-1], len(candidates) // 2
    noise = max(1.0, mad_sigma(system.right / system.sigma))
    solution = np.zeros(system.rows.shape[1])
    sigma = system.sigma
    for step in range(config.reweightings):
        scaled = weights / (noise * sigma) ** 2
        precision = system.precision(scaled, config)
        right = system.rows.T @ (scaled * system.right)
        if step % 2 == 1 and len(candidates) > 1:
            near, solution = _likeliest(system, precision, right, near, config)
            stiffness = candidates[near]
        else:
            solution, _ = _solve(system.stiffened(precision, stiffness), right)
        residual = system.rows @ solution - system.right
        sigma = group_noise(system.sigma, system.group, residual, TEXT_SIGMA)
        residual = residual / sigma
        noise = max(1.0, min(0.5 * noise, 1.5 * mad_sigma(residual)))
        weights = tukey_weights(residual / noise)
    return solution, weights, stiffness


def _likeliest(
    system: _System, precision: np.ndarray, right: np.ndarray, near: int, config: SplineConfig
) -> tuple[int, Float[np.ndarray, " m"]]:
    """Index of the stiffness candidate with most evidence, searched uphill from ``near``, and the unknowns with it."""
    solutions: dict[int, Float[np.ndarray, " m"]] = {}

    def evidence(number: int, stiffness: float) -> float:
        solutions[number], found = _log_evidence(system, precision, right, stiffness, config)
        return found

    candidates = [partial(evidence, k, stiffness) for k, stiffness in enumerate(_geometric(*config.stiffness))]
    near = highest_near(near, candidates)
    return near, solutions[near]


def highest_near(start: int, values: Sequence[Callable[[], float]]) -> int:
    """Index of a value that is higher than its neighbours, searched uphill from ``start``; only a few are computed."""
    value = cache(lambda k: values[k]())
    at, best = -1, start
    while at != best:
        at = best
        best = max(range(max(at - 1, 0), min(at + 2, len(values))), key=value)
    return best


@lru_cache(maxsize=4)
def _geometric(low: float, high: float, count: int) -> tuple[float, ...]:
    """Numbers from low to high in geometric progression."""
    return tuple(np.geomspace(low, high, count).tolist())


def _solve(matrix: Float[np.ndarray, "m m"], right: Float[np.ndarray, " m"]) -> tuple[Float[np.ndarray, " m"], float]:
    """Solution of a positive definite system, and the logarithm of its determinant.

    Calls LAPACK itself: SciPy's wrappers take longer than a system of a hundred unknowns. The matrix is overwritten.
    """
    factor, solution, info = _POSV(matrix.T, right, overwrite_a=True)  # transposed, it is in LAPACK's order
    if info != 0:
        raise np.linalg.LinAlgError("normal equations of the displacement are not positive definite")
    return solution, 2.0 * float(np.sum(np.log(np.diag(factor))))


@lru_cache(maxsize=4)
def _bending_eigenvalues(size: tuple[int, int]) -> np.ndarray:
    return np.maximum(eigvalsh(lattice_spline(size).bending), 0.0)


def _log_evidence(
    system: _System, precision: np.ndarray, right: np.ndarray, stiffness: float, config: SplineConfig
) -> tuple[Float[np.ndarray, " m"], float]:
    """The unknowns for a stiffness, and its log marginal likelihood up to a constant (the noise is stated, so this is
    not scale-free)."""
    solution, log_det = _solve(system.stiffened(precision, stiffness), right)
    ridge = _ridge(len(system.lattice.nodes), config)
    log_prior = np.sum(np.log(stiffness * _bending_eigenvalues(config.lattice) + ridge))
    return solution, float(0.5 * (log_prior - log_det + right @ solution))


__all__ = [
    "Displacement",
    "DisplacementFit",
    "SplineConfig",
    "fit_displacement",
    "highest_near",
    "lattice_rows",
    "no_displacement",
]
