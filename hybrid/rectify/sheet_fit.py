"""Which unstretched sheet the photo shows: fitted to its edges and to what is printed on it.

A network's map, even one that is put right along the edges, is off inside, where it knows only what films look like on
average. But a film does not stretch (its strain is a millionth), and what a camera shows of the four edges of such a
sheet tells where it is near and where it slopes: opposite edges show how the distance varies, and distance and slope
how the film's length is spread along the edges and over the inside (compare Perriollat and Bartoli 2013, "A
computational model of bounded developable surfaces"). Edges alone do not always tell: a sheet rolled about a slanting
axis may be mistaken for another. Lines and cells printed on it tell the rest, and the sheet in turn tells what they
leave open, as where between the edges the grid lies and how wide its cells are.

Where none explains what is seen, as of cloth in a simulation, one that stretches a little is tried, and finer splines.

Fitted at once are the surface, the camera, the sheet's ratio of sides, and the constants that sightings share.
Minimised are the distances of what is seen from where it should be, strain, bending, and, weakly, the distance from the
network's map: Gauss-Newton steps with Levenberg's damping.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import LinAlgError

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.rectify.sheet import NODES, Frame, Sheet, SheetConfig, flat_sheet, relief_reversed
from hybrid.rectify.sheet_problem import Problem, State, bending_cost, minimised
from hybrid.rectify.sheet_seen import NOTHING, seen_through
from hybrid.rectify.sightings import Sightings

BENDING_TELLS = 2.0
"""What a lower weight of bending may take off the cost at most, in parts of what bending makes of it: the sheet that is
freer to bend explains better what is seen, too."""


@dataclass(frozen=True, eq=False)
class FittedSheet:
    """A sheet and its map.

    cost: half the sum of squares, in deviations: how badly a sheet explains what was seen. constants: those that each
    list of sightings shares. bending, strain: the weight of bending and the deviation of strain that it was found with.
    """

    sheet: Sheet
    backward: BackwardMap
    cost: float
    constants: tuple[Float[np.ndarray, " _"], ...]
    bending: float
    strain: float


def fit_sheet(
    near: BackwardMap,
    through: BackwardMap,
    size: tuple[int, int],
    sightings: Sequence[Sightings],
    config: SheetConfig,
    before: FittedSheet | None = None,
) -> FittedSheet | None:
    """The sheet that explains best what is seen of its edges and its print; None where the fit fails. It does not
    stretch, unless only one that does explains that.

    near: a map that is near, to start from, and from ``before`` if that is its sheet. through: the map through which
    the sightings were made. size: (height, width) of the photo, whose centre the camera looks at.
    """
    frame = Frame.of(size)
    problem = Problem(seen_through(through, sightings, frame, config), _target(near, frame), config.bending[0], config)
    try:
        if before is not None:
            problem = replace(problem, bending=before.bending, config=replace(config.near, strain=before.strain))
            state = minimised(problem, problem.begun(before.sheet), config.steps[2], near=True)
            return _result(state, frame, sightings, problem)
        state, problem = _as_stretched_as_needed(problem, near, frame)
    except LinAlgError:
        return None
    state = _as_fine_as_needed(problem, state)
    return _result(state, frame, sightings, problem)


def _as_fine_as_needed(problem: Problem, state: State) -> State:
    """The sheet on finer splines, where it explains badly what is seen on coarser ones and these do so better."""
    config = problem.config
    if problem.explains(state, config.coarse):
        return state
    try:
        begun = replace(state, sheet=state.sheet.finer(config.finer))
        found = minimised(replace(problem, config=config.near), begun, config.steps[1])
    except LinAlgError:
        return state
    return found if found.cost < config.finer_gain * state.cost else state


def _as_stretched_as_needed(problem: Problem, near: BackwardMap, frame: Frame) -> tuple[State, Problem]:
    """The sheet that explains best what is seen, and the problem it solves.

    Where one that does not stretch explains badly what is seen, one that does is tried: as the map has it, and bent the
    other way round if that is no better.
    """
    config = problem.config
    firm = _bent_either_way(problem, near, frame)
    if problem.explains(firm[0], config.doubtful):
        return firm
    elastic, enough = replace(problem, config=config.elastic), config.stretched_gain * firm[0].cost
    try:
        blind = _blind(elastic, near, frame)
        start = _near_map(blind, near, frame)
        found = _as_bent_as_needed(elastic, elastic.begun(start), enough)
        if found[0].cost >= enough:
            found = _mirrored(elastic, blind, start, enough) or found
    except LinAlgError:
        return firm
    return found if found[0].cost < enough else firm


def _bent_either_way(problem: Problem, near: BackwardMap, frame: Frame) -> tuple[State, Problem]:
    """The sheet that explains best what is seen, bent towards the camera or away from it, and the problem it solves.

    From some way off both look nearly the same, so that steps from one do not lead to the other: where the first does
    not explain well what is seen its mirror images are tried, too, as it was before and after that was looked at.
    """
    config = problem.config
    blind = _blind(problem, near, frame)
    start = _near_map(blind, near, frame)
    best = first = _as_bent_as_needed(problem, problem.begun(start))
    for sheet in (start, first[0].sheet):
        if problem.explains(best[0], config.doubtful):
            break
        enough = config.reversed_gain * best[0].cost
        other = _mirrored(problem, blind, sheet, enough)
        if other is not None and other[0].cost < enough:
            best = other
    return best


def _mirrored(problem: Problem, blind: Problem, sheet: Sheet, enough: float) -> tuple[State, Problem] | None:
    """The sheet found from the mirror image of one; None where that comes to be the same, or to nothing. enough: the
    cost from which on it counts."""
    config = problem.config
    try:
        mirrored = minimised(blind, blind.begun(relief_reversed(sheet)), config.steps[1], near=True).sheet
        if np.abs(mirrored.control - sheet.control).max() < config.same_relief:
            return None
        return _as_bent_as_needed(problem, problem.begun(mirrored), enough)
    except LinAlgError:
        return None


def _as_bent_as_needed(problem: Problem, start: State, enough: float = np.inf) -> tuple[State, Problem]:
    """The sheet found with ever lower weights of bending, as long as that is worth it, and the last one's problem.

    enough: the cost from which on it counts; one that would come far from that is given up.
    """
    config = problem.config
    state = minimised(problem, start, config.steps[2], enough=enough)
    for weight in config.bending[1:]:
        bending = bending_cost(state.sheet, problem.bending)
        if bending <= config.bent_share * state.cost or state.cost - BENDING_TELLS * bending > enough:
            break
        softer = replace(problem, bending=weight)
        sharper = minimised(softer, state, config.steps[2])
        if sharper.cost >= config.sharper * state.cost:
            break
        state, problem = sharper, softer
    return state, problem


def _blind(problem: Problem, near: BackwardMap, frame: Frame) -> Problem:
    """The problem to come near to a map: of what is seen it knows nothing."""
    config = replace(problem.config.near, network_px=1.0)
    return Problem(seen_through(near, [NOTHING], frame, config), problem.target, config.bending[1], config)


def _near_map(blind: Problem, near: BackwardMap, frame: Frame) -> Sheet:
    """The unstretched sheet that comes nearest to a map."""
    config = blind.config
    first, last = config.intervals
    state = minimised(blind, blind.begun(flat_sheet(near, frame, first, config.focal)), config.steps[0], near=True)
    return minimised(blind, replace(state, sheet=state.sheet.finer(last)), config.steps[1], near=True).sheet


def _target(coarse: BackwardMap, frame: Frame) -> Float[np.ndarray, "m 2"]:
    """Where the network has some points of the film."""
    return frame.from_photo(coarse.photo_from_film(film_nodes(NODES).reshape(-1, 2)))


def _result(state: State, frame: Frame, sightings: Sequence[Sightings], problem: Problem) -> FittedSheet | None:
    backward = state.sheet.backward(frame)
    if backward is None:
        return None
    ends = np.cumsum([s.shared.shape[1] for s in sightings])
    constants = tuple(np.split(state.constants, ends[:-1]))
    return FittedSheet(state.sheet, backward, state.cost, constants, problem.bending, problem.config.strain)


__all__ = ["FittedSheet", "fit_sheet"]
