"""Fuse several photos of one film into one: register them on the flat film, then merge them weighted by trust.

A reflection moves when the phone or the lamp does; the print does not. Each photo is flattened on its own. Matched
patches measure how far its film is still displaced from the first. The maps err independently, so all of them are
moved, smoothly, to the middle of where they place the print, and each photo is resampled once through its moved map.
What differs from the other photos is then left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from hybrid.backward import BackwardMap, Orientation
from hybrid.coords import centres_1d, film_from_pixel, film_nodes, pixel_from_film, sample_bilinear
from hybrid.errors import FusionError, describe, require_at_least, require_at_most
from hybrid.levels import LevelReader
from hybrid.records import LeftOut, RectifyResult, SliceGrid, StageReport
from hybrid.rectify.coarse.consensus import read_beside, to_common
from hybrid.rectify.film.deilluminate import DeilluminateConfig, read_light, recovered
from hybrid.rectify.film.merge import Film, MergeConfig, detail_of, merge, reduced
from hybrid.rectify.film.resample import ResampleConfig, read_film
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


# ---------------------------------------------------------------- registration


def register(
    first: RectifyResult, other: RectifyResult, config: FuseConfig, names: tuple[str, str] = ("photo 1", "photo 2")
) -> Registration:
    """Where the other photo shows the first photo's film. names: of both, for messages.

    Raises:
        FusionError: the photos show different films, or too little of them to tell.
    """
    fixed = _details(first, Orientation(0, False), _film_of(first).shape, config)
    best, agreement = None, -1.0
    for index in range(8):  # almost always the first: both were turned upright
        way = Orientation.from_index(index)
        moving = _details(other, way, _film_of(first).shape, config)
        shift = _registered(fixed, moving, config)
        believed = np.linalg.norm(shift, axis=-1).max() <= MAX_SHIFT
        found = _agreement(fixed[0], _moved_by(moving[0], shift), first.grid) if believed else 0.0
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
    film, unseen = (np.ascontiguousarray(way.moved(x)) for x in (_film_of(result), _untrusted(result)))
    return [detail_of(film, unseen, reduced(size, side)) for side in config.sides_px]


def _registered(
    fixed: Sequence[AnyFilm], moving: Sequence[AnyFilm], config: FuseConfig
) -> Float[np.ndarray, "gh gw 2"]:
    """Displacement of the moving film's points from the fixed film's, in film units, on nodes; found coarse to fine."""
    nodes = (NODES, NODES)
    shift = np.zeros((*nodes, 2)) + _whole_shift(fixed[0], moving[0])
    for a, b in zip(fixed, moving, strict=True):
        found = _match(a, _moved_by(b, shift), config)
        if found is not None:
            shift = shift + _smooth(*found, nodes, config)
    return shift


def _film_of(result: RectifyResult) -> Film:
    """The film of a photo in which one was found."""
    if result.film is None:
        raise FusionError(describe(what="Photos that cannot be fused", got="one without a film", do="Leave it out."))
    return result.film


def _untrusted(result: RectifyResult) -> Bool[np.ndarray, "h w"]:
    """Pixels that show glare, something in front of the film, or nothing at all."""
    lost = np.zeros(_film_of(result).shape, bool) if result.glare is None else result.glare
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


def _moved_by(moving: Film, shift: Float[np.ndarray, "gh gw 2"]) -> Film:
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


# ---------------------------------------------------------------- all together


@dataclass(frozen=True, eq=False)
class Member:
    """A photo from which the fused film is made.

    index: its place among the given photos. at: where it shows the film of the base, and later the common one.
    """

    index: int
    photo: UInt8[np.ndarray, "_ _ 3"]
    result: RectifyResult
    at: Registration

    @property
    def side_px(self) -> float:
        """Longer side of its film in its photo."""
        return max(self.at.turned.mean_film_pixels())

    def cover_on(self, size: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
        """Where something lies in front of the film, on the common film of ``size``."""
        covered = self.result.covered
        if covered is None or not covered.any():
            return np.zeros(size, dtype=bool)
        own = np.ascontiguousarray(self.at.way.moved(covered)).astype(np.float32)
        return _moved_by(cv2.resize(own, size[::-1], interpolation=cv2.INTER_LINEAR), self.at.shift) >= 0.5


def fuse(
    photos: Sequence[UInt8[np.ndarray, "_ _ 3"]],
    results: Sequence[RectifyResult],
    reader: LevelReader,
    config: FuseConfig | None = None,
    light: DeilluminateConfig | None = None,
    resample: ResampleConfig | None = None,
    names: Sequence[str] | None = None,
) -> RectifyResult:
    """One result from several photos of one film, oriented as in the base, as large as the largest.

    results: of the photos; those without a film are left out, and if none has one, the first is returned. reader: of
    their light. names: of the photos, for messages.
    The base (``result.photo``) is the first photo whose map is sure or, if none is, the first with a film. rectified
    and backward are its own, moved to where the photos with sure maps (all, if none is sure) together place the print;
    expected error and grid come from these photos, the status from the base. film, glare, covered and confidence are
    made from all.

    Raises:
        FusionError: the photos show different films.
    """
    config, start = config or FuseConfig(), perf_counter()
    names = names or [f"photo {number}" for number in range(1, len(photos) + 1)]
    showing = [index for index, result in enumerate(results) if result.status.has_film]
    if not showing:
        return results[0]
    at = next((index for index in showing if results[index].status.ok), showing[0])
    members, left_out, notes = _members(photos, results, at, config, names)
    counts = [one.result.status.ok or not results[at].status.ok for one in members]
    common = to_common([one.at.shift for one in members], counts)
    members = [replace(one, at=replace(one.at, shift=shift)) for one, shift in zip(members, common, strict=True)]
    base = next(one for one in members if one.index == at)
    asked = [one for one, counted in zip(members, counts, strict=True) if counted]
    merged = _merged(members, base, reader, config.merge, light or DeilluminateConfig(), resample)
    shares = ", ".join(f"{share:.0%}" for share in merged.shares)
    without = [f"{names[one.photo]} left out: {one.why}" for one in left_out]
    several = f"{len(members)} photo{'s' * (len(members) > 1)}"
    others = sum(stage.seconds for one in results if one is not base.result for stage in one.stages)
    report = StageReport(
        "fuse",
        True,
        "; ".join([several, *without, *notes, f"shares {shares}"]),
        others + perf_counter() - start,
    )
    return replace(
        base.result,
        expected_error_px=_expected_px(asked, base),
        film=merged.film,
        rectified=merged.rectified,
        backward=base.at.backward,
        grid=_surest_grid(asked, base),
        glare=merged.glare,
        covered=merged.covered,
        confidence=merged.confidence,
        stages=(*base.result.stages, report),
        photo=at,
        left_out=tuple(left_out),
    )


def _members(
    photos: Sequence[UInt8[np.ndarray, "_ _ 3"]],
    results: Sequence[RectifyResult],
    at: int,
    config: FuseConfig,
    names: Sequence[str],
) -> tuple[list[Member], list[LeftOut], list[str]]:
    """The photos that show the film of the one at ``at``, those left out and why, and notes on the former.

    Raises:
        FusionError: a photo whose map is sure shows another film.
    """
    base = results[at]
    if base.backward is None:
        raise FusionError(describe(what="Photos that cannot be fused", got="one without a map", do="Leave it out."))
    members, left_out, notes = [], [], []
    for index, result in enumerate(results):
        if index == at:
            itself = Registration(base.backward, np.zeros((NODES, NODES, 2)), Orientation(0, False), 1.0)
            members.append(Member(at, photos[at], base, itself))
        elif not result.status.has_film:
            left_out.append(LeftOut(index, "no film was found in it"))
        else:
            try:
                found = register(base, result, config, (names[at], names[index]))
            except FusionError:
                if result.status.ok:
                    raise
                left_out.append(LeftOut(index, f"itself unsure, it is not like {names[at]}"))
                continue
            members.append(Member(index, photos[index], result, found))
            unsure = "" if result.status.ok else ", itself unsure"
            notes.append(f"{names[index]} moved by up to {found.largest:.1%} of the film{unsure}")
    return members, left_out, notes


@dataclass(frozen=True, eq=False)
class Merged:
    """The common film of all members: film, glare, covered, confidence as in a RectifyResult, (h, w); rectified as the
    base shows it; shares: each member's share of the film."""

    film: Film
    rectified: UInt8[np.ndarray, "h w 3"]
    glare: Bool[np.ndarray, "h w"]
    covered: Bool[np.ndarray, "h w"]
    confidence: Film
    shares: tuple[float, ...]


def _merged(
    members: Sequence[Member],
    base: Member,
    reader: LevelReader,
    config: MergeConfig,
    light: DeilluminateConfig,
    resample: ResampleConfig | None,
) -> Merged:
    """The photos resampled through their maps, freed of their light, and merged."""
    size = _largest_size(members, base)
    flats = [read_film(one.photo, one.at.backward, size, resample) for one in members]
    covers = [one.cover_on(size) for one in members]
    print_seen = [flat.valid & ~cover for flat, cover in zip(flats, covers, strict=True)]
    reads = [read_light(flat.image, seen, reader, light) for flat, seen in zip(flats, print_seen, strict=True)]
    tone = float(np.median([one.levels.root_share for one in reads]))  # it is one print, and mostly one camera
    lights = [
        recovered(flat.image, flat.valid, seen, one.of_tone(tone), light)
        for flat, seen, one in zip(flats, print_seen, reads, strict=True)
    ]
    fused = merge(
        [one.film for one in lights],
        [one.glare | ~seen for one, seen in zip(lights, print_seen, strict=True)],
        [one.confidence for one in lights],
        config,
    )
    glare = fused.lost & np.logical_or.reduce([one.glare for one in lights])
    covered = fused.lost & ~glare & np.logical_or.reduce(covers)
    shown = next(flat.image for flat, one in zip(flats, members, strict=True) if one is base)
    return Merged(fused.film, shown, glare, covered, fused.confidence, tuple(fused.shares))


def _largest_size(members: Sequence[Member], base: Member) -> tuple[int, int]:
    """Height and width of the fused film: the base's aspect ratio and the largest film's longer side."""
    height, width = _film_of(base.result).shape
    more = max(max(_film_of(one.result).shape) for one in members) / max(height, width)
    return round(more * height), round(more * width)


def _surest_grid(members: Sequence[Member], base: Member) -> SliceGrid | None:
    """The grid of the greatest confidence, moved onto the common film; None without any."""
    seen = [(one.result.grid.turned(one.at.way), one.at.shift) for one in members if one.result.grid is not None]
    if not seen:
        return None
    grid, shift = max(seen, key=lambda one: one[0].confidence)
    beside, vertices = BackwardMap(shift), grid.vertices
    for _ in range(3):  # the common film's point that lies there once it is shifted
        vertices = grid.vertices - beside.photo_from_film(vertices)
    return replace(grid, vertices=vertices, vertices_photo=base.at.backward.photo_from_film(vertices))


def _expected_px(members: Sequence[Member], base: Member) -> float | None:
    """Mean expected error of the members' maps, in pixels of the base; None if none is known."""
    known = [(one.result.expected_error_px, one.side_px) for one in members]
    errors = [px * base.side_px / side for px, side in known if px is not None]
    return float(np.mean(errors)) if errors else None


__all__ = ["FuseConfig", "Registration", "fuse", "phase_shift", "register"]
