"""Training views of BorderNet: strips across the borders between cells that a map and a grid predict, and where the
borders really are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap, Orientation, orientation
from hybrid.borders import GROUP, border_side, border_strips, inner_lines, strip_across
from hybrid.learn.datasets import behind
from hybrid.learn.datasets.colours import taken_badly
from hybrid.learn.datasets.draws import log_uniform
from hybrid.learn.datasets.edges import EdgePlace, disturbed_alike, film_shown, open_edges, row_of_line
from hybrid.learn.datasets.film import UNKNOWN_GRID, disturbed_map, grid_along
from hybrid.learn.datasets.samples import film_mask, film_of, photo_of, vertices_of
from hybrid.pyramid import Pyramid
from hybrid.strips import StripConfig, strip_copy


@dataclass(frozen=True)
class BorderAugment:
    """Errors of the map that flattens a film, and of the grid laid over it.

    found_share: share of FilmNet's maps, where these are known. plane_error, bend_error: ranges of one sigma of the
    error of the corners and of a smooth bending error, as a fraction of the film; FilmNet's maps get only the former.
    bend_nodes: numbers of nodes of the bending error. place_error: one sigma of the grid's shift and of its change in
    length, in film units. far_share: share of views with the grid far off; far: how far at most, in cells. colours:
    whether they are disturbed.
    """

    found_share: float = 0.3
    plane_error: tuple[float, float] = (0.0005, 0.006)
    bend_error: tuple[float, float] = (0.0006, 0.01)
    bend_nodes: tuple[int, ...] = (4, 5, 6, 8)
    place_error: float = 0.004
    far_share: float = 0.4
    far: float = 0.35
    colours: bool = True


def open_borders(folders: Sequence[Path]) -> list[EdgePlace]:
    """All samples of some data sets whose grid is recorded and has borders inside the sheet.

    Raises:
        DataError: a data set or maps cannot be read.
    """
    return [one for one in open_edges(folders) if _axes_with_borders(_grid(one, Orientation(0, False)))]


def border_view(
    sample: EdgePlace, strip: StripConfig, rng: np.random.Generator, augment: BorderAugment
) -> tuple[UInt8[np.ndarray, "4 r c 3"], Bool[np.ndarray, "4 r c"], Float[np.ndarray, "4 c2"]]:
    """Strips across GROUP borders along one axis of a sample, where the photo covers them, and the true rows in each
    pair of columns (NaN: hidden, beyond the ends of the grid, or outside the strip). The film is turned and mirrored at
    random."""
    place, way = sample.place, Orientation(int(rng.integers(4)), bool(rng.random() < 0.5))
    photo, film = photo_of(place), film_of(place)
    if augment.colours:
        photo = behind.behind_some(place, photo, film, rng)
        photo = taken_badly(photo, rng)
    true, grid = film.turned(way), _grid(sample, way)
    if sample.found is not None and rng.random() < augment.found_share:
        guess = BackwardMap(sample.found.astype(np.float64)).turned(orientation(film)).turned(way)
    else:
        guess = disturbed_map(true, int(rng.choice(augment.bend_nodes)), log_uniform(rng, augment.bend_error), rng)
    guess = disturbed_map(guess, 2, log_uniform(rng, augment.plane_error), rng)
    axis = int(rng.choice(_axes_with_borders(grid)))
    first, pitch, cells = grid[axis]
    lines, _ = inner_lines(first, pitch, round(cells))
    lines = lines[_some(len(lines), rng)]
    off, longer = rng.normal(0, augment.place_error, 2)
    held, strip = lines + off + longer * (lines - 0.5), strip_across(pitch, strip)
    if rng.random() < augment.far_share:
        held += pitch * rng.uniform(-augment.far, augment.far)
    copy, on_copy = strip_copy(Pyramid(photo), guess, strip)
    images, inside = border_strips(copy, on_copy, axis, held, strip)
    if augment.colours:
        images = disturbed_alike(images, rng)
    start, step, count = grid[1 - axis]
    t = np.linspace(start, start + count * step, 65)
    size, mask, rows = (photo.shape[0], photo.shape[1]), film_mask(place), []
    for line, at in zip(lines.tolist(), held.tolist(), strict=True):
        uv = border_side(axis, line).film_points(t, np.zeros(len(t)))
        visible = film_shown(mask, true.photo_from_film(uv), size)
        rows.append(row_of_line(true, guess, border_side(axis, at), uv, visible, size, strip))
    return images, inside, np.stack(rows)


def _grid(sample: EdgePlace, way: Orientation) -> Float[np.ndarray, "2 3"]:
    """The grid of the moved film, as ``grid_along`` gives it; a single cell where it is not recorded."""
    vertices = vertices_of(sample.place)
    return UNKNOWN_GRID if vertices is None else grid_along(way.inverse.seen_from_film(vertices))


def _axes_with_borders(grid: Float[np.ndarray, "2 3"]) -> list[int]:
    """Axes along which there are borders between cells, or ends of the grid inside the sheet."""
    return [axis for axis, (first, pitch, cells) in enumerate(grid) if len(inner_lines(first, pitch, round(cells))[0])]


def _some(count: int, rng: np.random.Generator) -> list[int]:
    """GROUP indices below count, in order; some repeat where there are too few."""
    if count >= GROUP:
        return np.sort(rng.choice(count, GROUP, replace=False)).tolist()
    return sorted(k % count for k in range(GROUP))
