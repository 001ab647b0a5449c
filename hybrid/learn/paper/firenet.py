"""FiReNet, the paper's network (PAPER.tex, section "CT Film Recovery Network"), and its ablations (table 3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from hybrid.learn.paper.blocks import UNetDecoder, UNetEncoder, unet_widths

FIRST_WIDTH = 16
HALVINGS = 6
"""The published U-Nets: 16 channels at full resolution, 1024 at 1/64 of it."""

MapName = Literal["xyz", "normal", "depth"]
HeadName = Literal["uv", "deformation", "albedo"]


@dataclass(frozen=True)
class FiReNetConfig:
    """Width and parts.

    width: factor of all channel counts; 1 as published. maps: those that the multi-map module decodes besides the
    background (table 3's "MM": xyz alone, or all three). heads: decoded from the second encoder (table 3's "Deform":
    with or without the deformation map). input_px: side of the square input that the network is trained for.
    """

    width: float = 1.0
    maps: tuple[MapName, ...] = ("xyz", "normal", "depth")
    heads: tuple[HeadName, ...] = ("uv", "deformation", "albedo")
    input_px: int = 256


UV_ONLY = FiReNetConfig(maps=("xyz",), heads=("uv", "albedo"))
"""Table 3, first row: uv from the 3D map alone."""

MULTI_MAP = FiReNetConfig(heads=("uv", "albedo"))
"""Table 3, second row: + normal and depth. The third row, with the deformation map, is the default configuration."""


@dataclass(frozen=True, eq=False)
class FiReNetOutput:
    """Maps at the input's resolution; None for a map that the configuration leaves out.

    mask_logit: film where positive (the paper's background map). xyz: camera axes, relative to the film's centre, in
    film diagonals. normal: of unit length in the truth, camera axes, towards the side that is seen. depth: along the
    optical axis, relative to the film's centre, in film diagonals. uv: film coordinates in [0, 1], v down. albedo:
    display grey in [0, 1]. deformation: on nodes of the *film*, not on the photo's pixels: entry [i, j] is the photo
    point of film node (j / (w - 1), i / (h - 1)) less that node, in units of the photo's sides.
    """

    mask_logit: Float[Tensor, "b h w"]
    xyz: Float[Tensor, "b 3 h w"]
    uv: Float[Tensor, "b 2 h w"]
    albedo: Float[Tensor, "b h w"]
    normal: Float[Tensor, "b 3 h w"] | None = None
    depth: Float[Tensor, "b h w"] | None = None
    deformation: Float[Tensor, "b 2 h w"] | None = None


class _Kind(NamedTuple):
    """Channels of a map, and the activation that brings the decoder's output into the map's range."""

    channels: int
    activation: Callable[[Tensor], Tensor]


def _unit(x: Tensor) -> Tensor:
    """Into (0, 1) by the hyperbolic tangent, the published activation."""
    return torch.tanh(x).add(1).div(2)


_KINDS: dict[str, _Kind] = {
    "xyz": _Kind(3, torch.tanh),
    "normal": _Kind(3, torch.tanh),
    "depth": _Kind(1, lambda x: torch.tanh(x)[:, 0]),
    "uv": _Kind(2, _unit),
    "deformation": _Kind(2, torch.tanh),
    "albedo": _Kind(1, lambda x: _unit(x)[:, 0]),
}


def _decoders(named: nn.ModuleDict) -> list[tuple[str, UNetDecoder]]:
    """Decoders with the names of what they decode; nn.ModuleDict does not know the type of its modules."""
    return cast("list[tuple[str, UNetDecoder]]", list(named.items()))


class FiReNet(nn.Module):
    """Image -> encoder -> map decoders -> filtered by the background -> second encoder -> uv, deformation, albedo.

    At width 1 it has 229.7 M parameters and 104 GFLOP at 256 x 256; the publication, 229.7 M and 106 GFLOP. Each of the
    two encoders has 59.8 M, each of the seven decoders 15.7 M. The paper gives neither widths nor depths; these are
    taken from the published code: six halvings from 16 channels, three convolutions with group normalisation per level.
    The paper calls the input of the second encoder the combined maps. In the code, as here, it consists of the finest
    features of the maps' decoders and the image, multiplied by the background's probability. The number of feature
    levels is an option there; one level gives the published counts, three (its default) 229.8 M and 111 GFLOP. The
    released decoders also compute a convolution whose result is never read (2.1 GFLOP in all); it is left out here.
    """

    def __init__(self, config: FiReNetConfig) -> None:
        super().__init__()
        self.config = config
        widths = unet_widths(FIRST_WIDTH, HALVINGS, config.width)
        self.encoder = UNetEncoder(3, widths)
        self.background = UNetDecoder(1, widths)
        self.maps = nn.ModuleDict({name: UNetDecoder(_KINDS[name].channels, widths) for name in config.maps})
        self.second_encoder = UNetEncoder(3 + len(config.maps) * widths[0], widths)
        self.heads = nn.ModuleDict({name: UNetDecoder(_KINDS[name].channels, widths) for name in config.heads})

    def forward(self, image: Float[Tensor, "b 3 H W"]) -> FiReNetOutput:
        """Maps of sRGB images in [0, 1] whose sides are multiples of 64."""
        scaled = image.mul(2).sub(1)  # the paper scales all images to [-1, 1]
        encoded = self.encoder(scaled)
        mask_logit = self.background(encoded)
        found, seen = {}, [scaled]
        for name, decoder in _decoders(self.maps):
            features = decoder.features(encoded)
            found[name] = _KINDS[name].activation(decoder.decoded(features))
            seen.append(features)
        encoded = self.second_encoder(torch.cat(seen, dim=1) * torch.sigmoid(mask_logit))
        for name, decoder in _decoders(self.heads):
            found[name] = _KINDS[name].activation(decoder(encoded))
        return FiReNetOutput(mask_logit=mask_logit[:, 0], **found)
