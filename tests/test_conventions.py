"""Proofs of docs/conventions.md: one test for each statement that code can prove, named by its number there."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid import coords
from hybrid.backward import BackwardMap, spline_weights

ROOT = Path(__file__).parents[1]

FLOAT32_PX = 2e-4  # float32 spacing at 1000 px is 6e-5, and a bilinear weight is made from a few such numbers
FLOAT64_PX = 1e-9  # float64 spacing at 1000 px is 1e-13; splines add up a few dozen terms
SRGB_LEVEL = 1 / 255

sizes = st.tuples(st.integers(5, 60), st.integers(5, 60))


def ramp(size: tuple[int, int]) -> np.ndarray:
    """(h, w, 3) float32 holding each pixel's photo point (x, y, 0): sampled at a point, it gives the point back."""
    xy = coords.pixel_centres(size)
    return np.concatenate([xy, np.zeros((*size, 1))], axis=2).astype(np.float32)


def points_inside(size: tuple[int, int], n: int = 200) -> np.ndarray:
    """(n, 2) float32 photo points at least one pixel away from the border."""
    h, w = size
    rng = np.random.default_rng(3)
    return rng.uniform([1, 1], [w - 1, h - 1], size=(n, 2)).astype(np.float32)


# ---------------------------------------------------------------- 1, 2: layout, photo frame


@given(size=sizes)
def test_convention_1_and_2_first_pixel_and_order(size: tuple[int, int]) -> None:
    centres = coords.pixel_centres(size)
    assert centres.shape == (*size, 2)  # sizes are (height, width), indices [row, col], points (x, y)
    assert tuple(centres[0, 0]) == (0.5, 0.5)
    assert tuple(centres[-1, -1]) == (size[1] - 0.5, size[0] - 0.5)


@given(size=sizes, factor=st.integers(2, 5))
def test_convention_2_scaling_an_image_scales_its_points(size: tuple[int, int], factor: int) -> None:
    large = (size[0] * factor, size[1] * factor)
    # The centre of a pixel is the mean of the centres of the small pixels that it is divided into.
    divided = coords.pixel_centres(large).reshape(size[0], factor, size[1], factor, 2).mean(axis=(1, 3))
    assert np.allclose(coords.rescale_points(coords.pixel_centres(size), size, large), divided, atol=FLOAT64_PX)


def test_convention_2_area_resize_agrees_with_rescaled_points() -> None:
    small = cv2.resize(ramp((40, 60)), (15, 10), interpolation=cv2.INTER_AREA)[..., :2]
    back = coords.rescale_points(coords.pixel_centres((10, 15)), (10, 15), (40, 60))
    assert np.abs(small - back).max() < FLOAT32_PX


def test_convention_2_cropping_is_a_subtraction() -> None:
    image = ramp((30, 40))
    crop = image[7:, 4:]
    assert np.allclose(crop[..., :2] - np.array([4, 7]), coords.pixel_centres(crop.shape[:2]), atol=FLOAT32_PX)


def test_convention_2_open3d_sends_the_first_ray_through_the_first_pixels_centre() -> None:
    o3d = pytest.importorskip("open3d", reason="open3d, of the extra 'data', is not installed", exc_type=ImportError)
    intrinsic = np.array([[100.0, 0, 32], [0, 100.0, 24], [0, 0, 1]])
    rays = o3d.t.geometry.RaycastingScene.create_rays_pinhole(intrinsic, np.eye(4), 64, 48).numpy()
    assert np.allclose(rays[..., 5], 1.0)  # directions have z = 1, so t_hit is the depth along the axis
    projected = rays[..., 3:5] * 100 + [32, 24]
    assert np.abs(projected - coords.pixel_centres((48, 64))).max() < FLOAT32_PX


# ---------------------------------------------------------------- 3: bridges


def test_convention_3_remap_bridge() -> None:
    xy = points_inside((30, 50))
    maps = coords.opencv_from_photo(xy)[None]
    sampled = cv2.remap(ramp((30, 50)), maps[..., 0], maps[..., 1], cv2.INTER_LINEAR)[0]
    assert np.abs(sampled[:, :2] - xy).max() < FLOAT32_PX


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_convention_3_remap_is_exact_where_the_project_uses_it(dtype: type, channels: int) -> None:
    values = np.array([0, 200], dtype=dtype)
    image = np.repeat(np.tile(values, (4, 1))[:, :, None], channels, axis=2)
    x = np.linspace(0, 1, 101, dtype=np.float32)[None]
    sampled = cv2.remap(image, x, np.ones_like(x), cv2.INTER_LINEAR).reshape(101, channels)
    assert np.abs(sampled - 200.0 * x.T).max() <= (0.5 if dtype != np.float32 else FLOAT32_PX) + FLOAT32_PX


def test_convention_3_remap_snaps_maps_of_two_channels_to_a_32nd() -> None:
    xy = points_inside((30, 50))
    maps = coords.opencv_from_photo(xy)[None]
    image = np.ascontiguousarray(ramp((30, 50))[..., :2])
    error = np.abs(cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR)[0] - xy).max()
    assert 1 / 128 < error <= 1 / 64 + FLOAT32_PX  # why uv and backward maps never go through remap


@given(size=sizes)
@settings(deadline=None)
def test_convention_3_grid_sample_bridge(size: tuple[int, int]) -> None:
    xy = points_inside(size)
    image = torch.from_numpy(ramp(size).transpose(2, 0, 1)[None].copy())
    sampled = coords.sample_photo(image, torch.from_numpy(xy)[None, None])[0, :2, 0].T.numpy()
    assert np.abs(sampled - xy).max() < FLOAT32_PX


@given(size=sizes)
def test_convention_3_opencv_round_trip(size: tuple[int, int]) -> None:
    xy = points_inside(size).astype(np.float64)
    assert np.allclose(coords.photo_from_opencv(coords.opencv_from_photo(xy)), xy, atol=FLOAT64_PX)
    assert coords.opencv_from_photo(np.array([[10, 20]])).tolist() == [[9.5, 19.5]]
    first = coords.opencv_from_photo(coords.pixel_centres(size)[0, 0])
    assert tuple(first) == (0.0, 0.0)


# ---------------------------------------------------------------- 4: film frame


@given(size=sizes)
def test_convention_4_film_pixels_and_corners(size: tuple[int, int]) -> None:
    h, w = size
    uv = coords.film_centres(size)
    assert np.allclose(uv[0, 0], [0.5 / w, 0.5 / h])
    assert np.allclose(uv[-1, -1], [1 - 0.5 / w, 1 - 0.5 / h])
    assert np.all(np.diff(uv[..., 0], axis=1) > 0)  # u right
    assert np.all(np.diff(uv[..., 1], axis=0) > 0)  # v down
    assert np.allclose(coords.film_from_pixel(coords.pixel_centres(size), size), uv)
    assert np.allclose(coords.pixel_from_film(uv, size), coords.pixel_centres(size), atol=FLOAT64_PX)


@given(size=sizes)
def test_convention_4_zero_and_one_are_the_physical_edges(size: tuple[int, int]) -> None:
    corners = np.array([[0.0, 0.0], [1.0, 1.0]])
    assert np.allclose(coords.pixel_from_film(corners, size), [[0, 0], [size[1], size[0]]])


# ---------------------------------------------------------------- 5: nodes


def test_convention_5_nodes_lie_on_the_edges() -> None:
    nodes = coords.film_nodes((5, 9))
    assert tuple(nodes[0, 0]) == (0.0, 0.0)
    assert tuple(nodes[-1, -1]) == (1.0, 1.0)
    assert np.allclose(nodes[2, 3], [3 / 8, 2 / 4])


def cubic_film(uv: np.ndarray) -> np.ndarray:
    u, v = uv[..., 0], uv[..., 1]
    return np.stack([900 * u + 80 * u * v**2 - 30 * u**3, 700 * v + 50 * u**2 - 40 * v**3], axis=-1)


@given(size=sizes)
@settings(deadline=None, max_examples=20)
def test_convention_5_dense_map_is_exact_for_what_a_cubic_spline_holds(size: tuple[int, int]) -> None:
    backward = BackwardMap.from_function(cubic_film, (6, 8))
    expected = cubic_film(coords.film_centres(size))
    assert np.abs(backward.photo_from_film(coords.film_centres(size)) - expected).max() < FLOAT64_PX
    assert np.abs(backward.dense(size) - expected).max() < 3 * FLOAT32_PX  # stored in float32


def test_convention_5_upsampling_is_separable() -> None:
    backward = BackwardMap.from_function(cubic_film, (6, 8))
    wv = spline_weights(6, coords.film_centres_1d(31))
    wu = spline_weights(8, coords.film_centres_1d(23))
    dense = np.einsum("ia,abk,jb->ijk", wv, backward.nodes, wu)
    assert np.abs(dense - backward.photo_from_film(coords.film_centres((31, 23)))).max() < FLOAT64_PX


def test_convention_5_image_resize_is_wrong_at_the_rim() -> None:
    backward = BackwardMap.from_function(cubic_film, (17, 17))
    resized = cv2.resize(backward.nodes.astype(np.float32), (256, 256), interpolation=cv2.INTER_LINEAR)
    assert np.abs(resized - backward.dense((256, 256))).max() > 5  # px: why nodes are not treated as pixels


# ---------------------------------------------------------------- 7, 8: Open3D's barycentrics and misses


def test_convention_7_and_8_barycentric_order_and_misses() -> None:
    o3d = pytest.importorskip("open3d", reason="open3d, of the extra 'data', is not installed", exc_type=ImportError)
    vertices = np.array([[0, 0, 5], [4, 0, 6], [0, 3, 7]], dtype=np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(np.array([[0, 1, 2]], dtype=np.uint32)))
    rays = np.array([[0.8, 0.9, 0, 0, 0, 1], [9, 9, 0, 0, 0, 1]], dtype=np.float32)
    answer = {key: value.numpy() for key, value in scene.cast_rays(o3d.core.Tensor(rays)).items()}
    a, b = answer["primitive_uvs"][0]
    hit = (1 - a - b) * vertices[0] + a * vertices[1] + b * vertices[2]
    assert np.allclose(hit[:2], rays[0, :2], atol=1e-5)
    assert hit[2] == pytest.approx(answer["t_hit"][0], abs=1e-5)
    assert np.isinf(answer["t_hit"][1])
    assert answer["primitive_ids"][1] == 2**32 - 1


# ---------------------------------------------------------------- 9: colour


def test_convention_9_srgb_round_trip_and_known_values() -> None:
    levels = np.arange(256) / 255
    assert np.abs(coords.srgb_from_linear(coords.linear_from_srgb(levels)) - levels).max() < 1e-6
    assert coords.linear_from_srgb(np.array(188 / 255)) == pytest.approx(0.5, abs=SRGB_LEVEL)  # half the light
    assert np.all(np.diff(coords.linear_from_srgb(levels)) > 0)


def test_convention_9_bgr_swaps_and_swaps_back() -> None:
    image = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    assert np.array_equal(coords.rgb_from_bgr(image), cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    assert np.array_equal(coords.rgb_from_bgr(coords.rgb_from_bgr(image)), image)


# ---------------------------------------------------------------- "anywhere else"

FORBIDDEN = {
    "a half pixel": re.compile(
        r"(arange\([^)]*\)|\b(cols?|rows?|xy?|xs|ys?))\)? ?[+-] ?0\.5\b(?!\) \* \w+\.pitch)|\+ ?0\.5\) ?/"
    ),
    "a channel flip": re.compile(r"\[\.\.\., ?::-1\]"),
    "align_corners": re.compile(r"align_corners"),
}


@pytest.mark.parametrize("what", FORBIDDEN)
def test_conversions_stand_in_coords_only(what: str) -> None:
    found = []
    for path in sorted(p for room in ("hybrid", "data_gen", "benchmarks") for p in (ROOT / room).rglob("*.py")):
        if path == ROOT / "hybrid" / "coords.py":
            continue
        for number, line in enumerate(path.read_text().splitlines(), start=1):
            if FORBIDDEN[what].search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert not found, f"{what} belongs into hybrid/coords.py:\n" + "\n".join(found)


def test_convention_bilinear_lookup_is_in_the_photo_frame_and_exact():
    """A linear function is sampled exactly between the outermost pixel centres, and takes its rim's values beyond."""
    rng = np.random.default_rng(0)
    centres = coords.pixel_centres((40, 50))
    image = np.stack([centres[..., 0], centres[..., 1], centres.sum(axis=-1)], axis=-1).astype(np.float32)
    xy = rng.uniform([0.5, 0.5], [49.5, 39.5], (30, 20, 2))
    expected = np.concatenate([xy, xy.sum(axis=-1, keepdims=True)], axis=-1)
    np.testing.assert_allclose(coords.sample_bilinear(image, xy), expected, atol=1e-4)
    mixed = np.where(rng.random((30, 20, 1)) < 0.5, xy, 0.0)
    np.testing.assert_allclose(coords.sample_bilinear(image, mixed)[..., :2], np.maximum(mixed, 0.5), atol=1e-4)


def test_pixels_inside_an_outline_are_those_whose_centres_are():
    rng = np.random.default_rng(1)
    square = np.array([[2.0, 3.0], [8.0, 3.0], [8.0, 9.0], [2.0, 9.0]])
    assert coords.inside_outline(square, (20, 24)).sum() == 36
    for _ in range(50):
        turn, size = rng.uniform(0, np.pi), rng.uniform(10, 24)
        ways = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        middle = rng.uniform(18, 30, 2)
        outline = middle + (np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * size / 2) @ ways
        off = np.abs((coords.pixel_centres((48, 48)) - middle) @ ways.T).max(axis=-1) - size / 2
        drawn = coords.inside_outline(outline, (48, 48))
        assert drawn[off < -0.12].all()
        assert not drawn[off > 0.12].any()
