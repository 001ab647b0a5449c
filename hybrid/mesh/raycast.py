"""Annotation maps of a bent film by ray casting (Open3D), and its exact backward map by projection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, node_centres_1d
from hybrid.mesh.camera import Camera
from hybrid.mesh.film import FilmMesh, lattice_triangles

_MISS = 2**32 - 1
"""Open3D's primitive number of a ray that hits nothing."""

RENDER_VERTICES = 97
"""Vertices along each side of the fine mesh that is cast: its facets are within 0.02 mm of the smooth film at a
radius of 150 mm."""


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


class FilmCaster:
    """A bent film ready for ray casting: built once, then cast from any camera at any resolution."""

    def __init__(self, film: FilmMesh, n: int = RENDER_VERTICES) -> None:
        import open3d as o3d

        t = node_centres_1d(n)
        self.film = film
        self._uv = film_nodes((n, n)).reshape(-1, 2)
        self._points = film.surface(t, t).reshape(-1, 3)
        self._normals = film.normals(t, t).reshape(-1, 3)
        self._triangles = lattice_triangles(n, n)
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(_tensor(self._points.astype(np.float32)), _tensor(self._triangles.astype(np.uint32)))

    def uv_map(self, camera: Camera) -> tuple[Bool[np.ndarray, "h w"], Float[np.ndarray, "h w 2"]]:
        """Mask and film uv (float32, NaN where the mask is False) of each pixel of the camera's photo."""
        mask, weights, corners = self._hits(camera)
        uv = np.full((*camera.size, 2), np.nan, dtype=np.float32)
        uv[mask] = _mix(self._uv, weights, corners)
        return mask, uv

    def annotate(self, camera: Camera) -> AnnotationMaps:
        """All maps of the camera's photo."""
        mask, weights, corners = self._hits(camera)
        size = camera.size
        uv, xyz, normal = (np.full((*size, k), np.nan) for k in (2, 3, 3))
        uv[mask] = _mix(self._uv, weights, corners)
        xyz[mask] = camera.camera_points(_mix(self._points, weights, corners))
        mixed = _mix(self._normals, weights, corners) @ camera.camera_from_world[:3, :3].T
        normal[mask] = mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)
        return AnnotationMaps(mask, uv, xyz, normal)

    def _hits(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mask of the pixels that see film, and for those the barycentric weights and vertex numbers.

        Rays are cast only through the bounding box of the projected film.
        """
        mask = np.zeros(camera.size, dtype=bool)
        box = self._bounding_box(camera)
        part = camera.cropped((box[1].start, box[0].start), mask[box].shape)
        rays = np.empty((*part.size, 6), dtype=np.float32)
        rays[..., :3] = camera.centre_world
        rays[..., 3:] = part.pixel_rays() @ camera.camera_from_world[:3, :3]
        answer = self._scene.cast_rays(_tensor(rays))
        primitive = answer["primitive_ids"].numpy()
        hit = primitive != _MISS
        mask[box] = hit
        bary = answer["primitive_uvs"].numpy()[hit].astype(np.float64)
        weights = np.stack([1 - bary[:, 0] - bary[:, 1], bary[:, 0], bary[:, 1]], axis=1)
        return mask, weights, self._triangles[primitive[hit]]

    def _bounding_box(self, camera: Camera) -> tuple[slice, slice]:
        """Rows and columns of the photo within which the film is seen; all where part of it is beside the camera."""
        points = camera.camera_points(self._points)
        h, w = camera.size
        if points[:, 2].min() <= 1.0:
            return slice(0, h), slice(0, w)
        photo = camera.photo_from_camera(points)
        left, top = np.clip(np.floor(photo.min(axis=0)).astype(int), 0, [w - 1, h - 1]).tolist()
        right, bottom = np.clip(np.ceil(photo.max(axis=0)).astype(int), [left + 1, top + 1], [w, h]).tolist()
        return slice(top, bottom), slice(left, right)


def _tensor(values: np.ndarray) -> Any:
    """Open3D's tensor over the same memory."""
    import open3d as o3d

    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(values))


def _mix(values: np.ndarray, weights: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric mean of vertex values, one for each hit."""
    mixed = weights[:, :1] * values[corners[:, 0]]
    mixed += weights[:, 1:2] * values[corners[:, 1]]
    mixed += weights[:, 2:] * values[corners[:, 2]]
    return mixed


def true_backward_map(film: FilmMesh, camera: Camera, size: tuple[int, int] = (33, 33)) -> BackwardMap:
    """The exact backward map: nodes of the smooth film projected by the camera, lens distortion included."""
    surface = film.surface(node_centres_1d(size[1]), node_centres_1d(size[0]))
    return BackwardMap(camera.photo_from_world(surface))
