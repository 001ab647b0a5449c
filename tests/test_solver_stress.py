"""A small part of the stress benchmark, with scenes that hypothesis searches for."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.scenes.stress import random_scene, run_scene
from hybrid.errors import ConfigError


@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_no_scene_breaks_the_solver(seed):
    """Each scene ends in a shape or in a readable refusal, without NaN and without energy from nowhere."""
    result = run_scene(seed, largest=9)
    assert not result.failure, result
    assert len(result.message) > 30


def test_the_scenes_are_as_wild_as_they_say():
    scenes = []
    for seed in range(100):
        try:
            scenes.append(random_scene(np.random.default_rng(seed), 65))
        except ConfigError as refusal:
            assert "without area" in str(refusal)  # noqa: PT017
    assert len(scenes) < 100  # triangles without area are among them
    stiffness = np.log10([s.network.material.youngs_modulus_mpa for s in scenes])
    steps = np.log10([s.config.dt_s for s in scenes])
    sides = {n for s in scenes for n in s.network.film.shape}
    assert np.ptp(stiffness) > 8.5
    assert np.ptp(steps) > 3.8
    assert min(sides) == 2
    assert max(sides) > 55
    assert any(np.isinf(s.loads.goal_stiffness).sum() > 3 for s in scenes)
    assert any(len(s.loads.bodies) == 2 for s in scenes)
