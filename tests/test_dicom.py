"""DICOM: orientation, order, units and refusals, on files written here and on real ones where available."""

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hybrid.errors import DataError

pydicom = pytest.importorskip("pydicom", reason="pydicom is not installed")

from data_gen.ct.dicom import read_all  # noqa: E402
from data_gen.ct.folder import load_volumes  # noqa: E402
from data_gen.ct.volumes import CtVolume  # noqa: E402

SHARED = os.environ.get("HYBRID_SHARED_DATA")
AXIAL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
SHAPE = (24, 20)


def anatomy(z: int) -> np.ndarray:
    """HU that tell all corners and slices apart: the right front is bright, the rest rises from air with position."""
    rows, cols = np.indices(SHAPE)
    hu = 10 * rows + cols + 100 * z - 1000
    hu[:3, :3] = 1000
    return hu


def write(path: Path, stored: np.ndarray, z_mm: float, **header: object) -> Path:
    """A CT file with intercept -1024; ``header`` replaces or (None) removes attributes."""
    meta = pydicom.dataset.FileMetaDataset()
    meta.MediaStorageSOPClassUID = pydicom.uid.CTImageStorage
    meta.MediaStorageSOPInstanceUID = pydicom.uid.generate_uid()
    meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    values: dict[str, object] = {
        "SOPClassUID": pydicom.uid.CTImageStorage,
        "SOPInstanceUID": meta.MediaStorageSOPInstanceUID,
        "Modality": "CT",
        "ImageType": ["ORIGINAL", "PRIMARY", "AXIAL"],
        "SeriesInstanceUID": "1.2.3",
        "ImageOrientationPatient": list(AXIAL),
        "ImagePositionPatient": [-10.0, -12.0, z_mm],
        "PixelSpacing": [0.5, 0.75],
        "SliceThickness": 5.0,
        "RescaleSlope": 1,
        "RescaleIntercept": -1024,
        "Rows": stored.shape[0],
        "Columns": stored.shape[1],
        "SamplesPerPixel": 1,
        "PhotometricInterpretation": "MONOCHROME2",
        "BitsAllocated": 16,
        "BitsStored": 16,
        "HighBit": 15,
        "PixelRepresentation": 0,
        "PixelData": stored.astype("<u2").tobytes(),
    }
    dataset = pydicom.dataset.Dataset()
    dataset.file_meta = meta
    for name, value in {**values, **header}.items():
        if value is not None:
            setattr(dataset, name, value)
    dataset.save_as(path, enforce_file_format=True)
    return path


def volumes_of(path: Path) -> tuple[CtVolume, ...]:
    return read_all(path).volumes


def write_stack(folder: Path, order: list[int], **header: object) -> None:
    folder.mkdir(exist_ok=True)
    for name, z in enumerate(order):
        write(folder / f"{name:03d}.dcm", anatomy(z) + 1024, 4.0 * z, **header)


@pytest.fixture
def expected() -> np.ndarray:
    return np.stack([anatomy(z) for z in range(5)]).astype(np.int16)


def test_slices_are_sorted_by_position_not_by_name(tmp_path: Path, expected: np.ndarray):
    write_stack(tmp_path / "ct", [3, 0, 4, 2, 1])
    (volume,) = volumes_of(tmp_path / "ct")
    assert np.array_equal(volume.hu, expected)
    assert volume.spacing_mm == (4.0, 0.5, 0.75)


@pytest.mark.parametrize(
    ("orientation", "turn"),
    [
        ((1, 0, 0, 0, -1, 0), lambda a: a[::-1]),
        ((-1, 0, 0, 0, 1, 0), lambda a: a[:, ::-1]),
        ((-1, 0, 0, 0, -1, 0), lambda a: a[::-1, ::-1]),
        ((0, 1, 0, 1, 0, 0), lambda a: a.T),
        ((0, -1, 0, 1, 0, 0), lambda a: a.T[:, ::-1]),
    ],
)
def test_every_axial_orientation_is_turned_upright(tmp_path: Path, expected: np.ndarray, orientation, turn):
    for z in range(5):
        spacing = [0.5, 0.75] if orientation[0] else [0.75, 0.5]
        header = {"ImageOrientationPatient": list(orientation), "PixelSpacing": spacing}
        write(tmp_path / f"{z}.dcm", turn(anatomy(z)) + 1024, 4.0 * z, **header)
    (volume,) = volumes_of(tmp_path)
    assert np.array_equal(volume.hu, expected)
    assert volume.spacing_mm == (4.0, 0.5, 0.75)


def test_a_tilted_gantry_gives_distances_along_the_normal(tmp_path: Path, expected: np.ndarray):
    tilt = np.deg2rad(20.0)
    orientation = [1.0, 0.0, 0.0, 0.0, float(np.cos(tilt)), float(np.sin(tilt))]
    write_stack(tmp_path, list(range(5)), ImageOrientationPatient=orientation)
    (volume,) = volumes_of(tmp_path)
    assert np.array_equal(volume.hu, expected)
    assert np.isclose(volume.spacing_mm[0], 4.0 * np.cos(tilt))


def test_monochrome1_does_not_change_hounsfield_units(tmp_path: Path, expected: np.ndarray):
    write_stack(tmp_path, list(range(5)), PhotometricInterpretation="MONOCHROME1")
    assert np.array_equal(volumes_of(tmp_path)[0].hu, expected)


def test_slope_intercept_and_padding(tmp_path: Path):
    stored = np.full(SHAPE, 600)
    stored[:4] = 63536  # -2000 as a signed number
    write(tmp_path / "a.dcm", stored, 0.0, RescaleSlope=2, RescaleIntercept=-1000, PixelPaddingValue=63536)
    (volume,) = volumes_of(tmp_path / "a.dcm")
    assert np.all(volume.hu[0, 4:] == 200)
    assert np.all(volume.hu[0, :4] == -2048)


def test_modality_lut(tmp_path: Path):
    lut = pydicom.dataset.Dataset()
    lut.LUTDescriptor = [4, 0, 16]
    lut.ModalityLUTType = "HU"
    lut.LUTData = np.array([0, 100, 200, 700], "<u2").tobytes()
    header = {"RescaleSlope": None, "RescaleIntercept": None, "ModalityLUTSequence": [lut]}
    write(tmp_path / "a.dcm", np.indices(SHAPE)[1] % 4, 0.0, **header)
    assert np.array_equal(np.unique(volumes_of(tmp_path / "a.dcm")[0].hu), [0, 100, 200, 700])


def test_series_are_kept_apart_and_scouts_left_out(tmp_path: Path):
    write_stack(tmp_path / "one", [0, 1, 2])
    write_stack(tmp_path / "two", [0, 1, 2, 3], SeriesInstanceUID="1.2.4")
    write(tmp_path / "scout.dcm", anatomy(0), 0.0, ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"])
    write(tmp_path / "coronal.dcm", anatomy(0), 0.0, ImageOrientationPatient=[1, 0, 0, 0, 0, -1])
    write(tmp_path / "twice.dcm", anatomy(9), 4.0)
    reading = read_all(tmp_path)
    assert [len(v.hu) for v in reading.volumes] == [4, 3]
    assert {r.reason for r in reading.refusals} == {
        "a scout view",
        "not an axial slice",
        "a second slice at the same position",
    }


def test_uneven_distances_are_resampled_and_said(tmp_path: Path):
    """A missing slice of a linear ramp is restored exactly."""
    write_stack(tmp_path, [0, 1, 2, 4, 5])
    reading = read_all(tmp_path)
    (volume,) = reading.volumes
    assert np.array_equal(volume.hu[:, 5:, 5:], np.stack([anatomy(z) for z in range(6)])[:, 5:, 5:])
    assert volume.spacing_mm[0] == 4.0
    assert len(reading.notes) == 1
    assert "from 4 to 8 mm, resampled at 4 mm" in reading.notes[0]


def test_wide_gaps_cut_a_series(tmp_path: Path):
    write_stack(tmp_path, [0, 1, 2, 7, 8])
    reading = read_all(tmp_path)
    assert [len(v.hu) for v in reading.volumes] == [3, 2]
    assert "1 gap(s)" in reading.notes[0]


def test_mixed_orientations_are_kept_apart(tmp_path: Path):
    """A head scanned straight below and with a tilted gantry above gives two volumes."""
    write_stack(tmp_path / "straight", [0, 1, 2])
    write_stack(tmp_path / "tilted", [3, 4], ImageOrientationPatient=[1.0, 0.0, 0.0, 0.0, 0.94, 0.3412])
    assert [len(v.hu) for v in read_all(tmp_path).volumes] == [3, 2]


def test_files_of_the_standard_before_dicom_are_read(tmp_path: Path):
    """ACR-NEMA: no preamble, no photometric interpretation, geometry under retired tags."""
    path = write(tmp_path / "a.dcm", anatomy(0) + 1024, 4.0)
    dataset = pydicom.dcmread(path)
    dataset.add_new((0x20, 0x35), "DS", dataset.ImageOrientationPatient)
    dataset.add_new((0x20, 0x30), "DS", dataset.ImagePositionPatient)
    for name in ("ImageOrientationPatient", "ImagePositionPatient", "PhotometricInterpretation", "SamplesPerPixel"):
        delattr(dataset, name)
    del dataset.file_meta
    dataset.save_as(path, implicit_vr=True, little_endian=True)
    (volume,) = volumes_of(path)
    assert np.array_equal(volume.hu[0], anatomy(0))


@pytest.mark.parametrize(
    ("header", "reason"),
    [
        ({"Modality": "MR"}, "modality 'MR' is not CT"),
        ({"PixelSpacing": None}, "no pixel spacing"),
        ({"PixelSpacing": [0.0, 1.0]}, "unusable pixel spacing"),
        ({"ImagePositionPatient": None}, "no slice position"),
        ({"ImageOrientationPatient": None}, "no orientation"),
        ({"ImageOrientationPatient": [0, 0, 0, 0, 0, 0]}, "unusable orientation"),
        ({"RescaleSlope": None}, "Hounsfield units unknown"),
        ({"RescaleType": "Z_EFF"}, "something else than Hounsfield units"),
        ({"RescaleSlope": 0.001}, "a mask or an empty image"),
        ({"PixelData": None}, "no pixels"),
        ({"PixelData": b"\0\0"}, "truncated"),
        ({"NumberOfFrames": 7}, "truncated"),
    ],
)
def test_unusable_files_are_refused_with_a_reason(tmp_path: Path, header: dict, reason: str):
    reading = read_all(write(tmp_path / "a.dcm", anatomy(0), 0.0, **header))
    assert not reading.volumes
    assert reason in " ".join(refusal.reason for refusal in reading.refusals)


def test_what_is_no_dicom_is_refused_and_never_crashes(tmp_path: Path):
    rng = np.random.default_rng(0)
    whole = write(tmp_path / "whole.dcm", anatomy(0), 0.0).read_bytes()
    (tmp_path / "empty.dcm").write_bytes(b"")
    (tmp_path / "text.dcm").write_text("not DICOM at all " * 30)
    (tmp_path / "noise.dcm").write_bytes(rng.bytes(5000))
    (tmp_path / "magic.dcm").write_bytes(b"\0" * 128 + b"DICM" + rng.bytes(300))
    (tmp_path / "bad.zip").write_bytes(b"PK\x03\x04" + rng.bytes(200))
    for cut in range(140, len(whole), 97):
        (tmp_path / f"cut{cut}.dcm").write_bytes(whole[:cut])
    for k in range(40):
        broken = bytearray(whole)
        for at in rng.integers(132, min(700, len(whole)), 6):
            broken[at] = rng.integers(256)
        (tmp_path / f"broken{k}.dcm").write_bytes(bytes(broken))
    reading = read_all(tmp_path)
    assert len(reading.refusals) > 10
    assert all(refusal.reason for refusal in reading.refusals)
    assert not read_all(tmp_path / "empty.dcm").volumes
    with pytest.raises(DataError, match="no such"):
        read_all(tmp_path / "nowhere")


def test_zips_are_read_and_load_volumes_finds_them(tmp_path: Path, expected: np.ndarray):
    write_stack(tmp_path / "ct", list(range(5)))
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for path in (tmp_path / "ct").iterdir():
            archive.write(path, f"inside/{path.name}")
            path.unlink()
    (volume,) = load_volumes(tmp_path)
    assert np.array_equal(volume.hu, expected)


def test_no_identity_in_names_and_reasons(tmp_path: Path):
    write_stack(tmp_path, [0, 1, 2], PatientName="Doe^Jane", PatientID="4711", SeriesInstanceUID="1.2.4711")
    write(tmp_path / "z.dcm", anatomy(0), 0.0, Modality="MR", PatientName="Doe^Jane", PatientID="4711")
    reading = read_all(tmp_path)
    said = " ".join([v.name for v in reading.volumes] + [r.reason for r in reading.refusals])
    assert "Doe" not in said
    assert "4711" not in said


@pytest.mark.skipif(SHARED is None, reason="HYBRID_SHARED_DATA is not set: no real DICOM files")
def test_a_real_tilted_series_agrees_with_its_volume():
    folder = Path(str(SHARED))
    (volume,) = volumes_of(folder / "dicom" / "head_cptacgbm_C3L02465.zip")
    with np.load(folder / "ct" / "head_cptacgbm_C3L02465.npz") as data:
        assert volume.hu.shape == data["hu"].shape
        assert np.allclose(volume.spacing_mm, data["spacing_mm"], rtol=1e-4)
        dense = data["hu"] > -900
        assert np.array_equal(volume.hu[dense], data["hu"][dense])


@pytest.mark.skipif(SHARED is None, reason="HYBRID_SHARED_DATA is not set: no real DICOM files")
def test_real_odd_files_are_read_or_refused():
    """Every file is read, or refused with the reason stated here."""
    refused = {
        "c3d_CT0012_fragmented_no_bot": "perfusion",
        "c3d_no_pixel_spacing": "'US' is not CT",
        "dcmqi_enhancedCT_multiframe_3": "a mask",
        "pydicom_CT_no_meta": "damaged header",
        "pydicom_ExplVR_BigEnd_RGB_US": "'US' is not CT",
        "pydicom_MR_truncated": "'MR' is not CT",
        "pydicom_RTPLAN_no_pixels": "'RTPLAN' is not CT",
        "pydicom_SEG_1bit": "'SEG' is not CT",
        "pydicom_deflated_OT": "'OT' is not CT",
        "pydicomdata_VOI_LUT": "'OT' is not CT",
        "pydicomdata_eCT_multiframe": "perfusion",
        "pydicomdata_modality_LUT": "'OT' is not CT",
        "tcia_CT_coronal": "not an axial slice",
        "tcia_CT_sagittal": "not an axial slice",
    }
    single = Path(str(SHARED)) / "dicom" / "single"
    for path in sorted(single.glob("*.dcm")):
        reading = read_all(path)
        if path.stem in refused:
            assert not reading.volumes, path
            assert refused[path.stem] in reading.refusals[0].reason
        else:
            assert len(reading.volumes) == 1, (path, reading.refusals)
    mixed = read_all(next(single.glob("mixed*.zip")))
    assert [len(v.hu) for v in mixed.volumes] == [18]
    assert [r.reason for r in mixed.refusals] == ["a scout view"]


@pytest.mark.skipif(SHARED is None, reason="HYBRID_SHARED_DATA is not set: no real DICOM files")
@pytest.mark.parametrize(
    ("kind", "typical_hu", "largest_hu"),
    [("bigendian", 0, 0), ("deflated", 0, 0), ("rle", 0, 0), ("jls", 0, 0), ("jls_near", 1, 1), ("jpegll_p14", 0, 0),
     ("jpegll_sv1", 0, 0), ("j2k_lossless", 0, 0), ("j2k", 2, 8), ("jpeg12", 4, 40)],
)  # fmt: skip
def test_every_encoding_of_a_ct_gives_the_same_units(
    kind: str, typical_hu: int, largest_hu: int, capfd: pytest.CaptureFixture[str]
):
    """Lossless syntaxes agree exactly, lossy ones to within their own quantisation. Decoders print nothing."""
    single = Path(str(SHARED)) / "dicom" / "single"
    plain, other = (volumes_of(single / f"c3d_CT_{name}.dcm")[0].hu.astype(int) for name in ("implicit", kind))
    error = np.abs(other - plain)
    assert np.median(error) <= typical_hu
    assert error.max() <= largest_hu
    assert capfd.readouterr() == ("", "")
