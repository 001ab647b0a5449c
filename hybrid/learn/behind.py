"""What lies behind a film and may be taken for part of it, put into training photos: shadows, sheets, films, patterns.

The data's rooms, tables and lamps are simulated (data_gen), but not all that a film may lie on. Of 69 photos with truth
that were given a hard shadow of the film, 14 were read with film and shadow as one sheet by a network that had not seen
any; of 50 laid on a dark sheet it saw 17 to 10 px of 1080 (45 as they were), on a white one 33, beside another film 33,
on stripes 26.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, opencv_from_photo
from hybrid.learn.samples import Place, film_of, photo_of
from hybrid.learn.views import film_view, view_image

Picture = UInt8[np.ndarray, "h w 3"]
Grey = UInt8[np.ndarray, "h w"]

SHARE = 0.4
"""Photos that get something behind their film."""

KINDS = {"shadow": 0.3, "sheet": 0.25, "film": 0.2, "pattern": 0.25}
"""Of these the shares of what it is."""

LENS_PX = 0.8
"""Sigma of a lens's blur in the data's photos."""

FILM_PX = 192
"""Side of another film's picture."""

_ALONG = 65
_FINER = 2


def behind_some(place: Place, photo: Picture, film: BackwardMap, rng: np.random.Generator) -> Picture:
    """The photo of a sample, of some with something behind the film; the film itself stays as it was."""
    if rng.random() >= SHARE:
        return photo
    nodes = film.photo_from_film(film_nodes((_ALONG, _ALONG)))
    free = 255 - _within(_filled(BackwardMap(nodes).outline(), photo.shape[:2]))
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    if kind == "shadow":
        return with_shadow(photo, nodes, free, rng)
    if kind == "pattern":
        return with_pattern(photo, free, rng)
    return with_sheet(photo, nodes, free, rng, (lambda: another_film(place, rng)) if kind == "film" else None)


def with_shadow(photo: Picture, nodes: Float[np.ndarray, "n m 2"], free: Grey, rng: np.random.Generator) -> Picture:
    """A hard shadow of the film's shape, as a point source throws it of a film that stands off what is behind it.

    nodes: photo points of a lattice of film points, edges included. free: share, of 255, of the ground in each pixel.
    """
    centre, size = nodes.mean(axis=(0, 1)), _size(nodes)
    turn, far = rng.uniform(0, 2 * np.pi), size * rng.uniform(0.02, 0.4)
    outline = BackwardMap(nodes).outline()
    thrown = (outline - centre) * rng.uniform(0.95, 1.15) + centre + far * np.array([np.cos(turn), np.sin(turn)])
    rim = max(size * float(np.exp(rng.uniform(*np.log((0.001, 0.02))))), 0.3)
    shade = cv2.GaussianBlur(_filled(thrown, photo.shape[:2]), (0, 0), rim)
    return _darkened(photo, cv2.multiply(shade, free, scale=1 / 255), rng)


def with_pattern(photo: Picture, free: Grey, rng: np.random.Generator) -> Picture:
    """Stripes, or checks, in what is around the film."""
    h, w = photo.shape[:2]
    period = max(h, w) * float(np.exp(rng.uniform(*np.log((0.015, 0.3)))))
    turn, duty = rng.uniform(0, np.pi), rng.uniform(0.1, 0.9, 2)
    y, x = np.mgrid[:h, :w].astype(np.float32) / np.float32(period)
    along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    drawn = along % 1 < duty[0]
    if rng.random() < 0.5:
        drawn ^= across % 1 < duty[1]
    soft = cv2.GaussianBlur(drawn.astype(np.uint8) * np.uint8(255), (0, 0), rng.uniform(0.3, 2.0))
    return _darkened(photo, cv2.multiply(soft, free, scale=1 / 255), rng)


def with_sheet(
    photo: Picture,
    nodes: Float[np.ndarray, "n m 2"],
    free: Grey,
    rng: np.random.Generator,
    picture: Callable[[], Picture] | None = None,
) -> Picture:
    """A sheet of one colour, larger or smaller than the film, below it; or a further film, partly below.

    picture: of the further film, flat.
    """
    h, w = photo.shape[:2]
    corners = nodes[[0, 0, -1, -1], [0, -1, -1, 0]]
    centre, size = corners.mean(axis=0), _size(nodes)
    turn = rng.normal(0, 0.2)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    far, to = size * (abs(rng.normal(0, 0.12)) if picture is None else rng.uniform(0.4, 1.0)), rng.uniform(0, 2 * np.pi)
    scale = rng.uniform(0.7, 1.6) if picture is None else rng.uniform(0.8, 1.15)
    placed = (corners - centre) * scale @ axes + centre + far * np.array([np.cos(to), np.sin(to)])
    if picture is None:
        colour = np.clip(rng.uniform(4, 250) * np.exp2(rng.normal(0, 0.1, 3)), 0, 255)
        laid = np.full_like(photo, np.rint(colour).astype(np.uint8))
    else:
        film = picture()
        side = np.float32(len(film))
        square = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32)
        to_photo = cv2.getPerspectiveTransform(opencv_from_photo(square), opencv_from_photo(placed.astype(np.float32)))
        laid = cv2.warpPerspective(film, to_photo, (w, h))
    share = cv2.multiply(_filled(placed, (h, w)), free, scale=1 / 255) / np.float32(255)
    return cv2.blendLinear(laid, photo, share, 1 - share)


def another_film(place: Place, rng: np.random.Generator) -> Picture:
    """The flat film of another sample of the same shard, in its light."""
    shard, index = place
    other = shard, (index + 1 + int(rng.integers(max(len(shard) - 1, 1)))) % len(shard)
    return view_image(photo_of(other), film_view(film_of(other), 0.0), FILM_PX)


def _darkened(photo: Picture, share: Grey, rng: np.random.Generator) -> Picture:
    """The photo with some of its light taken, by ``share`` of 255, and a little of its colour: other light is left."""
    taken = np.clip(rng.uniform(0.15, 0.9) + 0.08 * rng.normal(0, 1) * np.array([1.0, 0.0, -1.0]), 0, 0.95)
    left = np.rint(255 - np.arange(256)[:, None] * taken).astype(np.uint8)
    return cv2.multiply(photo, cv2.LUT(cv2.merge([share] * 3), left[None]), scale=1 / 255)


def _size(nodes: Float[np.ndarray, "n m 2"]) -> float:
    """Of the film in the photo, in pixels."""
    return float(np.linalg.norm(np.ptp(nodes, axis=(0, 1))) / np.sqrt(2))


def _filled(outline: Float[np.ndarray, "n 2"], size: tuple[int, ...]) -> Grey:
    """Share, of 255, of each pixel within an outline of photo points, to a quarter of a pixel."""
    mask = np.zeros((size[0] * _FINER, size[1] * _FINER), np.uint8)
    fixed = np.clip(opencv_from_photo(outline * _FINER) * 16, -(2**19), 2**19).round().astype(np.int32)
    cv2.fillPoly(mask, [fixed], 255, shift=4)
    return cv2.resize(mask, size[::-1], interpolation=cv2.INTER_AREA)


def _within(film: Grey) -> Grey:
    """The film without its rim, in which the lens mixes the ground: left as it was it would tell film from the rest."""
    soft = cv2.GaussianBlur(film, (0, 0), LENS_PX)
    return cv2.LUT(soft, np.clip(2 * np.arange(256) - 255, 0, 255).astype(np.uint8))
