"""What is printed evenly and seen unevenly tells how the map mistakes the sheet's foreshortening."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from jaxtyping import Float
from synthetic_film import FilmDrawing, make_photo
from test_cells import film_of

from hybrid.backward import BackwardMap, end_point_error
from hybrid.coords import film_nodes
from hybrid.rectify.foreshortening import EVEN, Bend, ForeshorteningConfig, even, foreshortening
from hybrid.rectify.refine import RefineConfig, refine

CONFIG = ForeshorteningConfig()


def spaced(t: Float[np.ndarray, "*n"], bend: Bend) -> Float[np.ndarray, "*n"]:
    """The film point at which an even film's point ``t`` is shown: the formula by which bends are defined."""
    a, b = bend
    return t + t * (1 - t) * (a + b * (1 - 2 * t))


def shown(film: Float[np.ndarray, "h w"], along_u: Bend, along_v: Bend) -> Float[np.ndarray, "h w"]:
    """A view that shows the film with such spacings, by inverting them point for point."""
    t, (h, w) = np.linspace(0, 1, 2001), film.shape
    x = np.interp((np.arange(w) + 0.5) / w, spaced(t, along_u), t) * w - 0.5
    y = np.interp((np.arange(h) + 0.5) / h, spaced(t, along_v), t) * h - 0.5
    maps = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    return cv2.remap(film, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize("bend", [(0.35, 0.0), (-0.25, -0.1), (0.4, -0.2), (-0.3, 0.15)])
@pytest.mark.parametrize(("rows", "cols"), [(5, 4), (4, 5), (6, 4)])
def test_uneven_spacing_is_read_along_each_axis(rows: int, cols: int, bend: Bend):
    film, t = film_of(rows, cols), np.linspace(0, 1, 41)
    for axis, view in enumerate((shown(film, bend, EVEN), shown(film, EVEN, bend))):
        found = foreshortening(view, CONFIG)
        assert found[1 - axis] == EVEN
        assert np.abs(spaced(t, found[axis]) - spaced(t, bend)).max() < 0.02
    found = foreshortening(shown(film, bend, (-bend[0], bend[1])), CONFIG)
    assert np.sign(found[0][0]) == np.sign(bend[0])
    assert np.sign(found[1][0]) == -np.sign(bend[0])


@pytest.mark.parametrize("margin", [0.0, 0.05])
@pytest.mark.parametrize("rules", [False, True])
def test_what_is_even_stays_even(rules: bool, margin: float):
    for rows, cols in ((3, 3), (5, 4), (2, 6)):
        assert foreshortening(film_of(rows, cols, margin, rules), CONFIG) == (EVEN, EVEN)


def test_small_unevenness_is_left_to_the_cells():
    assert foreshortening(shown(film_of(5, 4), (0.05, 0.0), EVEN), CONFIG) == (EVEN, EVEN)


@pytest.mark.parametrize("size", [(40, 300), (300, 40), (200, 200), (700, 500)])
def test_where_nothing_repeats_nothing_is_read(size: tuple[int, int]):
    rng = np.random.default_rng(0)
    noise = rng.normal(90, 30, size).astype(np.float32)
    ramp = np.tile(np.linspace(0, 255, size[1], dtype=np.float32), (size[0], 1))
    for view in (noise, cv2.GaussianBlur(noise, (0, 0), 3), ramp, np.zeros(size, np.float32)):
        assert foreshortening(view, CONFIG) == (EVEN, EVEN)


def test_the_even_map_undoes_the_spacing_and_keeps_the_edges():
    flat = BackwardMap(film_nodes((17, 17)) * (400.0, 300.0))
    bends = ((0.3, 0.1), (-0.2, 0.0))
    uv = film_nodes((21, 21))
    expected = np.stack([spaced(uv[..., 0], bends[0]) * 400, spaced(uv[..., 1], bends[1]) * 300], axis=-1)
    assert np.abs(even(flat, bends).photo_from_film(uv) - expected).max() < 0.02
    assert np.abs(even(flat, (EVEN, EVEN)).photo_from_film(uv) - flat.photo_from_film(uv)).max() < 1e-9


@pytest.mark.parametrize("axis", [0, 1])
def test_a_map_with_right_edges_and_an_inside_half_a_slice_off_is_put_right(axis: int):
    photo, true = make_photo(FilmDrawing(5, 4, rules=False), np.random.default_rng(3))
    bends = ((-0.35, 0.1), EVEN) if axis == 0 else (EVEN, (-0.35, 0.1))
    coarse = even(true, bends)
    refined = refine(photo, coarse, RefineConfig())
    before, after = (float(end_point_error(one, true.nodes).mean()) for one in (coarse, refined.backward))
    assert before > 20
    assert after < 2
    assert "foreshortening" in next(stage.reason for stage in refined.stages if stage.name == "grid")
