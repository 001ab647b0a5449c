"""Corners of the sheet that a person points at: from them to the map, and through the whole pipeline."""

from dataclasses import replace
from itertools import permutations

import cv2
import numpy as np
import pytest
from film_photos import Shot, film_print, photographed, table

from hybrid.backward import BackwardMap, film_as_seen
from hybrid.coords import film_nodes
from hybrid.errors import ConfigError
from hybrid.pipeline import Rectifier
from hybrid.records import StatusCode
from hybrid.rectify.coarse.corners import film_at, put_on_corners
from hybrid.rectify.verdict.survey import Verdict

SIZE = (800, 1000)
SHEET = np.array([[210.0, 120.0], [790.0, 180.0], [820.0, 640.0], [170.0, 600.0]])
"""Corners from the top left, clockwise."""


@pytest.fixture(scope="module")
def rectifier():
    return Rectifier()


def corners_of(film: BackwardMap) -> np.ndarray:
    """Clockwise from the top left."""
    return film.nodes[[0, 0, -1, -1], [0, -1, -1, 0]]


@pytest.mark.parametrize("order", list(permutations(range(4))))
def test_corners_in_any_order_are_those_of_one_plane_sheet(order):
    plane = film_at(SHEET[list(order)].tolist(), SIZE)
    np.testing.assert_allclose(corners_of(plane), SHEET, atol=1e-6)
    # a plane sheet shows its middle where its diagonals meet
    a, c, b, d = SHEET[0], SHEET[2], SHEET[1], SHEET[3]
    t = np.linalg.solve(np.stack([c - a, b - d], axis=1), b - a)[0]
    np.testing.assert_allclose(plane.photo_from_film(np.array([[0.5, 0.5]]))[0], a + t * (c - a), atol=1e-6)
    assert not plane.folds()


def test_the_top_is_the_side_nearest_to_the_photo_s():
    turned = np.array([[0.0, -1.0], [1.0, 0.0]])
    plane = film_at((SHEET - 450) @ turned.T + 450, SIZE)
    np.testing.assert_allclose(film_as_seen(plane).nodes, plane.nodes)


@pytest.mark.parametrize(
    "corners",
    [
        SHEET[:3],
        [[1.0, 2.0], [3.0], [3.0, 4.0], [5.0, 6.0]],
        np.where(SHEET == 790, np.nan, SHEET),
        np.array([[200, 100], [800, 100], [300, 200], [200, 700]]),  # one lies within the others
        np.array([[200, 100], [500, 101], [800, 102], [500, 700]]),  # three on a line
        np.array([[200, 100], [210, 100], [210, 110], [200, 110]]),  # too small
        SHEET + 2000,  # beyond the photo
    ],
)
def test_what_are_no_corners_is_refused(corners):
    with pytest.raises(ConfigError, match="Corners of the film"):
        film_at(corners, SIZE)


def test_a_map_put_on_corners_has_them_and_keeps_its_bend():
    told = film_at(SHEET, SIZE)
    uv = film_nodes((33, 33))
    bent = BackwardMap(told.nodes + 20 * np.sin(np.pi * uv[..., :1]) * np.array([0.0, 1.0]))
    off = BackwardMap(bent.nodes * 1.02 + np.array([9.0, -4.0]))
    put = put_on_corners(off, told)
    np.testing.assert_allclose(corners_of(put), SHEET, atol=1e-9)
    assert np.abs(put.nodes - bent.nodes).max() < 1.0
    np.testing.assert_allclose(put_on_corners(bent, told).nodes, bent.nodes, atol=1e-9)


# ---------------------------------------------------------------- the whole pipeline


def test_a_film_is_flattened_from_rough_corners(rectifier: Rectifier):
    it = photographed(film_print(19), Shot())
    rough = corners_of(it.truth) + np.array([[6, -5], [4, 6], [-6, 3], [5, 5]])
    result = rectifier(it.photo, rough)
    assert result.status.ok, result.status.doubts
    assert it.error_px(result.backward) < 1.0
    again = rectifier(it.photo, rough[[2, 0, 3, 1]])
    np.testing.assert_array_equal(again.backward.nodes, result.backward.nodes)


def test_corners_inside_a_border_as_dark_as_the_film_are_heard(rectifier: Rectifier):
    """Cells are as alike in the whole picture as in its inside: they cannot tell which of the two is the film."""
    image = cv2.resize(film_print(19).image, (900, 750), interpolation=cv2.INTER_AREA)
    grey = np.clip(np.rint(255 * (image - np.median(image))), 0, 255).astype(np.uint8)
    (h, w), border = grey.shape, 40
    photo = np.repeat(np.pad(grey, border)[..., None], 3, axis=2)
    told = border + np.array([[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]])
    result = rectifier(photo, told)
    outline = result.backward.turned(result.orientation.inverse)
    found = outline.photo_from_film(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))
    assert np.linalg.norm(found - told, axis=1).max() < 0.01 * np.hypot(h, w)
    whole = np.array([[1.0, 2.0], [w + 78.0, 1.0], [w + 79.0, h + 78.0], [2.0, h + 79.0]])
    (reason,) = (stage.reason for stage in rectifier(photo, whole).stages if stage.name == "flat")
    assert "not the photo's" not in reason


def test_a_negative_with_given_corners_is_doubtful(rectifier: Rectifier):
    it = photographed(film_print(19), Shot())
    result = rectifier(255 - it.photo, corners_of(it.truth))
    assert result.status.code is StatusCode.UNSURE
    assert any("of a negative, invert the picture" in doubt for doubt in result.status.doubts)


def test_one_of_two_films_is_chosen_by_its_corners(rectifier: Rectifier):
    """Of two films side by side, the one whose corners are given is flattened, whichever the network prefers."""
    small = Shot(fill=0.45, roll=(0.2, 0.2))
    left = photographed(film_print(19), replace(small, at=(0.26, 0.5)))
    both = photographed(film_print(23), replace(small, at=(0.75, 0.5), background=left.photo.astype(np.float64)))
    for it in (left, both):
        result = rectifier(both.photo, corners_of(it.truth) + 2)
        assert it.error_px(result.backward) < 3.0


def test_a_film_is_given_where_none_is_seen(rectifier: Rectifier):
    photo = np.rint(table()).astype(np.uint8)
    assert not rectifier(photo).status.has_film
    result = rectifier(photo, [[100.0, 100.0], [600.0, 120.0], [620.0, 600.0], [90.0, 580.0]])
    assert result.status.code is StatusCode.UNSURE
    assert result.status.doubts
    assert np.isfinite(result.film).all()


def test_given_corners_are_a_film_even_where_the_verdict_would_be_that_there_is_none(
    rectifier: Rectifier, monkeypatch: pytest.MonkeyPatch
):
    nothing = Verdict(StatusCode.NO_FILM, "nothing that makes a film is seen", ("nothing is seen",))
    monkeypatch.setattr("hybrid.pipeline.doubt.film_verdict", lambda *_: nothing)
    result = rectifier(
        np.rint(table()).astype(np.uint8), [[100.0, 100.0], [600.0, 120.0], [620.0, 600.0], [90.0, 580.0]]
    )
    assert result.status.code is StatusCode.UNSURE
    assert result.film is not None
