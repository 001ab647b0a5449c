"""The scores of a method on one photo, and on many."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from benchmarks.methods import Method
from benchmarks.photos.cases import Case, read_alike
from hybrid.backward import BackwardMap, Orientation, end_point_error
from hybrid.coords import rescale_points
from hybrid.metrics import PAPER_SIZE, ImageScores, PaperScores, image_scores, local_distortion, paper_protocol
from hybrid.rectify.verdict.trust import REFERENCE_PX

LATTICE = (33, 33)
"""Film points, edges included, over which the end-point error is taken."""

MAP_RANGE = 255.0
"""Values of a backward map taken as an image: the photo's sides have this length (the paper's B rows)."""


@dataclass(frozen=True)
class MapScore:
    """How near a found map comes to the true one, turned and mirrored to match it best.

    end_point_px, end_point_p95_px: mean and 95th percentile over the film of the distance between found and true photo
    points, for a photo of REFERENCE_PX. end_point_percent: the mean in percent of the film's diagonal as it is seen.
    distortion_px: hybrid.metrics.local_distortion. paper: scores of the unwarped photo. map: of the backward map as an
    image. up: whether the map is of the film that reads right, neither turned nor mirrored.
    """

    end_point_px: float
    end_point_p95_px: float
    end_point_percent: float
    distortion_px: float
    paper: PaperScores
    map: ImageScores
    up: bool


@dataclass(frozen=True)
class CaseScore:
    """Measurements on one photo. seconds: from the method's input to the map. score: None where the film is lost."""

    name: str
    seconds: float
    score: MapScore | None = None


def score(method: Method, case: Case) -> CaseScore:
    """Run a method on a photo and score its map."""
    given = method.given(case)
    start = time.perf_counter()
    found = method.find_or_lose(given)
    seconds = time.perf_counter() - start
    return CaseScore(case.name, seconds, None if found is None else score_map(found, case.backward, case.photo()))


def score_map(found: BackwardMap, true: BackwardMap, photo: UInt8[np.ndarray, "h w 3"]) -> MapScore:
    """Score a map against the true one of the same photo; the inputs are not changed."""
    size = (photo.shape[0], photo.shape[1])
    seen, way = read_alike(found, true)
    errors = end_point_error(seen, true.lattice(LATTICE))
    to_reference = REFERENCE_PX / max(size)
    return MapScore(
        end_point_px=float(errors.mean()) * to_reference,
        end_point_p95_px=float(np.percentile(errors, 95)) * to_reference,
        end_point_percent=100 * float(errors.mean()) / float(np.hypot(*true.mean_film_pixels())),
        distortion_px=local_distortion(seen, true),
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
    found = [one.score for one in scores if one.score is not None]
    times = [one.seconds for one in scores]
    summary: dict[str, Any] = {
        "count": len(scores),
        "lost": len(scores) - len(found),
        "up": sum(one.up for one in found) / len(scores) if says_up else None,
        "seconds": {"median": statistics.median(times), "spread": _quartiles(times), "least": min(times)},
    }
    if not found:
        return summary
    for name in ("end_point_px", "end_point_percent", "distortion_px"):
        values = [getattr(one, name) for one in found]
        summary[name] = {"mean": statistics.fmean(values), "median": statistics.median(values)}
    images = {
        "raw": [one.paper.raw for one in found],
        "deshifted": [one.paper.deshifted for one in found],
        "map": [one.map for one in found],
    }
    return summary | {name: _means(values) for name, values in images.items()}


def _means(scores: Sequence[ImageScores]) -> dict[str, float]:
    rows = [asdict(one) for one in scores]
    return {name: statistics.fmean(row[name] for row in rows) for name in rows[0]}


def _quartiles(values: Sequence[float]) -> list[float]:
    return [float(q) for q in np.quantile(values, (0.25, 0.75))]


__all__ = ["CaseScore", "MapScore", "score", "score_map", "summarise"]
