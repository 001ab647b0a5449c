"""Homographies from the film to the photo: the maps of plane sheets."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.stages import Decision


def apply_homography(homography: Float[np.ndarray, "3 3"], uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Film points mapped by a homography to points (x, y)."""
    mapped = uv @ homography[:, :2].T + homography[:, 2]
    return mapped[:, :2] / mapped[:, 2:]


def fit_homography(
    uv: Float[np.ndarray, "n 2"], target: Float[np.ndarray, "n 2"], weight: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "3 3"]:
    """The homography from film points to ``target`` points of order one (direct linear transform, weighted)."""
    root = np.sqrt(weight / weight.sum())[:, None]
    ones = np.ones((len(uv), 1))
    point = np.hstack([uv, ones]) * root
    zero = np.zeros_like(point)
    rows = np.vstack(
        [np.hstack([point, zero, -target[:, :1] * point]), np.hstack([zero, point, -target[:, 1:] * point])]
    )
    return np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)


def survey_plane(backward: BackwardMap, max_off: float) -> tuple[Decision, BackwardMap]:
    """Whether a map is within ``max_off`` (parts of the film's size) of a plane sheet's, and the nearest such map."""
    nodes = backward.nodes.reshape(-1, 2)
    uv = film_nodes(backward.nodes.shape[:2]).reshape(-1, 2)
    centre, unit = nodes.mean(axis=0), float(nodes.std())
    homography = fit_homography(uv, (nodes - centre) / unit, np.ones(len(uv)))
    plane = apply_homography(homography, uv) * unit + centre
    off = float(np.linalg.norm(plane - nodes, axis=1).max()) / max(backward.mean_film_pixels())
    evidence = f"the sheet is within {off:.1%} of its size of a plane"
    return Decision(off <= max_off, evidence), BackwardMap(plane.reshape(backward.nodes.shape))
