"""EdgeNet: finds the sheet's true edges in strips of the photo across the edges that a map predicts.

FilmNet sees a film about 165 pixels wide; strips along its edges show them three times as finely. Near an edge lie
other straight lines: rules of the print, other films, bars of the light box. What lies on both sides, over the whole
length, and what the sheet's other edges look like tell which line ends the sheet, and this can be learnt.

BorderNet is the same network, trained on strips across the borders between cells (datasets/borders.py). It reads four
borders of one axis together, as EdgeNet reads a film's four edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor, nn
from torch.nn import functional

from hybrid.learn.networks.filmnet import ConvNorm, Residual, local_contrast, view_coordinates
from hybrid.learn.networks.tensors import Tensors, image_batch
from hybrid.strips import SIDES, StripConfig, StripReader


@dataclass(frozen=True)
class EdgeNetConfig:
    """widths: channels at 1/2, 1/4 and 1/8 of a strip. input_px: rows of the strips; columns are two thirds of that."""

    widths: tuple[int, int, int] = (16, 32, 64)
    input_px: int = 96

    @property
    def strip(self) -> StripConfig:
        """How strips are cut for the network."""
        return StripConfig(rows=self.input_px, columns=2 * self.input_px // 3)


@dataclass(frozen=True, eq=False)
class EdgeTargets(Tensors):
    """row: where the edge crosses each output column, in rows of the strip; NaN where the strip does not show it."""

    row: Float[Tensor, "b c"]


class EdgeNet(nn.Module):
    """An encoder to 1/8 of the strip's resolution, and a decoder to all of its rows and half of its columns."""

    def __init__(self, config: EdgeNetConfig) -> None:
        super().__init__()
        self.config = config
        w2, w4, w8 = config.widths
        self.down2 = nn.Sequential(ConvNorm(8, w2, 5, 2), Residual(w2))
        self.down4 = nn.Sequential(ConvNorm(w2, w4, 3, 2), Residual(w4), Residual(w4))
        self.down8 = nn.Sequential(ConvNorm(w4, w8, 3, 2), Residual(w8), Residual(w8), Residual(w8))
        self.together = nn.Conv2d(w8, w8, 1)
        self.lateral4, self.lateral2 = nn.Conv2d(w8, w4, 1), nn.Conv2d(w4, w2, 1)
        self.up4, self.up2 = Residual(w4), Residual(w2)
        self.head = nn.Conv2d(w2, 2, 3, 1, 1)
        self.unseen = nn.Conv1d(w8, 4, 3, 1, 1)

    def forward(self, strips: Float[Tensor, "b 4 r c"]) -> Float[Tensor, "b r+1 c2"]:
        """Logits of the row at which the edge crosses each pair of columns; the last: it is not in the strip.

        strips: four of each film, in the order of SIDES, film by film; sRGB in [0, 1], and a channel that is 1 where
        the photo covers the strip."""
        colours, covered = strips[:, :3], strips[:, 3:]
        dark = torch.log2(8 * colours.mean(dim=1, keepdim=True) + 0.125) / 4  # resolves grey levels (of 255) from 2 on
        seen = [colours - 0.4, local_contrast(colours), dark, covered, view_coordinates(strips)]
        x2 = self.down2(torch.cat(seen, dim=1))
        x4 = self.down4(x2)
        x8 = self.down8[:2](x4)
        x8 = self.down8[2:](x8 + self.together(_of_all_sides(x8)))
        y4 = self.up4(x4 + functional.interpolate(self.lateral4(x8), scale_factor=2, mode="nearest"))
        y2 = self.up2(x2 + functional.interpolate(self.lateral2(y4), scale_factor=2, mode="nearest"))
        rows = self.head(y2).transpose(1, 2).flatten(1, 2)  # two rows from each row at half resolution
        unseen = self.unseen(x8.mean(dim=2)).transpose(1, 2).flatten(1, 2)  # four columns from each column at an eighth
        return torch.cat([rows, unseen[:, None]], dim=1)


def _of_all_sides(x: Float[Tensor, "b k r c"]) -> Float[Tensor, "b k r 1"]:
    """The mean of each row over a film's four strips, repeated for each strip."""
    films = x.mean(dim=3).unflatten(0, (-1, len(SIDES)))
    return films.mean(dim=1, keepdim=True).expand_as(films).flatten(0, 1)[..., None]


SOFT_ROWS = 0.7
"""Sigma, in rows, of the blur of the truth in the loss."""


def edge_losses(logits: Float[Tensor, "b r1 c"], truth: EdgeTargets) -> dict[str, Tensor]:
    """Cross-entropy of each column's row against the blurred true row."""
    rows = logits.shape[1] - 1
    row = truth.row
    none = torch.isnan(row)
    at = torch.arange(rows, device=row.device)[:, None]
    soft = torch.exp(-0.5 * ((at - row.nan_to_num()[:, None]) / SOFT_ROWS) ** 2)
    soft = soft / soft.sum(dim=1, keepdim=True).clamp(min=1e-6)
    soft = torch.where(none[:, None], torch.zeros_like(soft), soft)
    target = torch.cat([soft, none[:, None].float()], dim=1)
    return {"row": -(target * functional.log_softmax(logits.float(), dim=1)).sum(dim=1).mean()}


def strips_tensor(images: UInt8[np.ndarray, "b r c 3"], inside: Bool[np.ndarray, "b r c"]) -> Float[Tensor, "b 4 r c"]:
    """Strips as the network reads them; 0 where the photo does not cover them."""
    covered = torch.from_numpy(inside)[:, None].float()
    return torch.cat([image_batch(list(images)) * covered, covered], dim=1)


def strip_reader(network: EdgeNet) -> StripReader:
    """The network as the strip reader of ``hybrid.rectify.edges.paths`` and ``hybrid.rectify.grid.borders``."""

    def logs(images: UInt8[np.ndarray, "b r c 3"], inside: Bool[np.ndarray, "b r c"]) -> Float[np.ndarray, "b r1 c2"]:
        with torch.inference_mode():
            return functional.log_softmax(network(strips_tensor(images, inside)), dim=1).numpy()

    return StripReader(network.config.strip, logs)
