"""How unevenly a map shows what is printed evenly: the network's commonest large error, read off the print itself.

Where a sheet turns away from the camera, its slices look narrower. A map that knows too little of this has all its
edges right and the inside wrong, by half a slice or more: too far for cells to find each other. But a film's columns
of pixels look like those one cell on, wherever that is. So every column is compared with every other (a self-similarity
matrix, Foote 1999), and of all smooth ways to space the cells that keep the edges in place the one counts along which
columns a pitch apart are most alike. The same for rows. No cell needs to be found for this, and no line be seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, Int

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d, film_nodes, node_centres_1d
from hybrid.rectify.repeat import detail

Bend = tuple[float, float]
"""A spacing along one axis, a and b of ``t + t (1 - t) (a + b (1 - 2 t))``."""
EVEN: Bend = (0.0, 0.0)


@dataclass(frozen=True)
class ForeshorteningConfig:
    """Options of the search for the spacing of the print."""

    side_px: int = 400
    """Sides of the view of the film."""
    least_px: int = 100
    """Films are looked at from this shorter side on, in pixels: smaller ones show hardly more than their cells."""
    detail_px: tuple[float, float] = (2.0, 8.0)
    """Scales between which the print's detail lies, in pixels of the view."""
    smooth_px: int = 5
    """Columns over which their likeness is averaged."""
    least_levels: float = 1.0
    """Grey levels of detail below which a column is like no other."""
    pitches: tuple[float, float, int] = (0.095, 0.53, 48)
    """Shortest and longest pitch, in parts of the film, and how many are tried."""
    most: Bend = (0.6, 0.36)
    """Largest a and b."""
    steps: Bend = (0.1, 0.12)
    """Steps of a and b in the first look; each further one, around the best so far, halves them."""
    looks: int = 3
    places: int = 64
    """Places along the film at which columns are compared with those a pitch on."""
    least_slope: float = 0.25
    """Least slope of a spacing: no cell is drawn to more than four times its width, and nothing folds."""
    doubt: float = 0.3
    """By how much a bend of 1 must raise -log(1 - likeness): the network seldom errs so far."""
    least_gain: float = 0.08
    """By how much it must be raised beyond that."""
    least_likeness: float = 0.25
    """Likeness from which on a film repeats at all: noise comes to half of this."""
    least_move: float = 0.02
    """Cells must move by so much, in parts of the film (root mean square): less they find by themselves."""


def foreshortening(grey: Float[np.ndarray, "h w"], config: ForeshorteningConfig) -> tuple[Bend, Bend]:
    """How what is printed evenly is spaced in a view of the film, along u and along v; EVEN where nothing repeats.

    grey: view of [0, 1]^2, grey levels.
    """
    if min(grey.shape) < config.least_px:
        return EVEN, EVEN
    image = cv2.resize(grey, (config.side_px, config.side_px), interpolation=cv2.INTER_AREA)
    return _spacing(likeness(image, config), config), _spacing(likeness(image.T.copy(), config), config)


def likeness(image: Float[np.ndarray, "n n"], config: ForeshorteningConfig) -> Float[np.ndarray, "n n"]:
    """Correlation of the detail of every column with that of every other."""
    band = detail(image, *config.detail_px)
    product = band.T @ band
    strength = np.sqrt(np.diag(product))
    least = max(0.3 * float(strength.mean()), config.least_levels * np.sqrt(len(image)))
    strength = np.maximum(strength, least)  # empty columns are like nothing
    return cv2.blur(product / np.outer(strength, strength), (config.smooth_px, config.smooth_px))


def even(backward: BackwardMap, bends: tuple[Bend, Bend]) -> BackwardMap:
    """The map through which what this one shows with such spacings is even."""
    uv = film_nodes((max(33, backward.nodes.shape[0]), max(33, backward.nodes.shape[1])))
    at = [_spaced(uv[..., axis], *bends[axis]) for axis in (0, 1)]
    return BackwardMap(backward.photo_from_film(np.stack(at, axis=-1)))


# ---------------------------------------------------------------- steps


def _spacing(alike: Float[np.ndarray, "n n"], config: ForeshorteningConfig) -> Bend:
    """The spacing along which columns a pitch apart are most alike, at whichever pitch they are."""
    at, share, score, least = EVEN, 0.0, -np.inf, 0.0
    for look in range(config.looks):
        bends, curves = _first_look(config) if look == 0 else _further_look(at, look, config)
        shares = alike.ravel()[curves].mean(axis=-1).max(axis=1)
        scores = -np.log(1.0 - np.clip(shares, 0.0, 0.95))
        if look == 0:
            least = float(scores[bends.index(EVEN)]) + config.least_gain
        scores -= config.doubt * np.array([np.hypot(a, np.sqrt(3.0) * b) for a, b in bends])
        best = int(scores.argmax())
        at, share, score = bends[best], float(shares[best]), float(scores[best])
    sure = score >= least and share >= config.least_likeness and _move(at) >= config.least_move
    return at if sure else EVEN


def _spaced(t: np.ndarray, a: np.ndarray | float, b: np.ndarray | float) -> np.ndarray:
    """Where even points ``t`` are shown; arrays of points and of bends are broadcast."""
    return t + t * (1.0 - t) * (a + b * (1.0 - 2.0 * t))


def _move(bend: Bend) -> float:
    """Root mean square by which a spacing moves the film's points."""
    t = node_centres_1d(41)
    return float(np.sqrt(np.mean(np.square(_spaced(t, *bend) - t))))


@lru_cache(maxsize=2)
def _first_look(config: ForeshorteningConfig) -> tuple[tuple[Bend, ...], Int[np.ndarray, "b p m"]]:
    """The spacings of the first look, the same for every film, and their curves."""
    reach = [round(most / step) for most, step in zip(config.most, config.steps, strict=True)]
    bends = _allowed(EVEN, config.steps, reach, config)
    return bends, _curves(bends, config)


def _further_look(
    at: Bend, look: int, config: ForeshorteningConfig
) -> tuple[tuple[Bend, ...], Int[np.ndarray, "b p m"]]:
    """The spacings next to the best so far, and their curves."""
    a, b = (step * 0.5**look for step in config.steps)
    bends = _allowed(at, (a, b), [1, 1], config)
    return bends, _curves(bends, config)


def _allowed(at: Bend, steps: Bend, reach: list[int], config: ForeshorteningConfig) -> tuple[Bend, ...]:
    """A grid of spacings around one; those that are too steep are left out."""
    t = node_centres_1d(41)
    i, j = (np.arange(-n, n + 1) for n in reach)
    every = [(at[0] + steps[0] * x, at[1] + steps[1] * y) for x in i.tolist() for y in j.tolist()]
    return tuple(bend for bend in every if np.diff(_spaced(t, *bend)).min() >= config.least_slope * (t[1] - t[0]))


def _curves(bends: tuple[Bend, ...], config: ForeshorteningConfig) -> Int[np.ndarray, "b p m"]:
    """For each spacing and pitch, where in the matrix of likeness a column meets the one a pitch on."""
    n, (shortest, longest, number) = config.side_px, config.pitches
    pitch = np.geomspace(shortest, longest, number)[:, None]
    first = film_centres_1d(config.places) * (1.0 - pitch)
    a, b = np.array(bends).T[..., None, None]
    here, there = (np.clip((_spaced(t, a, b) * n).astype(np.int32), 0, n - 1) for t in (first, first + pitch))
    return here * n + there


__all__ = ["EVEN", "Bend", "ForeshorteningConfig", "even", "foreshortening", "likeness"]
