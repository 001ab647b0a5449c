"""What is seen, and what shines, through the film: the picture of what lies behind it."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float

from data_gen.light.rooms import FilteredEnvironment
from data_gen.render.seen_film import film_points
from data_gen.render.shade import Behind, LitFilm, entering_light
from hybrid.coords import opencv_from_photo

LATTICE = 96
"""Film points along each side at which the picture behind is looked up: every 4 mm, so what lies right behind a clear
film shows blurred."""

STANDING_OFF_MM = 20.0
"""How far a bent film stands off what it lies on, about: light on its far side is averaged at least this widely."""


def behind_film(lit: LitFilm, room: FilteredEnvironment, picture: Float[np.ndarray, "h w 3"]) -> Behind:
    """What reaches the far side of a film in front of a ``picture``: linear radiance over the whole photo.

    A table, wall or dark ground hides the room: all light then comes from it, over an area as wide as it is far away.
    A light box sheds its own; things that lie on it block only what is seen straight through the film.
    """
    straight = _straight(lit, picture)
    if lit.scene.backdrop.kind in ("room", "panel"):
        return Behind(straight, entering_light(lit, -lit.smooth.normals, room))
    reach = (lit.scene.backdrop.gap_mm + STANDING_OFF_MM) * LATTICE / max(lit.film.size_mm)
    even = cv2.GaussianBlur(straight, (0, 0), float(min(reach, LATTICE)), borderType=cv2.BORDER_REFLECT)
    return Behind(straight, cv2.resize(even, lit.inside.shape[1::-1], interpolation=cv2.INTER_AREA))


def _straight(lit: LitFilm, picture: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "k k 3"]:
    """Radiance that a clear film shows of the picture behind it, over the film; beyond the photo, as at its rim."""
    size = [n // max(1, n // (2 * LATTICE)) for n in picture.shape[:2]]  # averaging whole steps is far faster
    small = cv2.resize(picture, size[::-1], interpolation=cv2.INTER_AREA)
    camera = lit.scene.camera
    points = film_points(lit.film, LATTICE)
    shares = camera.photo_from_world(points) / np.array(camera.size[::-1])
    x, y = np.moveaxis(opencv_from_photo(shares * size[::-1]).astype(np.float32), -1, 0)
    return cv2.remap(small, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
