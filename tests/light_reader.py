"""The packaged LightNet, read once for all tests."""

from __future__ import annotations

import numpy as np

from hybrid.learn.networks.inference import ready
from hybrid.learn.networks.lightnet import level_reader
from hybrid.learn.networks.weights import packaged_light_net
from hybrid.rectify.film.deilluminate import DeilluminateConfig, Deillumination, deilluminate

READER = level_reader(ready(packaged_light_net()))


def without_light(
    photo: np.ndarray, valid: np.ndarray, covered: np.ndarray | None = None, config: DeilluminateConfig | None = None
) -> Deillumination:
    """The print of a flat film, recovered with the packaged network."""
    return deilluminate(photo, valid, READER, config, covered)
