"""Samples and shards: seed in, same bytes out; every map consistent with every other; a cut-off run goes on."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_gen.generate import GenerateConfig, generate
from data_gen.sample import SampleConfig, film_samples
from data_gen.sources import SourceConfig
from hybrid.coords import pixel_centres, rescale_points
from hybrid.errors import ConfigError, DataError
from hybrid.learn.shards import UV_LEVELS, open_dataset

CONFIG = SampleConfig(size=96, map_size=64, photos_per_film=2)


@pytest.fixture(scope="module")
def samples():
    return list(film_samples(3, 1, CONFIG))


def test_a_seed_gives_the_same_bytes(samples):
    again = list(film_samples(3, 1, CONFIG))
    assert [s.photo for s in again] == [s.photo for s in samples]
    np.testing.assert_array_equal(again[1].maps.uv, samples[1].maps.uv)
    assert samples[0].photo != samples[1].photo


def test_uv_and_backward_map_are_inverse(samples):
    for sample in samples:
        centres = rescale_points(pixel_centres((64, 64)), (64, 64), sample.camera.size)[sample.maps.mask]
        off = sample.backward.photo_from_film(sample.maps.uv[sample.maps.mask]) - centres
        assert np.abs(off).max() < 0.1


def test_points_project_to_their_pixels(samples):
    for sample in samples:
        centres = rescale_points(pixel_centres((64, 64)), (64, 64), sample.camera.size)[sample.maps.mask]
        off = sample.camera.photo_from_camera(sample.maps.xyz[sample.maps.mask]) - centres
        assert np.abs(off).max() < 0.05


def test_grid_vertices_are_the_same_in_every_frame(samples):
    for sample in samples:
        in_photo = sample.backward.photo_from_film(sample.grid_film)
        np.testing.assert_allclose(in_photo, sample.grid_photo, atol=0.05)
        np.testing.assert_allclose(sample.camera.photo_from_camera(sample.grid_camera), sample.grid_photo, atol=1e-6)


def test_no_value_where_there_is_no_film(samples):
    for sample in samples:
        off = ~sample.maps.mask
        for values in (sample.maps.uv, sample.maps.xyz, sample.maps.normal, sample.albedo):
            assert np.isnan(values[off]).all()
            assert np.isfinite(values[~off]).all()


def test_photos_are_pictures_of_the_right_size(samples):
    photo = cv2.imdecode(np.frombuffer(samples[0].photo, np.uint8), cv2.IMREAD_COLOR)
    assert photo.shape == (96, 96, 3)
    assert np.ptp(photo) > 20


def test_a_dataset_is_written_resumed_and_read(tmp_path):
    config = GenerateConfig(count=5, out=tmp_path / "d", seed=4, size=64, workers=1, shard_size=4, sample=CONFIG)
    generate(config)
    first = (tmp_path / "d/shard_00000/photos/000000.jpg").read_bytes()
    (tmp_path / "d/shard_00001").rename(tmp_path / "gone")
    generate(config)  # makes the missing shard only, and makes it alike
    for name in ("photos/000000.jpg", "uv.npy", "samples.jsonl"):
        assert (tmp_path / "gone" / name).read_bytes() == (tmp_path / "d/shard_00001" / name).read_bytes()
    shards = open_dataset(tmp_path / "d")
    assert [len(s) for s in shards] == [4, 1]
    assert shards[0].photos[0] == first
    sample = next(film_samples(4, 0, SampleConfig(size=64, map_size=64, photos_per_film=2)))
    np.testing.assert_allclose(shards[0].maps["uv"][0] / UV_LEVELS, np.nan_to_num(sample.maps.uv), atol=1 / UV_LEVELS)
    record = shards[0].samples[0]
    assert record["seed"] == 4
    assert record["lens"]["jpeg"] == sample.parameters["lens"]["jpeg"]


def test_another_data_set_is_not_mixed_in(tmp_path):
    folder = tmp_path / "d"
    folder.mkdir()
    (folder / "dataset.json").write_text(json.dumps({"seed": 1}))
    with pytest.raises(ConfigError, match="another --out"):
        generate(GenerateConfig(count=1, out=folder, workers=1, sample=CONFIG))


@pytest.mark.parametrize("options", [{"count": 0}, {"size": 8}, {"sources": SourceConfig(ct=Path("nowhere"))}])
def test_impossible_options_are_refused(tmp_path, options):
    with pytest.raises(ConfigError):
        generate(GenerateConfig(**({"count": 1, "out": tmp_path, "workers": 1} | options)))


def test_a_folder_without_shards_is_refused(tmp_path):
    with pytest.raises(DataError, match="data_gen"):
        open_dataset(tmp_path)
