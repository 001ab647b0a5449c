"""Photos in: every format of phones and scanners is read, and other files are clearly refused. Pictures out."""

from __future__ import annotations

import io
import os
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from PIL.ExifTags import Base

from hybrid.errors import PhotoError
from hybrid.image_io import MAX_PIXELS, as_photo, read_photo, write_film, write_rgb
from hybrid.jpeg import jpeg_extent

LOSSLESS = 0.0
JPEG_GREY_LEVELS = 2.0  # mean error of a smooth picture at quality 95, with another decoder's rounding


@pytest.fixture
def picture() -> np.ndarray:
    """(60, 90, 3) uint8: smooth, and with a different colour in each corner, so that a wrong turn shows."""
    y, x = np.mgrid[0:60, 0:90]
    return np.stack([255 * x / 89, 255 * y / 59, 128 + 100 * np.sin(x / 20)], axis=-1).astype(np.uint8)


def mean_difference(a: np.ndarray, b: np.ndarray) -> float:
    assert a.shape == b.shape
    return float(np.abs(a.astype(float) - b).mean())


# ---------------------------------------------------------------- formats


@pytest.mark.parametrize(
    ("name", "options", "tolerance"),
    [
        ("a.png", {}, LOSSLESS),
        ("a.tif", {}, LOSSLESS),
        ("a.tif", {"compression": "tiff_lzw"}, LOSSLESS),
        ("a.bmp", {}, LOSSLESS),
        ("a.webp", {"lossless": True}, LOSSLESS),
        ("a.jpg", {"quality": 95, "subsampling": 0}, JPEG_GREY_LEVELS),
        ("a.jpeg", {"quality": 95, "progressive": True, "subsampling": 0}, JPEG_GREY_LEVELS),
        ("wrong_suffix.png", {"format": "JPEG", "quality": 95, "subsampling": 0}, JPEG_GREY_LEVELS),
    ],
)
def test_formats_agree(tmp_path: Path, picture: np.ndarray, name: str, options: dict, tolerance: float) -> None:
    Image.fromarray(picture).save(tmp_path / name, **options)
    photo = read_photo(tmp_path / name)
    assert photo.dtype == np.uint8
    assert mean_difference(photo, picture) <= tolerance


def test_heic(tmp_path: Path, picture: np.ndarray) -> None:
    pillow_heif = pytest.importorskip("pillow_heif")
    pillow_heif.register_heif_opener()
    try:
        Image.fromarray(picture).save(tmp_path / "a.heic", quality=95)
    except (KeyError, OSError, RuntimeError) as error:
        pytest.skip(f"this build of libheif cannot write HEIC: {error}")
    assert mean_difference(read_photo(tmp_path / "a.heic"), picture) <= 3 * JPEG_GREY_LEVELS  # chroma is subsampled


@pytest.mark.parametrize("exif", [b"Exif\x00\x00garbage", b"Exif\x00\x00MM\x00*"])
@pytest.mark.parametrize("suffix", ["jpg", "png", "webp"])
def test_damaged_exif_costs_no_picture(tmp_path: Path, picture: np.ndarray, suffix: str, exif: bytes) -> None:
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(picture).save(path, exif=exif, **({"lossless": True} if suffix == "webp" else {"quality": 95}))
    assert mean_difference(read_photo(path), picture) <= (JPEG_GREY_LEVELS if suffix == "jpg" else LOSSLESS)


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_undone(tmp_path: Path, picture: np.ndarray, suffix: str, orientation: int) -> None:
    # The stored picture is the upright one after the inverse of the tag's transform (EXIF 2.3, table 4.6.4).
    stored = {
        1: picture,
        2: np.fliplr(picture),
        3: np.rot90(picture, 2),
        4: np.flipud(picture),
        5: picture.transpose(1, 0, 2),
        6: np.rot90(picture, 1),
        7: np.rot90(picture.transpose(1, 0, 2), 2),
        8: np.rot90(picture, -1),
    }[orientation]
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / f"a.{suffix}"
    options = {"jpg": {"quality": 95, "subsampling": 0}, "webp": {"lossless": True}}.get(suffix, {})
    Image.fromarray(np.ascontiguousarray(stored)).save(path, exif=exif, **options)
    assert mean_difference(read_photo(path), picture) <= (JPEG_GREY_LEVELS if suffix == "jpg" else LOSSLESS)


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
def test_grey_becomes_three_equal_channels(tmp_path: Path, picture: np.ndarray, suffix: str) -> None:
    Image.fromarray(picture[..., 0]).save(tmp_path / f"a.{suffix}")
    photo = read_photo(tmp_path / f"a.{suffix}")
    assert photo.shape == picture.shape
    assert np.ptp(photo, axis=2).max() == 0


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_16_bit_grey_is_scaled(tmp_path: Path, picture: np.ndarray, suffix: str) -> None:
    cv2.imwrite(str(tmp_path / f"a.{suffix}"), picture[..., 0].astype(np.uint16) * 257)
    assert np.array_equal(read_photo(tmp_path / f"a.{suffix}")[..., 2], picture[..., 0])


@pytest.mark.parametrize("mode", ["L", "I;16", "RGB", "RGBA", "CMYK", "P"])
def test_an_uncompressed_tiff_on_its_side_is_turned(tmp_path: Path, mode: str) -> None:
    """The picture is not square, since in a square one a skewed reading would not show."""
    grey = np.add.outer(3 * np.arange(40), 2 * np.arange(30)).astype(np.uint8)
    levels = Image.fromarray(grey.astype(np.uint16) * 257) if mode == "I;16" else Image.fromarray(grey).convert(mode)
    for orientation, turned in ((6, np.rot90(grey, -1)), (8, np.rot90(grey))):
        exif = Image.Exif()
        exif[0x0112] = orientation
        levels.save(tmp_path / "a.tif", exif=exif)
        assert np.abs(read_photo(tmp_path / "a.tif")[..., 1].astype(int) - turned).max() <= 1


@pytest.mark.parametrize("bits", [8, 16])
def test_a_tiff_of_densities_is_no_negative(tmp_path: Path, bits: int) -> None:
    """PhotometricInterpretation 0, as film digitisers write it: 0 is white."""
    grey = np.add.outer(3 * np.arange(40), 2 * np.arange(30)).astype(np.uint16)
    stored = (255 - grey).astype(np.uint8) if bits == 8 else ((255 - grey) * 257).astype(np.uint16)
    write_tiff(tmp_path / "a.tif", stored, photometric=0)
    assert np.array_equal(read_photo(tmp_path / "a.tif")[..., 0], grey)
    write_tiff(tmp_path / "b.tif", stored, photometric=1)
    assert np.array_equal(read_photo(tmp_path / "b.tif")[..., 0], 255 - grey)


def test_12_bits_of_grey_are_scaled(tmp_path: Path) -> None:
    """Digitisers pack two levels into three bytes; Pillow reads the levels without scaling them."""
    grey = np.add.outer(3 * np.arange(40), 2 * np.arange(30)).astype(np.uint16)
    levels = np.rint(grey * (4095 / 255)).astype(np.uint32).reshape(-1, 2)
    pairs = levels[:, 0] << 12 | levels[:, 1]
    packed = np.stack([pairs >> 16, pairs >> 8, pairs], axis=-1).astype(np.uint8).tobytes()
    write_strip(tmp_path / "a.tif", packed, grey.shape, 12, photometric=1)
    assert np.array_equal(read_photo(tmp_path / "a.tif")[..., 0], grey)
    write_strip(tmp_path / "b.tif", packed, grey.shape, 12, photometric=0)  # white is zero: Pillow cannot read these
    with pytest.raises(PhotoError, match=r"b\.tif"):
        read_photo(tmp_path / "b.tif")


def write_tiff(path: Path, grey: np.ndarray, photometric: int) -> None:
    write_strip(path, grey.tobytes(), grey.shape, 8 * grey.itemsize, photometric)


def write_strip(path: Path, strip: bytes, size: tuple[int, ...], bits: int, photometric: int) -> None:
    """A little-endian TIFF of one uncompressed strip."""
    height, width = size
    tags = {256: width, 257: height, 258: bits, 259: 1, 262: photometric, 273: 8}
    tags |= {277: 1, 278: height, 279: len(strip)}
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    head = struct.pack("<2sHI", b"II", 42, 8 + len(strip))
    path.write_bytes(head + strip + struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0))


def planar_tiff(picture: np.ndarray) -> bytes:
    """An uncompressed TIFF of 16 bits with one plane per colour."""
    height, width = picture.shape[:2]
    planes = (picture.astype("<u2") * 257).transpose(2, 0, 1)
    first = 8 + 2 + 9 * 12 + 4
    lists = struct.pack(
        "<3H3I3I", 16, 16, 16, *(first + 30 + k * planes[0].nbytes for k in range(3)), *[planes[0].nbytes] * 3
    )
    tags = [
        *((256, 4, 1, width), (257, 4, 1, height), (258, 3, 3, first), (259, 3, 1, 1), (262, 3, 1, 2)),
        *((273, 4, 3, first + 6), (277, 3, 1, 3), (279, 4, 3, first + 18), (284, 3, 1, 2)),
    ]
    directory = b"".join(struct.pack("<HHII", *tag) for tag in tags)
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + directory + bytes(4) + lists + planes.tobytes()


def test_planes_of_16_bits_are_refused_and_not_misread(tmp_path: Path, picture: np.ndarray) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(planar_tiff(picture))
    with Image.open(path) as image:  # Pillow misreads it
        assert mean_difference(np.asarray(image), picture) > 20
    with pytest.raises(PhotoError, match="plane for each colour"):
        read_photo(path)


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_16_bit_colour_is_scaled(tmp_path: Path, picture: np.ndarray, suffix: str) -> None:
    cv2.imwrite(str(tmp_path / f"a.{suffix}"), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR).astype(np.uint16) * 257)
    assert np.array_equal(read_photo(tmp_path / f"a.{suffix}"), picture)


def test_transparency_lies_over_black(tmp_path: Path, picture: np.ndarray) -> None:
    alpha = np.full((*picture.shape[:2], 1), 255, dtype=np.uint8)
    alpha[:, :30] = 0
    Image.fromarray(np.concatenate([picture, alpha], axis=2)).save(tmp_path / "a.png")
    photo = read_photo(tmp_path / "a.png")
    assert photo[:, :30].max() == 0
    assert np.array_equal(photo[:, 30:], picture[:, 30:])


def test_palette_and_bilevel(tmp_path: Path, picture: np.ndarray) -> None:
    Image.fromarray(picture).quantize(200).save(tmp_path / "a.png")
    assert mean_difference(read_photo(tmp_path / "a.png"), picture) < 12  # 200 colours for a smooth picture
    Image.fromarray(picture).convert("1").save(tmp_path / "b.png")
    assert set(np.unique(read_photo(tmp_path / "b.png"))) == {0, 255}


@pytest.mark.parametrize("suffix", ["jpg", "tif"])
def test_cmyk_keeps_light_light(tmp_path: Path, picture: np.ndarray, suffix: str) -> None:
    Image.fromarray(picture).convert("CMYK").save(tmp_path / f"a.{suffix}", quality=95)
    assert mean_difference(read_photo(tmp_path / f"a.{suffix}"), picture) < 3 * JPEG_GREY_LEVELS


def test_hundred_megapixels_are_read(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.jpg"), np.full((10_000, 10_000), 7, dtype=np.uint8))
    photo = read_photo(tmp_path / "a.jpg")
    assert photo.shape == (10_000, 10_000, 3)
    assert photo[0, 0, 0] == photo[-1, -1, 2] == 7


def test_pillows_own_limit_neither_stops_a_large_photo_nor_changes(
    tmp_path: Path, picture: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    Image.fromarray(picture).save(tmp_path / "a.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)  # 54 times fewer than the picture has: Pillow would refuse
    assert np.array_equal(read_photo(tmp_path / "a.png"), picture)
    assert Image.MAX_IMAGE_PIXELS == 100


# ---------------------------------------------------------------- refusals


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match=r"No such file \(.*gone\.jpg\)\. Check the name"):
        read_photo(tmp_path / "gone.jpg")


def test_folder(tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match=r"a folder, not a photo \(.*\)\. Name photos, or a folder"):
        read_photo(tmp_path)


def test_empty_file(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").touch()
    with pytest.raises(PhotoError, match=r"file is empty \(.*a\.jpg\)\. Copy it .*once more"):
        read_photo(tmp_path / "a.jpg")


def test_text_renamed(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_text("These are not the pixels you are looking for.")
    with pytest.raises(PhotoError, match=r"a\.jpg.*got text; allowed: JPEG.*Export the photo again"):
        read_photo(tmp_path / "a.jpg")


def test_pdf_and_noise(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"%PDF-1.7 and so on")
    with pytest.raises(PhotoError, match="got a PDF"):
        read_photo(tmp_path / "a.png")
    (tmp_path / "b.png").write_bytes(np.random.default_rng(0).bytes(5000))
    with pytest.raises(PhotoError, match="got unknown data"):
        read_photo(tmp_path / "b.png")


def test_a_dicom_file_is_called_one(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(bytes(128) + b"DICM" + bytes(400))
    with pytest.raises(PhotoError, match="DICOM file"):
        read_photo(tmp_path / "a.jpg")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_what_can_be_read_only_once_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.jpg")
    with pytest.raises(PhotoError, match="no regular file"):
        read_photo(tmp_path / "a.jpg")


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "a.webp"])
@pytest.mark.parametrize("share", [0.97, 0.5, 0.1])
def test_truncated_file(tmp_path: Path, name: str, share: float) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / name)
    data = (tmp_path / name).read_bytes()
    data = data[: int(share * len(data))]
    if name.endswith("jpg"):  # a thumbnail in the EXIF segment ends with an end marker of its own
        segment = b"Exif\0\0 thumbnail \xff\xd9"
        data = data[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2, "big") + segment + data[2:]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(PhotoError, match=r"a\.\w+.*(Export the photo again|once more)"):
        read_photo(tmp_path / name)


@pytest.mark.parametrize("quality", [75, 98])
@pytest.mark.parametrize("share", [0.9, 0.8, 0.5])
def test_a_jpeg_whose_end_was_never_written_is_refused(tmp_path: Path, share: float, quality: int) -> None:
    """An interrupted copy can leave a file of full length: its end is zeros, which a decoder takes for pixels."""
    smooth = np.add.outer(np.arange(300), np.arange(400))[..., None] * np.array([0.2, 0.3, 0.35])
    noise = np.random.default_rng(1).normal(0, 6, (300, 400, 3))
    Image.fromarray(np.clip(smooth + noise, 0, 255).astype(np.uint8)).save(tmp_path / "a.jpg", quality=quality)
    data = (tmp_path / "a.jpg").read_bytes()
    kept = int(share * len(data))
    (tmp_path / "a.jpg").write_bytes(data[:kept] + bytes(len(data) - kept))
    with pytest.raises(PhotoError, match=r"damaged or cut off.*once more"):
        read_photo(tmp_path / "a.jpg")


def test_the_extent_of_a_jpeg_is_that_of_its_own_picture(tmp_path: Path, picture: np.ndarray) -> None:
    for mode, colours in (("L", 1), ("RGB", 3)):
        Image.fromarray(picture).convert(mode).save(tmp_path / "a.jpg")
        data = (tmp_path / "a.jpg").read_bytes()
        assert jpeg_extent(data) == (colours, len(data))
        assert jpeg_extent(data + b"a film that a phone hangs on \xff\xd9") == (colours, len(data))
    assert jpeg_extent(b"\x89PNG") is None


def test_one_pixel(tmp_path: Path) -> None:
    Image.new("RGB", (1, 1)).save(tmp_path / "a.png")
    Image.new("RGB", (1, 1)).save(tmp_path / "a.jpg")
    for name in ("a.png", "a.jpg"):
        with pytest.raises(PhotoError, match=r"too small.*1 x 1 pixels.*1000 x 1000"):
            read_photo(tmp_path / name)


def test_absurd_size_is_refused_before_decoding(tmp_path: Path, picture: np.ndarray) -> None:
    Image.fromarray(picture).save(tmp_path / "a.jpg")
    data = bytearray((tmp_path / "a.jpg").read_bytes())
    frame = data.index(b"\xff\xc0")
    data[frame + 5 : frame + 9] = (60_000).to_bytes(2, "big") * 2
    (tmp_path / "a.jpg").write_bytes(data)
    with pytest.raises(PhotoError, match=rf"60000 x 60000 pixels; allowed: up to {MAX_PIXELS // 10**6} megapixels"):
        read_photo(tmp_path / "a.jpg")


def test_32_bit_picture_is_refused(tmp_path: Path) -> None:
    Image.fromarray(np.linspace(0, 1, 100, dtype=np.float32).reshape(10, 10)).save(tmp_path / "a.tif")
    with pytest.raises(PhotoError, match=r"32 bits per channel.*8 or 16 bit"):
        read_photo(tmp_path / "a.tif")


# ---------------------------------------------------------------- arrays


def test_array_passes_unchanged(picture: np.ndarray) -> None:
    before = picture.copy()
    assert np.array_equal(as_photo(picture), before)
    assert np.array_equal(as_photo(picture[..., 0]), np.stack([before[..., 0]] * 3, axis=-1))
    assert np.array_equal(picture, before)


def test_path_as_text(tmp_path: Path, picture: np.ndarray) -> None:
    Image.fromarray(picture).save(tmp_path / "a.png")
    assert np.array_equal(as_photo(str(tmp_path / "a.png")), picture)


def test_a_picture_of_pillows_is_read_as_its_file_would_be(tmp_path: Path, picture: np.ndarray) -> None:
    exif = Image.Exif()
    exif[Base.Orientation] = 6
    Image.fromarray(picture).save(tmp_path / "a.png", exif=exif)
    with Image.open(tmp_path / "a.png") as opened:
        assert np.array_equal(as_photo(opened), read_photo(tmp_path / "a.png"))
        assert opened.size == picture.shape[1::-1]  # not modified
    grey = Image.fromarray(picture[..., 0])
    assert np.array_equal(as_photo(grey), as_photo(picture[..., 0]))


def test_a_damaged_picture_of_pillows_is_refused(tmp_path: Path, picture: np.ndarray) -> None:
    Image.fromarray(picture).save(tmp_path / "a.png")
    data = (tmp_path / "a.png").read_bytes()
    with pytest.raises(PhotoError, match=r"damaged or cut off \(Pillow image\): got"):
        as_photo(Image.open(io.BytesIO(data[: len(data) // 2])))
    with pytest.raises(PhotoError, match=r"too small \(Pillow image\)"):
        as_photo(Image.new("RGB", (1, 1)))


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.full((9, 9, 3), np.nan), r"float64 of shape \(9, 9, 3\).*holds NaN"),
        (np.zeros((9, 9, 3)), r"\(255 \* photo\)\.round\(\)\.astype"),
        (np.zeros((9, 9, 3), np.uint16), r"photo / 257"),
        (np.zeros((9, 9, 3), bool), r"got bool.*allowed: a path, or a uint8 array"),
        (np.zeros((9, 9, 4), np.uint8), r"Drop the alpha channel"),
        (np.zeros((9, 9, 1), np.uint8), r"photo\[:, :, 0\]"),
        (np.zeros((3, 9, 9), np.uint8), r"transpose\(1, 2, 0\)"),
        (np.zeros((2, 9, 9, 3), np.uint8), r"one by one"),
        (np.zeros(9, np.uint8), r"shape \(9,\)"),
        (np.zeros((0, 9, 3), np.uint8), r"too small.*0 x 9"),
        (np.zeros((1, 1, 3), np.uint8), r"too small.*1 x 1"),
        ([[0, 1], [2, 3]], r"got a list.*np\.asarray"),
        (None, r"got a NoneType"),
    ],
)
def test_bad_array(array: object, message: str) -> None:
    with pytest.raises(PhotoError, match=message):
        as_photo(array)


def test_absurd_array() -> None:
    with pytest.raises(PhotoError, match="too large"):
        as_photo(np.broadcast_to(np.uint8(0), (30_000, 30_000)))


# ---------------------------------------------------------------- pictures out


def test_film_round_trip_to_16_bits(tmp_path: Path) -> None:
    film = np.random.default_rng(2).random((40, 30)).astype(np.float32)
    write_film(tmp_path / "a.png", film)
    levels = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    assert levels.dtype == np.uint16
    assert np.abs(levels / 65535 - film).max() <= 0.51 / 65535  # half a level, and float32's own rounding


def test_film_with_nan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="NaN in 1 pixels"):
        write_film(tmp_path / "a.png", np.array([[0.0, np.nan]], dtype=np.float32))
    assert not list(tmp_path.iterdir())


def test_rgb_round_trip(tmp_path: Path, picture: np.ndarray) -> None:
    write_rgb(tmp_path / "a.png", picture)
    write_rgb(tmp_path / "a.jpg", picture)
    assert np.array_equal(read_photo(tmp_path / "a.png"), picture)
    assert mean_difference(read_photo(tmp_path / "a.jpg"), picture) < 2 * JPEG_GREY_LEVELS
    with pytest.raises(ValueError, match=r"suffix '\.gif'.*allowed: \.jpg"):
        write_rgb(tmp_path / "a.gif", picture)


def test_arrays_with_gaps_are_packed_and_left_as_they_are():
    source = np.random.default_rng(0).integers(0, 256, (80, 90, 4), np.uint8)
    before = source.copy()
    photo = as_photo(source[..., :3])
    assert photo.flags.c_contiguous
    np.testing.assert_array_equal(photo, before[..., :3])
    np.testing.assert_array_equal(source, before)
