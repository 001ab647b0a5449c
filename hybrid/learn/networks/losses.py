"""Losses of FilmNet, each a function of prediction, truth and mask."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor
from torch.nn import functional

from hybrid.learn.networks.filmnet import FilmNetOutput
from hybrid.learn.networks.tensors import Tensors


@dataclass(frozen=True, eq=False)
class Targets(Tensors):
    """Truth at the network's output resolution; 0 where the mask is False.

    uv: of the film as seen. covered: something lies in front of the film; never where the mask is True. grid: of its
    cells, across and down: start of the first, pitch and number. orientation: index of the move that makes it read
    right. weight: of each view in the losses of uv and cells. has_shape, has_print, has_grid: 1 where xyz, normal and
    covered, where albedo, and where the cells are known; 0 where they are not and add nothing to the loss.
    """

    mask: Bool[Tensor, "b h w"]
    uv: Float[Tensor, "b 2 h w"]
    xyz: Float[Tensor, "b 3 h w"]
    albedo: Float[Tensor, "b h w"]
    normal: Float[Tensor, "b 3 h w"]
    covered: Bool[Tensor, "b h w"]
    grid: Float[Tensor, "b 2 3"]
    orientation: Int64[Tensor, " b"]
    weight: Float[Tensor, " b"]
    has_shape: Float[Tensor, " b"]
    has_print: Float[Tensor, " b"]
    has_grid: Float[Tensor, " b"]


COVERED_COUNTS = 4.0
"""How many times as much as others places count where something lies in front of the film."""


@dataclass(frozen=True)
class LossWeights:
    """Weights of the terms. slope is small: a heavy loss on the gradient of uv keeps the network from learning."""

    uv: float = 20.0
    mask: float = 0.5
    xyz: float = 4.0
    albedo: float = 0.5
    slope: float = 4.0
    scale: float = 0.05
    normal: float = 0.5
    covered: float = 4.0
    phases: float = 0.25
    grid: float = 0.1
    orientation: float = 0.05


def masked_mean(
    values: Float[Tensor, "b h w"], mask: Bool[Tensor, "b h w"], weight: Float[Tensor, " b"] | None = None
) -> Float[Tensor, ""]:
    """Mean over the pixels of each film, then (weighted) over the films, so that small films count as large ones do."""
    inside = mask.to(values.dtype)
    means = (values * inside).sum(dim=(1, 2)) / inside.sum(dim=(1, 2)).clamp(min=1.0)
    return (means if weight is None else means * weight).mean()


def uv_loss(output: FilmNetOutput, targets: Targets) -> Float[Tensor, ""]:
    """Mean distance of predicted from true film coordinates, |du| + |dv|."""
    return masked_mean((output.uv - targets.uv).abs().sum(dim=1), targets.mask, targets.weight)


def slope_loss(output: FilmNetOutput, targets: Targets) -> Float[Tensor, ""]:
    """Mean absolute error of the differences of uv between neighbouring film pixels, along both axes."""
    error, mask, weight = output.uv - targets.uv, targets.mask, targets.weight
    across = masked_mean((error[..., 1:] - error[..., :-1]).abs().sum(dim=1), mask[..., 1:] & mask[..., :-1], weight)
    down = masked_mean((error[:, :, 1:] - error[:, :, :-1]).abs().sum(dim=1), mask[:, 1:] & mask[:, :-1], weight)
    return across + down


def scale_loss(output: FilmNetOutput, targets: Targets) -> Float[Tensor, ""]:
    """Laplace negative log-likelihood of the uv error under the predicted scale; no gradient reaches uv through it."""
    error = (output.uv - targets.uv).detach().abs().mean(dim=1)
    log_scale = output.log_scale.clamp(-9.0, 1.0)
    return masked_mean(error * torch.exp(-log_scale) + log_scale, targets.mask)


def normal_loss(output: FilmNetOutput, targets: Targets) -> Float[Tensor, ""]:
    """Mean absolute error of the normal, where one is predicted."""
    if output.normal is None:
        return output.uv.new_zeros(())
    return masked_mean((output.normal - targets.normal).abs().sum(dim=1), targets.mask, targets.has_shape)


def covered_loss(output: FilmNetOutput, targets: Targets) -> Float[Tensor, ""]:
    """Cross-entropy, over the sheet, of whether something lies in front of it; the rare places where it does count
    more."""
    share = torch.tensor(COVERED_COUNTS, dtype=output.uv.dtype, device=output.uv.device)
    truth = targets.covered.to(output.uv.dtype)
    error = functional.binary_cross_entropy_with_logits(output.covered_logit, truth, reduction="none", pos_weight=share)
    return masked_mean(error, targets.mask | targets.covered, targets.has_shape)


def cell_phases(uv: Float[Tensor, "b 2 h w"], grid: Float[Tensor, "b 2 3"]) -> Float[Tensor, "b 2 2 h w"]:
    """Cosine and sine of each place's position in its cell, across and down; a full turn from cell to cell."""
    first, pitch = (grid[..., k, None, None] for k in (0, 1))
    turns = 2 * torch.pi * (uv - first) / pitch
    return torch.stack([torch.cos(turns), torch.sin(turns)], dim=2)


def in_grid(uv: Float[Tensor, "b 2 h w"], grid: Float[Tensor, "b 2 3"]) -> Bool[Tensor, "b h w"]:
    """Which places lie in a cell."""
    first, pitch, cells = (grid[..., k, None, None] for k in range(3))
    return ((uv >= first) & (uv <= first + pitch * cells)).all(dim=1)


def phase_loss(output: FilmNetOutput, targets: Targets) -> Float[Tensor, ""]:
    """Mean squared distance of the phases from the true ones, in cells: the less is known, the shorter the expected
    pair."""
    error = (output.phases - cell_phases(targets.uv, targets.grid)).square().sum(dim=(1, 2))
    return masked_mean(error, targets.mask & in_grid(targets.uv, targets.grid), targets.weight * targets.has_grid)


def grid_loss(output: FilmNetOutput, targets: Targets) -> Float[Tensor, ""]:
    """Cross-entropy of whether a film pixel lies in a cell."""
    inside = in_grid(targets.uv, targets.grid).to(output.uv.dtype)
    error = functional.binary_cross_entropy_with_logits(output.grid_logit, inside, reduction="none")
    return masked_mean(error, targets.mask, targets.weight * targets.has_grid)


def loss_terms(output: FilmNetOutput, targets: Targets) -> dict[str, Tensor]:
    """All terms, by name as in LossWeights, not yet weighted."""
    return {
        "uv": uv_loss(output, targets),
        "mask": functional.binary_cross_entropy_with_logits(output.mask_logit, targets.mask.to(output.uv.dtype)),
        "xyz": masked_mean((output.xyz - targets.xyz).abs().sum(dim=1), targets.mask, targets.has_shape),
        "albedo": masked_mean((output.albedo - targets.albedo).abs(), targets.mask, targets.has_print),
        "slope": slope_loss(output, targets),
        "scale": scale_loss(output, targets),
        "normal": normal_loss(output, targets),
        "covered": covered_loss(output, targets),
        "phases": phase_loss(output, targets),
        "grid": grid_loss(output, targets),
        "orientation": functional.cross_entropy(output.orientation, targets.orientation),
    }
