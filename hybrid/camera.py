"""What the file of a photo tells of the camera: how long its lens was.

Where a sheet only leans, the photo leaves open how long the lens is, and so how long the sheet (rectify/film_size.py).
"""

from __future__ import annotations

import math
from contextlib import nullcontext
from typing import Any

import numpy as np
from PIL import Image
from PIL.ExifTags import IFD, Base

from hybrid.image_io import PhotoSource, opened

FILM_35_DIAGONAL_MM = math.hypot(36.0, 24.0)
"""Of the frame that focal lengths are stated for as equivalent ones (CIPA DCG-001: by the diagonal)."""

SHORTEST_MM, LONGEST_MM = 8.0, 400.0
"""Equivalent focal lengths beyond these are no phone's; 0 stands for one that is not known."""

TOLD_SIGMA = 0.05
"""Standard deviation of the logarithm of a focal length that is told: the lens breathes, and millimetres are whole."""

SAME_SHAPE = 0.01
"""Relative difference of the ratio of sides from what the camera wrote, from which on a photo was cropped."""


def told_focal(source: PhotoSource) -> float | None:
    """The focal length that a photo's EXIF tells, in longer sides of the photo; None for an array, where it is not
    told, or where the photo was cropped since.

    By EXIF's equivalent for 35 mm film (FocalLengthIn35mmFilm), which is exact to half a millimetre, and which phones
    lengthen where they zoom by cropping.
    """
    if isinstance(source, np.ndarray):
        return None
    try:
        with nullcontext(source) if isinstance(source, Image.Image) else opened(source) as image:
            return _focal_of(image.getexif().get_ifd(IFD.Exif), image.size)
    except Exception:  # the photo itself is read elsewhere: of damaged EXIF Pillow raises nearly anything
        return None


def _focal_of(exif: dict[int, Any], size: tuple[int, int]) -> float | None:
    """The same by the EXIF of a picture of ``size`` (width, height)."""
    equivalent_mm = float(exif.get(Base.FocalLengthIn35mmFilm, 0))
    if not SHORTEST_MM <= equivalent_mm <= LONGEST_MM:
        return None
    taken = int(exif.get(Base.ExifImageWidth, 0)), int(exif.get(Base.ExifImageHeight, 0))
    if min(taken) > 0 and abs(_oblong(taken) / _oblong(size) - 1.0) > SAME_SHAPE:
        return None
    return equivalent_mm / FILM_35_DIAGONAL_MM * math.hypot(*size) / max(size)


def _oblong(size: tuple[int, int]) -> float:
    """Longer over shorter side: whichever way up the picture was turned since."""
    return max(size) / min(size)


__all__ = ["TOLD_SIGMA", "told_focal"]
