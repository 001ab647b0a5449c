"""How right a result is: end-point error, the paper's protocol, PSNR, SSIM and MS-SSIM. Inputs are never modified."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, opencv_from_photo, rescale_points

PAPER_SIZE = (256, 256)
"""Height and width at which the paper compares everything."""

PSNR_CAP_DB = 100.0
"""The PSNR of equal images, so that means over images stay finite (the paper's evaluation does the same)."""

DATA_RANGE = 255.0
MS_SSIM_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Exponents of the five scales, finest first (Wang, Simoncelli and Bovik 2003, section 3.2)."""

WINDOW = 11
WINDOW_SIGMA = 1.5
MIN_MS_SSIM_SIDE = (WINDOW - 1) * 2 ** (len(MS_SSIM_WEIGHTS) - 1) + 1
"""Smallest side for MS-SSIM: the window still fits into the coarsest scale."""

Image = Float[np.ndarray, "h w c"]


# ---------------------------------------------------------------- images against images


def psnr(a: Image, b: Image) -> float:
    """Peak signal-to-noise ratio in dB over all pixels and channels, values in 0..255; 100 for equal images."""
    error = float(np.mean(np.square(_as_float64(a, b) - np.asarray(b, dtype=np.float64))))
    if error == 0.0:
        return PSNR_CAP_DB
    return min(PSNR_CAP_DB, float(10 * np.log10(DATA_RANGE**2 / error)))


def ssim(a: Image, b: Image) -> float:
    """Structural similarity (Wang et al. 2004), values in 0..255: mean over windows that lie inside, then channels.

    Gaussian window 11 x 11 of sigma 1.5, K1 = 0.01, K2 = 0.03, no padding: what pytorch_msssim computes.
    """
    if min(a.shape[:2]) < WINDOW:
        raise ValueError(f"ssim: got {a.shape[0]} x {a.shape[1]} pixels; allowed: sides of at least {WINDOW}")
    return float(_similarity(_as_float64(a, b), np.asarray(b, dtype=np.float64))[0].mean())


def ms_ssim(a: Image, b: Image) -> float:
    """Multi-scale structural similarity (Wang et al. 2003), values in 0..255.

    Five scales, each half the one before (mean of 2 x 2 pixels, an odd side padded with zeros on both ends); the
    product over scales of the mean contrast-structure term (at the coarsest: of the mean SSIM), each clipped at 0 and
    raised to its weight, is taken for every channel, then averaged: what pytorch_msssim computes.
    """
    if min(a.shape[:2]) < MIN_MS_SSIM_SIDE:
        raise ValueError(f"ms_ssim: got {a.shape[0]} x {a.shape[1]} pixels; allowed: at least {MIN_MS_SSIM_SIDE}")
    x, y = _as_float64(a, b), np.asarray(b, dtype=np.float64)
    product = np.ones(x.shape[2])
    for level, weight in enumerate(MS_SSIM_WEIGHTS):
        similarity, contrast_structure = _similarity(x, y)
        coarsest = level == len(MS_SSIM_WEIGHTS) - 1
        product *= np.maximum(similarity if coarsest else contrast_structure, 0.0) ** weight
        if not coarsest:
            x, y = _halved(x), _halved(y)
    return float(product.mean())


def _as_float64(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    if a.shape != b.shape:
        raise ValueError(f"images to compare: got shapes {a.shape} and {b.shape}; allowed: equal shapes")
    return np.asarray(a, dtype=np.float64)


def _similarity(x: np.ndarray, y: np.ndarray) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Mean SSIM and mean contrast-structure term of each channel."""
    c1, c2 = (0.01 * DATA_RANGE) ** 2, (0.03 * DATA_RANGE) ** 2
    mean_x, mean_y = _window_mean(x), _window_mean(y)
    var_x = _window_mean(x * x) - mean_x**2
    var_y = _window_mean(y * y) - mean_y**2
    covariance = _window_mean(x * y) - mean_x * mean_y
    contrast_structure = (2 * covariance + c2) / (var_x + var_y + c2)
    luminance = (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    return (luminance * contrast_structure).mean(axis=(0, 1)), contrast_structure.mean(axis=(0, 1))


def _window_mean(image: np.ndarray) -> np.ndarray:
    """Gaussian-weighted mean in every window that lies inside the image."""
    kernel = cv2.getGaussianKernel(WINDOW, WINDOW_SIGMA, cv2.CV_64F)
    r = WINDOW // 2
    return np.atleast_3d(cv2.sepFilter2D(image, cv2.CV_64F, kernel, kernel))[r:-r, r:-r]


def _halved(image: np.ndarray) -> np.ndarray:
    h, w, c = image.shape
    padded = np.pad(image, ((h % 2, h % 2), (w % 2, w % 2), (0, 0)))
    h, w = (h + 2 * (h % 2)) // 2, (w + 2 * (w % 2)) // 2
    return padded[: 2 * h, : 2 * w].reshape(h, 2, w, 2, c).mean(axis=(1, 3))


# ---------------------------------------------------------------- the paper's protocol


@dataclass(frozen=True)
class ImageScores:
    """PSNR in dB, SSIM and MS-SSIM of one image against another."""

    psnr: float
    ssim: float
    ms_ssim: float


@dataclass(frozen=True)
class PaperScores:
    """The paper's scores of one predicted backward map.

    raw: with the map as predicted.
    deshifted: after subtracting the mean of predicted minus true photo points from the predicted ones. That needs
        the truth: it is an oracle, quoted because the paper's tables do.
    shift_px: that mean, (x, y), in pixels of the 256 x 256 photo.
    """

    raw: ImageScores
    deshifted: ImageScores
    shift_px: tuple[float, float]


def image_scores(a: Image, b: Image) -> ImageScores:
    """All three scores of one image against another, values in 0..255."""
    return ImageScores(psnr(a, b), ssim(a, b), ms_ssim(a, b))


def paper_protocol(photo: UInt8[np.ndarray, "h w 3"], predicted: BackwardMap, true: BackwardMap) -> PaperScores:
    """Score a backward map as the paper does: the same lit photo, unwarped with the predicted and with the true map.

    All at 256 x 256: the photo is scaled down (by pixel area), both maps are evaluated at the pixel centres of a film
    of that size, sampling is bilinear with zeros outside, and the three channels of the whole square count, without a
    mask. The maps are in pixels of the full photo. What is measured is geometry only, weighted by the photo's detail.
    """
    small = cv2.resize(photo, PAPER_SIZE, interpolation=cv2.INTER_AREA).astype(np.float32)
    points, true_points = (
        rescale_points(m.dense(PAPER_SIZE).astype(np.float64), photo.shape[:2], PAPER_SIZE) for m in (predicted, true)
    )
    shift = (points - true_points).mean(axis=(0, 1))
    truth = _sampled(small, true_points)
    return PaperScores(
        raw=image_scores(_sampled(small, points), truth),
        deshifted=image_scores(_sampled(small, points - shift), truth),
        shift_px=(float(shift[0]), float(shift[1])),
    )


def _sampled(photo: Float[np.ndarray, "h w 3"], points: Float[np.ndarray, "a b 2"]) -> Float[np.ndarray, "a b 3"]:
    """Bilinear samples of a float32 photo at photo points, zero outside (exact for three channels, convention 3)."""
    maps = opencv_from_photo(points.astype(np.float32))
    return cv2.remap(photo, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)


# ---------------------------------------------------------------- geometry


DISTORTION_AREA_PX = 598_400
"""Pixels of the flat picture in which local distortion is quoted (Ma et al., DocUNet, CVPR 2018)."""


def local_distortion(predicted: BackwardMap, true: BackwardMap, lattice: tuple[int, int] = (65, 65)) -> float:
    """How far what the flat film shows lies from where it belongs: mean distance in pixels of a film of 598,400.

    DocUNet's benchmark calls this distance local distortion and estimates it by SIFT flow. Here it comes from the maps,
    without the errors of a matcher, so it must not be compared with published figures. The flat film's sides are in the
    ratio of their mean lengths in the photo. Photo points that the prediction reads beyond the sheet's edges are placed
    to first order.
    """
    uv = film_nodes(lattice)
    read = predicted.photo_from_film(uv)
    shown = true.film_from_photo(read)
    off = np.isnan(shown).any(axis=-1)
    # A sheet seen edge-on has directions of no extent in the photo; the cutoff keeps them from becoming infinite.
    inverse = np.linalg.pinv(true.jacobian(uv[off]), rcond=1e-2)
    shown[off] = uv[off] + np.einsum("nij,nj->ni", inverse, read[off] - true.photo_from_film(uv[off]))
    aspect = np.divide(*true.mean_film_pixels())
    width = float(np.sqrt(DISTORTION_AREA_PX / aspect))
    return float(np.linalg.norm((shown - uv) * np.array([width, width * aspect]), axis=-1).mean())


# ---------------------------------------------------------------- film against print


def psnr_after_gain_offset(film: Float[np.ndarray, "h w"], truth: Float[np.ndarray, "h w"]) -> float:
    """PSNR in dB of a film against its print, display grey in [0, 1], after the best single gain and offset.

    The gain is not negative: an inverted film does not count as a film. What remains is what no exposure setting could
    mend: uneven light, a wrong tone curve, geometry, noise.
    """
    if film.shape != truth.shape:
        raise ValueError(f"film and print: got shapes {film.shape} and {truth.shape}; allowed: equal shapes")
    x, y = np.asarray(film, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    spread = float(np.var(x))
    gain = max(float(np.mean((x - x.mean()) * (y - y.mean()))) / spread, 0.0) if spread > 0 else 0.0
    error = float(np.mean(np.square(gain * (x - x.mean()) + y.mean() - y)))
    return PSNR_CAP_DB if error == 0.0 else min(PSNR_CAP_DB, float(-10 * np.log10(error)))


__all__ = [
    "ImageScores",
    "PaperScores",
    "image_scores",
    "local_distortion",
    "ms_ssim",
    "paper_protocol",
    "psnr",
    "psnr_after_gain_offset",
    "ssim",
]
