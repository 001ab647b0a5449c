"""DewarpNet (Das et al., ICCV 2019), the paper's baseline: a shape network, then a backward-map network.

``baselines`` holds what its inference does with the backward map, as published and corrected.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from hybrid.coords import film_nodes
from hybrid.errors import ConfigError, describe
from hybrid.learn.paper.blocks import in_single_precision, scaled

CODE_CENTRE = 0.5
"""Value of a code of 3D coordinates at the film's centre."""

NODES = 128
"""Side of the backward-map network's input and output."""

ENCODER_DEPTHS = (6, 12, 16, 16, 16)
DECODER_DEPTHS = (16, 16, 12, 6, 6)
"""Layers of each dense block, in the order of the forward pass."""

Layers = Literal["published", "read", "dense"]


@dataclass(frozen=True)
class DewarpNetConfig:
    """Widths and depths.

    width: factor of all channel counts; 1 as published. halvings: of the shape network; the input's side is a multiple
    of 2 to this power. latent: numbers between the dense network's halves. input_px: side of the shape network's input.
    layers: of the dense blocks. "published" holds all but reads only the first of each block, as the released code
    does; "read" holds only those that are read: the same function in half the memory; "dense" holds and reads all, as
    the paper describes.
    """

    width: float = 1.0
    halvings: int = 7
    latent: int = 128
    input_px: int = 256
    layers: Layers = "published"


@dataclass(frozen=True, eq=False)
class ShapeOutput:
    """code: 3D coordinates + CODE_CENTRE on the film, 0 off it (see ``coordinate_code``), at the input's resolution."""

    code: Float[Tensor, "b 3 h w"]

    @property
    def xyz(self) -> Float[Tensor, "b 3 h w"]:
        """Camera axes, relative to the film's centre, in film diagonals; without meaning off the film."""
        return self.code - CODE_CENTRE


@dataclass(frozen=True, eq=False)
class BackwardOutput:
    """backward: photo points on nodes of the film, in units of the photo's sides.

    Entry [:, i, j] is the point (x / width, y / height) that shows film point (j / (n - 1), i / (n - 1)).
    """

    backward: Float[Tensor, "b 2 n n"]


@dataclass(frozen=True, eq=False)
class DewarpNetOutput:
    """Outputs of the two networks."""

    shape: ShapeOutput
    backward: Float[Tensor, "b 2 n n"]


def coordinate_code(xyz: Float[Tensor, "b 3 h w"], mask: Bool[Tensor, "b h w"]) -> Float[Tensor, "b 3 h w"]:
    """3D coordinates as networks read and write them: shifted into (0, 1) on the film, 0 off it.

    No point of a sheet is farther than half a diagonal from its centre, so only 0 means "no film here". Without the
    shift, the film's centre would look like background. The publications scale each map to [0.1, 1] for this purpose.
    """
    return torch.where(mask[:, None], xyz + CODE_CENTRE, torch.zeros_like(xyz))


# ---------------------------------------------------------------- shape network


def _shape_widths(config: DewarpNetConfig) -> list[int]:
    """Channels after each halving: 64, doubled up to 512 at width 1."""
    return [scaled(64 << min(k, 3), config.width) for k in range(config.halvings)]


class ShapeNet(nn.Module):
    """Image -> 3D coordinates: a U-Net of strided 4 x 4 convolutions with batch normalisation, 41.8 M at width 1."""

    def __init__(self, config: DewarpNetConfig) -> None:
        super().__init__()
        self.config = config
        widths = _shape_widths(config)
        self.first = nn.Conv2d(3, widths[0], 4, 2, 1, bias=False)
        self.down = nn.ModuleList(
            nn.Sequential(nn.LeakyReLU(0.2), nn.Conv2d(a, b, 4, 2, 1, bias=False), nn.BatchNorm2d(b))
            for a, b in pairwise(widths[:-1])
        )
        self.bottom = nn.Sequential(nn.LeakyReLU(0.2), nn.Conv2d(widths[-2], widths[-1], 4, 2, 1, bias=False))
        inputs = [widths[-1], *(2 * w for w in reversed(widths[1:-1]))]
        self.up = nn.ModuleList(
            nn.Sequential(nn.ReLU(), nn.ConvTranspose2d(a, b, 4, 2, 1, bias=False), nn.BatchNorm2d(b))
            for a, b in zip(inputs, reversed(widths[:-1]), strict=True)
        )
        self.last = nn.Sequential(nn.ReLU(), nn.ConvTranspose2d(2 * widths[0], 3, 4, 2, 1))

    def forward(self, image: Float[Tensor, "b 3 H W"]) -> ShapeOutput:
        """The code of sRGB images in [0, 1] whose sides are multiples of 2 ** halvings."""
        skipped = [self.first(image)]
        for down in self.down:
            skipped.append(down(skipped[-1]))
        x = self.bottom(skipped[-1])
        for up, beside in zip(self.up, reversed(skipped), strict=True):
            x = torch.cat([beside, up(x)], dim=1)
        # The hyperbolic tangent is the network's own; training and inference both clamp its output at 0.
        return ShapeOutput(torch.tanh(in_single_precision(self.last, x)).clamp(0.0, 1.0))


# ---------------------------------------------------------------- backward-map network


class _DenseBlock(nn.Module):
    """Normalise, activate, convolve; each layer reads the sum of what all layers before it wrote.

    Only ``read`` of the ``held`` layers take part. The released code adds up earlier outputs but never calls a layer
    beyond a block's first, so that a block of n layers gives 2 ** (n - 2) times its first layer's output; the batch
    normalisation that follows every block divides this factor out, so it is left out here.
    """

    def __init__(self, channels: int, held: int, read: int) -> None:
        super().__init__()
        self.read = read
        self.layers = nn.ModuleList(
            nn.Sequential(
                nn.BatchNorm2d(channels), nn.ReLU(), nn.Conv2d(channels, channels, 3, padding=1, bias=False)
            ).requires_grad_(k < read)
            for k in range(held)
        )

    def forward(self, x: Tensor) -> Tensor:
        x = total = self.layers[0](x)
        for k in range(1, self.read):
            x = self.layers[k](total)
            total = total + x
        return x


def _dense_block(channels: int, depth: int, layers: Layers) -> _DenseBlock:
    held, read = {"published": (depth, 1), "read": (1, 1), "dense": (depth, depth)}[layers]
    return _DenseBlock(channels, held, read)


def _dense_encoder(config: DewarpNetConfig) -> nn.Sequential:
    """(B, 5, 128, 128) -> (B, latent, 1, 1)."""
    widths = [scaled(c, config.width) for c in (32, 64, 128, 256, 256)]
    parts: list[nn.Module] = [nn.BatchNorm2d(5), nn.ReLU(), nn.Conv2d(5, widths[0], 4, 2, 1)]
    for depth, a, b, pool in zip(ENCODER_DEPTHS, widths, [*widths[1:], config.latent], (2, 2, 2, 2, 4), strict=True):
        parts += [
            _dense_block(a, depth, config.layers),
            nn.Sequential(nn.BatchNorm2d(a), nn.LeakyReLU(0.2), nn.Conv2d(a, b, 1, bias=False), nn.MaxPool2d(pool)),
        ]
    return nn.Sequential(*parts, nn.Tanh())


def _raised(inputs: int, outputs: int, *geometry: int) -> nn.Sequential:
    """Normalise, activate, convolve transposed with (kernel, stride, padding)."""
    return nn.Sequential(nn.BatchNorm2d(inputs), nn.ReLU(), nn.ConvTranspose2d(inputs, outputs, *geometry, bias=False))


def _dense_decoder(config: DewarpNetConfig) -> nn.Sequential:
    """(B, latent, 1, 1) -> (B, 2, 128, 128)."""
    widths = [scaled(c, config.width) for c in (256, 256, 128, 64, 32)]
    parts: list[nn.Module] = [_raised(config.latent, widths[0], 4, 1, 0)]
    for depth, a, b in zip(DECODER_DEPTHS, widths, [*widths[1:], widths[-1]], strict=True):
        parts += [_dense_block(a, depth, config.layers), _raised(a, b, 4, 2, 1)]
    return nn.Sequential(*parts, _raised(widths[-1], 2, 3, 1, 1))


class BackwardNet(nn.Module):
    """3D coordinates -> backward map: dense blocks down to one vector and up again, 45.1 M at width 1.

    Training takes at least two samples per batch: the bottleneck has a batch normalisation of single values.
    """

    def __init__(self, config: DewarpNetConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = _dense_encoder(config)
        self.decoder = _dense_decoder(config)
        # Pixel positions as two more channels; the first layer normalises them, so their scale does not matter.
        position = torch.from_numpy(film_nodes((NODES, NODES))).float().permute(2, 0, 1)[None]
        self.register_buffer("position", position, persistent=False)

    def forward(self, code: Float[Tensor, "b 3 h w"]) -> BackwardOutput:
        """The map for a code of 3D coordinates of any size, which is subsampled without averaging."""
        small = functional.interpolate(code, (NODES, NODES), mode="nearest")
        position = self.get_buffer("position").expand(len(small), -1, -1, -1)
        features = self.decoder[:-1](self.encoder(torch.cat([small, position], dim=1)))
        normalised = functional.hardtanh(in_single_precision(self.decoder[-1], features))
        return BackwardOutput(normalised.add(1).div(2))


class DewarpNet(nn.Module):
    """Image -> 3D coordinates -> backward map.

    At width 1 it has 86.9 M parameters and takes 13 GFLOP at 256 x 256, the published figures. Both are true at once
    only because the released dense blocks never read 39.9 M of the parameters (see ``_DenseBlock``): with
    ``layers="read"`` there are 47.0 M at the same 13 GFLOP, with ``layers="dense"`` 86.9 M at 20 GFLOP.
    """

    def __init__(self, config: DewarpNetConfig) -> None:
        super().__init__()
        self.config = config
        self.shape_net = ShapeNet(config)
        self.backward_net = BackwardNet(config)

    def forward(self, image: Float[Tensor, "b 3 H W"]) -> DewarpNetOutput:
        """Maps of sRGB images in [0, 1] whose sides are multiples of 2 ** halvings."""
        shape = self.shape_net(image)
        return DewarpNetOutput(shape, self.backward_net(shape.code).backward)


def joined(shape_net: ShapeNet, backward_net: BackwardNet) -> DewarpNet:
    """DewarpNet made of two separately trained stages; it shares their weights.

    Raises:
        ConfigError: the stages have different configurations.
    """
    if shape_net.config != backward_net.config:
        raise ConfigError(
            describe(
                what="DewarpNet's stages",
                got=f"{shape_net.config} and {backward_net.config}",
                allowed="one configuration",
                do="Train both at the same width.",
            )
        )
    network = DewarpNet(shape_net.config)
    network.shape_net, network.backward_net = shape_net, backward_net
    return network
