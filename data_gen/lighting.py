"""What lights a film and how the film answers: records of material and light, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Material:
    """How the film answers to light.

    diffuse: share of the print's reflectance. transmission: share of light from behind that white lets through,
    scattered. clear: likewise unscattered. haze: grey that the sheet itself scatters. roughness: GGX. ior: of the
    surface. gloss: factor on the Fresnel reflection (1: one surface).
    """

    diffuse: float
    transmission: float
    clear: float
    haze: float
    roughness: float
    ior: float
    gloss: float


@dataclass(frozen=True)
class Light:
    """What lights the film besides the environment.

    light_box: True on a light box. box_radiance: its brightness, box_falloff: how it fades to its rim.
    front: factor on the environment's light. turn_deg: azimuth by which the room is turned, lying: film on its back.
    """

    light_box: bool
    box_radiance: float
    box_falloff: float
    front: float
    turn_deg: float
    lying: bool


def sample_material(rng: np.random.Generator) -> Material:
    glossy = rng.random() < 0.65
    return Material(
        diffuse=float(rng.uniform(0.2, 1.0)),
        transmission=float(rng.uniform(0.1, 0.9)),
        clear=float(rng.uniform(0, 0.6)) if rng.random() < 0.4 else 0.0,
        haze=float(10 ** rng.uniform(-3, -1.4)),
        roughness=float(rng.uniform(0.05, 0.35) if glossy else rng.uniform(0.35, 0.95)),
        ior=float(rng.uniform(1.3, 1.6)),
        gloss=float(rng.uniform(0.5, 2.0) if glossy else rng.uniform(0.1, 1.0)),
    )


def sample_light(rng: np.random.Generator, light_box_share: float) -> Light:
    light_box = bool(rng.random() < light_box_share)
    dark_room = light_box and rng.random() < 0.7
    return Light(
        light_box=light_box,
        box_radiance=float(rng.uniform(1.0, 6.0)),
        box_falloff=float(rng.uniform(0.0, 0.8)),
        front=float(rng.uniform(0.0, 0.15)) if dark_room else 1.0,
        turn_deg=float(rng.uniform(0, 360)),
        lying=bool(rng.random() < 0.4),
    )
