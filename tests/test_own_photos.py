"""Photos of one's own become samples: their maps are the lattice's, unknown truth is ignored, error messages help."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from data_gen.own_photos import OwnPhotosConfig, main, make_dataset, pair_paths, read_pair
from hybrid.backward import BackwardMap, Orientation
from hybrid.coords import film_centres, film_nodes, pixel_centres, rescale_points
from hybrid.errors import ConfigError, DataError, PhotoError
from hybrid.image_io import write_rgb
from hybrid.learn.datasets.film import AugmentConfig, batch_of, training_view
from hybrid.learn.datasets.samples import film_of, open_places, photo_of, truth_at
from hybrid.learn.datasets.shards import open_dataset
from hybrid.learn.networks.filmnet import STRIDE, FilmNet, FilmNetConfig
from hybrid.learn.networks.losses import loss_terms
from hybrid.learn.paper.views import PaperView, paper_batch
from hybrid.learn.training.plan import TrainConfig
from hybrid.learn.training.presets import PRESETS
from hybrid.learn.training.train import train

SIZE = (150, 200)
UV_STEP = 1 / 65535  # rounding of stored uv, and float32 arithmetic on it


def photo_from_film(uv: np.ndarray) -> np.ndarray:
    """A slightly bent film in a photo of SIZE, its right edge beyond the photo's."""
    u, v = uv[..., 0], uv[..., 1]
    return np.stack([30 + 180 * u + 8 * np.sin(2 * v), 15 + 115 * v + 10 * u * (1 - u)], axis=-1)


def write_pair(folder: Path, name: str, suffix: str = ".png", lattice: np.ndarray | None = None) -> None:
    rng = np.random.default_rng(len(name))
    write_rgb(folder / f"{name}{suffix}", rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8))
    np.savez(folder / f"{name}.npz", lattice=photo_from_film(film_nodes((21, 17))) if lattice is None else lattice)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of three pairs, one of them of a film on its side."""
    pairs, out = tmp_path_factory.mktemp("pairs"), tmp_path_factory.mktemp("made")
    write_pair(pairs, "a")
    write_pair(pairs, "bb", ".jpg")
    turned = BackwardMap(photo_from_film(film_nodes((21, 17)))).turned(Orientation(1, True)).nodes
    write_pair(pairs, "ccc", lattice=turned)
    assert make_dataset(OwnPhotosConfig(pairs, out, size=100)) == 3
    return out


# ---------------------------------------------------------------- what is stored


def test_maps_and_photo_are_those_of_the_pair(made: Path) -> None:
    (shard,) = open_dataset(made, verify=True)
    photo = photo_of((shard, 0))
    assert photo.shape == (75, 100, 3)  # the longer side reduced to 100
    film = film_of((shard, 0))
    uv = film_nodes((9, 9))
    np.testing.assert_allclose(film.photo_from_film(uv), photo_from_film(uv) / 2, atol=2e-4)  # nodes are float32
    mask, stored = shard.field("mask", 0), shard.field("uv", 0)
    points = rescale_points(pixel_centres(mask.shape), mask.shape, (75, 100))
    np.testing.assert_allclose(film.photo_from_film(stored[mask].astype(float)), points[mask], atol=200 * UV_STEP)
    area = abs(np.linalg.det(film.jacobian(film_centres((200, 200))))) / 200**2
    inside = film.photo_from_film(film_centres((200, 200)))[..., 0] < 100
    assert mask.sum() == pytest.approx((area * inside).sum() * mask.size / (75 * 100), rel=0.02)


def test_pairs_are_in_order_and_the_same_pairs_are_the_same_bytes(made: Path, tmp_path: Path) -> None:
    (shard,) = open_dataset(made)
    assert [shard.record(k)["name"] for k in range(3)] == ["a", "bb", "ccc"]
    pairs, twice = tmp_path / "pairs", tmp_path / "twice"
    pairs.mkdir()
    write_pair(pairs, "a")
    for _ in range(2):  # the second run replaces the first
        make_dataset(OwnPhotosConfig(pairs, twice, size=100))
    assert open_dataset(twice)[0].member("uv.npy", 0).tobytes() == shard.member("uv.npy", 0).tobytes()


def test_a_name_in_another_encoding_than_ours_is_a_name(tmp_path: Path) -> None:
    (tmp_path / "pairs").mkdir()
    write_pair(tmp_path / "pairs", os.fsdecode(b"caf\xe9"))
    assert make_dataset(OwnPhotosConfig(tmp_path / "pairs", tmp_path / "made", size=100)) == 1


def test_what_is_not_known_is_zero(made: Path) -> None:
    truth = truth_at(open_places([made])[0], pixel_centres((75, 100)), (75, 100))
    assert truth.mask.any()
    assert not any(values.any() for values in (truth.xyz, truth.normal, truth.albedo))


# ---------------------------------------------------------------- what is learnt from it


def test_a_view_of_a_pair_knows_its_film_and_not_its_shape_or_print(made: Path) -> None:
    places = open_places([made])
    for place in places:
        view = training_view(place, 96, np.random.default_rng(0), None)
        film, size = film_of(place), photo_of(place).shape[:2]
        uv = Orientation.from_index(view.orientation).film_from_seen(view.uv[view.mask].astype(float))
        n = 96 // STRIDE
        centres = rescale_points(pixel_centres((n, n)), (n, n), (100, 100)) - [0, (100 - size[0]) / 2]
        assert np.abs(film.photo_from_film(uv) - centres[view.mask]).max() < 0.05
        assert (view.has_shape, view.has_print, view.grid) == (False, False, None)
    ways = [training_view(place, 96, np.random.default_rng(0), None).orientation for place in places]
    assert ways[0] == ways[1] == 0
    assert ways[2] == Orientation(1, True).index


def test_what_is_not_known_teaches_nothing(made: Path) -> None:
    torch.manual_seed(0)
    place, augment = open_places([made])[0], replace(AugmentConfig(), empty_share=0.0)
    images, targets = batch_of([training_view(place, 64, np.random.default_rng(k), augment) for k in range(2)])
    output = FilmNet(FilmNetConfig(widths=(4, 8, 8, 8), blocks=(1, 1, 1), input_px=64)).train()(images)

    def terms(**known: torch.Tensor) -> dict[str, float]:
        return {name: float(term.detach()) for name, term in loss_terms(output, replace(targets, **known)).items()}

    assert all(terms()[name] == 0 for name in ("xyz", "albedo", "normal", "phases", "grid"))
    assert all(terms()[name] > 0 for name in ("uv", "mask", "slope"))
    half = torch.tensor([1.0, 0.0])
    assert all(terms(has_shape=half, has_print=half)[name] > 0 for name in ("xyz", "albedo", "normal"))


def test_a_network_that_needs_what_is_missing_says_so(made: Path) -> None:
    with pytest.raises(DataError, match=r"no xyz, normal or albedo.*Train FilmNet"):
        paper_batch(open_places([made]), PaperView(32, 0), [np.random.default_rng(0)], AugmentConfig())


def test_training_goes_on_with_pairs(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = FilmNetConfig(widths=(4, 8, 8, 8), blocks=(1, 1, 1), input_px=64)
    monkeypatch.setitem(PRESETS, "filmnet", replace(PRESETS["filmnet"], config=tiny, batch=2))
    train(TrainConfig((made,), tmp_path, passes=8, held_out=1, loaders=0, steps_per_test=2))
    assert len((tmp_path / "curves.csv").read_text().splitlines()) == 1 + 2


# ---------------------------------------------------------------- errors


def test_folders_and_files_that_are_no_pairs(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no \.npz file.*Name a folder"):
        pair_paths(tmp_path)
    write_pair(tmp_path, "a")
    (tmp_path / "a.png").rename(tmp_path / "b.png")
    with pytest.raises(DataError, match=r"a\.npz.*0 photos.*beside it"):
        pair_paths(tmp_path)
    (tmp_path / "a.png").write_text("no picture")
    with pytest.raises(PhotoError):
        read_pair(tmp_path / "a.png", tmp_path / "a.npz", 100)
    with pytest.raises(ConfigError, match="--size"):
        OwnPhotosConfig(tmp_path, tmp_path, size=10)


@pytest.mark.parametrize(
    ("lattice", "match"),
    [
        (np.zeros((3, 9, 2)), r"\(3, 9, 2\).*n and m >= 4"),
        (np.zeros((9, 9)), "regular lattice"),
        (np.full((9, 9, 2), np.nan), "NaN or infinity"),
        (photo_from_film(film_nodes((9, 9)))[[0, 1, 5, 4, 3, 2, 6, 7, 8]], "folds over itself"),
    ],
)
def test_lattices_that_are_no_maps(tmp_path: Path, lattice: np.ndarray, match: str) -> None:
    write_pair(tmp_path, "a", lattice=lattice)
    with pytest.raises(DataError, match=match):
        read_pair(tmp_path / "a.png", tmp_path / "a.npz", 100)


def test_a_truth_without_lattice_and_a_film_beside_the_photo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_pair(tmp_path, "a")
    np.savez(tmp_path / "a.npz", points=np.zeros((9, 9, 2)))
    with pytest.raises(DataError, match=r"an array 'lattice'.*savez"):
        read_pair(tmp_path / "a.png", tmp_path / "a.npz", 100)
    write_pair(tmp_path, "a", lattice=photo_from_film(film_nodes((9, 9))) + 1000)
    monkeypatch.setattr("sys.argv", ["own_photos", str(tmp_path), "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit, match=r"error: lattice \(a\): got no film within the photo"):
        main()
    monkeypatch.setattr("sys.argv", ["own_photos", str(tmp_path), "--out", str(tmp_path / "out"), "--size", "10"])
    capsys.readouterr()
    with pytest.raises(SystemExit, match=r"^2$"):
        main()
    assert capsys.readouterr().err == "error: --size: got 10; allowed: >= 64. Choose another.\n"
    assert not list((tmp_path / "out").glob("*.tar*"))
