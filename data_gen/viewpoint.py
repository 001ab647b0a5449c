"""Where the phone is held: cameras in front of a bent film, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hybrid.coords import node_centres_1d
from hybrid.mesh.camera import Camera, look_at
from hybrid.mesh.film import FilmMesh


@dataclass(frozen=True)
class ViewConfig:
    """Ranges from which viewpoints are drawn.

    fov_deg: across the photo's side. fill: longer side of the film's bounding box over the photo's side.
    leave_share: films that leave the frame. tilt_deg: spread (one sigma) of the view direction about the film's normal.
    roll_deg: likewise, about the axis.
    """

    fov_deg: tuple[float, float] = (16.0, 68.0)
    fill: tuple[float, float] = (0.55, 0.97)
    leave_share: float = 0.06
    tilt_deg: float = 17.0
    roll_deg: float = 14.0


def sample_camera(film: FilmMesh, size: tuple[int, int], rng: np.random.Generator, config: ViewConfig) -> Camera:
    """A phone held in front of the film so that it fills the wanted part of the frame."""
    t = node_centres_1d(17)
    points = film.surface(t, t).reshape(-1, 3)
    normal = film.normals(t, t).reshape(-1, 3).mean(axis=0)
    normal /= np.linalg.norm(normal)
    focal = 0.5 / np.tan(np.deg2rad(rng.uniform(*config.fov_deg)) / 2)  # in units of the photo's side
    roll = rng.normal(0, np.deg2rad(config.roll_deg))
    fill = rng.uniform(*config.fill)
    leave = rng.random() < config.leave_share
    eye_direction = _tilted(normal, abs(rng.normal(0, np.deg2rad(config.tilt_deg))), rng)
    down = np.array([np.sin(roll), np.cos(roll), 0.0])
    distortion = (float(rng.normal(0, 0.02)), float(rng.normal(0, 0.005)))
    centre = (points.max(axis=0) + points.min(axis=0)) / 2
    distance = focal * max(film.size_mm) / fill
    intrinsics = np.array([[focal * size[1], 0, size[1] / 2], [0, focal * size[0], size[0] / 2], [0, 0, 1]])
    camera = Camera(intrinsics, look_at(centre + distance * eye_direction, centre, down), distortion, size)
    for _ in range(3):  # the bounding box follows the distance almost inversely, so a few corrections suffice
        low, high = _bounding_box(camera, points)
        distance *= float((high - low).max()) / fill
        camera = Camera(intrinsics, look_at(centre + distance * eye_direction, centre, down), distortion, size)
    low, high = _bounding_box(camera, points)
    slack = 0.5 - (high - low) / 2 + (0.25 if leave else -0.012)
    wanted = np.clip(rng.normal(0, 0.5, 2), -1, 1) * np.maximum(slack, 0.0)
    return _panned(camera, wanted - ((high + low) / 2 - 0.5))


def _bounding_box(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the projected points' bounding box, in units of the photo's sides."""
    relative = camera.photo_from_world(points) / np.array(camera.size[::-1])
    return relative.min(axis=0), relative.max(axis=0)


def _panned(camera: Camera, shift: np.ndarray) -> Camera:
    """The camera turned so that its picture moves by ``shift`` (units of the photo's sides)."""
    focal = camera.intrinsics[0, 0] / camera.size[1]
    ax, ay = np.arctan(shift[0] / focal), np.arctan(shift[1] / focal)
    yaw = np.array([[np.cos(ax), 0, np.sin(ax)], [0, 1, 0], [-np.sin(ax), 0, np.cos(ax)]])
    pitch = np.array([[1, 0, 0], [0, np.cos(ay), np.sin(ay)], [0, -np.sin(ay), np.cos(ay)]])
    pose = np.eye(4)
    pose[:3, :3] = yaw @ pitch
    return Camera(camera.intrinsics, pose @ camera.camera_from_world, camera.distortion, camera.size)


def _tilted(normal: np.ndarray, angle: float, rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """A unit vector at ``angle`` from ``normal``, in a random direction; at most 55 degrees away."""
    side = rng.normal(size=3)
    side -= side @ normal * normal
    side /= np.linalg.norm(side)
    angle = min(angle, np.deg2rad(55))
    return np.cos(angle) * normal + np.sin(angle) * side
