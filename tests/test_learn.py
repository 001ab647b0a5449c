"""The network, its losses, its views and its weights files."""

from pathlib import Path

import numpy as np
import pytest
import torch

from data_gen.generate import GenerateConfig, generate
from data_gen.sample import SampleConfig
from hybrid.coords import pixel_centres, rescale_points
from hybrid.errors import ConfigError, DataError
from hybrid.learn.data import AugmentConfig, training_view
from hybrid.learn.losses import LossWeights, Targets, loss_terms, masked_mean, slope_loss, total_loss, uv_loss
from hybrid.learn.network import STRIDE, FilmNet, FilmNetConfig, FilmNetOutput, fused
from hybrid.learn.predict import PredictConfig, Window, film_windows, look, whole
from hybrid.learn.shards import open_dataset
from hybrid.learn.train import TrainConfig, train
from hybrid.learn.weights import load_weights, parameter_count, save_weights

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

    output = FilmNetOutput(draw(b, n, n) - 0.5, draw(b, 2, n, n), draw(b, 3, n, n), draw(b, n, n), draw(b, n, n) - 3)
    return output, Targets(draw(b, n, n) > 0.3, draw(b, 2, n, n), draw(b, 3, n, n), draw(b, n, n))


# ---------------------------------------------------------------- network


@pytest.mark.parametrize("px", [64, 128])
def test_maps_are_a_quarter_of_the_input(px):
    output = FilmNet(TINY)(torch.rand(2, 3, px, px))
    assert output.uv.shape == (2, 2, px // STRIDE, px // STRIDE)
    assert output.xyz.shape == (2, 3, px // STRIDE, px // STRIDE)


def test_folding_the_normalisation_changes_nothing():
    torch.manual_seed(0)
    network = FilmNet(TINY).train()
    for _ in range(3):
        network(torch.rand(4, 3, 64, 64))
    image = torch.rand(1, 3, 64, 64)
    with torch.no_grad():
        before = network.eval()(image)
        after = fused(network)(image)
    torch.testing.assert_close(after.uv, before.uv, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(after.mask_logit, before.mask_logit, atol=1e-5, rtol=1e-4)


def test_the_shipped_network_is_within_its_budget():
    assert parameter_count(FilmNet(FilmNetConfig())) <= 8_000_000


# ---------------------------------------------------------------- losses


def test_losses_by_hand():
    mask = torch.tensor([[[True, True], [False, False]], [[True, False], [False, False]]])
    error = torch.tensor([[[0.1, 0.3], [9.0, 9.0]], [[0.4, 9.0], [9.0, 9.0]]])
    assert float(masked_mean(error, mask)) == pytest.approx((0.2 + 0.4) / 2)
    zero = torch.zeros(2, 2, 2, 2)
    targets = Targets(mask, zero, torch.zeros(2, 3, 2, 2), torch.zeros(2, 2, 2))
    uv = torch.stack([error, error], dim=1)
    output = FilmNetOutput(
        torch.zeros(2, 2, 2), uv, torch.zeros(2, 3, 2, 2), torch.zeros(2, 2, 2), torch.zeros(2, 2, 2)
    )
    assert float(uv_loss(output, targets)) == pytest.approx(2 * 0.3)
    # One neighbouring pair of film pixels, in the first film only: |0.3 - 0.1| for u and for v.
    assert float(slope_loss(output, targets)) == pytest.approx(0.4 / 2, abs=1e-6)
    assert float(loss_terms(output, targets)["mask"]) == pytest.approx(np.log(2))


def test_a_perfect_prediction_costs_nothing():
    _, targets = random_case()
    logit = torch.where(targets.mask, 40.0, -40.0)
    perfect = FilmNetOutput(logit, targets.uv, targets.xyz, targets.albedo, torch.full_like(logit, -3.0))
    terms = loss_terms(perfect, targets)
    assert all(float(terms[name]) < 1e-6 for name in ("uv", "mask", "xyz", "albedo", "slope"))


def test_losses_do_not_see_the_background():
    output, targets = random_case()
    noisy = FilmNetOutput(
        output.mask_logit,
        torch.where(targets.mask[:, None], output.uv, 77.0),
        torch.where(targets.mask[:, None], output.xyz, 77.0),
        torch.where(targets.mask, output.albedo, 77.0),
        output.log_scale,
    )
    before, after = loss_terms(output, targets), loss_terms(noisy, targets)
    for name, value in before.items():
        assert float(after[name]) == pytest.approx(float(value), rel=1e-5)
    assert float(total_loss(before, LossWeights())) > 0


# ---------------------------------------------------------------- views


def test_an_undisturbed_view_is_the_sample(dataset):
    shard = open_dataset(dataset)[0]
    view = training_view(shard, 2, 96, np.random.default_rng(0), None)
    assert view.image.shape == (96, 96, 3)
    assert (view.mask == (view.uv != 0).any(axis=-1))[view.mask].all()
    nodes = shard.stored("backward", 2)
    from hybrid.backward import BackwardMap

    at = BackwardMap(nodes).photo_from_film(view.uv[view.mask].astype(np.float64))
    n = 96 // STRIDE
    centres = rescale_points(pixel_centres((n, n)), (n, n), (96, 96))[view.mask]
    assert np.median(np.linalg.norm(at - centres, axis=1)) < 0.1


def test_a_turned_view_turns_the_truth_with_it(dataset):
    """What a view says of 3D is the photo's camera turned about its axis: distances to the centre stay."""
    shard = open_dataset(dataset)[0]
    plain = training_view(shard, 1, 64, np.random.default_rng(0), None)
    config = AugmentConfig(crop_share=0.0, zoom=(1.0, 1.0), roll_deg=30.0, shift=0.0)
    turned = training_view(shard, 1, 64, np.random.default_rng(3), config)
    assert np.ptp(np.linalg.norm(plain.xyz[plain.mask], axis=-1)) > 0
    for view in (plain, turned):
        far = np.linalg.norm(view.xyz[view.mask], axis=-1).max()
        assert 0.2 < far < 0.8  # half a film's diagonal, about
    # u runs to the right of the view's own axes: dx/du is positive in both
    for view in (plain, turned):
        x, u = view.xyz[..., 0][view.mask], view.uv[..., 0][view.mask]
        assert np.corrcoef(x, u)[0, 1] > 0.5


# ---------------------------------------------------------------- looking


def test_looking_at_the_whole_shows_the_photo_itself():
    from hybrid.learn.predict import _cut

    photo = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    np.testing.assert_array_equal(_cut(photo, whole((64, 64)), 64), photo)


def test_a_window_is_where_it_says():
    """A ramp of columns read through a window gives the columns of the window's photo points."""
    from hybrid.learn.predict import _cut

    x = pixel_centres((300, 400))[..., 0]
    photo = np.repeat((x / 400 * 255)[..., None], 3, axis=-1).astype(np.uint8)
    window = Window((210.3, 140.7), 130.0)
    seen = _cut(photo, window, 64)[32, :, 0] / 255 * 400
    expected = 210.3 - 65 + (np.arange(64) + 0.5) * 130 / 64
    np.testing.assert_allclose(seen, expected, atol=3.0)


def test_the_photo_points_of_the_maps_cover_the_window():
    photo = np.zeros((100, 150, 3), np.uint8)
    (maps,) = look(fused(FilmNet(TINY)), photo, [Window((75.0, 50.0), 80.0)])
    np.testing.assert_allclose(maps.photo_points[0, 0], [35 + 2.5, 10 + 2.5])
    np.testing.assert_allclose(maps.photo_points.mean(axis=(0, 1)), [75, 50])
    assert film_windows(maps, PredictConfig(mask_threshold=1.1)) == []
    seen = film_windows(maps, PredictConfig(mask_threshold=-1.0, margins=(0.0, 0.25)))
    assert seen == [Window((75.0, 50.0), 80.0), Window((75.0, 50.0), 120.0)]


def test_looks_together_are_looks_one_by_one():
    network, photo = fused(FilmNet(TINY)), np.random.default_rng(0).integers(0, 256, (90, 90, 3), dtype=np.uint8)
    windows = [Window((40.0, 50.0), 60.0), Window((45.0, 45.0), 90.0)]
    for one, other in zip(look(network, photo, windows), (look(network, photo, [w])[0] for w in windows), strict=True):
        np.testing.assert_allclose(one.uv, other.uv, atol=1e-5)


# ---------------------------------------------------------------- weights and training


def test_weights_come_back_and_are_strict(tmp_path):
    network = FilmNet(TINY).eval()
    path = tmp_path / "w.safetensors"
    save_weights(path, network, {"passes": 0})
    image = torch.rand(1, 3, 64, 64)
    with torch.no_grad():
        torch.testing.assert_close(load_weights(path).eval()(image).uv, network(image).uv, atol=5e-3, rtol=5e-3)
    with pytest.raises(DataError, match="safetensors"):
        load_weights(Path(__file__))
    with pytest.raises(DataError, match="weights"):
        load_weights(tmp_path / "missing.safetensors")


def test_training_resumes_exactly_and_learns(dataset, tmp_path):
    def config(out, passes):
        return TrainConfig(
            data=(dataset,), out=out, passes=passes, coarse_share=0.0, held_out=2, batch=4, loaders=0,
            steps_per_test=4, minutes_per_save=0.0, network=TINY,
        )  # fmt: skip

    class CutError(Exception):
        pass

    from hybrid.learn import train as module

    train(config(tmp_path / "whole", 32))
    original = module._State.update
    calls = []

    def interrupted(self, images, targets):
        if len(calls) == 4:
            raise CutError
        calls.append(1)
        return original(self, images, targets)

    module._State.update = interrupted
    try:
        with pytest.raises(CutError):
            train(config(tmp_path / "parts", 32))
    finally:
        module._State.update = original
    train(config(tmp_path / "parts", 32))
    whole_run, parts = (
        load_weights(tmp_path / name / "filmnet.safetensors").state_dict() for name in ("whole", "parts")
    )
    for name, value in whole_run.items():
        torch.testing.assert_close(parts[name], value, atol=0, rtol=0)
    curves = (tmp_path / "whole/curves.csv").read_text().splitlines()
    assert curves[0].startswith("passes,train_uv")
    assert float(curves[-1].split(",")[1]) < float(curves[1].split(",")[1])


def test_too_little_data_is_refused(dataset, tmp_path):
    with pytest.raises(ConfigError, match="held out"):
        train(TrainConfig(data=(dataset,), out=tmp_path, held_out=100))
