"""Shards: coded within the stated errors, the same for every reader, refused when damaged."""

import io
import json
import pickle
import re
import tarfile
from pathlib import Path

import numpy as np
import pytest
from simple_samples import CONFIG, simple_film

from data_gen.generate import GenerateConfig
from data_gen.manifest import describe_dataset, write_manifest, write_shard
from data_gen.shards import members, sample_bytes
from hybrid.coords import CONVENTIONS_VERSION
from hybrid.errors import ConfigError, DataError
from hybrid.learn.datasets import coding
from hybrid.learn.datasets.shards import FORMAT, open_dataset, read_index

MAPS = ("mask", "uv", "xyz", "normal", "albedo", "glare", "backward")

BOUNDS = {"uv": 0.5 / 65535 + 1e-7, "albedo": 0.5 / 255 + 1e-7}
"""Half a step, and float32's own rounding."""


def put(folder, samples, first=0):
    """A data set of one shard."""
    folder.mkdir(exist_ok=True)
    describe_dataset(folder, {"format": FORMAT, "conventions": CONVENTIONS_VERSION}, len(samples))
    parts = [sample_bytes(sample, first + k) for k, sample in enumerate(samples)]
    write_manifest(folder, [write_shard(folder / "shard_00000.tar", first, parts)])
    return folder


@pytest.fixture(scope="module")
def samples():
    return simple_film(5, 0, CONFIG)


@pytest.fixture
def folder(samples, tmp_path):
    return put(tmp_path / "d", samples)


# ---------------------------------------------------------------- coding


def test_maps_come_back_within_the_stated_errors(samples, folder):
    (shard,) = open_dataset(folder)
    for k, sample in enumerate(samples):
        mask = sample.maps.mask
        np.testing.assert_array_equal(shard.field("mask", k), mask)
        np.testing.assert_array_equal(shard.field("glare", k), sample.glare)
        for name, bound in BOUNDS.items():
            truth = sample.albedo if name == "albedo" else getattr(sample.maps, name)
            assert np.abs(shard.field(name, k) - truth)[mask].max() <= bound
        xyz, truth = shard.field("xyz", k), sample.maps.xyz
        span = np.ptp(truth[mask], axis=0)
        assert (np.abs(xyz - truth)[mask].max(axis=0) <= span / 131070 + np.spacing(np.float32(2000))).all()
        np.testing.assert_array_equal(shard.field("depth", k), xyz[..., 2])
        np.testing.assert_array_equal(shard.field("backward", k), sample.backward.nodes.astype(np.float32))


def test_600_mm_are_stored_to_a_hundredth():
    xyz = np.random.default_rng(0).uniform(200, 800, (40, 40, 3))
    mask = np.ones((40, 40), dtype=bool)
    stored, how = coding.encode_xyz(xyz, mask)
    assert np.abs(coding.decode_xyz(stored, mask, how) - xyz).max() < 0.01


def test_normals_of_all_directions_come_back_within_their_angle():
    rng = np.random.default_rng(1)
    random = rng.normal(size=(500, 40, 3))
    random[0, :26] = [d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]
    random[0, :26] -= 1  # axes, edges and corners of the cube: where the octahedron folds
    unit = random / np.linalg.norm(random, axis=-1, keepdims=True)
    mask = np.ones(unit.shape[:2], dtype=bool)
    decoded = coding.decode_normal(coding.encode_normal(unit, mask), mask)
    sine = np.linalg.norm(np.cross(decoded, unit), axis=-1)
    assert np.rad2deg(np.arcsin(sine)).max() < 0.004
    assert ((decoded * unit).sum(axis=-1) > 0).all()


def test_there_is_no_value_where_there_is_no_film(samples, folder):
    (shard,) = open_dataset(folder)
    off = ~samples[0].maps.mask
    assert off.any()
    for name in ("uv", "xyz", "normal", "albedo", "depth"):
        assert np.isnan(shard.field(name, 0)[off]).all()
        assert np.isfinite(shard.field(name, 0)[~off]).all()
    for name in ("uv", "xyz", "normal", "albedo"):
        assert (shard.stored(name, 0)[off] == 0).all()


def test_a_photo_without_film_is_stored():
    mask = np.zeros((8, 8), dtype=bool)
    nothing = np.full((8, 8, 3), np.nan)
    stored, how = coding.encode_xyz(nothing, mask)
    assert np.isnan(coding.decode_xyz(stored, mask, how)).all()
    assert np.isnan(coding.decode_normal(coding.encode_normal(nothing, mask), mask)).all()


def test_the_record_keeps_every_parameter(samples, folder):
    (shard,) = open_dataset(folder)
    record = shard.record(1)
    assert record["light"] == samples[1].parameters["light"]
    assert record["coverage"] == samples[1].maps.mask.mean()
    np.testing.assert_allclose(record["grid"]["world"], samples[1].grid_world, atol=5.1e-5)
    np.testing.assert_allclose(record["grid"]["film"], samples[1].grid_film, atol=5.1e-8)


# ---------------------------------------------------------------- readers


GUIDE = Path(__file__).parents[1] / "docs" / "data.md"


@pytest.mark.filterwarnings("ignore:Exception ignored in.*FileIO:pytest.PytestUnraisableExceptionWarning")
def test_the_guides_ways_to_read_a_data_set_run_and_agree(folder):
    pytest.importorskip("webdataset")
    names = {"folder": folder}
    for block in re.findall(r"```python\n(.*?)```", GUIDE.read_text(), flags=re.DOTALL):
        exec(compile(block, GUIDE.name, "exec"), names)
    mask = open_dataset(folder)[0].field("mask", 0)
    np.testing.assert_allclose(names["xyz_mm"][mask][:, 2], names["depth_mm"][mask], rtol=1e-6)


def test_the_guide_names_every_member(samples):
    for member in members(samples[0]):
        assert f"`{member}`" in GUIDE.read_text()


# webdataset leaves it to the garbage collector to close the file.
@pytest.mark.filterwarnings("ignore:Exception ignored in.*FileIO:pytest.PytestUnraisableExceptionWarning")
def test_plain_tar_and_webdataset_read_the_same(samples, folder):
    webdataset = pytest.importorskip("webdataset")
    (shard,) = open_dataset(folder)
    read = list(webdataset.WebDataset(str(shard.path), shardshuffle=False).decode())
    with tarfile.open(shard.path) as tar:
        files = {member.name: tar.extractfile(member).read() for member in tar.getmembers()}
    assert len(read) == len(samples)
    for k, sample in enumerate(read):
        key = sample["__key__"]
        assert key == f"{k:09d}"
        assert files[f"{key}.photo.jpg"] == shard.photo(k) == samples[k].photo
        assert json.loads(files[f"{key}.json"]) == shard.record(k) == sample["json"]
        for name in MAPS:
            plain = np.load(io.BytesIO(files[f"{key}.{name}.npy"]))
            for other in (sample[f"{name}.npy"], shard.stored(name, k)):
                assert other.dtype == plain.dtype
                np.testing.assert_array_equal(other, plain)


def test_stored_arrays_are_not_copied_and_cannot_be_written(folder):
    (shard,) = open_dataset(folder)
    one, two = shard.stored("uv", 0), shard.stored("uv", 0)
    assert np.shares_memory(one, two)
    with pytest.raises(ValueError, match="read-only"):
        one[0] = 1


def test_headers_hold_neither_time_nor_owner(folder):
    with tarfile.open(folder / "shard_00000.tar") as tar:
        for member in tar.getmembers():
            assert (member.mtime, member.uid, member.gid, member.uname, member.gname) == (0, 0, 0, "", "")


def test_a_shard_goes_to_another_process_without_its_data(folder):
    (shard,) = open_dataset(folder)
    shard.stored("uv", 0)
    packed = pickle.dumps(shard)
    assert len(packed) < shard.entry.bytes / 4
    np.testing.assert_array_equal(pickle.loads(packed).stored("uv", 0), shard.stored("uv", 0))


def test_opening_a_data_set_opens_no_shard(folder):
    path = folder / "shard_00000.tar"
    path.write_bytes(bytes(path.stat().st_size))
    (shard,) = open_dataset(folder)
    assert len(shard) == 2
    with pytest.raises(DataError, match="sample"):
        shard.record(0)


# ---------------------------------------------------------------- refused


@pytest.mark.parametrize("cut", [300, 512, 5000])
def test_a_shard_that_was_cut_off_is_no_shard(folder, cut):
    path = folder / "shard_00000.tar"
    path.write_bytes(path.read_bytes()[: -1024 - cut])
    with pytest.raises(ValueError, match=r"cut off|lack members"):
        read_index(path)
    with pytest.raises(DataError, match="bytes"):
        open_dataset(folder)


def test_a_changed_byte_is_found(folder):
    path = folder / "shard_00000.tar"
    content = bytearray(path.read_bytes())
    content[2000] ^= 1
    path.write_bytes(content)
    assert open_dataset(folder)
    with pytest.raises(DataError, match="sha256"):
        open_dataset(folder, verify=True)


def test_a_missing_shard_is_found(folder):
    (folder / "shard_00000.tar").unlink()
    with pytest.raises(DataError, match="shard_00000"):
        open_dataset(folder)


def test_a_folder_without_data_set_is_refused(tmp_path):
    with pytest.raises(DataError, match=r"python -m data_gen\.generate"):
        open_dataset(tmp_path)


def test_an_older_data_set_is_refused(tmp_path):
    (tmp_path / "dataset.json").write_text(json.dumps({"seed": 1, "conventions": CONVENTIONS_VERSION}))
    with pytest.raises(DataError, match="Make it again"):
        open_dataset(tmp_path)


@pytest.mark.parametrize(
    ("name", "told"), [("000000.jpg", "--preset upright or"), ("000000.npz", "--preset light"), ("a.txt", "generate")]
)
def test_a_data_set_for_other_networks_is_named(folder, tmp_path, name, told):
    (tmp_path / "dataset.json").write_bytes((folder / "dataset.json").read_bytes())
    (tmp_path / name).touch()
    with pytest.raises(DataError, match=f"no finished shard.*{told}"):
        open_dataset(tmp_path)


def test_a_shard_of_other_samples_than_listed_is_refused(samples, folder):
    write_shard(folder / "shard_00000.tar", 10, [sample_bytes(sample, 10 + k) for k, sample in enumerate(samples)])
    with pytest.raises(DataError, match="samples 10 to"):
        open_dataset(folder)[0].record(0)


def test_shards_hold_whole_films(tmp_path):
    with pytest.raises(ConfigError, match="multiples of the 8"):
        GenerateConfig(count=8, out=tmp_path, shard_size=20)
