"""Round corners of a sheet of film, in film coordinates: many films leave the factory with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from hybrid.coords import FILM_CORNERS

_ARC, _SIDE = 17, 33


@dataclass(frozen=True)
class RoundCorners:
    """Radius of a sheet's corners, as a fraction of its width (u) and of its height (v); each in (0, 0.5]."""

    u: float
    v: float

    def cut(self, uv: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Which film points lie beyond the arcs; NaN points do not."""
        radius = np.array([self.u, self.v], uv.dtype)
        within = 1 - np.minimum(uv, 1 - uv) / radius  # from where the arc begins, in radii
        beyond = np.square(np.maximum(within, 0)).sum(axis=-1) > 1
        return np.asarray(beyond & (within.min(axis=-1) > 0))

    def turned(self, quarters: int) -> RoundCorners:
        """Those of the sheet after this many quarter turns."""
        return RoundCorners(self.v, self.u) if quarters % 2 else self

    def centres(self) -> Float[np.ndarray, "4 2"]:
        """Film points that are the centres of the arcs, in the order of FILM_CORNERS."""
        return np.abs(FILM_CORNERS - [self.u, self.v])

    def outline(self) -> Float[np.ndarray, "n 2"]:
        """Film points of the sheet's edge, once around from the top-left corner."""
        turns, begins = np.linspace(0, np.pi / 2, _ARC), np.pi * np.array([1, 1.5, 0, 0.5])
        arcs = [
            centre + np.stack([self.u * np.cos(turns + begin), self.v * np.sin(turns + begin)], axis=1)
            for centre, begin in zip(self.centres(), begins, strict=True)
        ]
        sides = [
            np.linspace(arc[-1], after[0], _SIDE)[1:-1] for arc, after in zip(arcs, arcs[1:] + arcs[:1], strict=True)
        ]
        return np.concatenate([part for pair in zip(arcs, sides, strict=True) for part in pair])


__all__ = ["RoundCorners"]
