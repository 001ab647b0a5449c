"""How a method did on one photo, and on many."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.cases import Case, read_alike
from benchmarks.methods import Method
from hybrid.backward import BackwardMap, Orientation, end_point_error
from hybrid.coords import film_nodes, rescale_points
from hybrid.metrics import PAPER_SIZE, ImageScores, PaperScores, image_scores, paper_protocol

LATTICE = (33, 33)
"""Film points, edges included, over which the end-point error is taken."""

REFERENCE_PX = 1080
"""Longer side of the photos that pixels are quoted for; photos of other sizes are scaled to it."""

MAP_RANGE = 255.0
"""Values of a backward map taken as an image: the photo's sides are this long (the paper's B rows)."""


@dataclass(frozen=True)
class CaseScore:
    """What was measured on one photo; None where no film was found.

    end_point_px: mean distance of found from true photo points, for a photo of REFERENCE_PX. end_point_percent: the
    same in percent of the film's diagonal as it is seen. paper: scores of the unwarped photo. map: of the backward map
    as an image. up: whether the map is of the film that reads right, neither turned nor mirrored. seconds: from what
    the method is given to its map.
    """

    name: str
    seconds: float
    end_point_px: float | None = None
    end_point_percent: float | None = None
    paper: PaperScores | None = None
    map: ImageScores | None = None
    up: bool | None = None

    @property
    def found(self) -> bool:
        return self.paper is not None


def score(method: Method, case: Case) -> CaseScore:
    """Run a method on a photo and score its map."""
    given = method.given(case)
    start = time.perf_counter()
    found = method.find_or_lose(given)
    seconds = time.perf_counter() - start
    if found is None:
        return CaseScore(case.name, seconds)
    photo, true = case.photo(), case.backward
    size = (photo.shape[0], photo.shape[1])
    seen, way = read_alike(found, true)
    error = float(end_point_error(seen, true.photo_from_film(film_nodes(LATTICE))).mean())
    return CaseScore(
        name=case.name,
        seconds=seconds,
        end_point_px=error * REFERENCE_PX / max(size),
        end_point_percent=100 * error / float(np.hypot(*true.mean_film_pixels())),
        paper=paper_protocol(photo, seen, true),
        map=image_scores(_as_image(seen, size), _as_image(true, size)),
        up=way == Orientation(0, False),
    )


def _as_image(backward: BackwardMap, photo_size: tuple[int, int]) -> Float[np.ndarray, "h w 2"]:
    """A backward map as an image of values from 0 to MAP_RANGE over the photo."""
    return rescale_points(backward.dense(PAPER_SIZE), photo_size, (1, 1)) * MAP_RANGE


# ---------------------------------------------------------------- many photos


def summarise(scores: Sequence[CaseScore], says_up: bool) -> dict[str, Any]:
    """Means over the photos in which a film was found (as the paper's), medians and spreads.

    up: share of all photos whose film reads right, lost ones counting as wrong; None for methods that do not say.
    """
    found = [one for one in scores if one.found]
    times = [one.seconds for one in scores]
    summary: dict[str, Any] = {
        "count": len(scores),
        "lost": len(scores) - len(found),
        "up": sum(bool(one.up) for one in scores) / len(scores) if says_up else None,
        "seconds": {"median": statistics.median(times), "spread": _quartiles(times), "least": min(times)},
    }
    if not found:
        return summary
    for name in ("end_point_px", "end_point_percent"):
        values = [getattr(one, name) for one in found]
        summary[name] = {"mean": statistics.fmean(values), "median": statistics.median(values)}
    images = {
        "raw": [one.paper.raw for one in found if one.paper],
        "deshifted": [one.paper.deshifted for one in found if one.paper],
        "map": [one.map for one in found if one.map],
    }
    return summary | {name: _means(values) for name, values in images.items()}


def _means(scores: Sequence[ImageScores]) -> dict[str, float]:
    rows = [asdict(one) for one in scores]
    return {name: statistics.fmean(row[name] for row in rows) for name in rows[0]}


def _quartiles(values: Sequence[float]) -> list[float]:
    return [float(q) for q in np.quantile(values, (0.25, 0.75))]


__all__ = ["CaseScore", "score", "summarise"]
