"""Where the sheet ends across its edge: blur does not move steps, rules are told from halos and shadows."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.stats import norm

from hybrid.coords import linear_from_srgb, srgb_from_linear
from hybrid.rectify.edges.profile import RULES_PX, end_of_sheet, profiles_along

DEPTH = np.arange(-30.0, 31.0)
EDGE = 0.3
"""Depth of the sheet's edge in the strips of these tests; row 30 is depth 0."""


def linear(level):
    return linear_from_srgb(np.full(3, level) / 255.0)


def strip_of(behind, film, rule=None, rule_px=1.0, blur_px=0.6, profiles=24):
    """Grey levels of a strip across an edge that slants by a pixel; each level is a grey or RGB."""
    edge = EDGE + np.linspace(-0.5, 0.5, profiles)
    inside, past = (norm.cdf((DEPTH[:, None] - edge - far) / blur_px)[..., None] for far in (0.0, rule_px))
    rule = film if rule is None else rule
    light = (1 - inside) * linear(behind) + (inside - past) * linear(rule) + past * linear(film)
    grey = 255.0 * srgb_from_linear(light)
    return grey, edge


def found_end(image, path=30, expected=False, frames=False):
    """Where the sheet ends near a straight path."""
    return end_of_sheet(profiles_along(image, np.full(image.shape[1], path)), expected, frames)


def off(image, edge, path=30, expected=False):
    """How far the found edge lies from the true one at each profile, in pixels, and whether a rule was seen."""
    found = found_end(image, path, expected)
    return np.abs(found.rows - 30 - edge), found.has_rule


@pytest.mark.parametrize("blur_px", [0.5, 1.5, 2.5])
@pytest.mark.parametrize("levels", [(230.0, 15.0), (15.0, 120.0)])
def test_blur_does_not_move_an_edge(blur_px, levels):
    """A lens blurs light: an edge that is blurred in linear light stays where it is, whatever lies behind the film."""
    behind, film = levels
    distance, has_rule = off(*strip_of(behind, film, blur_px=blur_px))
    assert distance.max() < 0.1
    assert not has_rule


def test_rules_in_a_narrow_dark_margin_do_not_move_the_edge():
    """A bright rule 7 px inside a black sheet that is darker than what lies behind it."""
    grey = np.where(DEPTH < 0, 27.0, 8.0)
    grey[(DEPTH >= 7) & (DEPTH < 10)] = 200.0
    image = np.repeat(np.repeat(grey[:, None, None], 20, axis=1), 3, axis=2)
    for path in (27, 28, 30):  # a gap between the compared windows lets the path lie there
        assert np.abs(found_end(image, path).rows - 29.5).max() < 0.5


@pytest.mark.parametrize("behind", [15.0, 90.0, (190.0, 110.0, 60.0), (60.0, 80.0, 200.0)])
@pytest.mark.parametrize("path", [29, 31])
@pytest.mark.parametrize("rule_px", [0.7, 1.0, 2.0])
def test_a_rule_along_the_edge_belongs_to_the_sheet(behind, path, rule_px):
    """The rule's inner flank is steeper; the sheet ends at the outer one, if the rule has the likely width."""
    distance, has_rule = off(*strip_of(behind, 25.0, rule=225.0, rule_px=rule_px), path=path)
    assert has_rule
    assert distance.max() < 0.15 + 0.5 * abs(rule_px - RULES_PX[0])


def test_a_bright_seam_of_sharpening_is_no_rule():
    image, edge = strip_of(150.0, 20.0)
    image += 0.5 * (image - gaussian_filter1d(image, 1.2, axis=0))
    distance, has_rule = off(image.clip(0.0, 255.0), edge)
    assert not has_rule
    assert distance.max() < 0.2


def test_a_rule_hardly_brighter_than_what_lies_behind_is_seen_where_one_is_expected():
    image, edge = strip_of(120.0, 20.0, rule=150.0)
    assert not off(image, edge)[1]
    distance, has_rule = off(image, edge, expected=True)
    assert has_rule
    assert distance.max() < 0.35


@pytest.mark.parametrize("behind", [15.0, 160.0, (60.0, 80.0, 200.0)])
@pytest.mark.parametrize("at_inner_flank", [False, True])
@pytest.mark.parametrize("width_px", [4.0, 4.5, 5.5, 6.5])
def test_a_frame_along_the_edge_belongs_to_the_sheet(behind, at_inner_flank, width_px):
    """The path may follow the frame's inner flank, which is steeper; the sheet ends at the outer one."""
    image, edge = strip_of(behind, 25.0, rule=225.0, rule_px=width_px, blur_px=0.7)
    path = 30 + round(width_px if at_inner_flank else 0)
    assert profiles_along(image, np.full(image.shape[1], path)).may_have_frame
    found = found_end(image, path, frames=True)
    assert found.has_frame
    assert not found.has_rule
    assert found.band_px == pytest.approx(width_px, abs=1.0)
    assert np.abs(found.rows - 30 - edge).max() < 0.25


@pytest.mark.parametrize("blur_px", [1.0, 2.0])
def test_a_rule_out_of_focus_is_no_frame(blur_px):
    image, _ = strip_of(60.0, 25.0, rule=225.0, rule_px=1.2, blur_px=blur_px)
    assert not found_end(image, frames=True).has_frame


@pytest.mark.parametrize(("behind", "film"), [(230.0, 15.0), (15.0, 120.0)])
def test_an_edge_alone_has_no_frame(behind, film):
    image, _ = strip_of(behind, film, blur_px=1.0)
    assert not profiles_along(image, np.full(image.shape[1], 30)).may_have_frame
    assert not found_end(image, expected=True, frames=True).has_frame


def test_a_penumbra_is_no_frame():
    """A sheet that stands off the ground has a band beside it, darker than the ground and brighter than the film."""
    image, _ = strip_of(200.0, 20.0, rule=90.0, rule_px=4.0)
    assert not profiles_along(image, np.full(image.shape[1], 30)).may_have_frame
    assert not found_end(image, expected=True, frames=True).has_frame


@pytest.mark.parametrize("expected", [False, True])
def test_a_shadow_beside_the_sheet_is_no_rule(expected):
    image, edge = strip_of(120.0, 30.0)
    beside = (DEPTH > EDGE - 3) & (DEPTH < EDGE)
    image[beside] *= 0.2
    assert not off(image, edge, expected=expected)[1]


@pytest.mark.parametrize(("behind", "clipped"), [(255.0, True), ((255.0, 255.0, 180.0), False), (200.0, False)])
def test_clipped_is_what_is_so_in_all_colours(behind, clipped):
    image, _ = strip_of(behind, 40.0)
    assert (found_end(image).clipped == clipped).all()


def test_nothing_but_noise_has_no_rule():
    rng = np.random.default_rng(4)
    image = np.clip(rng.normal(60.0, 6.0, (61, 80, 3)), 0.0, 255.0)
    for expected in (False, True):
        found = found_end(image, expected=expected)
        assert not found.has_rule
        assert np.isfinite(found.rows).all()
        assert np.abs(found.rows - 30).max() <= 5.0
