"""Volumes: other planes, the .npz reader and its refusals."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

nibabel = pytest.importorskip("nibabel", reason="nibabel is not installed")

from data_gen.ct.folder import load_volumes, read_npz, with_left_out  # noqa: E402
from data_gen.ct.nifti import NotCtError, read_nifti  # noqa: E402
from data_gen.ct.volumes import CtVolume, is_body, reformatted, tissue_width_mm, within_patient  # noqa: E402
from data_gen.prints.prints import PrintConfig, make_print  # noqa: E402
from hybrid.errors import DataError  # noqa: E402

SHARED = os.environ.get("HYBRID_SHARED_DATA")


def cylinder(diameter_mm: float, spacing_mm: float = 2.0) -> CtVolume:
    """Water in air, 6 slices of 256 x 256."""
    axis = (np.arange(256) - 127.5) * spacing_mm
    disc = np.hypot(*np.meshgrid(axis, axis)) < diameter_mm / 2
    hu = np.where(disc, 0, -1000).astype(np.int16)
    return CtVolume(np.repeat(hu[None], 6, axis=0), (5.0, spacing_mm, spacing_mm), "cylinder")


def save(path: Path, **arrays: object) -> Path:
    np.savez(path, **arrays)
    return path


def test_other_planes_have_the_head_at_the_top():
    """One voxel, identified by its place along the axes: caudal to cranial, front to back, right to left."""
    hu = np.full((3, 5, 7), -1000, np.int16)
    hu[2, 1, 6] = 500  # cranial, near the front, at the left
    volume = CtVolume(hu, (3.0, 2.0, 1.0), "one")
    coronal, sagittal = reformatted(volume, "coronal"), reformatted(volume, "sagittal")
    assert (coronal.hu.shape, coronal.spacing_mm) == ((5, 3, 7), (2.0, 3.0, 1.0))
    assert coronal.hu[1, 0, 6] == 500
    assert (sagittal.hu.shape, sagittal.spacing_mm) == ((7, 3, 5), (1.0, 3.0, 2.0))
    assert sagittal.hu[6, 0, 1] == 500
    assert reformatted(volume, "axial") is volume


def test_slices_beside_the_patient_are_left_out():
    """Air in front of a cylinder, and a thin table behind it, apart from it."""
    volume = cylinder(200.0)  # 100 voxels across, the 78th to the 177th
    hu = volume.hu.copy()
    hu[:, 200:206, 60:196] = 0
    coronal = reformatted(replace(volume, hu=hu), "coronal")
    inside = within_patient(coronal)
    first = int(np.flatnonzero([np.array_equal(slice_, inside.hu[0]) for slice_ in coronal.hu])[0])
    assert 78 <= first < 85
    assert 88 < len(inside.hu) <= 100
    assert ((inside.hu == 0).mean(axis=(1, 2)) > 0.05).all()
    assert inside.spacing_mm == coronal.spacing_mm
    np.testing.assert_array_equal(within_patient(volume).hu, volume.hu)  # axial slices all show it


@pytest.mark.parametrize("diameter_mm", [150.0, 400.0])
def test_width_of_a_cylinder_and_what_it_is_taken_for(diameter_mm: float):
    volume = cylinder(diameter_mm)
    assert abs(tissue_width_mm(volume) - diameter_mm) < 4 * 2 * 2.0  # two of the coarse voxels it looks at
    assert is_body(volume) == (diameter_mm > 300)


def test_npz_round_trip(tmp_path: Path):
    volume = cylinder(200.0)
    path = save(
        tmp_path / "a.npz", hu=volume.hu, spacing_mm=np.array(volume.spacing_mm), meta=json.dumps({"name": "x"})
    )
    got = read_npz(path)
    assert np.array_equal(got.hu, volume.hu)
    assert got.spacing_mm == volume.spacing_mm
    assert got.name == "x"


def test_the_name_of_a_file_reaches_no_data_set(tmp_path: Path):
    """The name may be a patient's."""
    volume = cylinder(200.0)
    path = save(tmp_path / "Jane Doe.npz", hu=volume.hu, spacing_mm=np.array(volume.spacing_mm))
    read = read_npz(path)
    printed = make_print(read, np.random.default_rng(0), PrintConfig()).parameters
    assert printed["volume"] == read.label
    assert "Jane" not in json.dumps(printed)
    assert read_npz(path).label == read.label


def test_npz_damaged_or_foreign_is_refused_with_the_path(tmp_path: Path):
    (tmp_path / "text.npz").write_text("no zip")
    (tmp_path / "empty.npz").write_bytes(b"")
    cases = [
        tmp_path / "text.npz",
        tmp_path / "empty.npz",
        tmp_path / "missing.npz",
        save(tmp_path / "foreign.npz", lattice=np.zeros(3)),
        save(tmp_path / "flat.npz", hu=np.zeros((4, 4), np.int16), spacing_mm=np.ones(3)),
        save(tmp_path / "spacing.npz", hu=np.zeros((4, 4, 4), np.int16), spacing_mm=np.array([1.0, -1.0, 1.0])),
        save(tmp_path / "two.npz", hu=np.zeros((4, 4, 4), np.int16), spacing_mm=np.ones(2)),
        save(tmp_path / "words.npz", hu=np.array(["a"]), spacing_mm=np.ones(3)),
    ]
    for path in cases:
        with pytest.raises(DataError, match=path.stem):
            read_npz(path)


def test_load_volumes_finds_files_in_folders_in_order(tmp_path: Path):
    (tmp_path / "sub").mkdir()
    volume = cylinder(200.0)
    for name in ("b.npz", "sub/a.npz"):
        save(tmp_path / name, hu=volume.hu, spacing_mm=np.array(volume.spacing_mm))
    assert [v.name for v in load_volumes(tmp_path)] == ["b", "a"]


def test_load_volumes_says_what_to_do_where_nothing_is(tmp_path: Path):
    with pytest.raises(DataError, match="no volume"):
        load_volumes(tmp_path)
    with pytest.raises(DataError, match="no such folder"):
        load_volumes(tmp_path / "nowhere")


# ---------------------------------------------------------------- NIfTI

AXES = {"R": (0, 1), "L": (0, -1), "A": (1, 1), "P": (1, -1), "S": (2, 1), "I": (2, -1)}


def scan() -> CtVolume:
    """A volume whose corners can be told apart."""
    hu = np.random.default_rng(0).integers(-1000, 1000, (3, 6, 5)).astype(np.int16)
    return CtVolume(hu, (5.0, 0.8, 0.7), "scan")


def save_nifti(path: Path, volume: CtVolume, codes: str, dtype: type = np.int16) -> Path:
    """The volume stored with its axes along ``codes`` (a letter per axis, as nibabel names them)."""
    ras = volume.hu.T[::-1, ::-1]  # CtVolume runs to the left, to the back, upwards
    lengths = volume.spacing_mm[::-1]
    affine = np.eye(4)
    affine[:3, :3] = 0
    order = []
    for axis, code in enumerate(codes):
        world, sign = AXES[code]
        order.append(world)
        affine[world, axis] = sign * lengths[world]
    data = ras.transpose(order)[tuple(slice(None, None, AXES[code][1]) for code in codes)]
    nibabel.save(nibabel.Nifti1Image(data.astype(dtype), affine), path)
    return path


@pytest.mark.parametrize("codes", ["RAS", "LPS", "LAS", "RPI", "SLP", "PSR"])
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_nifti_is_turned_by_its_affine(tmp_path: Path, codes: str, suffix: str):
    volume = scan()
    (got,) = load_volumes(save_nifti(tmp_path / f"a{suffix}", volume, codes).parent)
    assert np.array_equal(got.hu, volume.hu)
    assert np.allclose(got.spacing_mm, volume.spacing_mm)


def test_nifti_names_tell_nothing_of_the_file_name(tmp_path: Path):
    path = save_nifti(tmp_path / "DOE_JANE_4711.nii.gz", scan(), "RAS", np.float32)
    assert "DOE" not in read_nifti(path).name
    assert read_nifti(path).name == read_nifti(path).name


def test_nifti_that_is_no_ct_is_refused_with_a_reason(tmp_path: Path):
    volume = scan()
    mask = CtVolume((volume.hu > 0).astype(np.int16), volume.spacing_mm, "mask")
    mr = CtVolume(np.abs(volume.hu), volume.spacing_mm, "mr")
    flat = CtVolume(volume.hu, (0.8, 5.0, 0.7), "coronal")
    for path, reason in [
        (save_nifti(tmp_path / "mask.nii.gz", mask, "RAS"), "a mask"),
        (save_nifti(tmp_path / "mr.nii", mr, "RAS"), "no value below"),
        (save_nifti(tmp_path / "coronal.nii", flat, "RAS"), "not square"),
    ]:
        with pytest.raises(NotCtError, match=reason):
            read_nifti(path)
    turned = np.eye(4)
    turned[:3, :3] = [[0.7, -0.7, 0], [0.7, 0.7, 0], [0, 0, 1]]
    odd = {
        "oblique": nibabel.Nifti1Image(volume.hu, turned),
        "series": nibabel.Nifti1Image(np.zeros((3, 3, 3, 4), np.int16), np.eye(4)),
        "complex": nibabel.Nifti1Image(np.zeros((3, 3, 3), np.complex64), np.eye(4)),
    }
    for (name, image), reason in zip(odd.items(), ["far from", "not one volume", "complex"], strict=True):
        nibabel.save(image, tmp_path / f"{name}.nii")
        with pytest.raises(NotCtError, match=reason):
            read_nifti(tmp_path / f"{name}.nii")
    whole = (tmp_path / "mr.nii").read_bytes()
    for name, content in [("cut.nii", whole[:400]), ("text.nii.gz", b"text"), ("empty.nii", b"")]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(NotCtError, match="damaged"):
            read_nifti(tmp_path / name)
    with pytest.raises(DataError, match="no volume"):
        load_volumes(tmp_path)


def folder_with_odd_files(folder: Path, odd: int) -> Path:
    """A folder of a scan, a scan of two slices, and this many files that are no scans."""
    volume = cylinder(200.0)
    for name, hu in (("scan", volume.hu), ("short", volume.hu[:2])):
        save(folder / f"{name}.npz", hu=hu, spacing_mm=np.array(volume.spacing_mm))
    for k in range(odd):
        (folder / f"text_{k}.nii").write_bytes(b"text")
    return folder


def test_what_is_left_out_is_told_with_reasons_in_a_process_that_sets_nothing_up(tmp_path: Path):
    folder = folder_with_odd_files(tmp_path, 2)
    code = f"from data_gen.ct.folder import load_volumes; print(len(load_volumes({str(folder)!r})))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "1\n"
    first, *reasons = run.stderr.splitlines()
    assert first == f"3 of the CT sources in {folder} are left out:"
    assert [reason.split(":")[0] for reason in reasons] == [
        f"  NIfTI file ({folder}/text_0.nii)",
        f"  NIfTI file ({folder}/text_1.nii)",
        "  short",
    ]
    assert reasons[-1] == "  short: fewer than 3 slices"


def test_of_many_that_are_left_out_the_first_are_told(tmp_path: Path):
    volumes, told = with_left_out(load_volumes, folder_with_odd_files(tmp_path, 7))
    assert [volume.name for volume in volumes] == ["scan"]
    (message,) = told
    assert message.startswith("8 of the CT sources")
    assert message.endswith("\n  and 3 more")
    assert len(message.splitlines()) == 7
    (tmp_path / "scan.npz").unlink()
    with pytest.raises(DataError, match=r"(?s)no volume of 3 or more.*text_0.*and 3 more"):
        load_volumes(tmp_path)


def test_one_that_is_left_out_is_one(tmp_path: Path):
    _, (message,) = with_left_out(load_volumes, folder_with_odd_files(tmp_path, 0))
    assert message == f"1 of the CT sources in {tmp_path} is left out:\n  short: fewer than 3 slices"


@pytest.mark.skipif(SHARED is None, reason="HYBRID_SHARED_DATA is not set: no real CT volumes")
def test_real_volumes_are_told_apart():
    volumes = {v.name: v for v in load_volumes(Path(str(SHARED)) / "ct")}
    assert len(volumes) >= 4
    for name, volume in volumes.items():
        assert is_body(volume) == name.startswith("body")
