"""What lies behind a film and may be taken for part of it, put into training photos: shadows, sheets, films, patterns.

The data simulate rooms, tables and lamps (data_gen), but not everything that a film may lie on. A network that had not
seen such grounds took film and shadow for one sheet in 14 of 69 photos with truth that were given a hard shadow of the
film. Of 50 photos it was right to 10 px of 1080 in 45 as they were, in 17 with the film laid on a dark sheet, in 33 on
a white one, in 33 beside another film, and in 26 on stripes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, linear_from_srgb, opencv_from_photo, srgb_from_linear
from hybrid.learn.datasets.draws import log_uniform
from hybrid.learn.datasets.samples import Place, film_of, photo_of, round_corners_of, sheet_outline
from hybrid.learn.reading.views import film_view, view_image

Picture = UInt8[np.ndarray, "h w 3"]
Grey = UInt8[np.ndarray, "h w"]
Square = UInt8[np.ndarray, "s s 3"]
Nodes = Float[np.ndarray, "n m 2"]
Outline = Float[np.ndarray, "n 2"]

SHARE = 0.45
"""Share of the photos that may get something behind their film in which something is put there."""

KINDS = {"shadow": 0.2, "sheet": 0.25, "films": 0.4, "pattern": 0.15}
"""Shares of what that is."""

IN_ROW, APART = 0.65, (0.96, 1.13)
"""Share of the photos with further films in which these hang in a row with the film; and the distance of their middles
then, in its sides. On light boxes films hang so, with a gap between parallel edges and one film looking like the other.
"""

MORE_SHARE = 0.25
"""Share with two such things, one upon the other."""

LENS_PX = 0.8
"""Sigma of the blur at a film's rim in the data's photos where the lens is in focus."""

REFERENCE_SIDE = 1000.0
"""Longer side of a photo, in pixels, to which the blur in its record refers."""

MOVED_PX = 2.0
"""Photos blurred by more motion than this are left as they are: the blur differs along the film's rim."""

CLEAR = 0.3
"""Least share of light passing straight through a film at which what lies behind would be seen through it."""

FILM_PX = 192
"""Side of another film's picture."""

_ALONG = 65
_FINER = 2
_LINEAR = linear_from_srgb(np.arange(256) / 255).astype(np.float32)
_MOST = 2**16 - 1
_SRGB = np.rint(255 * srgb_from_linear(np.arange(_MOST + 1) / _MOST)).astype(np.uint8)


def behind_some(place: Place, photo: Picture, film: BackwardMap, rng: np.random.Generator) -> Picture:
    """A sample's photo, at times with something put behind the film; the film itself stays as it was.

    Photos with things over the film stay as they are, as these would be cut off where the film ends. Behind a clear
    film, which would show the rest, only shadows are put.
    """
    if rng.random() >= SHARE:
        return photo
    around = ground_around(place, photo, film)
    if around is None:
        return photo
    outline, free = around
    clear = clear_share(place[0].record(place[1]))
    nodes = film.photo_from_film(film_nodes((_ALONG, _ALONG)))
    for _ in range(1 + int(rng.random() < MORE_SHARE)):
        kind = rng.choice(list(KINDS), p=list(KINDS.values()))
        if kind == "shadow":
            photo = with_shadow(photo, outline, free, rng)
        elif clear > CLEAR:
            continue
        elif kind == "sheet":
            photo = with_sheet(photo, nodes, free, rng)
        elif kind == "films":
            photo = with_films(photo, nodes, free, [another_film(place, rng) for _ in range(_few(rng))], rng)
        else:
            photo = with_pattern(photo, free, rng)
    return photo


def ground_around(place: Place, photo: Picture, film: BackwardMap) -> tuple[Outline, Grey] | None:
    """The film's outline in a sample's photo, and the share, of 255, of the ground in each pixel.

    None for photos with things over the film, and for those blurred by motion.
    """
    shard, index = place
    record, scale = shard.record(index), max(photo.shape) / REFERENCE_SIDE
    lens = record.get("lens", {"defocus_px": 0.0, "motion_px": 0.0})
    if record.get("things") or scale * lens["motion_px"] > MOVED_PX:
        return None
    outline = sheet_outline(film, round_corners_of(place))
    return outline, ground_of(outline, photo.shape[:2], float(np.hypot(LENS_PX, scale * lens["defocus_px"])))


def clear_share(record: dict[str, Any]) -> float:
    """Share of the light that a sample's film sends on which passes straight through it; 0 where it is not known."""
    if "material" not in record:
        return 0.0
    clear, *scattered = (record["material"][name] for name in ("clear", "transmission", "diffuse"))
    return clear / (clear + sum(scattered))


def _few(rng: np.random.Generator) -> int:
    """One, mostly; two or three."""
    return 1 + int(rng.choice(3, p=[0.6, 0.25, 0.15]))


def with_shadow(photo: Picture, outline: Outline, free: Grey, rng: np.random.Generator) -> Picture:
    """A hard shadow of the film's shape, as a point source throws it where the film stands off the ground.

    outline: of the film, in the photo. free: share, of 255, of the ground in each pixel.
    """
    centre, size = outline.mean(axis=0), size_in_photo(outline)
    turn, far = rng.uniform(0, 2 * np.pi), size * rng.uniform(0.02, 0.4)
    thrown = (outline - centre) * rng.uniform(0.95, 1.15) + centre + far * np.array([np.cos(turn), np.sin(turn)])
    return with_shade(photo, thrown, size * log_uniform(rng, (0.001, 0.02)), free, rng)


def with_shade(photo: Picture, shadow: Outline, rim: float, free: Grey, rng: np.random.Generator) -> Picture:
    """The photo with some light taken of its ground within an outline, whose rim is blurred by ``rim`` pixels."""
    shade = cv2.GaussianBlur(filled(shadow, photo.shape[:2]), (0, 0), max(rim, 0.3))
    return _darkened(photo, cv2.multiply(shade, free, scale=1 / 255), rng)


def with_pattern(photo: Picture, free: Grey, rng: np.random.Generator) -> Picture:
    """Stripes, or checks, in what is around the film."""
    h, w = photo.shape[:2]
    period = max(h, w) * log_uniform(rng, (0.015, 0.3))
    turn, duty = rng.uniform(0, np.pi), rng.uniform(0.1, 0.9, 2)
    y, x = np.mgrid[:h, :w].astype(np.float32) / np.float32(period)
    along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    drawn = along % 1 < duty[0]
    if rng.random() < 0.5:
        drawn ^= across % 1 < duty[1]
    soft = cv2.GaussianBlur(drawn.astype(np.uint8) * np.uint8(255), (0, 0), rng.uniform(0.3, 2.0))
    return _darkened(photo, cv2.multiply(soft, free, scale=1 / 255), rng)


def with_sheet(photo: Picture, nodes: Nodes, free: Grey, rng: np.random.Generator) -> Picture:
    """A sheet, larger or smaller than the film, below it: of one colour, which may be near the film's, and shaded.

    nodes: photo points of a lattice of film points, edges included.
    """
    corners, size = _corners(nodes), size_in_photo(nodes)
    to = rng.uniform(0, 2 * np.pi)
    shift = size * abs(rng.normal(0, 0.12)) * np.array([np.cos(to), np.sin(to)])
    placed = _moved(corners, rng.normal(0, 0.2), rng.uniform(0.85, 1.7), shift)
    if rng.random() < 0.5:
        colour = rng.uniform(4, 250) * np.exp2(rng.normal(0, 0.1, 3))
    else:
        at = nodes[tuple(rng.integers(0, _ALONG, 2))]
        x, y = np.clip(at, 0, [photo.shape[1] - 1, photo.shape[0] - 1]).astype(int)
        colour = photo[y, x] * np.exp2(rng.normal(0, 0.3)) + rng.normal(0, 4)
    tilt = rng.normal(0, 0.2, 2)
    axes = (np.linspace(-1, 1, n, dtype=np.float32) for n in photo.shape[:2])
    down, across = (np.exp2(axis * slope).astype(np.float32) for axis, slope in zip(axes, tilt, strict=True))
    shaded = (down[:, None] * across)[..., None] * np.clip(colour, 2, 250).astype(np.float32)
    return _laid(photo, np.clip(shaded, 0, 255).astype(np.uint8), placed, free)


def with_films(
    photo: Picture, nodes: Nodes, free: Grey, pictures: Sequence[Square], rng: np.random.Generator
) -> Picture:
    """Further films, flat: in a row with this one, as on a light box, or at any angle and partly below it.

    pictures: of these films.
    """
    corners, size = _corners(nodes), size_in_photo(nodes)
    in_row = rng.random() < IN_ROW
    for picture in pictures:
        if in_row:
            sides = corners[[1, 2]] - corners[[0, 1]]  # along u and along v
            shift = sides[rng.integers(2)] * rng.choice([-1, 1]) * rng.uniform(*APART)
            placed = _moved(corners, rng.normal(0, 0.03), rng.uniform(0.95, 1.05), shift)
        else:
            to = rng.uniform(0, 2 * np.pi)
            shift = size * rng.uniform(0.4, 1.0) * np.array([np.cos(to), np.sin(to)])
            placed = _moved(corners, rng.normal(0, 0.2), rng.uniform(0.8, 1.15), shift)
        side = np.float32(len(picture))
        square = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32)
        to_photo = cv2.getPerspectiveTransform(opencv_from_photo(square), opencv_from_photo(placed.astype(np.float32)))
        photo = _laid(photo, cv2.warpPerspective(picture, to_photo, photo.shape[1::-1]), placed, free)
    return photo


def another_film(place: Place, rng: np.random.Generator) -> Square:
    """The flat film of another sample of the same shard, in its light."""
    shard, index = place
    other = shard, (index + 1 + int(rng.integers(max(len(shard) - 1, 1)))) % len(shard)
    return view_image(photo_of(other), film_view(film_of(other), 0.0), FILM_PX)


def ground_of(outline: Outline, size: tuple[int, ...], lens_px: float = LENS_PX) -> Grey:
    """Share, of 255, of the ground in each pixel of a photo of ``size`` (h, w), around a film of an outline there.

    All of the film's rim counts as ground, as the lens mixes both there: left as it was, it would give the film away.
    lens_px: sigma of that blur.
    """
    soft = cv2.GaussianBlur(filled(outline, size), (0, 0), lens_px)
    return 255 - cv2.LUT(soft, np.clip(2 * np.arange(256) - 255, 0, 255).astype(np.uint8))


def _darkened(photo: Picture, share: Grey, rng: np.random.Generator) -> Picture:
    """The photo with a part of its light taken, by ``share`` of 255, and the colour of the rest changed a little."""
    taken = np.clip(rng.uniform(0.15, 0.9) + 0.08 * rng.normal(0, 1) * np.array([1.0, 0.0, -1.0]), 0, 0.95)
    left = (_MOST * (1 - np.arange(256)[:, None] / 255 * taken)).astype(np.float32)
    light = cv2.multiply(cv2.LUT(photo, _LINEAR[None]), cv2.LUT(cv2.merge([share] * 3), left[None]))
    return _SRGB[np.rint(light).astype(np.uint16)]


def _laid(photo: Picture, laid: Picture, outline: Float[np.ndarray, "4 2"], free: Grey) -> Picture:
    """The photo with another picture in it, within an outline and where the ground is seen."""
    return mixed(photo, laid, cv2.multiply(filled(outline, photo.shape[:2]), free, scale=1 / 255))


def mixed(photo: Picture, other: Picture, share: Grey) -> Picture:
    """The photo with a share, of 255, of another picture."""
    weight = share / np.float32(255)
    return cv2.blendLinear(other, photo, weight, 1 - weight)


def _moved(
    corners: Float[np.ndarray, "4 2"], turn: float, scale: float, shift: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "4 2"]:
    """Corners turned and scaled about their middle, and shifted."""
    centre = corners.mean(axis=0)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return (corners - centre) * scale @ axes + centre + shift


def _corners(nodes: Nodes) -> Float[np.ndarray, "4 2"]:
    """Once around, from the film's top-left."""
    return nodes[[0, 0, -1, -1], [0, -1, -1, 0]]


def size_in_photo(points: Float[np.ndarray, "*n 2"]) -> float:
    """Of the film in the photo, in pixels."""
    return float(np.linalg.norm(np.ptp(points.reshape(-1, 2), axis=0)) / np.sqrt(2))


def filled(outline: Outline, size: tuple[int, ...]) -> Grey:
    """Share, of 255, of each pixel within an outline of photo points, to a quarter of a pixel."""
    mask = np.zeros((size[0] * _FINER, size[1] * _FINER), np.uint8)
    fixed = np.clip(opencv_from_photo(outline * _FINER) * 16, -(2**19), 2**19).round().astype(np.int32)
    cv2.fillPoly(mask, [fixed], 255, shift=4)
    return cv2.resize(mask, size[::-1], interpolation=cv2.INTER_AREA)
