"""The film as a sheet that bends but does not stretch, before a camera: its shape and what the photo shows of it.

The surface in space is a cubic B-spline of film uv. The camera has a focal length and a first radial distortion, and
looks at the photo's centre. sheet/fit.py finds which sheet the photo shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres, film_nodes
from hybrid.errors import require_at_least, require_at_most
from hybrid.rectify.coarse.homography import fit_homography
from hybrid.rectify.splines.bspline import SortedDesign, axis_weights

FOCAL, ASPECT, LENS = range(3)
"""Unknowns besides the surface: logarithms of the focal length and of the ratio of sides, and the distortion."""
CAMERA = 3
"""Number of these unknowns."""


@dataclass(frozen=True)
class SheetConfig:
    """Options of the fit of a sheet to what is seen of it. Pixels are those of a photo of 1000."""

    intervals: int = 7
    """Knot intervals of the surface along each film axis."""
    steps: tuple[int, int, int] = (12, 8, 20)
    """Most Gauss-Newton steps to come near a map, to do so from a mirror image, and to fit what is seen."""
    settled: float = 2e-3
    """A step that lowers the cost by less than this part is the last."""
    settled_near: float = 2e-2
    """The same where a sheet only has to come near a map, or starts from one that is near."""

    every: tuple[int, int] = (4, 2)
    """Of the points of edges and lines, and of the cells' windows, only one in so many counts: they are correlated."""
    edge_px: float = 0.7
    """Standard deviation of an edge's place."""
    print_px: float = 0.5
    """Standard deviation of the place of what is printed, besides the one stated for it."""
    network_px: float = 12.0
    """Standard deviation of the network's map; its errors are smooth, so all nodes count as much as six."""
    strain: float = 1e-3
    """Standard deviation of the strain at 40 places: what the splines cannot follow; film itself strains far less."""
    stretched: float = 40.0
    """Cost of strain above which a sheet is taken to stretch and further strain costs ever less (sheet/problem.py)."""
    firm: float = 5e-4
    """Part of all cost of strain that counts even so: cloth stretches by a percent or two, and no sheet is rubber."""
    bending: float = 120.0
    """Weight of the mean squared second derivatives, in units of the film's height, for films that are hardly bent."""
    bent: float = 0.25
    """Cost from which on further bending costs less, however bent a film is: in parts of the cost of what is seen."""
    doubtful: float = 0.5
    """Cost per point seen from which on the sheet is also tried bent the other way round."""
    same_relief: float = 0.05
    """The mirrored sheet, once fitted, is the same again if no coefficient is off by this, in film heights."""
    reversed_gain: float = 0.75
    """The mirrored sheet counts if its cost is less than this part of the first one's."""
    focal: float = 1.1
    """Usual focal length of a phone, in sides of the photo: between that of main lenses and longer ones."""
    focal_sigma: tuple[float, float] = (0.1, 0.5)
    """Standard deviation of its logarithm: while only the network's map is known, and with what is seen."""
    main_lens: float = 0.6
    """Share of photos of flat films taken with a main lens (film/size.py); 0 where the focal length is given."""
    focal_range: tuple[float, float] = (0.65, 3.5)
    """Shortest and longest focal length of a phone."""
    beyond_sigma: float = 0.03
    """Standard deviation beyond these; small, as a lens that no phone has may explain what is seen a little better."""
    distortion: float = 0.02
    """Standard deviation of the first radial distortion."""
    square: float = 1e-3
    """Standard deviation of the logarithm of a cell's height over its width, where cells are taken to be square."""
    least_edges: int = 3
    """With fewer edges the sheet's shape is not determined."""

    def __post_init__(self) -> None:
        require_at_least(self, 0.1, "focal", "focal_range")
        require_at_least(self, 1e-3, "focal_sigma", "beyond_sigma", "distortion", "stretched", "bent")
        require_at_least(self, 1e-3, "edge_px", "print_px", "network_px")
        require_at_least(self, 1e-6, "strain", "square")
        require_at_least(self, 0, "firm", "steps", "main_lens")
        require_at_most(self, 1, "firm", "main_lens")
        require_at_least(self, 1, "every", "intervals")

    @property
    def near(self) -> SheetConfig:
        """The same options for a sheet that has only to come near a map, or starts from one that is near."""
        return replace(self, settled=self.settled_near)

    @property
    def blind(self) -> SheetConfig:
        """The same where only a map is known, which tells more about how a sheet is bent than that it hardly is."""
        return replace(self.near, network_px=1.0, bending=5.0)


@dataclass(frozen=True)
class Frame:
    """The photo's centre (x, y) and longer side in pixels: points count from the former, in units of the latter."""

    centre: tuple[float, float]
    side: float

    @staticmethod
    def of(size: tuple[int, int]) -> Frame:
        """The frame of a photo of size (height, width)."""
        return Frame((0.5 * size[1], 0.5 * size[0]), float(max(size)))

    def from_photo(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Photo points in the units of the frame."""
        return (points - np.array(self.centre)) / self.side

    def to_photo(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Photo points in pixels."""
        return points * self.side + np.array(self.centre)


@dataclass(frozen=True, eq=False)
class Sheet:
    """A bent sheet before a camera.

    control: (n, 3) B-spline coefficients in camera axes, in units of the film's height, depths from ``stand`` focal
    lengths on: so the focal length by itself changes the strength of the perspective, but hardly where things are seen.
    log_focal: of the focal length in sides of the photo. log_aspect: of the film's width over its height.
    distortion: first radial coefficient.
    """

    intervals: int
    stand: float
    control: Float[np.ndarray, "n 3"]
    log_focal: float
    log_aspect: float
    distortion: float

    def moved(self, step: Float[np.ndarray, " m"]) -> Sheet:
        """With a step of all unknowns added: all x of the coefficients, then all y and z, then the camera's."""
        n = self.control.size
        focal, aspect, distortion = step[n : n + CAMERA]
        return replace(
            self,
            control=self.control + step[:n].reshape(3, -1).T,
            log_focal=self.log_focal + float(np.clip(focal, -0.3, 0.3)),
            log_aspect=self.log_aspect + float(np.clip(aspect, -0.1, 0.1)),
            distortion=self.distortion + float(distortion),
        )

    @property
    def focal(self) -> float:
        """The focal length in sides of the photo."""
        return float(np.exp(self.log_focal))

    def nearest(self) -> float:
        """Least depth of the coefficients; no point of the sheet is nearer."""
        return float(self.control[:, 2].min() + self.stand * self.focal)

    def backward(self, frame: Frame) -> BackwardMap | None:
        """The map of the sheet; None if some point of it has no finite image."""
        nodes = film_nodes((33, 33))
        seen = project(self, surface(self, nodes.reshape(-1, 2))[0]).point
        return BackwardMap(frame.to_photo(seen).reshape(nodes.shape)) if np.isfinite(seen).all() else None


@dataclass(frozen=True, eq=False)
class Projection:
    """Photo points in the units of the frame, and their derivatives, each computed on first use.

    ahead: x and y of the points in space, over their depth. depth: of the points. square: of the length of ``ahead``.
    """

    sheet: Sheet
    ahead: Float[np.ndarray, "m 2"]
    depth: Float[np.ndarray, " m"]
    square: Float[np.ndarray, " m"]
    point: Float[np.ndarray, "m 2"]

    @cached_property
    def by_point(self) -> Float[np.ndarray, "m 2 3"]:
        """Derivatives of x and y by the point in space."""
        x, bent = self.ahead, 2.0 * self.sheet.distortion
        stretch = 1.0 + self.sheet.distortion * self.square
        by_point = (bent * x)[:, :, None] * np.column_stack([x, -self.square])[:, None, :]
        by_point[:, 0, 0] += stretch
        by_point[:, 1, 1] += stretch
        by_point[:, :, 2] -= stretch[:, None] * x
        by_point *= (self.sheet.focal / self.depth)[:, None, None]
        return by_point

    @property
    def by_focal(self) -> Float[np.ndarray, "m 2"]:
        """Derivatives of x and y by the logarithm of the focal length."""
        return self.point + self.sheet.stand * self.sheet.focal * self.by_point[:, :, 2]

    @property
    def by_lens(self) -> Float[np.ndarray, "m 2"]:
        """Derivatives of x and y by the distortion."""
        return self.sheet.focal * self.square[:, None] * self.ahead


def project(sheet: Sheet, point: Float[np.ndarray, "m 3"]) -> Projection:
    """What the camera shows of points in space, in the axes and units of ``Sheet.control``."""
    depth = point[:, 2] + sheet.stand * sheet.focal
    ahead = point[:, :2] / depth[:, None]
    square = inner(ahead, ahead)
    seen = sheet.focal * (1.0 + sheet.distortion * square)[:, None] * ahead
    return Projection(sheet, ahead, depth, square, seen)


def inner(a: Float[np.ndarray, "m k"], b: Float[np.ndarray, "m k"]) -> Float[np.ndarray, " m"]:
    """Inner product of each row of one matrix with the same row of the other."""
    return np.einsum("mk,mk->m", a, b)


# ---------------------------------------------------------------- the surface


def surface(sheet: Sheet, uv: Float[np.ndarray, "m 2"]) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 2"]]:
    """Points of a sheet and their derivatives by u and v: quicker than with the weights of all coefficients."""
    n = sheet.intervals
    across, across_slope = (axis_weights(uv[:, 0], n, k) for k in (0, 1))
    down, down_slope = (axis_weights(uv[:, 1], n, k) for k in (0, 1))
    control = sheet.control.reshape(n + 3, n + 3, 3).transpose(0, 2, 1).reshape(n + 3, -1)
    rows, row_slopes = ((weights @ control).reshape(len(uv), 3, n + 3) for weights in (down, down_slope))
    slopes_uv = [_along(across_slope, rows), _along(across, row_slopes)]
    return _along(across, rows), np.stack(slopes_uv, axis=-1)


def _along(weights: Float[np.ndarray, "m k"], rows: Float[np.ndarray, "m 3 k"]) -> Float[np.ndarray, "m 3"]:
    """For each point, the weighted sum of its row's coefficients."""
    return np.einsum("mk,mjk->mj", weights, rows)


@lru_cache(maxsize=4)
def slopes(intervals: int) -> tuple[SortedDesign, SortedDesign]:
    """Slopes along u and v on the lattice where strain is measured."""
    places = film_centres((2 * intervals - 2, 2 * intervals - 2)).reshape(-1, 2)
    return SortedDesign.of(places, intervals, 1, 0), SortedDesign.of(places, intervals, 0, 1)


NODES = (6, 6)
"""Rows and columns of the film points at which the sheet is held near the network's map."""


@lru_cache(maxsize=4)
def at_nodes(intervals: int) -> SortedDesign:
    """The surface at these points."""
    return SortedDesign.of(film_nodes(NODES).reshape(-1, 2), intervals)


@lru_cache(maxsize=4)
def _plane(intervals: int) -> Float[np.ndarray, "n 3"]:
    """Coefficients of the functions u, v and 1: those of a linear function are its values at the knots."""
    knots = np.arange(-1, intervals + 2) / intervals
    u, v = np.meshgrid(knots, knots)
    return np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1)


def nearest_homography(film: BackwardMap, frame: Frame) -> Float[np.ndarray, "3 3"]:
    """The homography from film points to the units of the frame that is nearest to a map."""
    uv = film_nodes((17, 17)).reshape(-1, 2)
    return fit_homography(uv, frame.from_photo(film.photo_from_film(uv)), np.ones(len(uv)))


def flat_sheet(coarse: BackwardMap, frame: Frame, intervals: int, focal: float) -> Sheet:
    """The flat sheet that roughly reproduces a map, from the homography between film and photo."""
    homography = nearest_homography(coarse, frame)
    pose = np.diag([1.0 / focal, 1.0 / focal, 1.0]) @ homography
    if pose[2] @ np.array([0.5, 0.5, 1.0]) < 0:
        pose = -pose
    pose = pose / np.linalg.norm(pose[:, 1])
    control = _plane(intervals) @ pose.T
    middle = float(pose[2] @ np.array([0.5, 0.5, 1.0]))
    control[:, 2] -= middle
    log_aspect = float(np.log(np.linalg.norm(pose[:, 0])))
    return Sheet(intervals, middle / focal, control, float(np.log(focal)), log_aspect, 0.0)


def relief_reversed(sheet: Sheet) -> Sheet:
    """The sheet mirrored at the plane nearest to it: bent towards the camera where it was bent away.

    From afar both look the same. They differ only by a little perspective, which another focal length can imitate.
    """
    plane = _plane(sheet.intervals)
    pose = np.linalg.lstsq(plane, sheet.control, rcond=None)[0]
    normal = np.cross(pose[0], pose[1])
    normal /= np.linalg.norm(normal)
    above = (sheet.control - plane @ pose) @ normal
    return replace(sheet, control=sheet.control - 2.0 * above[:, None] * normal)


__all__ = [
    "ASPECT",
    "CAMERA",
    "FOCAL",
    "LENS",
    "NODES",
    "Frame",
    "Projection",
    "Sheet",
    "SheetConfig",
    "at_nodes",
    "flat_sheet",
    "inner",
    "nearest_homography",
    "project",
    "relief_reversed",
    "slopes",
    "surface",
]
