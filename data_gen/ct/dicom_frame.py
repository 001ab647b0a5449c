"""One DICOM image: its axial CT frames in Hounsfield units, upright, or the reason why it has none.

Reads geometry and pixels only, never who the patient is. Slices of a tilted gantry are kept as they were acquired,
because that is how films show them: nothing is sheared back to upright.
"""

from __future__ import annotations

import hashlib
import io
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pydicom
from jaxtyping import Bool, Float, Int16
from pydicom.multival import MultiValue
from pydicom.pixels.decoders.base import get_decoder
from pydicom.pixels.processing import apply_modality_lut
from pydicom.uid import ImplicitVRLittleEndian

from data_gen.ct import jpeg12
from hybrid.errors import DataError

PADDING_HU = -2048
"""What lies outside the scanned field; darker than air, so that it prints black in every window."""

AXIAL_COSINE = 0.8
"""Gantries tilt by up to 30 degrees (0.87) and patients lie a little askew; coronal and sagittal slices are at 0."""

NOT_SLICES = {"LOCALIZER": "a scout view", "PERFUSION": "a perfusion map, not Hounsfield units", "MIP": "a projection"}
"""Values of ImageType that say what a CT image is if it is not a slice."""

HOUNSFIELD_TYPES = {"", "HU", "HU_MOD", "US"}
"""Values of RescaleType that Hounsfield units come with (US: unspecified); others are densities, atomic numbers ..."""

RETIRED_TAGS = {"ImageOrientationPatient": (0x0020, 0x0035), "ImagePositionPatient": (0x0020, 0x0030)}
"""The equivalents in files of ACR-NEMA, the standard before DICOM."""


class RefusedError(DataError):
    """A file, or a frame of one, that is not an axial CT slice; the message is the reason."""


@dataclass(frozen=True, eq=False)
class Frame:
    """An axial CT slice as the patient is seen from below: row 0 anterior, column 0 the patient's right.

    series: what slices of the same volume share: series, size, spacing, orientation.
    height_mm: position along the slice normal, which points to the head. thickness_mm: 0 where unknown.
    """

    series: tuple[Any, ...]
    hu: Int16[np.ndarray, "rows cols"]
    height_mm: float
    spacing_mm: tuple[float, float]
    thickness_mm: float


def read_frames(content: bytes) -> list[Frame]:
    """The axial CT frames in the bytes of a file; raises RefusedError with a reason if there are none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pydicom warns of harmless oddities; what matters is checked below
        try:
            dataset = pydicom.dcmread(io.BytesIO(content), force=True)
            _check(dataset)
            return list(_frames(dataset))
        except RefusedError:
            raise
        except MemoryError as error:
            raise RefusedError("it claims more pixels than fit into memory") from error
        except Exception as error:  # damaged files make pydicom raise nearly everything
            # the library's message may quote values of the header, so only its kind is passed on
            raise RefusedError(f"damaged or unsupported DICOM ({type(error).__name__})") from error


def _check(dataset: Any) -> None:
    """Raises RefusedError if the header already shows that this is no CT slice."""
    modality = dataset.get("Modality")
    if modality is None and "PixelData" not in dataset:
        raise RefusedError("not a DICOM image, or one with a damaged header")
    if modality != "CT":
        raise RefusedError(f"modality {str(modality)[:16]!r} is not CT")
    _check_kind(dataset.get("ImageType"))
    if "PixelData" not in dataset:
        raise RefusedError("no pixels in it")
    if int(dataset.get("SamplesPerPixel", 1)) != 1:
        raise RefusedError("a colour picture, not Hounsfield units")
    jpeg12.register()
    syntax = dataset.file_meta.get("TransferSyntaxUID")
    if syntax is not None and syntax.is_compressed and not syntax.is_deflated:
        try:
            available = get_decoder(syntax).is_available
        except NotImplementedError:
            available = False
        if not available:
            raise RefusedError(f"compressed as {syntax.name}, for which no decoder is installed")


def _check_kind(image_type: Any) -> None:
    """Raises RefusedError if ImageType or FrameType names something other than a slice."""
    for value in image_type if isinstance(image_type, MultiValue) else ():
        if str(value).upper() in NOT_SLICES:
            raise RefusedError(NOT_SLICES[str(value).upper()])


# ---------------------------------------------------------------- frames


def _frames(dataset: Any) -> Iterator[Frame]:
    count = int(dataset.get("NumberOfFrames") or 1)
    geometries = [_geometry(dataset, k) for k in range(count)]  # before the pixels, which cost most
    stored = _stored_pixels(dataset)
    if stored.ndim == 2:
        stored = stored[None]
    if stored.ndim != 3 or len(stored) != count:
        raise RefusedError(f"pixels of shape {stored.shape} do not fit {count} frames")
    for k in range(count):
        yield _frame(dataset, k, stored[k], geometries[k])


def _stored_pixels(dataset: Any) -> np.ndarray:
    """The pixels as stored. Files without a preamble name no transfer syntax; they are implicit little-endian."""
    if dataset.file_meta.get("TransferSyntaxUID") is None:
        dataset.file_meta.TransferSyntaxUID = ImplicitVRLittleEndian
    for keyword, usual in (("SamplesPerPixel", 1), ("PhotometricInterpretation", "MONOCHROME2")):
        if dataset.get(keyword) is None:
            setattr(dataset, keyword, usual)
    try:
        return np.asarray(dataset.pixel_array)
    except (RuntimeError, ValueError, AttributeError) as error:
        name = dataset.file_meta.TransferSyntaxUID.name
        raise RefusedError(f"its pixels ({name}) are truncated or of a kind that no installed decoder reads") from error


def _value(dataset: Any, k: int, sequence: str, keyword: str) -> Any:
    """An attribute of frame ``k``: from the frame's own functional groups, the shared ones, or the plain header."""
    groups = []
    if "PerFrameFunctionalGroupsSequence" in dataset:
        groups.append(dataset.PerFrameFunctionalGroupsSequence[k])
    groups += list(dataset.get("SharedFunctionalGroupsSequence") or [])[:1]
    for group in groups:
        if group.get(sequence) and group[sequence][0].get(keyword) is not None:
            return group[sequence][0].get(keyword)
    if keyword in RETIRED_TAGS and keyword not in dataset:
        return dataset[RETIRED_TAGS[keyword]].value if RETIRED_TAGS[keyword] in dataset else None
    return dataset.get(keyword)


def _numbers(value: Any, count: int, what: str) -> Float[np.ndarray, " n"]:
    """``count`` finite numbers from a header, or RefusedError."""
    try:
        numbers = np.array([float(v) for v in value], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RefusedError(f"no {what}") from error
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise RefusedError(f"unusable {what}")
    return numbers


@dataclass(frozen=True, eq=False)
class _Geometry:
    """How a frame lies in the patient: unit vectors along rows and columns, their normal, which points to the head.

    spacing_mm: between pixels (down, across). height_mm: position along the normal. thickness_mm: 0 where unknown.
    """

    along_row: Float[np.ndarray, " 3"]
    along_column: Float[np.ndarray, " 3"]
    spacing_mm: Float[np.ndarray, " 2"]
    height_mm: float
    thickness_mm: float


def _geometry(dataset: Any, k: int) -> _Geometry:
    """Raises RefusedError if frame ``k`` is no axial slice, or if its header does not say so."""
    frame_type = _value(dataset, k, "CTImageFrameTypeSequence", "FrameType")
    if frame_type is not None:
        _check_kind(frame_type)
    orientation = _numbers(_value(dataset, k, "PlaneOrientationSequence", "ImageOrientationPatient"), 6, "orientation")
    spacing = _numbers(_value(dataset, k, "PixelMeasuresSequence", "PixelSpacing"), 2, "pixel spacing")
    position = _numbers(_value(dataset, k, "PlanePositionSequence", "ImagePositionPatient"), 3, "slice position")
    if spacing.min() <= 0:
        raise RefusedError("unusable pixel spacing")
    along_row, along_column = orientation[:3], orientation[3:]
    normal = np.cross(along_row, along_column)
    length = float(np.linalg.norm(normal))
    if not 0.9 < length < 1.1:
        raise RefusedError("unusable orientation")
    if abs(normal[2]) < AXIAL_COSINE * length:
        raise RefusedError("not an axial slice")
    thickness = _value(dataset, k, "PixelMeasuresSequence", "SliceThickness")
    try:
        thickness_mm = max(float(thickness), 0.0) if thickness is not None else 0.0
    except (TypeError, ValueError):
        thickness_mm = 0.0
    height_mm = float(position @ normal) / length * float(np.sign(normal[2]))
    return _Geometry(along_row, along_column, spacing, height_mm, thickness_mm)


def _frame(dataset: Any, k: int, stored: np.ndarray, geometry: _Geometry) -> Frame:
    hu = _hounsfield(dataset, k, stored)
    along_row, along_column, spacing = geometry.along_row, geometry.along_column, geometry.spacing_mm
    if abs(along_row[0]) < abs(along_column[0]):  # rotated by a quarter turn
        hu, along_row, along_column, spacing = hu.T, along_column, along_row, spacing[::-1]
    hu = hu[:: 1 if along_column[1] > 0 else -1, :: 1 if along_row[0] > 0 else -1]
    series = (
        hashlib.sha256(str(dataset.get("SeriesInstanceUID", "")).encode()).hexdigest()[:8],
        hu.shape,
        tuple(np.round(spacing, 4).tolist()),
        tuple(np.round([*geometry.along_row, *geometry.along_column], 2).tolist()),
    )
    upright = (float(spacing[0]), float(spacing[1]))
    return Frame(series, np.ascontiguousarray(hu), geometry.height_mm, upright, geometry.thickness_mm)


def _hounsfield(dataset: Any, k: int, stored: np.ndarray) -> Int16[np.ndarray, "rows cols"]:
    """Hounsfield units by modality LUT or rescale; MONOCHROME1 inverts the display, not the units."""
    padding = _padding(dataset, stored)
    if dataset.get("ModalityLUTSequence"):
        values = np.asarray(apply_modality_lut(stored, dataset), dtype=np.float64)
    else:
        sequence = "PixelValueTransformationSequence"
        kind = str(_value(dataset, k, sequence, "RescaleType") or "").strip().upper()
        if kind not in HOUNSFIELD_TYPES:
            raise RefusedError("its values are rescaled to something else than Hounsfield units")
        slope, intercept = (_value(dataset, k, sequence, key) for key in ("RescaleSlope", "RescaleIntercept"))
        slope, intercept = _numbers([slope, intercept], 2, "rescale slope and intercept: Hounsfield units unknown")
        values = stored * slope + intercept
    hu = np.clip(np.rint(values), PADDING_HU, 32767).astype(np.int16)
    hu[padding] = PADDING_HU
    return hu


def _padding(dataset: Any, stored: np.ndarray) -> Bool[np.ndarray, "rows cols"]:
    """Where the stored value means that nothing was scanned."""
    first = dataset.get("PixelPaddingValue")
    if not isinstance(first, int):
        return np.zeros(stored.shape, bool)
    last = dataset.get("PixelPaddingRangeLimit")
    low, high = sorted((first, last if isinstance(last, int) else first))
    mask = np.zeros(stored.shape, bool)
    wide = stored.astype(np.int64)
    for turn in (-65536, 0, 65536):  # writers disagree about the sign of this attribute
        mask |= (wide >= low + turn) & (wide <= high + turn)
    return mask


__all__ = ["PADDING_HU", "Frame", "RefusedError", "read_frames"]
