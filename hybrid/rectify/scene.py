"""The photo in which refinement looks at the film, and views of the film through a map of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d
from hybrid.film_view import FilmView, view_film
from hybrid.rectify.cell_phases import AxisPhases, CellPhases
from hybrid.rectify.sightings import Displacement, Sightings


@dataclass(frozen=True, eq=False)
class Scene:
    """A photo, what the film is looked at in, the map to start from, and what the networks tell of the film.

    grey: the photo without colour; reduced where the exactness of small pixels is not needed, and the map with it.
    film_size: (height, width) of a view of the film. phases: of the cells. edges: the sheet's, as they were read,
        through ``coarse``.
    """

    photo: UInt8[np.ndarray, "H W 3"]
    grey: UInt8[np.ndarray, "h w"]
    coarse: BackwardMap
    film_size: tuple[int, int]
    phases: CellPhases | None = None
    edges: tuple[Sightings, ...] = ()


def working_scene(
    photo: UInt8[np.ndarray, "H W 3"],
    coarse: BackwardMap,
    working_px: int,
    phases: CellPhases | None = None,
    edges: tuple[Sightings, ...] = (),
) -> Scene:
    """The photo scaled down, if need be, until the film's longer side has ``working_px`` pixels."""
    film_px = max(coarse.mean_film_pixels())
    if film_px > 1.15 * working_px:
        scale = working_px / film_px
        height, width = photo.shape[:2]
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        photo = cv2.resize(photo, size, interpolation=cv2.INTER_AREA)
        scale_xy = (size[0] / width, size[1] / height)
        coarse, phases = coarse.cropped((0.0, 0.0), scale_xy), phases and phases.scaled(scale_xy)
    down, across = coarse.mean_film_pixels()
    film_size = (int(np.clip(round(down), 64, 4096)), int(np.clip(round(across), 64, 4096)))
    return Scene(photo, cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY), coarse, film_size, phases, edges)


def halved(scene: Scene) -> Scene:
    """The scene at half the size."""
    height, width = scene.grey.shape
    size = (max(1, width // 2), max(1, height // 2))
    grey = cv2.resize(scene.grey, size, interpolation=cv2.INTER_AREA)
    scale_xy, film_size = (size[0] / width, size[1] / height), (scene.film_size[0] // 2, scene.film_size[1] // 2)
    coarse, phases = scene.coarse.cropped((0.0, 0.0), scale_xy), scene.phases and scene.phases.scaled(scale_xy)
    return Scene(scene.photo, grey, coarse, film_size, phases, scene.edges)


def view_of(scene: Scene, displacement: Displacement) -> FilmView:
    """The flat grey film as the displaced map sees it."""
    height, width = scene.film_size
    return view_film(scene.grey, displacement.composed(scene.coarse), film_centres_1d(width), film_centres_1d(height))


def phases_along(scene: Scene, displacement: Displacement) -> tuple[AxisPhases, AxisPhases] | None:
    """What the network tells of the cells along u and v, through the displaced map; None where it tells nothing."""
    return None if scene.phases is None else scene.phases.inside(displacement.composed(scene.coarse)).axes()


__all__ = ["Scene", "halved", "phases_along", "view_of", "working_scene"]
