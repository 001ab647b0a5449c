"""Light as a function of the normal: what a ball shows to the camera, looked up for every other shape.

Sloan et al. 2001, "The lit sphere". The environment is infinitely far and the things are small in the field of view,
so one direction of view serves for all of them, and one lookup by normal replaces two on the sphere.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from data_gen.light.lamps import Lamp, surface_irradiance, vector_irradiance
from data_gen.light.lighting import Light
from data_gen.light.rooms import FilteredEnvironment, sample_filtered, sample_irradiance
from hybrid.coords import film_centres, sample_bilinear

BALL = 48
"""Side of the ball's picture in pixels."""


PANEL_SHARE = 0.1
"""Share of the half-space behind a hand that a light box shines from: film and hand hide most of it."""


@dataclass(frozen=True, eq=False)
class LitSphere:
    """Radiance of a white matt ball and of one with a glossy or metal surface, in the light of one scene.

    matt: (n, n, 3) by normal (x, y) in [-1, 1]^2 in camera axes; normals that face away are taken at the outline.
    gloss: likewise, mirror reflection times Fresnel's factor.
    """

    matt: Float[np.ndarray, "n n 3"]
    gloss: Float[np.ndarray, "n n 3"]

    @property
    def facing(self) -> Float[np.ndarray, "3"]:
        """Radiance of a white matt surface that faces the camera."""
        return self.matt[BALL // 2, BALL // 2]


def lit_sphere(
    light: Light, room: FilteredEnvironment, room_from_camera: Float[np.ndarray, "3 3"], roughness: float, f0: float
) -> LitSphere:
    """The ball at the place of the film. f0: reflection at normal incidence (0.03 skin, 0.7 steel)."""
    normals, to_room = ball_normals(), room_from_camera.T
    facing = -normals[..., 2:]
    mirror = 2 * facing * normals - [0.0, 0.0, -1.0]
    fresnel = f0 + (1 - f0) * (1 - facing) ** 5 * (1 - roughness)  # rough surfaces shine less at grazing angles
    matt = sample_irradiance(room, normals @ to_room) * (light.front / np.pi)
    if light.light_box:  # if the panel filled the back, its share of the cosine lobe would be (1 - cos) / 2
        matt = matt + PANEL_SHARE * 0.5 * light.box_radiance * (1 - facing)
    gloss = sample_filtered(room, mirror @ to_room, roughness) * light.front * fresnel
    return LitSphere(matt.astype(np.float32), gloss.astype(np.float32))


def with_lamps(ball: LitSphere, lamps: Iterable[Lamp], world_from_camera: Float[np.ndarray, "3 3"]) -> LitSphere:
    """The ball lit by ``lamps`` as well, which are placed in the film's world; its gloss stays as it is."""
    normals = (ball_normals() @ world_from_camera.T).astype(np.float32)
    matt = ball.matt
    for lamp in lamps:
        vector = np.broadcast_to(vector_irradiance(lamp, np.zeros((1, 1, 3))), normals.shape)
        received, _ = surface_irradiance(vector, normals)
        matt = matt + received[..., None] / np.float32(np.pi) * np.array(lamp.radiance, np.float32)
    return LitSphere(matt, ball.gloss)


def ball_normals() -> Float[np.ndarray, "n n 3"]:
    """Unit normals in camera axes (towards the camera is -z) of the ball's pixels; beyond the ball, its outline's."""
    xy = (film_centres((BALL, BALL)) - np.array(0.5)) * np.array(2.0)
    xy = xy / np.maximum(np.linalg.norm(xy, axis=-1, keepdims=True), 1.0)
    return np.concatenate([xy, -np.sqrt(np.maximum(1 - (xy**2).sum(axis=-1, keepdims=True), 0.0))], axis=-1)


def look_up(ball: Float[np.ndarray, "n n 3"], normal_xy: Float[np.ndarray, "h w 2"]) -> Float[np.ndarray, "h w 3"]:
    """The ball's radiance at normals whose first two camera coordinates are given."""
    return sample_bilinear(ball, (normal_xy + np.array(1, normal_xy.dtype)) * np.array(BALL / 2, normal_xy.dtype))
