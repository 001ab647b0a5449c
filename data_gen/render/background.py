"""Linear radiance of what lies behind the film, over the whole photo.

A table or wall is a plane in the film's world, seen through the photo's camera without its slight distortion. A
background that is out of focus is drawn small and enlarged.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float

from data_gen.light.lamps import lamp_seen
from data_gen.light.lighting import room_from_film
from data_gen.light.rooms import FilteredEnvironment, sample_environment
from data_gen.render.ground import Ground, ground_below, ground_light, ground_material, place_things
from data_gen.render.ground_shadows import lit_ground
from data_gen.render.shade import box_offset_mm, light_box_lamp
from data_gen.scene.scene import Scene
from hybrid.coords import film_centres
from hybrid.mesh.camera import Camera
from hybrid.mesh.film import FilmMesh

COARSE = 24
"""Side of the lattices on which smooth light is evaluated."""

BLUR_REFERENCE = 1000.0
"""Photo side, in pixels, to which the backdrop's blur refers."""


def background(
    scene: Scene, film: FilmMesh, room: FilteredEnvironment, base: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "h w 3"]:
    """What is behind the film. base: radiance of its unprinted parts, which a dark backdrop is close to."""
    backdrop, (height, width) = scene.backdrop, scene.camera.size
    sigma = backdrop.blur * max(height, width) / BLUR_REFERENCE
    if backdrop.kind == "room":  # the environment's own pixels must not show
        sigma = float(np.hypot(sigma, 0.75 * _environment_pixel(scene.camera, room)))
    scale = float(np.clip(1.6 / max(sigma, 1e-6), 0.06, 1.0))
    if scale > 0.7 or backdrop.kind == "dark":
        scale = 1.0
    camera = scene.camera.resized((max(8, round(height * scale)), max(8, round(width * scale))))
    picture = _DRAWN[backdrop.kind](scene, camera, film, room, base)
    if sigma * scale > 0.25 and backdrop.kind != "dark":
        picture = cv2.GaussianBlur(picture, (0, 0), sigma * scale)
    if camera.size != (height, width):
        picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(picture, dtype=np.float32)


def _environment_pixel(camera: Camera, room: FilteredEnvironment) -> float:
    """Size of one pixel of the environment in pixels of the photo."""
    return float(camera.intrinsics[0, 0]) * 2 * np.pi / room.environment.radiance.shape[1]


def _room(
    scene: Scene, camera: Camera, film: FilmMesh, room: FilteredEnvironment, base: np.ndarray
) -> Float[np.ndarray, "h w 3"]:
    """The environment, and the lamps that stand farther away than the film."""
    small = camera.resized((max(4, camera.size[0] // 4), max(4, camera.size[1] // 4)))
    rays = (small.pixel_rays() @ camera.camera_from_world[:3, :3]).astype(np.float32)
    rays = cv2.resize(rays, camera.size[::-1], interpolation=cv2.INTER_LINEAR)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    turn = room_from_film(scene.light).T.astype(np.float32)
    picture = sample_environment(room.environment, rays @ turn) * np.float32(scene.light.front)
    farther = camera.camera_points(film.vertices.reshape(-1, 3))[:, 2].max()
    for lamp in (one.placed(camera.centre_world) for one in scene.light.lamps):
        if camera.camera_points(np.array([lamp.centre_mm]))[0, 2] > farther:
            picture[lamp_seen(lamp, np.broadcast_to(camera.centre_world, rays.shape), rays)] = lamp.radiance
    return picture


def _dark(
    scene: Scene, camera: Camera, film: FilmMesh, room: FilteredEnvironment, base: np.ndarray
) -> Float[np.ndarray, "h w 3"]:
    """A dark surface about as bright as the film's base, even or slightly graded."""
    backdrop = scene.backdrop
    rng = np.random.default_rng(backdrop.seed)
    level = np.maximum(base, 1e-4) * backdrop.level * np.array(backdrop.tint) ** (rng.random() < 0.5)
    if rng.random() < 0.5:
        return np.broadcast_to(level.astype(np.float32), (*camera.size, 3))
    slope = cv2.resize(rng.normal(0, 0.35, (3, 3)).astype(np.float32), camera.size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.exp2(slope)[..., None] * level.astype(np.float32)


def _plane(
    scene: Scene, camera: Camera, film: FilmMesh, room: FilteredEnvironment, base: np.ndarray
) -> Float[np.ndarray, "h w 3"]:
    """A table or a wall with what lies on it, the film's shadow on it, and the room in its gloss."""
    backdrop = scene.backdrop
    ground = ground_below(film, camera, backdrop)
    reflectance, seen = ground_material(ground, camera, backdrop)
    received = ground_light(ground, camera, scene, room, (COARSE, COARSE))
    shade, bare, glows = place_things(reflectance, ground, camera, backdrop, np.random.default_rng(backdrop.seed))
    light = lit_ground(ground, film, camera, scene, room, received)
    light *= shade[..., None]
    picture = reflectance * light
    picture += cv2.resize(received.gloss, camera.size[::-1], interpolation=cv2.INTER_LINEAR) * bare[..., None]
    for box, radiance in glows:
        picture[box] += radiance
    if not seen.all():  # above the plane's horizon
        picture = np.where(seen[..., None], picture, _room(scene, camera, film, room, base))
    return picture


def _panel(
    scene: Scene, camera: Camera, film: FilmMesh, room: FilteredEnvironment, base: np.ndarray
) -> Float[np.ndarray, "h w 3"]:
    """A light box: its panel, its frame, other films on it, and the wall or desk around it."""
    box = scene.light.box
    if box is None:
        raise ValueError("background: a panel is seen without a light box; allowed: backdrop 'panel' with light.box")
    rng = np.random.default_rng(scene.backdrop.seed)
    lamp, _ = light_box_lamp(box, film, camera.centre_world)
    across, down, middle = np.array(lamp.across), np.array([0, 1.0, 0]), np.array(box_offset_mm(box, film))
    behind_film = np.array(lamp.centre_mm) - middle[0] * across - middle[1] * down
    ground = Ground(behind_film, across, down, np.array(lamp.axis))
    half = np.array(lamp.half_mm)
    centre = film_centres((COARSE, COARSE))
    around, _ = ground_material(ground, camera, scene.backdrop)
    received = ground_light(ground, camera, scene, room, (COARSE, COARSE))
    rim = rng.uniform(6, 35)
    panel = outline_share(ground, camera, middle - half, middle + half)
    frame = outline_share(ground, camera, middle - half - rim, middle + half + rim)
    plastic = 10 ** rng.uniform(-1.9, -0.2)
    around += (np.float32(plastic) - around) * frame[..., None]
    light, gloss = (
        cv2.resize(x, camera.size[::-1], interpolation=cv2.INTER_LINEAR) for x in (received.matt(), received.gloss)
    )
    spill = cv2.resize(frame, (64, 64), interpolation=cv2.INTER_AREA)
    spill = cv2.resize(cv2.GaussianBlur(spill, (0, 0), 5.0), camera.size[::-1], interpolation=cv2.INTER_LINEAR)
    light += spill[..., None] * np.array(box.radiance, np.float32) * np.float32(0.05)
    bright = box.brightness(np.clip((1 + (ground.coordinates(camera, centre) - middle) / half) / 2, 0, 1))
    bright = cv2.resize(bright, camera.size[::-1], interpolation=cv2.INTER_LINEAR)
    shone = np.ones_like(around)
    place_things(shone, ground, camera, scene.backdrop, rng, (film.size_mm[1] / 2, film.size_mm[0] / 2))
    shone *= bright[..., None] * np.array(box.radiance, np.float32)
    gloss *= 1 - frame[..., None]  # that of the wall, not of the frame
    return (around * light + gloss) * (1 - panel[..., None]) + shone * panel[..., None]


def outline_share(
    ground: Ground, camera: Camera, low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "h w"]:
    """Share of each pixel within a rectangle of the plane, given by two corners in mm."""
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return ground.filled(camera, corners)


_DRAWN = {"room": _room, "table": _plane, "wall": _plane, "panel": _panel, "dark": _dark}
