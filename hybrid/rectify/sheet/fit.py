"""Which unstretched sheet the photo shows: fitted to its edges and to what is printed on it.

A network's map, even one that was corrected along the edges, is off inside, where it knows only what films look like on
average. But a film does not stretch (its strain is a millionth), and the camera's view of the four edges of such a
sheet tells where it is near and where it slopes: opposite edges show how the distance varies, and distance and slope
how the film's length is spread along the edges and over the inside (compare Perriollat and Bartoli 2013, "A
computational model of bounded developable surfaces"). Edges alone do not always tell: a sheet rolled about a slanting
axis may be mistaken for another. Lines and cells printed on it tell the rest, and the sheet in turn tells what they
leave open, such as where between the edges the grid lies and how wide its cells are.

It is not known beforehand how far the sheet is bent, nor whether it is simulated cloth, which does stretch: so
further bending and further strain cost ever less (``Eased``).

The surface, the camera, the sheet's ratio of sides, and the constants that sightings share are fitted together. The
cost is made of the distances of what is seen from where it should be, strain, bending, and, weakly, the distance from
the network's map: it is minimised by Gauss-Newton steps with Levenberg's damping.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import LinAlgError

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.rectify.sheet.problem import Cell, Problem, State, aspect_sigma, minimised, strain
from hybrid.rectify.sheet.seen import NOTHING, seen_through
from hybrid.rectify.sheet.shape import NODES, Frame, Sheet, SheetConfig, flat_sheet, relief_reversed
from hybrid.rectify.splines.sightings import Sightings

FIRM_STEPS = 3
"""First steps, in which bending counts in full."""


@dataclass(frozen=True, eq=False)
class FittedSheet:
    """A sheet and its map.

    constants: those that each list of sightings shares. problem, state: what was minimised, and the minimum.
    """

    backward: BackwardMap
    constants: tuple[Float[np.ndarray, " _"], ...]
    problem: Problem
    state: State

    @property
    def sheet(self) -> Sheet:
        """The sheet itself."""
        return self.state.sheet

    @property
    def cost(self) -> float:
        """Half the sum of squares, in standard deviations: how badly the sheet explains what was seen."""
        return self.state.cost

    @property
    def typical_residual(self) -> float:
        """Root of the cost per sighting: how far beside the sheet what was seen is, in standard deviations."""
        return float(np.sqrt(self.cost / max(len(self.problem.seen.number), 1)))

    @property
    def stretched(self) -> bool:
        """Whether it stretches."""
        config = self.problem.config
        return strain(self.sheet, config, 0, derivatives=False).cost > config.stretched

    @property
    def has_square_cells(self) -> bool:
        """Whether the cells printed on it were taken to be square."""
        return len(self.problem.square) > 0

    @property
    def aspect_sigma(self) -> float:
        """Standard deviation of the logarithm of the ratio of sides; takes as long as a step of the fit."""
        return aspect_sigma(self.problem, self.state)


def fit_sheet(
    near: BackwardMap,
    through: BackwardMap,
    size: tuple[int, int],
    sightings: Sequence[Sightings],
    config: SheetConfig,
    before: FittedSheet | None = None,
    square: Sequence[Cell] = (),
) -> FittedSheet | None:
    """The sheet that best explains what is seen of its edges and its print; None where the fit fails.

    near: a map near the solution, to start from; if ``before`` is its sheet, the fit starts from that. through: the map
    through which the sightings were made. size: (height, width) of the photo, whose centre the camera looks at. square:
    cells that are taken to be square; their constants are numbered through all sightings.
    """
    frame = Frame.of(size)
    seen = seen_through(through, sightings, frame, config)
    problem = Problem(seen, _target(near, frame), config, square=tuple(square))
    try:
        if before is not None:
            problem = replace(problem, config=config.near, bent=before.state.bent)
            state = minimised(problem, problem.begun(before.sheet), config.steps[2], near=True)
        else:
            state = _bent_either_way(problem, near, frame)
    except LinAlgError:
        return None
    return _result(replace(problem, bent=state.bent), state, frame, sightings)


def _bent_either_way(problem: Problem, near: BackwardMap, frame: Frame) -> State:
    """The sheet that best explains what is seen, bent towards the camera or away from it.

    From some distance both look nearly the same, and steps from one do not lead to the other: where the first does not
    explain well what is seen, the mirror images of the sheet from before and from after its fit are tried, too.
    """
    config = problem.config
    blind = _blind(problem, near, frame)
    start = _near_map(blind, near, frame)
    best = first = _found(problem, start)
    for sheet in (start, first.sheet):
        if problem.explains(best, config.doubtful):
            break
        enough = config.reversed_gain * best.cost
        other = _mirrored(problem, blind, sheet, enough)
        if other is not None and other.cost < enough:
            best = other
    return best


def _found(problem: Problem, start: Sheet, enough: float = np.inf) -> State:
    """The sheet that best explains what is seen, found from a starting sheet. enough: cost below which it counts.

    In the first steps bending counts in full: a step from afar may bend the sheet so much that further bending would
    hardly cost anything, and undoing that would take many steps.
    """
    config = problem.config
    state = minimised(problem, problem.begun(start), FIRM_STEPS)
    eased = problem.eased_after(state)
    state = replace(state, bent=eased.bent)
    return minimised(eased, state, config.steps[2] - FIRM_STEPS, near=True, enough=enough)


def _mirrored(problem: Problem, blind: Problem, sheet: Sheet, enough: float) -> State | None:
    """The sheet found from the mirror image of one; None if that ends at the same sheet or fails. enough: cost below
    which it counts."""
    config = problem.config
    try:
        mirrored = minimised(blind, blind.begun(relief_reversed(sheet)), config.steps[1], near=True).sheet
        if np.abs(mirrored.control - sheet.control).max() < config.same_relief:
            return None
        return _found(problem, mirrored, enough)
    except LinAlgError:
        return None


def _blind(problem: Problem, near: BackwardMap, frame: Frame) -> Problem:
    """The problem of coming near to a map: it ignores what is seen."""
    config = problem.config.blind
    return Problem(seen_through(near, [NOTHING], frame, config), problem.target, config)


def _near_map(blind: Problem, near: BackwardMap, frame: Frame) -> Sheet:
    """The unstretched sheet nearest to a map."""
    config = blind.config
    begun = blind.begun(flat_sheet(near, frame, config.intervals, config.focal))
    return minimised(blind, begun, config.steps[0], near=True).sheet


def _target(coarse: BackwardMap, frame: Frame) -> Float[np.ndarray, "m 2"]:
    """Where the network puts some points of the film."""
    return frame.from_photo(coarse.photo_from_film(film_nodes(NODES).reshape(-1, 2)))


def _result(problem: Problem, state: State, frame: Frame, sightings: Sequence[Sightings]) -> FittedSheet | None:
    backward = state.sheet.backward(frame)
    if backward is None:
        return None
    ends = np.cumsum([s.shared.shape[1] for s in sightings])
    return FittedSheet(backward, tuple(np.split(state.constants, ends[:-1])), problem, state)


__all__ = ["FittedSheet", "fit_sheet"]
