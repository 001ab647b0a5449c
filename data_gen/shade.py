"""Linear light that leaves the film, computed in film space: smooth light on a lattice, print detail multiplied in.

radiance = diffuse T E(n) / pi + transmission T E_back(-n) / pi + clear T L(behind) + haze E(n) / pi + gloss F L(mirror)

with T the print's linear reflectance, E irradiance, L the environment's radiance and F Schlick's Fresnel term.
Light varies slowly over the film, so it is evaluated on a lattice of film points and enlarged to the print.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from data_gen.lighting import Light
from data_gen.rooms import FilteredEnvironment, sample_environment, sample_filtered, sample_irradiance
from data_gen.scene import Scene
from hybrid.coords import film_centres_1d, linear_from_srgb
from hybrid.mesh.film import FilmMesh

LIGHT_LATTICE = 96
"""Film points along each side at which light is evaluated: 4 mm on a 35 x 43 cm film."""

_SRGB_LINEAR = linear_from_srgb(np.arange(256) / 255).astype(np.float32)


@dataclass(frozen=True, eq=False)
class FilmLight:
    """What the light does to the print: radiance = gain * T + veil, in film space, linear RGB.

    gain, veil: (n, n, 3) float32 on the pixel centres of an n x n film image.
    """

    gain: Float[np.ndarray, "n n 3"]
    veil: Float[np.ndarray, "n n 3"]


def room_from_film(light: Light) -> Float[np.ndarray, "3 3"]:
    """Rotation from the film's world (x right, y down, z away) to the room's (z up)."""
    upright = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # down is the floor, away is horizontal
    lying = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])  # away is the floor
    turn = np.deg2rad(light.turn_deg)
    azimuth = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    return azimuth @ (lying if light.lying else upright)


def film_light(
    film: FilmMesh, scene: Scene, room: FilteredEnvironment, rng: np.random.Generator, n: int = LIGHT_LATTICE
) -> FilmLight:
    """Gain and veil over the film for one scene."""
    t = film_centres_1d(n)
    points, normals = film.surface(t, t), film.normals(t, t)
    view = scene.camera.centre_world - points
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    towards = (view * normals).sum(axis=-1, keepdims=True)
    normals = np.where(towards < 0, -normals, normals)  # of the side that is seen: the film's back, if that faces it
    cosine = np.clip(np.abs(towards), 0.02, 1.0)
    turn = room_from_film(scene.light).T
    material, light = scene.material, scene.light
    front = sample_irradiance(room, normals @ turn) * (light.front / np.pi)
    mirror = 2 * cosine * normals - view
    reflected = sample_filtered(room, mirror @ turn, material.roughness) * light.front
    f0 = ((material.ior - 1) / (material.ior + 1)) ** 2
    fresnel = f0 + (1 - f0) * (1 - cosine) ** 5
    if light.light_box:
        behind = back = light_box_radiance(t, light, rng)
    else:
        back = sample_irradiance(room, -normals @ turn) / np.pi
        behind = sample_environment(room.environment, -view @ turn)
    gain = material.diffuse * front + material.transmission * back + material.clear * behind
    veil = material.haze * (front + back) + material.gloss * fresnel * reflected
    if scene.shadow:
        gain = gain * soft_shadow(n, rng)[..., None]
    return FilmLight(gain.astype(np.float32), veil.astype(np.float32))


def film_radiance(image: Float[np.ndarray, "h w"], light: FilmLight) -> Float[np.ndarray, "h w 3"]:
    """Linear radiance (float32) of the print ``image`` (display grey) under ``light``."""
    reflectance = _SRGB_LINEAR[np.clip(np.rint(image * 255), 0, 255).astype(np.uint8)]
    size = image.shape[::-1]
    radiance = cv2.resize(light.gain, size, interpolation=cv2.INTER_LINEAR)
    radiance *= reflectance[..., None]
    radiance += cv2.resize(light.veil, size, interpolation=cv2.INTER_LINEAR)
    return radiance


def light_box_radiance(t: np.ndarray, light: Light, rng: np.random.Generator) -> Float[np.ndarray, "n n 3"]:
    """Radiance of the light box behind each film point: bright around some point, fading to the rim; tubes on some."""
    u, v = np.meshgrid(t, t)
    cu, cv_ = rng.uniform(0.2, 0.8, 2)
    spread = rng.uniform(0.4, 1.2)
    fade = 1 - light.box_falloff * (1 - np.exp(-((u - cu) ** 2 + (v - cv_) ** 2) / (2 * spread**2)))
    if rng.random() < 0.3:
        fade *= 1 + 0.15 * np.cos(2 * np.pi * (rng.uniform(2, 6) * (u if rng.random() < 0.5 else v)))
    colour = np.exp2(rng.normal(0, [0.1, 0.02, 0.1]))
    return light.box_radiance * fade[..., None] * colour


def soft_shadow(n: int, rng: np.random.Generator) -> Float[np.ndarray, "n n"]:
    """Factor on the light over the film where a hand or the phone stands in it: soft-edged, 0.3 to 0.95 deep."""
    mask = np.zeros((n, n), np.float32)
    for _ in range(int(rng.integers(1, 4))):
        centre = tuple(int(c) for c in rng.uniform(-0.2, 1.2, 2) * n)
        axes = tuple(int(a) for a in rng.uniform(0.08, 0.6, 2) * n)
        cv2.ellipse(mask, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1.0, -1)
    soft = cv2.GaussianBlur(mask, (0, 0), float(rng.uniform(0.01, 0.12)) * n)
    return 1 - rng.uniform(0.05, 0.7) * soft
