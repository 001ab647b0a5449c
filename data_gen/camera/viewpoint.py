"""Where the phone is held: cameras in front of a bent film, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap, orientation
from hybrid.coords import node_centres_1d
from hybrid.mesh.camera import Camera, look_at
from hybrid.mesh.film import FilmMesh

LEAST_COSINE = 0.35
"""Least mean |cosine| between film normals and the rays to them that a view keeps: below, no slice can be read."""

_TRIES = 12
"""Views tried at most until one meets LEAST_COSINE; the last one looks along the normal."""

_MARGIN = 0.012
"""Least distance from the photo's sides, in units of these, of a film that stays within the frame."""

_NEAREST = 0.3
"""Least depth of any film point, as a share of the distance to the film's centre."""


@dataclass(frozen=True)
class ViewConfig:
    """Ranges from which viewpoints are drawn.

    fov_deg: across the photo's side. fill: longer side of the film's bounding box over the photo's side.
    leave_share: films that may leave the frame. tilt_deg: spread (one sigma) of the view direction about the film's
    normal. roll_deg: likewise, about the axis. any_roll_share: photos rolled by any angle instead. behind_share: films
    seen from behind, as a mirror image.
    """

    fov_deg: tuple[float, float] = (16.0, 68.0)
    fill: tuple[float, float] = (0.55, 0.97)
    leave_share: float = 0.08
    tilt_deg: float = 17.0
    roll_deg: float = 14.0
    any_roll_share: float = 0.12
    behind_share: float = 0.06


def sample_camera(film: FilmMesh, size: tuple[int, int], rng: np.random.Generator, config: ViewConfig) -> Camera:
    """A phone held so that the film fills the wanted part of the frame and its slices can be seen."""
    t = node_centres_1d(17)
    points, normals = film.surface(t, t).reshape(-1, 3), film.normals(t, t).reshape(-1, 3)
    side = -1.0 if rng.random() < config.behind_share else 1.0
    normal = side * normals.mean(axis=0)
    normal /= np.linalg.norm(normal)
    focal = 1 / (2 * np.tan(np.deg2rad(rng.uniform(*config.fov_deg)) / 2))  # in units of the photo's side
    roll = (
        rng.uniform(-np.pi, np.pi)
        if rng.random() < config.any_roll_share
        else rng.normal() * np.deg2rad(config.roll_deg)
    )
    fill = rng.uniform(*config.fill)
    leave = rng.random() < config.leave_share
    distortion = (float(rng.normal(0, 0.02)), float(rng.normal(0, 0.005)))
    down = np.array([np.sin(roll), np.cos(roll), 0.0])
    tilts = [*np.abs(rng.normal(0, np.deg2rad(config.tilt_deg), _TRIES - 1)), 0.0]
    for tilt in tilts:
        towards = _tilted(normal, tilt, rng)
        camera = _filling(points, towards, down, fill, Camera(_intrinsics(focal, size), np.eye(4), distortion, size))
        if mean_cosine(camera, points, normals) * side >= LEAST_COSINE:
            break
    low, high = _bounding_box(camera, points)
    slack = 1 / 2 - (high - low) / 2 + (0.25 if leave else -_MARGIN)
    wanted = np.clip(rng.normal(0, 0.5, 2), -1, 1) * np.maximum(slack, 0.0)
    camera = _panned(camera, wanted - ((high + low) / 2 - 1 / 2))
    return camera if leave else _within(camera, points)


def view_parameters(film: FilmMesh, camera: Camera, backward: BackwardMap) -> dict[str, Any]:
    """How the film lies in the photo, derived from the truth.

    roll_deg: angle, clockwise in the photo, of the film's downward direction against the photo's. tilt_deg: between
    the film's mean normal and the camera direction, 0 to 90. behind, mirrored: its back is seen, so it reads mirrored.
    turns: quarter turns clockwise that bring its top up, after mirroring if mirrored (``BackwardMap.turned``).
    fov_deg: across the photo's width. distance_mm: from the camera to the film's centre.
    """
    t = node_centres_1d(17)
    points, normals = film.surface(t, t).reshape(-1, 3), film.normals(t, t).reshape(-1, 3)
    way = camera.centre_world - points.mean(axis=0)
    normal = normals.mean(axis=0)
    cosine = float(way @ normal / (np.linalg.norm(way) * np.linalg.norm(normal)))
    found = orientation(backward)
    down = (backward.nodes[-1] - backward.nodes[0]).mean(axis=0)
    return {
        "roll_deg": float(np.rad2deg(np.arctan2(-down[0], down[1]))),
        "tilt_deg": float(np.rad2deg(np.arccos(min(abs(cosine), 1.0)))),
        "behind": cosine < 0,
        "turns": found.turns,
        "mirrored": found.mirrored,
        "fov_deg": float(2 * np.rad2deg(np.arctan(camera.size[1] / (2 * camera.intrinsics[0, 0])))),
        "distance_mm": float(np.linalg.norm(way)),
    }


def mean_cosine(camera: Camera, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]) -> float:
    """Mean cosine between surface normals and the directions to the camera: positive if the front is seen."""
    way = camera.centre_world - points
    return float(np.mean((way * normals).sum(axis=1) / np.linalg.norm(way, axis=1)))


def _intrinsics(focal: float, size: tuple[int, int]) -> Float[np.ndarray, "3 3"]:
    """Intrinsics for a focal length in units of the photo's sides, the axis in the photo's middle."""
    return np.array([[focal * size[1], 0, size[1] / 2], [0, focal * size[0], size[0] / 2], [0, 0, 1]])


def _filling(
    points: Float[np.ndarray, "n 3"], towards: np.ndarray, down: np.ndarray, fill: float, lens: Camera
) -> Camera:
    """The camera of ``lens`` placed in the direction ``towards`` so that the points' bounding box fills that share.

    Whatever the share, no point comes nearer than ``_NEAREST`` of the distance.
    """
    centre = (points.max(axis=0) + points.min(axis=0)) / 2
    nearest = float(((points - centre) @ towards).max()) / (1 - _NEAREST)
    distance = max(lens.intrinsics[0, 0] / lens.size[1] * float(np.ptp(points, axis=0).max()) / fill, nearest)
    for _ in range(4):  # the bounding box follows the distance almost inversely, so a few corrections suffice
        pose = look_at(centre + distance * towards, centre, down)
        camera = Camera(lens.intrinsics, pose, lens.distortion, lens.size)
        low, high = _bounding_box(camera, points)
        distance = max(distance * float((high - low).max()) / fill, nearest)
    return camera


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


def _within(camera: Camera, points: np.ndarray) -> Camera:
    """The camera turned back until its picture holds the points, whose image grows near its corners."""
    for _ in range(4):
        low, high = _bounding_box(camera, points)
        beyond = np.maximum(_MARGIN - low, 0.0) - np.maximum(high - (1 - _MARGIN), 0.0)
        if not beyond.any():
            break
        camera = _panned(camera, beyond)
    return camera


def _tilted(normal: np.ndarray, angle: float, rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """A unit vector at ``angle`` from ``normal``, in a random direction; at most 55 degrees away."""
    side = rng.normal(size=3)
    side -= side @ normal * normal
    side /= np.linalg.norm(side)
    angle = min(angle, np.deg2rad(55))
    return np.cos(angle) * normal + np.sin(angle) * side
