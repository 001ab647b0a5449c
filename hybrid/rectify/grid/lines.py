"""The grid of slices on a roughly flat film: printed rules and gutters, found as combs of straight lines.

A line counts if it is seen in nearly all strips across the film: slices, texts and scale bars are too short for that.
Lines at a regular pitch form a comb; a comb is believed if all its inner lines are seen. Each line is then followed
along its length (grid/follow.py).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, TypeVar

import cv2
import numpy as np
from jaxtyping import Float, Int

from hybrid.coords import film_centres_1d
from hybrid.errors import require_at_least, require_at_most
from hybrid.rectify.splines.sightings import Sightings

Lines = TypeVar("Lines", bound="GridLines")

MAX_CELLS = 10
"""Largest number of slices along either side of a film."""


@dataclass(frozen=True)
class GridConfig:
    """Options of the search for rules and gutters."""

    widths_px: tuple[int, ...] = (2, 5, 10)
    """Widths of lines looked for, in pixels of the film view: rules first, then gutters."""
    strips: int = 16
    """Number of strips across the film; a line should be seen in each."""
    share: float = 0.75
    """Share of the strips that must see a line."""
    lone_share: float = 0.9
    """The same where there is only one line between the cells, so that no pitch confirms it."""
    believed_share: float = 0.9
    """The same for a comb that counts: weaker ones are often the ends of slices."""
    sure_share: float = 0.95
    """The same if nothing repeats at the lines' pitch."""
    slack_px: int = 3
    """How far a line may wander from one strip to the next, in pixels."""
    cap_levels: float = 12.0
    """Responses are capped at this many grey levels, as more says no more: a bone is not a better rule than a rule."""
    min_levels: float = 1.2
    """Least response of a line, in grey levels."""
    min_sigmas: float = 4.0
    """Least response of a line, as a multiple of the film's median absolute response."""
    beside: float = 0.06
    """Lines that lie on average further than this, in cells, from where cells meet as the film was read are not borders
    of cells, but tables or rows of text: 16 of 196 combs on 256 simulated photos do, all of them wrong."""
    beside_read: float = 0.02
    """The same for borders that were read (grid/borders.py), which tell more exactly where cells meet: on 270 photos by
    another renderer, all of 75 combs of couches or texts lie further than this from them, and 7 of 156 others; on 240
    simulated ones, 43 of 52, and 27 of 306."""
    tolerance: float = 0.012
    """How far a line may lie from its place in the comb, in film units."""
    margin: float = 0.16
    """Widest margin around the grid, in film units: apart from it, the grid fills the film."""
    edge: float = 0.012
    """Lines nearer to the film's edge than this are left to the outline."""
    reach_px: int = 5
    """How far from its track a line is searched for when it is followed, in pixels of the film view."""
    coverage: float = 0.5
    """Least share of its length on which a followed line must be found; a comb with too many other lines is refused."""
    stations: int = 64
    """Number of places along a line at which it counts as observed."""
    sigma_px: float = 0.3
    """Stated noise of one such observation, in pixels of the film view."""
    centre_sigma: tuple[float, float] = (0.004, 0.012)
    """Prior standard deviation of a comb's middle about the film's, across and down, in film units: margins are alike
    on both sides, except for a header or footer."""
    pitch_sigma: float = 0.004
    """Prior standard deviation of a comb's pitch, in film units."""
    inset_sigma: float = 0.006
    """Prior standard deviation of the offset of the first and the last line from their places, in film units: up to the
    width of the gaps between cells that have their own frames."""
    snug: float = 0.008
    """A grid whose ends lie this near to the film's edges is taken to fill the film."""
    beyond: float = 0.025
    """The same if its ends lie beyond the film's edges by less than this: no grid does, so the edges are wrong."""
    aside: float = 0.002
    """A grid whose ends both lie further than this from the film's edges, to the same side, does not fill the film."""
    snug_sigma: float = 0.001
    """Prior standard deviation of the place of a grid that fills the film, in film units."""
    flush_sigma: float = 3e-4
    """The same for a grid that ends in rules along the film's edges."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "widths_px", "reach_px", "stations")
        require_at_least(self, 3, "strips")
        require_at_least(self, 1e-3, "min_levels", "sigma_px")
        require_at_least(self, 1e-6, "centre_sigma", "pitch_sigma", "inset_sigma", "snug_sigma", "flush_sigma")
        require_at_most(self, 1, "share", "lone_share", "believed_share", "sure_share", "coverage")


@dataclass(frozen=True, eq=False)
class GridLines:
    """Equally spaced lines across one axis of the film, between which the cells lie.

    axis: 0 for lines u = const, 1 for lines v = const.
    first, pitch: line i lies at ``first + i * pitch``, i = 0..cells; the outermost may be mere ends of margins.
    cells: number of cells along the axis.
    centred: whether the grid's margins are taken to be alike on both sides.
    loose: whether the grid is not taken to fill the film, however near the film's edges it ends.
    """

    axis: int
    first: float
    pitch: float
    cells: int
    centred: bool = field(default=False, kw_only=True)
    loose: bool = field(default=False, kw_only=True)
    pitch_at: ClassVar[int] = 1
    """Index of the pitch among the constants that sightings of the lines share; the place comes first."""

    def adjusted(self: Lines, sightings: Sightings, constants: Float[np.ndarray, " g"]) -> Lines:
        """The same lines, with the place and pitch that a fit to their sightings found."""
        step = np.ptp(sightings.known) / max(np.ptp(sightings.shared[:, 1]), 1.0)
        pitch = float(step if step > 0 else self.pitch) + float(constants[self.pitch_at])
        return replace(self, first=0.5 + float(constants[0]) - 0.5 * self.cells * pitch, pitch=pitch)

    def fills_film(self, config: GridConfig) -> bool:
        """Whether the grid's ends lie on the film's edges, or beyond them because edges were seen too far in.

        Not if one end lies beyond an edge and the other inside: such lines run along one side of every cell."""
        ends = np.array([self.first, 1.0 - self.first - self.cells * self.pitch])
        aside = ends[0] * ends[1] < 0 and np.abs(ends).min() > config.aside
        return not self.loose and bool((ends < config.snug).all() and (ends > -config.beyond).all() and not aside)

    def lines(self) -> Float[np.ndarray, " n"]:
        """Film coordinates of all lines, the grid's ends included."""
        return self.first + self.pitch * np.arange(self.cells + 1)

    def before(self, config: GridConfig) -> tuple[float, Float[np.ndarray, "2"]]:
        """What is known before sightings tell: the pitch, and the deviations of the grid's place and pitch."""
        if self.fills_film(config):
            return 1.0 / self.cells, config.snug_sigma * np.array([1.0, 1.0 / self.cells])
        return self.pitch, np.array([config.centre_sigma[self.axis], config.pitch_sigma])


@dataclass(frozen=True, eq=False)
class Comb(GridLines):
    """Lines that were seen.

    seen: the indices i of the lines that were seen.
    width_px, sign: width of the lines in pixels of the view; +1 for brighter, -1 for darker than what is beside them.
    strength: share of the film's length on which the weakest inner line is seen.
    tracks: film coordinate of each seen line in equal strips along its length.
    """

    seen: Int[np.ndarray, " k"]
    width_px: int
    sign: int
    strength: float
    tracks: Float[np.ndarray, "k s"]

    def straight(self) -> Comb:
        """The comb with its lines where they belong: for a view through a corrected map."""
        places = np.repeat(self.lines()[self.seen][:, None], self.tracks.shape[1], axis=1)
        return replace(self, tracks=places)


@dataclass(frozen=True, eq=False)
class Borders(GridLines):
    """Lines between cells that were read (grid/borders.py), whether or not anything is printed there.

    filling: whether they are taken to reach from edge to edge.
    """

    filling: bool = False

    def fills_film(self, config: GridConfig) -> bool:
        """Whether they are taken to: the ends of the print are read less exactly than the lines inside it."""
        return self.filling


@dataclass(frozen=True, eq=False)
class _Line:
    """A line across the film: its coordinate in each strip, and the share of its length on which it is seen."""

    track: Float[np.ndarray, " s"]
    evidence: float

    @property
    def at(self) -> float:
        """Film coordinate of the line, averaged over its length."""
        return float(self.track.mean())


def narrowed(grey: Float[np.ndarray, "h w"], axis: int) -> Float[np.ndarray, "d n"]:
    """The view, turned so that lines across ``axis`` run along the rows, averaged over 8 pixels along them: the lines
    stay, and there is less to compute."""
    h, w = grey.shape
    size = (max(w // 8, 16), h) if axis == 1 else (w, max(h // 8, 16))
    image = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return image if axis == 1 else np.ascontiguousarray(image.T)


def line_response(image: Float[np.ndarray, "h n"], width: int) -> Float[np.ndarray, "h n"]:
    """How many grey levels the ``width`` rows around each row differ from the rows on both sides of them.

    The weaker of the two sides counts, so that a step is not taken for a line. Positive for bright lines.
    """
    flank = max(2, width // 2 + 1)
    offset = (width + flank + 1) // 2 + 1
    centre = cv2.blur(image, (1, width)) if width % 2 else cv2.sepFilter2D(image, -1, np.ones(1), _even_box(width))
    side = cv2.blur(image, (1, 2 * (flank // 2) + 1))
    side = cv2.copyMakeBorder(side, offset, offset, 0, 0, cv2.BORDER_REPLICATE)
    above, below = centre - side[: -2 * offset], centre - side[2 * offset :]
    return np.maximum(np.minimum(above, below), 0.0) + np.minimum(np.maximum(above, below), 0.0)


def _even_box(width: int) -> Float[np.ndarray, " n"]:
    """A box filter over an even number of rows, centred on a row: half weights at both ends."""
    return np.array([0.5, *[1.0] * (width - 1), 0.5]) / width


def find_comb(
    grey: Float[np.ndarray, "h w"], axis: int, config: GridConfig, pitch_range: tuple[float, float] = (0.0, 1.0)
) -> Comb | None:
    """The comb of lines across ``axis`` of a film view that covers [0, 1]^2, or None where none is certain.

    pitch_range: the pitches considered, where they are known from elsewhere. Of the widths that show the comb about
    equally well, the narrowest counts: it is the most exact.
    """
    image = narrowed(grey, axis)
    found: list[Comb] = []
    kinds = [(width, sign) for width in config.widths_px for sign in (1, -1)]
    for (width, sign), lines in zip(kinds, _find_lines(image, config), strict=True):
        match = _fit_comb(lines, pitch_range, config)
        if match is not None:
            tracks = np.stack([lines[k].track for k in match.matched])
            found.append(
                Comb(axis, match.first, match.pitch, match.cells, match.seen, width, sign, match.strength, tracks)
            )
    strongest = max((comb.strength for comb in found), default=0.0)
    return next((comb for comb in found if comb.strength >= 0.85 * strongest), None)


def _find_lines(image: Float[np.ndarray, "h n"], config: GridConfig) -> list[list[_Line]]:
    """Lines that run from one end of the film to the other, strongest first: bright and dark ones of each width.

    A line may wander ``slack_px`` rows from strip to strip: the best such path through each row of the middle strip is
    found by dynamic programming, for all kinds of lines at once. Each strip adds at most 1, so that the sum tells
    in how many strips the line is seen.
    """
    h = len(image)
    votes = np.concatenate([line_votes(image, width, config) for width in config.widths_px], axis=2)
    kernel = np.ones((2 * config.slack_px + 1, 1), np.uint8)
    middle = config.strips // 2
    sums = votes  # best sum of a path from the nearer end of the film to this place
    for k in range(1, middle):
        sums[k] += cv2.dilate(sums[k - 1], kernel)
    for k in range(config.strips - 2, middle, -1):
        sums[k] += cv2.dilate(sums[k + 1], kernel)
    for k in (middle - 1, middle + 1):
        sums[middle] += cv2.dilate(sums[k], kernel)
    share = sums[middle] / config.strips
    around = np.ones((2 * max(2, round(0.012 * h)) + 1, 1), np.uint8)
    candidate = (share >= cv2.dilate(share, around)) & (share >= config.share)
    starts = [_strongest(np.flatnonzero(candidate[:, k]), share[:, k], config.slack_px) for k in range(share.shape[1])]
    kind = np.repeat(np.arange(len(starts)), [len(rows) for rows in starts])
    row = np.concatenate(starts)
    lines: list[list[_Line]] = [[] for _ in starts]
    for k, track, evidence in zip(kind, _trace(sums, row, kind, config.slack_px), share[row, kind], strict=True):
        lines[k].append(_Line(track, float(evidence)))
    return lines


def line_votes(image: Float[np.ndarray, "h n"], width: int, config: GridConfig) -> Float[np.ndarray, "s h 2"]:
    """How clearly each row of each strip shows a bright line of this width, and a dark one: from -0.5 to 1."""
    response = line_response(image, width)
    strips = cv2.resize(
        np.clip(response, -config.cap_levels, config.cap_levels),
        (config.strips, len(response)),
        interpolation=cv2.INTER_AREA,
    ).T
    scale = max(config.min_levels, config.min_sigmas * _median(np.abs(strips).ravel()))
    votes = np.empty((*strips.shape, 2), np.float32)
    np.clip(strips / scale, -0.5, 1.0, out=votes[..., 0])
    np.clip(strips / -scale, -0.5, 1.0, out=votes[..., 1])
    return votes


def _median(values: Float[np.ndarray, " n"]) -> float:
    """As NumPy's, without its detour: only the two values in the middle are put in order."""
    low, high = (len(values) - 1) // 2, len(values) // 2
    ordered = np.partition(values, [low, high] if high > low else low)
    return 0.5 * (float(ordered[low]) + float(ordered[high]))


def _strongest(rows: Int[np.ndarray, " n"], share: Float[np.ndarray, " h"], slack: int) -> Int[np.ndarray, " k"]:
    """The middle row of each group of rows where lines may be; the twelve best, best first."""
    groups = np.split(rows, np.flatnonzero(np.diff(rows) > slack) + 1) if len(rows) else []
    return np.array(sorted((g[len(g) // 2] for g in groups), key=lambda r: -share[r])[:12], dtype=np.intp)


def _trace(
    sums: Float[np.ndarray, "s h c"], start: Int[np.ndarray, " k"], kind: Int[np.ndarray, " k"], slack: int
) -> Float[np.ndarray, "k s"]:
    """Film coordinates, strip by strip, of the best paths of given kinds through rows ``start`` of the middle strip."""
    n, h, _ = sums.shape
    middle = n // 2
    rows = np.repeat(start[:, None], n, axis=1)
    step, line = np.arange(-slack, slack + 1), np.arange(len(start))
    for strips, came_from in ((range(middle - 1, -1, -1), 1), (range(middle + 1, n), -1)):
        for k in strips:
            near = np.clip(rows[:, k + came_from, None] + step, 0, h - 1)
            rows[:, k] = near[line, np.argmax(sums[k, near, kind[:, None]], axis=1)]
    return film_centres_1d(h)[rows]


@dataclass(frozen=True, eq=False)
class _Match:
    """A comb matched to lines: ``seen`` are its indices that have a line, ``matched`` tells which line that is."""

    first: float
    pitch: float
    cells: int
    seen: Int[np.ndarray, " k"]
    matched: Int[np.ndarray, " k"]
    strength: float


def _fit_comb(lines: list[_Line], pitch_range: tuple[float, float], config: GridConfig) -> _Match | None:
    """The comb that explains most of the lines."""
    at = np.array([line.at for line in lines])
    evidence = np.array([line.evidence for line in lines])
    value = np.maximum(evidence - config.share, 0.0) / (1.0 - config.share)
    best, best_score = None, 0.0
    for anchor, pitch in _comb_candidates(at, config):
        if not pitch_range[0] <= pitch <= pitch_range[1]:
            continue
        match = _match_comb(at, evidence, anchor, pitch, config)
        if match is None:
            continue
        score = float(value[match.matched].sum() - 0.25 * np.delete(value, match.matched).sum())
        if score > best_score:
            best, best_score = match, score
    return best


def _comb_candidates(at: Float[np.ndarray, " n"], config: GridConfig) -> list[tuple[float, float]]:
    """Anchors and pitches worth a try: any two lines as neighbours, or a single line near the middle."""
    pairs = [(float(a), float(b - a)) for a in at for b in at if 1.0 / MAX_CELLS <= b - a <= 0.55]
    return pairs + [(float(a), 0.5) for a in at if abs(a - 0.5) < 0.04]


def _straight_fit(index: Int[np.ndarray, " k"], at: Float[np.ndarray, " k"]) -> tuple[float, float]:
    """Value at index 0 and slope of the least-squares fit to the places of some lines."""
    middle = float(index.mean())
    step = float((index - middle) @ at) / float((index - middle) @ (index - middle))
    return float(at.mean()) - step * middle, step


def _match_comb(
    at: Float[np.ndarray, " n"], evidence: Float[np.ndarray, " n"], anchor: float, pitch: float, config: GridConfig
) -> _Match | None:
    """The comb fitted to the lines that it meets; None if an inner line is missing, or it does not fill the film."""
    for _ in range(2):
        low, high = int(np.ceil((-0.015 - anchor) / pitch)), int(np.floor((1.015 - anchor) / pitch))
        index = np.arange(low, high + 1)
        places = anchor + pitch * index
        nearest = np.argmin(np.abs(places[:, None] - at[None]), axis=1)
        met = np.abs(at[nearest] - places) <= config.tolerance
        if met.sum() >= 2:
            anchor, pitch = _straight_fit(index[met], at[nearest[met]])
    # Where margins are wider than cells, a line may be missing before the first: then the grid begins further in.
    while len(places) > 3 and not met[:2].any() and places[1] <= config.margin:
        index, places, nearest, met = index[1:], places[1:], nearest[1:], met[1:]
    while len(places) > 3 and not met[-2:].any() and places[-2] >= 1.0 - config.margin:
        index, places, nearest, met = index[:-1], places[:-1], nearest[:-1], met[:-1]
    # An end that was not seen may be the end of a margin; every line between the ends must be there.
    if len(places) < 3 or not met[1:-1].all() or places[0] > config.margin or places[-1] < 1.0 - config.margin:
        return None
    strength = float(evidence[nearest[1:-1]].min())
    if strength < (config.share if len(places) > 3 else config.lone_share):
        return None
    return _Match(anchor + pitch * int(index[0]), pitch, len(index) - 1, np.flatnonzero(met), nearest[met], strength)


__all__ = ["Borders", "Comb", "GridConfig", "GridLines", "find_comb", "line_response", "line_votes", "narrowed"]
