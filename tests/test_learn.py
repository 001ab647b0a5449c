"""The network, its losses, its views and its weights files."""

import pickle
import re
import signal
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from data_gen.camera.viewpoint import ViewConfig
from data_gen.generate import GenerateConfig, generate
from data_gen.sample import SampleConfig
from data_gen.scene.scene import SceneConfig
from hybrid.backward import BackwardMap, Orientation, orientation
from hybrid.coords import film_centres, film_nodes, pixel_centres, rescale_points
from hybrid.errors import ConfigError, DataError
from hybrid.learn.datasets import behind
from hybrid.learn.datasets.film import AugmentConfig, grid_along, random_view, training_view
from hybrid.learn.datasets.samples import film_of, open_places, photo_of, truth_at
from hybrid.learn.networks.filmnet import STRIDE, FilmNet, FilmNetConfig, FilmNetOutput
from hybrid.learn.networks.inference import PackedConv, fast_bfloat16, ready
from hybrid.learn.networks.losses import (
    LossWeights,
    Targets,
    cell_phases,
    covered_loss,
    in_grid,
    loss_terms,
    masked_mean,
    phase_loss,
    scale_loss,
    slope_loss,
    uv_loss,
)
from hybrid.learn.networks.uprightnet import UprightNet, UprightNetConfig
from hybrid.learn.networks.weights import (
    load_into,
    load_weights,
    packaged_slice_net,
    packaged_upright_net,
    parameter_count,
    save_weights,
)
from hybrid.learn.paper.views import PaperView, paper_batch
from hybrid.learn.reading.predict import as_in_view, look, look_from_sides
from hybrid.learn.reading.views import film_from_view, film_view, output_points, square_view, view_image
from hybrid.learn.training import state as state_module
from hybrid.learn.training import train as train_module
from hybrid.learn.training.plan import TrainConfig
from hybrid.learn.training.presets import PRESETS, weighted_sum
from hybrid.learn.training.train import train
from hybrid.pipeline import Rectifier
from hybrid.pyramid import Pyramid
from hybrid.records import CoarseMaps

TINY = FilmNetConfig(widths=(4, 8, 8, 8), blocks=(1, 1, 1), input_px=64)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("data")
    sample = SampleConfig(photos_per_film=4)
    generate(GenerateConfig(count=12, out=out, seed=7, size=96, map_size=64, workers=0, shard_size=8, sample=sample))
    return out


def random_case(seed=0, b=2, n=8):
    g = torch.Generator().manual_seed(seed)

    def draw(*shape):
        return torch.rand(*shape, generator=g)

    output = FilmNetOutput(
        draw(b, n, n) - 0.5,
        draw(b, 2, n, n),
        draw(b, 3, n, n),
        draw(b, n, n),
        draw(b, n, n) - 3,
        draw(b, 2, 2, n, n) - 0.5,
        draw(b, n, n) - 0.5,
        draw(b, n, n) - 0.5,
        draw(b, 8),
        draw(b, 3, n, n),
    )
    return output, targets_of(draw(b, n, n) > 0.3, draw(b, 2, n, n), draw(b, 3, n, n), draw(b, n, n), draw(b, 3, n, n))


def targets_of(mask, uv, xyz, albedo, normal) -> Targets:
    """Targets of upright films of 4 x 3 cells, all of the same weight."""
    b = len(mask)
    grid = torch.tensor([[0.05, 0.3, 3.0], [0.1, 0.2, 4.0]]).expand(b, 2, 3)
    covered = torch.zeros_like(mask)
    return Targets(mask, uv, xyz, albedo, normal, covered, grid, torch.zeros(b, dtype=torch.int64), *torch.ones(4, b))


# ---------------------------------------------------------------- network


@pytest.mark.parametrize("px", [64, 128])
def test_maps_are_a_quarter_of_the_input(px):
    output = FilmNet(TINY)(torch.rand(2, 3, px, px))
    assert output.uv.shape == (2, 2, px // STRIDE, px // STRIDE)
    assert output.xyz.shape == (2, 3, px // STRIDE, px // STRIDE)


def seen_before_and_ready(images: int, precision: torch.dtype) -> tuple[FilmNetOutput, FilmNetOutput]:
    """A network's output for some images, before and after it is made ready."""
    torch.manual_seed(0)
    network = FilmNet(TINY).train()
    for _ in range(3):
        network(torch.rand(4, 3, 64, 64))
    image = torch.rand(images, 3, 64, 64)
    with torch.no_grad():
        before = network.eval()(image)
        return before, ready(network, precision)(image)


@pytest.mark.parametrize("images", [1, 3])
def test_making_a_network_ready_changes_nothing(images):
    before, after = seen_before_and_ready(images, torch.float32)
    torch.testing.assert_close(after.uv, before.uv, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(after.mask_logit, before.mask_logit, atol=1e-5, rtol=1e-4)


HALF = pytest.mark.skipif(not fast_bfloat16("cpu"), reason="a processor without instructions for bfloat16")


@HALF
def test_in_bfloat16_a_network_says_nearly_the_same_in_single_precision():
    before, after = seen_before_and_ready(2, torch.bfloat16)
    assert after.uv.dtype is torch.float32
    off = (after.uv - before.uv).abs()
    assert 0 < off.mean() < 0.002
    assert off.max() < 0.01
    assert len(torch.unique(after.mask_logit)) > 0.9 * after.mask_logit.numel()  # not rounded to bfloat16


@HALF
@torch.inference_mode()
@pytest.mark.parametrize("net", [packaged_upright_net, packaged_slice_net])
def test_in_bfloat16_votes_are_nearly_the_same(net: Callable[[], torch.nn.Module]):
    torch.manual_seed(0)
    pictures = torch.rand(2, 5, *2 * (net().config.input_px,))
    before, after = (ready(net(), precision)(pictures) for precision in (torch.float32, torch.bfloat16))
    assert after.votes.dtype is torch.float32
    assert (after.votes - before.votes).abs().max() < 0.05


@pytest.mark.skipif(not torch.backends.mkldnn.is_available(), reason="PyTorch without oneDNN")
@pytest.mark.parametrize(("kernel", "stride", "groups"), [(1, 1, 1), (3, 2, 1), (7, 4, 2)])
def test_a_packed_convolution_is_the_convolution(kernel, stride, groups):
    torch.manual_seed(0)
    conv = torch.nn.Conv2d(6, 8, kernel, stride, kernel // 2, groups=groups)
    with torch.inference_mode():
        packed = PackedConv(conv)
        for size in ((1, 6, 16, 16), (3, 6, 20, 12)):
            image = torch.rand(size).contiguous(memory_format=torch.channels_last)
            torch.testing.assert_close(packed(image), conv(image), atol=1e-5, rtol=1e-5)
            with_relu = PackedConv(conv, relu=True)(image)
            torch.testing.assert_close(with_relu, conv(image).relu(), atol=1e-5, rtol=1e-5)


@torch.inference_mode()
@pytest.mark.skipif(not torch.backends.mkldnn.is_available(), reason="PyTorch without oneDNN")
def test_weights_are_not_laid_out_anew_whatever_the_batch(capfd):
    conv = PackedConv(torch.nn.Conv2d(80, 80, 3, padding=1))
    images = [torch.rand(n, 80, 16, 16).contiguous(memory_format=torch.channels_last) for n in (1, 2, 4)]
    for image in images:
        conv(image)
    capfd.readouterr()
    with torch.backends.mkldnn.verbose(torch.backends.mkldnn.VERBOSE_ON):
        for image in images:
            conv(image)
    told = capfd.readouterr().out
    assert told.count("exec,cpu,convolution") == len(images)
    assert "exec,cpu,reorder" not in told


def test_the_shipped_network_is_within_its_budget():
    assert parameter_count(FilmNet(FilmNetConfig())) <= 8_000_000


# ---------------------------------------------------------------- losses


def test_losses_by_hand():
    mask = torch.tensor([[[True, True], [False, False]], [[True, False], [False, False]]])
    error = torch.tensor([[[0.1, 0.3], [9.0, 9.0]], [[0.4, 9.0], [9.0, 9.0]]])
    assert float(masked_mean(error, mask)) == pytest.approx((0.2 + 0.4) / 2)
    zero = torch.zeros(2, 2, 2, 2)
    targets = targets_of(mask, zero, torch.zeros(2, 3, 2, 2), torch.zeros(2, 2, 2), torch.zeros(2, 3, 2, 2))
    uv = torch.stack([error, error], dim=1)
    zeros = torch.zeros(2, 2, 2)
    phases = torch.zeros(2, 2, 2, 2, 2)
    output = FilmNetOutput(zeros, uv, torch.zeros(2, 3, 2, 2), zeros, zeros, phases, zeros, zeros, torch.zeros(2, 8))
    assert float(uv_loss(output, targets)) == pytest.approx(2 * 0.3)
    # One neighbouring pair of film pixels, in the first film only: |0.3 - 0.1| for u and for v.
    assert float(slope_loss(output, targets)) == pytest.approx(0.4 / 2, abs=1e-6)
    assert float(loss_terms(output, targets)["mask"]) == pytest.approx(np.log(2))
    assert float(loss_terms(output, targets)["orientation"]) == pytest.approx(np.log(8))
    # A film that weighs twice as much counts twice.
    heavy = replace(targets, weight=torch.tensor([2.0, 1.0]))
    assert float(uv_loss(output, heavy)) == pytest.approx(2 * (2 * 0.2 + 0.4) / 2)


def test_an_error_costs_most_where_least_is_expected():
    """Laplace: it costs least to expect the true error; expecting a tenth of it or ten times as much costs more."""
    _, targets = random_case()
    output, _ = random_case(seed=1)
    error = (output.uv - targets.uv).abs().mean(dim=1)
    costs = [float(scale_loss(replace(output, log_scale=(factor * error).log()), targets)) for factor in (0.1, 1, 10)]
    assert costs[1] < min(costs[0], costs[2])
    assert costs[0] - costs[1] == pytest.approx(10 - 1 - np.log(10), rel=1e-3)


def test_what_lies_before_the_film_is_learnt_where_the_sheet_is_and_phases_where_cells_are():
    output, targets = random_case()
    hand = ~targets.mask
    hand[:, 4:] = False
    covered = replace(targets, covered=hand)
    elsewhere = ~(targets.mask | hand)
    sure = torch.where(hand, 40.0, -40.0)
    assert float(covered_loss(replace(output, covered_logit=sure), covered)) < 1e-6
    assert float(covered_loss(replace(output, covered_logit=torch.where(elsewhere, -sure, sure)), covered)) < 1e-6
    assert float(covered_loss(replace(output, covered_logit=torch.where(hand, -sure, sure)), covered)) > 1
    inside = in_grid(targets.uv, targets.grid)
    true = cell_phases(targets.uv, targets.grid)
    wrong = torch.where(inside[:, None, None], true, true + 5)
    assert float(phase_loss(replace(output, phases=wrong), targets)) < 1e-6
    assert float(phase_loss(replace(output, phases=true + 5), targets)) > 1


def test_a_perfect_prediction_costs_nothing():
    _, targets = random_case()
    logit = torch.where(targets.mask, 40.0, -40.0)
    upright = torch.nn.functional.one_hot(targets.orientation, 8) * 40.0
    scale = torch.full_like(logit, -3.0)
    phases = cell_phases(targets.uv, targets.grid)
    cells = torch.where(in_grid(targets.uv, targets.grid), 40.0, -40.0)
    covered = torch.where(targets.covered, 40.0, -40.0)
    maps = (logit, targets.uv, targets.xyz, targets.albedo, scale, phases, cells, covered)
    perfect = FilmNetOutput(*maps, upright, targets.normal)
    terms = loss_terms(perfect, targets)
    assert all(float(term) < 1e-6 for name, term in terms.items() if name != "scale")


def test_losses_do_not_see_the_background():
    output, targets = random_case()
    noisy = FilmNetOutput(
        output.mask_logit,
        torch.where(targets.mask[:, None], output.uv, 77.0),
        torch.where(targets.mask[:, None], output.xyz, 77.0),
        torch.where(targets.mask, output.albedo, 77.0),
        output.log_scale,
        torch.where(targets.mask[:, None, None], output.phases, 77.0),
        torch.where(targets.mask, output.grid_logit, 77.0),
        torch.where(targets.mask, output.covered_logit, 77.0),
        output.orientation,
        output.normal,
    )
    before, after = loss_terms(output, targets), loss_terms(noisy, targets)
    for name, value in before.items():
        assert float(after[name]) == pytest.approx(float(value), rel=1e-5)
    assert float(weighted_sum(before, asdict(LossWeights()))) > 0


# ---------------------------------------------------------------- views


def test_an_undisturbed_view_is_the_sample(dataset):
    place = open_places([dataset])[2]
    view = training_view(place, 96, np.random.default_rng(0), None)
    assert view.image.shape == (96, 96, 3)
    uv = Orientation.from_index(view.orientation).film_from_seen(view.uv[view.mask].astype(np.float64))
    n = 96 // STRIDE
    centres = rescale_points(pixel_centres((n, n)), (n, n), (96, 96))[view.mask]
    assert np.median(np.linalg.norm(film_of(place).photo_from_film(uv) - centres, axis=1)) < 0.1


def kind_of_view(**shares) -> AugmentConfig:
    return replace(AugmentConfig(), **({"colours": False, "empty_share": 0.0} | shares))


def test_a_view_shows_the_film_as_seen(dataset):
    """In every view, however turned or mirrored, u runs to the right and v down, and so do x and y."""
    places = open_places([dataset])
    for kind in (
        {"whole_share": 1.0},
        {"whole_share": 0.0, "plane_share": 1.0},
        {"whole_share": 0.0, "plane_share": 0.0},
    ):
        for seed in range(8):
            view = training_view(places[seed], 64, np.random.default_rng(seed), kind_of_view(**kind))
            if view.mask.sum() < 40:
                continue
            at = film_centres(view.mask.shape)[view.mask]
            for axis in (0, 1):
                assert np.corrcoef(at[:, axis], view.uv[view.mask][:, axis])[0, 1] > 0.6
                assert np.corrcoef(at[:, axis], view.xyz[view.mask][:, axis])[0, 1] > 0.4
            assert 0.1 < np.linalg.norm(view.xyz[view.mask], axis=-1).max() < 0.9  # film diagonals


def test_the_cells_of_a_view_lie_where_its_film_has_them(dataset):
    for number, place in enumerate(open_places([dataset])):
        view = training_view(place, 96, np.random.default_rng(number), AugmentConfig(empty_share=0.0))
        shard, index = place
        vertices = np.array(shard.record(index)["grid"]["film"])
        assert view.grid is not None
        assert sorted(view.grid[:, 2] + 1) == sorted(vertices.shape[:2])
        seen = Orientation.from_index(view.orientation).seen_from_film(vertices)
        pair = cell_phases(torch.tensor(seen).permute(2, 0, 1)[None], torch.tensor(view.grid)[None])
        np.testing.assert_allclose(pair[0, :, 0], 1.0, atol=1e-4)  # cells begin at the corners


def test_the_orientation_of_a_view_undoes_its_turns(dataset):
    """A view's label agrees with the sample's own truth: turned back by it, uv map to the photo points of the view."""
    place = open_places([dataset])[1]
    film = film_of(place)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        view = training_view(place, 64, rng, kind_of_view(whole_share=0.0, plane_share=0.0))
        again, _ = random_view(
            film, (96, 96), np.random.default_rng(seed), kind_of_view(whole_share=0.0, plane_share=0.0)
        )
        points = output_points(again, 64, STRIDE)[view.mask].astype(np.float64)
        uv = Orientation.from_index(view.orientation).film_from_seen(view.uv[view.mask].astype(np.float64))
        assert np.median(np.linalg.norm(film.photo_from_film(uv) - points, axis=-1)) < 0.1


def test_some_views_show_no_film(dataset):
    place = open_places([dataset])[0]
    shares = [
        training_view(place, 64, np.random.default_rng(seed), kind_of_view(empty_share=1.0)).mask.mean()
        for seed in range(8)
    ]
    assert min(shares) == 0


def test_flattened_views_hold_the_film_about_where_it_belongs(dataset):
    place = open_places([dataset])[0]
    errors = replace(kind_of_view(whole_share=0.0, plane_share=0.0), bend_error=(1e-6, 1.1e-6), margin=(0.1, 0.1001))
    view = training_view(place, 64, np.random.default_rng(0), errors)
    expected = film_from_view(film_centres(view.mask.shape), 0.1)
    assert np.quantile(np.abs(view.uv - expected)[view.mask], 0.95) < 0.005


@pytest.mark.parametrize("kind", list(behind.KINDS))
def test_what_is_put_behind_a_film_changes_what_is_around_it_alone(dataset, monkeypatch, kind):
    monkeypatch.setattr(behind, "SHARE", 1.0)
    monkeypatch.setattr(behind, "KINDS", {kind: 1.0})
    film = BackwardMap(film_nodes((9, 9)) * np.array([70.0, 90.0]) + np.array([50.0, 40.0]))
    place, around = open_places([dataset])[5], np.random.default_rng(1)
    photo = cv2.GaussianBlur(around.integers(60, 250, (180, 170, 3), dtype=np.uint8), (0, 0), 2)
    inside = np.zeros((180, 170), bool)
    inside[42:128, 52:118] = True
    changed = set()
    for seed in range(12):
        put = behind.behind_some(place, photo, film, np.random.default_rng(seed))
        np.testing.assert_array_equal(put[inside], photo[inside])
        changed.add(float((np.abs(put.astype(int) - photo).max(axis=2) > 4)[~inside].mean()))
        if kind in ("shadow", "pattern"):
            assert (put <= photo).all()
        again = behind.behind_some(place, photo, film, np.random.default_rng(seed))
        np.testing.assert_array_equal(put, again)
    assert len(changed) >= 10
    assert np.median(list(changed)) > 0.02


def test_another_film_is_another(dataset):
    places = open_places([dataset])
    for index in (0, 5):
        one = film_view(film_of(places[index]), 0.0)
        own = view_image(photo_of(places[index]), one, behind.FILM_PX)
        for seed in range(10):
            assert not np.array_equal(behind.another_film(places[index], np.random.default_rng(seed)), own)


def test_something_is_put_behind_some_films_and_nothing_where_colours_stay(dataset, monkeypatch):
    records = [(place, place[0].record(place[1])) for place in open_places([dataset])]
    milky = [place for place, one in records if not one["things"] and behind.clear_share(one) <= behind.CLEAR]
    place = milky[0]  # behind others only shadows are put, or nothing
    photo, film = photo_of(place), film_of(place)
    put = [behind.behind_some(place, photo, film, np.random.default_rng(seed)) is not photo for seed in range(100)]
    assert abs(np.mean(put) - behind.SHARE) < 0.15
    asked = []
    monkeypatch.setattr(behind, "behind_some", lambda place, photo, film, rng: asked.append(film) or photo)
    training_view(place, 64, np.random.default_rng(0), AugmentConfig())
    assert len(asked) == 1
    training_view(place, 64, np.random.default_rng(0), kind_of_view())
    training_view(place, 64, np.random.default_rng(0), None)
    assert len(asked) == 1


# ---------------------------------------------------------------- data for the paper's networks


def test_windows_for_the_papers_networks_agree_with_their_own_backward_map(dataset):
    places = open_places([dataset])[:4]
    config = kind_of_view()
    images, targets = paper_batch(places, PaperView(64, 33), [np.random.default_rng(0)] * len(places), config)
    assert images.shape == (4, 3, 64, 64)
    for k in range(4):
        film = BackwardMap(targets.backward[k].permute(1, 2, 0).numpy())
        mask = targets.mask[k].numpy()
        uv = targets.uv[k].permute(1, 2, 0).numpy()[mask].astype(np.float64)
        at = film_centres((64, 64))[mask]
        assert np.median(np.linalg.norm(film.photo_from_film(uv) - at, axis=-1)) < 0.002
        lengths = targets.normal[k].norm(dim=0).numpy()[mask]
        assert np.quantile(np.abs(lengths - 1), 0.9) < 0.01


@pytest.mark.parametrize("behind", [False, True])
def test_normals_point_to_the_side_that_is_seen(behind, tmp_path):
    """Normals point to the visible side, as to a network a film seen from behind looks like any other sheet."""
    view = ViewConfig(behind_share=float(behind))
    sample = SampleConfig(photos_per_film=2, scene=SceneConfig(view=view))
    generate(GenerateConfig(count=2, out=tmp_path, seed=3, size=64, map_size=32, workers=0, sample=sample))
    for place in open_places([tmp_path]):
        assert orientation(film_of(place)).mirrored == behind
        seen = truth_at(place, pixel_centres((64, 64)), (64, 64))
        assert np.median(seen.normal[seen.mask][:, 2]) < -0.5  # towards the camera, which looks along z


# ---------------------------------------------------------------- looking


def test_the_photo_points_of_the_maps_cover_the_view():
    photo = np.zeros((100, 150, 3), np.uint8)
    (maps,) = look(ready(FilmNet(TINY)), photo, [square_view((75.0, 50.0), 80.0)])
    np.testing.assert_allclose(maps.photo_points[0, 0], [35 + 2.5, 10 + 2.5], atol=1e-4)
    np.testing.assert_allclose(maps.photo_points.mean(axis=(0, 1)), [75, 50], atol=1e-4)


def test_looks_together_are_looks_one_by_one():
    network, photo = ready(FilmNet(TINY)), np.random.default_rng(0).integers(0, 256, (90, 90, 3), dtype=np.uint8)
    views = [square_view((40.0, 50.0), 60.0), square_view((45.0, 45.0), 90.0)]
    for one, other in zip(look(network, photo, views), (look(network, photo, [v])[0] for v in views), strict=True):
        np.testing.assert_allclose(one.uv, other.uv, atol=1e-5)


def test_a_look_from_another_side_names_the_same_film_points():
    """If a network only outputs each pixel's place in its view, its maps from all sides agree once turned back."""
    network = FilmNet(TINY)
    for parameter in network.head.parameters():
        torch.nn.init.zeros_(parameter)
    network = ready(network)
    photo = np.random.default_rng(0).integers(0, 256, (80, 80, 3), dtype=np.uint8)
    view = square_view((40.0, 40.0), 60.0, turn=0.2)
    for maps in look_from_sides(network, photo, view, range(8)):
        expected = view.film_from_photo(maps.photo_points.reshape(-1, 2).astype(np.float64)).reshape(maps.uv.shape)
        np.testing.assert_allclose(maps.uv, expected, atol=1e-4)


def test_phases_from_another_side_are_those_of_the_same_cells():
    """A perfect network's phases for a turned film of 2 x 3 cells, turned back, are those of the film itself."""
    view = square_view((40.0, 40.0), 60.0)
    grid = np.array([[0.1, 0.3, 2], [0.04, 0.3, 3]])
    corners = np.stack(np.meshgrid(*(first + pitch * np.arange(n + 1) for first, pitch, n in grid)), axis=-1)
    inside = film_centres((7, 7))

    def phases(uv, cells):
        pair = cell_phases(torch.tensor(uv).permute(2, 0, 1)[None].float(), torch.tensor(cells)[None].float())
        return pair[0].permute(2, 3, 0, 1).numpy()

    for side in range(8):
        way = Orientation.from_index(side)
        turned = view.turned(way)
        uv = turned.film_from_photo(view.photo_from_film(inside).reshape(-1, 2)).reshape(inside.shape)
        seen = turned.film_from_photo(view.photo_from_film(corners).reshape(-1, 2)).reshape(corners.shape)
        told = phases(uv, grid_along(seen))
        maps = CoarseMaps(np.ones((7, 7)), uv, np.zeros((7, 7, 3)), np.zeros((7, 7)), inside, phases=told)
        back = as_in_view(maps, way)
        np.testing.assert_allclose(back.uv, inside, atol=1e-6)
        assert back.phases is not None
        np.testing.assert_allclose(back.phases, phases(inside, grid), atol=1e-4)


# ---------------------------------------------------------------- weights and training


def test_weights_come_back_and_are_strict(tmp_path):
    network = FilmNet(TINY).eval()
    path = tmp_path / "w.safetensors"
    save_weights(path, network, TINY, {"passes": 0})
    image = torch.rand(1, 3, 64, 64)
    back = load_weights(path, FilmNet, FilmNetConfig).eval()
    assert back.config == TINY
    with torch.no_grad():
        torch.testing.assert_close(back(image).uv, network(image).uv, atol=5e-3, rtol=5e-3)
    with pytest.raises(DataError, match="safetensors"):
        load_weights(Path(__file__), FilmNet, FilmNetConfig)
    with pytest.raises(DataError, match="weights"):
        load_weights(tmp_path / "missing.safetensors", FilmNet, FilmNetConfig)
    with pytest.raises(DataError, match="UprightNet"):
        load_weights(path, UprightNet, UprightNetConfig)
    with pytest.raises(DataError, match="same preset"):
        load_into(FilmNet(replace(TINY, widths=(4, 8, 8, 16))), path)


def test_the_same_weights_make_the_same_file(tmp_path):
    network, paths = FilmNet(TINY), [tmp_path / f"{k}.safetensors" for k in range(8)]
    for path in paths:
        save_weights(path, network, TINY, {"passes": 0, "seed": 1})
    assert len({path.read_bytes() for path in paths}) == 1


@pytest.mark.parametrize("name", [name for name, chosen in PRESETS.items() if name != "borders"])
def test_weights_of_every_kind_come_back_without_pytorchs_defaults_or_random_numbers(name, tmp_path):
    """Buffers that are not weights, such as DewarpNet's positions, come back too."""
    chosen = PRESETS[name].at_width(0.03) if hasattr(PRESETS[name].config, "width") else PRESETS[name]
    network, path = chosen.network(), tmp_path / "w.safetensors"
    save_weights(path, network, chosen.config, {})
    load_into(network, path)  # rounded to half precision
    random = torch.get_rng_state()
    torch.set_default_dtype(torch.float64)
    try:
        back = load_weights(path, chosen.build, type(chosen.config))
    finally:
        torch.set_default_dtype(torch.float32)
    assert torch.equal(torch.get_rng_state(), random)
    for theirs, ours in ((network.state_dict(), back.state_dict()), *(
        (dict(getattr(network, kind)()), dict(getattr(back, kind)())) for kind in ("named_parameters", "named_buffers")
    )):  # fmt: skip
        assert theirs.keys() == ours.keys()
        for key, value in theirs.items():
            assert (ours[key].dtype, ours[key].device) == (value.dtype, value.device)
            assert ours[key].requires_grad == value.requires_grad
            assert torch.equal(ours[key], value)


def test_rectifying_neither_hears_of_pytorchs_defaults_nor_takes_its_random_numbers():
    photo = Path(__file__).parents[1] / "hybrid" / "examples" / "film.jpg"
    usual = Rectifier()(photo)
    random = torch.get_rng_state()
    torch.set_default_dtype(torch.float64)
    torch.set_default_device("meta")
    try:
        other = Rectifier()(photo)
    finally:
        torch.set_default_device(None)
        torch.set_default_dtype(torch.float32)
    assert torch.equal(torch.get_rng_state(), random)
    assert np.array_equal(other.film, usual.film)
    assert np.array_equal(other.backward.nodes, usual.backward.nodes)
    assert (other.orientation, other.upright_probability) == (usual.orientation, usual.upright_probability)
    assert other.expected_error_px == usual.expected_error_px


@pytest.fixture
def tiny(monkeypatch):
    """The FilmNet preset, reduced to a size for tests."""
    monkeypatch.setitem(PRESETS, "filmnet", replace(PRESETS["filmnet"], config=TINY, batch=4))


def quick_run(dataset, out, passes, **options) -> TrainConfig:
    return TrainConfig(
        data=(dataset,),
        out=out,
        passes=passes,
        held_out=2,
        loaders=0,
        steps_per_test=4,
        minutes_per_save=0.0,
        **options,
    )


@pytest.mark.usefixtures("tiny")
def test_training_resumes_exactly(dataset, tmp_path, monkeypatch):
    """Ctrl-C comes in the middle of the fifth step, after the forward pass and before the update."""
    train(quick_run(dataset, tmp_path / "whole", 32))
    original, calls = state_module.weighted_sum, []

    def interrupted(terms, weights):
        calls.append(1)
        if len(calls) == 5:
            signal.raise_signal(signal.SIGINT)
        return original(terms, weights)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    with monkeypatch.context() as patch:
        patch.setattr(state_module, "weighted_sum", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train(replace(quick_run(dataset, tmp_path / "parts", 32), minutes_per_save=60.0))
    signal.signal(signal.SIGINT, before)
    assert len(calls) == 5
    train(quick_run(dataset, tmp_path / "parts", 32))
    whole, parts = (load_file(tmp_path / name / "filmnet.safetensors") for name in ("whole", "parts"))
    assert whole.keys() == parts.keys()
    assert all(torch.equal(value, parts[name]) for name, value in whole.items())
    curves = (tmp_path / "whole/curves.csv").read_text().splitlines()
    assert curves[0].startswith("passes,train_uv")


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"learning_rate": 0.0}, "--learning-rate: got 0.0"),
        ({"coarse_share": 7.0}, "--coarse-share: got 7.0"),
        ({"coarse_share": 0.5, "coarse_px": 100}, "--coarse-px: got 100; allowed: multiples of 32"),
        ({"input_px": 100}, "--input-px: got 100; allowed: multiples of 32"),
        ({"input_px": 192, "preset": "dewarpnet"}, "--input-px: got 192; allowed: multiples of 128"),
        ({"width": float("nan"), "preset": "dewarpnet"}, "--width: got nan; allowed: > 0"),
        ({"weight_decay": -1.0}, "--weight-decay: got -1.0; allowed: >= 0"),
        ({"preset": "slices", "coarse_share": 0.5, "coarse_px": 32}, "--preset slices: got --coarse-share 0.5"),
        ({"seed": 2**64}, "--seed: got 18446744073709551616; allowed: <= 18446744073709551615"),
        ({"minutes_per_save": float("nan")}, "--minutes-per-save: got nan; allowed: >= 0"),
    ],
)
def test_options_that_cannot_be_are_refused_before_any_data_is_read(options, told, tmp_path):
    with pytest.raises(ConfigError, match=re.escape(told)):
        train(TrainConfig(data=(tmp_path / "nothing",), out=tmp_path / "out", **options))


@pytest.mark.parametrize("name", PRESETS)
def test_presets_reach_processes_that_share_no_memory(name):
    assert pickle.loads(pickle.dumps(PRESETS[name])).config == PRESETS[name].config


@pytest.mark.usefixtures("tiny")
def test_a_training_can_start_from_weights(dataset, tmp_path):
    train(quick_run(dataset, tmp_path / "first", 4))
    start = tmp_path / "first" / "filmnet.safetensors"
    train(quick_run(dataset, tmp_path / "second", 4, start=(start,), learning_rate=1e-12, weight_decay=0.0))
    before, after = (load_weights(p, FilmNet, FilmNetConfig) for p in (start, tmp_path / "second/filmnet.safetensors"))
    torch.testing.assert_close(after.head.weight, before.head.weight)


def test_a_network_of_the_paper_trains_on_the_same_data(dataset, tmp_path, monkeypatch):
    narrow = PRESETS["firenet"].at_width(0.03).at_input(64)
    monkeypatch.setitem(PRESETS, "firenet", narrow)
    train(quick_run(dataset, tmp_path, 4, preset="firenet", batch=2))
    assert (tmp_path / "firenet.safetensors").exists()
    assert "test_uv_percent" in (tmp_path / "curves.csv").read_text()


@pytest.mark.usefixtures("tiny")
def test_too_little_data_is_refused(dataset, tmp_path):
    with pytest.raises(ConfigError, match="held out"):
        train(replace(quick_run(dataset, tmp_path, 4), held_out=100))


def test_large_photos_are_reduced_once_and_maps_go_back_to_them():
    photo = np.random.default_rng(0).integers(0, 256, (301, 402, 3), dtype=np.uint8)
    small, factor = Pyramid(photo).reduced(2.0)
    assert (small.shape, factor) == ((150, 201, 3), 2)
    network = ready(FilmNet(TINY))
    (maps,) = look(network, small, [square_view((100.0, 75.0), 150.0)])
    (full,) = look(network, photo, [square_view((200.0, 150.0), 300.0)])
    np.testing.assert_allclose(maps.enlarged(factor).photo_points, full.photo_points, atol=1e-3)


def test_what_an_image_shows_depends_on_its_number_alone():
    shown = [train_module._place_of(k, seed=3, count=10) for k in range(30)]
    assert all(sorted(shown[start : start + 10]) == list(range(10)) for start in (0, 10, 20))
    assert shown[:10] != shown[10:20]
