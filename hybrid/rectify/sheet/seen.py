"""What is seen of a sheet's edges and print: points of curves on which one film coordinate is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from hybrid.backward import BackwardMap
from hybrid.rectify.sheet.shape import Frame, Sheet, SheetConfig, inner, project, surface
from hybrid.rectify.splines.bspline import SortedDesign
from hybrid.rectify.splines.sightings import Sightings, group_medians, group_noise
from hybrid.rectify.splines.tps import MAD_TO_SIGMA

NOTHING = Sightings(0, np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 0)), np.zeros(0))
"""No sightings at all."""
TEXT_SIGMA = 3e-4
"""Deviation up to which a group of points is text, in the frame's units; beyond, it is anatomy. It is larger than in
splines/displacement.py, as here every deviation contains SheetConfig.print_px."""
BEYOND = 0.03
"""How far beyond the sheet's edges what is seen may lie during the fit, in film units: were it clipped at the edges,
the constants could grow without end, as they would no longer change anything."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Points of the photo, in the frame's units, at which one film coordinate is known up to the shared constants.

    across: the axis of that coordinate. along: film coordinate on the other axis, as far as known. sigma: in film
    units, 0 where only ``floor`` counts: the deviation in the frame's units. number: of the list that each comes from.
    group: number shared by points that show the same thing, -1 for none.
    """

    point: Float[np.ndarray, "n 2"]
    across: Int[np.ndarray, " n"]
    known: Float[np.ndarray, " n"]
    along: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]
    floor: Float[np.ndarray, " n"]
    shared: Float[np.ndarray, "n g"]
    shared_sigma: Float[np.ndarray, " g"]
    number: Int[np.ndarray, " n"]
    group: Int[np.ndarray, " n"]


def seen_through(through: BackwardMap, sightings: Sequence[Sightings], frame: Frame, config: SheetConfig) -> Seen:
    """Sightings made through a map, as points of the photo."""
    thinned = [s.subset(np.arange(0, len(s), config.every[s.group is not None])) for s in sightings]
    number = np.repeat(np.arange(len(thinned)), [len(s) for s in thinned])
    widths = [s.shared.shape[1] for s in thinned]
    shared, first = np.zeros((len(number), sum(widths))), np.cumsum([0, *widths])
    group, next_group = np.full(len(number), -1), 0
    for k, s in enumerate(thinned):
        shared[number == k, first[k] : first[k + 1]] = s.shared
        if s.group is not None:
            own = np.unique(s.group, return_inverse=True)[1]
            group[number == k] = own + next_group
            next_group += int(own.max(initial=-1)) + 1
    edge = np.array([s.shared.shape[1] == 0 for s in thinned])[number]
    seen, places = np.concatenate([s.seen for s in thinned]), np.concatenate([s.places() for s in thinned])
    across = np.array([s.axis for s in thinned])[number]
    rows = np.arange(len(number))
    return Seen(
        frame.from_photo(through.photo_from_film(seen)),
        across,
        places[rows, across],
        np.clip(places[rows, 1 - across], 0.0, 1.0),
        np.where(edge, 0.0, np.concatenate([s.sigma for s in thinned])),
        1e-3 * np.where(edge, config.edge_px, config.print_px),
        shared,
        np.concatenate([s.shared_sigma for s in thinned]),
        number,
        group,
    )


@dataclass(frozen=True, eq=False)
class Curves:
    """Where a sheet puts what is seen: film points slid along their curves to where they are nearest to it.

    along: as in Seen, and in that order. All else is in the order of ``design``, that of the film points. point: as in
    Seen. normal: to the curves in the photo, over the deviation. pull: by how much the points move along the normal
    with each of the constants. tolerance: in deviations. constants: those at which all this holds.
    """

    along: Float[np.ndarray, " n"]
    design: SortedDesign
    point: Float[np.ndarray, "n 2"]
    normal: Float[np.ndarray, "n 2"]
    pull: Float[np.ndarray, "n g"]
    tolerance: Float[np.ndarray, " n"]
    constants: Float[np.ndarray, " g"]


def slid(
    seen: Seen, sheet: Sheet, constants: Float[np.ndarray, " g"], along: Float[np.ndarray, " n"], near: bool
) -> Curves:
    """What is seen, slid along its curves on a sheet. along: where to start from. near: whether the sheet is so near
    that the residuals tell how exact the sightings are."""
    rows = np.arange(len(along))
    place = np.empty((len(along), 2))
    place[rows, seen.across] = np.clip(seen.known + seen.shared @ constants, -BEYOND, 1.0 + BEYOND)
    place[rows, 1 - seen.across] = along
    for _ in range(1 if near else 2):
        points, by_uv = surface(sheet, place)
        now = project(sheet, points)
        by_uv = now.by_point @ by_uv  # (n, 2, 2): of x, y by u, v
        tangent = by_uv[rows, :, 1 - seen.across]
        square = np.maximum(inner(tangent, tangent), 1e-9)
        step = np.clip(inner(seen.point - now.point, tangent) / square, -0.05, 0.05)
        place[rows, 1 - seen.across] = np.clip(place[rows, 1 - seen.across] + step, 0.0, 1.0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.sqrt(square)[:, None]
    pull = inner(by_uv[rows, :, seen.across], normal)
    sigma = np.hypot(seen.sigma * pull, seen.floor)
    order = SortedDesign.order(place, sheet.intervals)
    shown = SortedDesign.of(place[order], sheet.intervals)
    point, normal, sigma = seen.point[order], normal[order], sigma[order]
    residual = inner(project(sheet, shown.values(sheet.control)).point - point, normal)
    if near and (seen.group >= 0).any():
        sigma = group_noise(sigma, seen.group[order], residual, TEXT_SIGMA)
    number = seen.number[order]
    typical = MAD_TO_SIGMA * group_medians(np.abs(residual) / sigma, number)
    tolerance = np.maximum(1.0, 2.0 * typical)[number]
    pull = seen.shared[order] * (pull[order] / sigma)[:, None]
    return Curves(place[rows, 1 - seen.across], shown, point, normal / sigma[:, None], pull, tolerance, constants)


__all__ = ["NOTHING", "Curves", "Seen", "seen_through", "slid"]
