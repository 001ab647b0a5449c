"""From the network's uv map to the backward map: one robust, smooth fit of photo points over film points.

Photo points are modelled as ``H(uv) + S(uv)``: a homography H (what a plane sheet would show) and a cubic B-spline S
with a bending penalty (how far the sheet is from a plane). Where no pixel shows film, S continues about linearly, so a
corner that is covered or outside the frame continues the plane that the rest of the sheet suggests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float

from hybrid.backward import MIN_NODES, BackwardMap
from hybrid.coords import film_nodes
from hybrid.errors import require_at_least
from hybrid.records import CoarseMaps
from hybrid.rectify.coarse.homography import apply_homography, fit_homography
from hybrid.rectify.splines import bspline
from hybrid.rectify.splines.bspline import NormalEquations
from hybrid.rectify.splines.tps import tukey_weights

ROBUST_INTERVALS = 4
"""Knot intervals of the stiff spline that tells good pixels from bad ones: false islands must not attract it."""
ROBUST_SMOOTHING = 1e-5
ROBUST_PIXELS = 400
"""About this many pixels are enough to fit that spline; all pixels are judged by it afterwards."""
ISLAND_SHARE = 0.1
"""A hand may cut the film in two, but a part below this share of the largest is a false alarm elsewhere."""
MAD_2D = 1.1774
"""Median of the length of a two-dimensional standard normal vector."""
COVERAGE_BINS = 12


@dataclass(frozen=True)
class InvertConfig:
    """How the uv map is turned into a backward map."""

    intervals: int = 8
    """Knot intervals of the spline along each film axis."""
    smoothing: float = 1e-7
    """Least weight of the bending energy relative to the mean squared residual, both in units of the film's size."""
    smoothing_per_variance: float = 0.3
    """Weight added per unit of variance of the residuals: a noisy map is smoothed more, a clean one hardly at all."""
    min_pixels: int = 60
    """Fewer pixels than this are no film."""
    nodes: tuple[int, int] = (33, 33)
    """Nodes (rows, columns) of the backward map; one more than a multiple of ``intervals`` represents S exactly."""
    scale_floor: float = 0.002
    """Residuals below this fraction of the film's size never count as bad."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "intervals", "min_pixels")
        require_at_least(self, MIN_NODES, "nodes")
        require_at_least(self, 0, "smoothing", "smoothing_per_variance")
        require_at_least(self, 1e-6, "scale_floor")


@dataclass(frozen=True, eq=False)
class Inversion:
    """A backward map, and how well the uv map supports it.

    residual_px: root mean square distance in photo pixels between the map and the pixels that it explains (robust).
    coverage: share of the film's area that such pixels show, in [0, 1].
    inlier_share: share of the film pixels that the map explains.
    """

    backward: BackwardMap
    residual_px: float
    coverage: float
    inlier_share: float

    def enlarged(self, factor: int) -> Inversion:
        """The same for the photo enlarged ``factor`` times."""
        backward = self.backward.cropped((0.0, 0.0), (float(factor), float(factor)))
        return replace(self, backward=backward, residual_px=self.residual_px * factor)


@dataclass(frozen=True)
class NotInverted:
    """Why a uv map gave no backward map."""

    reason: str


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Film pixels of a uv map. target: photo points, centred and in units of the film's rough size (n, 2)."""

    uv: Float[np.ndarray, "n 2"]
    target: Float[np.ndarray, "n 2"]
    weight: Float[np.ndarray, " n"]
    centre: Float[np.ndarray, " 2"]
    unit_px: float


def fit_backward(maps: CoarseMaps, config: InvertConfig | None = None) -> Inversion | NotInverted:
    """The smooth backward map that explains the film pixels of ``maps``, in spite of bad pixels and missing parts."""
    config = config or InvertConfig()
    pixels = _film_pixels(maps, config)
    if isinstance(pixels, NotInverted):
        return pixels
    tukey = _robust_weights(pixels, config)
    weight = pixels.weight * tukey
    if np.count_nonzero(weight > 0.05) < config.min_pixels // 2:
        return NotInverted("the film pixels do not agree on any smooth shape")
    homography = _plane_prior(pixels.uv, pixels.target, weight)
    plane = apply_homography(homography, pixels.uv)
    rows = bspline.design(pixels.uv, config.intervals)
    normal = NormalEquations.of(rows, weight, pixels.target - plane, config.intervals)
    error = pixels.target - plane - rows @ normal.solve(config.smoothing)
    variance = float(weight @ (error**2).sum(axis=1) / weight.sum() / 2.0)
    smooth = normal.solve(config.smoothing + config.smoothing_per_variance * variance)
    shape = apply_homography(homography, film_nodes(config.nodes).reshape(-1, 2)).reshape(*config.nodes, 2)
    shape = shape + bspline.on_lattice(smooth, config.nodes, config.intervals)
    inlier = tukey > 0.05
    error = _lengths(pixels.target - plane - rows @ smooth)
    return Inversion(
        backward=BackwardMap(shape * pixels.unit_px + pixels.centre),
        residual_px=float(np.sqrt(np.mean(error[inlier] ** 2)) * pixels.unit_px),
        coverage=coverage(pixels.uv[inlier]),
        inlier_share=float(inlier.mean()),
    )


def agreed(inversions: Sequence[Inversion | NotInverted]) -> Inversion | NotInverted:
    """The mean of the maps from several looks at one photo, with the last look's evidence.

    A look that gave no map is left out; if the last gave none, there is no mean either.
    """
    last = inversions[-1]
    if isinstance(last, NotInverted):
        return last
    nodes = [inversion.backward.nodes for inversion in inversions if isinstance(inversion, Inversion)]
    return replace(last, backward=BackwardMap(np.mean(nodes, axis=0)))


def change(before: Inversion, after: Inversion | NotInverted) -> float:
    """Mean distance between two maps, as a fraction of the film's size; infinite if there is no second map."""
    if isinstance(after, NotInverted):
        return float("inf")
    distance = np.linalg.norm(after.backward.nodes - before.backward.nodes, axis=-1).mean()
    return float(distance / np.mean(after.backward.mean_film_pixels()))


def coverage(uv: Float[np.ndarray, "n 2"], bins: int = COVERAGE_BINS) -> float:
    """Share of a ``bins`` x ``bins`` tiling of the film that holds at least one of the film points."""
    inside = uv[((uv > -0.02) & (uv < 1.02)).all(axis=1)]
    cell = np.clip((inside * bins).astype(np.int64), 0, bins - 1)
    return np.unique(cell[:, 1] * bins + cell[:, 0]).size / bins**2


def _film_pixels(maps: CoarseMaps, config: InvertConfig) -> _Pixels | NotInverted:
    """The pixels that probably show film, in normalised photo coordinates."""
    with np.errstate(invalid="ignore"):
        film: Bool[np.ndarray, "h w"] = maps.film & np.isfinite(maps.uv).all(axis=-1)
        film &= (np.abs(maps.uv) < 2.0).all(axis=-1)
    film = _largest_islands(film, ISLAND_SHARE)
    count = int(film.sum())
    if count < config.min_pixels:
        return NotInverted(f"{count} of {film.size} pixels show film; {config.min_pixels} are needed")
    uv = np.asarray(maps.uv[film], dtype=np.float64)
    points = np.asarray(maps.photo_points[film], dtype=np.float64)
    centre = np.median(points, axis=0)
    unit = float(np.sqrt(np.mean((points - centre) ** 2) * 12.0))  # the side of a square of this spread
    if unit <= 0 or np.ptp(uv, axis=0).min() < 0.05:
        return NotInverted("the film coordinates hardly vary over the pixels that show film")
    return _Pixels(uv, (points - centre) / unit, np.asarray(maps.mask[film], dtype=np.float64) ** 2, centre, unit)


def _robust_weights(pixels: _Pixels, config: InvertConfig) -> Float[np.ndarray, " n"]:
    """Tukey weights in [0, 1] of the pixels relative to a stiff spline, started from an absolute-deviation fit."""
    rows = bspline.design(pixels.uv, ROBUST_INTERVALS)
    some = slice(None, None, max(len(rows) // ROBUST_PIXELS, 1))
    part, target, weight = rows[some], pixels.target[some], pixels.weight[some]
    factor = np.ones(len(part))
    for step in range(5):
        fit = NormalEquations.of(part, weight * factor, target, ROBUST_INTERVALS).solve(ROBUST_SMOOTHING)
        distance = _lengths(target - part @ fit)
        scale = max(float(np.median(distance)) / MAD_2D, config.scale_floor)
        # Tukey alone would lock on to whatever the first, unrobust fit happened to favour
        factor = 1.0 / np.maximum(distance / scale, 1.0) if step < 2 else tukey_weights(distance / scale)
    return tukey_weights(_lengths(pixels.target - rows @ fit) / scale)


def _lengths(vectors: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Lengths of plane vectors."""
    return np.hypot(vectors[:, 0], vectors[:, 1])


def _largest_islands(film: Bool[np.ndarray, "h w"], least_share: float) -> Bool[np.ndarray, "h w"]:
    """The connected parts of a mask that are at least ``least_share`` of the largest one."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(film.astype(np.uint8), connectivity=4)
    if count <= 2:
        return film
    area = stats[1:, cv2.CC_STAT_AREA]
    return np.isin(labels, 1 + np.flatnonzero(area >= least_share * area.max()))


def _plane_prior(
    uv: Float[np.ndarray, "n 2"], target: Float[np.ndarray, "n 2"], weight: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "3 3"]:
    """The homography that fits the pixels best, or the best affine map if the homography diverges near the film."""
    homography = fit_homography(uv, target, weight)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.5]])
    depth = corners @ homography[2, :2] + homography[2, 2]
    if depth.min() * depth.max() > 0 and np.abs(depth).min() > 0.4 * np.abs(depth).max():
        return homography / homography[2, 2]
    ones, root = np.hstack([uv, np.ones((len(uv), 1))]), np.sqrt(weight)[:, None]
    affine = np.linalg.lstsq(ones * root, target * root, rcond=None)[0].T
    return np.vstack([affine, [0.0, 0.0, 1.0]])
