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
from hybrid.rectify.sightings import Sightings


@dataclass(frozen=True, eq=False)
class Scene:
    """A photo, or the copy of it that is large enough, the map to start from, and what the networks tell of the film.

    coarse: maps into ``photo``. grey: the photo without colour. film_size: (height, width) of a view of the film.
    phases: of the cells. edges: the sheet's, as they were read, through ``coarse``.
    """

    photo: UInt8[np.ndarray, "H W 3"]
    grey: UInt8[np.ndarray, "H W"]
    coarse: BackwardMap
    film_size: tuple[int, int]
    phases: CellPhases | None = None
    edges: tuple[Sightings, ...] = ()


def scene_of(
    photo: UInt8[np.ndarray, "H W 3"],
    coarse: BackwardMap,
    phases: CellPhases | None = None,
    edges: tuple[Sightings, ...] = (),
) -> Scene:
    """The scene in which a view of the film has as many pixels as the photo has of it."""
    down, across = coarse.mean_film_pixels()
    film_size = (int(np.clip(round(down), 64, 4096)), int(np.clip(round(across), 64, 4096)))
    return Scene(photo, cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY), coarse, film_size, phases, edges)


def view_of(scene: Scene, film: BackwardMap) -> FilmView:
    """The flat grey film as a map of it into the scene's photo sees it."""
    return _view(scene.grey, film, scene.film_size)


def half_view(scene: Scene, film: BackwardMap) -> FilmView:
    """The same at half the size, in a copy of the photo of half the size."""
    height, width = scene.grey.shape
    size = (max(1, width // 2), max(1, height // 2))
    grey = cv2.resize(scene.grey, size, interpolation=cv2.INTER_AREA)
    small = film.cropped((0.0, 0.0), (size[0] / width, size[1] / height))
    return _view(grey, small, (scene.film_size[0] // 2, scene.film_size[1] // 2))


def phases_along(scene: Scene, film: BackwardMap) -> tuple[AxisPhases, AxisPhases] | None:
    """What the network tells of the cells along u and v, through a map; None where it tells nothing."""
    return None if scene.phases is None else scene.phases.inside(film).axes()


def _view(grey: UInt8[np.ndarray, "h w"], film: BackwardMap, size: tuple[int, int]) -> FilmView:
    return view_film(grey, film, film_centres_1d(size[1]), film_centres_1d(size[0]))


__all__ = ["Scene", "half_view", "phases_along", "scene_of", "view_of"]
