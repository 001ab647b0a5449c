"""Arithmetic on many 3-vectors at once, along the last axis.

It works component by component: two to ten times as fast as ``np.cross`` and sums over an axis of three. It is fastest
on arrays whose components lie apart in memory (``planar``); elementwise operations keep that layout.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def planar(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """The same vectors, each component contiguous in memory."""
    return np.moveaxis(np.ascontiguousarray(np.moveaxis(vectors, -1, 0)), 0, -1)


def turned(vectors: Float[np.ndarray, "*n 3"], rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "*n 3"]:
    """``rotation @ v`` for each vector, in its precision, planar."""
    parts = np.moveaxis(vectors, -1, 0)
    out = rotation.astype(vectors.dtype) @ parts.reshape(3, -1)
    return np.moveaxis(out.reshape(parts.shape), 0, -1)


def dot(a: Float[np.ndarray, "*#n 3"], b: Float[np.ndarray, "*#n 3"]) -> Float[np.ndarray, "..."]:
    """Dot products; shapes are broadcast."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def cross(a: Float[np.ndarray, "*#n 3"], b: Float[np.ndarray, "*#n 3"]) -> Float[np.ndarray, "... 3"]:
    """Cross products, planar; shapes are broadcast."""
    (ax, ay, az), (bx, by, bz) = ([v[..., k] for k in range(3)] for v in (a, b))
    out = np.empty((3, *np.broadcast_shapes(a.shape, b.shape)[:-1]), np.result_type(a, b))
    out[0], out[1], out[2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return np.moveaxis(out, 0, -1)


def unit(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """The vectors scaled to length 1; a null vector stays null."""
    return vectors / (np.sqrt(dot(vectors, vectors)) + vectors.dtype.type(1e-20))[..., None]
