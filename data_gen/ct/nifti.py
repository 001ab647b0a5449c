"""CT volumes from NIfTI files (``.nii``, ``.nii.gz``)."""

from __future__ import annotations

import hashlib
import zlib
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
from nibabel.affines import obliquity
from nibabel.filebasedimages import ImageFileError
from nibabel.orientations import aff2axcodes

from data_gen.ct.volumes import CtVolume, as_hounsfield, not_ct
from hybrid.errors import DataError, describe

MAX_VOXELS = 2**29
"""More than a whole-body CT has; a header that claims more is damaged."""

MAX_OBLIQUE_RAD = 0.6
"""A scan whose axes lie further (34 degrees) from the patient's is not axial; gantries tilt by up to 30 degrees."""

MAX_PIXEL_RATIO = 1.5
"""Pixels of axial CT slices are square; those of a coronal or sagittal series, seen from above, are elongated."""


DIM_HU = -300
"""A whole scan includes air, which is far below this. NIfTI names no modality, and MR has no negative values."""


class NotCtError(DataError):
    """A NIfTI file that holds no axial CT; the message says why."""


def read_nifti(path: Path | str) -> CtVolume:
    """The CT in a NIfTI file, brought to the axes of CtVolume by its affine (NIfTI's world: x left to right, y back to
    front, z up). The volume's name is a hash of the file's: converters write the patient's name there.

    Raises NotCtError with the reason if the file is damaged or holds anything but axial CT in Hounsfield units.
    """
    path = Path(path)
    try:
        image: Any = nibabel.load(path)  # type: ignore[attr-defined]
        shape, affine = tuple(image.shape), np.asarray(image.affine, np.float64)
        while len(shape) > 3 and shape[-1] == 1:
            shape = shape[:-1]
        _check_header(path, shape, affine, image.get_data_dtype())
        canonical = nibabel.as_closest_canonical(image)  # type: ignore[attr-defined]
        values = np.asanyarray(canonical.dataobj).reshape(canonical.shape[:3])
    except (OSError, EOFError, ValueError, TypeError, MemoryError, zlib.error, ImageFileError) as error:
        raise _refused(path, f"damaged or unsupported NIfTI ({type(error).__name__})") from error
    hu = np.ascontiguousarray(as_hounsfield(values).T[:, ::-1, ::-1])  # x to the left, y to the back
    reason = not_ct(hu)
    if not reason and hu.min() > DIM_HU:
        reason = f"no value below {hu.min()}: not Hounsfield units, where air is -1000"
    if reason:
        raise _refused(path, reason)
    x, y, z = (float(s) for s in np.linalg.norm(canonical.affine[:3, :3], axis=0))
    return CtVolume(hu, (z, y, x), f"nifti_{hashlib.sha256(path.name.encode()).hexdigest()[:8]}")


def _check_header(path: Path, shape: tuple[int, ...], affine: np.ndarray, dtype: np.dtype) -> None:
    """Raises NotCtError if the header already shows that this is no axial CT."""
    if len(shape) != 3 or min(shape) < 1:
        raise _refused(path, f"{len(shape)} axes of {shape}, not one volume")
    if int(np.prod(shape, dtype=np.int64)) > MAX_VOXELS:
        raise _refused(path, f"it claims {shape} voxels, more than {MAX_VOXELS}")
    if dtype.kind not in "iuf":
        raise _refused(path, "colours or complex numbers, not Hounsfield units")
    lengths = np.linalg.norm(affine[:3, :3], axis=0)
    if not np.isfinite(affine).all() or lengths.min() <= 0:
        raise _refused(path, "an affine without voxel sizes")
    if obliquity(affine).max() > MAX_OBLIQUE_RAD:
        raise _refused(path, "axes far from the patient's: not an axial scan")
    across = [size for size, code in zip(lengths, aff2axcodes(affine), strict=True) if code not in ("S", "I")]
    if max(across) > MAX_PIXEL_RATIO * min(across):
        raise _refused(path, "pixels that are not square seen from above: not an axial scan")


def _refused(path: Path, reason: str) -> NotCtError:
    allowed = "axial CT in Hounsfield units"
    return NotCtError(describe(what="NIfTI file", where=path, got=reason, allowed=allowed, do="Leave it out"))


__all__ = ["NotCtError", "read_nifti"]
