"""The order of the slices on a flat film, and so which way it reads.

Films are filled row by row, and empty cells are left at the end. Anatomy changes little from slice to slice; in the
right order, successive cells are alike, even across the end of a row. A mirrored film, on which heads look like any
others, breaks that order, as does one turned by a quarter; one turned by a half keeps it, except for its empty cells.
Small pictures, in which writing can no longer be read, are enough.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float64, UInt8
from scipy.special import softmax

from hybrid.learn.networks.slicenet import cell_pictures, standardised
from hybrid.learn.networks.uprightnet import WAYS

PICTURE_PX = 16
"""Side of the pictures that are compared."""
LEAST_CELLS = 4
"""With fewer cells that show slices, the order tells nothing."""
EMPTY = 0.3
"""A cell is empty if its spread of greys is less than this fraction of the median cell's."""
REACH = 2.0
"""Distance in the order at which the weight of a pair of cells has fallen to 1/e."""
JITTER = 0.05
"""Added to the dissimilarity of two cells, as a fraction of the median of all pairs: some are the same slice twice."""
BY_LIKENESS, BY_EMPTY = 0.88, 2.0
"""Weights of both signs (``order_signs``), fitted like the next to films of 882 simulated photos of training scans."""
UNORDERED = 0.11
"""Share of films whose order tells nothing."""


def order_chances(film: UInt8[np.ndarray, "h w"], vertices: Float[np.ndarray, "r c 2"]) -> Float64[np.ndarray, " 8"]:
    """Probability, from the order of its slices alone, that a flat film (sRGB grey) has to be moved in each of WAYS to
    read right. vertices: film uv of the grid's corners."""
    shape = (vertices.shape[0] - 1, vertices.shape[1] - 1)
    signs = order_signs(cell_pictures(film, vertices, PICTURE_PX), shape)
    chances = softmax(signs @ [BY_LIKENESS, BY_EMPTY])
    return (1 - UNORDERED) * chances + UNORDERED / len(WAYS)


def order_signs(pictures: UInt8[np.ndarray, "n p p"], shape: tuple[int, int]) -> Float64[np.ndarray, "8 2"]:
    """Evidence for each way: how much more alike cells are that are near each other in its reading order; whether all
    empty cells, if some but not most are empty, come last in it. All 0 where too few cells have slices.

    pictures: of the cells of a grid of this shape (rows, columns), row by row as the film lies.
    """
    shown = standardised(pictures).reshape(len(pictures), -1)
    spread = pictures.reshape(len(pictures), -1).std(axis=1)
    filled: Bool[np.ndarray, " n"] = shown.any(axis=1) & (spread > EMPTY * np.median(spread))
    if filled.sum() < LEAST_CELLS:
        return np.zeros((len(WAYS), 2))
    shown = shown[filled] / np.linalg.norm(shown[filled], axis=1, keepdims=True)
    one, other = np.triu_indices(len(shown), 1)
    unlike = 1 - (shown @ shown.T)[one, other].astype(np.float64)
    near = -np.log(unlike / max(np.median(unlike), 1e-3) + JITTER)
    empty = len(filled) - len(shown)
    signs = []
    for way in WAYS:
        order = way.moved(np.arange(len(filled)).reshape(shape)).ravel()
        place = np.argsort(order)[filled]
        apart = np.abs(place[one] - place[other])
        last = 0 < empty <= len(filled) // 2 and not filled[order[-empty:]].any()
        signs.append((near @ np.exp(-apart / REACH), float(last)))
    return np.array(signs)


__all__ = ["order_chances", "order_signs"]
