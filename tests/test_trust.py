"""When a film is called flattened: never on a contradiction, never without the musts, never because a sign is worse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic_film import FilmDrawing, disturbed, make_photo

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres, film_nodes
from hybrid.pyramid import Pyramid
from hybrid.records import CoarseMaps, Signs, SliceGrid, StatusCode
from hybrid.rectify.edges.paths import EdgesRead
from hybrid.rectify.verdict.flat import frame_of
from hybrid.rectify.verdict.trust import (
    FLAT_ERROR,
    TrustConfig,
    cells_alike,
    chance_right,
    expected_error_px,
    film_verdict,
    largest_error_px,
    seen_beside,
    sides_outside,
)

TOO_FAR = f"px of error expected, {TrustConfig().safety * TrustConfig().limit_px:.1f} allowed"

SURE = Signs(
    overlap_before=0.99, overlap_after=0.995, alike=0.7, grid=True, corrected=True, edges=4, film_px=700.0,
    photo_px=1080, levels=255.0, support=0.97, in_step=0.98, seen_beside=0.003, stated=0.0008, edges_beside=0.0003,
    borders_shown=0.98, lopsided=0.001, sheet=True,
)  # fmt: skip


def test_what_was_in_doubt_at_first_is_trusted_less() -> None:
    """The surest of several refinements is so partly by selection."""
    assert chance_right(replace(SURE, doubted=True)) < chance_right(SURE)
    assert expected_error_px(replace(SURE, doubted=True)) == expected_error_px(SURE)


def test_without_a_grid_what_shows_in_a_nearer_look_alone_is_no_film() -> None:
    """Some parts of rooms and of papers look like a sheet once the rest is left out."""
    bare = replace(SURE, grid=False, in_step=0.0, alike=0.0)
    assert film_verdict(bare).code is StatusCode.UNSURE
    assert film_verdict(replace(bare, near=True)).code is StatusCode.NO_FILM
    assert film_verdict(replace(SURE, near=True)).ok


@pytest.mark.parametrize("k", range(4))
def test_the_side_with_the_least_support_is_named(k: int) -> None:
    chances = np.full((4, 64), 0.9)
    chances[k] = 0.3
    read = EdgesRead(frame_of((600, 400)), (), 0.0, chances)
    assert read.weakest == ("top", "bottom", "left", "right")[k]
    assert read.support.min() == pytest.approx(0.3)


def test_sides_outside_the_photo_are_named() -> None:
    """A corner may lie outside, and a film may end where the photo does or be read as ending a pixel beyond that."""
    frame = frame_of((600, 400))
    assert sides_outside(frame, (600, 400)) == ()
    assert sides_outside(frame.cropped((1.0, 1.0), (1.0, 1.0)), (598, 398)) == ()
    assert sides_outside(frame.cropped((0.0, 30.0), (1.0, 1.0)), (570, 400)) == ("top",)
    assert sides_outside(frame.cropped((-10.0, 0.0), (1.0, 1.0)), (560, 400)) == ("bottom", "right")
    corner = BackwardMap.from_function(
        lambda uv: uv @ np.array([[400.0, 90.0], [-90.0, 400.0]]) + np.array([60.0, 30.0])
    )
    assert sides_outside(corner, (600, 500)) == ()


def test_a_film_that_all_signs_speak_for_is_flattened() -> None:
    found = film_verdict(SURE)
    assert found.ok
    assert "expected to be off by 0.4 px" in found.reason
    assert found.doubts == ()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"grid": False}, "no grid seen"),
        ({"edges": 3}, "3 of 4 edges seen"),
        ({"levels": 13.0}, "only 13 of 255 grey levels"),
        ({"corrected": False}, "did not correct the network"),
        ({"support": 0.3}, "the weakest edge is only 30% likely to be the sheet's"),
        ({"support": 0.3, "weakest": "left"}, "the left edge is only 30% likely to be the sheet's"),
        ({"outside": ("top",)}, "step back, the photo lacks the film's top edge"),
        ({"outside": ("top", "left")}, "the photo lacks the film's top and left edge"),
        ({"goes_on": 0.454}, "the sheet may go on beyond its map (45% likely)"),
        ({"alike": 0.05}, "cells are not alike"),
        ({"in_step": 0.3}, "the network sees other cells"),
        ({"overlap_after": 0.6}, "overlaps the sheet by only 60%"),
        ({"edges_beside": 0.02, "stated": 0.01}, TOO_FAR),
        ({"seen_beside": float("inf")}, TOO_FAR),
        ({"borders_shown": 0.0, "lopsided": 0.05, "stated": 0.005}, TOO_FAR),
        ({"seen_beside": float("inf")}, "sure to be right to 5.0 px"),
        ({"seen_beside": 0.02}, "sure to be right to 5.0 px"),
        ({"lopsided": 0.05, "stated": 0.006}, "sure to be right to 5.0 px"),
        ({"borders_shown": 0.3, "sheet": False, "edges_beside": 0.002}, "sure to be right to 5.0 px"),
    ],
)
def test_each_doubt_is_told(change: dict, text: str) -> None:
    found = film_verdict(replace(SURE, **change))
    assert found.code is StatusCode.UNSURE
    assert text in found.reason
    assert any(text in doubt for doubt in found.doubts)


def test_what_has_neither_edges_nor_cells_nor_anything_that_fits_is_no_film() -> None:
    signs = {"grid": False, "corrected": False, "support": 0.1}
    assert film_verdict(replace(SURE, **signs)).code is StatusCode.NO_FILM
    for name in signs:
        others = {key: value for key, value in signs.items() if key != name}
        assert film_verdict(replace(SURE, **others)).code is StatusCode.UNSURE


@pytest.mark.parametrize(
    ("name", "worse"),
    [("seen_beside", 0.01), ("stated", 0.01), ("edges_beside", 0.002), ("borders_shown", 0.6), ("lopsided", 0.02)],
)
def test_every_worse_sign_raises_the_expected_error(name: str, worse: float) -> None:
    assert expected_error_px(replace(SURE, **{name: worse})) > expected_error_px(SURE)


@pytest.mark.parametrize(
    ("name", "worse"),
    [("seen_beside", 0.01), ("stated", 0.01), ("edges_beside", 0.002), ("borders_shown", 0.6), ("lopsided", 0.02),
     ("sheet", False), ("film_px", 1000.0)],
)  # fmt: skip
def test_every_worse_sign_makes_a_right_map_less_probable(name: str, worse: float) -> None:
    assert chance_right(replace(SURE, **{name: worse})) < chance_right(SURE)


def test_the_more_error_is_allowed_the_more_probable_is_a_right_map() -> None:
    assert chance_right(SURE, TrustConfig(limit_px=10.0)) > chance_right(SURE) > 0.95
    assert chance_right(replace(SURE, flat=True)) == 1.0


def test_the_expected_error_scales_with_the_photo_and_the_verdict_does_not_change() -> None:
    twice = replace(SURE, film_px=1400.0, photo_px=2160)
    assert chance_right(twice) == pytest.approx(chance_right(SURE))
    assert expected_error_px(twice) == pytest.approx(2 * expected_error_px(SURE))
    for overlap in np.linspace(0.85, 1.0, 16):
        one, two = (film_verdict(replace(s, overlap_before=overlap, overlap_after=overlap)) for s in (SURE, twice))
        assert one.code is two.code


def test_in_a_tiny_photo_one_pixel_is_allowed() -> None:
    """Five pixels of a 1080 px photo would be half a pixel there."""
    tiny, larger = (replace(SURE, film_px=70.0, photo_px=px) for px in (108, 216))
    assert chance_right(tiny) == chance_right(larger)
    assert film_verdict(tiny).code is film_verdict(larger).code


def grid_over(true: BackwardMap, rows: int, cols: int) -> SliceGrid:
    vertices = film_nodes((rows + 1, cols + 1))
    return SliceGrid(rows, cols, vertices, true.photo_from_film(vertices), 1.0)


def test_cells_are_most_alike_through_the_true_map() -> None:
    photo, true = make_photo(FilmDrawing(rules=False), np.random.default_rng(2), 150)
    grid = grid_over(true, 4, 3)
    alike = cells_alike(Pyramid(photo), true, grid)
    for seed in range(3):
        assert cells_alike(Pyramid(photo), disturbed(true, 6.0, np.random.default_rng(seed)), grid) < alike
    assert 0 <= alike <= 1
    assert cells_alike(Pyramid(photo), true, grid_over(true, 1, 1)) == 0


def test_a_flat_picture_is_expected_to_be_off_in_proportion_to_its_size() -> None:
    one, two = (expected_error_px(replace(SURE, flat=True, film_px=px)) for px in (700.0, 1400.0))
    assert one == pytest.approx(700 * FLAT_ERROR)
    assert two == pytest.approx(2 * one)


def test_a_flat_picture_is_expected_to_be_off_by_what_refining_its_frame_moves() -> None:
    flat = replace(SURE, flat=True)
    aslant, further = (replace(flat, off_frame=share) for share in (0.002, 0.02))
    assert expected_error_px(flat) < expected_error_px(aslant) < expected_error_px(further)
    assert expected_error_px(aslant) == pytest.approx(0.002 * flat.film_px)
    assert film_verdict(further).ok


def test_margins_are_as_lopsided_as_they_differ_along_the_worse_axis() -> None:
    film = BackwardMap.from_function(lambda uv: 100.0 + uv * 400.0)
    vertices = np.array([0.02, 0.05]) + np.array([0.96, 0.88]) * film_nodes((3, 4))
    grid = SliceGrid(2, 3, vertices, film.photo_from_film(vertices), 1.0)
    assert grid.lopsided == pytest.approx(0.02)


def test_what_is_seen_beside_a_map_counts_as_far_as_it_is_smooth() -> None:
    film = BackwardMap.from_function(lambda uv: 100.0 + uv * 400.0)
    uv = film_centres((20, 20)).astype(np.float32)
    whole, zeros = np.ones((20, 20), np.float32), np.zeros((20, 20, 3), np.float32)

    def beside(off: np.ndarray) -> float:
        seen = (film.photo_from_film(uv.astype(np.float64)) + off).astype(np.float32)
        return seen_beside(CoarseMaps(whole, uv, zeros, whole, seen), film)

    assert beside(np.array([3.0, 4.0])) == pytest.approx(5.0 / 400, rel=1e-3)
    assert beside(np.stack([10.0 * (uv[..., 1] - 0.5), 0 * uv[..., 0]], axis=-1)) == pytest.approx(2.89 / 400, rel=0.02)
    assert beside(np.random.default_rng(0).normal(0, 5, (20, 20, 2))) < 1.5 / 400


def test_no_photo_is_asked_for_less_than_a_pixel_of_its_own() -> None:
    assert largest_error_px(1080, TrustConfig()) == pytest.approx(5)
    assert largest_error_px(100, TrustConfig()) == 1


def test_what_reads_as_an_edge_a_little_is_a_film_that_is_not_sure() -> None:
    signs = replace(SURE, grid=False, corrected=False, support=0.4)
    assert film_verdict(signs).code is StatusCode.UNSURE
