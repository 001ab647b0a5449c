"""What surrounds the film in the photo, and what covers its rim: linear RGB pictures from made-up materials."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float

from data_gen.rooms import FilteredEnvironment, sample_environment, sample_filtered, sample_irradiance
from data_gen.scene import Scene
from data_gen.shade import room_from_film
from hybrid.coords import linear_from_srgb, sample_bilinear
from hybrid.mesh.camera import Camera

TILE = 256
"""Side of a material's picture in pixels; it repeats, mirrored, over its plane."""


def background(scene: Scene, room: FilteredEnvironment, rng: np.random.Generator) -> Float[np.ndarray, "h w 3"]:
    """Linear radiance of what lies behind the film, at half of the photo's resolution or 128 px at least."""
    height, width = (max(s // 2, min(s, 128)) for s in scene.camera.size)
    camera = scene.camera.resized((height, width))
    if scene.background == "room":
        picture = _room(camera, scene, room, rng)
    elif scene.background == "table":
        picture = _table(camera, scene, room, rng)
    elif scene.background == "panel":
        picture = _panel(camera, scene, rng)
    else:
        grey = 10 ** rng.uniform(-2.3, -0.6) * np.exp2(rng.normal(0, 0.15, 3) * (rng.random() < 0.5))
        picture = np.broadcast_to(grey, (*camera.size, 3)).astype(np.float32)
    return np.ascontiguousarray(picture, dtype=np.float32)


def _room(camera: Camera, scene: Scene, room: FilteredEnvironment, rng: np.random.Generator) -> np.ndarray:
    """The environment itself, out of focus by a random amount."""
    rays = camera.pixel_rays() @ camera.camera_from_world[:3, :3] @ room_from_film(scene.light).T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    if rng.random() < 0.3:
        return sample_filtered(room, rays, float(rng.uniform(0.05, 0.3)))
    picture = sample_environment(room.environment, rays)
    return cv2.GaussianBlur(picture, (0, 0), float(10 ** rng.uniform(-0.5, 1.0)) * camera.size[1] / 256)


def _table(camera: Camera, scene: Scene, room: FilteredEnvironment, rng: np.random.Generator) -> np.ndarray:
    """A plane behind the film with a made-up material and things lying on it, lit by the room."""
    rays = camera.pixel_rays() @ camera.camera_from_world[:3, :3]
    eye = camera.centre_world
    normal = np.array([rng.normal(0, 0.15), rng.normal(0, 0.15), 1.0])
    height = rng.uniform(5, 60) if rng.random() < 0.6 else rng.uniform(60, 900)
    along = np.maximum(rays @ normal, 1e-3)
    distance = np.minimum((normal @ (np.array([0, 0, 60.0 + height]) - eye)) / along, 1e5)
    plane = (eye + rays * distance[..., None])[..., :2]
    scale = TILE / rng.uniform(300, 1500)
    turn = rng.uniform(0, 2 * np.pi)
    rotation = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    at = plane @ rotation + rng.uniform(0, TILE, 2)
    mirrored = TILE - np.abs(np.mod(at, 2 * TILE) - TILE)  # the tile repeats, mirrored
    reflectance = sample_bilinear(material_tile(rng), mirrored)
    towards = room_from_film(scene.light) @ np.array([0, 0, -1.0])
    light = sample_irradiance(room, towards[None])[0] / np.pi * scene.light.front
    picture = reflectance * light
    blur = float(rng.uniform(0.3, 4.0)) * camera.size[1] / 256
    picture = cv2.GaussianBlur(picture, (0, 0), blur) if rng.random() < 0.5 else picture
    shade = _smooth_field(camera.size, rng, 0.5)
    return picture * shade[..., None]


def _panel(camera: Camera, scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """A light box: a bright panel around the film, its rim in the frame or not, dark beyond."""
    h, w = camera.size
    picture = np.full((h, w, 3), 10 ** rng.uniform(-2.5, -0.8), np.float32)
    margin = rng.uniform(-0.2, 0.15, 4)
    corners = np.array(
        [[margin[0], margin[1]], [1 - margin[2], margin[1]], [1 - margin[2], 1 - margin[3]], [margin[0], 1 - margin[3]]]
    )
    corners = (corners + rng.normal(0, 0.02, (4, 2))) * [w, h]
    cv2.fillConvexPoly(picture, corners.astype(np.int32), (1.0, 1.0, 1.0), cv2.LINE_AA)
    level = scene.light.box_radiance * np.exp2(rng.normal(0, [0.1, 0.02, 0.1]))
    return picture * level * _smooth_field((h, w), rng, 0.4)[..., None]


def material_tile(rng: np.random.Generator) -> Float[np.ndarray, "t t 3"]:
    """Linear reflectance of a random material: cloth, wood, stone, tiles or plain, often with things on it."""
    base = rng.uniform(0.02, 0.9) * np.exp2(rng.normal(0, 0.5, 3) * rng.uniform(0, 1))
    tile = np.full((TILE, TILE, 3), base, np.float64)
    for power in range(1, 7):
        n = 2**power
        octave = cv2.resize(rng.normal(0, 1, (n, n)), (TILE, TILE), interpolation=cv2.INTER_CUBIC)
        if rng.random() < 0.25:  # wood: stretched along one axis
            octave = cv2.resize(rng.normal(0, 1, (n * 4, 2)), (TILE, TILE), interpolation=cv2.INTER_CUBIC)
        tile *= np.exp2(0.3 * rng.random() * octave)[..., None]
    if rng.random() < 0.3:
        _stripes(tile, rng)
    for _ in range(int(rng.integers(0, 14)) if rng.random() < 0.6 else 0):
        _thing(tile, rng)
    return np.clip(tile, 0.003, 0.95).astype(np.float32)


def _stripes(tile: np.ndarray, rng: np.random.Generator) -> None:
    """Joints of tiles or planks, or a weave: periodic lines along one axis or both."""
    period = int(rng.integers(6, 80))
    width = max(1, int(period * rng.uniform(0.03, 0.4)))
    factor = np.exp2(rng.normal(0, 1))
    lines = (np.arange(TILE) % period) < width
    if rng.random() < 0.7:
        tile[lines] *= factor
    if rng.random() < 0.7:
        tile[:, lines] *= factor


def _thing(tile: np.ndarray, rng: np.random.Generator) -> None:
    """A sheet of paper with lines of text, a box, a disc, a cable."""
    colour = tuple(float(c) for c in rng.uniform(0.01, 0.9) * np.exp2(rng.normal(0, 0.5, 3)))
    x, y = (int(c) for c in rng.integers(0, TILE, 2))
    kind = int(rng.integers(4))
    if kind == 0:
        cv2.circle(tile, (x, y), int(rng.integers(3, 40)), colour, -1, cv2.LINE_AA)
    elif kind == 1:
        end = tuple(int(c) for c in rng.integers(0, TILE, 2))
        cv2.line(tile, (x, y), end, colour, int(rng.integers(1, 8)), cv2.LINE_AA)
    else:
        box = ((float(x), float(y)), tuple(float(s) for s in rng.uniform(10, 120, 2)), float(rng.uniform(0, 180)))
        corners = cv2.boxPoints(box)
        cv2.fillConvexPoly(tile, corners.astype(np.int32), colour, cv2.LINE_AA)
        if kind == 3:
            for t in np.linspace(0.1, 0.9, int(rng.integers(3, 12))):
                start = corners[0] + t * (corners[1] - corners[0]) + 0.1 * (corners[3] - corners[0])
                stop = corners[0] + t * (corners[1] - corners[0]) + rng.uniform(0.4, 0.9) * (corners[3] - corners[0])
                dark = tuple(0.1 * c for c in colour)
                cv2.line(tile, start.astype(int).tolist(), stop.astype(int).tolist(), dark, 1, cv2.LINE_AA)


def occluders(
    rim: Float[np.ndarray, "n 2"], size: tuple[int, int], count: int, light: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
    """Fingers and clips over the film's rim: their linear picture and coverage in [0, 1].

    rim: photo points of the film's outline, in order. light: radiance of a white surface there.
    """
    picture, cover = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32)
    centre, span = rim.mean(axis=0), float(np.linalg.norm(np.ptp(rim, axis=0)))
    for _ in range(count):
        at = rim[int(rng.integers(len(rim)))]
        inward = (centre - at) / max(float(np.linalg.norm(centre - at)), 1e-6)
        inward = inward + rng.normal(0, 0.35, 2)
        tip = at + inward * span * rng.uniform(0.005, 0.09)
        shape = np.zeros(size, np.float32)
        if rng.random() < 0.75:
            colour = linear_from_srgb(np.array([0.85, 0.66, 0.55]) * rng.uniform(0.35, 1.05))
            width = max(2, int(span * rng.uniform(0.03, 0.07)))
            root = at - inward * span * rng.uniform(0.2, 0.6)
            cv2.line(shape, root.astype(int).tolist(), tip.astype(int).tolist(), 1.0, width, cv2.LINE_AA)
        else:
            colour = np.full(3, 10 ** rng.uniform(-2, -0.2))
            box = (tuple(map(float, at)), (span * rng.uniform(0.03, 0.12), span * rng.uniform(0.02, 0.06)))
            turn = float(np.rad2deg(np.arctan2(inward[1], inward[0])) + 90)
            cv2.fillConvexPoly(shape, cv2.boxPoints((*box, turn)).astype(np.int32), 1.0, cv2.LINE_AA)
        relief = cv2.GaussianBlur(shape, (0, 0), max(1.0, 0.01 * span))
        picture = picture * (1 - shape[..., None]) + shape[..., None] * colour * light * relief[..., None]
        cover = np.maximum(cover, shape)
    return picture.astype(np.float32), cover


def _smooth_field(size: tuple[int, int], rng: np.random.Generator, strength: float) -> np.ndarray:
    """A positive smooth random factor around 1."""
    field = cv2.resize(rng.normal(0, 1, (4, 4)), size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.exp2(strength * rng.random() * field).astype(np.float32)
