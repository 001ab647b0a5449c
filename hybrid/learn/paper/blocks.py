"""Building blocks of the paper's networks: a U-Net in two halves, so that several decoders can share one encoder."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

GROUPS = 8
"""Groups of every group normalisation; channel counts are multiples of it."""


def scaled(channels: int, width: float) -> int:
    """Channels of a layer at a width factor: the nearest multiple of GROUPS, at least GROUPS."""
    return GROUPS * max(1, round(channels * width / GROUPS))


def unet_widths(first: int, halvings: int, width: float) -> tuple[int, ...]:
    """Channels at full resolution and after each halving: doubled each time, then scaled by ``width``."""
    return tuple(scaled(first << k, width) for k in range(halvings + 1))


class TripleConv(nn.Sequential):
    """Three times: 3 x 3 convolution, group normalisation, ReLU."""

    def __init__(self, inputs: int, outputs: int) -> None:
        layers: list[nn.Module] = []
        for k in range(3):
            layers += [
                nn.Conv2d(inputs if k == 0 else outputs, outputs, 3, padding=1),
                nn.GroupNorm(GROUPS, outputs),
                nn.ReLU(inplace=True),
            ]
        super().__init__(*layers)


class UNetEncoder(nn.Module):
    """Features of an image at full resolution and after each halving.

    Each step convolves first and then halves by max pooling, as the published code does: most of the arithmetic is done
    at the finer of the two resolutions.
    """

    def __init__(self, inputs: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.first = TripleConv(inputs, widths[0])
        self.steps = nn.ModuleList(TripleConv(a, b) for a, b in pairwise(widths))
        self.bottom = TripleConv(widths[-1], widths[-1])

    def forward(self, image: Tensor) -> list[Tensor]:
        """Features, fine to coarse, of (B, inputs, H, W) with sides divisible by 2 to the number of halvings."""
        features = [self.first(image)]
        for step in self.steps:
            features.append(functional.max_pool2d(step(features[-1]), 2))
        features[-1] = self.bottom(features[-1])
        return features


class UNetDecoder(nn.Module):
    """From an encoder's features back to full resolution; ``head`` maps the finest features to the output."""

    def __init__(self, outputs: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.steps = nn.ModuleList(TripleConv(a + b, a) for a, b in pairwise(widths))
        self.head = nn.Conv2d(widths[0], outputs, 1)

    def features(self, encoded: Sequence[Tensor]) -> Tensor:
        """The finest features, (B, widths[0], H, W)."""
        x = encoded[-1]
        for k in reversed(range(len(self.steps))):
            x = self.steps[k](torch.cat([doubled(x), encoded[k]], dim=1))
        return x

    def forward(self, encoded: Sequence[Tensor]) -> Tensor:
        """(B, outputs, H, W), without an activation."""
        return self.decoded(self.features(encoded))

    def decoded(self, features: Tensor) -> Tensor:
        """The output for the finest features, in single precision."""
        return in_single_precision(self.head, features)


def in_single_precision(layer: nn.Module, x: Tensor) -> Tensor:
    """Apply a last layer to ``x`` in single precision, whatever type autocast computes other layers in: near one half,
    bfloat16 has steps of a 256th."""
    if not torch.amp.is_autocast_available(x.device.type):  # meta tensors, used for their shapes only
        return layer(x)
    with torch.autocast(x.device.type, enabled=False):
        return layer(x.float())


def doubled(x: Tensor) -> Tensor:
    """Twice the resolution, bilinear between pixel centres."""
    return functional.interpolate(x, scale_factor=2, mode="bilinear")
