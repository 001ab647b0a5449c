"""What holds, touches or covers the film in a photo: hands, clips, tape; where they sit and their patches."""

from __future__ import annotations

import numpy as np

from data_gen.light.lit_sphere import LitSphere
from data_gen.scene.clips import Clip, clip_patch, sample_clips
from data_gen.scene.hands import Hand, hand_patch, sample_hands
from data_gen.scene.patches import Patch
from data_gen.scene.relief import Place
from hybrid.mesh.camera import Camera
from hybrid.mesh.film import FilmMesh

Thing = Hand | Clip

CLIP_SHARE = 0.3
"""Share of clips, magnets or tape among the photos in which something holds the film: the others show hands."""


def sample_things(lying: bool, rng: np.random.Generator) -> tuple[Thing, ...]:
    """One or more holders; mostly of one kind, a few photos show both."""
    draw = rng.random()
    hands = sample_hands(int(rng.choice([1, 2], p=[0.75, 0.25])), lying, rng) if draw > CLIP_SHARE else ()
    clips = sample_clips(int(rng.integers(1, 4)), rng) if draw < 1.3 * CLIP_SHARE else ()
    return clips + hands


def rim_place(film: FilmMesh, camera: Camera, edge: float) -> Place:
    """The film's rim in the photo at ``edge``: 0 to 4 from the top-left corner clockwise."""
    side, t = divmod(edge % 4, 1.0)
    u, v = ((t, 0.0), (1.0, t), (1 - t, 1.0), (0.0, 1 - t))[int(side)]
    inner = 0.04
    towards = ((0, inner), (-inner, 0), (0, -inner), (inner, 0))[int(side)]
    corner = np.clip(1 - 8 * min(t, 1 - t), 0, 0.5) * (1 if t < 0.5 else -1)  # near a corner it points to the middle
    aside = (towards[1] * corner, -towards[0] * corner)
    inner_u, inner_v = u + towards[0] + aside[0], v + towards[1] + aside[1]
    points = np.concatenate([film.surface(np.array([a]), np.array([b]))[0] for a, b in ((u, v), (inner_u, inner_v))])
    at, inside = camera.photo_from_world(points)
    depth = camera.camera_points(points)[0, 2]
    way = inside - at
    return Place(at, way / max(float(np.linalg.norm(way)), 1e-9), float(camera.intrinsics[0, 0] / depth))


def patches_before(
    things: tuple[Thing, ...], film: FilmMesh, camera: Camera, ball: LitSphere, steel: LitSphere
) -> list[Patch]:
    """Patches of everything in front of the film, the lowest first."""
    found = []
    for thing in things:
        place = rim_place(film, camera, thing.edge)
        if isinstance(thing, Clip):
            found.append(clip_patch(thing, place, ball, steel, camera.size))
        else:
            found.append(hand_patch(thing, place, ball, camera.size, front=True))
    return [patch for patch in found if patch is not None]


def patches_behind(things: tuple[Thing, ...], film: FilmMesh, camera: Camera, ball: LitSphere) -> list[Patch]:
    """Patches of the hands behind the film, to be put over the background."""
    hands = [t for t in things if isinstance(t, Hand) and t.behind]
    found = [hand_patch(h, rim_place(film, camera, h.edge), ball, camera.size, front=False) for h in hands]
    return [patch for patch in found if patch is not None]
