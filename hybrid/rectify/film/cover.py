"""What lies in front of the film: hands, clips, tape. Hidden print is marked, never made up."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from hybrid.backward import BackwardMap
from hybrid.coords import photo_from_opencv, sample_bilinear
from hybrid.errors import require_at_least, require_at_most
from hybrid.records import CoarseMaps
from hybrid.rectify.film.resample import index_in_grid


@dataclass(frozen=True)
class CoverConfig:
    """When a part of the film counts as hidden by something in front of it."""

    least_chance: float = 0.5
    """Least probability of that, according to the network."""
    side_px: int = 96
    """Pixels along each side of the film at which the network's map is read: twice as many as the map has."""

    def __post_init__(self) -> None:
        require_at_least(self, 4, "side_px")
        require_at_most(self, 1, "least_chance")


def covered_parts(
    maps: CoarseMaps, backward: BackwardMap, valid: Bool[np.ndarray, "h w"], config: CoverConfig | None = None
) -> Bool[np.ndarray, "h w"]:
    """Which pixels of the flat film show something in front of it.

    maps: the network's last look. backward: the film's map, however it is turned. valid: where the photo reaches.
    """
    config = config or CoverConfig()
    chance = _chance(maps, backward, config)
    if chance is None:
        return np.zeros_like(valid)
    covered = cv2.resize(chance, valid.shape[::-1], interpolation=cv2.INTER_LINEAR) >= config.least_chance
    return np.asarray(covered & valid)


def _chance(maps: CoarseMaps, backward: BackwardMap, config: CoverConfig) -> Float[np.ndarray, "n n"] | None:
    """The probability on a small copy of the film; None where it is low everywhere, as in most photos."""
    if maps.covered is None or maps.covered.max() < config.least_chance:
        return None
    points = backward.dense((config.side_px, config.side_px))
    at = photo_from_opencv(np.stack(index_in_grid(maps.photo_points, points), axis=-1))
    chance = sample_bilinear(np.asarray(maps.covered, dtype=np.float32), at)
    return chance if chance.max() >= config.least_chance else None
