"""LightNet: its losses, the units and truth of its training data, and what it reads in known light."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from light_reader import READER
from surroundings_case import scene

from data_gen.camera.develop import Lens
from data_gen.lit_films import LitFilmsConfig, _photographed, lit_film, lit_films
from data_gen.render.shade import FilmLight
from data_gen.sample import SampleConfig, densest_of
from data_gen.sources import SourceConfig
from hybrid.coords import linear_from_srgb, linear_from_srgb_tensor, srgb_from_linear
from hybrid.errors import ConfigError, DataError
from hybrid.gsdf import light_through
from hybrid.learn.datasets.light import (
    UNDISTURBED,
    LightAugment,
    LitPlace,
    light_batch,
    light_view,
    open_lit_films,
    read_lit_film,
    split_films,
    toned,
)
from hybrid.learn.datasets.patterns import drawn_pattern
from hybrid.learn.networks.lightnet import (
    SURE_STEP,
    Attention,
    LightNet,
    LightNetConfig,
    LightNetOutput,
    LightTargets,
    film_error,
    films_tensor,
    light_losses,
)
from hybrid.learn.networks.weights import packaged_light_net, parameter_count
from hybrid.levels import LEAST_CONTRAST, USUAL_ROOT_SHARE, grey_table

PX = 128


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> list[LitPlace]:
    """Two films with two photos each."""
    out = tmp_path_factory.mktemp("lit")
    lit_films(LitFilmsConfig(2, out, photos=2, workers=1))
    return open_lit_films([out])


def output_of(black: torch.Tensor, gain: torch.Tensor, root_share: float = 1.0) -> LightNetOutput:
    """An output with these levels; a root share of 1 turns light back into the print of ``targets``."""
    return LightNetOutput(black, gain, torch.full((len(black),), root_share))


def targets(px: int = PX) -> LightTargets:
    """A film of random grey in even light, seen without disturbances."""
    flat = torch.rand(1, px, px, generator=torch.Generator().manual_seed(0))
    black, white = (torch.full((1, px // 2, px // 2), level) for level in (0.1, 0.5))
    contrast = torch.full_like(black, float(np.diff(srgb_from_linear(np.array([0.1, 0.5])))[0]))
    return LightTargets(0.1 + 0.4 * flat**2, black, white, contrast, flat, torch.ones(1, px, px))


# ---------------------------------------------------------------- losses


def test_a_perfect_prediction_costs_nothing() -> None:
    truth = targets()
    terms = light_losses(output_of(truth.black, truth.white - truth.black), truth)
    for name in ("black", "gain", "contrast", "slope"):
        assert float(terms[name]) == pytest.approx(0, abs=1e-5)
    assert float(film_error(output_of(truth.black, truth.white - truth.black), truth)[0]) < 1e-5


def test_losses_by_hand() -> None:
    truth = targets()
    terms = light_losses(output_of(truth.black, 2 * (truth.white - truth.black)), truth)
    assert float(terms["gain"]) == pytest.approx(np.log(2), abs=1e-4)
    assert float(terms["slope"]) == pytest.approx(0, abs=1e-5)
    black = np.sqrt(0.3 / 0.5 + 1e-3) - np.sqrt(0.1 / 0.5 + 1e-3)
    terms = light_losses(output_of(truth.black + 0.2, truth.white - truth.black), truth)
    assert float(terms["black"]) == pytest.approx(black, abs=1e-4)
    shown = np.diff(srgb_from_linear(np.array([[0.3, 0.7], [0.1, 0.5]])), axis=1)
    assert float(terms["contrast"]) == pytest.approx(abs(shown[0, 0] - shown[1, 0]), abs=1e-4)


def test_glare_that_is_not_read_costs_what_it_is_off_by() -> None:
    """Print and glare, half and half: the loss of a correct reading, and of one with 20 levels of contrast in glare."""
    truth = targets()
    lost = torch.zeros_like(truth.contrast).bool()
    lost[..., : lost.shape[-1] // 2] = True
    black, white = (torch.where(lost, 1.0, x) for x in (truth.black, truth.white))
    truth = replace(truth, black=black, white=white, contrast=torch.where(lost, 0.0, truth.contrast))
    right = float(light_losses(output_of(black, white - black), truth)["glare"])
    assert right == pytest.approx(0.5 * np.log1p(np.exp(-LEAST_CONTRAST / SURE_STEP)), abs=1e-3)
    dark = float(linear_from_srgb(np.array(235 / 255)))
    read = output_of(torch.where(lost, dark, black), torch.where(lost, 1 - dark, white - black))
    off = (20 / 255 - LEAST_CONTRAST) / SURE_STEP
    assert float(light_losses(read, truth)["glare"]) == pytest.approx(0.5 * np.log1p(np.exp(off)), abs=2e-3)


def test_a_wrong_tone_costs_film_and_a_right_one_nothing() -> None:
    truth = targets()
    right, wrong = (output_of(truth.black, truth.white - truth.black, share) for share in (1.0, 0.3))
    assert float(film_error(right, truth)[0]) < 1e-5 < float(film_error(wrong, truth)[0])


def test_print_in_the_levels_costs_more_than_light_that_is_off_by_as_much() -> None:
    truth = targets()
    gain = truth.white - truth.black
    checks = 1 + 0.2 * (torch.arange(gain.shape[1])[:, None] + torch.arange(gain.shape[2]) & 1)
    broad = 1 + 0.1 * torch.ones_like(gain)
    slope = [float(light_losses(output_of(truth.black, gain * x), truth)["slope"]) for x in (checks, broad)]
    assert slope[0] > 0.05
    assert slope[1] == pytest.approx(0, abs=1e-5)


def test_pixels_that_do_not_count_do_not_count() -> None:
    truth = targets()
    spoilt = truth.grey.clone()
    spoilt[:, :20] = 1.0
    counted = truth.counted.clone()
    counted[:, :20] = 0.0
    output = output_of(truth.black, truth.white - truth.black)
    assert float(film_error(output, replace(truth, grey=spoilt, counted=counted))[0]) < 1e-5
    assert float(film_error(output, replace(truth, grey=spoilt))[0]) > 1e-3
    assert float(film_error(output, replace(truth, counted=torch.zeros_like(counted)))[1]) == 0


# ---------------------------------------------------------------- data


def test_the_levels_of_a_film_explain_its_photos(places: list[LitPlace]) -> None:
    """Photo = black + (white - black) * print in linear light, up to tone curve, blur, noise and coding. One of the
    films has a display's greys, the other is printed by DICOM's display function."""
    counted = 0
    for place in places:
        view = light_view(place, PX, np.random.default_rng(0), UNDISTURBED)
        table = grey_table()
        grey = sum(table[view.image[..., k], k] for k in range(3))
        densest = densest_of([0, int(place.path.stem), 2], SampleConfig())
        light = linear_from_srgb(view.flat) if densest is None else light_through(view.flat, densest)
        told = view.black + (view.white - view.black) * light
        free = view.white < 0.9
        if free.any():  # a photo may be clipped everywhere
            counted += 1
            assert np.abs(srgb_from_linear(grey) - srgb_from_linear(told))[free].mean() < 0.04
    assert counted >= 2


def test_another_print_lies_in_the_same_light_exactly(places: list[LitPlace]) -> None:
    augment = replace(UNDISTURBED, other_print=1.0)
    for seed in range(4):
        view = light_view(places[0], PX, np.random.default_rng(seed), augment)
        grey = sum(grey_table()[view.image[..., k], k] for k in range(3))
        told = view.black + (view.white - view.black) * linear_from_srgb(view.flat)
        assert np.abs(srgb_from_linear(grey) - srgb_from_linear(told)).max() < 0.01


def test_parts_of_prints_lie_in_the_same_light_exactly(places: list[LitPlace]) -> None:
    augment = replace(UNDISTURBED, other_print=1.0, joined=1.0, windowed=1.0)
    prints = [read_lit_film(path).flat for path in places[0].films]
    for seed in range(4):
        view = light_view(places[0], PX, np.random.default_rng(seed), augment)
        grey = sum(grey_table()[view.image[..., k], k] for k in range(3))
        told = view.black + (view.white - view.black) * linear_from_srgb(view.flat)
        assert np.abs(srgb_from_linear(grey) - srgb_from_linear(told)).max() < 0.01
        assert view.flat.max() > 0.5
        assert all(np.abs(np.sort(view.flat.ravel()) - np.sort(flat.ravel()) / 255).max() > 0.02 for flat in prints)


def test_a_further_tone_curve_moves_levels_and_film_alike(places: list[LitPlace]) -> None:
    for strength in (-0.5, 2.0):
        augment = replace(UNDISTURBED, toned=1.0, tones=(strength, strength))
        plain, view = (light_view(places[0], PX, np.random.default_rng(1), a) for a in (UNDISTURBED, augment))
        np.testing.assert_allclose(view.black, toned(plain.black, strength), atol=1e-5)
        np.testing.assert_allclose(view.white, toned(plain.white, strength), atol=1e-5)
        np.testing.assert_array_equal(view.flat, plain.flat)
        grey, before = (sum(grey_table()[x.image[..., k], k] for k in range(3)) for x in (view, plain))
        free = plain.image.max(axis=2) < 200  # bright colours may clip
        assert np.abs(grey - toned(before, strength))[free].max() < 0.02


def test_tone_curves_by_hand() -> None:
    light = np.array([0.0, 0.25, 1.0], np.float32)
    np.testing.assert_allclose(toned(light, 1.0), [0, 0.4, 1], atol=1e-6)
    np.testing.assert_allclose(toned(light, -1.0), [0, 1 / 7, 1], atol=1e-6)
    np.testing.assert_allclose(toned(light, 0.0), light)


def test_a_view_depends_on_its_numbers_alone(places: list[LitPlace]) -> None:
    one, again, other = (light_view(places[1], PX, np.random.default_rng(k), LightAugment()) for k in (3, 3, 4))
    np.testing.assert_array_equal(one.image, again.image)
    np.testing.assert_array_equal(one.black, again.black)
    assert not np.array_equal(one.image, other.image)


def test_what_lies_before_the_film_is_not_print(places: list[LitPlace]) -> None:
    augment = replace(UNDISTURBED, covered=1.0, told=0.0)
    view = light_view(places[0], PX, np.random.default_rng(1), augment)
    assert view.seen.all()
    assert 0 < (~view.shows_print).mean() < 0.2
    told = light_view(places[0], PX, np.random.default_rng(1), replace(augment, told=1.0))
    np.testing.assert_array_equal(told.seen, told.shows_print)
    images, truth = light_batch([view, told])
    assert images.shape == (2, 4, PX, PX)
    assert float(truth.counted.sum()) > 0
    assert not truth.counted.numpy()[:, ~view.shows_print].any()


def test_a_seed_gives_the_same_films_and_patterns() -> None:
    one, again = (lit_film(5, 0, 1, SourceConfig()) for _ in range(2))
    for name in ("photos", "flat", "black", "white"):
        np.testing.assert_array_equal(getattr(one, name), getattr(again, name))
    pattern, other = (drawn_pattern(PX, np.random.default_rng(k)) for k in (1, 2))
    np.testing.assert_array_equal(pattern, drawn_pattern(PX, np.random.default_rng(1)))
    assert not np.array_equal(pattern, other)


@pytest.mark.parametrize("local", [0.0, 0.6])
def test_levels_are_what_the_camera_shows_of_print_white(local: float) -> None:
    """Also where a phone makes dark parts brighter: a white print is everywhere as bright as its level says."""
    v = np.linspace(0.2, 1.0, 64, dtype=np.float32)[:, None, None]
    light = FilmLight(np.broadcast_to(v, (64, 64, 3)).copy(), np.full((64, 64, 3), 0.05, np.float32))
    lens = Lens(0.5, 0.0, 0.0, "srgb", 0.0, 0.0, local, 0.1, 0.0, 0.0, 0.0, 1e-4, 96)
    of = replace(scene("room", 1), lens=lens)
    photo, _, white = _photographed(light, light.gain, of, np.ones((96, 96), np.float32), np.random.default_rng(0))
    shown = photo[::2, ::2].mean(axis=-1)
    np.testing.assert_allclose(shown[2:-2], white[2:-2], atol=4)
    contrast = float(shown[-4].mean() / shown[4].mean())
    assert (contrast < 1.6) == (local > 0)


def test_prints_that_are_held_out_are_in_no_view_that_is_trained_on(places: list[LitPlace]) -> None:
    """All photos of a held-out film are held out, even if fewer were asked for."""
    held_out, trained_on = split_films(places, 1)
    assert [place.number for place in held_out] == [0, 1]
    assert len(trained_on) == 2
    for place in trained_on:
        assert place.films == (places[-1].path,)
    assert split_films(places, 0) == ([], list(places))


def test_a_cast_of_the_light_changes_no_grey(places: list[LitPlace]) -> None:
    """The levels are in linear grey: a cast that changed it would make them wrong."""
    views = [light_view(places[0], PX, np.random.default_rng(3), replace(UNDISTURBED, cast=x)) for x in (0.0, 0.3)]
    plain, cast = (grey_table()[view.image, np.arange(3)].sum(axis=-1) for view in views)
    assert np.abs(views[1].image.astype(int) - views[0].image).max() > 10
    bright = (plain > 0.05) & (views[1].image.max(axis=-1) < 255)
    assert np.abs(np.log(cast[bright] / plain[bright])).mean() < 0.02  # as eight bits round the darkest; 0.04 if not


def test_films_made_with_other_options_are_not_gone_on_with(tmp_path: Path) -> None:
    lit_films(LitFilmsConfig(1, tmp_path, photos=1, workers=1))
    with pytest.raises(ConfigError, match="photos, seed"):
        lit_films(LitFilmsConfig(1, tmp_path, seed=9, photos=3, workers=1))
    kept = (tmp_path / "000000.npz").read_bytes()
    lit_films(LitFilmsConfig(2, tmp_path, photos=1, workers=1))
    assert (tmp_path / "000000.npz").read_bytes() == kept
    assert len(open_lit_films([tmp_path])) == 2


def test_folders_and_files_of_something_else_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="lit_films"):
        open_lit_films([tmp_path])
    path = tmp_path / "000000.npz"
    np.savez(path, photos=np.zeros(1))
    with pytest.raises(DataError, match="Make it again"):
        read_lit_film(path)


# ---------------------------------------------------------------- the network


def test_the_shipped_network_is_small() -> None:
    assert parameter_count(packaged_light_net()) < 2_000_000


def test_attention_changes_nothing_before_it_has_learnt() -> None:
    features = torch.rand(2, 16, 8, 8)
    torch.testing.assert_close(Attention(16, 4)(features), features)


def test_attention_finds_what_is_alike_wherever_it_lies() -> None:
    """Each place gets the mean of what looks like it: with two kinds in any arrangement, that of its own kind."""
    layer = Attention(2, 1)
    with torch.no_grad():
        layer.asked.weight.zero_()
        layer.asked.bias.zero_()
        for part, gain in ((0, 20.0), (1, 20.0), (2, 1.0)):  # query, key and value
            layer.asked.weight[2 * part : 2 * part + 2, :2, 0, 0] = gain * torch.eye(2)
        layer.said.weight[:, :, 0, 0] = torch.eye(2)
        kind = torch.rand(1, 1, 6, 6) > 0.5
        features = torch.cat([kind, ~kind], dim=1).float()
        torch.testing.assert_close(layer(features), 2 * features, atol=1e-3, rtol=0)


def test_the_tone_that_is_told_is_a_tone_curve() -> None:
    network = LightNet(LightNetConfig()).eval()
    films = torch.rand(2, 4, PX, PX)
    with torch.inference_mode():
        assert network(films).root_share.tolist() == pytest.approx([USUAL_ROOT_SHARE] * 2)
        network.tone.bias.fill_(100.0)
        assert network(films).root_share.max() <= 2.0  # above this, the curve would fall near white
        network.tone.bias.fill_(-100.0)
        assert network(films).root_share.min() >= 0.0  # below this, it would fall near black


def test_light_is_read_in_units_of_the_film(places: list[LitPlace]) -> None:
    view = light_view(places[0], PX, np.random.default_rng(0), UNDISTURBED)
    network = packaged_light_net().eval()
    film = films_tensor(np.ascontiguousarray(view.image)[None], np.ascontiguousarray(view.seen)[None])
    dim = film.clone()
    dim[:, :3] = torch.from_numpy(srgb_from_linear(0.5 * linear_from_srgb_tensor(film[:, :3]).numpy()))
    with torch.inference_mode():
        bright, dark = network(film), network(dim)
    if float(film[:, :3].max()) < 0.98:  # clipped pixels are marked, and do not clip in half the light
        torch.testing.assert_close(dark.black, 0.5 * bright.black, rtol=1e-3, atol=1e-5)
        torch.testing.assert_close(dark.gain, 0.5 * bright.gain, rtol=1e-3, atol=1e-5)


def test_levels_that_are_known_are_read() -> None:
    """Test patterns in even light: black is read, and white to within a half, since not all of them show it."""
    for seed in range(3):
        rng = np.random.default_rng(40 + seed)
        flat = linear_from_srgb(drawn_pattern(PX, rng) / 255)
        image = np.rint(255 * srgb_from_linear(0.05 + 0.4 * flat)[..., None].repeat(3, axis=2)).astype(np.uint8)
        levels = READER.read(image, np.ones((PX, PX), bool))
        assert abs(float(np.median(levels.black)) - 0.05) < 0.03
        assert 0.2 < float(np.median(levels.gain)) < 0.6


def test_what_is_not_seen_changes_nothing() -> None:
    flat = linear_from_srgb(drawn_pattern(PX, np.random.default_rng(7)) / 255)
    image = np.rint(255 * srgb_from_linear(0.05 + 0.4 * flat)[..., None].repeat(3, axis=2)).astype(np.uint8)
    seen = np.ones((PX, PX), bool)
    seen[:, 100:] = False
    spoilt = image.copy()
    spoilt[:, 100:] = 200
    one, other = READER.read(image, seen), READER.read(spoilt, seen)
    np.testing.assert_array_equal(one.black, other.black)
    np.testing.assert_array_equal(one.gain, other.gain)


def test_fields_are_half_as_large_as_the_film() -> None:
    with torch.inference_mode():
        output = LightNet(LightNetConfig()).eval()(torch.rand(2, 4, 64, 64))
    assert output.black.shape == output.gain.shape == (2, 32, 32)
    assert float(output.black.min()) >= 0
    assert float(output.gain.min()) > 0
