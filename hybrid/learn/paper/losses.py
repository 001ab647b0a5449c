"""The losses of the paper, each with its equation, and those of its baselines.

Norms are taken over the two or three numbers of a pixel and averaged over pixels and films, so that neither the image's
nor the film's size changes a term's weight, as they would in the paper's sums. The paper scales all maps to [-1, 1]
before it adds their terms; here uv, albedo and background lie in [0, 1], coordinates and depth are in diagonals of the
film, and only normals in [-1, 1]: against these terms normals count twice as much as in the paper, depth less. Maps of
the photo are compared on the film, whereas the published code compares whole images with 0 as the background's truth.

The published code never puts the terms of equation (3) to use: its training only sums L1 terms. Its versions of them
differ from the paper's; the shift and disturbance are squared, the de-shifted difference is a smooth L1 loss of the
error less its mean where equation (3) takes the smaller of the two, and the deviation is one number for the whole
batch.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hybrid.coords import sample_photo
from hybrid.learn.networks.losses import masked_mean
from hybrid.learn.paper.dewarpnet import BackwardOutput, DewarpNetOutput, ShapeOutput, coordinate_code
from hybrid.learn.paper.firenet import FiReNetOutput
from hybrid.learn.paper.targets import PaperTargets
from hybrid.learn.paper.uvbw import UvOutput

ALPHA = 2.0
BETA = 2.0
"""The paper's weights of disturbance and de-shifted difference in equation (4)."""

_MIN_VARIANCE = 1e-12
"""Below it the deviation is practically 0, and the square root's slope would grow without bound."""


def everywhere(error: Float[Tensor, "b c h w"]) -> Bool[Tensor, "b h w"]:
    """A mask that leaves nothing out."""
    return torch.ones_like(error[:, 0], dtype=torch.bool)


# ---------------------------------------------------------------- equations (1) to (5)


def l1_loss(error: Float[Tensor, "b c h w"], mask: Bool[Tensor, "b h w"]) -> Float[Tensor, ""]:
    """Equation (1): L_3D = || M^_3D - M_3D ||_1, and so for every other map. error: prediction less truth."""
    return masked_mean(error.abs().sum(dim=1), mask)


def shape_terms(output: FiReNetOutput, targets: PaperTargets) -> dict[str, Tensor]:
    """Terms of equation (2), whose sum it is: L_shape = L_3D + L_nor + L_dp + L_bg.

    Maps that an ablation leaves out have no term. The background's error is that of its probability, on all pixels.
    """
    background = torch.sigmoid(output.mask_logit) - targets.mask.to(targets.uv.dtype)
    terms = {
        "xyz": l1_loss(output.xyz - targets.xyz, targets.mask),
        "background": background.abs().mean(),
    }
    if output.normal is not None:
        terms["normal"] = l1_loss(output.normal - targets.normal, targets.mask)
    if output.depth is not None:
        terms["depth"] = l1_loss((output.depth - targets.depth)[:, None], targets.mask)
    return terms


def error_mean(error: Float[Tensor, "b c h w"], mask: Bool[Tensor, "b h w"]) -> Float[Tensor, "b c 1 1"]:
    """mu of equation (3): mean error over each film, for each channel."""
    weight = mask[:, None].to(error.dtype)
    return (error * weight).sum(dim=(2, 3), keepdim=True) / weight.sum(dim=(2, 3), keepdim=True).clamp(min=1.0)


def shift_loss(error: Float[Tensor, "b c h w"], mask: Bool[Tensor, "b h w"]) -> Float[Tensor, ""]:
    """Equation (3), first part: L_shift = || mu ||_1, with mu the mean of the error, prediction less truth."""
    return error_mean(error, mask).abs().sum(dim=1).mean()


def disturbance_loss(error: Float[Tensor, "b c h w"], mask: Bool[Tensor, "b h w"]) -> Float[Tensor, ""]:
    """Equation (3), second part: L_disturb = || sigma ||_1, with sigma the error's standard deviation over each film.

    The paper's text calls sigma both variance and standard deviation; the latter has the error's unit.
    """
    variance = error_mean((error - error_mean(error, mask)) ** 2, mask)
    return variance.clamp(min=_MIN_VARIANCE).sqrt().sum(dim=1).mean()


def deshifted_difference_loss(error: Float[Tensor, "b c h w"], mask: Bool[Tensor, "b h w"]) -> Float[Tensor, ""]:
    """Equation (3), third part: L_diff = min(| e |, | e - mu |) where e (e - mu) > 0, else 0, for each number e.

    Where e and e - mu differ in sign the point lies between its absolute and its relative place, and is left alone.
    """
    relative = error - error_mean(error, mask)
    smaller = torch.minimum(error.abs(), relative.abs())
    return l1_loss(torch.where(error * relative > 0, smaller, torch.zeros_like(error)), mask)


def deformation_loss(
    error: Float[Tensor, "b c h w"], mask: Bool[Tensor, "b h w"], alpha: float = ALPHA, beta: float = BETA
) -> Float[Tensor, ""]:
    """Equation (4): L_df = L_shift + alpha L_disturb + beta L_diff; the uv map's loss L_uv has the same form."""
    disturb, diff = disturbance_loss(error, mask), deshifted_difference_loss(error, mask)
    return shift_loss(error, mask) + alpha * disturb + beta * diff


def transformation_terms(
    output: FiReNetOutput, targets: PaperTargets, alpha: float = ALPHA, beta: float = BETA
) -> dict[str, Tensor]:
    """Terms of equation (5), whose sum it is: L_trans = L_df + L_uv + L_ab; without L_df where an ablation has none.

    The deformation map lives on the film's nodes, all of which have a truth, so it needs no mask.
    """
    terms = {
        "uv": deformation_loss(output.uv - targets.uv, targets.mask, alpha, beta),
        "albedo": l1_loss((output.albedo - targets.albedo)[:, None], targets.mask),
    }
    if output.deformation is not None:
        error = output.deformation - targets.deformation
        terms["deformation"] = deformation_loss(error, everywhere(error), alpha, beta)
    return terms


def firenet_losses(output: FiReNetOutput, targets: PaperTargets) -> dict[str, Tensor]:
    """All terms of the paper's total, L = L_shape + L_trans; each counts once."""
    return shape_terms(output, targets) | transformation_terms(output, targets)


# ---------------------------------------------------------------- the baselines


def shape_net_losses(output: ShapeOutput, targets: PaperTargets) -> dict[str, Tensor]:
    """L1 of the coordinate code on the whole image, background included, which the backward-map network relies on.

    The DewarpNet paper adds a gradient error; its released training has that term switched off.
    """
    error = output.code - coordinate_code(targets.xyz, targets.mask)
    return {"code": l1_loss(error, everywhere(error))}


def reconstruction_loss(predicted: Float[Tensor, "b 2 n n"], targets: PaperTargets) -> Float[Tensor, ""]:
    """Mean squared difference of the print unwarped with the predicted and with the true map.

    The albedo stands for the print as seen in the photo: light would make the loss depend on the scene.
    """
    albedo = targets.albedo[:, None]
    sides = albedo.new_tensor([albedo.shape[-1], albedo.shape[-2]])

    def unwarped(backward: Tensor) -> Tensor:
        return sample_photo(albedo, backward.permute(0, 2, 3, 1) * sides)

    return (unwarped(predicted) - unwarped(targets.backward)).square().mean()


def backward_net_losses(output: BackwardOutput, targets: PaperTargets) -> dict[str, Tensor]:
    """DewarpNet's second stage: L1 of the backward map and the reconstruction loss."""
    error = output.backward - targets.backward
    return {
        "backward": l1_loss(error, everywhere(error)),
        "reconstruction": reconstruction_loss(output.backward, targets),
    }


def dewarpnet_losses(output: DewarpNetOutput, targets: PaperTargets) -> dict[str, Tensor]:
    """Losses of both stages of DewarpNet, for training them as one."""
    return shape_net_losses(output.shape, targets) | backward_net_losses(BackwardOutput(output.backward), targets)


def net_bw_losses(output: BackwardOutput, targets: PaperTargets) -> dict[str, Tensor]:
    """L1 of the backward map, for the study of table 2."""
    error = output.backward - targets.backward
    return {"backward": l1_loss(error, everywhere(error))}


def net_uv_losses(output: UvOutput, targets: PaperTargets) -> dict[str, Tensor]:
    """L1 of the uv map on the film, for the study of table 2."""
    return {"uv": l1_loss(output.uv - targets.uv, targets.mask)}
