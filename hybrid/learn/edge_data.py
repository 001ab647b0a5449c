"""Training views of EdgeNet: strips across the edges that a disturbed map predicts, and where the edges really are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap, Orientation, film_as_seen
from hybrid.coords import film_centres_1d, rescale_points, sample_bilinear
from hybrid.learn.data import BEND_ERROR_NODES, disturbed, disturbed_map, log_uniform
from hybrid.learn.samples import Place, film_mask, film_of, photo_of
from hybrid.learn.views import plane_of
from hybrid.pyramid import Pyramid
from hybrid.strips import SIDES, StripConfig, edge_strips, strip_copy

JUST_INSIDE = 0.02
"""Film units inside of an edge at which a mask of some 80 pixels shows film wherever nothing hides the edge."""


@dataclass(frozen=True)
class EdgeAugment:
    """How the predicting map errs.

    plane_share: maps that are the plane nearest to the true one. plane_error, bend_error: range of one sigma of the
    corners' error and of a smooth bent one, in parts of the film. colours: whether colours are disturbed.
    """

    plane_share: float = 0.25
    plane_error: tuple[float, float] = (0.003, 0.045)
    bend_error: tuple[float, float] = (0.001, 0.008)
    colours: bool = True


def edge_view(
    place: Place, strip: StripConfig, rng: np.random.Generator, augment: EdgeAugment
) -> tuple[UInt8[np.ndarray, "4 r c 3"], Bool[np.ndarray, "4 r c"], Float[np.ndarray, "4 c2"]]:
    """Strips of a sample, where the photo covers them, and the true rows in each pair of columns (NaN: not shown)."""
    photo, true = photo_of(place), film_as_seen(film_of(place))
    true = true.turned(Orientation(int(rng.integers(4)), bool(rng.random() < 0.5)))
    guess = plane_of(true) if rng.random() < augment.plane_share else true
    guess = disturbed_map(guess, 2, log_uniform(rng, augment.plane_error), rng)
    guess = disturbed_map(guess, BEND_ERROR_NODES, log_uniform(rng, augment.bend_error), rng)
    copy, on_copy = strip_copy(Pyramid(photo), guess, strip)
    images, inside = edge_strips(copy, on_copy, strip)
    if augment.colours:
        images = disturbed(images.reshape(-1, *images.shape[2:]), rng).reshape(images.shape)
    return images, inside, true_rows(true, guess, (photo.shape[0], photo.shape[1]), film_mask(place), strip)


def true_rows(
    true: BackwardMap, guess: BackwardMap, size: tuple[int, int], mask: Bool[np.ndarray, "h w"], strip: StripConfig
) -> Float[np.ndarray, "4 c2"]:
    """Rows of the strips of ``guess`` at which the edges of ``true`` cross the middles of pairs of columns; NaN where a
    hand or another thing hides the edge, too: what hides it has an edge of its own, which must not count.

    size: (height, width) of the photo. mask: where it shows film, at any resolution.
    """
    t = np.linspace(0, 1, 65)
    along = film_centres_1d(strip.columns // 2)
    rows = np.full((len(SIDES), len(along)), np.nan)
    for k, side in enumerate(SIDES):
        uv = side.film_points(t, np.zeros(len(t)))
        points = true.photo_from_film(uv)
        at = guess.film_near(points, uv, iterations=4, most_step=0.1)
        depth = side.inward * (at[:, side.axis] - side.edge)
        visible = _film_at(mask, true.photo_from_film(side.film_points(t, np.full(len(t), JUST_INSIDE))), size)
        visible = np.minimum(visible, ((points >= 0) & (points < [size[1], size[0]])).all(axis=1))
        order = np.argsort(at[:, 1 - side.axis])
        place = at[order, 1 - side.axis]
        depth = np.interp(along, place, depth[order], left=np.nan, right=np.nan)
        shown = (np.interp(along, place, visible[order]) > 0.5) & (np.abs(depth) < strip.reach)
        rows[k, shown] = strip.row_of(depth[shown])
    return rows


def _film_at(
    mask: Bool[np.ndarray, "h w"], points: Float[np.ndarray, "n 2"], size: tuple[int, int]
) -> Float[np.ndarray, " n"]:
    """Share of film around photo points, each among the mask's four nearest pixels."""
    at = rescale_points(points, size, (mask.shape[0], mask.shape[1]))
    return sample_bilinear(mask.astype(np.float32), at[None])[0].astype(float)
