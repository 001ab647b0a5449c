"""Linear light that leaves the film, computed in film space: smooth light on a lattice, print detail multiplied in.

The film is a thin sheet with a print of linear reflectance T below a glossy surface; both sides behave alike. With o
towards the eye, i towards the light, c their cosines to the normal, R the surface's directional albedo and M its
cosine-weighted mean, the sheet scatters by

    f(i, o) = gloss                   F D G1(i) G1(o) / (4 c_i c_o)               i and o on one side
            + (T diffuse + haze)      (1 - R(i)) (1 - R(o)) / (pi (1 - M))        i and o on one side
            + (T transmission + haze) (1 - R(i)) (1 - R(o)) / (pi (1 - M))        i and o on different sides
            + T clear                 (1 - R(o)) delta(i = -o)                    straight through

What the surface does not reflect enters, so the lobes below it share 1 - R (Kelemen and Szirmay-Kalos 2001, the
`roughplastic` of Mitsuba): whatever the roughness, a sheet with diffuse + transmission + clear + 2 haze = 1 and T = 1
loses nothing, all drawn parameters reflect and transmit at most what comes in, and f(i, o) = f(o, i).
Left out: light that the film's far surface reflects back through the print, shadows of the film on itself and light
from one part of it on another, whose size benchmarks/radiance.py states; and the table or wall behind a film where its
surface mirrors that instead of the room.

Light varies slowly over the film, so radiance = gain * T + veil is evaluated on a lattice of film points and enlarged
to the print; the more mirror-like the film, the finer the lattice.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from data_gen.light.gloss import Gloss, gloss
from data_gen.light.lamps import Lamp, lamp_seen, surface_irradiance, vector_irradiance
from data_gen.light.lighting import LightBox, Material, room_from_film
from data_gen.light.onlookers import left_free
from data_gen.light.rooms import FilteredEnvironment, sample_environment, sample_irradiance
from data_gen.render.reflections import lamp_highlight, reflection
from data_gen.render.seen_film import SeenFilm, seen_film
from data_gen.scene.scene import Scene
from data_gen.scene.shadows import film_shadow
from hybrid.mesh.film import FilmMesh
from hybrid.mesh.vectors import dot, turned

SMOOTH_LATTICE = 48
"""Film points along each side at which matt light is evaluated: 9 mm on a 35 x 43 cm film."""

SHADOW_LATTICE = 160
"""Likewise where something casts a shadow: 3 mm, the least width of the sun's penumbra a metre away."""


@dataclass(frozen=True, eq=False)
class FilmLight:
    """What the light does to the print: radiance = gain * T + veil, in film space, linear RGB.

    gain, veil: (n, n, 3) float32 on the pixel centres of an n x n film image.
    """

    gain: Float[np.ndarray, "n n 3"]
    veil: Float[np.ndarray, "n n 3"]

    def __add__(self, other: FilmLight) -> FilmLight:
        return FilmLight(self.gain + other.gain, self.veil + other.veil)


Sources = tuple[tuple[Lamp, ...], tuple[Lamp, LightBox] | None]
"""The lamps of a scene, in the film's world, and its light box with the rectangle that it shines from."""


@dataclass(frozen=True, eq=False)
class LitFilm:
    """The film of a scene, ready to be lit from either side.

    film: bent. smooth: the points at which matt light is evaluated. fine: those of reflections, n x n. surface: its
    gloss. sources: near it. inside: (m, m, 1) share of uniform light that comes out through the surface, on the smooth
    points. shadow: (n, n, 1) factor on matt light of the seen side; everything that casts shadows is on that side.
    """

    film: FilmMesh
    scene: Scene
    smooth: SeenFilm
    fine: SeenFilm
    surface: Gloss
    sources: Sources
    inside: Float[np.ndarray, "m m 1"]
    shadow: Float[np.ndarray, "n n 1"]

    def matt(self, values: Float[np.ndarray, "m m 3"]) -> Float[np.ndarray, "n n 3"]:
        """Matt light on the fine points."""
        return cv2.resize(values.astype(np.float32), self.shadow.shape[1::-1], interpolation=cv2.INTER_LINEAR)


@dataclass(frozen=True, eq=False)
class Behind:
    """What reaches the film's far side.

    straight: (k, k, 3) radiance that a clear film shows, over the film. irradiance: (m, m, 3) that enters the print,
    divided by pi, on the smooth points.
    """

    straight: Float[np.ndarray, "k k 3"]
    irradiance: Float[np.ndarray, "m m 3"]


def film_light(film: FilmMesh, scene: Scene, room: FilteredEnvironment) -> FilmLight:
    """Gain and veil over the film for one scene whose room, lamps and light box are all there is behind it."""
    lit = lit_film(film, scene)
    return light_before(lit, room) + light_through(lit, room_behind(lit, room))


def lit_film(film: FilmMesh, scene: Scene) -> LitFilm:
    """The lattices of film points for one scene, its surface, and what shines near it."""
    material, light, camera_mm = scene.material, scene.light, scene.camera.centre_world
    surface = gloss(material.roughness, material.ior, material.surfaces)
    lamps = tuple(patch for lamp in light.lamps for patch in lamp.placed(camera_mm).patches())
    panel = light_box_lamp(light.box, film, camera_mm) if light.box else None
    smooth = seen_film(film, camera_mm, SMOOTH_LATTICE)
    n = max(glossy_lattice(material, scene.camera.size), SHADOW_LATTICE if scene.shadows else 0)
    shadow = film_shadow(scene.shadows, film.size_mm, n)[..., None]
    inside = np.asarray(1 - surface.reflected(smooth.cosine))
    return LitFilm(film, scene, smooth, seen_film(film, camera_mm, n), surface, (lamps, panel), inside, shadow)


def light_before(lit: LitFilm, room: FilteredEnvironment) -> FilmLight:
    """What light on the seen side does: the print scatters it and the surface reflects it."""
    material, (lamps, _) = lit.scene.material, lit.sources
    entering = lit.inside * entering_light(lit, lit.smooth.normals, room)
    veil = lit.matt(material.haze * entering) * lit.shadow + reflection(lit.fine, lit.scene, room, lit.surface)
    for lamp in lamps:
        shown = lamp_highlight(lamp, lit.fine, lit.surface)
        if shown.any():
            hidden = lit.scene.camera, lit.fine.points, lit.fine.mirror, lit.surface.alpha, np.array(lamp.centre_mm)
            shown = shown * left_free(lit.scene.onlookers, *hidden)
        veil += shown[..., None] * np.array(lamp.radiance, np.float32)
    base = np.array(material.tint, np.float32) ** 2  # once in, once out
    return FilmLight(lit.matt(material.diffuse * entering) * lit.shadow * base, veil)


def light_through(lit: LitFilm, behind: Behind) -> FilmLight:
    """What light on the far side does: the print scatters it on its way, or it goes straight through."""
    material = lit.scene.material
    entering = lit.inside * behind.irradiance
    gain = lit.matt(material.transmission * entering)
    if material.clear:
        straight = cv2.resize(behind.straight, gain.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        gain += np.float32(material.clear) * (1 - lit.surface.reflected(lit.fine.cosine)) * straight
    return FilmLight(gain * np.array(material.tint, np.float32), lit.matt(material.haze * entering))


def glossy_lattice(material: Material, photo_size: tuple[int, int]) -> int:
    """Film points along each side at which reflections are evaluated.

    A lobe's half width is 1.3 alpha rad, and reflected directions turn by about 3 rad over a bent film; a lattice finer
    than three photo pixels costs more than it shows.
    """
    return int(np.clip(4.0 / material.roughness**2, SMOOTH_LATTICE, max(0.3 * max(photo_size), 96)))


# ---------------------------------------------------------------- light on either side


def entering_light(
    lit: LitFilm, normals: Float[np.ndarray, "m m 3"], room: FilteredEnvironment
) -> Float[np.ndarray, "m m 3"]:
    """Irradiance entering the print on one side, over pi (1 for uniform light of radiance 1). normals: of that side."""
    (lamps, panel), points, light = lit.sources, lit.smooth.points, lit.scene.light
    entering = sample_irradiance(room, turned(normals, room_from_film(light)), lit.surface.entry) * np.float32(
        light.front / np.pi
    )
    if panel:
        lamp, box = panel
        share, _ = surface_irradiance(vector_irradiance(lamp, points), normals)
        share = share[..., None] / np.float32(np.pi)
        bright = box.brightness(_panel_uv(lamp, points))[..., None] * np.array(lamp.radiance, np.float32)
        entering = entering * (1 - share) + share * bright
    for lamp in lamps:
        vector = vector_irradiance(lamp, points)
        filled = np.sqrt(dot(vector, vector)) / np.float32(np.pi)
        received, cosine = surface_irradiance(vector, normals)
        # Entry is taken at the lamp's mean direction; a lamp that fills the hemisphere enters like uniform light.
        received *= (lit.surface.entering(np.maximum(cosine, 0)) * (1 - filled) + filled) / np.float32(np.pi)
        entering = entering + received[..., None] * np.array(lamp.radiance, np.float32)
    return entering


def room_behind(lit: LitFilm, room: FilteredEnvironment) -> Behind:
    """The room, lamps and the light box behind the film, with nothing in between."""
    return Behind(_room_straight(lit, room), entering_light(lit, -lit.smooth.normals, room))


def _room_straight(lit: LitFilm, room: FilteredEnvironment) -> Float[np.ndarray, "n n 3"]:
    """Radiance that comes straight through the film; nothing is looked up for a film that is not clear."""
    if not lit.scene.material.clear:
        return np.zeros((1, 1, 3), np.float32)
    (lamps, panel), light, points, rays = lit.sources, lit.scene.light, lit.fine.points, -lit.fine.view
    behind = sample_environment(room.environment, turned(rays, room_from_film(light)))
    behind *= np.float32(light.front)
    for lamp in lamps:
        behind[lamp_seen(lamp, points, rays)] = lamp.radiance
    if panel:
        lamp, box = panel
        hit = lamp_seen(lamp, points, rays)
        depth = (np.array(lamp.centre_mm) - points) @ np.array(lamp.axis) / (rays @ np.array(lamp.axis))
        uv = _panel_uv(lamp, (points + rays * depth[..., None])[hit])
        behind[hit] = box.brightness(uv)[..., None] * np.array(lamp.radiance, np.float32)
    return behind


def light_box_lamp(box: LightBox, film: FilmMesh, camera_mm: Float[np.ndarray, "3"]) -> tuple[Lamp, LightBox]:
    """The box as a rectangle just behind the film, as the camera sees it, upright in the film's world.

    Its first side runs to the right as seen.
    """
    points = film.vertices.reshape(-1, 3)
    centre, away = points.mean(axis=0), 1.0 if points[:, 2].mean() > camera_mm[2] else -1.0
    depth = (points[:, 2] * away).max() + box.gap_mm
    half = (box.size[0] * film.size_mm[1] / 2, box.size[1] * film.size_mm[0] / 2)
    right, down = box_offset_mm(box, film)
    at = (float(centre[0] + away * right), float(centre[1] + down), float(away * depth))
    return Lamp("rectangle", at, (0.0, 0.0, -away), (away, 0.0, 0.0), half, box.radiance), box


def box_offset_mm(box: LightBox, film: FilmMesh) -> tuple[float, float]:
    """Offset of a light box's middle from the film's, to the right and down as seen."""
    return box.offset[0] * film.size_mm[1], box.offset[1] * film.size_mm[0]


def _panel_uv(lamp: Lamp, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Positions on the panel, (0, 0) to (1, 1) right and down, of points projected onto it along its normal."""
    offset = (points - np.array(lamp.centre_mm))[..., :2] * [lamp.across[0], 1.0] / np.array(lamp.half_mm)
    return np.clip((1 + offset) / 2, 0, 1)
