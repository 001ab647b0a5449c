"""Round corners: what the arcs cut off, in samples made with them and in samples that get them for training."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_gen.sample import SampleConfig, corners_of, film_samples
from hybrid.backward import BackwardMap, Orientation
from hybrid.coords import film_nodes
from hybrid.learn.datasets import rounded
from hybrid.learn.datasets.edges import EdgeAugment, EdgePlace, edge_view, true_rows
from hybrid.learn.datasets.film import AugmentConfig, training_view
from hybrid.learn.datasets.samples import film_of, open_places, round_corners_of, truth_at
from hybrid.round_corners import RoundCorners
from hybrid.strips import StripConfig

SIZE_MM = np.array([350.0, 430.0])
"""Width and height of a sheet."""
STRIP = StripConfig()


def of_radius(radius_mm: float) -> RoundCorners:
    return RoundCorners(*(radius_mm / SIZE_MM))


# ---------------------------------------------------------------- geometry


@pytest.mark.parametrize("radius", [3.0, 40.0, 175.0])
def test_what_is_cut_is_further_than_the_radius_from_the_arcs_middle(radius: float) -> None:
    uv = np.random.default_rng(0).uniform(0, 1, (4000, 2)) ** np.array([2.0, 1.0])
    inner = np.clip(uv * SIZE_MM, radius, SIZE_MM - radius)  # nearest point of the sheet shrunk by the radius
    far = np.linalg.norm(uv * SIZE_MM - inner, axis=1)
    np.testing.assert_array_equal(of_radius(radius).cut(uv), far > radius)


def test_nothing_is_cut_where_no_film_is_known() -> None:
    assert not of_radius(20.0).cut(np.full((3, 2), np.nan)).any()


def test_the_outline_parts_what_is_cut_from_what_is_left() -> None:
    corners = of_radius(30.0)
    outline = corners.outline()
    middle = np.array([0.5, 0.5])
    assert not corners.cut(middle + (outline - middle) * 0.999).any()
    beyond = middle + (outline - middle) * 1.001
    outside = (beyond < 0).any(axis=1) | (beyond > 1).any(axis=1)
    assert (corners.cut(beyond) | outside).all()
    steps = np.linalg.norm(np.diff(outline, axis=0, append=outline[:1]) * SIZE_MM, axis=1)
    assert steps.max() < 15
    left = cv2.contourArea((outline * SIZE_MM).astype(np.float32))
    assert left == pytest.approx(np.prod(SIZE_MM) - (4 - np.pi) * 30.0**2, rel=1e-3)


@pytest.mark.parametrize("index", range(8))
def test_a_turned_sheet_has_the_same_corners(index: int) -> None:
    corners, way = of_radius(60.0), Orientation.from_index(index)
    uv = np.random.default_rng(1).uniform(0, 1, (500, 2))
    seen = way.seen_from_film(uv)
    np.testing.assert_array_equal(corners.turned(way.turns).cut(seen), corners.cut(uv))


# ---------------------------------------------------------------- samples made with them


def test_a_share_of_sheets_is_round_and_nothing_else_depends_on_it() -> None:
    config = SampleConfig(size=200, map_size=100, photos_per_film=1)
    drawn = [corners_of((430.0, 350.0), [3, k], config) for k in range(300)]
    assert np.mean([one is not None for one in drawn]) == pytest.approx(config.round_share, abs=0.1)
    radii = np.array([(one.u * 350, one.v * 430) for one in drawn if one is not None])
    np.testing.assert_allclose(radii[:, 0], radii[:, 1])
    assert config.corner_mm[0] <= radii.min() < radii.max() <= config.corner_mm[1]

    big = (40.0, 41.0)
    (sharp,) = film_samples(3, 1, replace(config, round_share=0.0))
    (other,) = film_samples(3, 1, replace(config, round_share=1.0, corner_mm=big))
    corners = RoundCorners(*other.parameters["round_corners"])
    assert sharp.parameters["round_corners"] is None
    assert big[0] <= corners.u * other.size_mm[1] <= big[1]
    cut = corners.cut(sharp.maps.uv)
    assert cut.any()
    np.testing.assert_array_equal(other.maps.mask, sharp.maps.mask & ~cut)
    both = other.maps.mask
    np.testing.assert_allclose(other.maps.uv[both], sharp.maps.uv[both], atol=1e-4)
    np.testing.assert_array_equal(other.backward.nodes, sharp.backward.nodes)


# ---------------------------------------------------------------- samples that get them for training


def upright_film() -> tuple[np.ndarray, BackwardMap]:
    photo = cv2.GaussianBlur(np.random.default_rng(0).integers(90, 250, (300, 260, 3), dtype=np.uint8), (0, 0), 2)
    photo[50:250, 60:200] = 20
    return photo, BackwardMap(film_nodes((9, 9)) * np.array([140.0, 200.0]) + np.array([60.0, 50.0]))


def test_only_the_corners_of_a_photo_are_changed_and_they_show_ground() -> None:
    photo, film = upright_film()
    corners = RoundCorners(20 / 140, 20 / 200)
    put = rounded.with_round_corners(photo, film, corners, np.random.default_rng(0))
    y, x = np.mgrid[:300, :260] + 0.5
    uv = np.stack([(x - 60) / 140, (y - 50) / 200], axis=-1)
    deep = cv2.erode(corners.cut(uv).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    assert put[deep].mean() > 90
    near = cv2.dilate(corners.cut(uv).astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    np.testing.assert_array_equal(put[~near], photo[~near])


def test_some_get_them_and_those_that_have_them_keep_their_own() -> None:
    photo, film = upright_film()
    drawn = [rounded.round_some(photo, film, None, np.random.default_rng(seed)) for seed in range(100)]
    assert np.mean([corners is not None for _, corners in drawn]) == pytest.approx(rounded.SHARE, abs=0.15)
    assert all((corners is None) == (put is photo) for put, corners in drawn)
    radii = [(corners.u * 140, corners.v * 200) for _, corners in drawn if corners is not None]
    assert all(u == pytest.approx(v) for u, v in radii)
    assert 200 * rounded.RADIUS[0] <= min(radii)[0] < max(radii)[0] <= 200 * rounded.RADIUS[1]
    own = RoundCorners(0.1, 0.1)
    assert rounded.round_some(photo, film, own, np.random.default_rng(0)) == (photo, own)


def test_what_is_cut_off_is_no_film_in_the_truth(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place, corners = open_places([dataset])[0], RoundCorners(0.3, 0.3)
    alone = AugmentConfig(empty_share=0.0)
    monkeypatch.setattr(rounded, "round_some", lambda photo, film, own, rng: (photo, None))
    before = training_view(place, 64, np.random.default_rng(3), alone)
    monkeypatch.setattr(rounded, "round_some", lambda photo, film, own, rng: (photo, corners))
    after = training_view(place, 64, np.random.default_rng(3), alone)
    cut = before.mask & corners.cut(before.uv)
    assert cut.any()
    np.testing.assert_array_equal(after.mask, before.mask & ~cut)
    assert not np.concatenate([after.uv[cut], after.xyz[cut], after.albedo[cut][:, None]], axis=1).any()


def test_where_a_corner_is_round_its_edge_is_not_shown() -> None:
    _, film = upright_film()
    mask = np.ones((80, 80), bool)
    rows = true_rows(film, film, (300, 260), mask, STRIP, RoundCorners(0.3, 0.1))
    columns = (np.arange(rows.shape[1]) + 0.5) / rows.shape[1]
    for side, radius in zip(rows, (0.3, 0.3, 0.1, 0.1), strict=True):  # top and bottom, then left and right
        shown = ~np.isnan(side)
        off = np.minimum(columns, 1 - columns) - radius
        assert shown[off > 0.02].all()
        assert not shown[off < -0.02].any()


def test_the_corners_of_a_stored_sample_are_not_covered_and_turn_with_it(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = open_places([dataset])[1]
    shard, k = place
    assert round_corners_of(place) is None
    record = shard.record(k) | {"round_corners": [0.3, 0.2]}
    monkeypatch.setattr(type(shard), "record", lambda self, index: record)
    assert round_corners_of(place) == RoundCorners(0.3, 0.2)
    points = film_nodes((48, 48)) * 47.0 + 0.5
    covered = truth_at(place, points, (48, 48)).covered
    cut = RoundCorners(0.32, 0.22).cut(points / 48)  # the photo shows nothing but the film
    assert not covered[RoundCorners(0.27, 0.18).cut(points / 48)].any()
    assert covered[~cut].any()

    seen = []
    monkeypatch.setattr("hybrid.learn.datasets.edges.true_rows", lambda *args: seen.append(args) or np.zeros((4, 2)))
    for seed in range(12):
        edge_view(EdgePlace(place, None), STRIP, np.random.default_rng(seed), EdgeAugment())
    rows = film_of(place).nodes[[0, -1]]
    for true, *_, corners in seen:
        along_rows = any(np.allclose(true.nodes[0], row) or np.allclose(true.nodes[0], row[::-1]) for row in rows)
        assert corners == (RoundCorners(0.3, 0.2) if along_rows else RoundCorners(0.2, 0.3))
    assert len({corners for *_, corners in seen}) == 2
