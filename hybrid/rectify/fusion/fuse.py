"""Fuse several photos of one film into one: register them on the flat film, then merge them weighted by trust.

A reflection moves when the phone or the lamp does; the print does not. Each photo is flattened on its own. Matched
patches measure how far its film is still displaced from the first. The maps err independently, so all of them are
moved, smoothly, to the middle of where they place the print, and each photo is resampled once through its moved map.
What differs from the other photos is then left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from hybrid.backward import BackwardMap, Orientation
from hybrid.errors import FusionError, describe
from hybrid.levels import LevelReader
from hybrid.records import LeftOut, RectifyResult, SliceGrid, StageReport
from hybrid.rectify.coarse.consensus import to_common
from hybrid.rectify.film.deilluminate import DeilluminateConfig, read_light, recovered
from hybrid.rectify.film.resample import ResampleConfig, read_film
from hybrid.rectify.fusion.merge import Film, MergeConfig, merge
from hybrid.rectify.fusion.register import NODES, FuseConfig, Registration, film_of, moved_by, register


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
        return moved_by(cv2.resize(own, size[::-1], interpolation=cv2.INTER_LINEAR), self.at.shift) >= 0.5


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
    height, width = film_of(base.result).shape
    more = max(max(film_of(one.result).shape) for one in members) / max(height, width)
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


__all__ = ["fuse"]
