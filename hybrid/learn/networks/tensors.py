"""Conversion between arrays (channels last) and tensors of networks (channels first); records of tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float, Shaped, UInt8
from torch import Tensor, nn

Network = TypeVar("Network", bound=nn.Module)
Record = TypeVar("Record", bound="Tensors")


@dataclass(frozen=True, eq=False)
class Tensors:
    """A record whose fields are all tensors."""

    def to(self: Record, device: str) -> Record:
        """The same on another device."""
        return replace(self, **{f.name: getattr(self, f.name).to(device) for f in fields(self)})


def image_batch(images: Sequence[UInt8[np.ndarray, "h w 3"]]) -> Float[Tensor, "b 3 h w"]:
    """Images of one size as a network reads them: float32 in [0, 1]."""
    return torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).float().div_(255)


def map_batch(maps: Sequence[Shaped[np.ndarray, "h w *c"]]) -> Shaped[Tensor, "b *c h w"]:
    """Maps of one size, with channels (last) or without, as a tensor of their type."""
    stacked = torch.from_numpy(np.stack(maps))
    return stacked.permute(0, 3, 1, 2) if stacked.ndim == 4 else stacked


def first_map(maps: Shaped[Tensor, "b c h w"]) -> Shaped[np.ndarray, "h w c"]:
    """The first map of a batch, channels last."""
    return maps[0].permute(1, 2, 0).numpy()
