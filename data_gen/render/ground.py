"""The plane behind a film: where it lies, its material, its light, and things upon it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from data_gen.light.lamps import surface_irradiance, vector_irradiance
from data_gen.light.lighting import room_from_film
from data_gen.light.rooms import FilteredEnvironment, sample_filtered, sample_irradiance
from data_gen.render.clutter import ON_PANEL, ON_TABLE, ON_WALL, PX_PER_MM, VARIANTS, Sprite, sprite
from data_gen.scene.backdrop import Backdrop
from data_gen.scene.materials import TILE, tile
from data_gen.scene.patches import Box, blurred, filled, frame_box
from data_gen.scene.scene import Scene
from hybrid.coords import centres_1d, film_centres, opencv_from_photo
from hybrid.mesh.camera import Camera
from hybrid.mesh.film import FilmMesh

NEAREST_MM = 60.0
"""Nothing closer to the camera's plane than this is drawn."""

FARTHEST_MM = 4000.0
"""Things farther from the film than this are left out."""


@dataclass(frozen=True, eq=False)
class Ground:
    """A plane in the film's world. origin: mm. along, across: its axes, unit, to the right and down as seen.
    normal: unit, towards the camera."""

    origin: Float[np.ndarray, "3"]
    along: Float[np.ndarray, "3"]
    across: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]

    def world(self, mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
        """World points of points of the plane."""
        return self.origin + mm[..., :1] * self.along + mm[..., 1:] * self.across

    def coordinates(self, camera: Camera, shares: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Points (mm) of the plane seen at places of the photo, in shares of its sides; far away where it is missed."""
        photo = shares * np.array(camera.size[::-1], np.float64)
        rays = camera.ray_directions(photo) @ camera.camera_from_world[:3, :3]
        eye = self.origin - camera.centre_world
        depth = (eye @ self.normal) / np.minimum(rays @ self.normal, -1e-3)
        relative = rays * depth[..., None] - eye
        return np.stack([relative @ self.along, relative @ self.across], axis=-1)

    def pixels(
        self, camera: Camera
    ) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
        """Plane coordinates (mm, float32) of all pixels, and which of them see the plane; without lens distortion."""
        k = camera.intrinsics
        x = ((centres_1d(camera.size[1]) - k[0, 2]) / k[0, 0])[None, :]
        y = ((centres_1d(camera.size[0]) - k[1, 2]) / k[1, 1])[:, None]
        rotation = camera.camera_from_world[:3, :3]
        eye = self.origin - camera.centre_world

        def dot(axis: np.ndarray) -> np.ndarray:
            a, b, c = rotation @ axis
            return (a * x + c).astype(np.float32) + (b * y).astype(np.float32)

        facing = dot(self.normal)
        depth = np.float32(eye @ self.normal) / np.minimum(facing, np.float32(-1e-3))
        u = dot(self.along) * depth - np.float32(eye @ self.along)
        v = dot(self.across) * depth - np.float32(eye @ self.across)
        return u, v, facing < -0.02

    def filled(self, camera: Camera, outline_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "h w"]:
        """Share of each pixel within an outline on the plane; nothing if part of it is behind the camera."""
        world = self.world(outline_mm)
        if camera.camera_points(world)[:, 2].min() < NEAREST_MM:
            return np.zeros(camera.size, np.float32)
        return filled(camera.photo_from_world(world), camera.size)


def ground_below(film: FilmMesh, camera: Camera, backdrop: Backdrop) -> Ground:
    """The plane that just touches the film on its far side, moved away by the gap and tilted."""
    points = film.vertices.reshape(-1, 3)
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    normal = normal * (1.0 if (camera.centre_world - centre) @ normal > 0 else -1.0)
    along = np.cross([0.0, 1.0, 0.0], normal) if abs(normal[1]) < 0.9 else np.cross([1.0, 0.0, 0.0], normal)
    along /= np.linalg.norm(along)
    across = np.cross(normal, along)
    normal = normal + backdrop.tilt[0] * along + backdrop.tilt[1] * across
    normal /= np.linalg.norm(normal)
    along = along - (along @ normal) * normal
    along /= np.linalg.norm(along)
    across = np.cross(normal, along)
    across, along = (across, -along) if across[1] > 0 else (-across, along)  # right and down as the camera sees them
    nearest = ((points - centre) @ normal).min()
    return Ground(centre + normal * (nearest - backdrop.gap_mm), along, across, normal)


def ground_material(
    ground: Ground, camera: Camera, backdrop: Backdrop
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Reflectance seen by each pixel, and which pixels see the plane."""
    material = tile(backdrop.material, backdrop.variant)
    u, v, seen = ground.pixels(camera)
    middle = tuple(n // 2 for n in camera.size)
    step = np.hypot(u[middle] - u[middle[0], middle[1] - 1], v[middle] - v[middle[0], middle[1] - 1])
    level = int(np.clip(np.round(np.log2(max(step * TILE / material.mm, 1e-3))), 0, len(material.levels) - 1))
    picture = material.levels[level]
    per_mm = len(picture) / material.mm
    c, s = (float(f(np.deg2rad(backdrop.turn_deg))) * per_mm for f in (np.cos, np.sin))
    shift = np.random.default_rng(backdrop.seed).uniform(0, len(picture), 2)
    x = np.clip(u * np.float32(c) + v * np.float32(s) + np.float32(shift[0]), -30000, 30000)
    y = np.clip(v * np.float32(c) - u * np.float32(s) + np.float32(shift[1]), -30000, 30000)
    coded = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return cv2.LUT(coded, _DECODED[..., None] * np.array(backdrop.tint, np.float32)), seen


_DECODED = ((np.arange(256) / 255) ** 2).astype(np.float32)[None]


@dataclass(frozen=True, eq=False)
class GroundLight:
    """Radiance of white matt ground and of its gloss, on a coarse lattice over the photo.

    room: from the environment. lamps: from each lamp. gloss: reflection of the environment.
    """

    room: Float[np.ndarray, "a b 3"]
    lamps: tuple[Float[np.ndarray, "a b 3"], ...]
    gloss: Float[np.ndarray, "a b 3"]

    def matt(self) -> Float[np.ndarray, "a b 3"]:
        """All that white matt ground scatters; the gloss is kept apart, since the ground does not colour it."""
        return sum(self.lamps, self.room)


def ground_light(
    ground: Ground, camera: Camera, scene: Scene, room: FilteredEnvironment, size: tuple[int, int]
) -> GroundLight:
    """What the ground, with nothing upon it, receives from each source; ``size``: of the lattice."""
    light, turn = scene.light, room_from_film(scene.light).T
    points = ground.world(ground.coordinates(camera, film_centres(size))).astype(np.float32)
    normals = np.broadcast_to(ground.normal.astype(np.float32), points.shape)
    matt = np.repeat(sample_irradiance(room, ground.normal[None] @ turn), points[..., 0].size, axis=0)
    matt = matt.reshape(points.shape) * np.float32(light.front / np.pi)
    lamps = []
    for lamp in light.lamps:
        received, _ = surface_irradiance(vector_irradiance(lamp.placed(camera.centre_world), points), normals)
        lamps.append(received[..., None] / np.float32(np.pi) * np.array(lamp.radiance, np.float32))
    material = tile(scene.backdrop.material, scene.backdrop.variant)
    view = camera.centre_world - points
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    cosine = np.maximum(view @ ground.normal, 0.02)[..., None]
    mirror = 2 * cosine * ground.normal - view
    fresnel = material.f0 + (1 - material.f0) * (1 - cosine) ** 5 * (1 - material.roughness)
    seen = sample_filtered(room, (mirror @ turn).astype(np.float32), material.roughness)
    gloss = seen * fresnel * (light.front if material.f0 else 0.0)
    return GroundLight(matt, tuple(lamps), gloss.astype(np.float32))


# ---------------------------------------------------------------- things


Glow = tuple[Box, Float[np.ndarray, "_ _ 3"]]
"""Radiance of something that shines by itself, within a part of the photo."""


def place_things(
    reflectance: Float[np.ndarray, "h w 3"],
    ground: Ground,
    camera: Camera,
    backdrop: Backdrop,
    rng: np.random.Generator,
    free_mm: tuple[float, float] = (0.0, 0.0),
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"], list[Glow]]:
    """Draw the backdrop's things into ``reflectance``; return the factor of their shadows, the share of the ground that
    they leave bare, and what shines by itself.

    free_mm: half sides of the part of the plane about its origin that things lie beside, as films on a light box do.
    """
    shade, bare = (np.ones(camera.size, np.float32) for _ in range(2))
    kinds = {"table": ON_TABLE, "wall": ON_WALL, "panel": ON_PANEL}[backdrop.kind]
    placed = []
    for _ in range(backdrop.things):
        thing = sprite(str(rng.choice(kinds)), int(rng.integers(VARIANTS)))
        upright = backdrop.kind != "table" or rng.random() < 0.25
        turn = float(rng.normal(0, 0.04) if upright else rng.uniform(-np.pi, np.pi))
        at = ground.coordinates(camera, rng.uniform(-0.1, 1.1, (1, 2)))[0]
        if max(free_mm):
            nearest = np.array(free_mm) + np.array(thing.size_mm[::-1]) / 2
            at = at / np.clip(np.abs(at / nearest).max(), 1e-3, 1)
        if np.abs(at).max() < FARTHEST_MM:
            placed.append(_placed(thing, at, turn, ground, camera))
    glows = []
    for seen in sorted((p for p in placed if p), key=lambda p: p.thing.glow):  # what shines is not covered
        part, cover = reflectance[seen.box], seen.cover[..., None]
        bare[seen.box] *= 1 - seen.cover
        if seen.spread > 0.4:
            soft = blurred(seen.cover, seen.spread)
            shade[seen.box] *= 1 - np.float32(0.6) * soft * (1 - seen.cover)
        if seen.thing.glow:
            part *= 1 - cover
            glows.append((seen.box, seen.colour * cover * np.float32(seen.thing.glow)))
        else:
            part += (seen.colour - part) * cover
    return shade, bare, glows


@dataclass(frozen=True, eq=False)
class _Seen:
    """A thing in the photo: reflectance and coverage within ``box``; its shadow is blurred by ``spread`` pixels."""

    thing: Sprite
    box: Box
    colour: Float[np.ndarray, "h w 3"]
    cover: Float[np.ndarray, "h w"]
    spread: float


def _placed(thing: Sprite, at: np.ndarray, turn: float, ground: Ground, camera: Camera) -> _Seen | None:
    """The thing lying at a point (mm) of the plane; None outside the photo."""
    half = np.array([thing.size_mm[1], thing.size_mm[0]]) / 2
    c, s = np.cos(turn), np.sin(turn)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ np.array([[c, s], [-s, c]]) + at
    world = ground.world(corners)
    if camera.camera_points(world)[:, 2].min() < NEAREST_MM:
        return None
    photo = camera.photo_from_world(world)
    per_mm = float(np.linalg.norm(photo[1] - photo[0]) / thing.size_mm[1])
    spread = min(0.35 * thing.rise_mm * per_mm, 40.0)
    box = frame_box(photo, camera.size, 2 + 3 * spread)
    if box is None or per_mm < 0.02:
        return None
    level = int(np.clip(np.floor(np.log2(PX_PER_MM / per_mm) + 0.3), 0, len(thing.levels) - 1))  # text must not alias
    picture = thing.levels[level]
    h, w = picture.shape[:2]
    source = opencv_from_photo(np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32))
    target = opencv_from_photo((photo - [box[1].start, box[0].start]).astype(np.float32))
    size = (box[1].stop - box[1].start, box[0].stop - box[0].start)
    seen = cv2.warpPerspective(picture, cv2.getPerspectiveTransform(source, target), size, flags=cv2.INTER_LINEAR)
    colour = cv2.LUT(np.ascontiguousarray(seen[..., :3]), _DECODED)
    return _Seen(thing, box, colour, seen[..., 3] * np.float32(1 / 255), spread)
