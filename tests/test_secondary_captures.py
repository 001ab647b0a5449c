"""Export as DICOM (failure 29): valid Secondary Captures that say what they are made of and invent nothing."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pillow_heif
import pydicom
import pytest
from PIL import Image
from pydicom.dataset import Dataset
from test_cli import StandIn

from hybrid.dicom import AV1, JPEG, JPEG_2000, PhotoFile, lossy_method, secondary_captures
from hybrid.errors import HybridError
from hybrid.image_io import levels_16, read_photo, write_rgb
from hybrid.outputs import is_result, photo_digest, save_result
from hybrid.records import LeftOut, RectifyResult, SliceGrid, Status, StatusCode

FILE = PhotoFile("0" * 64, 12.5, "ISO_10918_1")
INVENTED = (
    *("PixelSpacing", "ImagerPixelSpacing", "NominalScannedPixelSpacing", "PixelAspectRatio", "SliceThickness"),
    *("ImagePositionPatient", "ImageOrientationPatient", "FrameOfReferenceUID", "SliceLocation"),
    *("RescaleSlope", "RescaleIntercept", "RescaleType"),
)
UNKNOWN = ("PatientName", "PatientID", "PatientBirthDate", "PatientSex", "StudyDate", "StudyTime", "AccessionNumber")


@pytest.fixture
def result() -> RectifyResult:
    picture = np.random.default_rng(3).integers(0, 255, (61, 92, 3), dtype=np.uint8)
    return replace(StandIn()(picture), status=Status(StatusCode.UNSURE, ("3 of 4 edges seen",)))


def captures(result: RectifyResult, photo: PhotoFile = FILE) -> list[Dataset]:
    return list(secondary_captures(result, photo))


def test_film_and_slices_hold_the_film_s_greys(result: RectifyResult):
    film, *slices = captures(result)
    np.testing.assert_array_equal(film.pixel_array, levels_16(result.film))
    assert len(slices) == len(result.slices()) == 6
    for k, (capture, cell) in enumerate(zip(slices, result.slices(), strict=True), start=1):
        np.testing.assert_array_equal(capture.pixel_array, levels_16(cell))
        assert (capture.SeriesNumber, capture.InstanceNumber) == (2, k)
    levels = pydicom.pixels.apply_voi_lut(film.pixel_array, film)
    np.testing.assert_allclose(levels, film.pixel_array, atol=1)  # the window is the whole range


def test_they_say_what_they_are_and_invent_nothing(result: RectifyResult):
    for it in captures(result):
        assert it.SOPClassUID == pydicom.uid.SecondaryCaptureImageStorage
        assert it.ConversionType == "DF"
        assert list(it.ImageType) == ["DERIVED", "SECONDARY"]
        assert (it.Modality, it.BurnedInAnnotation, it.LossyImageCompression) == ("OT", "YES", "01")
        assert float(it.LossyImageCompressionRatio) == pytest.approx(12.5)
        assert it.PhotometricInterpretation == "MONOCHROME2"  # larger values are brighter
        assert "photo" in it.ImageComments
        assert "Not for diagnosis" in it.ImageComments
        assert "3 of 4 edges seen" in it.DerivationDescription
        assert all(it[name].is_empty for name in UNKNOWN)
        assert not [name for name in INVENTED if name in it]


def test_a_photo_without_loss_is_not_called_compressed(result: RectifyResult):
    assert all("LossyImageCompression" not in it for it in captures(result, replace(FILE, method=None)))


@pytest.mark.parametrize(
    ("kind", "options", "method"),
    [
        ("JPEG", {}, "ISO_10918_1"),
        ("HEIF", {}, "ISO_23008_2"),
        ("WEBP", {"quality": 80}, "RFC_9649"),
        ("WEBP", {"quality": 80, "icc_profile": b"none"}, "RFC_9649"),  # the picture is not the first chunk
        ("WEBP", {"lossless": True}, None),
        ("PNG", {}, None),
        ("TIFF", {}, None),
    ],
)
def test_loss_is_told_by_what_a_file_holds_not_by_its_name(kind, options, method, tmp_path: Path):
    pillow_heif.register_heif_opener()
    photo = tmp_path / "photo.jfif"
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)).save(photo, kind, **options)
    told = PhotoFile.of([photo], "0" * 64)
    assert told.method == method
    assert told.ratio == pytest.approx(3 * 64 * 64 / photo.stat().st_size)


def test_the_ratio_of_a_grey_jpeg_and_of_one_with_something_behind_it_is_its_own(tmp_path: Path):
    photo = tmp_path / "photo.jpg"
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (64, 64), np.uint8)).save(photo)
    size = photo.stat().st_size
    photo.write_bytes(photo.read_bytes() + bytes(3 * size))
    assert PhotoFile.of([photo], "0" * 64).ratio == pytest.approx(64 * 64 / size)


def brighter(result: RectifyResult) -> RectifyResult:
    return replace(result, film=np.clip(result.film + np.float32(0.1), 0, 1))


def test_identifiers_follow_from_what_they_are_of(result: RectifyResult):
    first, again = captures(result), captures(result)
    assert [it.SOPInstanceUID for it in first] == [it.SOPInstanceUID for it in again]
    assert len({it.SOPInstanceUID for it in first}) == len(first)
    other_photo, other_film = captures(result, replace(FILE, digest="1" * 64)), captures(brighter(result))
    for others in (other_photo, other_film):
        assert not {it.SOPInstanceUID for it in first} & {it.SOPInstanceUID for it in others}
        assert not {it.SeriesInstanceUID for it in first} & {it.SeriesInstanceUID for it in others}
    assert {it.StudyInstanceUID for it in first} == {it.StudyInstanceUID for it in other_film}
    assert {it.StudyInstanceUID for it in first} != {it.StudyInstanceUID for it in other_photo}
    assert len({it.SeriesInstanceUID for it in first}) == 2
    other = captures(replace(result, film=1 - result.film))
    assert {it.StudyInstanceUID for it in other} == {it.StudyInstanceUID for it in first}
    assert not {it.SOPInstanceUID for it in other} & {it.SOPInstanceUID for it in first}
    assert not {it.StudyInstanceUID for it in captures(result, replace(FILE, digest="1" * 64))} & {
        it.StudyInstanceUID for it in first
    }
    assert all(pydicom.uid.UID(it.SOPInstanceUID).is_valid for it in first)


def test_without_a_grid_the_film_alone_and_without_a_film_nothing(result: RectifyResult):
    assert len(captures(replace(result, grid=None))) == 1
    assert captures(RectifyResult(Status(StatusCode.NO_FILM))) == []


def test_slices_of_another_grid_have_other_identifiers(result: RectifyResult):
    grid = result.grid
    other = SliceGrid(1, 1, grid.vertices[[0, -1]][:, [0, -1]], grid.vertices_photo[[0, -1]][:, [0, -1]], 1.0)
    first, others = captures(result), captures(replace(result, grid=other))
    assert not {it.SOPInstanceUID for it in first[1:]} & {it.SOPInstanceUID for it in others[1:]}


@pytest.mark.parametrize(
    ("name", "options", "method"),
    [
        ("a.avif", {"quality": 60}, AV1),
        ("a.jp2", {"irreversible": True, "quality_layers": [40]}, JPEG_2000),
        ("b.jp2", {}, None),
        ("a.tif", {"compression": "jpeg"}, JPEG),
        ("b.tif", {}, None),
    ],
)
def test_files_say_how_they_were_compressed_with_loss(name: str, options: dict, method: str | None, tmp_path: Path):
    picture = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    Image.fromarray(picture).save(tmp_path / name, **options)
    assert lossy_method((tmp_path / name).read_bytes()) == method


def test_files_can_be_read_and_belong_to_the_result(result: RectifyResult, tmp_path: Path):
    photo = tmp_path / "film.png"
    write_rgb(photo, result.rectified)
    files = save_result(photo, result, tmp_path / "out", dicom=True)
    names = [file.relative_to(tmp_path / "out").as_posix() for file in files if file.suffix == ".dcm"]
    assert names == ["film_dicom/film.dcm", *(f"film_dicom/{k:02d}.dcm" for k in range(1, 7))]
    assert set(names) <= set(json.loads((tmp_path / "out" / "film.json").read_text())["files"])
    it = pydicom.dcmread(tmp_path / "out" / names[0])
    assert it.file_meta.TransferSyntaxUID == pydicom.uid.ExplicitVRLittleEndian
    assert it.file_meta.MediaStorageSOPInstanceUID == it.SOPInstanceUID
    np.testing.assert_array_equal(it.pixel_array, levels_16(result.film))
    assert is_result(tmp_path / "out" / names[1])
    with pytest.raises(HybridError):  # a DICOM file that was written as a result is not taken for a photo
        read_photo(tmp_path / "out" / names[0])
    before = (tmp_path / "out" / names[0]).read_bytes()
    save_result(photo, result, tmp_path / "out", dicom=True)
    assert (tmp_path / "out" / names[0]).read_bytes() == before
    save_result(photo, result, tmp_path / "out")  # asks for no DICOM files, and removes none
    assert (tmp_path / "out" / names[0]).read_bytes() == before
    assert json.loads((tmp_path / "out" / "film.json").read_text())["earlier_files"] == names
    assert is_result(tmp_path / "out" / names[1])
    save_result(photo, replace(result, grid=None), tmp_path / "out", dicom=True)
    assert [name for name in names if (tmp_path / "out" / name).exists()] == names[:1]


def test_a_fused_film_belongs_to_the_photo_that_its_map_is_of(result: RectifyResult, tmp_path: Path):
    """Its files identify the study by that photo, be it the first or the second, a JPEG."""
    for name in ("first.png", "second.jpg"):
        write_rgb(tmp_path / name, result.rectified)
    both = [tmp_path / "first.png", tmp_path / "second.jpg"]
    studies = []
    for photo in (0, 1):
        files = save_result(both, replace(result, photo=photo, photos=2), tmp_path / f"out{photo}", dicom=True)
        of = pydicom.dcmread(next(file for file in files if file.name == "film.dcm"))
        digest = photo_digest(both[photo])
        assert of.StudyInstanceUID == captures(result, replace(FILE, digest=digest))[0].StudyInstanceUID
        studies.append(of)
    for of in studies:  # the film has pixels of both, whichever photo the map is of
        assert of.LossyImageCompression == "01"
        bytes_of_pixels = result.rectified.nbytes
        assert float(of.LossyImageCompressionRatio) == pytest.approx(bytes_of_pixels / both[1].stat().st_size, abs=0.01)
    write_rgb(tmp_path / "third.png", result.rectified)
    both[1] = tmp_path / "third.png"
    files = save_result(both, replace(result, photo=0, photos=2), tmp_path / "whole", dicom=True)
    assert "LossyImageCompression" not in pydicom.dcmread(next(file for file in files if file.name == "film.dcm"))


def test_photos_that_are_left_out_of_a_fused_film_are_no_part_of_it(result: RectifyResult, tmp_path: Path):
    """A JPEG among them does not make the film lossily compressed."""
    paths = [tmp_path / name for name in ("blank.jpg", "small.png", "big.png")]
    for path in paths:
        write_rgb(path, result.rectified)
    fused = replace(result, photo=1, photos=3, left_out=(LeftOut(0, "no film was found in it"),))
    files = save_result(paths, fused, tmp_path / "out", dicom=True)
    film = pydicom.dcmread(next(file for file in files if file.name == "film.dcm"))
    assert "LossyImageCompression" not in film
    digest = photo_digest(paths[1])
    assert film.StudyInstanceUID == captures(result, replace(FILE, digest=digest))[0].StudyInstanceUID
    record = json.loads(files[-1].read_text())
    assert files[-1].name == "blank_fused.json"
    assert (record["photo"], record["further_photos"], record["left_out"]) == ("small.png", ["big.png"], ["blank.jpg"])
    assert (record["photo_sha256"], record["left_out_sha256"]) == (digest, [photo_digest(paths[0])])


def test_a_tiff_that_is_larger_than_pillow_takes_says_how_it_was_compressed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    picture = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    Image.fromarray(picture).save(tmp_path / "a.tif", compression="jpeg")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)  # from twice as many on, Pillow refuses a picture
    assert PhotoFile.of([tmp_path / "a.tif"], "0" * 64).method == JPEG
