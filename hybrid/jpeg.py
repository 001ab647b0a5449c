"""What a JPEG says of itself before its pixels, and where it ends: read from its bytes, without decoding it."""

from __future__ import annotations

from dataclasses import dataclass

JPEG_START, _JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"

_SCAN = 0xDA
"""The marker after which pixels follow."""

_NO_FRAMES = (0xC4, 0xC8, 0xCC)
"""Markers among those of frames, 0xC0 to 0xCF, that stand for something else."""


@dataclass(frozen=True)
class JpegHeader:
    """Size, number of colour components, and the byte where the first scan starts."""

    height: int
    width: int
    components: int
    scan_start: int


def jpeg_header(data: bytes) -> JpegHeader | None:
    """Walk the segments of a JPEG up to its first scan; None for another format or a header that makes no sense.

    Thumbnails inside the EXIF segment are skipped, so their end marker is not taken for the photo's.
    """
    if not data.startswith(JPEG_START):
        return None
    frame: tuple[int, int, int] | None = None
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # fill bytes before a marker
            at += 1
            continue
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        body = data[at + 4 : at + 10]
        if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAMES and len(body) == 6:
            frame = (int.from_bytes(body[1:3], "big"), int.from_bytes(body[3:5], "big"), body[5])
        at += 2 + length
        if marker == _SCAN:
            return JpegHeader(*frame, scan_start=at) if frame else None
    return None


def jpeg_end(data: bytes, header: JpegHeader) -> int | None:
    """Number of bytes up to the picture's end; None if it has none, as a truncated file."""
    end = data.find(_JPEG_END, header.scan_start)
    return None if end < 0 else end + len(_JPEG_END)


def jpeg_extent(data: bytes) -> tuple[int, int] | None:
    """Number of colours of a JPEG, and number of bytes up to its end; None for other files.

    What phones append to it, such as video clips and brightness maps, is separate from the picture.
    """
    header = jpeg_header(data)
    return None if header is None else (header.components, jpeg_end(data, header) or len(data))


__all__ = ["JPEG_START", "JpegHeader", "jpeg_end", "jpeg_extent", "jpeg_header"]
