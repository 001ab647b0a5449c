"""How flat films of several photos lie beside each other: matched patches give the smooth displacement between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from hybrid.backward import BackwardMap, Orientation
from hybrid.coords import centres_1d, film_from_pixel, film_nodes, pixel_from_film, sample_bilinear
from hybrid.errors import FusionError, describe, require_at_least, require_at_most
from hybrid.records import RectifyResult, SliceGrid
from hybrid.rectify.coarse.consensus import read_beside
from hybrid.rectify.fusion.merge import Film, MergeConfig, detail_of, reduced
from hybrid.rectify.splines import bspline
from hybrid.rectify.splines.bspline import NormalEquations
from hybrid.rectify.splines.tps import mad_sigma

AnyFilm = Float32[np.ndarray, "_ _"]
"""One of several films of different sizes."""

NODES = 33
"""Nodes along each side of displacement fields, and of the maps made from them."""

MIN_SLICES = 6
"""Fewer slices than this do not show what all have in common."""

MIN_SIGMA = 4.0
"""Number of standard errors by which films must agree better in place than out of place."""

MAX_SHIFT = 0.1
"""Largest shift, in film units: two flat films of one sheet never lie farther apart, patches matched by chance do."""

MIN_PATCHES = 12
"""Fewer patches with detail than this do not determine a displacement."""


@dataclass(frozen=True)
class FuseConfig:
    """How photos of one film are registered and merged."""

    sides_px: tuple[int, ...] = (384, 1024)
    """Longer sides of the reduced films that are registered, one after the other."""
    patch_px: int = 64
    """Side of the patches that are matched; they overlap by half."""
    intervals: int = 5
    """Knot intervals of the smooth displacement along each side."""
    smoothing: float = 1e-5
    least_contrast: float = 0.5
    """Standard deviation of a patch's detail, relative to the film's, below which it is ignored."""
    same: float = 0.4
    """Films are the same print if at least this share of slices is found in place on both, once registered."""
    merge: MergeConfig = field(default_factory=MergeConfig)

    def __post_init__(self) -> None:
        require_at_least(self, 8, "patch_px", "sides_px")
        require_at_least(self, 1, "intervals")
        require_at_least(self, 0, "smoothing", "least_contrast", "same")
        require_at_most(self, 1, "same")


@dataclass(frozen=True, eq=False)
class Registration:
    """Where another photo shows the film of the first: its map, how it had to be moved, and how well the films agree.

    turned: the other photo's own map, turned as ``way`` says. shift: (gh, gw, 2) displacement of its film's points from
    those of the first, in film units, on film nodes. agreement: share of slices found in their place.
    """

    turned: BackwardMap
    shift: Float[np.ndarray, "gh gw 2"]
    way: Orientation
    agreement: float

    @property
    def backward(self) -> BackwardMap:
        """From the first film's uv to the other photo."""
        return read_beside(self.turned, self.shift)

    @property
    def largest(self) -> float:
        """The largest displacement, in film units."""
        return float(np.linalg.norm(self.shift, axis=-1).max())


def register(
    first: RectifyResult, other: RectifyResult, config: FuseConfig, names: tuple[str, str] = ("photo 1", "photo 2")
) -> Registration:
    """Where the other photo shows the first photo's film. names: of both, for messages.

    Raises:
        FusionError: the photos show different films, or too little of them to tell.
    """
    fixed = _details(first, Orientation(0, False), film_of(first).shape, config)
    best, agreement = None, -1.0
    for index in range(8):  # almost always the first: both were turned upright
        way = Orientation.from_index(index)
        moving = _details(other, way, film_of(first).shape, config)
        shift = _registered(fixed, moving, config)
        believed = np.linalg.norm(shift, axis=-1).max() <= MAX_SHIFT
        found = _agreement(fixed[0], moved_by(moving[0], shift), first.grid) if believed else 0.0
        if found > agreement:
            best, agreement = (way, shift), found
        if agreement >= config.same:
            break
    if best is None or other.backward is None or agreement < config.same:
        raise FusionError(
            describe(
                what="Photos that cannot be fused",
                where=names[1],
                got=f"another film than on {names[0]}, or too little of it: {agreement:.0%} of its slices are found "
                "there",
                allowed=f"photos of one film ({config.same:.0%} or more)",
                do="Leave it out, or fuse it with photos of its own film.",
            )
        )
    way, shift = best
    return Registration(other.backward.turned(way), shift, way, agreement)


def _details(result: RectifyResult, way: Orientation, size: tuple[int, ...], config: FuseConfig) -> list[AnyFilm]:
    """The detail of a film in a given orientation, on reduced copies of a film of ``size``."""
    film, unseen = (np.ascontiguousarray(way.moved(x)) for x in (film_of(result), _untrusted(result)))
    return [detail_of(film, unseen, reduced(size, side)) for side in config.sides_px]


def _registered(
    fixed: Sequence[AnyFilm], moving: Sequence[AnyFilm], config: FuseConfig
) -> Float[np.ndarray, "gh gw 2"]:
    """Displacement of the moving film's points from the fixed film's, in film units, on nodes; found coarse to fine."""
    nodes = (NODES, NODES)
    shift = np.zeros((*nodes, 2)) + _whole_shift(fixed[0], moving[0])
    for a, b in zip(fixed, moving, strict=True):
        found = _match(a, moved_by(b, shift), config)
        if found is not None:
            shift = shift + _smooth(*found, nodes, config)
    return shift


def film_of(result: RectifyResult) -> Film:
    """The film of a photo in which one was found."""
    if result.film is None:
        raise FusionError(describe(what="Photos that cannot be fused", got="one without a film", do="Leave it out."))
    return result.film


def _untrusted(result: RectifyResult) -> Bool[np.ndarray, "h w"]:
    """Pixels that show glare, something in front of the film, or nothing at all."""
    lost = np.zeros(film_of(result).shape, bool) if result.glare is None else result.glare
    return lost if result.confidence is None else lost | (result.confidence <= 0)


def _whole_shift(fixed: Film, moving: Film) -> Float[np.ndarray, "2"]:
    """Film units by which ``moving`` as a whole lies to the right of and below ``fixed``."""
    x, y, _ = phase_shift(fixed, moving)
    return film_from_pixel(np.array([x, y]), (fixed.shape[0], fixed.shape[1]))


def phase_shift(fixed: Film, moving: Film) -> tuple[float, float, float]:
    """Pixels by which ``moving`` lies to the right of and below ``fixed``, and how clearly (0 to about 1).

    OpenCV 5.0 applies the window in place to pictures whose sizes suit its Fourier transform, so it is given copies.
    Where the transform has an odd size, it takes the middle to be half a pixel less than it is.
    """
    window = cv2.createHanningWindow(fixed.shape[::-1], cv2.CV_32F)
    (x, y), response = cv2.phaseCorrelate(fixed.copy(), moving.copy(), window)
    odd_y, odd_x = (cv2.getOptimalDFTSize(n) % 2 for n in fixed.shape)
    return x - odd_x / 2, y - odd_y / 2, response


def moved_by(moving: Film, shift: Float[np.ndarray, "gh gw 2"]) -> Film:
    """The picture resampled so that each film point gets the value displaced from it by ``shift`` (on film nodes)."""
    size = (moving.shape[0], moving.shape[1])
    dense = BackwardMap(pixel_from_film(film_nodes(shift.shape[:2]) + shift, size)).dense(size)
    return sample_bilinear(moving, dense)


def _patches(size: tuple[int, ...], side: int) -> list[tuple[slice, slice]]:
    """Windows of ``side`` pixels that overlap by half."""
    tops, lefts = (range(0, n - side + 1, side // 2) for n in size)
    return [(slice(top, top + side), slice(left, left + side)) for top in tops for left in lefts]


def _match(
    fixed: Film, moving: Film, config: FuseConfig
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]] | None:
    """Film uv of patches, their displacement in film units, and their weights; None if there are too few."""
    size = (fixed.shape[0], fixed.shape[1])
    side = min(config.patch_px, min(size) // 3)
    whole = (float(fixed.std()), float(moving.std()))
    at, moved, weight = [], [], []
    for part in _patches(size, side):
        a, b = fixed[part], moving[part]
        if a.std() < config.least_contrast * whole[0] or b.std() < config.least_contrast * whole[1]:
            continue
        x, y, response = phase_shift(a, b)
        if max(abs(x), abs(y)) > side / 3:
            continue
        at.append((part[1].start + side / 2, part[0].start + side / 2))
        moved.append((x, y))
        weight.append(response)
    if len(at) < MIN_PATCHES:
        return None
    weights = np.clip(np.array(weight), 1e-3, 1.0) ** 2
    return film_from_pixel(np.array(at), size), film_from_pixel(np.array(moved), size), weights


def _smooth(
    at: Float[np.ndarray, "n 2"], moved: Float[np.ndarray, "n 2"], weight: Float[np.ndarray, " n"],
    size: tuple[int, int], config: FuseConfig,
) -> Float[np.ndarray, "gh gw 2"]:  # fmt: skip
    """A smooth displacement fitted robustly to those of the patches, on ``size`` film nodes."""
    rows = bspline.design(at, config.intervals)
    trust = weight
    fit = NormalEquations.of(rows, trust, moved, config.intervals).solve(config.smoothing)
    for _ in range(6):
        distance = np.linalg.norm(moved - rows @ fit, axis=1)
        scale = max(3 * mad_sigma(distance), 1e-6)
        trust = weight * np.maximum(1 - (distance / scale) ** 2, 0) ** 2 + 1e-12
        fit = NormalEquations.of(rows, trust, moved, config.intervals).solve(config.smoothing)
    return bspline.on_lattice(fit, size, config.intervals)


def _agreement(fixed: Film, moving: Film, grid: SliceGrid | None) -> float:
    """Share of the first film's parts that are more like the same part of the other film than like any other part.

    Parts are the slices, without what is alike in all of them: films of one examination share rules and texts, and
    their slices resemble each other. Only the half of the parts with most detail counts. 0 where parts resemble those
    in their place more than others by less than MIN_SIGMA standard errors: that may be chance.
    """
    if grid is not None and grid.rows * grid.cols >= MIN_SLICES:
        a, b = (_own_of_slices(x, grid) for x in (fixed, moving))
    else:
        side = min(fixed.shape) // 4
        a, b = (np.stack([x[part].ravel() for part in _patches(fixed.shape, side)]) for x in (fixed, moving))
    a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    power_a, power_b = (np.sqrt((x * x).sum(axis=1)) for x in (a, b))
    alike = a @ b.T / np.maximum(power_a[:, None] * power_b, 1e-9)
    full = power_a * power_b >= np.median(power_a * power_b)
    same, others = np.diag(alike)[full], alike[full][~np.eye(len(a), dtype=bool)[full]]
    excess = (same.mean() - others.mean()) / max(float(others.std()), 1e-6) * np.sqrt(len(same))
    own = alike.argmax(axis=1) == np.arange(len(a))
    return float(own[full].mean()) if excess >= MIN_SIGMA else 0.0


def _own_of_slices(detail: Film, grid: SliceGrid) -> Float[np.ndarray, "slices n"]:
    """Each slice's detail minus the median over all slices."""
    slices = _seen_slices(detail, grid, max(round(max(detail.shape) / max(grid.rows, grid.cols)), 16))
    slices = slices - np.median(slices, axis=(0, 2), keepdims=True)
    return slices.swapaxes(1, 2).reshape(grid.rows * grid.cols, -1)


def _seen_slices(film: Film, grid: SliceGrid, samples: int) -> Float32[np.ndarray, "rows n cols n"]:
    """A film's slices, each sampled at ``samples`` x ``samples`` places."""
    along_v, along_u = (
        np.interp(centres_1d(samples * (len(lines) - 1)) / samples, np.arange(len(lines)), lines)
        for lines in (grid.vertices[..., 1].mean(axis=1), grid.vertices[..., 0].mean(axis=0))  # straight on the film
    )
    points = pixel_from_film(np.stack(np.meshgrid(along_u, along_v), axis=-1), (film.shape[0], film.shape[1]))
    return sample_bilinear(film, points).reshape(grid.rows, samples, grid.cols, samples)


__all__ = ["FuseConfig", "Registration", "film_of", "moved_by", "phase_shift", "register"]
