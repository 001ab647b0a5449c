"""Records between the stages: they check what they hold, and a result can be read by a person."""

from __future__ import annotations

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import hybrid
from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.records import RectifyResult, SliceGrid, StageReport, Status, StatusCode


def grid_of(rows: int, cols: int, confidence: float = 0.9) -> SliceGrid:
    vertices = film_nodes((rows + 1, cols + 1))
    return SliceGrid(rows, cols, vertices, 100 * vertices, confidence)


def test_only_ok_is_ok_and_every_other_status_says_what_to_do() -> None:
    assert [code for code in StatusCode if Status(code).ok] == [StatusCode.OK]
    for code in StatusCode:
        sentence = str(Status(code))
        assert sentence.endswith(".")
        assert code is StatusCode.OK or sentence.count(".") >= 2, "a failure says what happened and what to do next"


def test_a_film_is_given_when_sure_and_when_not() -> None:
    assert [code for code in StatusCode if Status(code).has_film] == [StatusCode.OK, StatusCode.UNSURE]


def test_stage_report_reads_as_one_line() -> None:
    line = str(StageReport("grid", False, "no printed lines found", 0.0123))
    assert line.split() == ["grid", "skipped", "12.3", "ms", "no", "printed", "lines", "found"]


def test_records_are_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        grid_of(2, 2).rows = 3  # pyright: ignore[reportAttributeAccessIssue]
    backward = BackwardMap(film_nodes((4, 4)))
    for each in (backward, pickle.loads(pickle.dumps(backward)), copy.deepcopy(backward)):
        assert np.array_equal(each.nodes, backward.nodes)
        with pytest.raises(ValueError, match="read-only"):
            each.nodes[0, 0] = 1.0


def test_grid_refuses_vertices_that_do_not_fit() -> None:
    vertices = film_nodes((4, 4))
    with pytest.raises(ValueError, match=r"SliceGrid\.vertices: got shape \(4, 4, 2\); allowed: \(3, 4, 2\)"):
        SliceGrid(2, 3, vertices, vertices, 0.5)
    with pytest.raises(ValueError, match=r"confidence: got 1\.5"):
        grid_of(3, 3, confidence=1.5)


def test_slices_tile_the_film() -> None:
    film = np.random.default_rng(0).random((60, 80)).astype(np.float32)
    cells = RectifyResult(Status(StatusCode.OK), film=film, grid=grid_of(3, 4)).slices()
    assert len(cells) == 12
    rows = [np.concatenate(cells[4 * i : 4 * i + 4], axis=1) for i in range(3)]
    assert np.array_equal(np.concatenate(rows, axis=0), film)


def test_no_slices_without_a_grid_or_a_film() -> None:
    assert RectifyResult(Status(StatusCode.NO_FILM)).slices() == []
    assert RectifyResult(Status(StatusCode.OK), film=np.zeros((8, 8), np.float32)).slices() == []


def test_backward_map_refuses_what_is_no_map() -> None:
    with pytest.raises(ValueError, match=r"got shape \(3, 4, 2\); allowed"):
        BackwardMap(np.zeros((3, 4, 2)))
    with pytest.raises(ValueError, match="NaN or infinity"):
        BackwardMap(np.full((4, 4, 2), np.nan))


def test_points_that_are_none_lie_nowhere_on_the_film():
    film = BackwardMap(film_nodes((5, 5)) * 100.0)
    found = film.film_from_photo(np.array([[50.0, 25.0], [np.inf, 3.0], [np.nan, 1.0], [500.0, 20.0]]))
    assert found[0] == pytest.approx([0.5, 0.25], abs=1e-5)
    assert np.isnan(found[1:]).all()


def test_unknown_public_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'Dewarper'; it has .*Rectifier"):
        _ = hybrid.Dewarper  # pyright: ignore[reportAttributeAccessIssue]


def test_a_slice_s_corners_are_the_nearest_pixels() -> None:
    uv = np.array([[[0.0, 0.0], [0.496, 0.0], [1.0, 0.0]], [[0.0, 1.0], [0.496, 1.0], [1.0, 1.0]]])
    film = np.zeros((10, 100), np.float32)
    halves = RectifyResult(Status(StatusCode.OK), film=film, grid=SliceGrid(1, 2, uv, uv, 1.0)).slices()
    assert [half.shape for half in halves] == [(10, 50), (10, 50)]


def test_a_map_folds_where_its_sense_changes_not_where_it_is_seen_from_behind() -> None:
    plain = BackwardMap.from_function(lambda uv: uv * [200.0, 100.0])
    assert not plain.folds()
    assert not BackwardMap(plain.nodes[:, ::-1]).folds()
    assert BackwardMap.from_function(lambda uv: np.stack([(uv[..., 0] - 0.43) ** 2, uv[..., 1]], axis=-1)).folds()


def test_height_comes_before_width() -> None:
    film = BackwardMap.from_function(lambda uv: uv * [200.0, 100.0])
    assert film.mean_film_pixels() == pytest.approx((100.0, 200.0))


def test_a_point_beside_the_film_is_not_on_it_and_a_step_is_no_longer_than_it_may_be() -> None:
    film = BackwardMap.from_function(lambda uv: uv * [200.0, 100.0])
    assert np.isnan(film.film_from_photo(np.array([[200.5, 50.0]]))).all()
    start = np.array([[0.1, 0.1]])
    near = film.film_near(np.array([[200.0, 10.0]]), start, iterations=1, most_step=0.2)
    np.testing.assert_allclose(near, [[0.3, 0.1]], atol=1e-9)
