"""FiReNet's recovery (PAPER.tex, "Recovery Details"): uv map and deformation map to a backward map.

This is the baseline's own, slow way: linear interpolation between scattered points on a Delaunay triangulation, the
nearest point outside their hull. The authors triangulate the same points once for x and once for y and build the
nearest neighbours twice as well; here both coordinates share one of each, which halves the time and gives the same
map. ``hybrid.rectify.coarse.invert`` is the project's way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import Delaunay, QhullError

from hybrid.coords import film_centres, film_nodes
from hybrid.errors import PhotoError, describe

MASK_LEVEL = 0.6
"""Value of the paper's background map, high on film, above which the published code takes a pixel for film."""

QUARTERS = 4
"""Steps along each edge between the points that the deformation map adds: a corner, three points, a corner."""


@dataclass(frozen=True, eq=False)
class ScatteredPoints:
    """Film points and where the photo shows them, in no order.

    film: uv. photo: in units of the photo's sides.
    """

    film: Float[np.ndarray, "n 2"]
    photo: Float[np.ndarray, "n 2"]


def points_of_uv(uv: Float[np.ndarray, "h w 2"], mask: Float[np.ndarray, "h w"]) -> ScatteredPoints:
    """Every film pixel of a uv map: what the paper calls C' and V'. mask: probability of film."""
    film: Bool[np.ndarray, "h w"] = mask > MASK_LEVEL
    height, width = film.shape
    # Pixel centres in units of the photo's sides are what film_centres gives for a film image of that size.
    return ScatteredPoints(np.asarray(uv[film], dtype=np.float64), film_centres((height, width))[film])


def points_of_deformation(deformation: Float[np.ndarray, "h w 2"]) -> ScatteredPoints:
    """The four corners and the three nodes nearest to the quarters of each edge: 16 film points on the outline."""
    nodes = film_nodes((deformation.shape[0], deformation.shape[1]))
    rows, cols = (np.linspace(0, n - 1, QUARTERS + 1).round().astype(int) for n in deformation.shape[:2])
    outline = np.ones((QUARTERS + 1, QUARTERS + 1), dtype=bool)
    outline[1:-1, 1:-1] = False
    film, moved = (values[np.ix_(rows, cols)][outline] for values in (nodes, deformation.astype(np.float64)))
    return ScatteredPoints(film, film + moved)


def joined(*parts: ScatteredPoints) -> ScatteredPoints:
    """All points of several sets."""
    return ScatteredPoints(np.concatenate([p.film for p in parts]), np.concatenate([p.photo for p in parts]))


def interpolated(points: ScatteredPoints, size: tuple[int, int]) -> Float[np.ndarray, "gh gw 2"]:
    """A backward map on ``size`` (rows, columns) nodes of the film, in units of the photo's sides.

    Raises:
        PhotoError: fewer than three film points, or all on one line.
    """
    try:
        triangulation = Delaunay(points.film)
    except (QhullError, ValueError) as error:
        raise PhotoError(
            describe(
                what="uv map",
                got=f"{len(points.film)} film points that span no area",
                allowed=">= 3 points not on a line",
                do="Show more of the film, or train the network longer.",
            )
        ) from error
    nodes = film_nodes(size)
    linear = LinearNDInterpolator(triangulation, points.photo)(nodes)
    nearest = NearestNDInterpolator(points.film, points.photo)(nodes)
    return np.where(np.isnan(linear), nearest, linear)
