"""Losses of FilmNet, each a function of prediction, truth and mask."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor
from torch.nn import functional

from hybrid.learn.network import FilmNetOutput
from hybrid.learn.tensors import Tensors


@dataclass(frozen=True, eq=False)
class Targets(Tensors):
    """Truth at the network's output resolution; 0 where the mask is False.

    uv: of the film as seen. orientation: index of what makes it read right. weight: of each view in the loss.
    has_shape, has_print: 1 where xyz and normal, and albedo, are known; 0 where they are not and teach nothing.
    """

    mask: Bool[Tensor, "b h w"]
    uv: Float[Tensor, "b 2 h w"]
    xyz: Float[Tensor, "b 3 h w"]
    albedo: Float[Tensor, "b h w"]
    normal: Float[Tensor, "b 3 h w"]
    orientation: Int64[Tensor, " b"]
    weight: Float[Tensor, " b"]
    has_shape: Float[Tensor, " b"]
    has_print: Float[Tensor, " b"]


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
    orientation: float = 0.05


def masked_mean(
    values: Float[Tensor, "b h w"], mask: Bool[Tensor, "b h w"], weight: Float[Tensor, " b"] | None = None
) -> Float[Tensor, ""]:
    """Mean over the pixels of each film, then (weighted) over the films, so that a small one counts as a large one."""
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
        "orientation": functional.cross_entropy(output.orientation, targets.orientation),
    }
