"""FilmNet: the compact network that predicts mask, uv, 3D coordinates and albedo of a film in a view of a photo."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from hybrid.coords import film_centres_1d

STRIDE = 4
"""Input pixels per output pixel and axis: the uv map varies slowly, so a quarter of the resolution loses nothing."""


@dataclass(frozen=True)
class FilmNetConfig:
    """Widths and depths. widths: channels at 1/4 (stem), 1/8, 1/16 and 1/32 of the input. blocks: residual blocks at
    1/8, 1/16 and 1/32 on the way down. heads: of the attention at 1/16 and 1/8 on the way up. input_px: side of the
    square input that the network was trained for."""

    widths: tuple[int, int, int, int] = (32, 80, 160, 320)
    blocks: tuple[int, int, int] = (1, 2, 3)
    heads: int = 4
    input_px: int = 192


@dataclass(frozen=True, eq=False)
class FilmNetOutput:
    """Maps at a quarter of the input's resolution, and one guess of the film's orientation.

    mask_logit: film where positive. uv: coordinates of the film as seen (``hybrid.backward.Orientation``). xyz: camera
    axes turned and mirrored with the view, relative to the film's centre, in film diagonals. albedo: display grey of
    the print. log_scale: natural log of the expected absolute error of uv (Laplace). phases: cosine and sine of each
    place's position in its cell, a full turn from cell to cell; across, then down the film as seen; the shorter the
    pair, the less certain. grid_logit: in a cell, not in a margin, where positive. covered_logit: something lies in
    front of the sheet where positive, valid on it only. orientation: logits of the eight ways the film may lie. normal:
    unit vector towards the side seen, in the axes of xyz; predicted in training only, else None.
    """

    mask_logit: Float[Tensor, "b h w"]
    uv: Float[Tensor, "b 2 h w"]
    xyz: Float[Tensor, "b 3 h w"]
    albedo: Float[Tensor, "b h w"]
    log_scale: Float[Tensor, "b h w"]
    phases: Float[Tensor, "b 2 2 h w"]
    grid_logit: Float[Tensor, "b h w"]
    covered_logit: Float[Tensor, "b h w"]
    orientation: Float[Tensor, "b 8"]
    normal: Float[Tensor, "b 3 h w"] | None = None


_CHANNELS = 1 + 2 + 3 + 1 + 1 + 4 + 1 + 1
_TRAINING_CHANNELS = 3


class ConvNorm(nn.Sequential):
    """Convolution, batch normalisation, ReLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )


class Residual(nn.Module):
    """Two 3 x 3 convolutions with an identity shortcut."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = ConvNorm(channels, channels, 3, 1)
        self.second = nn.Sequential(nn.Conv2d(channels, channels, 3, 1, 1, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.second(self.first(x)))


class Attention(nn.Module):
    """Attention of each place to all others (Vaswani et al. 2017), with an identity shortcut. Before training it
    changes nothing."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.asked = nn.Conv2d(channels + 2, 3 * channels, 1)
        self.said = silent(nn.Conv2d(channels, channels, 1))

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        size = x.shape[2:]
        asked = self.asked(torch.cat([x, view_coordinates(x)], dim=1)).flatten(2).unflatten(1, (3, self.heads, -1))
        query, key, value = asked.transpose(3, 4).unbind(dim=1)
        found = functional.scaled_dot_product_attention(query, key, value)
        return x + self.said(found.transpose(2, 3).flatten(1, 2).unflatten(2, size))


def silent(conv: nn.Conv2d) -> nn.Conv2d:
    """The convolution with all parameters set to zero, so that it adds nothing until trained."""
    for values in conv.parameters():
        nn.init.zeros_(values)
    return conv


class FilmNet(nn.Module):
    """An encoder to 1/32 of the input's resolution and a decoder back to 1/8, whose head writes 2 x 2 pixels per place.

    Most of the work is done at 1/8 and below, where a few convolutions reach across the whole film; on the way up, each
    place also attends to all others, since distant edges tell where on the sheet it lies. Each pixel is given its
    position in the view (Liu et al. 2018, CoordConv), and uv is predicted as an offset from it. Besides colours, the
    network sees their local contrast, in which a dark film on dark ground looks like any other.
    """

    def __init__(self, config: FilmNetConfig) -> None:
        super().__init__()
        self.config = config
        stem, w8, w16, w32 = config.widths
        self.stem = ConvNorm(3 + 1 + 2, stem, 7, STRIDE)
        self.down8 = nn.Sequential(ConvNorm(stem, w8, 3, 2), *(Residual(w8) for _ in range(config.blocks[0])))
        self.down16 = nn.Sequential(ConvNorm(w8, w16, 3, 2), *(Residual(w16) for _ in range(config.blocks[1])))
        self.down32 = nn.Sequential(ConvNorm(w16, w32, 3, 2), *(Residual(w32) for _ in range(config.blocks[2])))
        self.lateral16 = nn.Conv2d(w32, w16, 1)
        self.among16 = Attention(w16, config.heads)
        self.up16 = Residual(w16)
        self.lateral8 = nn.Conv2d(w16, w8, 1)
        self.among8 = Attention(w8, config.heads)
        self.up8 = Residual(w8)
        self.head = nn.Conv2d(w8 + 2, 4 * _CHANNELS, 3, 1, 1)
        self.training_head = nn.Conv2d(w8, 4 * _TRAINING_CHANNELS, 1)
        self.orientation_head = nn.Linear(w32, 8)

    def forward(self, image: Float[Tensor, "b 3 H W"]) -> FilmNetOutput:
        """Maps of sRGB images in [0, 1] whose sides are multiples of 32."""
        x4 = self.stem(torch.cat([image - 0.4, local_contrast(image), view_coordinates(image)], dim=1))
        x8 = self.down8(x4)
        x16 = self.down16(x8)
        x32 = self.down32(x16)
        y16 = self.up16(self.among16(x16 + _doubled(self.lateral16(x32))))
        y8 = self.up8(self.among8(x8 + _doubled(self.lateral8(y16))))
        maps = functional.pixel_shuffle(self.head(torch.cat([y8, view_coordinates(y8)], dim=1)), 2)
        maps = maps.float()  # bfloat16 would resolve uv only to a 256th of the film
        return FilmNetOutput(
            mask_logit=maps[:, 0],
            uv=maps[:, 1:3] + view_coordinates(maps) + 0.5,
            xyz=maps[:, 3:6],
            albedo=maps[:, 6],
            log_scale=maps[:, 7] - 3.0,
            phases=maps[:, 8:12].unflatten(1, (2, 2)),
            grid_logit=maps[:, 12],
            covered_logit=maps[:, 13],
            orientation=self.orientation_head(x32.mean(dim=(2, 3))).float(),
            normal=functional.pixel_shuffle(self.training_head(y8), 2).float() if self.training else None,
        )


def _doubled(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2, mode="nearest")


def view_coordinates(maps: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 2 h w"]:
    """Positions (x, y) of the pixel centres relative to the view's middle, as fractions of its sides."""
    h, w = maps.shape[-2:]
    x, y = (torch.from_numpy(film_centres_1d(n)).to(maps) - 0.5 for n in (w, h))
    return torch.stack([x.expand(h, w), y[:, None].expand(h, w)]).expand(len(maps), 2, h, w)


def local_contrast(images: Float[Tensor, "b 3 H W"], window: int = 32) -> Float[Tensor, "b 1 H W"]:
    """Grey minus its mean, over its standard deviation, both in a window of about ``window`` pixels; within +-1.

    It does not depend on the image's gain, except that differences of less than about 0.01 stay faint: they are noise.
    """
    grey = images.mean(dim=1, keepdim=True)
    size = grey.shape[-2:]

    def around(values: Tensor) -> Tensor:
        pooled = functional.avg_pool2d(values, window, window // 2, window // 4, count_include_pad=False)
        return functional.interpolate(pooled, size=size, mode="bilinear")

    off = grey - around(grey)
    return (off / (4.0 * (around(off * off) + 1e-4).sqrt())).clamp(-1.0, 1.0)
