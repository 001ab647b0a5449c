"""A pydicom decoder plug-in for 12-bit JPEG (transfer syntax JPEG Extended), which pydicom's own plug-ins refuse.

GDCM decodes such frames exactly as libjpeg-turbo does; pydicom's plug-in for GDCM rejects them without trying.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

from pydicom.pixels.decoders.base import JPEGExtended12BitDecoder
from pydicom.uid import JPEGExtended12Bit

LABEL = "gdcm_12_bit"
STDERR = 2
DECODER_DEPENDENCIES = {JPEGExtended12Bit: ("python-gdcm>=3.0",)}


def is_available(uid: str) -> bool:
    """Whether frames of this transfer syntax can be decoded here (called by pydicom)."""
    return uid in DECODER_DEPENDENCIES and find_spec("gdcm") is not None


def register() -> None:
    """Makes the plug-in known to pydicom; a second call changes nothing."""
    if LABEL not in (*JPEGExtended12BitDecoder.available_plugins, *JPEGExtended12BitDecoder.missing_dependencies):
        JPEGExtended12BitDecoder.add_plugin(LABEL, (__name__, "decode_frame"))


def decode_frame(source: bytes, runner: Any) -> bytes:
    """The little-endian 16-bit pixels of one compressed frame; ``runner`` is pydicom's, with the header's numbers."""
    import gdcm

    if runner.bits_stored <= 8 or runner.samples_per_pixel != 1:
        raise NotImplementedError("only grey frames of more than 8 bits")
    fragment = gdcm.Fragment()
    fragment.SetByteStringValue(source)
    fragments = gdcm.SequenceOfFragments.New()
    fragments.AddFragment(fragment)
    pixels = gdcm.DataElement(gdcm.Tag(0x7FE0, 0x0010))
    pixels.SetValue(fragments.__ref__())
    image = gdcm.Image()
    image.SetNumberOfDimensions(2)
    image.SetDimensions((runner.columns, runner.rows, 1))
    image.SetDataElement(pixels)
    grey = gdcm.PhotometricInterpretation.GetPIType(runner.photometric_interpretation)
    image.SetPhotometricInterpretation(gdcm.PhotometricInterpretation(grey))
    image.SetTransferSyntax(gdcm.TransferSyntax(gdcm.TransferSyntax.GetTSType(str(JPEGExtended12Bit))))
    bits = runner.bits_stored
    image.SetPixelFormat(gdcm.PixelFormat(1, runner.bits_allocated, bits, bits - 1, runner.pixel_representation))
    with _silent():
        return image.GetBuffer().encode("utf-8", "surrogateescape")  # GDCM's wrapper gives bytes as text


@contextmanager
def _silent() -> Iterator[None]:
    """Silence this process's standard error.

    GDCM first tries its 8-bit JPEG library on each frame, which prints "Unsupported JPEG data precision 12" whatever
    GDCM's own switches say; then it decodes with its 12-bit one.
    """
    sys.stderr.flush()
    kept, nowhere = os.dup(STDERR), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, STDERR)
        yield
    finally:
        os.dup2(kept, STDERR)
        os.close(kept)
        os.close(nowhere)


__all__ = ["DECODER_DEPENDENCIES", "LABEL", "decode_frame", "is_available", "register"]
