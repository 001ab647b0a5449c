"""The paper's equations (1) to (5) on values worked by hand, and the laws that they follow."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from paper_case import flat_case

from hybrid.learn.paper.dewarpnet import BackwardOutput, DewarpNetOutput, ShapeOutput, coordinate_code
from hybrid.learn.paper.firenet import FiReNetOutput
from hybrid.learn.paper.losses import (
    ALPHA,
    BETA,
    backward_net_losses,
    deformation_loss,
    deshifted_difference_loss,
    dewarpnet_losses,
    disturbance_loss,
    everywhere,
    firenet_losses,
    l1_loss,
    net_bw_losses,
    net_uv_losses,
    shape_net_losses,
    shape_terms,
    shift_loss,
    transformation_terms,
)
from hybrid.learn.paper.uvbw import UvOutput

ERROR = torch.tensor([0.0, 0.0, 0.0, 4.0]).reshape(1, 1, 2, 2)
"""mu = 1, sigma = sqrt((1 + 1 + 1 + 9) / 4) = sqrt(3); e - mu = -1, -1, -1, 3."""

EXACT = 1e-6  # float32 sums of a few numbers near 1
LAW = 1e-5  # float32 sums of a few hundred


def perfect(targets) -> FiReNetOutput:
    return FiReNetOutput(
        mask_logit=torch.where(targets.mask, 40.0, -40.0),
        xyz=targets.xyz,
        uv=targets.uv,
        albedo=targets.albedo,
        normal=targets.normal,
        depth=targets.depth,
        deformation=targets.deformation,
    )


def disturbed(targets, seed=0) -> FiReNetOutput:
    g = torch.Generator().manual_seed(seed)
    exact = perfect(targets)
    return FiReNetOutput(**{k: v + 0.1 * torch.randn(v.shape, generator=g) for k, v in vars(exact).items()})


# ---------------------------------------------------------------- by hand


def test_equation_1_by_hand():
    error = torch.tensor([[[[1.0, -2.0], [9.0, 0.0]], [[3.0, 0.0], [9.0, 1.0]]]])
    mask = torch.tensor([[[True, True], [False, True]]])
    assert float(l1_loss(error, mask)) == pytest.approx(((1 + 3) + 2 + 1) / 3, abs=EXACT)


def test_equation_3_by_hand():
    mask = everywhere(ERROR)
    assert float(shift_loss(ERROR, mask)) == pytest.approx(1.0, abs=EXACT)
    assert float(disturbance_loss(ERROR, mask)) == pytest.approx(3**0.5, abs=EXACT)
    # e (e - mu) is positive only in the last place, where the smaller of |4| and |3| is taken.
    assert float(deshifted_difference_loss(ERROR, mask)) == pytest.approx(3 / 4, abs=EXACT)


def test_equation_4_by_hand():
    assert (ALPHA, BETA) == (2.0, 2.0)  # the paper's
    mask = everywhere(ERROR)
    assert float(deformation_loss(ERROR, mask)) == pytest.approx(1 + 2 * 3**0.5 + 2 * 0.75, abs=EXACT)
    assert float(deformation_loss(ERROR, mask, 0.5, 3.0)) == pytest.approx(1 + 0.5 * 3**0.5 + 3 * 0.75, abs=EXACT)


def test_channels_add_up_and_films_are_averaged():
    one = torch.cat([ERROR, -ERROR], dim=1)
    both = torch.cat([one, torch.zeros_like(one)])
    for loss in (l1_loss, shift_loss, disturbance_loss, deshifted_difference_loss, deformation_loss):
        single = float(loss(ERROR, everywhere(ERROR)))
        assert float(loss(one, everywhere(one))) == pytest.approx(2 * single, abs=EXACT)
        assert float(loss(both, everywhere(both))) == pytest.approx(single, abs=2 * EXACT)


def test_equation_2_is_the_sum_of_four_maps():
    _, targets = flat_case(16, 16)
    exact = perfect(targets)
    output = replace(
        exact,
        mask_logit=torch.zeros_like(exact.mask_logit),
        xyz=targets.xyz + 0.1,
        normal=targets.normal - 0.2,
        depth=targets.depth + 0.3,
    )
    terms = shape_terms(output, targets)
    expected = {"xyz": 3 * 0.1, "normal": 3 * 0.2, "depth": 0.3, "background": 0.5}
    assert {name: float(term) for name, term in terms.items()} == pytest.approx(expected, abs=LAW)


def test_equation_5_is_the_sum_of_three_maps():
    _, targets = flat_case(16, 16)
    exact = perfect(targets)
    output = replace(exact, uv=targets.uv + 0.1, albedo=targets.albedo - 0.2, deformation=targets.deformation + 0.3)
    terms = transformation_terms(output, targets)
    # A constant error is all shift: nothing is disturbed, and the de-shifted difference is 0.
    expected = {"uv": 2 * 0.1, "albedo": 0.2, "deformation": 2 * 0.3}
    assert {name: float(term) for name, term in terms.items()} == pytest.approx(expected, abs=LAW)


def test_an_ablation_pays_only_for_its_own_maps():
    _, targets = flat_case(16, 16)
    full = disturbed(targets)
    less = replace(full, normal=None, depth=None, deformation=None)
    terms, fewer = firenet_losses(full, targets), firenet_losses(less, targets)
    assert set(terms) - set(fewer) == {"normal", "depth", "deformation"}
    assert all(torch.equal(terms[name], fewer[name]) for name in fewer)


# ---------------------------------------------------------------- laws

TERMS = (l1_loss, shift_loss, disturbance_loss, deshifted_difference_loss, deformation_loss)


def random_error(seed=1) -> tuple[torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    return torch.randn(3, 2, 8, 8, generator=g) + 0.3, torch.rand(3, 8, 8, generator=g) > 0.4


@pytest.mark.parametrize("loss", TERMS)
def test_a_term_is_a_length(loss):
    """Doubling the error doubles the term, negating the error leaves it, and no error costs nothing."""
    error, mask = random_error()
    value = float(loss(error, mask))
    assert value > 0
    assert float(loss(2 * error, mask)) == pytest.approx(2 * value, rel=LAW)
    assert float(loss(-error, mask)) == pytest.approx(value, rel=LAW)
    assert float(loss(0 * error, mask)) == pytest.approx(0.0, abs=LAW)


@pytest.mark.parametrize("loss", TERMS)
def test_a_term_does_not_see_the_background(loss):
    error, mask = random_error()
    elsewhere = torch.where(mask[:, None], error, 77.0)
    assert float(loss(elsewhere, mask)) == pytest.approx(float(loss(error, mask)), rel=LAW)


@pytest.mark.parametrize("loss", TERMS)
@pytest.mark.parametrize("case", ["random", "none", "constant", "no film"])
def test_gradients_are_finite(loss, case):
    error, mask = random_error()
    error = {"none": torch.zeros_like(error), "constant": torch.ones_like(error)}.get(case, error)
    error = error.clone().requires_grad_()
    loss(error, mask & (case != "no film")).backward()
    assert error.grad is not None
    assert bool(torch.isfinite(error.grad).all())


def test_a_shift_moves_the_shifting_loss_alone():
    error, mask = random_error()
    centred = error - (error * mask[:, None]).sum((2, 3), keepdim=True) / mask.sum((1, 2)).reshape(-1, 1, 1, 1)
    assert float(shift_loss(centred + 0.25, mask)) == pytest.approx(2 * 0.25, abs=LAW)
    before, after = disturbance_loss(error, mask), disturbance_loss(error + 5.0, mask)
    assert float(after) == pytest.approx(float(before), rel=1e-4)  # the squares of 5 cost a few digits


def test_the_deshifted_difference_is_never_above_either_error():
    error, mask = random_error()
    relative = error - (error * mask[:, None]).sum((2, 3), keepdim=True) / mask.sum((1, 2)).reshape(-1, 1, 1, 1)
    value = float(deshifted_difference_loss(error, mask))
    assert value <= min(float(l1_loss(error, mask)), float(l1_loss(relative, mask)))


def test_a_perfect_prediction_costs_nothing():
    _, targets = flat_case(32, 32)
    terms = firenet_losses(perfect(targets), targets)
    assert set(terms) == {"xyz", "normal", "depth", "background", "uv", "albedo", "deformation"}
    assert all(float(term) < LAW for term in terms.values())
    code = coordinate_code(targets.xyz, targets.mask)
    assert float(shape_net_losses(ShapeOutput(code), targets)["code"]) == 0.0
    assert all(float(t) == 0.0 for t in backward_net_losses(BackwardOutput(targets.backward), targets).values())
    assert float(net_bw_losses(BackwardOutput(targets.backward), targets)["backward"]) == 0.0
    assert float(net_uv_losses(UvOutput(targets.uv), targets)["uv"]) == 0.0


def test_unwarping_sees_a_shift_of_the_map():
    """A map moved by a whole cell of the print unwarps another print, and both terms of the loss show it."""
    _, targets = flat_case(32, 24)
    moved = backward_net_losses(BackwardOutput(targets.backward + 0.15), targets)
    assert float(moved["backward"]) == pytest.approx(2 * 0.15, abs=LAW)
    assert float(moved["reconstruction"]) > 1e-3


def test_the_reconstruction_is_the_mean_squared_difference_of_the_unwarped_prints():
    _, targets = flat_case(32, 24)
    moved = targets.backward + 0.1

    def unwarped(backward: torch.Tensor) -> np.ndarray:
        at = backward.permute(0, 2, 3, 1).numpy() * 32 - 0.5
        x, y = (np.ascontiguousarray(at[..., k], np.float32) for k in range(2))
        prints = targets.albedo.numpy().astype(np.float32)
        return np.stack([cv2.remap(*film, cv2.INTER_LINEAR) for film in zip(prints, x, y, strict=True)])

    loss = float(backward_net_losses(BackwardOutput(moved), targets)["reconstruction"])
    expected = float(np.square(unwarped(moved) - unwarped(targets.backward)).mean())
    assert expected > 1e-3
    assert loss == pytest.approx(expected, rel=1e-3)


def test_both_stages_of_dewarpnet_count():
    _, targets = flat_case(32, 32)
    code = coordinate_code(targets.xyz, targets.mask)
    perfect_output = DewarpNetOutput(ShapeOutput(code), targets.backward)
    assert all(float(term) == 0.0 for term in dewarpnet_losses(perfect_output, targets).values())
    wrong = dewarpnet_losses(DewarpNetOutput(ShapeOutput(code + 1), targets.backward), targets)
    assert float(wrong["code"]) > 0.5
    assert float(wrong["backward"]) == 0.0
