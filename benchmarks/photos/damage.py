"""Photos damaged at random, with the truth that remains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, opencv_from_photo
from hybrid.draw import resized
from hybrid.rectify.verdict.trust import REFERENCE_PX

SMALLEST_PX, LARGEST_PX = 64.0**2, 100e6
"""Range of areas to which photos are resized."""

LATTICE = (33, 33)
"""Film points, edges included, over which errors are taken."""


@dataclass(frozen=True, eq=False)
class Damaged:
    """A photo and its true map. scale: pixels for each pixel of the original photo. before_px: longer side of the
    original. kinds: the kinds of damage."""

    photo: UInt8[np.ndarray, "h w 3"]
    backward: BackwardMap
    scale: float = 1.0
    kinds: tuple[str, ...] = ()
    before_px: int = REFERENCE_PX

    @property
    def to_reference(self) -> float:
        """Pixels of the original photo, scaled to a longer side of REFERENCE_PX, for each pixel of this one."""
        return REFERENCE_PX / self.before_px / self.scale

    def visible_share(self) -> float:
        """Share of the film that lies within the photo."""
        return float(_inside(self.backward, (self.photo.shape[0], self.photo.shape[1])).mean())


Damage = Callable[[Damaged, np.random.Generator], Damaged]


def damaged(photo: UInt8[np.ndarray, "h w 3"], backward: BackwardMap, rng: np.random.Generator) -> Damaged:
    """A photo with one to three kinds of damage; resizing, if drawn, comes last."""
    names = list(DAMAGES)
    chosen = rng.choice(names, size=int(rng.integers(1, 4)), replace=False)
    result = Damaged(photo, backward, before_px=max(photo.shape[:2]))
    for name in sorted(chosen, key=names.index):
        result = replace(DAMAGES[name](result, rng), kinds=(*result.kinds, str(name)))
    return result


def _noise(it: Damaged, rng: np.random.Generator) -> Damaged:
    sigma = float(10 ** rng.uniform(0.3, 1.9))
    noisy = it.photo + rng.normal(0, sigma, it.photo.shape).astype(np.float32)
    return replace(it, photo=np.clip(np.rint(noisy), 0, 255).astype(np.uint8))


def _blur(it: Damaged, rng: np.random.Generator) -> Damaged:
    return replace(it, photo=cv2.GaussianBlur(it.photo, (0, 0), float(10 ** rng.uniform(-0.2, 1.2))))


def _exposure(it: Damaged, rng: np.random.Generator) -> Damaged:
    gain, lift = float(2 ** rng.uniform(-4, 3)), float(rng.uniform(-60, 60))
    return replace(it, photo=np.clip(it.photo * gain + lift, 0, 255).astype(np.uint8))


def _jpeg(it: Damaged, rng: np.random.Generator) -> Damaged:
    _, coded = cv2.imencode(".jpg", it.photo, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(2, 40))])
    decoded = cv2.imdecode(coded, cv2.IMREAD_COLOR)
    return it if decoded is None else replace(it, photo=np.ascontiguousarray(decoded))


def _cover(it: Damaged, rng: np.random.Generator) -> Damaged:
    """Up to three patches of one colour each, together up to a third of the photo."""
    photo, (height, width) = it.photo.copy(), it.photo.shape[:2]
    for _ in range(int(rng.integers(1, 4))):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        axes = (round(width * rng.uniform(0.03, 0.18)), round(height * rng.uniform(0.03, 0.18)))
        colour = tuple(int(c) for c in rng.integers(0, 256, 3))
        cv2.ellipse(photo, (round(x), round(y)), axes, float(rng.uniform(0, 180)), 0, 360, colour, -1)
    return replace(it, photo=photo)


def _crop(it: Damaged, rng: np.random.Generator) -> Damaged:
    """A window of 40 to 95 % of each side."""
    height, width = it.photo.shape[:2]
    h, w = (max(1, round(side * rng.uniform(0.4, 0.95))) for side in (height, width))
    top, left = int(rng.integers(0, height - h + 1)), int(rng.integers(0, width - w + 1))
    photo = np.ascontiguousarray(it.photo[top : top + h, left : left + w])
    return replace(it, photo=photo, backward=it.backward.cropped((float(left), float(top))))


def _rotate(it: Damaged, rng: np.random.Generator) -> Damaged:
    """Turned by any angle about the middle, with the frame unchanged."""
    height, width = it.photo.shape[:2]
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = np.array([width, height]) / 2
    centre = opencv_from_photo(middle)
    matrix = np.column_stack([turn, centre - turn @ centre])
    photo = cv2.warpAffine(it.photo, matrix, (width, height), flags=cv2.INTER_LINEAR)
    return replace(it, photo=photo, backward=BackwardMap((it.backward.nodes - middle) @ turn.T + middle))


def _resize(it: Damaged, rng: np.random.Generator) -> Damaged:
    """Any area from 64 x 64 pixels to 100 megapixels, uniform in its logarithm."""
    height, width = it.photo.shape[:2]
    factor = float(np.exp(rng.uniform(np.log(SMALLEST_PX), np.log(LARGEST_PX)))) / (height * width)
    size = (max(2, round(height * factor**0.5)), max(2, round(width * factor**0.5)))
    scale = (size[1] / width, size[0] / height)
    truth = it.backward.cropped((0.0, 0.0), scale)
    return replace(it, photo=resized(it.photo, size), backward=truth, scale=it.scale * float(np.sqrt(np.prod(scale))))


DAMAGES: dict[str, Damage] = {
    "cover": _cover,
    "rotate": _rotate,
    "crop": _crop,
    "blur": _blur,
    "exposure": _exposure,
    "noise": _noise,
    "jpeg": _jpeg,
    "resize": _resize,
}
"""In the order in which they are applied to a photo."""

CUT_OFF = "cut off"
"""A file that ends too soon: damage to the bytes, not to the picture."""


def cut_file(photo: UInt8[np.ndarray, "h w 3"], rng: np.random.Generator) -> bytes:
    """A JPEG or PNG of the photo, truncated somewhere."""
    suffix = ".jpg" if rng.random() < 0.7 else ".png"
    _, coded = cv2.imencode(suffix, photo[::2, ::2])
    return coded.tobytes()[: int(rng.uniform(0, 0.995) * coded.size)]


def visible_error_px(found: BackwardMap, true: BackwardMap, size: tuple[int, int]) -> float:
    """Mean distance over the film points that lie within a photo of ``size``; infinite where none does."""
    nodes = film_nodes(LATTICE)
    distances = np.linalg.norm(found.photo_from_film(nodes) - true.photo_from_film(nodes), axis=-1)
    errors = distances[_inside(true, size)]
    return float(errors.mean()) if errors.size else float("inf")


def _inside(backward: BackwardMap, size: tuple[int, int]) -> Bool[np.ndarray, "n n"]:
    """Which points of a lattice over the film lie within a photo of ``size``."""
    points = backward.photo_from_film(film_nodes(LATTICE))
    within: Bool[np.ndarray, "n n"] = np.all((points >= 0) & (points <= np.array(size[::-1])), axis=-1)
    return within


__all__ = ["CUT_OFF", "DAMAGES", "Damaged", "cut_file", "damaged", "visible_error_px"]
