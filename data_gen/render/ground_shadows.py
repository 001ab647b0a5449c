"""Shadows on the plane behind a film: its own, cast by each light from its place, and those that cross the film.

A shadow is the film projected onto the plane along the light's rays. Its rim is as wide as the light's angular size
times the film's height above the plane: sharp where the sheet touches, soft where it is lifted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float

from data_gen.light.lamps import Lamp
from data_gen.light.lighting import room_from_film
from data_gen.light.rooms import FilteredEnvironment, room_lights
from data_gen.render.ground import NEAREST_MM, Ground, GroundLight
from data_gen.scene.patches import blurred
from data_gen.scene.scene import Scene, passes
from data_gen.scene.shadows import Shadow, film_shadow
from hybrid.coords import film_centres, film_nodes, node_centres_1d, opencv_from_photo
from hybrid.mesh.camera import Camera
from hybrid.mesh.film import FilmMesh
from hybrid.mesh.vectors import unit

NODES = 16
"""Film points along each side that are projected onto the plane."""

GRAZING = 0.12
"""For light that comes in flatter than this (cosine) no shadow is drawn: it would run across the whole plane."""

RIM_MM = 0.1
"""Sigma of a shadow's rim where the film touches the plane."""

WIDEST_PX = 80.0
"""Shadows blurred wider than this are left out: they would not show."""

STEP = 2.5
"""A shadow is blurred at widths that grow by this factor; each place mixes the two nearest."""

PRINT = 0.2
"""Mean reflectance assumed for the print where light passes through the film to the plane."""

ROOM_LIGHTS = 6
"""A room casts shadows as at most this many lights."""

NEAR_MM = 120.0
"""Shadows that cross the film also fall on a plane at most this far behind it."""

AROUND = 3
"""Shadows that cross the film are drawn over this many of its sides, with the film in the middle."""

_CROSSING_SIDE = 420


@dataclass(frozen=True, eq=False)
class _Cast:
    """The film's shadow by one light. way: unit, from the nodes to the light. spread: sigma of the rim per mm of
    height. share: part of its source's light."""

    way: Float[np.ndarray, "k k 3"]
    spread: float
    share: float


def lit_ground(
    ground: Ground, film: FilmMesh, camera: Camera, scene: Scene, room: FilteredEnvironment, light: GroundLight
) -> Float[np.ndarray, "h w 3"]:
    """Radiance of white matt ground over the photo, with the shadows of the film and of what shadows it."""
    t = node_centres_1d(NODES)
    nodes = film.surface(t, t)
    opaque = 1 - through(scene)
    casts = [room_casts(ground, nodes, scene, room)]
    casts += [[lamp_cast(lamp.placed(camera.centre_world), nodes)] for lamp in scene.light.lamps]
    total = np.zeros((*camera.size, 3), np.float32)
    for lattice, some in zip((light.room, *light.lamps), casts, strict=True):
        part = cv2.resize(lattice, camera.size[::-1], interpolation=cv2.INTER_LINEAR)
        shadows = [_shadow(cast, ground, nodes, camera) for cast in some]
        dark = [shadow for shadow in shadows if shadow is not None]
        if dark:
            part *= 1 - np.sum(dark, axis=0)[..., None] * opaque
        total += part
    if scene.shadows and scene.backdrop.gap_mm < NEAR_MM:
        total *= _crossing(scene.shadows, ground, nodes, film.size_mm, camera)[..., None]
    return total


def through(scene: Scene) -> Float[np.ndarray, "3"]:
    """Share of the light (RGB) that passes through the film into its shadow, for a print of mean reflectance PRINT.

    Where the ground is also seen through the film, the film is given both passes of light through the print
    (``scene.passes``): to that extent, the shadow leaves out the first.
    """
    material = scene.material
    share = PRINT ** (2.0 - passes(scene)) * (material.transmission + material.clear)
    return np.float32(share) * np.array(material.tint, np.float32) + np.float32(material.haze)


def lamp_cast(lamp: Lamp, nodes: Float[np.ndarray, "k k 3"]) -> _Cast:
    """The shadow by a lamp in the world's frame; a disc of radius r has the variance of a Gaussian of sigma r / 2."""
    offset = np.array(lamp.centre_mm) - nodes
    radius = float(np.sqrt(lamp.half_mm[0] * lamp.half_mm[1]))
    distance = float(np.linalg.norm(offset, axis=-1).mean())
    return _Cast(unit(offset), min(0.5 * radius / distance, 0.6), 1.0)


def room_casts(
    ground: Ground, nodes: Float[np.ndarray, "k k 3"], scene: Scene, room: FilteredEnvironment
) -> list[_Cast]:
    """The film's shadows cast by the room, taken as a few lights: a sun or windows, and the rest by direction."""
    turn = room_from_film(scene.light)
    ways, shares, sigmas = room_lights(room, turn @ ground.normal, ROOM_LIGHTS)
    return [
        _Cast(np.broadcast_to(way, nodes.shape), min(float(sigma), 0.6), float(share))
        for way, share, sigma in zip(ways @ turn, shares, sigmas, strict=True)
    ]


def _shadow(
    cast: _Cast, ground: Ground, nodes: Float[np.ndarray, "k k 3"], camera: Camera
) -> Float[np.ndarray, "h w"] | None:
    """Share of the light on its way to the plane that meets the film; None if there is none or it cannot be drawn."""
    cosine = cast.way @ ground.normal
    if cosine.min() < GRAZING or cast.share < 0.01:
        return None
    rise = np.maximum((nodes - ground.origin) @ ground.normal, 0.0)
    foot = nodes - cast.way * (rise / cosine)[..., None]
    depth = camera.camera_points(foot.reshape(-1, 3))[:, 2]
    if depth.min() < NEAREST_MM:
        return None
    photo = camera.photo_from_world(foot.reshape(-1, 3)).reshape((*foot.shape[:2], 2))
    per_mm = float(camera.intrinsics[0, 0] / np.median(depth))
    sigma = (RIM_MM + cast.spread * rise / cosine) * per_mm
    if sigma.min() > WIDEST_PX:
        return None
    return np.float32(cast.share) * _soft(_covered(photo, camera.size), photo, sigma)


def _covered(photo: Float[np.ndarray, "k k 2"], size: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """Share of each pixel of a photo covered by a lattice of photo points: drawn cell by cell, as cells may overlap."""
    mask = np.zeros(size, np.uint8)
    corners = np.stack([photo[:-1, :-1], photo[:-1, 1:], photo[1:, 1:], photo[1:, :-1]], axis=2).reshape(-1, 4, 2)
    fixed = np.clip(opencv_from_photo(corners) * 16, -(2**19), 2**19).round().astype(np.int32)
    for mesh in fixed:
        cv2.fillPoly(mask, [mesh], 255, cv2.LINE_AA, 4)
    return mask * np.float32(1 / 255)


def _soft(
    mask: Float[np.ndarray, "h w"], photo: Float[np.ndarray, "k k 2"], sigma: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, "h w"]:
    """The mask blurred by a width that changes over the photo: a quadratic fitted to the width at some points."""
    low, high = np.clip([sigma.min(), sigma.max()], 0.4, WIDEST_PX)
    steps = int(np.ceil(np.log(high / low) / np.log(STEP)))
    if steps == 0:
        return blurred(mask, float(low))
    h, w = mask.shape
    widths = np.geomspace(low, high, steps + 1)
    solved = np.linalg.lstsq(_quadratic(photo / (w, h)), np.clip(sigma, low, high).reshape(-1), rcond=None)[0]
    wanted = np.clip((_quadratic(film_centres((24, 24))) @ solved).reshape(24, 24), low, high)
    level = cv2.resize((np.log(wanted / low) / np.log(widths[1] / low)).astype(np.float32), (w, h))
    out = np.zeros_like(mask)
    for k, width in enumerate(widths):
        out += np.maximum(1 - np.abs(level - np.float32(k)), 0) * blurred(mask, float(width))
    return out


def _quadratic(xy: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "m 6"]:
    x, y = xy[..., 0].reshape(-1), xy[..., 1].reshape(-1)
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def _crossing(
    shadows: tuple[Shadow, ...],
    ground: Ground,
    nodes: Float[np.ndarray, "k k 3"],
    size_mm: tuple[float, float],
    camera: Camera,
) -> Float[np.ndarray, "h w"]:
    """Factor, beside the film, of the shadows that cross it: the plane's points are given film coordinates."""
    around = tuple(replace(s, at=tuple((np.array(s.at) + (AROUND - 1) / 2) / AROUND)) for s in shadows)
    factor = film_shadow(around, (AROUND * size_mm[0], AROUND * size_mm[1]), _CROSSING_SIDE)
    uv = film_nodes((NODES, NODES)).reshape(-1, 2)
    offset = nodes.reshape(-1, 3) - ground.origin
    mm = np.stack([offset @ ground.along, offset @ ground.across, np.ones(len(offset))], axis=1)
    solved = np.linalg.lstsq(mm, uv, rcond=None)[0]
    solved[2] += (AROUND - 1) / 2
    a, b, c = (solved * (_CROSSING_SIDE / AROUND)).astype(np.float32)
    u, v, _ = ground.pixels(camera)
    x, y = (np.clip(opencv_from_photo(u * a[k] + v * b[k] + c[k]), -30000, 30000) for k in range(2))
    return cv2.remap(factor, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
