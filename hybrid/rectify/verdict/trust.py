"""How far a flattened film can be trusted: what speaks for its map and against it, and the error to be expected.

All is looked at once more, through the finished map: EdgeNet must read edges where the map has them, BorderNet should
read borders where the grid predicts them, and what FilmNet sees must lie where the map puts it. How far apart the two
ends of refinement lie, whether a bent sheet explains what was seen, and whether margins are alike on both sides tell
the rest. Two regressions over photos with truth turn these signs into an error and into a probability that it is small.
Other signs are musts: without them, there are photos on which all of these speak for a wrong map.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d
from hybrid.errors import FittedWeights, require_at_least, require_at_most
from hybrid.film_view import grey_view
from hybrid.pyramid import Pyramid
from hybrid.records import CoarseMaps, Signs, SliceGrid, StatusCode
from hybrid.rectify.edges.paths import EdgesRead
from hybrid.rectify.grid.phases import CellPhases
from hybrid.rectify.grid.repeat import Repeats, cell_agreement
from hybrid.rectify.refine.refine import Refinement
from hybrid.rectify.verdict.survey import Verdict, grey_spread, mask_overlap
from hybrid.strips import SIDES, Side

REFERENCE_PX = 1080
"""Longer side of the photos that limits in pixels are stated for."""

FLAT_ERROR, ASLANT = 0.0005, 0.004
"""Error of a photo that is the flat film itself, in parts of the film's size, where cells pin it; and its largest mean
error where they do not: of 81 scans put aslant, 28 pass for flat, one of which is further off."""

UNKNOWN_STATED = 0.01
"""Assumed expected error where refinement left the map as it was: the network's, in parts of the film."""

UNKNOWN_EDGES = 0.02
"""Assumed distance between an edge as read and the map's, where not all edges are read, in film units."""

OUTSIDE = 0.6
"""A side counts as lying outside the photo if this part of it does: of 936 films 25 had such a side, and 17 of these
were over 5 px off, at the median 13; of 18 with less of a side outside, three were."""

OUTSIDE_BY = 0.005
"""How far outside that part must lie, in parts of the film's size: a film may end where the photo does."""

UNKNOWN_LOPSIDED = 0.05
"""Assumed difference between opposite margins where there is no grid, in film units; larger ones count as this one."""


@dataclass(frozen=True)
class ChanceConfig(FittedWeights):
    """How probable it is that a map is right to within a limit: a logistic regression over the maps of 1,920 simulated
    photos of the training scans, with limits of 4, 5 and 6 pixels of a photo of 1080.

    limit: for the logarithm of the limit, in parts of the film. no_sheet: where no bent sheet explains what was seen.
    doubted: for each refinement of the film that had left a doubt: the surest of several is so partly by selection.
    The others: as in ``features``.
    """

    constant: float = -8.903
    limit: float = 1.676
    seen_beside: float = -1.699
    stated: float = -0.901
    edges_beside: float = -0.634
    unshown: float = -0.532
    lopsided: float = -18.558
    no_sheet: float = -0.601
    doubted: float = -0.695


@dataclass(frozen=True)
class ErrorConfig(FittedWeights):
    """Which error is expected: its logarithm, in parts of the film, as a linear function of the same ``features``,
    fitted by absolute deviations to the same maps."""

    constant: float = 4.025
    seen_beside: float = 0.662
    stated: float = 0.52
    edges_beside: float = 0.388
    unshown: float = 0.357
    lopsided: float = 1.929


@dataclass(frozen=True)
class TrustConfig:
    """The error from which on a film is not called flattened, and how errors are predicted.

    The typical error tells little about how probable a large one is: ``chance`` has weights of its own for that.
    """

    limit_px: float = 5.0
    """Largest error of a film that is called flattened, in pixels of a photo of 1080; at least one of its own."""
    safety: float = 0.4
    """The expected error must be below this part of the limit."""
    least_chance: float = 0.95
    """Least probability that the error is below the limit."""
    chance: ChanceConfig = ChanceConfig()
    """How this probability is predicted."""
    error: ErrorConfig = ErrorConfig()
    """How the error is predicted."""
    min_edges: int = 4
    """Least number of the sheet's edges that must be seen: repetition alone tells neither place nor size, and a printed
    line may be taken for an edge that is not seen."""
    min_support: float = 0.6
    """Least mean probability that an edge lies where the map puts it: others do not look like edges to EdgeNet."""
    least_support: float = 0.2
    """Below this, what has no grid and was not corrected by anything seen on it is no film, but part of a room:
    of 1,110 films found in simulated photos this holds for one, which is 59 px off."""
    min_overlap: float = 0.925
    """Least intersection over union of what the network sees as film with the finished map's outline."""
    min_in_step: float = 0.88
    """Least agreement of the grid with what the network says about the cells."""
    min_alike: float = 0.12
    """Least agreement of the cells: noise repeats by chance, too."""
    most_lopsided: float = 0.055
    """How much opposite margins may differ on a photo that is the flat film itself (``SliceGrid.lopsided``): they do by
    0.05 at most on 50 whole films, by 0.06 and more on nine that lack 0.4 of a column or 7 % of their width."""
    most_going_on: float = 0.1
    """Largest probability of the edges of a longer sheet that was not believed: of 25 films in 1,920 simulated photos
    for which one was noticed, 23 are wrong."""
    min_levels: float = 20.0
    """Least number of grey levels that the photo makes use of: with fewer, gutters look like the sheet's edges."""

    def __post_init__(self) -> None:
        require_at_least(self, 0, "limit_px")
        chances = "least_chance", "min_support", "least_support", "most_going_on"
        require_at_most(self, 1, *chances, "min_overlap", "min_in_step", "min_alike")


def signs_of(
    pyramid: Pyramid,
    seen: CoarseMaps,
    coarse: BackwardMap,
    refinement: Refinement,
    again: CoarseMaps,
    across: EdgesRead,
    shown: float,
    flat: bool = False,
    near: bool = False,
    goes_on: float = 0.0,
) -> Signs:
    """What speaks for a refined map.

    seen, coarse: what the network saw last before refinement, and the map made from it. again: what it sees of the film
    flattened by the refined map (as a plane sheet). across: the edges as read across the refined map's. shown: how
    probable it is that borders between cells show where its grid has them (``borders_shown``). near: whether the
    network saw the film only in a look at a part of the photo. goes_on: as in ``Signs``.
    """
    backward, grid = refinement.backward, refinement.grid
    film_px = _film_px(backward)
    return Signs(
        overlap_before=mask_overlap(seen, coarse),
        overlap_after=mask_overlap(again, backward),
        alike=0.0 if grid is None else cells_alike(pyramid, backward, grid),
        grid=grid is not None,
        corrected=refinement.believed,
        edges=refinement.edges,
        film_px=film_px,
        photo_px=max(pyramid.size),
        levels=grey_spread(pyramid.photo),
        support=float(across.support.min()),
        in_step=0.0 if grid is None else _in_step(again, backward, grid),
        seen_beside=seen_beside(again, backward),
        stated=UNKNOWN_STATED if refinement.expected_px is None else refinement.expected_px / film_px,
        edges_beside=across.off if len(across.sightings) == len(SIDES) else UNKNOWN_EDGES,
        borders_shown=shown,
        lopsided=UNKNOWN_LOPSIDED if grid is None else grid.lopsided,
        sheet=refinement.aspect is not None,
        flat=flat,
        off_frame=(refinement.expected_px or 0.0) / film_px if flat else 0.0,
        weakest=across.weakest,
        outside=sides_outside(backward, pyramid.size),
        near=near,
        goes_on=goes_on,
    )


def sides_outside(backward: BackwardMap, size: tuple[int, int]) -> tuple[str, ...]:
    """Names of the sides of the sheet that lie mostly outside a photo of ``size`` (height, width)."""
    along, beside = film_centres_1d(32), OUTSIDE_BY * max(backward.mean_film_pixels())

    def outside(side: Side) -> float:
        at = backward.photo_from_film(side.film_points(along, np.zeros_like(along)))
        return float(((at < -beside) | (at > np.array(size[::-1]) + beside)).any(axis=1).mean())

    return tuple(side.name for side in SIDES if outside(side) >= OUTSIDE)


def expected_error_px(signs: Signs, config: TrustConfig | None = None) -> float:
    """Mean distance, in pixels of the photo, by which points of the film are expected to be off."""
    config = config or TrustConfig()
    if _whole_photo(signs, config):
        return float(np.clip(signs.off_frame, FLAT_ERROR, ASLANT)) * signs.film_px
    return float(np.exp(_weighted(features(signs), config.error))) * signs.film_px


def _whole_photo(signs: Signs, config: TrustConfig) -> bool:
    """Whether the photo is the flat film itself, and all of it."""
    return signs.flat and signs.lopsided <= config.most_lopsided


def features(signs: Signs) -> dict[str, float]:
    """The values that the weights of ErrorConfig, and most of those of ChanceConfig, multiply."""
    return {
        "constant": 1.0,
        "seen_beside": float(np.log(min(signs.seen_beside, 1.0) + 1e-3)),
        "stated": float(np.log(np.clip(signs.stated, 3e-4, 0.05))),
        "edges_beside": float(np.log(signs.edges_beside + 2e-4)),
        "unshown": float(np.log(1.03 - min(signs.borders_shown, 1.0))),
        "lopsided": min(signs.lopsided, UNKNOWN_LOPSIDED),
    }


def chance_right(signs: Signs, config: TrustConfig | None = None) -> float:
    """Probability that the mean error is below the largest allowed for a film that is called flattened."""
    config = config or TrustConfig()
    if _whole_photo(signs, config):
        return 1.0
    odds = _weighted(chance_features(signs, largest_error_px(signs.photo_px, config)), config.chance)
    return float(1.0 / (1.0 + np.exp(-odds)))


def chance_features(signs: Signs, limit_px: float) -> dict[str, float]:
    """The values that the weights of ChanceConfig multiply. limit_px: of the error, in pixels of the photo."""
    limit = float(np.log(limit_px / signs.film_px))
    return {
        **features(signs),
        "no_sheet": float(not signs.sheet),
        "doubted": float(signs.doubted),
        "limit": limit,
    }


def largest_error_px(photo_px: int, config: TrustConfig) -> float:
    """Largest error of a film that is called flattened, in pixels of a photo whose longer side has ``photo_px``."""
    return max(config.limit_px / REFERENCE_PX * photo_px, 1.0)


def film_verdict(signs: Signs, config: TrustConfig | None = None) -> Verdict:
    """OK where the film almost certainly lies where the map says, NO_FILM where no sign of a film is seen, otherwise
    UNSURE; with the evidence."""
    config = config or TrustConfig()
    if _whole_photo(signs, config):
        return Verdict(StatusCode.OK, f"the photo is the flat film itself: cells are alike to {signs.alike:.0%}")
    limit, chance = largest_error_px(signs.photo_px, config), chance_right(signs, config)
    allowed, expected = config.safety * limit, expected_error_px(signs, config)
    doubts = [
        text
        for text, doubtful in (
            (f"step back, the photo lacks the film's {' and '.join(signs.outside)} edge", bool(signs.outside)),
            ("a scan with unlike margins on opposite sides, which may lack part of the sheet", signs.flat),
            (f"{signs.edges} of 4 edges seen", signs.edges < config.min_edges),
            ("no grid seen", not signs.grid),
            (
                f"the sheet may go on beyond its map ({floored(signs.goes_on)} likely)",
                signs.goes_on > config.most_going_on,
            ),
            (f"only {signs.levels:.0f} of 255 grey levels", signs.levels < config.min_levels),
            (
                f"the {signs.weakest} edge is only {signs.support:.0%} likely to be the sheet's",
                signs.support < config.min_support,
            ),
            (
                f"what the network sees as film overlaps the sheet by only {signs.overlap_after:.0%}",
                signs.overlap_after < config.min_overlap,
            ),
            ("the network sees other cells", signs.grid and signs.in_step < config.min_in_step),
            ("cells are not alike", signs.grid and signs.alike < config.min_alike),
            ("edges, lines and texts of the film did not correct the network's map", not signs.corrected),
            (f"{expected:.1f} px of error expected, {allowed:.1f} allowed", expected > allowed),
            (f"only {floored(chance)} sure to be right to {limit:.1f} px", chance < config.least_chance),
        )
        if doubtful
    ]
    evidence = (
        f"{floored(chance)} sure to be right to {limit:.1f} px, expected to be off by {expected:.1f} px; "
        f"mask and outline agree to {signs.overlap_before:.1%} before and "
        f"{signs.overlap_after:.1%} after refinement, each edge is at least {signs.support:.0%} likely to be the "
        f"sheet's, cells are alike to {signs.alike:.0%} and agree with what the network sees to {signs.in_step:.0%}"
    )
    if doubts:
        bare = not signs.corrected and signs.support < config.least_support
        nothing = not signs.grid and (bare or signs.near)
        code = StatusCode.NO_FILM if nothing else StatusCode.UNSURE
        return Verdict(code, f"{', '.join(doubts)}: {evidence}", tuple(doubts))
    return Verdict(StatusCode.OK, evidence)


def cells_alike(pyramid: Pyramid, backward: BackwardMap, grid: SliceGrid, side_px: int = 500) -> float:
    """Share of fine detail that the cells of the grid have in common, less what as many unlike cells would share."""
    cells = grid.rows * grid.cols
    if cells < 2:
        return 0.0
    view = grey_view(pyramid, backward, side_px)
    columns, rows = (_repeats(grid, axis) for axis in (0, 1))
    if min(columns.pitch * len(view.u), rows.pitch * len(view.v)) < 4:
        return 0.0
    share = cell_agreement(view, columns, rows)
    return float(np.clip((share - 1 / cells) / (1 - 1 / cells), 0.0, 1.0))


def _in_step(again: CoarseMaps, backward: BackwardMap, grid: SliceGrid) -> float:
    """Agreement of a grid with the phases that the network predicts, along the worse axis; 0 where it predicts none."""
    phases = CellPhases.of(again)
    if phases is None:
        return 0.0
    columns, rows = (_repeats(grid, axis) for axis in (0, 1))
    cells = np.array([columns.first, rows.first]), np.array([columns.pitch, rows.pitch])
    return float(phases.inside(backward).in_step(*cells).min())


def _repeats(grid: SliceGrid, axis: int) -> Repeats:
    """The grid along one axis as cells that repeat."""
    return Repeats(axis, *grid.along(axis))


def _weighted(features: Mapping[str, float], weights: ChanceConfig | ErrorConfig) -> float:
    """Sum of the features, each times its weight."""
    return sum(getattr(weights, name) * value for name, value in features.items())


def seen_beside(again: CoarseMaps, backward: BackwardMap) -> float:
    """Root mean square of the displacement between a map and what the network sees, smoothed to a quadratic function of
    film points, in parts of the film's size."""
    film = again.film
    if not film.any():
        return float("inf")
    uv = np.asarray(again.uv[film], dtype=np.float64)
    apart = backward.photo_from_film(uv) - again.photo_points[film]
    u, v = uv.T
    smooth = np.column_stack([np.ones(len(uv)), u, v, u * u, u * v, v * v])
    fitted = smooth @ np.linalg.lstsq(smooth, apart, rcond=None)[0]
    return float(np.sqrt(np.square(fitted).sum() / len(uv))) / _film_px(backward)


def _film_px(backward: BackwardMap) -> float:
    """Side of a square with the film's area in the photo, in pixels."""
    return max(float(np.sqrt(np.prod(backward.mean_film_pixels()))), 1e-9)


def floored(chance: float) -> str:
    """A probability in whole percent, rounded down."""
    return f"{int(100 * chance + 1e-9)}%"


__all__ = [
    "ChanceConfig",
    "ErrorConfig",
    "TrustConfig",
    "cells_alike",
    "chance_features",
    "chance_right",
    "expected_error_px",
    "features",
    "film_verdict",
    "floored",
    "largest_error_px",
    "seen_beside",
    "sides_outside",
    "signs_of",
]
