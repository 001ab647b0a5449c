"""Metrics: a perfect prediction scores perfect, inputs are not modified, known cases follow the definitions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from hybrid.backward import BackwardMap, end_point_error
from hybrid.coords import film_nodes, pixel_centres
from hybrid.metrics import (
    DISTORTION_AREA_PX,
    MS_SSIM_WEIGHTS,
    PSNR_CAP_DB,
    _sampled,
    image_scores,
    local_distortion,
    ms_ssim,
    paper_protocol,
    psnr,
    psnr_after_gain_offset,
    ssim,
)

STORED_SSIM, STORED_MS_SSIM = 0.837399, 0.771388
"""Scores of two pictures in closed form; see the end of this file."""

FLOAT32_SCORE = 2e-5  # the implementation to compare with computes its window in float32, for values up to 255^2


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.fixture
def picture(rng: np.random.Generator) -> np.ndarray:
    """(256, 256, 3) float64 in 0..255 with detail at many scales."""
    total = np.zeros((256, 256, 3))
    for size in (4, 8, 16, 32, 64, 128, 256):
        total += np.kron(rng.normal(size=(size, size, 3)), np.ones((256 // size, 256 // size, 1))) / size**0.3
    return 255 * (total - total.min()) / np.ptp(total)


def curved_map(scale: float = 1.0, shift: tuple[float, float] = (0.0, 0.0)) -> BackwardMap:
    """A smooth bent film in a 540 x 540 photo, or in one scaled by ``scale``, shifted by (x, y) pixels."""

    def photo_from_film(uv: np.ndarray) -> np.ndarray:
        u, v = uv[:, 0], uv[:, 1]
        x = 60 + 420 * u + 15 * np.sin(3 * v) + shift[0]
        y = 80 + 380 * v + 20 * u * (1 - u) * 4 + shift[1]
        return scale * np.stack([x, y], axis=-1)

    return BackwardMap.from_function(photo_from_film)


@pytest.fixture
def photo(rng: np.random.Generator) -> np.ndarray:
    coarse = rng.integers(0, 255, (60, 60, 3), dtype=np.uint8)
    return np.kron(coarse, np.ones((9, 9, 1), dtype=np.uint8))


# ---------------------------------------------------------------- images


@pytest.mark.parametrize(("metric", "perfect"), [(psnr, PSNR_CAP_DB), (ssim, 1.0), (ms_ssim, 1.0)])
def test_equal_images_score_perfect_however_often(metric: Callable, perfect: float, picture: np.ndarray) -> None:
    before = picture.copy()
    for _ in range(3):  # the published evaluation mirrored its input on every second call
        assert metric(picture, picture.copy()) == pytest.approx(perfect, abs=1e-12)
    assert np.array_equal(picture, before)


@pytest.mark.parametrize("metric", [psnr, ssim, ms_ssim])
def test_symmetric_and_falling_with_noise(metric: Callable, picture: np.ndarray, rng: np.random.Generator) -> None:
    noise = rng.normal(size=picture.shape)
    noisy = [picture + sigma * noise for sigma in (2.0, 8.0, 32.0)]
    scores = [metric(picture, image) for image in noisy]
    assert scores[0] > scores[1] > scores[2]
    assert metric(noisy[1], picture) == pytest.approx(scores[1], rel=1e-12)


def test_psnr_of_a_known_offset() -> None:
    a = np.full((8, 8, 3), 100.0)
    assert psnr(a, a + 25.5) == pytest.approx(20.0, abs=1e-9)


def test_ssim_of_two_constant_images_is_the_luminance_term() -> None:
    a, b = 90.0, 120.0
    c1 = (0.01 * 255) ** 2
    expected = (2 * a * b + c1) / (a * a + b * b + c1)
    assert ssim(np.full((32, 32, 1), a), np.full((32, 32, 1), b)) == pytest.approx(expected, abs=1e-9)


def torch_ms_ssim(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """(SSIM, MS-SSIM) written out again with convolutions and pooling, after pytorch_msssim's definition."""
    window = torch.exp(-((torch.arange(11.0) - 5) ** 2) / (2 * 1.5**2))
    window = (window / window.sum()).double()
    channels = a.shape[2]
    kernel = (window[:, None] * window[None, :]).expand(channels, 1, 11, 11)

    def blur(image: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(image, kernel, groups=channels)

    x, y = (torch.from_numpy(image.transpose(2, 0, 1)[None].copy()).double() for image in (a, b))
    single, terms = 0.0, []
    for level in range(5):
        mx, my = blur(x), blur(y)
        sx, sy, sxy = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
        cs = (2 * sxy + 58.5225) / (sx + sy + 58.5225)
        full = cs * (2 * mx * my + 6.5025) / (mx * mx + my * my + 6.5025)
        single = float(full.mean()) if level == 0 else single
        terms.append((full if level == 4 else cs).flatten(2).mean(-1).relu())
        pad = [s % 2 for s in x.shape[2:]]
        x, y = (torch.nn.functional.avg_pool2d(t, kernel_size=2, padding=pad) for t in (x, y))
    weights = torch.tensor(MS_SSIM_WEIGHTS).double().view(-1, 1, 1)
    return single, float(torch.prod(torch.stack(terms) ** weights, dim=0).mean())


@pytest.mark.parametrize("size", [(256, 256), (211, 190)])
def test_agrees_with_an_independent_implementation(
    picture: np.ndarray, rng: np.random.Generator, size: tuple[int, int]
) -> None:
    a = picture[: size[0], : size[1]]
    b = 0.8 * np.roll(a, 2, axis=1) + 10 + rng.normal(scale=6, size=a.shape)
    expected_ssim, expected_ms_ssim = torch_ms_ssim(a, b)
    assert ssim(a, b) == pytest.approx(expected_ssim, abs=FLOAT32_SCORE)
    assert ms_ssim(a, b) == pytest.approx(expected_ms_ssim, abs=FLOAT32_SCORE)


def test_images_smaller_than_the_window_are_refused() -> None:
    with pytest.raises(ValueError, match=r"ms_ssim.*at least 161"):
        ms_ssim(np.zeros((160, 300, 3)), np.zeros((160, 300, 3)))
    with pytest.raises(ValueError, match=r"ssim.*at least 11"):
        ssim(np.zeros((10, 300, 3)), np.zeros((10, 300, 3)))


# ---------------------------------------------------------------- the paper's protocol


def test_the_true_map_scores_perfect_in_everything(photo: np.ndarray) -> None:
    before = photo.copy()
    scores = paper_protocol(photo, curved_map(), curved_map())
    for part in (scores.raw, scores.deshifted):
        assert (part.psnr, part.ssim, part.ms_ssim) == pytest.approx((PSNR_CAP_DB, 1.0, 1.0), abs=1e-9)
    assert scores.shift_px == (0.0, 0.0)
    assert np.array_equal(photo, before)


def test_deshift_takes_a_pure_shift_away_and_nothing_else(photo: np.ndarray) -> None:
    scores = paper_protocol(photo, curved_map(shift=(6.0, -3.0)), curved_map())
    assert scores.shift_px == pytest.approx((6.0 * 256 / 540, -3.0 * 256 / 540), abs=1e-4)  # float32 maps
    assert scores.deshifted.psnr > 60  # limited by float32 coordinates
    assert scores.raw.psnr < 30
    bent = curved_map()
    wrong = BackwardMap(bent.nodes + 5 * np.sin(12 * film_nodes((33, 33))))
    assert paper_protocol(photo, wrong, bent).deshifted.psnr < 35


def test_a_mirrored_map_is_not_forgiven(photo: np.ndarray) -> None:
    true = curved_map()
    mirrored = BackwardMap(np.fliplr(true.nodes))
    assert paper_protocol(photo, mirrored, true).raw.psnr < 15


def test_scores_do_not_depend_on_the_photos_resolution(photo: np.ndarray) -> None:
    large = np.kron(photo, np.ones((2, 2, 1), dtype=np.uint8))
    small_scores = paper_protocol(photo, curved_map(shift=(4, 2)), curved_map())
    large_scores = paper_protocol(large, curved_map(scale=2, shift=(4, 2)), curved_map(scale=2))
    assert large_scores.raw.psnr == pytest.approx(small_scores.raw.psnr, abs=0.1)  # area scaling rounds to uint8


def test_image_scores_holds_the_three(picture: np.ndarray) -> None:
    noisy = picture + 3
    scores = image_scores(picture, noisy)
    assert (scores.psnr, scores.ssim, scores.ms_ssim) == (
        psnr(picture, noisy),
        ssim(picture, noisy),
        ms_ssim(picture, noisy),
    )


# ---------------------------------------------------------------- geometry, film against print


def test_gain_and_offset_are_free(rng: np.random.Generator) -> None:
    truth = rng.random((64, 64))
    assert psnr_after_gain_offset(0.2 + 0.3 * truth, truth) > 90
    assert psnr_after_gain_offset(truth**2, truth) < 35
    assert psnr_after_gain_offset(1 - truth, truth) == psnr_after_gain_offset(np.full(truth.shape, 0.5), truth)
    assert psnr_after_gain_offset(np.full((64, 64), 0.4), truth) == pytest.approx(
        -10 * np.log10(truth.var()), abs=1e-9
    )  # nothing is left of the film but its mean


# ---------------------------------------------------------------- in any order, against stored values


def waves(shift: float) -> np.ndarray:
    """(192, 208, 3) in 0..255, in closed form."""
    y, x = np.mgrid[:192, :208].astype(np.float64)
    planes = [
        np.sin((k + 2) * 0.021 * (x + shift)) * np.cos((k + 1) * 0.047 * y) + 0.3 * np.sin(0.9 * x) for k in range(3)
    ]
    return 127.5 + 90 * np.stack(planes, axis=-1)


def test_ms_ssim_of_stated_images_is_the_stored_value() -> None:
    """Stored: what the written-out definition above gives, so that neither can drift unnoticed."""
    a, b = waves(0.0), 0.6 * waves(9.0) + 30
    expected_ssim, expected = torch_ms_ssim(a, b)
    assert (ssim(a, b), ms_ssim(a, b)) == pytest.approx((STORED_SSIM, STORED_MS_SSIM), abs=1e-6)
    assert (expected_ssim, expected) == pytest.approx((STORED_SSIM, STORED_MS_SSIM), abs=FLOAT32_SCORE)


def test_a_perfect_prediction_is_perfect_in_every_metric_in_any_order(photo: np.ndarray, picture: np.ndarray) -> None:
    true, film = curved_map(), picture[..., 0] / 255
    perfect = {
        "psnr": (lambda: psnr(picture, picture), PSNR_CAP_DB),
        "ssim": (lambda: ssim(picture, picture), 1.0),
        "ms_ssim": (lambda: ms_ssim(picture, picture), 1.0),
        "raw": (lambda: paper_protocol(photo, true, true).raw.psnr, PSNR_CAP_DB),
        "deshifted": (lambda: paper_protocol(photo, true, true).deshifted.ms_ssim, 1.0),
        "end point": (lambda: end_point_error(true, true.photo_from_film(film_nodes((9, 9)))).max(), 0.0),
        "distortion": (lambda: local_distortion(true, true), 0.0),
        "print": (lambda: psnr_after_gain_offset(film, film), PSNR_CAP_DB),
    }
    kept = photo.copy(), picture.copy(), film.copy(), true.nodes.copy()
    for order in (list(perfect), list(reversed(perfect)), sorted(perfect), 2 * sorted(perfect)[1::2]):
        for name in order:
            metric, expected = perfect[name]
            assert metric() == pytest.approx(expected, abs=1e-6), name
    for array, before in zip((photo, picture, film, true.nodes), kept, strict=True):
        np.testing.assert_array_equal(array, before)


def test_local_distortion_is_the_distance_on_the_flat_film() -> None:
    square = BackwardMap.from_function(lambda uv: 100 + 400 * uv)
    moved = BackwardMap(square.nodes + np.array([3.0, 4.0]))  # reads beyond the sheet along two edges
    side = DISTORTION_AREA_PX**0.5
    assert local_distortion(moved, square) == pytest.approx(5 * side / 400, rel=1e-6)
    tall = BackwardMap.from_function(lambda uv: 100 + uv * np.array([300.0, 600.0]))
    wider = BackwardMap(tall.nodes + np.array([3.0, 0.0]))
    assert local_distortion(wider, tall) == pytest.approx(3 * (DISTORTION_AREA_PX / 2) ** 0.5 / 300, rel=1e-6)
    turned = BackwardMap(np.rot90(square.nodes).copy())
    assert local_distortion(turned, square) > 0.3 * side


def test_the_protocol_reads_pixels_at_their_centres_and_nothing_outside() -> None:
    photo = np.random.default_rng(0).integers(1, 255, (256, 256, 3)).astype(np.float32)
    np.testing.assert_allclose(_sampled(photo, pixel_centres((256, 256))), photo, atol=1e-3)
    beyond = _sampled(photo, pixel_centres((256, 256)) + np.array([10.0, 0.0]))
    assert not beyond[:, -9:].any()
    np.testing.assert_allclose(beyond[:, :246], photo[:, 10:], atol=1e-3)
