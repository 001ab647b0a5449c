"""What a photo is taken of and how: viewpoint, light, material, surroundings and lens, drawn at random."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from data_gen.camera.develop import Lens, sample_lens
from data_gen.camera.viewpoint import ViewConfig, sample_camera
from data_gen.light.lighting import (
    CLEAR_SHARE,
    Light,
    Material,
    over_table,
    sample_light,
    sample_material,
    smallest_rotation,
    some_mirrored,
)
from data_gen.light.onlookers import Billboard, sample_onlookers
from data_gen.scene.backdrop import Backdrop, sample_backdrop
from data_gen.scene.shadows import Shadow, sample_shadows
from data_gen.scene.things import Thing, sample_things
from hybrid.mesh.camera import Camera
from hybrid.mesh.film import FilmMesh

REACH_BEHIND_MM = 40.0
"""A hand needs this much room behind the film."""

TOUCHING_MM = 15.0
"""Distance of a clear film from its ground at which the print's shadow there no longer lies behind the print."""


@dataclass(frozen=True)
class SceneConfig:
    """Ranges from which scenes are drawn.

    light_box_share: films on a light box instead of in a room (PAPER: 20 %). thing_share: photos with hands, clips or
    tape at the film's rim. shadow_share: photos with shadows cast on the film. clear_share: films with a clear base, of
    those whose background would show through it. view: of the camera.
    """

    light_box_share: float = 0.2
    thing_share: float = 0.3
    shadow_share: float = 0.3
    clear_share: float = CLEAR_SHARE
    view: ViewConfig = field(default_factory=ViewConfig)


@dataclass(frozen=True, eq=False)
class Scene:
    """One photograph about to be taken."""

    camera: Camera
    material: Material
    light: Light
    lens: Lens
    backdrop: Backdrop
    things: tuple[Thing, ...]
    shadows: tuple[Shadow, ...]
    onlookers: tuple[Billboard, ...] = ()

    def parameters(self) -> dict[str, Any]:
        """Everything but the camera, JSON-able."""
        things = [{"thing": type(t).__name__.lower()} | asdict(t) for t in self.things]
        rest = {"things": things} | {k: [asdict(s) for s in getattr(self, k)] for k in ("shadows", "onlookers")}
        return {k: asdict(getattr(self, k)) for k in ("material", "light", "lens", "backdrop")} | rest


def placed(film: FilmMesh) -> FilmMesh:
    """A bent film moved to where scenes have it: its middle at the world's origin, its plane that of a flat film.

    The forces that bend a film may move it and turn it over; it is turned back by the smallest rotation.
    """
    points = film.vertices - film.vertices.mean(axis=(0, 1))
    normal = np.linalg.svd(points.reshape(-1, 3), full_matrices=False)[2][2]
    facing = film.normals(film.u_lines, film.v_lines).mean(axis=(0, 1))
    turn = smallest_rotation(normal * np.copysign(1.0, normal @ facing), np.array([0.0, 0.0, -1.0]))
    return film.bent(points @ turn.T)


def sample_scene(film: FilmMesh, size: tuple[int, int], rng: np.random.Generator, config: SceneConfig) -> Scene:
    """A random scene for a bent film, ``placed``, and a photo of ``size`` (height, width)."""
    camera = sample_camera(film, size, rng, config.view)
    light = over_table(sample_light(rng, config.light_box_share), camera.centre_world)
    light = some_mirrored(light, film, camera, rng)
    backdrop = sample_backdrop(light, rng)
    lying = light.light_box or (backdrop.kind in ("table", "wall") and backdrop.gap_mm < REACH_BEHIND_MM)
    things = sample_things(lying, rng) if rng.random() < config.thing_share else ()
    shadows = sample_shadows(rng) if rng.random() < config.shadow_share else ()
    clear_share = config.clear_share if light.light_box or backdrop.kind != "dark" else 0.0
    material, lens = sample_material(rng, clear_share), sample_lens(rng)
    return Scene(camera, material, light, lens, backdrop, things, shadows, sample_onlookers(rng))


def passes(scene: Scene) -> float:
    """How often light passes through the print: light from a table that touches a clear film came through it, too."""
    material, ground = scene.material, scene.backdrop
    if scene.light.box or ground.kind not in ("table", "wall"):
        return 1.0
    straight = material.clear / (material.clear + material.transmission + material.diffuse)
    return 1.0 + straight * float(np.exp(-ground.gap_mm / TOUCHING_MM))
