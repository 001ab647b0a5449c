"""DewarpNet and the pair in table 2: published size, what the map means, inference as published and corrected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from paper_case import assert_a_few_steps_lower_the_loss, flat_case, photo_from_film
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from hybrid.backward import BackwardMap
from hybrid.coords import film_centres, film_nodes
from hybrid.errors import ConfigError
from hybrid.learn.networks.weights import parameter_count
from hybrid.learn.paper.baselines import corrected, dewarpnet_map, published_image, published_points
from hybrid.learn.paper.dewarpnet import (
    NODES,
    BackwardNet,
    DewarpNet,
    DewarpNetConfig,
    DewarpNetOutput,
    ShapeNet,
    ShapeOutput,
    coordinate_code,
    joined,
)
from hybrid.learn.paper.losses import (
    backward_net_losses,
    dewarpnet_losses,
    net_bw_losses,
    net_uv_losses,
    shape_net_losses,
)
from hybrid.learn.paper.uvbw import NetBw, NetUv, UvBwConfig
from hybrid.learn.training.presets import preset

NARROW = DewarpNetConfig(width=0.1, halvings=5, latent=16, input_px=64, layers="read")

FLOAT32 = 1e-5  # maps in units of the photo's sides, stored in float32


def on_paper(config: DewarpNetConfig) -> DewarpNet:
    """A network with shapes but no values: full width costs nothing."""
    with torch.device("meta"):
        return DewarpNet(config).eval().to("meta")


def work(network: nn.Module) -> int:
    with FlopCounterMode(display=False) as counter:
        network(torch.empty(1, 3, 256, 256, device="meta"))
    return counter.get_total_flops()


# ---------------------------------------------------------------- size


def test_the_published_size_and_work():
    published = on_paper(DewarpNetConfig())
    assert parameter_count(published) / 1e6 == pytest.approx(86.9, abs=0.05)
    assert work(published) / 1e9 == pytest.approx(13, abs=0.5)


def test_what_the_published_layers_read():
    """Dropping the layers that are never read does not change the work; reading them all takes half as much again."""
    read, dense = (on_paper(DewarpNetConfig(layers=layers)) for layers in ("read", "dense"))
    published = on_paper(DewarpNetConfig())
    assert parameter_count(dense) == parameter_count(published)
    assert work(read) == work(published) < 0.7 * work(dense)
    used = sum(p.numel() for p in published.parameters() if p.requires_grad)
    assert parameter_count(read) == used < 0.6 * parameter_count(published)


def test_layers_that_are_never_read_change_nothing():
    torch.manual_seed(0)
    whole = BackwardNet(DewarpNetConfig(width=0.25)).eval()
    lean = BackwardNet(DewarpNetConfig(width=0.25, layers="read")).eval()
    lean.load_state_dict({name: whole.state_dict()[name] for name in lean.state_dict()}, strict=True)
    code = torch.rand(1, 3, NODES, NODES)
    with torch.no_grad():
        assert torch.equal(whole(code).backward, lean(code).backward)


@pytest.mark.parametrize(
    ("name", "width"),
    [("dewarpnet", 0.25), ("dewarpnet_shape", 0.25), ("dewarpnet_bw", 0.25), ("net_bw", 0.125), ("net_uv", 0.125)],
)
def test_weights_as_trained_here_fit_25_mb_in_half_precision(name, width):
    with torch.device("meta"):
        network = preset(name).at_width(width).network()
    assert 2 * parameter_count(network) <= 25e6


# ---------------------------------------------------------------- maps


def test_the_coordinate_code_tells_film_from_background():
    _, targets = flat_case(32, 8)
    code = coordinate_code(targets.xyz, targets.mask)
    assert bool(((code == 0).all(dim=1) == ~targets.mask).all())
    assert float(code.min()) == 0.0
    assert float(code.max()) < 1.0
    back = ShapeOutput(code).xyz
    film = targets.mask[:, None].expand_as(back)
    torch.testing.assert_close(back[film], targets.xyz[film], atol=FLOAT32, rtol=0)


def test_shapes_and_ranges():
    torch.manual_seed(0)
    with torch.no_grad():
        output = DewarpNet(NARROW).eval()(torch.rand(2, 3, 64, 64))
        uv = NetUv(UvBwConfig(width=0.02)).eval()(output.shape.code).uv
        nodes = NetBw(UvBwConfig(width=0.02)).eval()(output.shape.code).backward
    assert output.shape.code.shape == (2, 3, 64, 64)
    assert output.backward.shape == (2, 2, NODES, NODES)
    assert uv.shape == nodes.shape == (2, 2, 64, 64)
    for maps in (output.shape.code, output.backward):
        assert 0 <= float(maps.min()) <= float(maps.max()) <= 1


def test_the_backward_net_mixes_no_pixels():
    """It subsamples a larger code; the pixels in between do not matter."""
    torch.manual_seed(0)
    network = BackwardNet(NARROW).eval()
    code = torch.rand(1, 3, 2 * NODES, 2 * NODES)
    other = torch.rand_like(code)
    other[..., ::2, ::2] = code[..., ::2, ::2]
    with torch.no_grad():
        assert torch.equal(network(code).backward, network(other).backward)


def test_two_stages_make_one_network():
    torch.manual_seed(0)
    stages = ShapeNet(NARROW).eval(), BackwardNet(NARROW).eval()
    image = torch.rand(1, 3, 64, 64)
    with torch.no_grad():
        apart = stages[1](stages[0](image).code).backward
        assert torch.equal(joined(*stages).eval()(image).backward, apart)
    with pytest.raises(ConfigError, match="same width"):
        joined(stages[0], BackwardNet(replace(NARROW, width=0.2)))


# ---------------------------------------------------------------- inference


class _Knowing(DewarpNet):
    """A DewarpNet that has learnt one backward map, in units of the photo's sides, and nothing else."""

    def __init__(self, backward) -> None:
        nn.Module.__init__(self)
        self.config = DewarpNetConfig()
        nodes = backward(film_nodes((NODES, NODES)))
        self.backward = torch.from_numpy(nodes).float().permute(2, 0, 1)[None]

    def forward(self, image):
        return DewarpNetOutput(ShapeOutput(torch.zeros_like(image)), self.backward)


SIZE = (300, 420)


def test_corrected_inference_is_the_map_itself():
    photo = np.zeros((*SIZE, 3), dtype=np.uint8)
    uv = film_centres((20, 30))
    found = corrected(_Knowing(photo_from_film), photo).photo_from_film(uv)
    side, beside = SIZE[1], (SIZE[1] - SIZE[0]) / 2  # the network sees the whole square around the photo
    np.testing.assert_allclose(found, photo_from_film(uv) * side - [0, beside], atol=0.01)


def test_published_inference_is_right_but_for_the_corners_convention_inside():
    """Away from the rim, mean and resize preserve a linear map; the lookup leaves an error of at most half a pixel."""
    found = published_points(BackwardMap(photo_from_film(film_nodes((NODES, NODES)))), SIZE)
    true = photo_from_film(film_centres(SIZE)) * [SIZE[1], SIZE[0]]
    error = (found - true)[6:-6, 6:-6]
    expected = 0.5 - photo_from_film(film_centres(SIZE))[6:-6, 6:-6]
    np.testing.assert_allclose(error, expected, atol=0.01)
    assert np.abs(error).max() < 0.5


def test_published_inference_pulls_the_rim_inwards():
    """At the film's edges the mean and the repeated rim leave out a strip that the corrected inference shows."""
    backward = BackwardMap(photo_from_film(film_nodes((NODES, NODES))))
    found = published_points(backward, SIZE)
    true = photo_from_film(film_centres(SIZE)) * [SIZE[1], SIZE[0]]
    cell = np.array([SIZE[1], SIZE[0]]) * 0.68 / NODES  # about one node's pitch in photo pixels
    missing = (found - true)[:, 0, 0].mean()
    assert 0.5 * cell[0] < missing < 2 * cell[0]
    assert (true - found)[:, -1, 0].mean() > 0.5 * cell[0]


def test_published_inference_looks_up_the_photo_in_double_precision():
    """A photo of ramps shows where it was read: the film image holds the points themselves."""
    ramp = np.zeros((*SIZE, 3), dtype=np.uint8)
    ramp[..., 0] = (np.arange(SIZE[1]) // 2).astype(np.uint8)
    film = published_image(dewarpnet_map(_Knowing(photo_from_film), ramp), ramp)
    assert film.dtype == np.float64
    assert film.shape == ramp.shape
    points = published_points(BackwardMap(photo_from_film(film_nodes((NODES, NODES)))), SIZE)
    assert np.abs(film[..., 0] * 255 - points[..., 0] / 2).max() < 1.0  # the ramp's own steps


# ---------------------------------------------------------------- learning


@pytest.mark.parametrize(
    ("network", "losses", "reads", "nodes"),
    [
        (lambda: ShapeNet(NARROW), shape_net_losses, "photo", 8),
        (lambda: BackwardNet(NARROW), backward_net_losses, "code", NODES),
        (lambda: DewarpNet(NARROW), dewarpnet_losses, "photo", NODES),
        (lambda: NetBw(UvBwConfig(width=0.02)), net_bw_losses, "code", 64),
        (lambda: NetUv(UvBwConfig(width=0.02)), net_uv_losses, "code", 64),
    ],
    ids=["shape", "backward", "both", "net_bw", "net_uv"],
)
def test_a_few_steps_lower_the_loss(network, losses, reads, nodes):
    torch.manual_seed(0)
    images, targets = flat_case(64, nodes)
    inputs = images if reads == "photo" else coordinate_code(targets.xyz, targets.mask)
    assert_a_few_steps_lower_the_loss(network(), losses, inputs, targets)
