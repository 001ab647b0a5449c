"""Which way is up, from what slices show: pictures of cells, votes, training views, what the packaged network sees."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from synthetic_film import FilmDrawing, draw_print

from data_gen.ct.phantom import body_phantom, head_phantom
from data_gen.flat_prints import FlatPrintsConfig, flat_prints
from data_gen.prints.prints import PrintConfig, make_print
from data_gen.sources import SourceConfig
from hybrid.coords import film_nodes
from hybrid.errors import DataError
from hybrid.learn.datasets.slices import SliceAugment, grid_of, slice_view, sliced_prints
from hybrid.learn.datasets.upright import PrintAugment
from hybrid.learn.networks.inference import ready
from hybrid.learn.networks.slicenet import (
    SliceNet,
    SliceNetConfig,
    cell_squares,
    least_side,
    slice_pictures,
    standardised,
)
from hybrid.learn.networks.uprightnet import WAYS
from hybrid.learn.networks.weights import packaged_slice_net, packaged_upright_net
from hybrid.learn.reading.orientation import (
    TURNS_OF_WAYS,
    OrientationReader,
    UprightConfig,
    orientation_chances,
    upright_way,
)

PX = 48


def arrow(px: int = 240) -> np.ndarray:
    """A bright, upright arrow that is its own mirror image."""
    picture = np.full((px, px), 20, np.uint8)
    tip = np.array([[0.5, 0.15], [0.75, 0.5], [0.25, 0.5]]) * px
    cv2.fillPoly(picture, [np.rint(tip).astype(np.int32)], 220)
    picture[px // 2 : round(0.8 * px), round(0.42 * px) : round(0.58 * px)] = 150
    return np.maximum(picture, picture[:, ::-1])


def rgb(film: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.repeat(film[..., None], 3, axis=2))


# ---------------------------------------------------------------- pictures


def test_squares_lie_in_the_middles_of_cells_that_are_not_square():
    squares = cell_squares(film_nodes((3, 5)), (600, 2000))
    assert len(squares) == 8
    np.testing.assert_allclose(squares[5][0], [750, 450])
    assert {side for _, side in squares} == {300.0}
    assert least_side(film_nodes((3, 5)), (600, 2000)) == 300.0


def test_pictures_are_the_same_in_any_even_light_and_show_a_disc():
    picture = cv2.resize(arrow(), (PX, PX), interpolation=cv2.INTER_AREA)[None]
    dim = (0.5 * picture.astype(float) + 20).round().astype(np.uint8)
    np.testing.assert_allclose(standardised(dim), standardised(picture), atol=0.05)
    corner = standardised(picture)[0, :6, :6]
    assert not corner.any()


def test_empty_cells_are_left_out_and_no_more_are_taken_than_asked_for():
    film = np.tile(arrow(), (4, 5))
    film[:240, :480] = 20
    vertices = film_nodes((5, 6))
    assert len(slice_pictures(film, vertices, SliceNetConfig(count=50))) == 18
    few = slice_pictures(film, vertices, SliceNetConfig(count=7))
    assert few.shape == (7, PX, PX)
    assert len(slice_pictures(np.full_like(film, 20), vertices, SliceNetConfig())) == 0


# ---------------------------------------------------------------- votes


@pytest.mark.parametrize("turns", range(4))
def test_votes_turn_with_the_slices(turns: int):
    """Slices turned clockwise have to be turned by that much less: whatever the weights, no side is favoured."""
    torch.manual_seed(0)
    network = SliceNet(SliceNetConfig()).eval()
    pictures = np.random.default_rng(0).normal(size=(2, 3, PX, PX)).astype(np.float32)
    turned = np.ascontiguousarray(np.rot90(pictures, -turns, (-2, -1)))
    with torch.no_grad():
        votes, after = (network(torch.from_numpy(some)).votes.numpy() for some in (pictures, turned))
    np.testing.assert_allclose(after, np.roll(votes, -turns, axis=2), atol=1e-5)


@pytest.mark.parametrize("way", WAYS)
def test_turns_of_ways_put_slices_upright_whether_mirrored_or_not(way):
    """A picture that is its own mirror image is upright after the turn of a way, even if the way mirrors it first."""
    seen = way.inverse.moved(arrow())
    np.testing.assert_array_equal(np.rot90(seen, -TURNS_OF_WAYS[way.index]), arrow())


# ---------------------------------------------------------------- data


def test_views_show_slices_upright(tmp_path: Path):
    path = tmp_path / "000000.jpg"
    cv2.imwrite(str(path), np.tile(arrow(), (4, 4)))
    path.with_suffix(".json").write_text(json.dumps({"vertices": film_nodes((5, 5)).tolist()}))
    photo = PrintAugment(
        photo_px=(959.0, 960.0), squeeze=1.0, stretch=1e-9, roll_deg=1e-9, gain=(0.9, 0.91), gamma=1e-9, veil=0.0,
        blur_px=(0.25, 0.26), sharpen=1e-9,
    )  # fmt: skip
    still = SliceAugment(
        roll_deg=0.0, stretch=0.0, zoom=(1.0, 1.0), bend=0.0, shift=0.0, gamma=0.0, hidden=0.0, strange=0.0, shown=20
    )
    view = slice_view(path, SliceNetConfig(), np.random.default_rng(0), photo, still)
    true = standardised(cv2.resize(arrow(), (PX, PX), interpolation=cv2.INTER_AREA)[None])[0]
    assert view[:16].any(axis=(1, 2)).all()
    assert not view[16:].any()
    assert all(np.corrcoef(picture.ravel(), true.ravel())[0, 1] > 0.97 for picture in view[:16])


def test_prints_say_where_their_slices_are(tmp_path: Path):
    config = FlatPrintsConfig(2, tmp_path / "prints", seed=3, workers=0, sources=SourceConfig(phantoms=(0, 1)))
    flat_prints(config)
    paths = sliced_prints(config.out)
    assert len(paths) == 2
    vertices = grid_of(paths[1])
    assert vertices.shape[-1] == 2
    assert np.all((vertices >= 0) & (vertices <= 1))
    first = paths[0].read_bytes()
    for path in paths:
        path.unlink()
    flat_prints(config)
    assert paths[0].read_bytes() == first
    paths[0].with_suffix(".json").unlink()
    with pytest.raises(DataError, match="Make the prints again"):
        sliced_prints(config.out)


# ---------------------------------------------------------------- the packaged network


@pytest.fixture(scope="module")
def reader() -> OrientationReader:
    return OrientationReader(ready(packaged_upright_net()), ready(packaged_slice_net()))


SILENT = {"text_share": 0.0, "header_share": 0.0, "scout_share": 0.0, "clear_share": 0.0}


@pytest.mark.parametrize("phantom", [head_phantom, body_phantom])
def test_a_film_without_writing_is_put_upright_by_its_slices(reader: OrientationReader, phantom):
    """By quarter turns. From behind it looks as it does from the front, so it is not mirrored; nor is it turned over,
    as slices printed upside down are about as frequent as films held upside down."""
    volume, config = phantom(np.random.default_rng(7)), UprightConfig(min_film_px=10**6)
    seed = 2
    film_print = make_print(volume, np.random.default_rng(seed), PrintConfig(longer_px=1000, **SILENT))
    assert film_print.parameters["anatomy_upright"]
    image = np.rint(255 * film_print.image).astype(np.uint8)
    for way in WAYS[:4]:
        seen = rgb(way.inverse.moved(image))
        vertices = way.inverse.film_from_seen(film_print.vertices)
        vertices = way.inverse.moved(vertices)
        chances, read = orientation_chances(reader, seen, vertices, config)
        assert read == "slices"
        assert chances is not None
        assert chances.argmax() == way.index
        assert (upright_way(chances, config)[0] == way) or way.turns == 2


def test_what_is_no_anatomy_says_little(reader: OrientationReader):
    film = draw_print(FilmDrawing(rows=5, cols=4, texts=False), np.random.default_rng(3), (1400, 1120))
    config = replace(UprightConfig(), min_film_px=10**6)
    chances, _ = orientation_chances(reader, rgb(film), film_nodes((6, 5)), config)
    assert chances is not None
    assert upright_way(chances, config)[0].index == 0


def test_nothing_is_read_where_all_is_small(reader: OrientationReader):
    chances, read = orientation_chances(reader, rgb(arrow(60)), film_nodes((5, 5)), UprightConfig())
    assert chances is None
    assert read == ""
