"""Which way is up: where films carry writing, what the patches say together, and what the packaged network reads."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from synthetic_film import FilmDrawing, draw_print

from hybrid.backward import Orientation
from hybrid.errors import DataError
from hybrid.learn.datasets.upright import PrintAugment, print_paths, upright_view
from hybrid.learn.networks.inference import ready
from hybrid.learn.networks.slicenet import SliceNet, SliceNetConfig
from hybrid.learn.networks.upright_patches import PatchConfig, standardised, text_patches, text_places
from hybrid.learn.networks.uprightnet import WAYS, PatchVotes, UprightNet, UprightNetConfig, joined, upright_losses
from hybrid.learn.networks.weights import packaged_upright_net, parameter_count
from hybrid.learn.reading.orientation import OrientationReader, UprightConfig, orientation_chances, upright_way

RIGHT, TURNED = WAYS[0], WAYS[1]


@pytest.fixture(scope="module")
def reader() -> UprightNet:
    return ready(packaged_upright_net())


def written_chances(reader: UprightNet, film: np.ndarray, config: UprightConfig) -> np.ndarray:
    """What the writing alone says."""
    readers = OrientationReader(reader, SliceNet(SliceNetConfig()))
    chances, read = orientation_chances(readers, film, None, config)
    assert read == "writing"
    assert chances is not None
    return chances


def written_film(seed: int = 0) -> np.ndarray:
    return draw_print(FilmDrawing(rows=5, cols=4), np.random.default_rng(seed), (1400, 1120))


def rgb(film: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.repeat(film[..., None], 3, axis=2))


# ---------------------------------------------------------------- patches


def test_a_patch_is_the_same_in_any_even_light():
    patch = np.random.default_rng(0).integers(60, 200, (1, 32, 32), dtype=np.uint8)
    dim = (0.5 * patch.astype(float) + 20).round().astype(np.uint8)
    np.testing.assert_allclose(standardised(dim), standardised(patch), atol=0.15)
    assert not standardised(np.full((2, 32, 32), 90, np.uint8)).any()


def test_patches_are_cut_where_letters_stand_and_not_where_lines_or_tissue_do():
    film = np.full((1400, 1120), 14, np.uint8)
    cv2.ellipse(film, (560, 900), (300, 220), 10, 0, 360, 150, -1)
    for x in (0, 373, 746, 1119):
        cv2.line(film, (x, 0), (x, 1399), 200, 2)
    places = [(60, 50), (700, 60), (200, 400), (900, 500)]
    for x, y in places:
        cv2.putText(film, "RW 34", (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.4, 230, 1, cv2.LINE_AA)
    found = text_places(film, PatchConfig(count=4)) * [1120, 1400]
    letters = np.array([(x + 22, y - 4) for x, y in places])  # their middles
    nearest = np.linalg.norm(found[:, None] - letters, axis=-1)
    assert sorted(nearest.argmin(axis=1)) == [0, 1, 2, 3]
    assert nearest.min(axis=1).max() < 25


def test_fewer_letters_give_fewer_patches():
    film = np.zeros((1400, 1120), np.uint8)
    assert not text_patches(film, PatchConfig()).any()
    cv2.putText(film, "W 34", (500, 700), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 230, 1, cv2.LINE_AA)
    some = text_patches(film, PatchConfig()).any(axis=(1, 2))
    assert 1 <= some.sum() < 12


# ---------------------------------------------------------------- votes


@pytest.mark.parametrize("way", WAYS)
def test_votes_turn_with_the_patches(way):
    """A patch moved by ``way.inverse`` needs ``way`` once more: whatever the weights, no way is favoured."""
    torch.manual_seed(0)
    network = UprightNet(UprightNetConfig()).eval()
    patches = np.random.default_rng(0).normal(size=(2, 3, 48, 48)).astype(np.float32)
    moved = np.stack([[way.moved(patch) for patch in film] for film in patches])
    with torch.no_grad():
        votes, after = (network(torch.from_numpy(some)).votes.numpy() for some in (patches, moved))
    corner = np.arange(4).reshape(2, 2)
    for k, then in enumerate(WAYS):
        whole = next(w.index for w in WAYS if np.array_equal(w.moved(corner), then.moved(way.moved(corner))))
        np.testing.assert_allclose(after[..., k], votes[..., whole], atol=1e-5)


def votes_of(votes: torch.Tensor, alike: float) -> PatchVotes:
    return PatchVotes(votes, torch.ones(votes.shape[:2], dtype=torch.bool), torch.tensor(alike))


def test_losses_by_hand():
    """Two patches that err together (alike 1) count as one, those that err apart (0) as two."""
    sure = torch.full((1, 2, 8), -50.0)
    sure[:, :, 3] = 0.0
    right = upright_losses(votes_of(sure, 0.0), torch.tensor([3]))
    assert [float(value) for value in right.values()] == pytest.approx([0, 0], abs=1e-6)
    for alike, film in ((0.0, 100), (1.0, 50), (1 / 3, 75)):
        wrong = upright_losses(votes_of(sure, alike), torch.tensor([1]))
        assert {name: float(value) for name, value in wrong.items()} == pytest.approx({"patch": 50, "film": film})
    blind = upright_losses(votes_of(torch.full((1, 2, 8), -np.log(8.0)), 0.3), torch.tensor([0]))
    assert [float(value) for value in blind.values()] == pytest.approx([np.log(8), np.log(8)])


def test_empty_patches_do_not_count():
    votes = torch.full((1, 3, 8), -np.log(8.0))
    votes[0, 0, 1] = 0.0
    alone = PatchVotes(votes, torch.tensor([[True, False, False]]), torch.tensor(0.5)).films
    np.testing.assert_allclose(alone.softmax(dim=1), votes[:, 0].softmax(dim=1), atol=1e-6)
    again = joined(
        [PatchVotes(part, torch.tensor([[k == 0]]), torch.tensor(0.5)) for k, part in enumerate(votes.split(1, dim=1))]
    )
    np.testing.assert_array_equal(again.films, alone)


def test_a_contact_sheet_is_no_print(tmp_path: Path):
    (tmp_path / "contact_sheet.jpg").touch()
    (tmp_path / "shard_00000.tar").touch()
    with pytest.raises(DataError, match=r"data set of photos.*flat_prints"):
        print_paths(tmp_path)


def test_a_view_shows_the_prints_letters_upright():
    """A print of one sign again and again: its patches show the sign upright."""
    sign = np.zeros((70, 70), np.uint8)
    cv2.putText(sign, "F", (22, 46), cv2.FONT_HERSHEY_SIMPLEX, 0.9, 230, 2, cv2.LINE_AA)
    clean = PrintAugment(
        photo_px=(1200.0, 1201.0), squeeze=1.0, zoom=(0.999, 1.001), stretch=1e-9, roll_deg=1e-9, gain=(0.9, 0.91),
        gamma=1e-9, veil=0.0, blur_px=(0.25, 0.26), sharpen=1e-9,
    )  # fmt: skip
    config = UprightNetConfig(film_px=1400.0)
    views = upright_view(np.tile(sign, (20, 16)), config, np.random.default_rng(0), clean)
    template = sign[18:54, 14:50].astype(np.float32)
    fit = [cv2.matchTemplate(np.pad(view, 8), template, cv2.TM_CCOEFF_NORMED).max() for view in views]
    assert np.median(fit) > 0.9


# ---------------------------------------------------------------- the packaged network


def test_it_is_small(reader):
    assert parameter_count(packaged_upright_net()) < 300_000


def test_a_written_film_is_read_or_left_as_it_lies(reader):
    """Most ways are read; none is read wrongly."""
    found = {}
    for way in WAYS:
        seen = rgb(way.inverse.moved(written_film()))
        chances = written_chances(reader, seen, UprightConfig())
        assert chances.sum() == pytest.approx(1, abs=1e-5)
        np.testing.assert_array_equal(written_chances(reader, seen, UprightConfig()), chances)
        found[way] = upright_way(chances, UprightConfig())[0]
    assert all(said in (way, Orientation(0, False)) for way, said in found.items())
    assert sum(said == way for way, said in found.items()) >= 5


def test_what_cannot_be_read_is_left_as_it_lies(reader):
    config = UprightConfig()
    rng = np.random.default_rng(3)
    blank = np.full((900, 700), 20, np.uint8)
    noise = rng.integers(0, 60, (900, 700), dtype=np.uint8)
    tissue = draw_print(FilmDrawing(texts=False), rng)
    for film in (blank, noise, tissue):
        assert upright_way(written_chances(reader, rgb(film), config), config)[0] == RIGHT


def test_no_more_is_read_than_is_needed(reader):
    """Clear writing ends the reading early; where nothing is ever sure enough, all of it is read."""
    looked = []
    hook = reader.register_forward_hook(lambda _, patches, __: looked.append(patches[0].shape[1]))
    try:
        written_chances(reader, rgb(written_film()), UprightConfig())
        clear = sum(looked)
        looked.clear()
        written_chances(reader, rgb(written_film()), UprightConfig(enough=1.1))
    finally:
        hook.remove()
    assert clear < sum(looked) <= reader.config.patches


def test_without_evidence_most_films_lie_right():
    prior = UprightConfig().prior
    assert prior.sum() == pytest.approx(1)
    assert prior[0] > 0.8
    assert prior[1:4].min() > prior[4:].max()  # photographed from behind: rarer than turned


def chances_of(**ways: float) -> np.ndarray:
    """Chances of the ways named w0 to w7; the others share what is left."""
    chances = np.full(8, (1 - sum(ways.values())) / (8 - len(ways)), np.float32)
    for name, chance in ways.items():
        chances[int(name[1:])] = chance
    return chances


def test_weak_evidence_moves_no_film():
    config = UprightConfig(min_probability=0.95)
    way, reason = upright_way(chances_of(w0=0.07, w1=0.92), config)
    assert way == RIGHT
    assert "left as it lies" in reason
    assert upright_way(chances_of(w0=0.07, w1=0.92), replace(config, min_probability=0.9))[0] == TURNED


def test_a_film_that_surely_lies_wrong_is_moved_as_it_most_likely_reads():
    """Such as one on its side of which only the slices can be read: it may be mirrored or not."""
    assert upright_way(chances_of(w0=0.001, w1=0.7, w7=0.29), UprightConfig())[0] == TURNED
