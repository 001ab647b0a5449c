"""The pair of the paper's study of uv against backward maps: one U-Net from 3D coordinates to either map (table 2)."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor, nn

from hybrid.learn.paper.blocks import UNetDecoder, UNetEncoder, unet_widths
from hybrid.learn.paper.dewarpnet import BackwardOutput

FIRST_WIDTH = 64
HALVINGS = 4
"""The published pair: 64 channels at full resolution, 1024 at 1/16 of it."""


@dataclass(frozen=True)
class UvBwConfig:
    """width: factor of all channel counts; 1 as published. input_px: side of the square input."""

    width: float = 1.0
    input_px: int = 256


@dataclass(frozen=True, eq=False)
class UvOutput:
    """uv: film coordinates, v down, at the input's resolution; without meaning off the film."""

    uv: Float[Tensor, "b 2 h w"]


class _CoordinateUNet(nn.Module):
    """Two numbers for each pixel from the code of 3D coordinates (``dewarpnet.coordinate_code``).

    The paper says "simple U-Net without tricks" and no more. Widths, depths and the linear output are those of the
    published code, which begins with one convolution where this network has three, as at every other level. 75.4 M
    parameters and 314 GFLOP at width 1: most of the work is done at the input's resolution.
    """

    def __init__(self, config: UvBwConfig) -> None:
        super().__init__()
        self.config = config
        widths = unet_widths(FIRST_WIDTH, HALVINGS, config.width)
        self.encoder = UNetEncoder(3, widths)
        self.decoder = UNetDecoder(2, widths)

    def pair(self, code: Tensor) -> Tensor:
        """(B, 2, H, W); 0 from the decoder means the middle of the map's range [0, 1]."""
        return self.decoder(self.encoder(code)).add(1).div(2)


class NetUv(_CoordinateUNet):
    """3D coordinates -> uv map."""

    def forward(self, code: Float[Tensor, "b 3 h w"]) -> UvOutput:
        """The uv map of a code whose sides are multiples of 16."""
        return UvOutput(self.pair(code))


class NetBw(_CoordinateUNet):
    """3D coordinates -> backward map on as many nodes as the input has pixels."""

    def forward(self, code: Float[Tensor, "b 3 h w"]) -> BackwardOutput:
        """The backward map of a square code whose side is a multiple of 16."""
        return BackwardOutput(self.pair(code))
