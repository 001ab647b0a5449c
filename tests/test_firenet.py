"""FiReNet: the published size, its parts and ablations, and that a narrow one learns."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from paper_case import assert_a_few_steps_lower_the_loss, flat_case
from torch.utils.flop_counter import FlopCounterMode

from hybrid.learn.networks.weights import parameter_count
from hybrid.learn.paper.firenet import MULTI_MAP, UV_ONLY, FiReNet, FiReNetConfig
from hybrid.learn.paper.losses import firenet_losses
from hybrid.learn.training.presets import preset

NARROW = 0.05  # 8 channels at the finest levels, 48 at the coarsest


def on_paper(config: FiReNetConfig) -> FiReNet:
    """A network with shapes but no values: full width costs nothing."""
    with torch.device("meta"):
        return FiReNet(config)


def test_the_published_number_of_parameters():
    assert parameter_count(on_paper(FiReNetConfig())) / 1e6 == pytest.approx(229.7, abs=0.05)


def test_the_published_amount_of_work():
    """106 GFLOP, of which the released code spends 2.1 on convolutions that nothing reads, one in each decoder."""
    with FlopCounterMode(display=False) as counter:
        on_paper(FiReNetConfig())(torch.empty(1, 3, 256, 256, device="meta"))
    unread = 7 * 2 * 16 * 16 * 9 * 256**2
    assert (counter.get_total_flops() + unread) / 1e9 == pytest.approx(106, abs=0.5)


def test_a_step_of_table_3_is_a_matter_of_whole_decoders():
    decoder = parameter_count(on_paper(FiReNetConfig()).background)
    full, multi, uv_only = (parameter_count(on_paper(c)) for c in (FiReNetConfig(), MULTI_MAP, UV_ONLY))
    assert full - multi == pytest.approx(decoder, rel=1e-5)  # except for the last layer's channels
    assert multi - uv_only == pytest.approx(2 * decoder, rel=1e-3)  # and the second encoder's first layer


@pytest.mark.parametrize("name", ["firenet", "firenet_multimap", "firenet_uv_only"])
def test_weights_of_a_fifth_of_the_width_fit_25_mb_in_half_precision(name):
    assert 2 * parameter_count(on_paper(preset(name).at_width(0.2).config)) <= 25e6


@pytest.mark.parametrize("config", [FiReNetConfig(), MULTI_MAP, UV_ONLY])
def test_maps_have_the_inputs_resolution_and_their_range(config):
    torch.manual_seed(0)
    with torch.no_grad():
        output = FiReNet(replace(config, width=NARROW)).eval()(torch.rand(2, 3, 64, 64))
    found = {name for name, value in vars(output).items() if value is not None}
    assert found == {"mask_logit", *config.maps, *config.heads}
    assert all(vars(output)[name].shape[-2:] == (64, 64) for name in found)
    for name in found & {"uv", "albedo"}:
        assert 0 <= float(vars(output)[name].min()) <= float(vars(output)[name].max()) <= 1


def test_nothing_passes_a_closed_background():
    """Where the first stage sees no film, the second has nothing to read: its maps are the same for every photo."""
    torch.manual_seed(0)
    network = FiReNet(FiReNetConfig(width=NARROW)).eval()
    torch.nn.init.constant_(network.background.head.bias, -1e4)
    with torch.no_grad():
        one, two = (network(torch.rand(1, 3, 64, 64)) for _ in range(2))
    assert torch.equal(one.uv, two.uv)
    assert one.deformation is not None
    assert two.deformation is not None
    assert torch.equal(one.deformation, two.deformation)
    assert not torch.equal(one.xyz, two.xyz)


def test_a_few_steps_lower_the_loss():
    torch.manual_seed(0)
    images, targets = flat_case(64, 64)
    network = FiReNet(FiReNetConfig(width=NARROW))
    assert_a_few_steps_lower_the_loss(network, firenet_losses, images, targets)
