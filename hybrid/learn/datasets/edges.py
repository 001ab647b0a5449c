"""Training views of EdgeNet: strips across the edges that a map predicts, and where the edges really are.

The predicting map is the true one, disturbed, or the one that FilmNet made of the photo (data_gen/film_maps.py). Only
FilmNet's errs as it does in use: where a shadow or a frame looks like the sheet's edge, FilmNet has already been drawn
to it. It has not seen the shadows that are put into photos here, so for these the true map is moved out to them
(datasets/near_edges.py). In the search for margins (rectify/margins/clear.py) a map may end where there is nothing to
see, and so do some of the maps here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap, Orientation, orientation
from hybrid.coords import film_centres_1d, rescale_points, sample_bilinear
from hybrid.errors import NPZ_ERRORS, DataError, describe
from hybrid.learn.datasets import behind, rounded
from hybrid.learn.datasets.colours import disturbed, taken_badly
from hybrid.learn.datasets.draws import log_uniform, one_side_or_two
from hybrid.learn.datasets.film import BEND_ERROR_NODES, corners_moved, disturbed_map
from hybrid.learn.datasets.near_edges import margins_some, near_edges
from hybrid.learn.datasets.samples import Place, film_mask, film_of, open_places, photo_of, round_corners_of
from hybrid.learn.datasets.shards import FILM_MAPS
from hybrid.learn.reading.views import plane_of
from hybrid.pyramid import Pyramid
from hybrid.round_corners import RoundCorners
from hybrid.strips import SIDES, Side, StripConfig, edge_strips, strip_copy

JUST_INSIDE = 0.02
"""Film units inside of an edge at which a mask of some 80 pixels shows film wherever nothing hides the edge."""


@dataclass(frozen=True)
class EdgeAugment:
    """How the predicting map errs.

    drawn_share: share of the photos with a shadow right beside the film in which the map reaches out to it.
    found_share: of the rest, the share that use FilmNet's map, where there is one. found_error: range of the standard
    deviation of the disturbance of the corners of both, in parts of the film. plane_share: of the rest, the share that
    use the plane nearest to the true map. plane_error, bend_error: range of the standard deviation of the error of
    their corners, and of a smooth bent one. far_share: share of all maps of which a side or two are moved; far: range
    of how far, which may be further than strips reach. outwards_share: of these sides, the share that is moved
    outwards. colours: whether colours are disturbed.
    """

    drawn_share: float = 0.65
    found_share: float = 0.5
    found_error: tuple[float, float] = (0.0005, 0.01)
    plane_share: float = 0.25
    plane_error: tuple[float, float] = (0.003, 0.045)
    bend_error: tuple[float, float] = (0.001, 0.008)
    far_share: float = 0.3
    far: tuple[float, float] = (0.02, 0.25)
    outwards_share: float = 0.7
    colours: bool = True


@dataclass(frozen=True, eq=False)
class EdgePlace:
    """A sample, and the nodes of FilmNet's map of it, turned as the film is seen; None where there is no such map."""

    place: Place
    found: Float[np.ndarray, "n m 2"] | None


def open_edges(folders: Sequence[Path]) -> list[EdgePlace]:
    """All samples of some data sets, with FilmNet's maps where these are stored beside them.

    Raises:
        DataError: a data set or maps that cannot be read, or maps that are not as many as its samples.
    """
    return [one for folder in folders for one in _open_folder(folder)]


def _open_folder(folder: Path) -> list[EdgePlace]:
    places, path = open_places([folder]), folder / FILM_MAPS
    if not path.exists():
        return [EdgePlace(place, None) for place in places]
    maps = _read_maps(path)
    if len(maps) != len(places):
        got = f"{len(maps)} maps of {len(places)} samples"
        raise DataError(describe(what="FilmNet's maps", where=path, got=got, do="Make the maps again."))
    known = np.asarray(np.isfinite(maps).all(axis=(1, 2, 3)))
    return [EdgePlace(place, nodes if good else None) for place, nodes, good in zip(places, maps, known, strict=True)]


def _read_maps(path: Path) -> Float[np.ndarray, "k n m 2"]:
    try:
        return np.load(path)
    except NPZ_ERRORS as error:
        raise DataError(describe(what="FilmNet's maps", where=path, got=error, do="Make the maps again.")) from error


def edge_view(
    sample: EdgePlace, strip: StripConfig, rng: np.random.Generator, augment: EdgeAugment
) -> tuple[UInt8[np.ndarray, "4 r c 3"], Bool[np.ndarray, "4 r c"], Float[np.ndarray, "4 c2"]]:
    """Strips of a sample, where the photo covers them, and the true row for each pair of columns (NaN: not shown)."""
    place, way = sample.place, Orientation(int(rng.integers(4)), bool(rng.random() < 0.5))
    photo, film, corners = photo_of(place), film_of(place), round_corners_of(place)
    drawn: BackwardMap | None = None
    if augment.colours:
        photo = behind.behind_some(place, photo, film, rng)
        photo, drawn = near_edges(place, photo, film, rng)
        photo = margins_some(place, photo, film, rng)
        photo, corners = rounded.round_some(photo, film, corners, rng)
        photo = taken_badly(photo, rng)
    seen = orientation(film)
    true = film.turned(seen.inverse).turned(way)
    if corners is not None:
        corners = corners.turned(seen.turns + way.turns)
    found: BackwardMap | None = None
    if drawn is not None and rng.random() < augment.drawn_share:
        found = drawn.turned(seen.inverse).turned(way)
    elif sample.found is not None and rng.random() < augment.found_share:
        found = BackwardMap(sample.found.astype(np.float64)).turned(way)
    if found is not None:
        guess = disturbed_map(found, 2, log_uniform(rng, augment.found_error), rng)
    else:
        guess = plane_of(true) if rng.random() < augment.plane_share else true
        guess = disturbed_map(guess, 2, log_uniform(rng, augment.plane_error), rng)
        guess = disturbed_map(guess, BEND_ERROR_NODES, log_uniform(rng, augment.bend_error), rng)
    if rng.random() < augment.far_share:
        guess = sides_far(guess, augment, rng)
    copy, on_copy = strip_copy(Pyramid(photo), guess, strip)
    images, inside = edge_strips(copy, on_copy, strip)
    if augment.colours:
        images = disturbed_alike(images, rng)
    size = (photo.shape[0], photo.shape[1])
    return images, inside, true_rows(true, guess, size, film_mask(place), strip, corners)


def sides_far(film: BackwardMap, augment: EdgeAugment, rng: np.random.Generator) -> BackwardMap:
    """The map with one or two sides moved far outside or inside, and turned a little."""
    by = np.zeros((2, 2, 2))
    for side in one_side_or_two(rng):
        outwards = rng.random() < augment.outwards_share
        off = rng.uniform(*augment.far) * (-side.inward if outwards else side.inward)
        corners = by[int(side.edge)] if side.axis == 1 else by[:, int(side.edge)]
        corners[:, side.axis] += off * rng.uniform(0.8, 1.2, 2)
    return corners_moved(film, by)


def true_rows(
    true: BackwardMap,
    guess: BackwardMap,
    size: tuple[int, int],
    mask: Bool[np.ndarray, "h w"],
    strip: StripConfig,
    corners: RoundCorners | None = None,
) -> Float[np.ndarray, "4 c2"]:
    """Rows of the strips of ``guess`` at which the edges of ``true`` cross the middles of pairs of columns.

    NaN where a hand or another thing hides the edge: its own edge must not count. NaN also where a corner is rounded:
    there the sheet ends, but not at the edge that is sought.

    size: (height, width) of the photo. mask: where it shows film, at any resolution.
    """
    t = np.linspace(0, 1, 65)
    rows = []
    for side in SIDES:
        uv = side.film_points(t, np.zeros(len(t)))
        visible = film_shown(mask, true.photo_from_film(side.film_points(t, np.full(len(t), JUST_INSIDE))), size)
        if corners is not None:
            visible = np.minimum(visible, ~corners.cut(uv))
        rows.append(row_of_line(true, guess, side, uv, visible, size, strip))
    return np.stack(rows)


def row_of_line(
    true: BackwardMap,
    guess: BackwardMap,
    side: Side,
    uv: Float[np.ndarray, "n 2"],
    visible: Float[np.ndarray, " n"],
    size: tuple[int, int],
    strip: StripConfig,
) -> Float[np.ndarray, " c2"]:
    """Rows of the strip of ``guess`` across a side at which a line crosses the middles of pairs of columns.

    NaN where less than half of the line is visible, and where it lies outside of the photo or the strip or has ended.

    uv: points along the line, by ``true``. visible: how much of each is seen, in [0, 1]. size: (height, width) of the
    photo.
    """
    points = true.photo_from_film(uv)
    at = guess.film_near(points, uv, iterations=4, most_step=0.1)
    depth = side.inward * (at[:, side.axis] - side.edge)
    visible = np.minimum(visible, ((points >= 0) & (points < [size[1], size[0]])).all(axis=1))
    order = np.argsort(at[:, 1 - side.axis])
    place, along = at[order, 1 - side.axis], film_centres_1d(strip.columns // 2)
    depth = np.interp(along, place, depth[order], left=np.nan, right=np.nan)
    shown = (np.interp(along, place, visible[order]) > 0.5) & (np.abs(depth) < strip.reach)
    return np.where(shown, strip.row_of(depth), np.nan)


def disturbed_alike(images: UInt8[np.ndarray, "k r c 3"], rng: np.random.Generator) -> UInt8[np.ndarray, "k r c 3"]:
    """Strips of one photo with their colours disturbed alike, as if they were one picture."""
    return np.stack(np.split(disturbed(np.concatenate(images, axis=1), rng), len(images), axis=1))


def film_shown(
    mask: Bool[np.ndarray, "h w"], points: Float[np.ndarray, "n 2"], size: tuple[int, int]
) -> Float[np.ndarray, " n"]:
    """Share of film at photo points, interpolated between the mask's four nearest pixels."""
    at = rescale_points(points, size, (mask.shape[0], mask.shape[1]))
    return sample_bilinear(mask.astype(np.float32), at[None])[0].astype(float)
