"""Refines a coarse backward map to a fraction of a pixel by what the photo shows of the sheet and its print.

Starting from a map, each round searches for the sheet's edges and its print and fits a smooth displacement to them
(refine/course.py). Then one bent sheet that does not stretch, or hardly, is fitted to all that was seen (sheet/fit.py),
and everything is searched for again through its map: the result counts if it explains what is seen as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.records import SliceGrid, StageReport
from hybrid.rectify.edges.outline import find_outline
from hybrid.rectify.edges.paths import EdgesRead
from hybrid.rectify.grid.phases import CellPhases
from hybrid.rectify.margins.placing import PlacedPrint
from hybrid.rectify.refine.config import RefineConfig
from hybrid.rectify.refine.course import (
    Course,
    Progress,
    agreement,
    begin,
    ended,
    followed,
    next_sheets,
    read_view,
    unstretched,
)
from hybrid.rectify.refine.scene import phases_along, scene_of
from hybrid.rectify.sheet.fit import FittedSheet
from hybrid.rectify.splines.sightings import Sightings
from hybrid.stages import Stopwatch


@dataclass(frozen=True)
class _Trend:
    """Logarithm of the remaining error, as a linear function of what is known: a constant and slopes.

    apart: for the logarithm of how far apart the two ends are, in percent of the film. residual: for the logarithm of
    the held-out residual. unseen: added where no cells were matched. whole: for the number of axes on which all lines
    were seen. sheet: added where an unstretched sheet explains what is seen.
    """

    constant: float
    apart: float
    residual: float
    unseen: float
    whole: float
    sheet: float


EXPECTED = _Trend(-4.37, 1.0, 0.75, 0.55, -0.25, -0.43)
"""Ridge regression (of absolute deviations) over 250 simulated photos of the training scans, a fifth of them damaged.
Half of the errors are smaller than predicted; the logarithm spreads by 1.2: one in ten is over 3.8 times as large."""

UNKNOWN_APART = 0.008
"""Assumed distance between the two ends where there is only one, in parts of the film."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """A refined map, the slice grid if one was found, and what was done.

    expected_px: expected mean end-point error that is left (EXPECTED), in pixels of the photo; None where the coarse
        map was kept.
    edges: number of the sheet's edges that were seen.
    aspect: height over width of the unstretched sheet that explains what is seen; None where none does. aspect_sigma:
        standard deviation of its logarithm.
    stands: whether what was seen bears the map out, even a coarse map kept because no other explains that better.
    across: the sheet's edges as read across the map's (edges/paths.py); None where they were not read.
    """

    backward: BackwardMap
    grid: SliceGrid | None
    stages: tuple[StageReport, ...]
    expected_px: float | None = None
    edges: int = 0
    aspect: float | None = None
    aspect_sigma: float = 0.0
    stands: bool = False
    across: EdgesRead | None = None

    @property
    def believed(self) -> bool:
        """Whether another map was found and is taken to be better than the one it started from."""
        return self.expected_px is not None


def refine(
    photo: UInt8[np.ndarray, "H W 3"],
    coarse: BackwardMap,
    phases: CellPhases | None,
    config: RefineConfig,
    edges: Sequence[Sightings] = (),
) -> Refinement:
    """The coarse map, corrected where the photo shows how.

    photo: RGB, the one that ``coarse`` maps into, as large as needed (config.working_px). phases: what the network says
    about the cells. edges: as read (edges/paths.py) through ``coarse``. Returns the coarse map itself where nothing was
    seen, where the correction does not explain the photo better, or where it would fold the film or move it too far;
    the report of stage ``spline`` says which. Raises nothing on any photo.
    """
    watch = Stopwatch()
    scene = scene_of(photo, coarse, phases, tuple(edges))
    outline = find_outline(scene.photo, scene.coarse, config.outline, scene.edges)
    watch.lap("outline")
    course = _course(begin(scene, outline, config), config, watch)
    if course is None:
        return _unchanged(coarse, "no edge, rule, gutter or repeated text was seen", watch)
    is_bent = course.scene is not scene
    changed = course.believed and (is_bent or course.displacement.moves)
    backward = coarse
    if changed:
        rows, columns = (max(33, n) for n in coarse.nodes.shape[:2])
        fine = (rows, columns) != course.film.nodes.shape[:2]
        backward = course.displacement.composed(course.scene.coarse, (rows, columns)) if fine else course.film
    aspect = None if course.sheet is None else float(np.exp(-course.sheet.sheet.log_aspect))
    told = phases_along(course.scene, course.film)
    seen_aspect = course.scene.aspect if aspect is None else aspect
    reading = read_view(course.counted_view, course.layout, told, seen_aspect, config)
    share = _expected_share(course)
    grid = course.layout.slice_grid(reading, course.film, share if course.believed else np.inf)
    if grid is not None and is_bent and not changed:  # it was seen through a map that is not believed
        vertices = np.clip(_film_of(grid.vertices_photo, backward, grid.vertices), 0.0, 1.0)
        grid = replace(grid, vertices=vertices, vertices_photo=backward.photo_from_film(vertices))
    watch.lap("grid")
    bound = changed and course.sheet is not None
    stages = (
        StageReport("outline", course.edges > 0, f"{course.edges} of 4 edges", watch["outline"]),
        StageReport("grid", grid is not None, course.layout.reason(reading), watch["grid"]),
        StageReport("sheet", bound, _about_sheet(course.sheet if bound else None, config), watch["sheet"]),
        StageReport("spline", changed, course.verdict, watch["spline"]),
    )
    return Refinement(
        backward,
        grid,
        stages,
        expected_px=share * max(backward.mean_film_pixels()) if changed else None,
        edges=course.edges,
        aspect=aspect if changed else None,
        aspect_sigma=0.0 if course.sheet is None else course.sheet.aspect_sigma,
        stands=course.believed,
    )


def _about_sheet(sheet: FittedSheet | None, config: RefineConfig) -> str:
    """What the report says about the sheet that explains what is seen, or about there being none (None)."""
    if not config.sheet_rounds:
        return "no sheet is fitted in this effort"
    if sheet is None:
        return "no sheet explains what is seen"
    kind = "a sheet that stretches" if sheet.stretched else "an unstretched sheet"
    return f"edges and print are those of {kind}"


def _film_of(
    points: Float[np.ndarray, "r c 2"], film: BackwardMap, near: Float[np.ndarray, "r c 2"]
) -> Float[np.ndarray, "r c 2"]:
    """Film coordinates, by a map, of photo points whose coordinates are roughly known."""
    return film.film_near(points.reshape(-1, 2), near.reshape(-1, 2)).reshape(near.shape)


def _course(begun: Progress, config: RefineConfig, watch: Stopwatch) -> Course | None:
    """All rounds from a starting map, then those from the unstretched sheets that explain what was seen, if these
    explain it as well. None where nothing is seen."""
    progress = followed(begun, config, watch)
    if progress is None:
        return None
    likeliest, possible = _with_sheets(progress, config, watch)
    free = ended(progress, config, watch)
    if not config.sheet_rounds:
        return replace(free, apart=0.0)
    if likeliest is None:
        return free
    bound = ended(likeliest, config, watch)
    if possible is not None:
        bound = _likelier(bound, ended(possible, config, watch), config, watch)
    return replace(_better(free, bound, config, watch), apart=_apart(free, bound))


def _with_sheets(progress: Progress, config: RefineConfig, watch: Stopwatch) -> tuple[Progress | None, Progress | None]:
    """Where the rounds from unstretched sheets end: those that explain best what is seen and, if there are any, those
    with usual margins that explain it less well at first."""
    likeliest, possible = progress, None
    while not _is_last(likeliest, config):
        sheets = next_sheets(likeliest, config, watch)
        if (begun := _from_sheet(likeliest, sheets.possible, config, watch)) is not None:
            possible = _with_sheets(begun, config, watch)[0] or begun
        further = _from_sheet(likeliest, sheets.likeliest, config, watch)
        if further is None:
            break
        likeliest = further
    return (None if likeliest is progress else likeliest), possible


def _from_sheet(
    progress: Progress, placed: PlacedPrint | None, config: RefineConfig, watch: Stopwatch
) -> Progress | None:
    """One more round from a sheet, if there is one."""
    return None if placed is None else unstretched(progress, placed, config, watch)


def _is_last(progress: Progress, config: RefineConfig) -> bool:
    """Whether no further sheet is to follow."""
    enough = progress.sheets >= config.sheet_rounds
    return enough or (progress.sheet is not None and progress.is_last(config))


def _likelier(bound: Course, usual: Course, config: RefineConfig, watch: Stopwatch) -> Course:
    """The less doubtful of two courses with sheets, of which the second has more usual margins."""
    if not usual.believed:
        return bound
    before, after = (
        doubt * (1.0 if course.sheet is None else course.sheet.typical_residual)
        for doubt, course in zip(_doubts((bound, usual), config), (bound, usual), strict=True)
    )
    watch.lap("spline")
    return usual if after <= config.usual_doubt * before else bound


def _better(free: Course, bound: Course, config: RefineConfig, watch: Stopwatch) -> Course:
    """The less doubtful course. Neither the residual nor how alike the cells look tells alone: cells also look alike
    through a wrongly bent sheet, and the sightings that misled a sheet do fit it.

    ``bound`` ends with a sheet, as films are, so it counts even if it is slightly more doubtful. A course that is
    believed is better than one that is not.
    """
    if free.believed != bound.believed:
        return bound if bound.believed else free
    doubt = _doubts((free, bound), config)
    watch.lap("spline")
    return bound if doubt[1] <= config.sheet_doubt * doubt[0] else free


def _doubts(courses: tuple[Course, Course], config: RefineConfig) -> list[float]:
    """How doubtful two courses are: the residual over the square of how alike the cells look."""
    layouts = [course.layout for course in courses]
    return [course.after / np.square(agreement(course, layouts) + config.least_likeness) for course in courses]


def _apart(one: Course, other: Course) -> float:
    """Mean distance between the final maps of two courses, up to a shift of the whole film, in parts of its longer
    side: only the sheet tells where between the margins the grid lies."""
    ends = [end.scene.coarse.photo_from_film(end.displacement(film_nodes((9, 9)))) for end in (one, other)]
    apart = ends[1] - ends[0]
    apart -= apart.mean(axis=(0, 1))
    return float(np.linalg.norm(apart, axis=-1).mean() / max(one.scene.coarse.mean_film_pixels()))


def _expected_share(course: Course) -> float:
    """The error that is expected to be left at the end of a course, in parts of the film's longer side.

    The distance between the ends of the rounds and of the unstretched sheet tells most: what leads one astray seldom
    leads the other the same way. EXPECTED says how this was calibrated.
    """
    layout, trend = course.layout, EXPECTED
    whole = sum(comb is not None and len(comb.seen) > comb.cells for comb in layout.combs)
    apart = UNKNOWN_APART if course.apart is None else float(np.clip(course.apart, 2e-4, 0.1))
    return float(
        np.exp(
            trend.constant
            + trend.apart * np.log(apart / 0.01)
            + trend.residual * np.log(np.clip(course.after, 0.4, 3.0))
            + trend.unseen * (not layout.has_cells)
            + trend.whole * whole
            + trend.sheet * (course.sheet is not None)
        )
    )


def _unchanged(coarse: BackwardMap, reason: str, watch: Stopwatch) -> Refinement:
    stages = tuple(StageReport(name, False, reason, watch[name]) for name in ("outline", "grid", "sheet", "spline"))
    return Refinement(coarse, None, stages)


__all__ = ["Refinement", "refine"]
