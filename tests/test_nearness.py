"""Which of several maps of one film counts."""

from __future__ import annotations

from dataclasses import replace

import pytest
from test_trust import SURE

from hybrid.rectify.verdict.nearness import NearnessConfig, nearness
from hybrid.rectify.verdict.trust import chance_right


@pytest.mark.parametrize(("sign", "better"), [("alike", 0.8), ("support", 0.99), ("stated", 0.0004)])
def test_the_map_counts_whose_cells_are_more_alike_whose_edges_are_surer_or_that_expects_less_error(sign, better):
    assert nearness(replace(SURE, **{sign: better})) > nearness(SURE)


def test_how_alike_cells_are_tells_maps_of_one_film_apart_but_not_films():
    other = replace(SURE, alike=0.3)
    assert nearness(other) < nearness(SURE)
    assert chance_right(other) == chance_right(SURE)


def test_nothing_seen_is_finite_and_weights_may_be_changed():
    nothing = replace(SURE, alike=0.0, support=0.0, stated=0.0)
    assert -100 < nearness(nothing) < 100
    assert nearness(SURE, NearnessConfig(alike=0.0, support=0.0, stated=0.0)) == 0.0
