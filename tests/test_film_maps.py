"""FilmNet's maps of a data set: near the truth, turned as the film is seen, with strips cut across their edges."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_film import FilmDrawing, make_photo

from data_gen.film_maps import FilmMapsConfig, main, write_film_maps
from data_gen.own_photos import OwnPhotosConfig, make_dataset
from hybrid.backward import Orientation, end_point_error, film_as_seen
from hybrid.errors import DataError
from hybrid.image_io import write_rgb
from hybrid.learn.datasets.edges import EdgeAugment, edge_view, open_edges
from hybrid.learn.datasets.samples import film_of
from hybrid.learn.datasets.shards import FILM_MAPS
from hybrid.strips import SIDES, StripConfig

FOUND = EdgeAugment(found_share=1.0, found_error=(1e-6, 2e-6), far_share=0.0, colours=False)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of a film, the same film upside down, and noise, with FilmNet's maps beside it."""
    pairs, out = tmp_path_factory.mktemp("pairs"), tmp_path_factory.mktemp("made")
    rng = np.random.default_rng(0)
    photo, film = make_photo(FilmDrawing(), rng, size=480)
    noise = rng.integers(0, 256, photo.shape, dtype=np.uint8)
    for name, image, true in (("a", photo, film), ("b", photo, film.turned(Orientation(2, False))), ("c", noise, film)):
        write_rgb(pairs / f"{name}.png", image)
        np.savez(pairs / f"{name}.npz", lattice=true.nodes)
    make_dataset(OwnPhotosConfig(pairs, out))
    assert write_film_maps(FilmMapsConfig(out, workers=1)) == out / FILM_MAPS
    return out


def test_maps_are_near_the_film_as_it_is_seen(made: Path) -> None:
    maps = np.load(made / FILM_MAPS)
    for sample, nodes in zip(open_edges([made])[:2], maps, strict=False):
        true = film_as_seen(film_of(sample.place))
        assert sample.found is not None
        assert np.array_equal(sample.found, nodes)
        assert end_point_error(true, nodes.astype(float)).mean() < 0.03 * max(true.mean_film_pixels())


def test_a_map_that_is_not_of_the_film_is_not_known(made: Path) -> None:
    assert open_edges([made])[2].found is None


def test_strips_are_cut_across_the_edges_that_filmnet_found(made: Path) -> None:
    """FilmNet's map places them: a true edge is as far from its strip's middle as the map is off."""
    sample, strip = open_edges([made])[0], StripConfig()
    rows = edge_view(sample, strip, np.random.default_rng(1), FOUND)[2]
    again = edge_view(sample, strip, np.random.default_rng(1), FOUND)[2]
    assert np.array_equal(rows, again, equal_nan=True)
    for seed in range(3):  # however it is turned, the map and the edges are the same
        turned = edge_view(sample, strip, np.random.default_rng(seed), FOUND)[2]
        off = np.sort(np.nanmean(np.abs(turned - (strip.rows - 1) / 2), axis=1))
        assert np.allclose(off, np.sort(np.nanmean(np.abs(rows - (strip.rows - 1) / 2), axis=1)), atol=0.5)
    other = edge_view(sample, strip, np.random.default_rng(1), replace(FOUND, found_share=0.0))[2]
    assert other.shape == (len(SIDES), strip.columns // 2)
    assert not np.allclose(rows, other, atol=0.5, equal_nan=True)


def test_without_maps_edges_are_those_of_disturbed_true_ones(made: Path, tmp_path: Path) -> None:
    for path in made.iterdir():
        if path.name != FILM_MAPS:
            (tmp_path / path.name).write_bytes(path.read_bytes())
    assert [sample.found for sample in open_edges([tmp_path])] == [None] * 3
    np.save(tmp_path / FILM_MAPS, np.zeros((2, 33, 33, 2), np.float32))
    with pytest.raises(DataError, match="2 maps of 3 samples"):
        open_edges([tmp_path])


@pytest.mark.parametrize("kept", [0, 5, 60, 1000])
def test_damaged_maps_are_an_error(made: Path, tmp_path: Path, kept: int) -> None:
    for path in made.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / FILM_MAPS).write_bytes((made / FILM_MAPS).read_bytes()[:kept])
    with pytest.raises(DataError, match=r"FilmNet's maps .*Make the maps again"):
        open_edges([tmp_path])


def test_no_data_set_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["film_maps", str(tmp_path)])
    with pytest.raises(SystemExit, match="error: "):
        main()


def test_ctrl_c_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    def stopped(config: FilmMapsConfig) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("data_gen.film_maps.write_film_maps", stopped)
    monkeypatch.setattr("sys.argv", ["film_maps", str(tmp_path)])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 130
    assert capsys.readouterr().err == "stopped; no maps are written, and the same command begins anew\n"
