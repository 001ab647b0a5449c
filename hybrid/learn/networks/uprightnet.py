"""UprightNet: reads the writing on a flat film and tells which way is up, and whether it is seen from behind.

FilmNet sees films too small to read their writing, and slices alone may be printed upside down or mirrored; writing
never is. So this small network looks at many small patches of the flattened film, each of which casts a vote.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn
from torch.nn import functional

from hybrid.backward import Orientation
from hybrid.learn.networks.filmnet import ConvNorm
from hybrid.learn.networks.upright_patches import PatchConfig

WAYS = tuple(Orientation.from_index(index) for index in range(8))


@dataclass(frozen=True)
class UprightNetConfig:
    """widths: channels at 1/2, 1/4 and 1/8 of a patch. input_px: side of the patches. film_px, patches: longer side of
    the films that they are cut from, and their largest number per film (``PatchConfig``)."""

    widths: tuple[int, int, int] = (12, 32, 64)
    input_px: int = 48
    film_px: float = 1200.0
    patches: int = 96

    @property
    def cut(self) -> PatchConfig:
        """How films are cut up for it."""
        return PatchConfig(self.film_px, self.input_px, self.patches)


@dataclass(frozen=True)
class PatchVotes:
    """votes: for each patch, log-probabilities of the ways in which it may have to be moved to read right: the eight of
    WAYS, or the first four. written: which patches show anything. alike: correlation of the patches of one film, which
    do not err independently.
    """

    votes: Float[Tensor, "b n ways"]
    written: Bool[Tensor, "b n"]
    alike: Float[Tensor, ""]

    @property
    def films(self) -> Float[Tensor, "b ways"]:
        """Logits of the ways for each film: n patches count as n / (1 + (n - 1) alike) independent ones (the design
        effect of cluster samples, Kish 1965)."""
        others = (self.written.sum(dim=1, keepdim=True) - 1).clamp(min=0)
        return self.votes.sum(dim=1) / (1 + others * self.alike)


def joined(parts: Sequence[PatchVotes]) -> PatchVotes:
    """The votes of several sets of patches of the same films, as one."""
    votes, written = (torch.cat([getattr(part, name) for part in parts], dim=1) for name in ("votes", "written"))
    return replace(parts[0], votes=votes, written=written)


class Mix(nn.Module):
    """A 3 x 3 convolution with an identity shortcut."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Sequential(nn.Conv2d(channels, channels, 3, 1, 1, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.conv(x))


class UprightNet(nn.Module):
    """Scores how much a patch looks like writing that reads right; each patch is scored in all eight ways.

    So it cannot favour a way, what it learns about one way holds for all, and patches without writing score alike.
    """

    def __init__(self, config: UprightNetConfig) -> None:
        super().__init__()
        self.config = config
        w2, w4, w8 = config.widths
        self.stages = nn.Sequential(
            ConvNorm(1, w2, 5, 2), ConvNorm(w2, w4, 3, 2), Mix(w4), ConvNorm(w4, w8, 3, 2), Mix(w8), Mix(w8)
        )
        self.score = nn.Conv2d(w8, 1, 1)
        self.alike_logit = nn.Parameter(torch.tensor(-2.0))

    def forward(self, patches: Float[Tensor, "b n p p"]) -> PatchVotes:
        """Votes of the patches of some films (``text_patches``)."""
        held = torch.stack([_moved(patches, way) for way in WAYS], dim=2)
        scores = self.score(self.stages(held.flatten(0, 2)[:, None])).float().mean(dim=(1, 2, 3))
        votes = functional.log_softmax(scores.view(held.shape[:3]), dim=2)
        return PatchVotes(votes, patches.flatten(2).any(dim=2), self.alike_logit.sigmoid())


def _moved(patches: Float[Tensor, "*b p p"], way: Orientation) -> Float[Tensor, "*b p p"]:
    """As ``Orientation.moved``, for tensors."""
    return torch.rot90(patches.flip(-1) if way.mirrored else patches, -way.turns, (-2, -1))


def upright_losses(output: PatchVotes, truth: Int64[Tensor, " b"]) -> dict[str, Tensor]:
    """Cross-entropy of each patch, and of each film by its votes. truth: indices of the ways to read right."""
    every = truth[:, None, None].expand(*output.votes.shape[:2], 1)
    return {
        "patch": -output.votes.gather(2, every).mean(),
        "film": functional.cross_entropy(output.films, truth),
    }
