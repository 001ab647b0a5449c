"""Find the sheet's own edges in the photo to a fraction of a pixel, near where a map predicts them.

The photo is sampled in a band across each predicted edge. An edge is where two adjacent windows are each homogeneous
and differ: a printed rule or a text, thinner than a window, spoils its window's homogeneity and so is no edge. Dynamic
programming finds one coherent path along each side. A network that reads edges, but less exactly (edges/paths.py), has
already told the edge from what lies parallel to it, such as the frame of a print or the sheet's shadow, and the path
stays near what it read. A side that shows no contrast gives no sightings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import uniform_filter1d

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d
from hybrid.errors import require_at_least, require_at_most
from hybrid.rectify.edges.curves import best_paths, smooth_curve_weights
from hybrid.rectify.edges.profile import EndOfSheet, end_of_sheet, profiles_along
from hybrid.rectify.splines.sightings import Sightings
from hybrid.strips import SIDES, Side, view_across


@dataclass(frozen=True)
class OutlineConfig:
    """Options of the search for the sheet's edges."""

    band: float = 0.01
    """Half width of the search band, as a fraction of the film's size across the edge."""
    least_px: int = 8
    """The same in pixels, at least: a rule along the edge of a small film needs room for what is beside it."""
    profiles: int = 80
    """Profiles per side."""
    windows_px: tuple[int, int] = (4, 9)
    """Widths of the windows that are compared, in pixels: small ones see narrow margins, large ones skip rules."""
    gap_windows_px: int = 6
    """Width of the windows that are compared with a gap between them."""
    gap_px: int = 3
    """Half of that gap, in pixels: hides a rule that is printed on the very edge."""
    noise_levels: float = 1.5
    """Grey levels that a difference must exceed to count as contrast; sensor and compression noise after averaging."""
    min_score: float = 1.6
    """Least score of an edge point: difference of the windows over their spread."""
    min_share: float = 0.35
    """Least share of a side's profiles that must see the edge."""
    sigma_px: float = 0.35
    """Stated noise of one edge point, in pixels."""
    rule_sigma_px: float = 0.25
    """Standard deviation of the offset that all points of an edge share if a rule is printed along it, in pixels."""
    covered_px: tuple[float, float] = (0.8, 0.8)
    """How far a clipped background covers the film's rim, in pixels: mean and standard deviation."""
    clipped_share: float = 0.7
    """Share of a side's edge points that must be clipped for that."""
    prior: float = 0.02
    """Distance from the prediction, as a fraction of the film's size, that costs a path half a point of score."""
    read_free: float = 0.002
    """How far a path may stray at no cost from an edge read before, beyond its stated deviation, in film units."""
    read_prior: float = 0.003
    """Further distance, as a fraction of the film's size, that costs half a point of score."""
    held_prior: float = 0.0005
    """The same where paths are held to what was read, with no free distance."""
    read_near: float = 0.025
    """How near along the side an edge must have been read for that to count, in film units."""

    def __post_init__(self) -> None:
        require_at_least(self, 4, "profiles")
        require_at_least(self, 1, "windows_px", "gap_windows_px")
        require_at_least(self, 1e-3, "sigma_px", "rule_sigma_px", "covered_px", "noise_levels")
        require_at_least(self, 1e-6, "prior", "read_prior", "held_prior")
        require_at_most(self, 1, "min_share", "clipped_share")

    @property
    def held(self) -> OutlineConfig:
        """The same, with paths held to where edges were read, whatever else looks like one nearby."""
        return replace(self, read_free=0.0, read_prior=self.held_prior)


_NOWHERE = -10.0
"""Score of rows that may not be chosen: so low that no path goes there while there is another way."""
LEAST_FRAMED = 2
"""Number of sides that must show a frame for it to count."""
_ALL = np.ones(3, np.float32)
"""Sums over the colours as a matrix product, which is faster along so short an axis."""


@dataclass(frozen=True, eq=False)
class Strip:
    """The photo across one predicted edge. Row k lies ``depth[k]`` film units inside the prediction.

    image: (depths, profiles, 3) grey levels.
    along: film coordinate of the profiles along the side.
    inside: where the photo covers the strip.
    pixel: film units per row.
    """

    image: Float[np.ndarray, "d p 3"]
    depth: Float[np.ndarray, " d"]
    along: Float[np.ndarray, " p"]
    inside: Bool[np.ndarray, "d p"]
    pixel: float


def find_outline(
    photo: UInt8[np.ndarray, "H W 3"], backward: BackwardMap, config: OutlineConfig, read: Sequence[Sightings] = ()
) -> tuple[Sightings, ...]:
    """Sightings of the sheet's edges through the map, one record for each side on which an edge is seen.

    read: the edges as they were read before (edges/paths.py), through the map; of several lines that look like an edge,
    the one nearby is taken.
    """
    strips = [sample_strip(photo, backward, side, config) for side in SIDES]
    deepest = max(len(strip.depth) for strip in strips)
    scores = np.full((len(strips), deepest, config.profiles), _NOWHERE)
    for k, (strip, side) in enumerate(zip(strips, SIDES, strict=True)):
        prior = _prior(strip, _read_of(side, read), side, config)
        searched = np.abs(strip.depth) <= half_band(strip.pixel, config) * (1 + 1e-9)
        score = edge_score(strip, config) - prior
        scores[k, : len(strip.depth)] = np.where(searched[:, None], score, _NOWHERE)
    paths = best_paths(scores)
    at_path = np.take_along_axis(scores, paths[:, None], axis=1)[:, 0]
    ends = _ends(strips, paths, read)
    depth = np.stack([np.interp(e.rows, np.arange(len(s.depth)), s.depth) for e, s in zip(ends, strips, strict=True)])
    good = (at_path >= config.min_score) & np.isfinite(depth)
    rough = 1.2 * np.array([strip.pixel for strip in strips])
    good &= smooth_curve_weights(strips[0].along, depth, good, rough) > 0.2
    return tuple(
        _side_sightings(strip, side, at_path[k], depth[k], good[k], end, config)
        for k, (strip, side, end) in enumerate(zip(strips, SIDES, ends, strict=True))
        if good[k].mean() >= config.min_share
    )


def _ends(strips: Sequence[Strip], paths: Int[np.ndarray, "b p"], read: Sequence[Sightings]) -> list[EndOfSheet]:
    """Where the sheet ends on each side. A print with a rule along one edge mostly has one along each; a frame counts
    only if two sides have it."""
    profiles = [profiles_along(strip.image, path) for strip, path in zip(strips, paths, strict=True)]

    def framed(expected: bool) -> dict[int, EndOfSheet]:
        ends = {k: end_of_sheet(p, expected, frames=True) for k, p in enumerate(profiles) if p.may_have_frame}
        return {k: end for k, end in ends.items() if _where_read(end, strips[k], SIDES[k], read)}

    ends = [end_of_sheet(p, False) for p in profiles]
    if len(read) >= LEAST_FRAMED and len(framed(expected=False)) >= LEAST_FRAMED:
        wide = framed(expected=True)
        return [wide.get(k, end) for k, end in enumerate(ends)]
    if not any(end.has_rule for end in ends):
        return ends
    return [end if end.has_rule else end_of_sheet(p, True) for p, end in zip(profiles, ends, strict=True)]


def _where_read(end: EndOfSheet, strip: Strip, side: Side, read: Sequence[Sightings]) -> bool:
    """Whether a frame ends the sheet: the edge was read nearer to its outer flank than to its inner one."""
    of_side = _read_of(side, read)
    if not end.has_frame or not of_side:
        return False
    along, depth, _ = _depth_read(of_side[0], side)
    outer = np.interp(end.rows, np.arange(len(strip.depth)), strip.depth)
    beside = np.interp(strip.along, along, depth) - outer
    return bool(np.median(beside) < 0.5 * end.band_px * strip.pixel)


def _prior(strip: Strip, read: Sequence[Sightings], side: Side, config: OutlineConfig) -> Float[np.ndarray, "d p"]:
    """Cost of each place for a path: by its distance from the prediction and from where the edge was read."""
    cost = np.repeat(0.5 * np.square(strip.depth / config.prior)[:, None], len(strip.along), axis=1)
    for edge in read:
        along, depth, sigma = _depth_read(edge, side)
        off = np.abs(strip.depth[:, None] - np.interp(strip.along, along, depth))
        off -= config.read_free + np.interp(strip.along, along, sigma)
        near = np.abs(strip.along[:, None] - along).min(axis=1) < config.read_near
        cost += np.where(near, 0.5 * np.square(np.maximum(off, 0.0) / config.read_prior), 0.0)
    return cost


def _read_of(side: Side, read: Sequence[Sightings]) -> list[Sightings]:
    """The edge of one side, if it was read."""
    return [edge for edge in read if (edge.axis, edge.known[0]) == (side.axis, side.edge)]


def _depth_read(
    edge: Sightings, side: Side
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Where along a side its edge was read, how far inside the prediction, and the stated deviation of that."""
    order = np.argsort(edge.seen[:, 1 - side.axis])
    along, across = edge.seen[order, 1 - side.axis], edge.seen[order, side.axis]
    return along, side.inward * (across - side.edge), edge.sigma[order]


def sample_strip(photo: UInt8[np.ndarray, "H W 3"], backward: BackwardMap, side: Side, config: OutlineConfig) -> Strip:
    """The photo in the band around one predicted edge, averaged a little along the edge."""
    size_px = backward.mean_film_pixels()
    across_px, along_px = (size_px[1], size_px[0]) if side.axis == 0 else size_px
    pixel = 1.0 / max(across_px, 64.0)
    n = int(np.ceil(half_band(pixel, config) / pixel)) + max(config.windows_px)
    depth = pixel * np.arange(-n, n + 1, dtype=np.float64)
    fine = max(1, round(along_px / config.profiles / 2.5))
    image, inside = view_across(photo, backward, side, depth, config.profiles, fine)
    return Strip(image, depth, film_centres_1d(config.profiles), inside, pixel)


def half_band(pixel: float, config: OutlineConfig) -> float:
    """Half width of the search band, in film units, for rows of ``pixel`` film units."""
    return max(config.band, config.least_px * pixel)


def edge_score(strip: Strip, config: OutlineConfig) -> Float[np.ndarray, "d p"]:
    """How much row k looks like the sheet's edge: differing, homogeneous windows on both sides; 0 outside the photo.

    Half of the score leaves a gap between the windows, where a rule printed on the very edge may hide.
    """
    levels = strip.image - strip.image.mean(axis=(0, 1))  # float32 holds sums of the squares of these well enough
    near = [_window_score(levels, w, 1, config.noise_levels) for w in config.windows_px]
    apart = _window_score(levels, config.gap_windows_px, config.gap_px, config.noise_levels)
    score = 0.5 * np.mean([np.minimum(s, 6.0) for s in near], axis=0) + 0.5 * np.minimum(apart, 6.0)
    usable = uniform_filter1d(strip.inside.astype(np.float32), 2 * min(config.windows_px) + 1, axis=0) > 0.999
    return np.where(usable, score, 0.0)


def _window_score(image: Float[np.ndarray, "d p 3"], width: int, gap: int, noise: float) -> Float[np.ndarray, "d p"]:
    """Difference of the means of ``width`` rows that end ``gap`` rows before and after each row, over their spread."""
    d, p = image.shape[:2]
    margin = width + gap
    box = {"ddepth": -1, "ksize": (1, width), "anchor": (0, 0), "borderType": cv2.BORDER_REPLICATE}
    padded = cv2.copyMakeBorder(image.reshape(d, -1), margin, margin, 0, 0, cv2.BORDER_REPLICATE)
    mean, square = (f(padded, **box).reshape(-1, p, 3) for f in (cv2.boxFilter, cv2.sqrBoxFilter))
    outer, inner = slice(1, 1 + d), slice(margin + gap, margin + gap + d)
    variance = np.maximum(square @ _ALL - np.square(mean) @ _ALL, 0.0)
    difference = np.sqrt(np.square(mean[outer] - mean[inner]) @ _ALL)
    return difference / np.sqrt(variance[outer] + variance[inner] + noise**2)


def _side_sightings(
    strip: Strip,
    side: Side,
    at_path: Float[np.ndarray, " p"],
    depth: Float[np.ndarray, " p"],
    good: Bool[np.ndarray, " p"],
    end: EndOfSheet,
    config: OutlineConfig,
) -> Sightings:
    """The edge along one strip where it is seen well. A rule makes its place a little uncertain, and so does clipping:
    the blur of a background that is far brighter than the photo can show covers the film's rim."""
    sigma = config.sigma_px * strip.pixel * np.sqrt(np.clip(4.0 / at_path[good], 1.0, 4.0))
    along, depth = strip.along[good], depth[good]
    if end.clipped[good].mean() > config.clipped_share:
        covered, spread = config.covered_px
        return _may_shift(edge_sightings(side, along, depth - covered * strip.pixel, sigma), spread * strip.pixel)
    seen = edge_sightings(side, along, depth, sigma)
    if end.has_frame:
        return replace(seen, has_frame=True)
    return _may_shift(replace(seen, has_rule=True), config.rule_sigma_px * strip.pixel) if end.has_rule else seen


def edge_sightings(
    side: Side, along: Float[np.ndarray, " n"], depth: Float[np.ndarray, " n"], sigma: Float[np.ndarray, " n"]
) -> Sightings:
    """An edge seen at these places along a side, this far inside of where a map has it."""
    n = len(along)
    seen = side.film_points(along, depth)
    return Sightings(side.axis, seen, np.full(n, side.edge), sigma, np.zeros((n, 0)), np.zeros(0))


def _may_shift(edge: Sightings, sigma: float) -> Sightings:
    """An edge that may be shifted as a whole, with this deviation in film units; its shape stays as seen."""
    return replace(edge, shared=np.ones((len(edge), 1)), shared_sigma=np.array([sigma]))


def expecting_rule(edge: Sightings, width: float) -> Sightings:
    """An edge along which a rule this wide (film units) may be printed that was not distinguished from it."""
    return replace(_may_shift(edge, width), rule_expected=True)


def as_seen(edge: Sightings) -> Sightings:
    """An edge along which a rule was expected, freed of that: its place is where it is seen."""
    return replace(edge, shared=edge.shared[:, :0], shared_sigma=edge.shared_sigma[:0], rule_expected=False)


__all__ = [
    "OutlineConfig",
    "Strip",
    "as_seen",
    "edge_score",
    "edge_sightings",
    "expecting_rule",
    "find_outline",
    "sample_strip",
]
