"""What looks like the sheet's edge beside it, put into EdgeNet's training photos: shadows, bands and margins of prints.

A film that stands a few millimetres off the table throws a shadow of its own shape, which sticks out by 0.5 to 5 % of
the film on one or two sides and is as dark as a rim of clear film. FilmNet takes it for part of the sheet. The false
edge then lies just where the map says, and EdgeNet believed it while it had met such edges only through maps that were
right. But once it has met shadows, it takes the black band below a patient's couch for one, and a margin that is a
little darker or brighter than the cells as well; so bands and margins are put into prints, too.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.learn.datasets.behind import Grey, Outline, Picture, filled, ground_around, mixed, size_in_photo, with_shade
from hybrid.learn.datasets.draws import log_uniform, one_side_or_two
from hybrid.learn.datasets.film import corners_moved
from hybrid.learn.datasets.samples import Place
from hybrid.strips import SIDES, Side

SHADOW_SHARE, BAND_SHARE, MARGIN_SHARE = 0.08, 0.15, 0.15
"""Shares of the photos with nothing lying over the film that get a shadow, a band in the print, and margins in it."""

FAR = (0.004, 0.08)
"""How far beside the film a shadow lies, in sizes of the film."""

SLANT = 0.4
"""Standard deviation, in parts of that, of how the shadow is turned, stretched and sheared, as by a sheet that stands
off unevenly."""

RIM = (0.0005, 0.012)
"""Sigma of its blurred rim, in sizes of the film."""

REACHED = (0.002, 0.085)
"""Range of how far a map's corners are moved out to the shadow, in parts of the film: a strip would not show more."""

PART_SHARE = 0.3
"""Share of the maps that take only part of the shadow for the sheet."""

DEEP, THICK = (0.006, 0.09), (0.0006, 0.008)
"""How deep in the film a band ends, or a margin, and how thick the line of a band is, in parts of the film."""

BROKEN_SHARE, PIECES = 0.5, (3, 8)
"""Share of the lines that are broken, as where each slice has its own; and the least and most pieces then."""

LIFT = (1.0, 40.0)
"""By how many grey levels margins are brighter than what is darkest nearby."""

LIFTED_SHARE, ALL_ROUND = 0.7, 0.5
"""Shares of the margins that are brighter at all, and that lie on all four sides."""

GREYS = (8, 96)
"""Percentiles of the film's colours in the photo that bands and lines are near."""

CORNERS = film_nodes((2, 2)).reshape(4, 2)
"""The film's corners, row by row, as ``corners_moved`` has them."""


def near_edges(
    place: Place, photo: Picture, film: BackwardMap, rng: np.random.Generator
) -> tuple[Picture, BackwardMap | None]:
    """A sample's photo, at times with a band along a side of the print, or with a shadow right beside the film.

    Also the map that takes the shadow for part of the sheet; None where there is none.
    """
    band, shadow = rng.random(2) < (BAND_SHARE, SHADOW_SHARE)
    around = ground_around(place, photo, film) if band or shadow else None
    if around is None:
        return photo, None
    outline, free = around
    if band:
        photo = with_band(photo, film, free, rng)
    return near_shadow(photo, film, outline, free, rng) if shadow else (photo, None)


def margins_some(place: Place, photo: Picture, film: BackwardMap, rng: np.random.Generator) -> Picture:
    """A sample's photo, at times with margins along sides of the print."""
    around = ground_around(place, photo, film) if rng.random() < MARGIN_SHARE else None
    return photo if around is None else with_margins(photo, film, around[1], rng)


def near_shadow(
    photo: Picture, film: BackwardMap, outline: Outline, free: Grey, rng: np.random.Generator
) -> tuple[Picture, BackwardMap]:
    """The photo with a shadow right beside the film, and the map that takes it for part of the sheet.

    outline: of the film, in the photo. free: share, of 255, of the ground in each pixel.
    """
    centre, size = outline.mean(axis=0), size_in_photo(outline)
    far, turn, rim = log_uniform(rng, FAR), rng.uniform(0, 2 * np.pi), log_uniform(rng, RIM)
    slant = np.eye(2) + rng.normal(0, SLANT * far, (2, 2))
    to = centre + far * size * np.array([np.cos(turn), np.sin(turn)])
    part = rng.uniform(0, 1) if rng.random() < PART_SHARE else 1.0
    drawn = reaching(film, (film.photo_from_film(CORNERS) - centre) @ slant + to, part)
    return with_shade(photo, (outline - centre) @ slant + to, rim * size, free, rng), drawn


def reaching(film: BackwardMap, thrown: Float[np.ndarray, "4 2"], part: float = 1.0) -> BackwardMap:
    """The map that takes the film's shadow for part of the sheet where it sticks out, or only so large a part of it.

    thrown: photo points of the shadows of CORNERS.
    """
    out = film.film_near(thrown, CORNERS, iterations=6, most_step=0.1) - CORNERS
    beyond = out * np.sign(CORNERS - 0.5)
    by = part * np.where((beyond > REACHED[0]) & (beyond < REACHED[1]), out, 0.0)
    return corners_moved(film, by.reshape(2, 2, 2))


def with_band(photo: Picture, film: BackwardMap, free: Grey, rng: np.random.Generator) -> Picture:
    """The photo with a black band printed along one side of the film, and a bright line where it ends."""
    side, deep, thick = SIDES[rng.integers(4)], log_uniform(rng, DEEP), log_uniform(rng, THICK)
    dark, bright = _greys(photo, film)
    band = _strip(film, side, (0.0, 1.0), (0.0, deep))
    photo = _printed(photo, [band], np.full_like(photo, dark), rng.uniform(0.5, 1.0), free)
    ends = [(0.0, 1.0)]
    if rng.random() < BROKEN_SHARE:
        pieces = int(rng.integers(PIECES[0], PIECES[1] + 1))
        length = rng.uniform(0.7, 0.98) / pieces
        ends = [(k / pieces, k / pieces + length) for k in range(pieces)]
    lines = [_strip(film, side, piece, (deep, deep + thick)) for piece in ends]
    return _printed(photo, lines, np.full_like(photo, bright), rng.uniform(0.2, 1.0), free)


def with_margins(photo: Picture, film: BackwardMap, free: Grey, rng: np.random.Generator) -> Picture:
    """The photo with margins along some sides of the film: nearly as dark as what is darkest of the print nearby."""
    deep, lifted = log_uniform(rng, DEEP), rng.random() < LIFTED_SHARE
    near = 2 * int(0.5 * deep * size_in_photo(film.outline())) + 3
    darkest = cv2.erode(np.maximum(photo, free[..., None]), np.ones((near, near), np.uint8))
    blank = cv2.blur(darkest, (near, near))
    if lifted:
        blank = cv2.add(blank, np.full_like(blank, round(log_uniform(rng, LIFT))))
    sides = SIDES if rng.random() < ALL_ROUND else one_side_or_two(rng)
    strips = [_strip(film, side, (0.0, 1.0), (0.0, deep)) for side in sides]
    return _printed(photo, strips, blank, rng.uniform(0.8, 1.0), free)


def _strip(film: BackwardMap, side: Side, along: tuple[float, float], depth: tuple[float, float]) -> Outline:
    """In the photo, the outline of a strip along a side: between two places along it, and two depths."""
    t = np.linspace(*along, 33)
    there, back = (side.film_points(t, np.full(len(t), d)) for d in depth)
    return film.photo_from_film(np.concatenate([there, back[::-1]]))


def _printed(photo: Picture, outlines: list[Outline], other: Picture, share: float, free: Grey) -> Picture:
    """The photo with a share of another within outlines, as far as the film is seen there."""
    drawn = np.max([filled(outline, photo.shape[:2]) for outline in outlines], axis=0)
    weight = share * drawn * (1 - free / np.float32(255))
    return mixed(photo, other, np.rint(weight).astype(np.uint8))


def _greys(photo: Picture, film: BackwardMap) -> Float[np.ndarray, "2 3"]:
    """A dark and a bright colour of the film, as the photo shows it."""
    points = film.photo_from_film(film_nodes((65, 65))[4:-4, 4:-4].reshape(-1, 2))
    seen = points[((points >= 0) & (points < photo.shape[1::-1])).all(axis=1)]
    if not len(seen):
        return np.array([[20.0] * 3, [200.0] * 3])
    colours = photo[seen[:, 1].astype(int), seen[:, 0].astype(int)]
    order = np.argsort(colours.sum(axis=1, dtype=int))
    return colours[order[[int(p / 100 * (len(order) - 1)) for p in GREYS]]].astype(float)
