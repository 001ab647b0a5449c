"""Parts of a photo that something covers: small pictures put over a large one, each only within its box."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float

from hybrid.coords import opencv_from_photo

Box = tuple[slice, slice]
"""Rows and columns of a photo."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Something in front of a picture, within ``box``.

    radiance: linear RGB. cover: share of each pixel that it covers, [0, 1]. hides: share over which the print behind
    is no longer readable; less than ``cover`` for anything transparent. shade: factor on the light of what it leaves
    uncovered, (0, 1].
    """

    box: Box
    radiance: Float[np.ndarray, "h w 3"]
    cover: Float[np.ndarray, "h w"]
    hides: Float[np.ndarray, "h w"]
    shade: Float[np.ndarray, "h w"]


def put_over(picture: Float[np.ndarray, "h w 3"], patches: Iterable[Patch]) -> Float[np.ndarray, "h w 3"]:
    """A copy of ``picture`` with the patches over it, the first one lowest."""
    out = picture.copy()
    for patch in patches:
        free = (patch.shade * (1 - patch.cover))[..., None]
        out[patch.box] = out[patch.box] * free + patch.radiance * patch.cover[..., None]
    return out


def shading_only(patch: Patch, over: Float[np.ndarray, "h w"]) -> Patch:
    """The patch, its shade limited to ``over``, a share of each pixel."""
    return replace(patch, shade=1 - (1 - patch.shade) * over[patch.box])


def hidden_share(patches: Iterable[Patch], size: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """Share of each pixel of a photo of ``size`` that the patches hide."""
    out = np.zeros(size, np.float32)
    for patch in patches:
        out[patch.box] = np.maximum(out[patch.box], patch.hides)
    return out


def frame_box(points: Float[np.ndarray, "n 2"], size: tuple[int, int], margin: float = 2.0) -> Box | None:
    """The part of a photo that holds ``points`` (photo frame), with a margin in pixels; None outside the photo."""
    low = np.clip(np.floor(points.min(axis=0) - margin), 0, size[::-1]).astype(int)
    high = np.clip(np.ceil(points.max(axis=0) + margin), 0, size[::-1]).astype(int)
    if (high <= low).any():
        return None
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def filled(outline: Float[np.ndarray, "n 2"], size: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """Share of each pixel of a photo of ``size`` within an outline in the photo frame, its rim up to a pixel wider."""
    mask = np.zeros(size, np.uint8)
    fixed = np.clip(opencv_from_photo(outline) * 16, -(2**19), 2**19).round().astype(np.int32)
    cv2.fillPoly(mask, [fixed], 255, cv2.LINE_AA, 4)
    return mask * np.float32(1 / 255)


def blurred(picture: Float[np.ndarray, "h w"], sigma: float) -> Float[np.ndarray, "h w"]:
    """Gaussian blur; a wide one runs on a smaller picture, since it removes all finer detail."""
    step = sigma / 3
    if step < 1.5 or min(picture.shape) < 4 * step:
        return cv2.GaussianBlur(picture, (0, 0), sigma)
    h, w = picture.shape
    small = cv2.resize(picture, (max(2, round(w / step)), max(2, round(h / step))), interpolation=cv2.INTER_AREA)
    return cv2.resize(cv2.GaussianBlur(small, (0, 0), 3.0), (w, h), interpolation=cv2.INTER_LINEAR)
