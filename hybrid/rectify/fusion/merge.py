"""Merge registered films into one: a mean weighted by trust, without what differs from the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from hybrid.errors import require_at_least
from hybrid.threads import in_strips

Film = Float32[np.ndarray, "h w"]

STRIP_ROWS = 64
"""Number of rows whose median is found at a time, so that those of all films stay in the processor's cache."""


@dataclass(frozen=True)
class MergeConfig:
    """How films are merged."""

    detail: float = 0.01
    """Fraction of the longer side below which changes of grey are detail, not remains of light."""
    outlier: float = 0.06
    """Display grey by which a photo may differ from the others, apart from detail, before it is left out."""
    sharpness_px: int = 1024
    """Longer side of the copies on which the films' detail is compared."""

    def __post_init__(self) -> None:
        require_at_least(self, 1e-6, "outlier")


@dataclass(frozen=True, eq=False)
class Fused:
    """The merged film, where no photo shows it, how far it can be trusted, and each photo's share in it."""

    film: Film
    lost: Bool[np.ndarray, "h w"]
    confidence: Film
    shares: tuple[float, ...]


def reduced(size: tuple[int, ...], longer: int) -> tuple[int, int]:
    """Size (h, w) with ``longer`` as its longer side; never enlarged."""
    factor = min(1.0, longer / max(size))
    return max(round(size[0] * factor), 1), max(round(size[1] * factor), 1)


def detail_of(film: Film, unseen: Bool[np.ndarray, "h w"], size: tuple[int, int]) -> Float32[np.ndarray, "sh sw"]:
    """The film at another size without its slow changes, 0 where it cannot be trusted: light does not affect this."""
    small = cv2.resize(film, size[::-1], interpolation=cv2.INTER_AREA)
    sigma = max(size) / 100
    fine = small - cv2.GaussianBlur(small, (0, 0), sigma)
    lost = cv2.resize(unseen.astype(np.float32), size[::-1], interpolation=cv2.INTER_AREA)
    return np.where(cv2.GaussianBlur(lost, (0, 0), sigma) > 0.1, np.float32(0), fine)


def merge(
    films: Sequence[Film],
    lost: Sequence[Bool[np.ndarray, "h w"]],
    trust: Sequence[Film],
    config: MergeConfig,
) -> Fused:
    """One film from several that cover each other: their mean, weighted by trust, without what differs from the others.

    lost: where a photo shows no film (glare, something in front of it, or beyond the photo's edge). trust: in [0, 1].

    Remains of light are broad, and mostly too bright: they are judged on blurred films against their lower median,
    weighted by trust.
    """
    sigma = config.detail * max(films[0].shape)
    broad = [_blurred_where(film, ~gone, sigma) for film, gone in zip(films, lost, strict=True)]
    level = _middle(broad, lost, trust)
    total, weights = np.zeros(films[0].shape, np.float32), []
    merged, best = np.zeros_like(total), np.zeros_like(total)
    sharp = np.array([_sharpness(film, gone, config.sharpness_px) for film, gone in zip(films, lost, strict=True)])
    sharp = (sharp / max(sharp.max(), 1e-9)) ** 4  # what is blurred adds little but blur
    for film, gone, sure, smooth, worth in zip(films, lost, trust, broad, sharp.tolist(), strict=True):
        odd = np.exp(-np.square((smooth - level) / np.float32(config.outlier)))
        # weights fade towards what is lost, so that no edge of a reflection is printed into the film
        near = _blurred(gone.astype(np.float32), sigma)
        weight = np.square(sure) * odd * np.clip(1 - near, 0.0, 1.0) * np.float32(worth)
        weight = np.where(gone, np.float32(0), weight + np.float32(1e-4))
        merged += weight * film
        total += weight
        best = np.maximum(best, np.where(gone, np.float32(0), sure * odd))  # low where the others disagree
        weights.append(weight)
    nowhere = np.logical_and.reduce(list(lost))
    film = np.where(nowhere, films[0], merged / np.maximum(total, np.float32(1e-9)))
    shares = tuple(float((weight / np.maximum(total, 1e-9))[~nowhere].mean()) if not nowhere.all() else 0.0
                   for weight in weights)  # fmt: skip
    return Fused(film, nowhere, best, shares)


def _blurred(values: Film, sigma: float) -> Film:
    """A Gaussian blur, computed at a quarter of the size if it is wide enough for that not to matter."""
    if sigma < 8:
        return cv2.GaussianBlur(values, (0, 0), max(sigma, 0.5))
    quarter = (max(values.shape[1] // 4, 1), max(values.shape[0] // 4, 1))  # OpenCV scales by exactly 1 / 4 otherwise
    small = cv2.resize(values, quarter, interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), sigma / 4)
    return cv2.resize(blurred, values.shape[::-1], interpolation=cv2.INTER_LINEAR)


def _blurred_where(film: Film, known: Bool[np.ndarray, "h w"], sigma: float) -> Film:
    """The film blurred over its known pixels."""
    weight = known.astype(np.float32)
    return _blurred(film * weight, sigma) / np.maximum(_blurred(weight, sigma), np.float32(1e-3))


def _middle(values: Sequence[Film], lost: Sequence[Bool[np.ndarray, "h w"]], trust: Sequence[Film]) -> Film:
    """The lower median at each pixel, weighted by squared trust, of the values that are not lost, or of all where all
    are lost: several veiled photos do not outvote a clear one, and of two, the one that is trusted more counts."""
    middle = np.empty_like(values[0])

    def find(part: slice) -> None:
        weights = [
            np.where(gone[part], np.float32(1e-9), np.square(sure[part]) + np.float32(1e-6))
            for gone, sure in zip(lost, trust, strict=True)
        ]
        half, least = np.float32(0.5) * sum(weights), np.full(weights[0].shape, np.inf, np.float32)
        for value in values:
            below = sum(
                np.where(other[part] <= value[part], weight, np.float32(0))
                for other, weight in zip(values, weights, strict=True)
            )
            least = np.where(below >= half, np.minimum(least, value[part]), least)
        middle[part] = least

    in_strips(find, len(middle), STRIP_ROWS)
    return middle


def _sharpness(film: Film, gone: Bool[np.ndarray, "h w"], side: int) -> float:
    """How much detail a film holds where it is seen."""
    fine = detail_of(film, gone, reduced(film.shape, side))
    return float(np.sqrt(np.square(fine[fine != 0]).mean())) if fine.any() else 0.0


__all__ = ["Film", "Fused", "MergeConfig", "detail_of", "merge", "reduced"]
