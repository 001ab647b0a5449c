"""The registry of networks: what each needs is enough to train it; a shard's truth as a view sees it."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from paper_case import flat_case, photo_from_film

from hybrid.coords import film_nodes
from hybrid.errors import ConfigError
from hybrid.learn.losses import Targets
from hybrid.learn.network import FilmNetConfig
from hybrid.learn.paper_targets import PaperTargets, backward_in_view, normal_in_view
from hybrid.learn.presets import PRESETS, preset, weighted_sum

PAPERS = [name for name in PRESETS if name != "filmnet"]


def small(name: str):
    """The preset at a width and input of a quick test."""
    narrow = PRESETS[name].at_width(0.03)
    changes = {"halvings": 5, "latent": 16} if name.startswith("dewarpnet") else {}
    return replace(narrow, config=replace(narrow.config, input_px=64, **changes))


@pytest.mark.parametrize("name", PAPERS)
def test_a_preset_trains_on_the_fields_that_it_names(name):
    """Everything else is NaN: had the losses read it, they would be too."""
    torch.manual_seed(0)
    chosen = small(name)
    images, whole = flat_case(64, chosen.nodes(64) or 8)
    named = {f.name for f in fields(PaperTargets)} & set(chosen.fields)
    assert named == set(chosen.fields)
    blank = {
        f.name: torch.full_like(getattr(whole, f.name), torch.nan) for f in fields(PaperTargets) if f.name not in named
    }
    targets = replace(whole, **blank)
    terms = chosen.losses(chosen.network()(chosen.inputs(images, targets)), targets)
    assert set(chosen.weights) <= set(terms)
    loss = weighted_sum(terms, chosen.weights)
    loss.backward()
    assert bool(torch.isfinite(loss.detach()))


def test_filmnet_is_one_of_them():
    chosen = replace(PRESETS["filmnet"], config=FilmNetConfig(widths=(4, 8, 8, 8), blocks=(1, 1, 1), input_px=64))
    images, whole = flat_case(64, 8)
    s = chosen.stride
    quarter = {name: getattr(whole, name)[..., ::s, ::s] for name in chosen.fields}
    terms = chosen.losses(chosen.network()(images), Targets(**quarter))
    assert set(terms) == set(chosen.weights)


def test_weights_multiply_and_default_to_one():
    terms = {"a": torch.tensor(2.0), "b": torch.tensor(3.0)}
    assert float(weighted_sum(terms, {"a": 10.0})) == 10 * 2 + 3


def test_an_unknown_preset_or_a_width_where_there_is_none_is_refused():
    with pytest.raises(ConfigError, match="firenet_uv_only"):
        preset("unet")
    with pytest.raises(ConfigError, match="width"):
        preset("filmnet").at_width(0.5)


# ---------------------------------------------------------------- truth in a view


def test_a_view_of_the_whole_photo_changes_units_only():
    nodes = photo_from_film(film_nodes((9, 9))) * 500
    whole = np.array([[500 / 64, 0.0, 0.0], [0.0, 500 / 64, 0.0]])
    seen = backward_in_view(nodes, whole, 64, 17)
    np.testing.assert_allclose(seen, photo_from_film(film_nodes((17, 17))), atol=1e-6)


def test_a_turned_view_is_undone_by_its_own_map():
    rng = np.random.default_rng(1)
    nodes = photo_from_film(film_nodes((9, 9))) * 500
    turn = 0.4
    linear = 6.0 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    view = np.column_stack([linear, rng.uniform(0, 90, 2)])
    seen = backward_in_view(nodes, view, 64, 9).astype(np.float64) * 64
    np.testing.assert_allclose(seen @ linear.T + view[:, 2], nodes, atol=1e-3)  # float32 of numbers near 500


def test_normals_turn_with_the_camera_and_stay_of_unit_length():
    rng = np.random.default_rng(2)
    normal = rng.normal(size=(4, 5, 3))
    seen = rng.random((4, 5)) > 0.3
    turned = normal_in_view(0.7 * normal, seen, 0.3)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=-1), seen.astype(float), atol=1e-6)
    back = normal_in_view(turned, seen, -0.3)
    unit = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    np.testing.assert_allclose(back, np.where(seen[..., None], unit, 0), atol=1e-6)


def test_depth_and_deformation_follow_from_the_other_truth():
    _, targets = flat_case(16, 9)
    assert torch.equal(targets.depth, targets.xyz[:, 2])
    nodes = torch.from_numpy(film_nodes((9, 9))).float().permute(2, 0, 1)
    torch.testing.assert_close(targets.deformation + nodes, targets.backward)
