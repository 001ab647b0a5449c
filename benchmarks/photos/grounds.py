"""Photos with truth, changed around their film: what it may lie on or beside, and how it may lie in the frame.

The film itself stays as it was photographed. The things that networks are trained with behind films
(hybrid/learn/datasets/behind.py) are drawn by other rules: of these changes only the hard shadow and the round corners
are much alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from benchmarks.photos.damage import Damaged
from hybrid.backward import BackwardMap
from hybrid.coords import FILM_CORNERS, film_nodes, opencv_from_photo
from hybrid.learn.datasets.behind import filled, ground_of, mixed
from hybrid.learn.datasets.rounded import cut_share
from hybrid.round_corners import RoundCorners

Picture = UInt8[np.ndarray, "h w 3"]

_ALONG = 129


@dataclass(frozen=True, eq=False)
class Sheet:
    """A film in a photo, and where it is seen there."""

    photo: Picture
    backward: BackwardMap

    @cached_property
    def nodes(self) -> Float[np.ndarray, "n n 2"]:
        """Photo points of a lattice of film points, edges included."""
        return self.backward.photo_from_film(film_nodes((_ALONG, _ALONG)))

    @cached_property
    def box(self) -> Float[np.ndarray, "2 2"]:
        """The least and the largest x and y of its photo points."""
        return np.stack([self.nodes.min(axis=(0, 1)), self.nodes.max(axis=(0, 1))])

    @cached_property
    def ground(self) -> UInt8[np.ndarray, "h w"]:
        """Share, of 255, of ground (not film) in each pixel."""
        return ground_of(BackwardMap(self.nodes).outline(), self.photo.shape[:2])

    def on(self, other: Picture, share: UInt8[np.ndarray, "h w"] | None = None) -> Picture:
        """The photo with another picture in place of its ground, or of a share of it."""
        return mixed(self.photo, other, self.ground if share is None else self.seen(share))

    def seen(self, share: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
        """The part of a share of each pixel that is ground."""
        return cv2.multiply(self.ground, share, scale=1 / 255)


Change = Callable[[Sheet, Sheet, np.random.Generator], Damaged]
"""From a film, and another film to lay beside it, to the changed photo and its truth."""


# ---------------------------------------------------------------- what the film lies on


def _on(picture: Callable[[Sheet, np.random.Generator], Picture]) -> Change:
    return lambda sheet, other, rng: Damaged(sheet.on(picture(sheet, rng)), sheet.backward)


def _plain(sheet: Sheet, colour: Float[np.ndarray, "3"], rng: np.random.Generator) -> Picture:
    """One colour with a little noise, like a surface without marks."""
    noisy = np.asarray(colour) + rng.normal(0, 1.5, sheet.photo.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def _as_black(sheet: Sheet, rng: np.random.Generator) -> Picture:
    """As dark as the darkest parts of the film."""
    film = sheet.photo[sheet.ground == 0]
    dark = film[film.sum(axis=1) <= np.percentile(film.sum(axis=1), 10)] if len(film) else np.zeros((1, 3))
    return _plain(sheet, dark.mean(axis=0), rng)


def _cloth(crossed: bool, sheet: Sheet, rng: np.random.Generator) -> Picture:
    """A table cloth of two colours, in perspective: striped or chequered."""
    h, w = sheet.photo.shape[:2]
    turn, period = rng.uniform(0, np.pi), max(h, w) * rng.uniform(0.04, 0.15)
    y, x = np.mgrid[:h, :w] / max(h, w) - 0.5
    depth = 1 + 0.5 * (np.cos(turn) * y + np.sin(turn) * x) * rng.uniform(-1, 1)
    along, across = ((np.cos(a) * x + np.sin(a) * y) / depth * max(h, w) / period for a in (turn, turn + np.pi / 2))
    inked = np.floor(along) % 2 == (np.floor(across) % 2 if crossed else 0)
    two = rng.uniform(10, 245, (2, 3))
    cloth = np.where(inked[..., None], two[0], two[1]).astype(np.uint8)
    return cv2.GaussianBlur(cloth, (0, 0), 1.0)


def _page(sheet: Sheet, rng: np.random.Generator) -> Picture:
    """Lines of print, like a report below the film."""
    h, w = sheet.photo.shape[:2]
    page = np.full((h, w, 3), rng.uniform(190, 250), np.uint8)
    letters = list("abcdefghiklmnoprstuvwxyz  ")
    height = max(h, w) * rng.uniform(0.012, 0.025)
    for row in np.arange(height, h, 1.8 * height):
        words = "".join(rng.choice(letters, 400))
        cv2.putText(page, words, (round(0.05 * w), round(row)), cv2.FONT_HERSHEY_SIMPLEX, height / 30, (40, 40, 40), 1,
                    cv2.LINE_AA)  # fmt: skip
    return page


# ---------------------------------------------------------------- what lies below or beside it


def _below(grey: tuple[float, float]) -> Change:
    """A sheet of plain paper below the film and a little larger, of a grey within a range."""

    def change(sheet: Sheet, other: Sheet, rng: np.random.Generator) -> Damaged:
        points = sheet.nodes.reshape(-1, 2).astype(np.float32)
        corners = cv2.boxPoints(cv2.minAreaRect(points)).astype(np.float64)
        middle = corners.mean(axis=0)
        outline = middle + (corners - middle) * rng.uniform(1.05, 1.3, (1, 1))
        outline += rng.normal(0, 0.03, 2) * np.ptp(corners, axis=0)
        paper = _plain(sheet, np.full(3, rng.uniform(*grey)), rng)
        return Damaged(sheet.on(paper, filled(outline, sheet.photo.shape[:2])), sheet.backward)

    return change


def _beside(sides: int) -> Change:
    """Another film, bent and lit as in its own photo, on this many sides of this one, with or without a gap."""

    def change(sheet: Sheet, other: Sheet, rng: np.random.Generator) -> Damaged:
        size, (low, high) = sheet.photo.shape[:2], sheet.box
        scale = float(np.prod(high - low) / np.prod(other.box[1] - other.box[0])) ** 0.5
        middle, apart = (low + high) / 2, (high - low) / 2 + scale * (other.box[1] - other.box[0]) / 2
        photo = sheet.photo
        for way in rng.permutation(np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))[:sides]:
            at = middle + way * apart * rng.uniform(0.95, 1.1)
            shift = at - scale * other.box.mean(axis=0)
            moved = _for_opencv(np.column_stack([scale * np.eye(2), shift]))
            there = cv2.warpAffine(other.photo, moved, size[::-1])
            ground = cv2.warpAffine(other.ground, moved, size[::-1], borderValue=(255,))
            photo = mixed(photo, there, sheet.seen(255 - ground))
        return Damaged(photo, sheet.backward)

    return change


def _hard_shadow(sheet: Sheet, other: Sheet, rng: np.random.Generator) -> Damaged:
    """The film's own shadow, as a small lamp casts it on a wall behind."""
    outline, middle = sheet.backward.outline(), sheet.box.mean(axis=0)
    turn, size = rng.uniform(0, 2 * np.pi), float(np.hypot(*np.ptp(sheet.box, axis=0))) / np.sqrt(2)
    shear = np.eye(2) * rng.uniform(1.0, 1.2) + rng.normal(0, 0.03, (2, 2))
    far = size * rng.uniform(0.05, 0.3) * np.array([np.cos(turn), np.sin(turn)])
    shade = filled((outline - middle) @ shear.T + middle + far, sheet.photo.shape[:2])
    shade = cv2.GaussianBlur(shade, (0, 0), max(size * rng.uniform(0.001, 0.006), 0.5))
    dark = np.rint(sheet.photo * rng.uniform(0.25, 0.6)).astype(np.uint8)
    return Damaged(sheet.on(dark, shade), sheet.backward)


def _rounded(sheet: Sheet, other: Sheet, rng: np.random.Generator) -> Damaged:
    """Its corners rounded, as those of films from a box are: the ground near them shows there."""
    down, across = sheet.backward.mean_film_pixels()
    radius = rng.uniform(0.015, 0.04) * max(down, across)
    corners, size = RoundCorners(radius / across, radius / down), (sheet.photo.shape[0], sheet.photo.shape[1])
    ground = (sheet.ground / np.float32(255))[..., None]
    near = radius / 2
    around = cv2.GaussianBlur(sheet.photo * ground, (0, 0), near) / (
        cv2.GaussianBlur(ground, (0, 0), near)[..., None] + 1e-3
    )
    there = np.zeros(size, np.uint8)
    for x, y in np.rint(sheet.backward.photo_from_film(FILM_CORNERS)).astype(int).tolist():
        cv2.circle(there, (x, y), round(1.2 * radius), (255,), -1)
    share = cv2.min(cut_share(sheet.backward, corners, size, 2), there)
    filling = np.clip(np.rint(around), 0, 255).astype(np.uint8)
    return Damaged(mixed(sheet.photo, filling, share), sheet.backward)


# ---------------------------------------------------------------- how it lies in the frame


def _framed(moved: Float[np.ndarray, "2 3"], size: tuple[int, int], sheet: Sheet) -> Damaged:
    """The photo moved within a frame of ``size`` (h, w); beyond its border the edge goes on, ever more blurred."""
    shown, frame = _for_opencv(moved), size[::-1]
    mean = tuple(float(c) for c in sheet.photo.mean(axis=(0, 1)))
    held = np.full(sheet.photo.shape[:2], 255, np.uint8)
    share = cv2.GaussianBlur(cv2.warpAffine(held, shown, frame), (0, 0), 2) / np.float32(255)
    edge = cv2.GaussianBlur(
        cv2.warpAffine(sheet.photo, shown, frame, borderMode=cv2.BORDER_REPLICATE), (0, 0), max(size) / 40
    )
    inner = cv2.warpAffine(sheet.photo, shown, frame, borderValue=mean)
    photo = cv2.blendLinear(inner, edge, share, 1 - share)
    photo = np.where((share > 0.999)[..., None], inner, photo)
    scale = float(abs(np.linalg.det(moved[:, :2]))) ** 0.5
    return Damaged(photo, BackwardMap(sheet.backward.nodes @ moved[:, :2].T + moved[:, 2]), scale)


def _for_opencv(moved: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "2 3"]:
    """Convert an affine map between photo points to one between OpenCV's points."""
    origin = opencv_from_photo(np.zeros(2))
    return np.column_stack([moved[:, :2], moved[:, 2] + origin - moved[:, :2] @ origin])


def _frame(taller: float, wider: float) -> Change:
    """A frame this many times as tall and as wide, with the photo somewhere in it."""

    def change(sheet: Sheet, other: Sheet, rng: np.random.Generator) -> Damaged:
        h, w = sheet.photo.shape[:2]
        size = round(h * taller), round(w * wider)
        room = np.array([size[1] - w, size[0] - h]) * rng.uniform(0.25, 0.75, 2)
        return _framed(np.column_stack([np.eye(2), room]), size, sheet)

    return change


def _turned(sheet: Sheet, other: Sheet, rng: np.random.Generator) -> Damaged:
    """Turned by 45 degrees and scaled down to fit."""
    middle = np.array(sheet.photo.shape[1::-1]) / 2
    turn = 0.72 * np.sqrt(0.5) * np.array([[1.0, -1.0], [1.0, 1.0]])
    size = (sheet.photo.shape[0], sheet.photo.shape[1])
    return _framed(np.column_stack([turn, middle - turn @ middle]), size, sheet)


def _moved(sheet: Sheet, other: Sheet, rng: np.random.Generator) -> Damaged:
    """Blurred along a line, as by an unsteady hand."""
    length = max(3, round(max(sheet.photo.shape[:2]) * rng.uniform(0.005, 0.012)) | 1)
    turn = rng.uniform(0, np.pi)
    kernel = np.zeros((length, length), np.float32)
    reach = (length // 2) * np.array([np.cos(turn), np.sin(turn)])
    ends = [tuple(int(c) for c in np.rint(length // 2 + sign * reach)) for sign in (-1, 1)]
    cv2.line(kernel, ends[0], ends[1], (1.0,), 1, cv2.LINE_AA)
    return Damaged(cv2.filter2D(sheet.photo, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT), sheet.backward)


CHANGES: dict[str, tuple[str, Change]] = {
    "plain": ("as they were", lambda sheet, other, rng: Damaged(sheet.photo, sheet.backward)),
    "dark_sheet": ("a dark sheet below", _below((8.0, 45.0))),
    "white_sheet": ("a white sheet below", _below((200.0, 250.0))),
    "as_black": ("on ground as black as the film", _on(_as_black)),
    "checks": ("on a chequered cloth", _on(partial(_cloth, True))),
    "stripes": ("on a striped cloth", _on(partial(_cloth, False))),
    "page": ("on a page of print", _on(_page)),
    "film_beside": ("another film beside", _beside(1)),
    "films_around": ("films on all four sides", _beside(4)),
    "hard_shadow": ("its own hard shadow behind", _hard_shadow),
    "rounded": ("its corners rounded", _rounded),
    "wide": ("in a frame of 5:3", _frame(1.0, 5 / 3)),
    "tall": ("in a frame of 3:5", _frame(5 / 3, 1.0)),
    "small": ("in a frame twice as large", _frame(2.0, 2.0)),
    "turned": ("turned by 45 degrees", _turned),
    "moved": ("blurred by motion", _moved),
}
"""What each change is called, in words, and how it is made."""

__all__ = ["CHANGES", "Sheet"]
