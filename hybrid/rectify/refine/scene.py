"""The photo in which refinement looks at the film, and views of the film through a map of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d
from hybrid.film_view import FilmView, view_film
from hybrid.rectify.grid.phases import AxisPhases, CellPhases
from hybrid.rectify.splines.sightings import Sightings

VIEW_STEP = 24
"""Sides of views are multiples of this many pixels: their halves, thirds and eighths are whole, and OpenCV averages
whole numbers of pixels ten times as fast."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A photo, or a copy of it that is large enough, the map to start from, and what the networks say about the film.

    coarse: maps into ``photo``. grey: the photo without colour. film_size: (height, width) of a view of the film.
    aspect: height over width of the film as the photo shows it. phases: of the cells. edges: the sheet's, as read
    through ``coarse``.
    """

    photo: UInt8[np.ndarray, "H W 3"]
    grey: UInt8[np.ndarray, "H W"]
    coarse: BackwardMap
    film_size: tuple[int, int]
    aspect: float
    phases: CellPhases | None = None
    edges: tuple[Sightings, ...] = ()


def scene_of(
    photo: UInt8[np.ndarray, "H W 3"],
    coarse: BackwardMap,
    phases: CellPhases | None = None,
    edges: tuple[Sightings, ...] = (),
) -> Scene:
    """The scene in which a view of the film has about as many pixels as the film has in the photo."""
    down, across = coarse.mean_film_pixels()
    height, width = (VIEW_STEP * int(np.clip(round(n / VIEW_STEP), 3, 170)) for n in (down, across))
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)
    return Scene(photo, grey, coarse, (height, width), down / across, phases, edges)


def view_of(scene: Scene, film: BackwardMap) -> FilmView:
    """The flat grey film, seen through a map of it into the scene's photo."""
    return _view(scene.grey, film, scene.film_size)


def half_view(scene: Scene, film: BackwardMap) -> FilmView:
    """The same at half the size, from a copy of the photo at half the size."""
    height, width = (max(1, n // 2) for n in scene.grey.shape)
    grey = cv2.resize(scene.grey[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
    small = film.cropped((0.0, 0.0), (0.5, 0.5))
    return _view(grey, small, (scene.film_size[0] // 2, scene.film_size[1] // 2))


def phases_along(scene: Scene, film: BackwardMap) -> tuple[AxisPhases, AxisPhases] | None:
    """What the network says about the cells along u and v, through a map; None where it says nothing."""
    return None if scene.phases is None else scene.phases.inside(film).axes()


def _view(grey: UInt8[np.ndarray, "h w"], film: BackwardMap, size: tuple[int, int]) -> FilmView:
    return view_film(grey, film, film_centres_1d(size[1]), film_centres_1d(size[0]))


__all__ = ["Scene", "half_view", "phases_along", "scene_of", "view_of"]
