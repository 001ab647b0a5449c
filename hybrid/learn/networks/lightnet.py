"""LightNet: predicts how bright print black and print white are at each point of a flat film.

A reflection can be told from print by what both look like: organs end at the borders of slices and recur from slice to
slice, windows and lamps do neither, and the brightest bone of one slice is as white as that of the next. The network
sees the whole film at once, small: light has little detail. Its output is two smooth fields; every detail of the
recovered film comes from the photo.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor, nn
from torch.nn import functional

from hybrid.coords import linear_from_srgb_tensor, srgb_from_linear_tensor
from hybrid.learn.networks.filmnet import Attention, ConvNorm, Residual, silent
from hybrid.learn.networks.tensors import Tensors, image_batch
from hybrid.levels import (
    CHANNEL_SHARES,
    CLIPPED,
    LEAST_CONTRAST,
    MOST_ROOT_SHARE,
    USUAL_ROOT_SHARE,
    LevelReader,
    Levels,
)


@dataclass(frozen=True)
class LightNetConfig:
    """widths: channels at 1/2, 1/4, 1/8 and 1/16 of the film. blocks: residual blocks at 1/4, 1/8 and 1/16 on the way
    down. heads: of the attention at 1/8 and 1/16. input_px: side of the square copy that is read."""

    widths: tuple[int, int, int, int] = (24, 48, 80, 112)
    blocks: tuple[int, int, int] = (1, 3, 4)
    heads: int = 4
    input_px: int = 128


@dataclass(frozen=True, eq=False)
class LightNetOutput:
    """As ``hybrid.levels.Levels``: linear grey, at half the input's resolution, and the tone of each film."""

    black: Float[Tensor, "b h w"]
    gain: Float[Tensor, "b h w"]
    root_share: Float[Tensor, " b"]


class LightNet(nn.Module):
    """An encoder to 1/16 of the film's resolution, and a decoder to half of it; each field is a sum of three, from
    coarse to fine. At 1/8 and 1/16 each position attends to all others, since what recurs from slice to slice is print.

    Light is in units of the film's mean, so a brighter photo is read the same way.
    """

    def __init__(self, config: LightNetConfig) -> None:
        super().__init__()
        self.config = config
        w2, w4, w8, w16 = config.widths
        self.down2 = nn.Sequential(ConvNorm(5, w2, 3, 2), ConvNorm(w2, w2, 3, 1))
        self.down4 = _halved(w2, w4, config.blocks[0])
        self.down8 = _halved(w4, w8, config.blocks[1])
        self.alike8 = Attention(w8, config.heads)
        self.down16 = _halved(w8, w16, config.blocks[2])
        self.alike16 = Attention(w16, config.heads)
        self.whole = nn.Conv2d(w16, w16, 1)
        self.deep = Residual(w16)
        self.lateral8, self.lateral4, self.lateral2 = nn.Conv2d(w16, w8, 1), nn.Conv2d(w8, w4, 1), nn.Conv2d(w4, w2, 1)
        self.up8, self.up4, self.up2 = Residual(w8), Residual(w4), Residual(w2)
        self.tone = silent(nn.Conv2d(w16, 1, 1))
        self.head16, self.head4, self.head2 = (nn.Conv2d(width, 2, 3, 1, 1) for width in (w16, w4, w2))

    def forward(self, films: Float[Tensor, "b 4 n n"]) -> LightNetOutput:
        """Levels of flat films. films: sRGB in [0, 1], and 1 where the photo shows the print (0 elsewhere)."""
        seen, clipped = films[:, 3:], (films[:, :3].amax(dim=1, keepdim=True) >= CLIPPED / 255).float()
        linear = linear_from_srgb_tensor(films[:, :3])
        unit = 2 * (linear_grey(linear) * seen[:, 0]).sum(dim=(1, 2)) / seen.sum(dim=(1, 2, 3)).clamp(min=1)
        unit = unit.clamp(min=1e-4)[:, None, None]
        roots = (linear / unit[:, None]).clamp(max=4).sqrt()
        x2 = self.down2(torch.cat([roots, seen, clipped], dim=1) * seen)
        x4 = self.down4(x2)
        x8 = self.alike8(self.down8(x4))
        x16 = self.alike16(self.down16(x8))
        x16 = self.deep(x16 + self.whole(x16.mean(dim=(2, 3), keepdim=True)))
        y8 = self.up8(x8 + _larger(self.lateral8(x16), 2))
        y4 = self.up4(x4 + _larger(self.lateral4(y8), 2))
        y2 = self.up2(x2 + _larger(self.lateral2(y4), 2))
        fields = _larger(self.head16(x16).float(), 8) + _larger(self.head4(y4).float(), 2) + self.head2(y2).float()
        black, gain = functional.softplus(fields[:, 0] - 2), torch.exp(fields[:, 1].clamp(-5, 4))
        tone = self.tone(x16.mean(dim=(2, 3), keepdim=True)).float().flatten()
        return LightNetOutput(unit * black, unit * gain, (USUAL_ROOT_SHARE + tone).clamp(0, MOST_ROOT_SHARE))


def _halved(inputs: int, outputs: int, blocks: int) -> nn.Sequential:
    """Halve the resolution, then apply residual blocks."""
    return nn.Sequential(ConvNorm(inputs, outputs, 3, 2), *(Residual(outputs) for _ in range(blocks)))


def _larger(x: Tensor, times: int) -> Tensor:
    return functional.interpolate(x, scale_factor=times, mode="bilinear")


def linear_grey(linear: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b h w"]:
    """Linear grey of linear RGB."""
    red, green, blue = CHANNEL_SHARES
    return red * linear[:, 0] + green * linear[:, 1] + blue * linear[:, 2]


# ---------------------------------------------------------------- losses


@dataclass(frozen=True, eq=False)
class LightTargets(Tensors):
    """grey: linear grey of the input. black, white: the true levels (linear grey), at half its resolution. contrast:
    display grey between them. flat: the print in display grey. counted: where grey shows the print with enough
    contrast."""

    grey: Float[Tensor, "b n n"]
    black: Float[Tensor, "b h w"]
    white: Float[Tensor, "b h w"]
    contrast: Float[Tensor, "b h w"]
    flat: Float[Tensor, "b n n"]
    counted: Float[Tensor, "b n n"]


SURE_CONTRAST = 0.1
"""Display grey between black and white from which the gain's error counts in full: below, noise and coding blur it."""

SURE_STEP = 4 / 255
"""Display grey by which predicted contrast must differ from ``LEAST_CONTRAST`` to tell clearly whether it is glare."""

UNHEARD = 12.0
"""Steps above ``LEAST_CONTRAST`` beyond which the glare loss gives no gradient and leaves contrast to other losses."""

LEAST_ERROR = 3e-4
"""Mean square error of the film below which further improvement counts for little."""

FEWEST_PIXELS = 800
"""A film is compared with its print only if more pixels of print than this are seen."""


def light_losses(output: LightNetOutput, truth: LightTargets) -> dict[str, Tensor]:
    """black: mean difference of the square roots, in units of the film's mean white. gain: mean difference of the logs.
    contrast: mean difference of the display grey between black and white, which vanishes where both levels clip. glare:
    cross entropy of where that is too little to recover the print. slope: mean step of the first two errors from pixel
    to pixel, so that no print shows in the fields. film: log of the mean square error of the recovered film, after one
    gain and offset."""
    unit = truth.white.mean(dim=(1, 2), keepdim=True).clamp(min=1e-4)
    gain = ((truth.white - truth.black) / unit).clamp(min=1e-3)
    roots = [(black / unit + 1e-3).sqrt() for black in (output.black, truth.black)]
    black, off = roots[0] - roots[1], (output.gain / unit).clamp(min=1e-3).log() - gain.log()
    sure = (truth.contrast / SURE_CONTRAST).clamp(0, 1)
    error, enough = film_error(output, truth)
    contrast, lost = displayed_contrast(output), (truth.contrast < LEAST_CONTRAST).float()
    return {
        "black": black.abs().clamp(max=2).mean(),
        "gain": ((off.abs().clamp(max=3) * sure).sum(dim=(1, 2)) / sure.sum(dim=(1, 2)).clamp(min=50)).mean(),
        "contrast": (contrast - truth.contrast).abs().mean(),
        "glare": functional.binary_cross_entropy_with_logits(
            ((LEAST_CONTRAST - contrast) / SURE_STEP).clamp(min=-UNHEARD), lost
        ),
        "slope": _steps(black, torch.ones_like(sure)) + 0.3 * _steps(off, sure),
        "film": ((error + LEAST_ERROR).log() * enough).sum() / enough.sum().clamp(min=1),
    }


def displayed_contrast(output: LightNetOutput) -> Float[Tensor, "b h w"]:
    """Display grey between black and white."""
    black, white = (srgb_from_linear_tensor(x) for x in (output.black, output.black + output.gain))
    return white - black


def _steps(off: Float[Tensor, "b h w"], weight: Float[Tensor, "b h w"]) -> Float[Tensor, ""]:
    """Mean absolute difference of neighbours along both axes."""
    return torch.stack([(off.diff(dim=k).abs().clamp(max=1) * weight.narrow(k, 1, off.shape[k] - 1)).mean()
                        for k in (1, 2)]).sum()  # fmt: skip


def film_error(output: LightNetOutput, truth: LightTargets) -> tuple[Float[Tensor, " b"], Float[Tensor, " b"]]:
    """Mean square error of each film against its print after the best gain and offset, and 1 where enough is seen."""
    black, gain = (_larger(x[:, None], truth.grey.shape[-1] // x.shape[-1])[:, 0] for x in (output.black, output.gain))
    even = ((truth.grey - black) / gain).clamp(max=1.5)
    even = torch.where(even > 1e-3, even, 1e-3 * torch.exp((even.clamp(max=1e-3) - 1e-3) / 1e-3))  # keeps a gradient
    share, weight = output.root_share[:, None, None], truth.counted
    shown = share * (even + 1e-5).sqrt() + (1 - share) * even
    count = weight.sum(dim=(1, 2), keepdim=True).clamp(min=1)
    film, flat = ((x - (x * weight).sum(dim=(1, 2), keepdim=True) / count) * weight for x in (shown, truth.flat))
    slope = (film * flat).sum(dim=(1, 2), keepdim=True) / film.square().sum(dim=(1, 2), keepdim=True).clamp(min=1e-6)
    error = (flat - slope * film).square().sum(dim=(1, 2)) / count[:, 0, 0]
    return error, (weight.sum(dim=(1, 2)) > FEWEST_PIXELS).float()


# ---------------------------------------------------------------- in use


def films_tensor(films: UInt8[np.ndarray, "b n n 3"], seen: Bool[np.ndarray, "b n n"]) -> Float[Tensor, "b 4 n n"]:
    """Flat films as the network reads them."""
    shown = torch.from_numpy(seen)[:, None].float()
    return torch.cat([image_batch(list(films)) * shown, shown], dim=1)


def level_reader(network: LightNet) -> LevelReader:
    """The network as the level reader of ``hybrid.rectify.film.deilluminate``.

    It reads a film twice, as it lies and turned by 180 degrees, since light does not depend on which way the print
    lies. The mean of both is nearer to the truth, and the same for a film that lies upside down.
    """

    def read(film: UInt8[np.ndarray, "n n 3"], seen: Bool[np.ndarray, "n n"]) -> Levels:
        films, shown = (np.stack([x, x[::-1, ::-1]]) for x in (film, seen))
        with torch.inference_mode():
            output = network(films_tensor(films, shown))
            black, log_gain = (torch.stack([x[0], x[1].flip(0, 1)]).mean(dim=0)
                               for x in (output.black.sqrt(), output.gain.log()))  # fmt: skip
            return Levels(black.square().numpy(), log_gain.exp().numpy(), float(output.root_share.mean()))

    return LevelReader(network.config.input_px, read)
