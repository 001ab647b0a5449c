"""Pictures from and to files: the only module of the package that opens a photo."""

from __future__ import annotations

import io
import os
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

import cv2
import numpy as np
from jaxtyping import Float, UInt8, UInt16
from PIL import Image, ImageOps, UnidentifiedImageError

from hybrid.coords import rgb_from_bgr
from hybrid.errors import PhotoError, describe
from hybrid.files import write_bytes
from hybrid.jpeg import JPEG_START, jpeg_end, jpeg_header

MAX_PIXELS = 400_000_000
"""Larger pictures are refused: no phone makes them, and decoding one takes gigabytes."""

MIN_SIDE = 2
"""A picture of a single row or column of pixels is not a photo."""

PHOTOMETRIC, WHITE_IS_ZERO = 262, 0
"""The TIFF tag that says what a grey value means, and its value for films that were scanned as densities."""

BITS, COMPRESSION, PLANES = 258, 259, 284
"""Further tags. Pillow reads uncompressed (1) planes (2) of 16 bits as if they had 8."""

READABLE = "JPEG, PNG, TIFF, WebP or HEIC"
SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".heic", ".heif", ".avif", ".bmp", ".jp2")
_NOTHING_WRITTEN = 64
"""A JPEG that ends in this many zeros was never written to its end; pixels seldom make more than four."""
_DAMAGED = "The picture is damaged or cut off"
_JPEG_QUALITY = 95
_PNG_LEVEL = 3  # drawings shrink to a third of what OpenCV's own options leave; the film's noise hardly shrinks more
_TAKE_AGAIN = f"Export the photo again as {READABLE}, or copy it from the phone once more."
_BOMB_LOCK = threading.Lock()


# ---------------------------------------------------------------- photos in


PhotoSource: TypeAlias = str | os.PathLike[str] | np.ndarray | Image.Image
"""What a photo is given as: a path; (H, W, 3) uint8 RGB; (H, W) uint8 grey; or a Pillow image."""


def as_photo(source: Any) -> UInt8[np.ndarray, "h w 3"]:
    """The photo as (H, W, 3) uint8 RGB, upright: from a path, or from pixels that are checked and never modified.

    source: as in ``PhotoSource``. Grey is repeated for the three channels. A Pillow image is turned upright by its EXIF
    orientation, as files are (``read_photo``). Raises PhotoError, which says what to do, for anything else.
    """
    if isinstance(source, (str, os.PathLike)):
        return read_photo(source)
    if isinstance(source, Image.Image):
        with _damage_told("Pillow image"):
            return _pixels(source, "Pillow image")
    if not isinstance(source, np.ndarray):
        _refuse_array(f"a {type(source).__name__}", "Pass a path or a numpy array; np.asarray(photo) makes one.")
    got = f"{source.dtype} of shape {source.shape}"
    if source.dtype != np.uint8:
        _refuse_array(got, _how_to_uint8(source))
    if source.ndim != 2 and not (source.ndim == 3 and source.shape[2] == 3):
        _refuse_array(got, _how_to_reshape(source.shape))
    _check_size(source.shape[0], source.shape[1], "array")
    if source.ndim == 2:
        return np.repeat(source[:, :, None], 3, axis=2)
    return np.ascontiguousarray(source)  # otherwise OpenCV copies all of it at every call


def read_photo(path: str | os.PathLike[str]) -> UInt8[np.ndarray, "h w 3"]:
    """The photo in a file as (H, W, 3) uint8 sRGB, turned upright by its EXIF orientation.

    Reads JPEG, PNG, TIFF, WebP, HEIC and whatever else Pillow reads, and the first of several frames. Grey and palettes
    become RGB, 16 bits are scaled to 8, CMYK is converted without a profile (embedded colour profiles are not applied),
    and transparency is laid over black, because a transparent pixel sends no light. Raises PhotoError for what is no
    picture or ends too early. A JPEG that is damaged inside but has an end is read: decoders fill in what is lost.
    """
    path = Path(path)
    data = _read_if_jpeg(path)
    header = jpeg_header(data)
    if header is None:
        return _decode_with_pillow(path)
    _check_size(header.height, header.width, path)
    unended = jpeg_end(data, header) is None
    if unended and data.endswith(bytes(_NOTHING_WRITTEN)):  # within a scan, a decoder takes zeros for pixels
        got = "zeros where the picture should end"
        raise PhotoError(describe(what=_DAMAGED, where=path, got=got, do=_TAKE_AGAIN))
    if header.components not in (1, 3) or unended:
        return _decode_with_pillow(path)  # CMYK; or no end marker: Pillow tells a truncated file from an untidy one
    # OpenCV reads a JPEG twice as fast as Pillow, and turns it upright as well.
    photo = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR_RGB)
    return _decode_with_pillow(path) if photo is None else photo


def pictures_in(path: str | os.PathLike[str]) -> int:
    """How many pictures the file of a photo holds, as TIFFs may have several pages; one for a JPEG."""
    with Path(path).open("rb") as file:
        if file.read(len(JPEG_START)) == JPEG_START:
            return 1
        try:
            with _pillow_limits(), Image.open(file) as image:
                return getattr(image, "n_frames", 1)
        except Exception:  # the photo itself was read: it does no harm if Pillow cannot tell of the others
            return 1


def photo_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Height and width, as stored, of the picture in a file that was read before."""
    with opened(path) as image:
        return image.height, image.width


@contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[Image.Image]:
    """The picture in a file that was read before, opened for its header; no pixel is decoded."""
    with _pillow_limits():
        try:
            image = Image.open(path)
        except UnidentifiedImageError:  # HEIC, whose reader need not be loaded for a JPEG
            _hear_of_heif()
            image = Image.open(path)
        with image:
            yield image


def tiff_compression(data: bytes) -> int | None:
    """How the pixels of a TIFF that was read before are compressed, by its tag 259; None if it does not say."""
    with _pillow_limits(), Image.open(io.BytesIO(data)) as image:
        return getattr(image, "tag_v2", {}).get(COMPRESSION)


def _read_if_jpeg(path: Path) -> bytes:
    """The whole file if it is a JPEG, else its first bytes; PhotoError if it is not a file, or empty."""
    try:
        if not path.exists():
            _refuse_file("No such file", path, "Check the name and the folder.")
        if path.is_dir():
            _refuse_file(
                "This is a folder, not a photo", path, f"Name photos, or a folder that holds some ({READABLE})."
            )
        if not path.is_file():
            _refuse_file("This is no regular file", path, "Save the photo to a file first: it is read more than once.")
        with path.open("rb") as file:
            start = file.read(len(JPEG_START))
            data = start + file.read() if start == JPEG_START else start
    except OSError as error:
        raise PhotoError(
            describe(what="The photo cannot be opened", where=path, got=error.strerror, do="Check its permissions.")
        ) from error
    if not data:
        _refuse_file("The file is empty", path, "Copy it from the phone once more.")
    return data


@contextmanager
def _pillow_limits() -> Iterator[None]:
    """Inside, this package's own limit replaces Pillow's, which refuses above 179 megapixels and warns above 89."""
    with _BOMB_LOCK, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # damaged EXIF and metadata: the picture itself is checked
        before, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            yield
        finally:
            Image.MAX_IMAGE_PIXELS = before


def _hear_of_heif() -> None:
    """Make Pillow read HEIC; called when a file may need it, so that nothing runs at import."""
    import pillow_heif

    pillow_heif.register_heif_opener()


def _decode_with_pillow(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    _hear_of_heif()
    try:
        # Opened by name, Pillow maps uncompressed TIFFs into memory, and reads them skewed if they lie on their side.
        with _damage_told(path), _pillow_limits(), path.open("rb") as file, Image.open(file) as image:
            return _pixels(image, path)
    except UnidentifiedImageError as error:
        what = "The file is not a picture that can be read"
        raise PhotoError(
            describe(what=what, where=path, got=_kind_of(path), allowed=READABLE, do=_TAKE_AGAIN)
        ) from error


@contextmanager
def _damage_told(where: object) -> Iterator[None]:
    """Turn whatever Pillow raises on a damaged picture into a PhotoError, unless it does not take it for a picture."""
    try:
        yield
    except (PhotoError, MemoryError, UnidentifiedImageError):
        raise
    except Exception as error:  # a damaged file makes Pillow's many readers raise nearly anything
        raise PhotoError(describe(what=_DAMAGED, where=where, got=f"'{error}'", do=_TAKE_AGAIN)) from error


def _pixels(image: Image.Image, where: object) -> UInt8[np.ndarray, "h w 3"]:
    """The pixels of a picture that Pillow has opened, upright."""
    _check_size(image.height, image.width, where)
    tags = getattr(image, "tag_v2", {})
    if (tags.get(PLANES), tags.get(COMPRESSION)) == (2, 1) and 16 in tags.get(BITS, ())[1:]:
        do = "Save it with the colours of each pixel together, or with 8 bits."
        raise PhotoError(describe(what="The TIFF has 16 bits and a plane for each colour", where=where, do=do))
    image.load()
    return _rgb_from_pillow(image, where)


def _rgb_from_pillow(picture: Image.Image, where: object) -> UInt8[np.ndarray, "h w 3"]:
    try:
        image = ImageOps.exif_transpose(picture)
    except Exception:  # damaged EXIF, on which Pillow raises nearly anything, says nothing about the picture
        image = picture
    if image.mode.startswith("I;16"):
        tags = getattr(picture, "tag_v2", {})
        most = 2 ** tags.get(BITS, (16,))[0] - 1  # 12 bits are read unscaled, too
        grey = np.rint(np.asarray(image, dtype=np.float32) * np.float32(255 / most)).astype(np.uint8)
        if tags.get(PHOTOMETRIC) == WHITE_IS_ZERO:  # Pillow inverts 8 bits, not 16
            grey = 255 - grey
        return np.repeat(grey[:, :, None], 3, axis=2)
    if image.mode in ("I", "F"):
        do = "Save it with 8 or 16 bits per channel, whole range used."
        raise PhotoError(describe(what="The picture has 32 bits per channel", where=where, got=image.mode, do=do))
    if image.mode in ("RGBA", "LA", "PA", "La", "RGBa") or "transparency" in image.info:
        clear = image.convert("RGBA")
        black = Image.new("RGBA", clear.size, (0, 0, 0, 255))
        image = Image.alpha_composite(black, clear)
    return np.array(image.convert("RGB"))


def _kind_of(path: Path) -> str:
    """What a file that is not a picture seems to be, in words."""
    with path.open("rb") as file:
        start = file.read(512)
    if start.startswith(b"%PDF"):
        return "a PDF"
    if start[128:132] == b"DICM":
        return "a DICOM file, not a photo of a film"
    try:
        start.decode("utf-8")
    except UnicodeDecodeError:
        return "unknown data"
    return "unknown data" if b"\0" in start else "text"


# ---------------------------------------------------------------- refusals


def _refuse_file(what: str, path: Path, do: str) -> NoReturn:
    raise PhotoError(describe(what=what, where=path, do=do))


def _refuse_array(got: str, do: str) -> NoReturn:
    allowed = "a path, or a uint8 array of shape (H, W, 3) in RGB or (H, W), or a picture of Pillow's"
    raise PhotoError(describe(what="The photo cannot be used", got=got, allowed=allowed, do=do))


def _check_size(height: int, width: int, where: object) -> None:
    if min(height, width) < MIN_SIDE:
        do = "Use a photo of 1000 x 1000 pixels or more."
        raise PhotoError(describe(what="The photo is too small", where=where, got=f"{height} x {width} pixels", do=do))
    if height * width > MAX_PIXELS:
        raise PhotoError(
            describe(
                what="The photo is too large",
                where=where,
                got=f"{height} x {width} pixels",
                allowed=f"up to {MAX_PIXELS // 1_000_000} megapixels",
                do="Scale it down first.",
            )
        )


def _how_to_uint8(array: np.ndarray) -> str:
    if np.issubdtype(array.dtype, np.floating):
        if not np.isfinite(array).all():
            return "It holds NaN or infinity: repair those pixels, then use (255 * photo).round().astype(np.uint8)."
        return "For values in [0, 1] use (255 * photo).round().astype(np.uint8)."
    if array.dtype == np.uint16:
        return "For the whole 16-bit range use (photo / 257).round().astype(np.uint8)."
    return "Convert it with photo.astype(np.uint8) after scaling to 0..255."


def _how_to_reshape(shape: tuple[int, ...]) -> str:
    if len(shape) == 3 and shape[2] == 4:
        return "Drop the alpha channel: photo[:, :, :3]."
    if len(shape) == 3 and shape[2] == 1:
        return "Drop the last axis: photo[:, :, 0]."
    if len(shape) == 3 and shape[0] == 3:
        return "Put the channels last: photo.transpose(1, 2, 0)."
    if len(shape) == 4:
        return "Pass the photos of a batch one by one."
    return "Pass one photo, height first, colour channels last."


# ---------------------------------------------------------------- pictures out


def write_film(path: str | os.PathLike[str], film: Float[np.ndarray, "h w"]) -> None:
    """Write display grey as a 16-bit grey PNG; see ``levels_16``. A level that saves 3 % more takes twice the time."""
    write_bytes(path, _encoded(".png", levels_16(film)))


def levels_16(film: Float[np.ndarray, "h w"]) -> UInt16[np.ndarray, "h w"]:
    """Display grey in [0, 1] in 16 bits; values outside are clipped; NaN raises ValueError."""
    if np.isnan(film).any():
        raise ValueError(f"film: got NaN in {int(np.isnan(film).sum())} pixels; allowed: numbers in [0, 1]")
    return np.rint(np.clip(film, 0.0, 1.0) * 65535).astype(np.uint16)


def write_rgb(path: str | os.PathLike[str], rgb: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write an RGB picture in the format of the name's suffix (.jpg, .jpeg or .png); ValueError for any other."""
    suffix = Path(path).suffix.lower()
    options = {
        ".jpg": [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY],
        ".jpeg": [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY],
        ".png": [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL],
    }
    if suffix not in options:
        raise ValueError(f"write_rgb: got the suffix {suffix!r} ({path}); allowed: {', '.join(options)}")
    write_bytes(path, _encoded(suffix, rgb_from_bgr(rgb), options[suffix]))


def write_grey(path: str | os.PathLike[str], shares: Float[np.ndarray, "h w"]) -> None:
    """Write numbers in [0, 1] as an 8-bit grey PNG."""
    write_bytes(path, _encoded(".png", np.rint(np.clip(shares, 0.0, 1.0) * 255).astype(np.uint8)))


def _encoded(suffix: str, image: np.ndarray, options: Sequence[int] = ()) -> bytes:
    """The picture as a file, with OpenCV's own options if none are given."""
    done, buffer = cv2.imencode(suffix, image, options)
    if not done:
        raise ValueError(f"a picture of shape {image.shape} cannot be written as {suffix}")
    return buffer.tobytes()


__all__ = [
    "MAX_PIXELS",
    "MIN_SIDE",
    "PhotoSource",
    "as_photo",
    "levels_16",
    "opened",
    "photo_size",
    "pictures_in",
    "read_photo",
    "tiff_compression",
    "write_film",
    "write_grey",
    "write_rgb",
]
