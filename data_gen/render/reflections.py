"""What a glossy film shows as a mirror does: the room, blurred by the lobe's width, and lamps, one by one."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float

from data_gen.light.gloss import Gloss, smith
from data_gen.light.gloss import fresnel as fresnel_reflectance
from data_gen.light.lamps import Lamp, highlight
from data_gen.light.lighting import room_from_film
from data_gen.light.onlookers import mirrored_onlookers
from data_gen.light.rooms import FilteredEnvironment, directions, sample_filtered, solid_angles
from data_gen.render.seen_film import SeenFilm
from data_gen.scene.scene import Scene
from hybrid.mesh.vectors import turned


def reflection(seen: SeenFilm, scene: Scene, room: FilteredEnvironment, surface: Gloss) -> Float[np.ndarray, "n n 3"]:
    """Radiance of the room and the onlookers in it, reflected by the film's glossy surface; uniform light is multiplied
    by the directional albedo."""
    n, light = len(seen.points), scene.light
    turn = room_from_film(light)
    if surface.alpha >= WIDE_ALPHA:
        stride = max(1, -(-n // int(np.clip(3.0 / surface.alpha, 10, 16))))
        every = slice(stride // 2, None, stride)
        around = _between(wide_reflection(seen.part(every, every), room, turn, surface), n, stride, cv2.INTER_CUBIC)
    else:
        round_lobe = surface.alpha * float(np.sqrt(seen.cosine.mean()))  # the solid angle of a lobe falls with c_o
        around = sample_filtered(room, turned(seen.mirror, turn), float(np.sqrt(round_lobe)))
    mean = np.average(room.coarse.mean(axis=1), axis=0, weights=solid_angles(room.coarse.shape[:2]).ravel())
    around = mirrored_onlookers(
        scene.onlookers, scene.camera, seen.points, seen.mirror, surface.alpha, np.maximum(around, 0), mean
    )
    return surface.reflected(seen.cosine) * np.float32(light.front) * around


WIDE_ALPHA = 0.1
"""Lobes of at least this width are summed over the whole sphere. Narrower ones are nearly round, so a blurred room is
looked up in the mirror's direction: compared with sums of 1500 samples in six rooms, the lookup differs by 4 % at
roughness 0.2, by 7 % at 0.3, and by 10 to 20 % from 0.5 on, where horizon and Fresnel term cut into the lobe; the sum
over the sphere differs by 5 to 7 %."""


def wide_reflection(
    seen: SeenFilm, room: FilteredEnvironment, turn: Float[np.ndarray, "3 3"], surface: Gloss
) -> Float[np.ndarray, "m m 3"]:
    """Mean radiance of the room under a wide lobe, weighted by the BSDF, over a coarse image of all directions.

    turn: from the film's world to the room.
    """
    size = room.coarse.shape[:2]
    towards = directions(size).reshape(-1, 3) @ turn.astype(np.float32)
    eye, normals = seen.view.reshape(-1, 3), seen.normals.reshape(-1, 3)
    o_h = np.sqrt(np.maximum((1 + eye @ towards.T) / 2, np.float32(1e-4)))
    n_i = normals @ towards.T
    n_h = (seen.cosine.reshape(-1, 1) + n_i) / (2 * o_h)
    alpha_sq = np.float32(surface.alpha**2)
    weight = smith(n_i, surface.alpha) * fresnel_reflectance(o_h, surface.ior, surface.surfaces)
    weight /= (n_h**2 * (alpha_sq - 1) + 1) ** 2  # f times c_i, without factors of o alone: G1 is 0 below the horizon
    weight *= np.repeat(solid_angles(size), size[1]).astype(np.float32)
    total = weight @ room.coarse.reshape(-1, 3)
    return (total / np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)).reshape(seen.points.shape)


def _between(
    coarse: Float[np.ndarray, "m m *c"], n: int, stride: int, interpolation: int
) -> Float[np.ndarray, "n n *c"]:
    """All n values along each side, from every ``stride``-th of them: those of ``slice(stride // 2, None, stride)``.
    ``cv2.resize`` would take these for the centres of equal parts of the side. That is wrong if the last part is
    shorter or a part has no central value.
    """
    at = ((np.arange(n) - stride // 2) / stride).astype(np.float32)
    return cv2.remap(coarse, *np.meshgrid(at, at), interpolation, borderMode=cv2.BORDER_REPLICATE)


def lamp_highlight(lamp: Lamp, seen: SeenFilm, surface: Gloss) -> Float[np.ndarray, "n n"]:
    """Reflection of a lamp of radiance 1, on a coarse lattice and, where that is too coarse, finer near its peak."""
    n = len(seen.points)
    stride = max(1, n // HIGHLIGHT_LATTICE)
    every = slice(stride // 2, None, stride)
    coarse = seen.part(every, every)
    wide, sharp = (max(surface.alpha, 0.5 / k) for k in (len(coarse.points), n))  # half vectors turn by about 1 rad
    rough = highlight(lamp, coarse.points, coarse.normals, coarse.view, surface, wide)
    if stride == 1:
        return rough
    if rough.max() == 0 or surface.alpha >= 2.0 / len(rough):
        return _between(rough, n, stride, cv2.INTER_LINEAR)
    seen_from = min(0.02 * rough.max(), FAINT / np.mean(lamp.radiance))
    rows, cols = (np.flatnonzero((rough > seen_from).any(axis=axis)) for axis in (1, 0))
    block = tuple(slice(max(int(k[0]) - 1, 0) * stride, (int(k[-1]) + 2) * stride) for k in (rows, cols))
    part, tails = seen.part(*block), highlight(lamp, coarse.points, coarse.normals, coarse.view, surface, sharp)
    values = _between(tails, n, stride, cv2.INTER_LINEAR)
    values[block] = highlight(lamp, part.points, part.normals, part.view, surface, sharp)
    return values


FAINT = 0.05
"""Radiance of a lamp's reflection, with the coarse lattice's wide lobe, above which it is evaluated finely."""

HIGHLIGHT_LATTICE = 32
"""Film points along each side of the coarse lattice that is searched for highlights of lamps."""
