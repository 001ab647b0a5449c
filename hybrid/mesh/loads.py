"""What acts on a film during a step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hybrid.mesh.contact import Body


@dataclass(frozen=True, eq=False)
class Loads:
    """What acts on the sheet during a step.

    force_n: (V, 3) N on each vertex. goal_mm: (V, 3) where goal springs pull to. goal_stiffness: (V,) N/mm, 0 for a
    free vertex, inf for a pin. rest_curvature: 1/mm along u and along v (a film kept rolled). bodies: what it touches.
    drag: (V,) N s/mm of air resistance to motion along ``drag_normal`` (V, 3).
    """

    force_n: Float[np.ndarray, "v 3"]
    goal_mm: Float[np.ndarray, "v 3"]
    goal_stiffness: Float[np.ndarray, " v"]
    rest_curvature: tuple[float, float] = (0.0, 0.0)
    bodies: Sequence[Body] = ()
    drag: Float[np.ndarray, " v"] | None = None
    drag_normal: Float[np.ndarray, "v 3"] | None = None
