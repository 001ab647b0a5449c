"""Linear light that leaves the film, computed in film space: smooth light on a lattice, print detail multiplied in.

The film is a thin sheet with a print of linear reflectance T below a glossy surface; both sides answer alike. With o
towards the eye, i towards the light, c their cosines to the normal, R the surface's directional albedo and M its
cosine-weighted mean, the sheet scatters by

    f(i, o) = gloss                   F D G1(i) G1(o) / (4 c_i c_o)               i and o on one side
            + (T diffuse + haze)      (1 - R(i)) (1 - R(o)) / (pi (1 - M))        i and o on one side
            + (T transmission + haze) (1 - R(i)) (1 - R(o)) / (pi (1 - M))        i and o on different sides
            + T clear                 (1 - R(o)) delta(i = -o)                    straight through

What the surface does not reflect enters, so the lobes below it share 1 - R (Kelemen and Szirmay-Kalos 2001, the
`roughplastic` of Mitsuba): whatever the roughness, a sheet with diffuse + transmission + clear + 2 haze = 1 and T = 1
loses nothing, every draw of parameters reflects and lets through at most what comes in, and f(i, o) = f(o, i).
Left out: light that the film's far surface reflects back through the print, shadows of the film on itself and light
from one part of it on another; benchmarks/radiance.py says what they amount to.

Light varies slowly over the film, so radiance = gain * T + veil is evaluated on a lattice of film points and enlarged
to the print; the lattice is the finer, the more the film is a mirror.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, Float32
from scipy.interpolate import make_interp_spline

from data_gen.gloss import Gloss, cross, dot, gloss, smith, unit
from data_gen.gloss import fresnel as fresnel_reflectance
from data_gen.lamps import Lamp, highlight, lamp_seen, surface_irradiance, vector_irradiance
from data_gen.lighting import Light, LightBox, Material
from data_gen.rooms import (
    FilteredEnvironment,
    directions,
    sample_environment,
    sample_filtered,
    sample_irradiance,
    solid_angles,
)
from data_gen.scene import Scene
from data_gen.shadows import film_shadow
from hybrid.coords import film_centres_1d
from hybrid.mesh.film import FilmMesh

SMOOTH_LATTICE = 48
"""Film points along each side at which matt light is evaluated: 9 mm on a 35 x 43 cm film."""

SHADOW_LATTICE = 160
"""Likewise where something casts a shadow: 3 mm, as wide as the penumbra of the sun a metre away is at the least."""


@dataclass(frozen=True, eq=False)
class FilmLight:
    """What the light does to the print: radiance = gain * T + veil, in film space, linear RGB.

    gain, veil: (n, n, 3) float32 on the pixel centres of an n x n film image.
    """

    gain: Float[np.ndarray, "n n 3"]
    veil: Float[np.ndarray, "n n 3"]


@dataclass(frozen=True, eq=False)
class SeenFilm:
    """A lattice of film points as one camera sees them; float32.

    points: mm. normals: unit, of the side that is seen. view: unit, towards the camera. cosine: between those two.
    """

    points: Float[np.ndarray, "m n 3"]
    normals: Float[np.ndarray, "m n 3"]
    view: Float[np.ndarray, "m n 3"]
    cosine: Float[np.ndarray, "m n 1"]

    @property
    def mirror(self) -> Float[np.ndarray, "m n 3"]:
        """Unit directions from which a mirror would send light to the camera."""
        return 2 * self.cosine * self.normals - self.view

    def part(self, rows: slice, cols: slice) -> SeenFilm:
        return SeenFilm(*(getattr(self, name)[rows, cols] for name in ("points", "normals", "view", "cosine")))


def seen_film(film: FilmMesh, camera_mm: Float[np.ndarray, "3"], n: int) -> SeenFilm:
    """The n x n lattice of film pixel centres on the smooth (bicubic) film, seen from ``camera_mm``.

    The bicubic surface through the vertices is a product of two interpolations: matrices, fast on fine lattices.
    """
    (u, du), (v, dv) = (_spline_matrices(tuple(lines.tolist()), n) for lines in (film.u_lines, film.v_lines))
    grid = np.ascontiguousarray(film.vertices.transpose(2, 0, 1), dtype=np.float32)

    def lattice(rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.moveaxis(rows @ (grid @ cols.T), 0, -1))

    points, normals = lattice(v, u), unit(cross(lattice(dv, u), lattice(v, du)))
    view = unit(camera_mm.astype(np.float32) - points)
    towards = dot(view, normals)[..., None]
    normals *= np.where(towards < 0, np.float32(-1), np.float32(1))
    return SeenFilm(points, normals, view, np.maximum(np.abs(towards), np.float32(0.01)))


@lru_cache(maxsize=64)
def _spline_matrices(lines: tuple[float, ...], n: int) -> tuple[Float32[np.ndarray, "n m"], Float32[np.ndarray, "n m"]]:
    """What takes values on the m lattice lines of one axis to the cubic spline, and its slope, at n pixel centres."""
    spline, t = make_interp_spline(np.array(lines), np.eye(len(lines))), film_centres_1d(n)
    return spline(t).astype(np.float32), spline(t, nu=1).astype(np.float32)


def room_from_film(light: Light) -> Float[np.ndarray, "3 3"]:
    """Rotation from the film's world (x right, y down, z away) to the room's (z up)."""
    upright = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # down is the floor, away is horizontal
    lying = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])  # away is the floor
    turn = np.deg2rad(light.turn_deg)
    azimuth = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    return azimuth @ (lying if light.lying else upright)


def film_light(film: FilmMesh, scene: Scene, room: FilteredEnvironment) -> FilmLight:
    """Gain and veil over the film for one scene."""
    material, light, camera_mm = scene.material, scene.light, scene.camera.centre_world
    surface = gloss(material.roughness, material.ior, material.surfaces)
    lamps = tuple(patch for lamp in light.lamps for patch in lamp.placed(camera_mm).patches())
    smooth = seen_film(film, camera_mm, SMOOTH_LATTICE)
    panel = light_box_lamp(light.box, film, camera_mm) if light.box else None
    front, back = matt_light(smooth, light, room, surface, (lamps, panel))
    inside = 1 - surface.reflected(smooth.cosine)
    gain = inside * (material.diffuse * front + material.transmission * back)
    veil = inside * (material.haze * (front + back))
    n = max(glossy_lattice(material, scene.camera.size), SHADOW_LATTICE if scene.shadows else 0)
    fine = seen_film(film, camera_mm, n)
    gain, veil = (cv2.resize(x.astype(np.float32), (n, n), interpolation=cv2.INTER_LINEAR) for x in (gain, veil))
    if scene.shadows:
        shadow = film_shadow(scene.shadows, film.size_mm, n)[..., None]
        gain, veil = gain * shadow, veil * shadow
    if material.clear:
        gain += material.clear * (1 - surface.reflected(fine.cosine)) * light_behind(fine, light, room, (lamps, panel))
    veil += reflection(fine, light, room, surface)
    for lamp in lamps:
        veil += lamp_highlight(lamp, fine, surface)[..., None] * np.array(lamp.radiance, np.float32)
    return FilmLight(gain, veil)


def glossy_lattice(material: Material, photo_size: tuple[int, int]) -> int:
    """Film points along each side at which reflections are evaluated.

    A lobe's half width is 1.3 alpha rad, and reflected directions turn by about 3 rad over a bent film; finer than
    three photo pixels costs more than it shows.
    """
    return int(np.clip(4.0 / material.roughness**2, SMOOTH_LATTICE, max(0.3 * max(photo_size), 96)))


# ---------------------------------------------------------------- matt light

Sources = tuple[tuple[Lamp, ...], tuple[Lamp, LightBox] | None]
"""The lamps of a scene, in the film's world, and its light box with the rectangle that it shines from."""


def matt_light(
    seen: SeenFilm, light: Light, room: FilteredEnvironment, surface: Gloss, sources: Sources
) -> tuple[Float[np.ndarray, "m n 3"], Float[np.ndarray, "m n 3"]]:
    """Irradiance that enters the print, over pi (1 for even light of radiance 1), from the seen side and the other."""
    lamps, panel = sources
    turn = room_from_film(light).T.astype(np.float32)
    sides = []
    for normals in (seen.normals, -seen.normals):
        received = sample_irradiance(room, normals @ turn, surface.entry) * np.float32(light.front / np.pi)
        if panel:
            lamp, box = panel
            share, _ = surface_irradiance(vector_irradiance(lamp, seen.points), normals)
            share = share[..., None] / np.float32(np.pi)
            bright = box.brightness(_panel_uv(lamp, seen.points))[..., None] * np.array(lamp.radiance, np.float32)
            received = received * (1 - share) + share * bright
        sides.append(received)
    for lamp in lamps:
        vector = vector_irradiance(lamp, seen.points)
        filled = np.sqrt(dot(vector, vector)) / np.float32(np.pi)
        for side, normals in enumerate((seen.normals, -seen.normals)):
            received, cosine = surface_irradiance(vector, normals)
            # Entry is taken at the lamp's mean direction; a lamp that fills the hemisphere enters like even light.
            received *= (surface.entering(np.maximum(cosine, 0)) * (1 - filled) + filled) / np.float32(np.pi)
            sides[side] = sides[side] + received[..., None] * np.array(lamp.radiance, np.float32)
    return sides[0], sides[1]


def light_behind(
    seen: SeenFilm, light: Light, room: FilteredEnvironment, sources: Sources
) -> Float[np.ndarray, "m n 3"]:
    """Radiance that comes straight through the film: the room, lamps or the light box behind it."""
    lamps, panel = sources
    rays = -seen.view
    behind = sample_environment(room.environment, rays @ room_from_film(light).T.astype(np.float32))
    behind *= np.float32(light.front)
    for lamp in lamps:
        behind[lamp_seen(lamp, seen.points, rays)] = lamp.radiance
    if panel:
        lamp, box = panel
        hit = lamp_seen(lamp, seen.points, rays)
        depth = (np.array(lamp.centre_mm) - seen.points) @ np.array(lamp.axis) / (rays @ np.array(lamp.axis))
        uv = _panel_uv(lamp, (seen.points + rays * depth[..., None])[hit])
        behind[hit] = box.brightness(uv)[..., None] * np.array(lamp.radiance, np.float32)
    return behind


def light_box_lamp(box: LightBox, film: FilmMesh, camera_mm: Float[np.ndarray, "3"]) -> tuple[Lamp, LightBox]:
    """The box as a rectangle just behind the film, as the camera sees it, upright in the film's world."""
    points = film.vertices.reshape(-1, 3)
    centre, away = points.mean(axis=0), 1.0 if points[:, 2].mean() > camera_mm[2] else -1.0
    depth = (points[:, 2] * away).max() + box.gap_mm
    half = (box.size[0] * film.size_mm[1] / 2, box.size[1] * film.size_mm[0] / 2)
    at = (float(centre[0]), float(centre[1]), float(away * depth))
    return Lamp("rectangle", at, (0.0, 0.0, -away), (1.0, 0.0, 0.0), half, box.radiance), box


def _panel_uv(lamp: Lamp, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Where on the panel, (0, 0) to (1, 1), points lie that are moved onto it along its normal."""
    offset = (points - np.array(lamp.centre_mm))[..., :2] / np.array(lamp.half_mm)
    return np.clip((1 + offset) / 2, 0, 1)


# ---------------------------------------------------------------- reflections


def reflection(seen: SeenFilm, light: Light, room: FilteredEnvironment, surface: Gloss) -> Float[np.ndarray, "n n 3"]:
    """Radiance of the room in the film's glossy surface; even light comes out as the directional albedo times it."""
    n = len(seen.points)
    turn = room_from_film(light).T.astype(np.float32)
    if surface.alpha >= WIDE_ALPHA:
        stride = max(1, -(-n // int(np.clip(3.0 / surface.alpha, 10, 16))))
        every = slice(stride // 2, None, stride)
        around = wide_reflection(seen.part(every, every), room, turn, surface)
        around = cv2.resize(around, (n, n), interpolation=cv2.INTER_CUBIC)
    else:
        round_lobe = surface.alpha * float(np.sqrt(seen.cosine.mean()))  # the solid angle of a lobe falls with c_o
        around = sample_filtered(room, seen.mirror @ turn, float(np.sqrt(round_lobe)))
    return surface.reflected(seen.cosine) * np.float32(light.front) * np.maximum(around, 0)


WIDE_ALPHA = 0.1
"""Lobes from this width on are summed over the whole sphere. Narrower ones are nearly round, and are looked up blurred
about the mirror's direction: against sums of 1500 samples in six rooms the reflection differs by 4 % at roughness 0.2,
by 7 % at 0.3, and by 10 to 20 % from 0.5 on, where horizon and Fresnel term cut into the lobe; summed by 5 to 7 %."""


def wide_reflection(
    seen: SeenFilm, room: FilteredEnvironment, turn: Float[np.ndarray, "3 3"], surface: Gloss
) -> Float[np.ndarray, "m m 3"]:
    """Mean radiance of the room under a wide lobe, weighted by the BSDF, over a coarse image of all directions."""
    size = room.coarse.shape[:2]
    towards = directions(size).reshape(-1, 3) @ turn.T
    eye, normals = seen.view.reshape(-1, 3), seen.normals.reshape(-1, 3)
    o_h = np.sqrt(np.maximum((1 + eye @ towards.T) / 2, np.float32(1e-4)))
    n_i = normals @ towards.T
    n_h = (seen.cosine.reshape(-1, 1) + n_i) / (2 * o_h)
    alpha_sq = np.float32(surface.alpha**2)
    weight = smith(n_i, surface.alpha) * fresnel_reflectance(o_h, surface.ior, surface.surfaces)
    weight /= (n_h**2 * (alpha_sq - 1) + 1) ** 2  # f times c_i, without the factors of o alone: G1 is 0 below
    weight *= np.repeat(solid_angles(size), size[1]).astype(np.float32)
    total = weight @ room.coarse.reshape(-1, 3)
    return (total / np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)).reshape(seen.points.shape)


def lamp_highlight(lamp: Lamp, seen: SeenFilm, surface: Gloss) -> Float[np.ndarray, "n n"]:
    """Reflection of a lamp of radiance 1, on a coarse lattice and, where that cannot hold it, finer near its middle."""
    n = len(seen.points)
    stride = max(1, n // HIGHLIGHT_LATTICE)
    every = slice(stride // 2, None, stride)
    coarse = seen.part(every, every)
    wide = max(surface.alpha, 0.5 / len(coarse.points))  # half vectors turn by about 1 rad over the film
    rough = highlight(lamp, coarse.points, coarse.normals, coarse.view, surface, wide)
    if stride == 1:
        return rough
    values = cv2.resize(rough, (n, n), interpolation=cv2.INTER_LINEAR)
    if rough.max() > 0 and surface.alpha < 2.0 / len(rough):
        rows, cols = (np.flatnonzero((rough > 0.02 * rough.max()).any(axis=axis)) for axis in (1, 0))
        block = tuple(slice(max(int(k[0]) - 1, 0) * stride, (int(k[-1]) + 2) * stride) for k in (rows, cols))
        part = seen.part(*block)
        values[block] = highlight(lamp, part.points, part.normals, part.view, surface, max(surface.alpha, 0.5 / n))
    return values


HIGHLIGHT_LATTICE = 32
"""Film points along each side at which highlights of lamps are looked for."""
