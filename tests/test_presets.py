"""The registry of networks: the targets that each preset asks for suffice to train it, and weights name terms."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from paper_case import flat_case

from hybrid.coords import film_nodes
from hybrid.errors import ConfigError
from hybrid.learn.networks.filmnet import FilmNetConfig
from hybrid.learn.networks.losses import Targets
from hybrid.learn.paper.blocks import in_single_precision
from hybrid.learn.training.presets import PRESETS, preset, weighted_sum

PAPERS = [name for name in PRESETS if name not in ("filmnet", "upright", "slices", "edges", "borders", "light")]


def small(name: str):
    """The preset at a width and input size for quick tests."""
    narrow = PRESETS[name].at_width(0.03)
    changes = {"halvings": 5, "latent": 16} if name.startswith("dewarpnet") else {}
    return replace(narrow, config=replace(narrow.config, input_px=64, **changes))


@pytest.mark.parametrize("name", PAPERS)
def test_a_preset_trains_on_the_targets_that_its_feed_makes(name):
    """Backward maps are made only for presets that ask for them; the others must not read them."""
    torch.manual_seed(0)
    chosen = small(name)
    images, targets = flat_case(64, chosen.nodes(64) or 8)
    if not chosen.nodes(64):
        targets = replace(targets, backward=torch.full_like(targets.backward, torch.nan))
    terms = chosen.losses(chosen.network()(chosen.inputs(images, targets)), targets)
    assert set(chosen.weights) <= set(terms)
    loss = weighted_sum(terms, chosen.weights)
    loss.backward()
    assert bool(torch.isfinite(loss.detach()))


@pytest.mark.parametrize("name", PAPERS)
def test_maps_are_as_fine_in_bfloat16_runs(name):
    torch.manual_seed(0)
    chosen = small(name)
    images, targets = flat_case(64, chosen.nodes(64) or 8)
    with torch.autocast("cpu", torch.bfloat16):
        output = chosen.network()(chosen.inputs(images, targets))
    maps = [value for value in vars(output).values() if isinstance(value, torch.Tensor)]
    assert maps
    assert all(one.dtype == torch.float32 for one in maps)


def test_a_last_layer_in_single_precision_heeds_no_autocast():
    torch.manual_seed(0)
    layer, x = torch.nn.Conv2d(8, 2, 1), torch.rand(1, 8, 32, 32).bfloat16()
    with torch.autocast("cpu", torch.bfloat16):
        found, coarse = in_single_precision(layer, x), layer(x)
    assert torch.equal(found, layer(x.float()))
    assert len(found.unique()) > 2 * len(coarse.unique())


def test_weights_stand_for_terms_that_there_are():
    chosen = PRESETS["filmnet"]
    network = chosen.build(FilmNetConfig(widths=(4, 8, 8, 8), blocks=(1, 1, 1), input_px=64))
    maps = {"uv": 2, "xyz": 3, "normal": 3}
    targets = Targets(
        mask=torch.ones(2, 16, 16, dtype=torch.bool),
        albedo=torch.zeros(2, 16, 16),
        covered=torch.zeros(2, 16, 16, dtype=torch.bool),
        orientation=torch.zeros(2, dtype=torch.int64),
        weight=torch.ones(2),
        has_shape=torch.ones(2),
        has_print=torch.ones(2),
        has_grid=torch.ones(2),
        grid=torch.ones(2, 2, 3),
        **{name: torch.zeros(2, count, 16, 16) for name, count in maps.items()},
    )
    assert set(chosen.losses(network(torch.rand(2, 3, 64, 64)), targets)) == set(chosen.weights)


def test_weights_multiply_and_default_to_one():
    terms = {"a": torch.tensor(2.0), "b": torch.tensor(3.0)}
    assert float(weighted_sum(terms, {"a": 10.0})) == 10 * 2 + 3


def test_an_unknown_preset_or_a_width_where_there_is_none_is_refused():
    with pytest.raises(ConfigError, match="firenet_uv_only"):
        preset("unet")
    with pytest.raises(ConfigError, match="width"):
        preset("filmnet").at_width(0.5)


def test_depth_and_deformation_follow_from_the_other_truth():
    _, targets = flat_case(16, 9)
    assert torch.equal(targets.depth, targets.xyz[:, 2])
    nodes = torch.from_numpy(film_nodes((9, 9))).float().permute(2, 0, 1)
    torch.testing.assert_close(targets.deformation + nodes, targets.backward)
