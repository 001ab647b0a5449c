"""A flat film, a camera in front of it and even or made-up light: shared by the tests of a photo's surroundings."""

from dataclasses import replace

import numpy as np

from data_gen.camera.develop import sample_lens
from data_gen.light.lighting import Light, sample_material
from data_gen.light.rooms import Environment, prefilter
from data_gen.scene.backdrop import sample_backdrop
from data_gen.scene.scene import Scene
from hybrid.mesh.camera import Camera, look_at
from hybrid.mesh.film import film_mesh

SIZE = (96, 120)
FILM = film_mesh((430.0, 350.0), np.linspace(0.1, 0.9, 5), np.linspace(0.1, 0.9, 7), 1)


def camera(size=SIZE, distance_mm=900.0, tilt=0.0) -> Camera:
    """A camera in front of the film, aimed at its middle from ``tilt`` radians to the side."""
    eye = distance_mm * np.array([np.sin(tilt), 0.2 * np.sin(tilt), -np.cos(tilt)])
    focal = 1.5 * size[0]
    intrinsics = np.array([[focal, 0, size[1] / 2], [0, focal, size[0] / 2], [0, 0, 1]])
    return Camera(intrinsics, look_at(eye, np.zeros(3), np.array([0, 1.0, 0])), (0.01, 0.0), size)


def even_room(radiance=1.0):
    """Light that is the same from every direction."""
    return prefilter(Environment(np.full((32, 64, 3), radiance, np.float32), "even"))


def scene(kind="table", seed=0, light=None, held=(), **changes) -> Scene:
    """A scene with a backdrop of one kind."""
    rng = np.random.default_rng(seed)
    light = light or Light(front=1.0, turn_deg=30.0, lying=kind == "table")
    backdrop = replace(sample_backdrop(light, rng), kind=kind, **changes)
    return Scene(camera(tilt=0.3), sample_material(rng), light, sample_lens(rng), backdrop, held, ())
