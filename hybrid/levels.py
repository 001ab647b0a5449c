"""What print black and print white look like at each place of a flat film, and what reads that from a small copy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from hybrid.coords import linear_from_srgb

CHANNEL_SHARES = (0.25, 0.6, 0.15)
"""Shares of red, green and blue in linear grey: green is the sharpest and least noisy channel of a phone's picture. Any
fixed shares keep the form gain * print + veil, and a colour cast only changes the gain."""

CLIPPED = 253
"""Channel values from here on say only "at least"."""

LEAST_CONTRAST = 12 / 255
"""Contrast of print black and white, in display grey, below which nothing can be recovered: noise and coding eat it."""


USUAL_ROOT_SHARE, MOST_ROOT_SHARE = 0.85, 2.0
"""``Levels.root_share`` of films of which nothing better is known, and the most that it can be: with more, a tone curve
would fall before white. Films printed by DICOM's display function need 1.8 (``hybrid.gsdf``)."""


@dataclass(frozen=True, eq=False)
class Levels:
    """Linear grey of the photo (``CHANNEL_SHARES``) where the print is black and where it is white.

    black: the veil, which the film reflects from the room whatever is printed. gain: white minus black, positive. Both
    are given at the pixel centres of a small lattice over the film. root_share: in the print's tone from black to
    white, the share of the square root (as of a print seen by reflection: the display's own gamma) against the straight
    line (as of a print whose transmission is proportional to its grey, or of a camera that raises middle greys).
    """

    black: Float32[np.ndarray, "h w"]
    gain: Float32[np.ndarray, "h w"]
    root_share: float = USUAL_ROOT_SHARE


@dataclass(frozen=True)
class LevelReader:
    """side_px: side of the square copy of the film that is read. read: the levels, from a copy (sRGB) and a mask of
    where it is visible and shows print."""

    side_px: int
    read: Callable[[UInt8[np.ndarray, "n n 3"], Bool[np.ndarray, "n n"]], Levels]


def grey_table() -> Float32[np.ndarray, "256 3"]:
    """Each channel's contribution to linear grey, by its 8-bit sRGB value."""
    return (linear_from_srgb(np.arange(256) / 255.0)[:, None] * np.array(CHANNEL_SHARES)).astype(np.float32)
