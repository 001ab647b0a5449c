"""What the file of a photo tells of the camera: the focal length of its lens.

Where a sheet is only tilted, the photo leaves the focal length open, and so the sheet's length (rectify/film/size.py).
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
"""Diagonal of the frame to which equivalent focal lengths refer (CIPA DCG-001: by the diagonal)."""

SHORTEST_MM, LONGEST_MM = 8.0, 400.0
"""Equivalent focal lengths outside these are not those of phones; 0 means that it is unknown."""

FOCALS = (0.1, 20.0)
"""Focal lengths that may be given, in units of the photo's longer side: between a fisheye's and a telescope's."""

TOLD_SIGMA = 0.05
"""Standard deviation of the logarithm of a focal length that is told: lenses breathe, and millimetres are whole."""

SAME_SHAPE = 0.01
"""Relative change of the ratio of sides, since the camera wrote it, above which a photo counts as cropped."""


def told_focal(source: PhotoSource) -> float | None:
    """The focal length in a photo's EXIF, in units of the photo's longer side; None for an array, if EXIF does not give
    it, or if the photo was cropped since.

    Uses EXIF's equivalent for 35 mm film (FocalLengthIn35mmFilm), which is accurate to half a millimetre, and which
    phones increase when they zoom by cropping.
    """
    if isinstance(source, np.ndarray):
        return None
    try:
        with nullcontext(source) if isinstance(source, Image.Image) else opened(source) as image:
            return _focal_of(image.getexif().get_ifd(IFD.Exif), image.size)
    except Exception:  # the photo itself is read elsewhere: on damaged EXIF Pillow raises nearly anything
        return None


def _focal_of(exif: dict[int, Any], size: tuple[int, int]) -> float | None:
    """The same from the EXIF of a picture of ``size`` (width, height)."""
    equivalent_mm = float(exif.get(Base.FocalLengthIn35mmFilm, 0))
    if not SHORTEST_MM <= equivalent_mm <= LONGEST_MM:
        return None
    taken = int(exif.get(Base.ExifImageWidth, 0)), int(exif.get(Base.ExifImageHeight, 0))
    if min(taken) > 0 and abs(_oblong(taken) / _oblong(size) - 1.0) > SAME_SHAPE:
        return None
    return equivalent_mm / FILM_35_DIAGONAL_MM * math.hypot(*size) / max(size)


def _oblong(size: tuple[int, int]) -> float:
    """Longer over shorter side: the same whichever way the picture was turned since."""
    return max(size) / min(size)


__all__ = ["FOCALS", "TOLD_SIGMA", "told_focal"]
