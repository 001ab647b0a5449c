"""Annotation maps of a bent film by ray casting (Open3D), and its exact backward map by projection."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from hybrid.backward import BackwardMap
from hybrid.coords import node_centres_1d, photo_from_opencv, pixel_centres, sample_bilinear
from hybrid.errors import SimulationError, describe
from hybrid.mesh.camera import Camera
from hybrid.mesh.film import FilmMesh, lattice_triangles
from hybrid.mesh.sparse import FOR_MAPS, FOR_PHOTOS, Blocks, Sparse, bumpy, crossed, enlarged, smooth_film
from hybrid.mesh.vectors import dot, turned
from hybrid.round_corners import RoundCorners

_MISS = 2**32 - 1
"""Open3D's primitive number of a ray that hits nothing."""

FACET_MM = 0.03
"""Facets of the ray-cast mesh stay within this distance of the smooth film: 0.08 px where a pixel is 0.4 mm."""

_FACET_VERTICES = (17, 193)
"""Fewest and most vertices along a side of the mesh that is cast: the upper limit cuts off sharp creases of soft
sheets."""

BACKWARD_NODES = (65, 65)
"""Nodes of a true backward map: its spline is then within 0.02 px of the film in a 256 px photo even along creases
(33 nodes: 0.15 px)."""

_RIM_RAYS = np.array([[9, 5], [7, 11], [13, 9], [5, 3], [3, 13], [1, 7], [11, 15], [15, 1]], np.float32) / 16
"""Points of a pixel at which rays are cast where the film's outline or a fold crosses it. No two share a row or a
column (eight rooks): vertical and horizontal edges, the usual ones, are resolved to an eighth of a pixel."""

_CENTRE = pixel_centres((1, 1))[0, 0].astype(np.float32)


@dataclass(frozen=True, eq=False)
class AnnotationMaps:
    """What each pixel of a photo sees; NaN where ``mask`` is False.

    uv: film coordinates. xyz: mm, camera axes. normal: unit, camera axes, towards the side that reads right.
    """

    mask: Bool[np.ndarray, "h w"]
    uv: Float[np.ndarray, "h w 2"]
    xyz: Float[np.ndarray, "h w 3"]
    normal: Float[np.ndarray, "h w 3"]

    @property
    def depth(self) -> Float[np.ndarray, "h w"]:
        """Distance along the camera's axis, mm."""
        return self.xyz[..., 2]


@dataclass(frozen=True, eq=False)
class PixelView:
    """Which film points the pixels of a photo see: one each where the film is smooth, many where it ends or folds.

    box: rows and columns of the photo outside which there is no film; all other fields describe that part only.
    coverage: (h, w) share of each pixel that film covers. uv: (h, w, 2) film point at each pixel's centre, 0 if none.
    rim: (m,) numbers, row by row, of the pixels through which an outline or a fold runs.
    rim_uv, rim_hit: (m, k, 2), (m, k) what k rays spread evenly over each of those pixels meet.
    rays: number of rays cast.
    """

    box: tuple[slice, slice]
    coverage: Float32[np.ndarray, "h w"]
    uv: Float32[np.ndarray, "h w 2"]
    rim: Int[np.ndarray, " m"]
    rim_uv: Float32[np.ndarray, "m k 2"]
    rim_hit: Bool[np.ndarray, "m k"]
    rays: int


class FilmCaster:
    """A bent film ready for ray casting: built once, then cast from any camera at any resolution.

    Cut-off corners show no film further back; only a rolled-up sheet would have any there.
    """

    def __init__(self, film: FilmMesh, facet_mm: float = FACET_MM, corners: RoundCorners | None = None) -> None:
        import open3d as o3d

        self.film, self.corners = film, corners
        self.shape = facet_shape(film, facet_mm)
        self._v, self._u = (node_centres_1d(n) for n in self.shape)
        self._points = film.surface(self._u, self._v)
        self.scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        triangles = lattice_triangles(*self.shape).astype(np.uint32)
        self.scene.add_triangles(_tensor(self._points.reshape(-1, 3).astype(np.float32)), _tensor(triangles))

    @cached_property
    def _normals(self) -> Float32[np.ndarray, "nv nu 3"]:
        """Unit normals of the smooth film at the vertices, world axes."""
        return self.film.normals(self._u, self._v).astype(np.float32)

    def uv_map(self, camera: Camera) -> tuple[Bool[np.ndarray, "h w"], Float[np.ndarray, "h w 2"]]:
        """Mask and film uv (NaN where the mask is False) of each pixel of the camera's photo, one ray for each."""
        mask = np.zeros(camera.size, dtype=bool)
        uv = np.full((*camera.size, 2), np.nan, dtype=np.float32)
        box = self._bounding_box(camera)
        mask[box], uv[box], _ = self._cast(camera, _cropped(camera, box).pixel_rays())
        return mask, uv

    def annotate(self, camera: Camera) -> AnnotationMaps:
        """All maps (float32) of the camera's photo, at the pixels' centres.

        Near the outline, folds and sharp bends each pixel has its own ray; elsewhere one ray serves four pixels, by
        interpolation.
        """
        mask = np.zeros(camera.size, dtype=bool)
        uv, xyz, normal = (np.full((*camera.size, k), np.nan, dtype=np.float32) for k in (2, 3, 3))
        projected = self._projected(camera)
        if projected is None:
            box = slice(0, camera.size[0]), slice(0, camera.size[1])
            rays = camera.ray_directions(_centres(camera.size))
            mask[box], film, depth = self._cast(camera, rays)
        else:
            box = _box(projected, camera.size)
            part = _cropped(camera, box)
            blocks = self._blocks(part, FOR_MAPS)
            mask[box], film, wanted = smooth_film(blocks, self._rim(projected, box), part.size, FOR_MAPS)
            wanted |= bumpy(blocks, float(part.intrinsics[0, 0]), part.size, FOR_MAPS)
            rays, depth = (enlarged(values, part.size, FOR_MAPS) for values in (blocks.rays, blocks.depth))
            self._fill(part, wanted, mask[box], film, depth)
        rays *= depth[..., None]
        uv[box], xyz[box], normal[box] = film, rays, self._normals_at(film, camera)
        return AnnotationMaps(mask, uv, xyz, normal)

    def view(self, camera: Camera, maps: AnnotationMaps | None = None) -> PixelView:
        """Film points of a photo's pixels with as few rays as possible; ``maps`` of the same camera save most of them.

        The outline and the places where the film turns over are edges of the mesh: projected and drawn, they mark the
        rim, the pixels in which rays are cast densely (so no sliver of film between rays is lost).

        Raises:
            SimulationError: film beside or behind the camera, where it has no projection.
        """
        projected = self._projected(camera)
        if projected is None:
            raise SimulationError(
                describe(what="view of a film", got="film behind the camera", allowed="z > 1 mm", do="Move the camera.")
            )
        box = _box(projected, camera.size)
        part, rim = _cropped(camera, box), self._rim(projected, box)
        rays = 0
        if maps is None:
            blocks = self._blocks(part, FOR_PHOTOS)
            mask, uv, wanted = smooth_film(blocks, rim, part.size, FOR_PHOTOS)
            wanted &= ~rim
            self._fill(part, wanted, mask, uv)
            rays = blocks.hit.size + int(np.count_nonzero(wanted))
        else:
            mask, uv = maps.mask[box], maps.uv[box].copy()
        cv2.patchNaNs(uv, 0.0)

        at = np.flatnonzero(rim)
        rim_hit, rim_uv, _ = self._cast(camera, part.ray_directions(_corners(at, part.size)[:, None] + _RIM_RAYS))
        cv2.patchNaNs(rim_uv, 0.0)
        coverage = mask.astype(np.float32)
        coverage.reshape(-1)[at] = np.count_nonzero(rim_hit, axis=1) / np.float32(len(_RIM_RAYS))
        return PixelView(box, coverage, uv, at, rim_uv, rim_hit, rays + rim_hit.size)

    def _rim(self, projected: Float[np.ndarray, "nv nu 2"], box: tuple[slice, slice]) -> Bool[np.ndarray, "h w"]:
        """Pixels of a part of the photo through which the outline or a fold runs."""
        rows, cols = box
        size, origin = (rows.stop - rows.start, cols.stop - cols.start), [cols.start, rows.start]
        lines = _outline_and_folds(projected - origin)
        if self.corners is not None:
            edge = self.corners.outline()
            lattice = np.ascontiguousarray(projected, np.float32)
            at = photo_from_opencv(edge[None] * (np.array(self.shape[::-1]) - 1))  # vertices are at whole numbers
            lines.append(sample_bilinear(lattice, at.astype(np.float32))[0].astype(float) - origin)
        return crossed(lines, size)

    def _blocks(self, part: Camera, sparse: Sparse) -> Blocks:
        """What rays through the centres of blocks of pixels meet."""
        step, (rows, cols) = sparse.spacing, sparse.blocks(part.size)
        blocks = part.cropped((-step, -step), (rows * step, cols * step)).resized((rows, cols))
        rays = blocks.ray_directions(_centres(blocks.size))
        return Blocks(rays, *self._cast(blocks, rays))

    def _fill(
        self,
        part: Camera,
        wanted: Bool[np.ndarray, "h w"],
        mask: Bool[np.ndarray, "h w"],
        uv: Float32[np.ndarray, "h w 2"],
        depth: Float32[np.ndarray, "h w"] | None = None,
    ) -> None:
        """Cast rays through the centres of the wanted pixels and fill in what they see."""
        at = np.flatnonzero(wanted)
        hit, film, far = self._cast(part, part.ray_directions(_corners(at, part.size) + _CENTRE))
        mask[wanted], uv.reshape(-1, 2)[at] = hit, film
        if depth is not None:
            depth.reshape(-1)[at] = far

    def _cast(
        self, camera: Camera, directions: Float[np.ndarray, "*n 3"]
    ) -> tuple[Bool[np.ndarray, "*n"], Float32[np.ndarray, "*n 2"], Float32[np.ndarray, "*n"]]:
        """Whether rays (camera axes, z = 1) meet film, its uv there and the depth in mm; both NaN where they do not."""
        rays = np.empty((*directions.shape[:-1], 6), dtype=np.float32)
        rays[..., :3] = camera.centre_world
        np.matmul(directions.astype(np.float32), camera.camera_from_world[:3, :3].astype(np.float32), out=rays[..., 3:])
        answer = self.scene.cast_rays(_tensor(rays))
        primitive, depth = answer["primitive_ids"].numpy(), answer["t_hit"].numpy().copy()
        uv = self._film_points(primitive, answer["primitive_uvs"].numpy())
        hit = primitive != _MISS
        if self.corners is not None:
            hit &= ~self.corners.cut(uv)
        missed = ~hit
        uv[missed] = depth[missed] = np.nan
        return hit, uv, depth

    def _film_points(self, primitive: np.ndarray, bary: np.ndarray) -> Float32[np.ndarray, "*n 2"]:
        """Film uv of hits from the order of ``lattice_triangles``: the cells' upper triangles, then the lower ones.

        Upper corners: (row, col), one down, one to the right; lower: one to the right, one down, both.
        """
        rows, cols = self.shape[0] - 1, self.shape[1] - 1
        upper = primitive < rows * cols
        cell = np.where(upper, primitive, primitive - rows * cols).astype(np.int32)
        row, col = np.divmod(cell, cols)
        a, b = bary[..., 0], bary[..., 1]
        lattice = np.empty((*primitive.shape, 2), np.float32)
        lattice[..., 0] = col + np.where(upper, b, 1 - a)
        lattice[..., 1] = row + np.where(upper, a, a + b)
        lattice /= np.array([cols, rows], np.float32)
        return lattice

    def _normals_at(self, uv: Float32[np.ndarray, "h w 2"], camera: Camera) -> Float32[np.ndarray, "h w 3"]:
        """Unit normals in the camera's axes, bilinear between the vertices of the fine lattice; NaN where ``uv`` is."""
        last = np.array([self.shape[1] - 1, self.shape[0] - 1], np.float32)  # vertices are at whole numbers
        place = cv2.patchNaNs(uv.copy(), 0.0) * last
        lattice = np.ascontiguousarray(turned(self._normals, camera.camera_from_world[:3, :3]))
        mixed = sample_bilinear(lattice, photo_from_opencv(place))
        length = np.sqrt(dot(mixed, mixed))
        length[np.isnan(uv[..., 0])] = np.nan
        mixed /= length[..., None]
        return mixed

    def _projected(self, camera: Camera) -> Float[np.ndarray, "nv nu 2"] | None:
        """Photo points of the vertices; None where some are beside or behind the camera."""
        points = camera.camera_points(self._points)
        return camera.photo_from_camera(points) if points[..., 2].min() > 1.0 else None

    def _bounding_box(self, camera: Camera) -> tuple[slice, slice]:
        """Rows and columns of the photo in which the film is seen; all of them if part of it is beside the camera."""
        projected = self._projected(camera)
        if projected is None:
            return slice(0, camera.size[0]), slice(0, camera.size[1])
        return _box(projected, camera.size)


def facet_shape(film: FilmMesh, facet_mm: float) -> tuple[int, int]:
    """Vertices down and across of the coarsest lattice whose facets keep within ``facet_mm`` of the smooth film.

    Linear interpolation over a cell is off by at most (|S_uu| a^2 + 2 |S_uv| a b + |S_vv| b^2) / 8, where a and b are
    its sides; each direction gets half of the bound.
    """
    n = 33
    t = node_centres_1d(n)
    s = film.surface(t, t)
    uu = np.linalg.norm(np.diff(s, 2, axis=1), axis=-1).max()
    vv = np.linalg.norm(np.diff(s, 2, axis=0), axis=-1).max()
    uv = np.linalg.norm(np.diff(np.diff(s, axis=0), axis=1), axis=-1).max()
    least, most = _FACET_VERTICES
    across, down = ((n - 1) * np.sqrt((bend + uv) / (4 * facet_mm)) for bend in (uu, vv))
    return int(np.clip(np.ceil(down) + 1, least, most)), int(np.clip(np.ceil(across) + 1, least, most))


def _cropped(camera: Camera, box: tuple[slice, slice]) -> Camera:
    rows, cols = box
    return camera.cropped((cols.start, rows.start), (rows.stop - rows.start, cols.stop - cols.start))


def _box(projected: Float[np.ndarray, "nv nu 2"], size: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of the pixels that points fall on, at least one of each."""
    (h, w), points = size, projected.reshape(-1, 2)
    left, top = np.clip(np.floor(points.min(axis=0)).astype(int), 0, [w - 1, h - 1]).tolist()
    right, bottom = np.clip(np.ceil(points.max(axis=0)).astype(int), [left + 1, top + 1], [w, h]).tolist()
    return slice(top, bottom), slice(left, right)


def _outline_and_folds(projected: Float[np.ndarray, "nv nu 2"]) -> list[Float[np.ndarray, "_ 2"]]:
    """Lines of a projected lattice at which the film point seen may jump: its four sides, and the edges between a
    triangle that shows its front and one that shows its back."""
    across, down = np.diff(projected, axis=1), np.diff(projected, axis=0)
    upper = _turn(across[:-1], down[:, :-1]) > 0
    lower = _turn(across[1:], down[:, 1:]) > 0
    lines = [projected[0], projected[-1], projected[:, 0], projected[:, -1]]
    if (upper == lower).all() and upper.all() == upper.any():
        return lines
    edges = (
        (upper != lower, projected[1:, :-1], projected[:-1, 1:]),
        (upper[:, 1:] != lower[:, :-1], projected[:-1, 1:-1], projected[1:, 1:-1]),
        (upper[1:] != lower[:-1], projected[1:-1, :-1], projected[1:-1, 1:]),
    )
    for turns, start, stop in edges:
        lines.extend(np.stack([start[turns], stop[turns]], axis=1))
    return lines


def _turn(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Twice the signed area that two sides span."""
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def _centres(size: tuple[int, int]) -> Float32[np.ndarray, "h w 2"]:
    """Photo points of all pixel centres in single precision."""
    return pixel_centres(size).astype(np.float32)


def _corners(at: Int[np.ndarray, " m"], size: tuple[int, int]) -> Float32[np.ndarray, "m 2"]:
    """Photo points of the upper left corners of pixels, given by their numbers row by row."""
    rows, cols = np.divmod(at, size[1])
    return np.stack([cols, rows], axis=-1).astype(np.float32)


def _tensor(values: np.ndarray) -> Any:
    """Open3D's tensor over the same memory."""
    import open3d as o3d

    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(values))


def true_backward_map(film: FilmMesh, camera: Camera, size: tuple[int, int] = BACKWARD_NODES) -> BackwardMap:
    """The exact backward map: nodes of the smooth film projected by the camera, lens distortion included."""
    surface = film.surface(node_centres_1d(size[1]), node_centres_1d(size[0]))
    return BackwardMap(camera.photo_from_world(surface))
