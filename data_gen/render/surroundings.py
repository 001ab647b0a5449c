"""Everything in a photo but the film: what is behind it and what is in front of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from data_gen.light.lighting import room_from_film
from data_gen.light.lit_sphere import lit_sphere, with_lamps
from data_gen.light.rooms import FilteredEnvironment
from data_gen.render.background import background
from data_gen.scene.patches import Patch, put_over
from data_gen.scene.scene import Scene
from data_gen.scene.things import patches_before, patches_behind
from hybrid.mesh.film import FilmMesh

SKIN = (0.42, 0.028)
"""Roughness and reflection at normal incidence of skin (index 1.4); plastics are near enough."""

STEEL = (0.2, 0.62)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """behind: linear radiance behind the film over the whole photo. before: what covers it, the lowest first."""

    behind: Float[np.ndarray, "h w 3"]
    before: tuple[Patch, ...]


def surroundings(scene: Scene, film: FilmMesh, room: FilteredEnvironment, base: Float[np.ndarray, "3"]) -> Surroundings:
    """What is around the film. base: radiance of its unprinted rim, which a dark background may equal."""
    behind = background(scene, film, room, base)
    if not scene.things:
        return Surroundings(behind, ())
    room_from_camera = room_from_film(scene.light) @ scene.camera.camera_from_world[:3, :3].T
    ball, steel = (lit_sphere(scene.light, room, room_from_camera, *surface) for surface in (SKIN, STEEL))
    lamps = [lamp.placed(scene.camera.centre_world) for lamp in scene.light.lamps]
    ball = with_lamps(ball, lamps, scene.camera.camera_from_world[:3, :3].T)
    behind = put_over(behind, patches_behind(scene.things, film, scene.camera, ball))
    return Surroundings(behind, tuple(patches_before(scene.things, film, scene.camera, ball, steel)))
