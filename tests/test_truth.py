"""Truth of a sample at the points of a view: what lies in front of the film is told from what lies beside it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from simple_samples import simple_dataset

from hybrid.coords import film_nodes, pixel_centres
from hybrid.learn.datasets.samples import open_places, truth_at
from hybrid.learn.datasets.shards import Shard


class OneSample(Shard):
    """A shard of one sample whose only maps are the film's: a flat film in a photo of 160 px, maps of 80 px."""

    def __init__(self, hole: tuple[slice, slice] | None) -> None:
        self.nodes = 24.0 + 112.0 * film_nodes((5, 5))
        self.mask = np.zeros((80, 80), bool)
        self.mask[12:68, 12:68] = True
        if hole is not None:
            self.mask[hole] = False

    def stored(self, name: str, index: int) -> np.ndarray:
        return {"mask": self.mask, "backward": self.nodes, "uv": np.zeros((80, 80, 2), np.uint16)}[name]

    def has(self, name: str) -> bool:
        return name == "uv"

    def record(self, index: int) -> dict[str, Any]:
        return {}


def test_a_normal_is_known_wherever_film_is_seen(tmp_path):
    """Also where the nearest pixel shows no film but the three others around the point do."""
    place = open_places([simple_dataset(tmp_path, count=2, shard_size=2)])[0]
    truth = truth_at(place, pixel_centres((48, 48)) + 0.37, (48, 48))
    np.testing.assert_allclose(np.linalg.norm(truth.normal[truth.mask], axis=-1), 1.0, atol=1e-5)
    assert not truth.normal[~truth.mask].any()


@pytest.mark.parametrize("hole", [None, (slice(30, 50), slice(50, 80))])
def test_what_is_hidden_within_the_outline_is_covered(hole):
    truth = truth_at((OneSample(hole), 0), pixel_centres((160, 160)) + 5.0, (160, 160))
    assert not (truth.covered & truth.mask).any()
    expected = np.zeros((160, 160), bool)
    if hole is not None:
        expected[55:95, 95:131] = True  # twice as many pixels, five pixels further to the top left
    wrong = (truth.covered ^ expected).sum()
    assert wrong <= 0.15 * expected.sum()
    assert not truth.covered[:, 150:].any(), "beyond the photo nothing is known"
