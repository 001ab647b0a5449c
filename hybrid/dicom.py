"""A film and its slices as DICOM: Secondary Captures of a digitised film, for archives and viewers.

They declare what a photo of a film is: derived, secondary, lossily compressed, with burned-in text. What it cannot tell
is left out of them: no pixel spacing, no position in the patient, no Hounsfield units, no patient, no date.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, SecondaryCaptureImageStorage

from hybrid import __version__
from hybrid.image_io import levels_16, photo_size, tiff_compression
from hybrid.jpeg import jpeg_extent
from hybrid.records import RectifyResult

JPEG, JPEG_2000, HEVC, WEBP, AV1 = "ISO_10918_1", "ISO_15444_1", "ISO_23008_2", "RFC_9649", "AOM_AV1"
"""Lossy compression methods of photos, in DICOM's terms (PS3.3 C.7.6.1.1.5.1), and WebP and AVIF, for which it has
none."""

JPEG_IN_TIFF = (6, 7)
"""Values of ``image_io.tiff_compression`` that mean JPEG."""

NOT_DIAGNOSTIC = "Made of a photo of a film. Not for diagnosis: greys are not Hounsfield units, geometry is the film's."

FILM, SLICES = 1, 2
"""Numbers of the series."""


@dataclass(frozen=True)
class PhotoFile:
    """What must be known of the files of a film's photos. digest: SHA-256 of the photo that the map is of. method: how
    a photo was lossily compressed, in DICOM's terms; None if it is not known to be. ratio: bytes of its pixels over
    bytes of its file."""

    digest: str
    ratio: float
    method: str | None

    @staticmethod
    def of(paths: Sequence[Path], digest: str) -> PhotoFile:
        """Of one photo, or of several that were fused: of the first of them that was lossily compressed."""
        path, data, method = paths[0], b"", None
        for path in paths:
            data = path.read_bytes()
            if (method := lossy_method(data)) is not None:
                break
        height, width = photo_size(path)
        colours, length = jpeg_extent(data) or (3, len(data))
        return PhotoFile(digest, colours * height * width / length, method)


def lossy_method(data: bytes) -> str | None:
    """How a picture's file is lossily compressed, judged by its content; None if it is not known to be lossy."""
    if data.startswith(b"\xff\xd8\xff"):
        return JPEG
    if data[4:8] == b"ftyp":
        brands = data[8 : int.from_bytes(data[:4], "big")]
        if any(brand in brands for brand in (b"avif", b"avis")):
            return AV1
        return HEVC if any(brand in brands for brand in (b"heic", b"heix", b"hevc", b"heim")) else None
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        at = 12
        while at + 8 <= len(data):  # from chunk to chunk: "VP8 " is lossy, "VP8L" is not
            if data[at : at + 4] == b"VP8 ":
                return WEBP
            size = int.from_bytes(data[at + 4 : at + 8], "little")
            at += 8 + size + size % 2
    if data[4:8] == b"jP  ":
        coding = data.find(b"\xff\x52")  # the marker COD; 13 bytes on comes the wavelet, of which 9-7 (0) is lossy
        return JPEG_2000 if coding >= 0 and data[coding + 13 : coding + 14] == b"\0" else None
    if data[:4] in (b"II*\0", b"MM\0*"):
        return JPEG if tiff_compression(data) in JPEG_IN_TIFF else None
    return None


def secondary_captures(result: RectifyResult, photo: PhotoFile) -> Iterator[Dataset]:
    """The film, then its slices row by row: one study, a series for each of the two. Nothing without a film.

    The same photo and result give the same bytes, identifiers included; anything else gets other identifiers.
    """
    if result.film is None:
        return
    cells = b"" if result.grid is None else result.grid.vertices.tobytes()
    said = f"{__version__} {result.status.doubts} {result.film.shape}".encode()
    of = hashlib.sha256(said + result.film.tobytes() + cells).hexdigest()
    yield _capture(result, photo, result.film, of, (FILM, 1), "Film, flattened")
    for number, cell in enumerate(filter(np.size, result.slices()), start=1):
        yield _capture(result, photo, cell, of, (SLICES, number), "Slices of a film, row by row")


def _capture(
    result: RectifyResult,
    photo: PhotoFile,
    picture: Float[np.ndarray, "h w"],
    of: str,
    number: tuple[int, int],
    series: str,
) -> Dataset:
    """One Secondary Capture (PS3.3 A.8.1). of: digest of the whole film. number: of the series, and within it."""
    sure = "; ".join(result.status.doubts) or "no doubts"
    it = Dataset()
    it.SpecificCharacterSet = "ISO_IR 192"
    it.SOPClassUID = SecondaryCaptureImageStorage
    it.SOPInstanceUID = _uid(photo.digest, of, f"{number}")
    it.StudyInstanceUID = _uid(photo.digest)
    it.SeriesInstanceUID = _uid(photo.digest, of, f"{number[0]}")
    it.SeriesNumber, it.InstanceNumber = number
    it.SeriesDescription = series
    for unknown in (
        *("PatientName", "PatientID", "PatientBirthDate", "PatientSex", "StudyDate", "StudyTime", "StudyID"),
        *("ReferringPhysicianName", "AccessionNumber", "PatientOrientation", "Laterality"),
    ):
        setattr(it, unknown, "")
    it.Modality = "OT"
    it.ConversionType = "DF"  # digitised film
    it.SecondaryCaptureDeviceManufacturer = "hybrid"
    it.SecondaryCaptureDeviceSoftwareVersions = __version__
    it.ImageType = ["DERIVED", "SECONDARY"]
    it.DerivationDescription = f"hybrid {__version__}: flat, its light taken out; {sure}."
    it.ImageComments = NOT_DIAGNOSTIC
    it.BurnedInAnnotation = "YES"
    if photo.method is not None:
        it.LossyImageCompression = "01"
        it.LossyImageCompressionMethod = photo.method
        it.LossyImageCompressionRatio = f"{photo.ratio:.2f}"
    it.SamplesPerPixel, it.PhotometricInterpretation = 1, "MONOCHROME2"
    it.Rows, it.Columns = picture.shape
    it.BitsAllocated = it.BitsStored = 16
    it.HighBit, it.PixelRepresentation = 15, 0
    it.WindowCenter, it.WindowWidth = 2**15, 2**16
    it.PixelData = levels_16(picture).astype("<u2").tobytes()
    it.file_meta = FileMetaDataset()
    it.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    return it


def _uid(*parts: str) -> str:
    """An identifier derived from what it identifies (PS3.5 B.2)."""
    return f"2.25.{uuid.uuid5(uuid.NAMESPACE_OID, '/'.join(parts)).int}"


__all__ = ["PhotoFile", "secondary_captures"]
