"""The backward map: which photo point shows a film point, as a callable with an inverse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import factorial
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped
from scipy.interpolate import make_interp_spline

from hybrid.coords import film_centres_1d, film_nodes, node_centres_1d

MIN_NODES = 4
"""A cubic spline needs four nodes along each axis."""


@lru_cache(maxsize=8)
def _node_splines(n_nodes: int):
    """The cubic splines that are 1 at one node and 0 at the others, and their derivatives."""
    spline = make_interp_spline(node_centres_1d(n_nodes), np.eye(n_nodes), k=3)
    return spline, spline.derivative()


@lru_cache(maxsize=16)
def _lattice_weights(n_nodes: int, n: int) -> tuple[Float[np.ndarray, "n g"], Float[np.ndarray, "n g"]]:
    """Weights of the node values in the spline and in its derivative, at the nodes of a lattice of n along an axis."""
    spline, slope = _node_splines(n_nodes)
    return spline(node_centres_1d(n)), slope(node_centres_1d(n))


@lru_cache(maxsize=8)
def _piece_weights(n_nodes: int) -> Float[np.ndarray, "p g"]:
    """Weights of the node values in the polynomial coefficients of the spline's pieces, from node to node: those of the
    powers, from 0 to 3, of the position within a piece."""
    spline, _ = _node_splines(n_nodes)
    nodes, step = node_centres_1d(n_nodes), 1.0 / (n_nodes - 1)
    powers = [spline.derivative(k)(nodes[:-1]) * step**k / factorial(k) for k in range(3)]
    cubic = spline.derivative(3)(nodes[:-1] + 0.5 * step) * step**3 / 6.0  # the third derivative jumps at nodes
    return np.stack([*powers, cubic], axis=1).reshape(-1, n_nodes)


def spline_weights(n_nodes: int, t: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n g"]:
    """Weights of the g node values in the cubic spline through them, at film coordinates ``t`` of one axis; beyond
    [0, 1] it continues linearly, as BackwardMap does. Read-only: it is cached, as the same few ``t`` recur."""
    return _weights_at(n_nodes, np.asarray(t, dtype=np.float64).tobytes())


@lru_cache(maxsize=64)
def _weights_at(n_nodes: int, t: bytes) -> Float[np.ndarray, "n g"]:
    spline, slope = _node_splines(n_nodes)
    at = np.frombuffer(t)
    inside = np.clip(at, 0.0, 1.0)
    weights = spline(inside) + (at - inside)[:, None] * slope(inside)
    weights.setflags(write=False)
    return weights


def _points(values: Float[np.ndarray, "*n 2"], what: str) -> Float[np.ndarray, "*n 2"]:
    """The points as float64; ValueError if they are not points."""
    points = np.asarray(values, dtype=np.float64)
    if points.ndim == 0 or points.shape[-1] != 2:
        raise ValueError(f"{what}: got shape {points.shape}; allowed: (..., 2)")
    return points


def _cubic(coefficients: Float[np.ndarray, "*n 4"], at: Float[np.ndarray, "*#n"]) -> Float[np.ndarray, "*n"]:
    """Values of cubics, each given by the coefficients of the powers from 0 to 3."""
    constant, linear, square, cube = (coefficients[..., k] for k in range(4))
    return ((cube * at + square) * at + linear) * at + constant


def _cubic_slope(coefficients: Float[np.ndarray, "*n 4"], at: Float[np.ndarray, "*#n"]) -> Float[np.ndarray, "*n"]:
    """Their derivatives."""
    _, linear, square, cube = (coefficients[..., k] for k in range(4))
    return (3.0 * cube * at + 2.0 * square) * at + linear


def _newton_step(jacobian: Float[np.ndarray, "n 2 2"], error: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """How far film points must move for their photo points to move by ``error``; zero if the Jacobian is singular."""
    (a, b), (c, d) = (jacobian[:, k].T for k in (0, 1))
    det = a * d - b * c
    safe = np.where(np.abs(det) > 1e-9, det, np.inf)
    x, y = error.T
    return np.stack([d * x - b * y, a * y - c * x], axis=1) / safe[:, None]


@dataclass(frozen=True, eq=False)
class BackwardMap:
    """Photo point of every film point: a bicubic spline through nodes that lie on the film's edges.

    nodes: (gh, gw, 2) float64, photo points in pixels of the full-resolution photo; ``nodes[i, j]`` is the
        photo point of film point ``(j / (gw - 1), i / (gh - 1))``.
    """

    nodes: Float[np.ndarray, "gh gw 2"]

    def __post_init__(self) -> None:
        nodes = np.array(self.nodes, dtype=np.float64)
        if nodes.ndim != 3 or nodes.shape[2] != 2 or min(nodes.shape[:2]) < MIN_NODES:
            raise ValueError(f"BackwardMap.nodes: got shape {nodes.shape}; allowed: (gh, gw, 2), gh, gw >= {MIN_NODES}")
        if not np.isfinite(nodes).all():
            raise ValueError("BackwardMap.nodes: got NaN or infinity; allowed: finite photo points")
        nodes.setflags(write=False)
        object.__setattr__(self, "nodes", nodes)

    def __reduce__(self) -> tuple[Any, ...]:
        return BackwardMap, (self.nodes,)  # so that the nodes of a copy are read-only, too

    @staticmethod
    def from_function(
        photo_from_film: Callable[[np.ndarray], np.ndarray], size: tuple[int, int] = (33, 33)
    ) -> BackwardMap:
        """The map that agrees with ``photo_from_film`` ((N, 2) uv -> (N, 2) photo points) at all nodes."""
        uv = film_nodes(size)
        return BackwardMap(photo_from_film(uv.reshape(-1, 2)).reshape(*size, 2))

    @cached_property
    def _patches(self) -> Float[np.ndarray, "k 2 4 4"]:
        """Coefficients of x and y in each patch between four nodes, by powers of the position down and across it."""
        gh, gw = self.nodes.shape[:2]
        down = np.tensordot(_piece_weights(gh), self.nodes, axes=(1, 0))
        both = np.tensordot(down, _piece_weights(gw), axes=(1, 1)).reshape(gh - 1, 4, 2, gw - 1, 4)
        return both.transpose(0, 3, 2, 1, 4).reshape(-1, 2, 4, 4)

    def _columns_at(
        self, inside: Float[np.ndarray, "n 2"], slope: bool = False
    ) -> tuple[Float[np.ndarray, "n 2 4"], Float[np.ndarray, "n 1"], Float[np.ndarray, "n 2 4"] | None]:
        """At film points: the cubics by which x and y vary down the patch there, the position down it, and, with
        ``slope``, the derivatives of these cubics' coefficients across."""
        gh, gw = self.nodes.shape[:2]
        across, down = inside[:, 0] * (gw - 1), inside[:, 1] * (gh - 1)
        i, j = np.minimum(down.astype(np.intp), gh - 2), np.minimum(across.astype(np.intp), gw - 2)
        patches, at = self._patches[i * (gw - 1) + j], (across - j)[:, None, None]
        cubics = _cubic(patches, at)
        return cubics, (down - i)[:, None], (gw - 1) * _cubic_slope(patches, at) if slope else None

    def photo_from_film(self, uv: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Photo points of film points; outside [0, 1]^2 the map continues linearly from the nearest edge point."""
        inside = np.clip(_points(uv, "film points (u, v)"), 0.0, 1.0)
        cubics, down, _ = self._columns_at(inside.reshape(-1, 2))
        points = _cubic(cubics, down).reshape(inside.shape)
        beyond = np.asarray(uv, dtype=np.float64) - inside
        outside = np.any(beyond, axis=-1)
        if np.any(outside):
            points[outside] += np.einsum("...ij,...j->...i", self.jacobian(inside[outside]), beyond[outside])
        return points

    def jacobian(self, uv: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2 2"]:
        """d(x, y) / d(u, v) in pixels per film unit; its determinant is positive where nothing folds or mirrors."""
        inside = np.clip(_points(uv, "film points (u, v)"), 0.0, 1.0)
        cubics, down, slopes = self._columns_at(inside.reshape(-1, 2), slope=True)
        assert slopes is not None
        by_v = (self.nodes.shape[0] - 1) * _cubic_slope(cubics, down)
        return np.stack([_cubic(slopes, down), by_v], axis=-1).reshape(*inside.shape, 2)

    def film_from_photo(
        self, xy: Float[np.ndarray, "*n 2"], iterations: int = 12, tolerance_px: float = 1e-3
    ) -> Float[np.ndarray, "*n 2"]:
        """Film uv of photo points by Newton's method from the nearest node; NaN off the film.

        A point counts as on the film if a uv within [0, 1]^2 maps to within ``tolerance_px`` of it (with a tolerance of
        one part in a million for points on the edge).
        """
        from scipy.spatial import KDTree

        shape = np.shape(xy)
        target = _points(xy, "photo points (x, y)").reshape(-1, 2)
        uv_nodes = film_nodes(self.nodes.shape[:2]).reshape(-1, 2)
        finite = np.asarray(np.isfinite(target).all(axis=1))
        target = np.where(finite[:, None], target, 0.0)
        _, nearest = KDTree(self.nodes.reshape(-1, 2)).query(target)
        uv = uv_nodes[nearest]
        moving = np.arange(len(uv))
        for _ in range(iterations):
            at = uv[moving]
            step = _newton_step(self.jacobian(at), target[moving] - self.photo_from_film(at))
            uv[moving] = np.clip(at + np.clip(step, -0.2, 0.2), -0.5, 1.5)
            moving = moving[np.abs(uv[moving] - at).max(axis=1) > 1e-10]
            if not moving.size:
                break
        miss = np.linalg.norm(target - self.photo_from_film(uv), axis=1)
        on_sheet = ((uv >= -1e-6) & (uv <= 1 + 1e-6)).all(axis=1)
        on_film = np.asarray(finite & on_sheet & (miss <= tolerance_px))
        return np.where(on_film[:, None], uv, np.nan).reshape(shape)

    def film_near(
        self,
        xy: Float[np.ndarray, "n 2"],
        start: Float[np.ndarray, "n 2"],
        iterations: int = 2,
        most_step: float = np.inf,
    ) -> Float[np.ndarray, "n 2"]:
        """Film uv of photo points, beyond the edges too, by Newton's method from film points near them.

        Steps are at most ``most_step`` along each axis. Only ``film_from_photo`` says whether the film is there.
        """
        uv = start.copy()
        for _ in range(iterations):
            step = _newton_step(self.jacobian(uv), xy - self.photo_from_film(uv))
            uv += np.clip(step, -most_step, most_step)
        return uv

    def dense(self, size: tuple[int, int]) -> Float[np.ndarray, "h w 2"]:
        """Photo points (float32) of all pixel centres of a film image of ``size`` (height, width)."""
        gh, gw = self.nodes.shape[:2]
        weights_v, weights_u = (spline_weights(n, film_centres_1d(px)) for n, px in ((gh, size[0]), (gw, size[1])))
        columns = np.tensordot(weights_v, self.nodes, axes=(1, 0)).astype(np.float32)  # (h, gw, 2)
        across = weights_u.astype(np.float32).T
        return np.stack([columns[..., k] @ across for k in range(2)], axis=-1)

    def lattice(self, size: tuple[int, int]) -> Float[np.ndarray, "h w 2"]:
        """``photo_from_film(film_nodes(size))``, but quicker, as it interpolates along rows and columns in turn."""
        (down, _), (across, _) = (_lattice_weights(*n) for n in zip(self.nodes.shape[:2], size, strict=True))
        return np.stack([down @ self.nodes[..., k] @ across.T for k in range(2)], axis=-1)

    def resized(self, size: tuple[int, int]) -> BackwardMap:
        """The same map on another number of nodes (rows, columns)."""
        return self if size == self.nodes.shape[:2] else BackwardMap(self.lattice(size))

    def cropped(self, offset_xy: tuple[float, float], scale_xy: tuple[float, float] = (1.0, 1.0)) -> BackwardMap:
        """The map into a photo that was cropped at ``offset_xy`` and then scaled by ``scale_xy``."""
        return BackwardMap((self.nodes - np.asarray(offset_xy)) * np.asarray(scale_xy))

    def turned(self, way: Orientation) -> BackwardMap:
        """The map of the film after it was moved as ``way`` says."""
        return BackwardMap(way.moved(self.nodes))

    def outline(self) -> Float[np.ndarray, "n 2"]:
        """Photo points of the nodes along the sheet's edges, once around from its top-left corner."""
        nodes = self.nodes
        return np.concatenate([nodes[0, :-1], nodes[:-1, -1], nodes[-1, :0:-1], nodes[:0:-1, 0]])

    def mean_film_pixels(self) -> tuple[float, float]:
        """Mean height and width in photo pixels of the film: lengths of the lattice lines, averaged."""
        return self._mean_film_pixels

    @cached_property
    def _mean_film_pixels(self) -> tuple[float, float]:
        across = np.linalg.norm(np.diff(self.nodes, axis=1), axis=-1).sum(axis=1).mean()
        down = np.linalg.norm(np.diff(self.nodes, axis=0), axis=-1).sum(axis=0).mean()
        return float(down), float(across)

    def folds(self, size: tuple[int, int] = (65, 65)) -> bool:
        """True where the map turns over somewhere (the Jacobian's determinant changes sign or vanishes)."""
        (down, slope_v), (across, slope_u) = (
            _lattice_weights(*n) for n in zip(self.nodes.shape[:2], size, strict=True)
        )
        x, y = np.moveaxis(self.nodes, -1, 0)
        det = (down @ x @ slope_u.T) * (slope_v @ y @ across.T) - (slope_v @ x @ across.T) * (down @ y @ slope_u.T)
        return not (np.all(det > 0) or np.all(det < 0))


@dataclass(frozen=True)
class Orientation:
    """How a film that is seen in a photo must be moved to read right: mirrored left to right first, then turned.

    turns: quarter turns clockwise, 0 to 3. mirrored: the film is seen from behind. ``seen`` coordinates are film uv as
    if the film were read the way it appears in the photo.
    """

    turns: int
    mirrored: bool

    def __post_init__(self) -> None:
        if self.turns not in range(4):
            raise ValueError(f"Orientation.turns: got {self.turns}; allowed: 0 to 3")

    @property
    def index(self) -> int:
        """0 to 7: turns, plus 4 if mirrored."""
        return self.turns + 4 * self.mirrored

    @staticmethod
    def from_index(index: int) -> Orientation:
        """The orientation of an index from 0 to 7; ValueError for others."""
        if index not in range(8):
            raise ValueError(f"Index of an Orientation: got {index}; allowed: 0 to 7")
        return Orientation(index % 4, index >= 4)

    @property
    def inverse(self) -> Orientation:
        """The orientation that undoes it: ``seen = true.turned(way.inverse)``. A reflection undoes itself."""
        return self if self.mirrored else Orientation(-self.turns % 4, False)

    def moved(self, picture: Shaped[np.ndarray, "h w *c"]) -> Shaped[np.ndarray, "h2 w2 *c"]:
        """A picture (or nodes, or vertices) of a film, moved as the film is; a view if possible."""
        return np.rot90(picture[:, ::-1] if self.mirrored else picture, -self.turns)

    def film_from_seen(self, uv: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Film uv of coordinates of the film as seen."""
        return _from_middle(uv, self._film_from_seen)

    def seen_from_film(self, uv: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Coordinates of the film as seen, of film uv."""
        return _from_middle(uv, self._film_from_seen.T)

    @property
    def _film_from_seen(self) -> Float[np.ndarray, "2 2"]:
        """A rotation, after a reflection if mirrored; the film's centre stays fixed."""
        clockwise = np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), self.turns)
        return clockwise @ np.diag([-1.0 if self.mirrored else 1.0, 1.0])


def _from_middle(uv: np.ndarray, matrix: Float[np.ndarray, "2 2"]) -> np.ndarray:
    """Film coordinates moved by a linear map about the film's middle; keeps the dtype of floats."""
    uv = np.asarray(uv, np.result_type(uv, np.float32))
    middle = np.asarray(0.5, dtype=uv.dtype)
    return (uv - middle) @ matrix.T.astype(uv.dtype) + middle


def orientation(backward: BackwardMap) -> Orientation:
    """How the film lies in the photo: mirrored or not, and which way its top points, to the nearest quarter turn."""
    nodes = backward.nodes
    return orientation_of((nodes[:, -1] - nodes[:, 0]).mean(axis=0), (nodes[-1] - nodes[0]).mean(axis=0))


def orientation_of(across: Float[np.ndarray, "2"], down: Float[np.ndarray, "2"]) -> Orientation:
    """The orientation of a film whose u and v directions are seen as ``across`` and ``down`` (x, y)."""
    mirrored = bool(across[0] * down[1] - across[1] * down[0] < 0)
    if mirrored:
        across, down = across * [-1, 1], down * [-1, 1]  # as in the photo mirrored left to right
    # Both directions vote for the angle: across turned by a quarter is down.
    side = across / np.hypot(*across) + np.array([down[1], -down[0]]) / np.hypot(*down)
    clockwise = np.arctan2(side[1], side[0])
    return Orientation(int(np.rint(-2 * clockwise / np.pi)) % 4, mirrored)


def film_as_seen(backward: BackwardMap) -> BackwardMap:
    """The map of the film as it lies in the photo: not mirrored, and its top is the side nearest to the photo's top.

    ``orientation(backward)`` turns it into the true map.
    """
    return backward.turned(orientation(backward).inverse)


def end_point_error(predicted: BackwardMap, true_points: Float[np.ndarray, "h w 2"]) -> Float[np.ndarray, "h w"]:
    """Distance in photo pixels between predicted and true photo points of a film lattice, edges included."""
    return np.linalg.norm(predicted.lattice(true_points.shape[:2]) - true_points, axis=-1)


def mean_move(before: BackwardMap, after: BackwardMap) -> float:
    """Mean distance between two maps of a film, as a fraction of the first one's longer side."""
    return float(end_point_error(after, before.nodes).mean()) / max(before.mean_film_pixels())


__all__ = [
    "BackwardMap",
    "Orientation",
    "end_point_error",
    "film_as_seen",
    "mean_move",
    "orientation",
    "orientation_of",
    "spline_weights",
]
