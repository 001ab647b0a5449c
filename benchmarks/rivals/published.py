"""The paper's networks as wide as published, and DewarpNet as released: their run time.

It does not depend on the values of the weights, so these are random. What follows the network does depend on its output
(recovery looks at film pixels, resampling at places in the photo), so the network runs and its output is then replaced
by the true one. Such a method has a run time and no error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor, nn

from benchmarks.methods import (
    DEWARPNET_DUE,
    DEWARPNET_PUBLISHED,
    Flattened,
    Method,
    flatten_as_published,
    map_as_published,
    millions,
)
from benchmarks.photos.cases import Case
from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, rescale_points
from hybrid.learn.networks.tensors import map_batch
from hybrid.learn.networks.weights import parameter_count
from hybrid.learn.paper.baselines import Recovery, corrected, recover
from hybrid.learn.paper.dewarpnet import NODES, BackwardOutput, DewarpNet, DewarpNetConfig
from hybrid.learn.paper.firenet import FiReNet, FiReNetConfig, FiReNetOutput
from hybrid.learn.reading.views import whole_view

TIME_ONLY = "time only: random weights"
"""Why these methods are not scored."""


class Prompted(nn.Module):
    """Runs a network, then returns another answer in place of its output."""

    def __init__(self, network: Any, answer: Any) -> None:
        nn.Module.__init__(self)  # not the network's own: nothing is to be built
        self.network, self.answer, self.config = network, answer, network.config

    def forward(self, image: Tensor) -> Any:
        self.network(image)
        return self.answer


class PromptedFiReNet(Prompted, FiReNet):
    """FiReNet, for code that checks types."""


class PromptedDewarpNet(Prompted, DewarpNet):
    """DewarpNet, for code that checks types."""


@dataclass(frozen=True, eq=False)
class Prompt:
    """A photo, and the answer that a perfect network would give."""

    photo: UInt8[np.ndarray, "h w 3"]
    answer: Any


def true_squeezed_answer(case: Case) -> BackwardOutput:
    """The true map on DewarpNet's nodes, of a photo squeezed into the network's square, as released."""
    size = case.photo().shape[:2]
    return BackwardOutput(map_batch([rescale_points(_true_nodes(case, NODES), size, (1, 1)).astype(np.float32)]))


def true_dewarpnet_answer(case: Case) -> BackwardOutput:
    """The true map on DewarpNet's nodes, of the square around the photo."""
    return BackwardOutput(map_batch([_in_square(case, NODES)]))


def true_firenet_answer(case: Case, px: int) -> FiReNetOutput:
    """The true mask, uv map and deformation map at px x px of the square around the photo; the other maps are zero."""
    uv = case.backward.film_from_photo(whole_view(case.photo().shape[:2]).dense((px, px)))
    film = torch.from_numpy(np.isfinite(uv).all(axis=-1))[None]
    return FiReNetOutput(
        mask_logit=torch.where(film, 9.0, -9.0),
        xyz=torch.zeros(1, 3, px, px),
        uv=map_batch([np.nan_to_num(uv).astype(np.float32)]),
        albedo=torch.zeros(1, px, px),
        deformation=map_batch([_in_square(case, px) - film_nodes((px, px)).astype(np.float32)]),
    )


def _in_square(case: Case, n: int) -> np.ndarray:
    """The true map on n x n nodes, in units of the smallest square around the photo."""
    size = case.photo().shape[:2]
    return ((_true_nodes(case, n) - whole_view(size).nodes[0, 0]) / max(size)).astype(np.float32)


def _true_nodes(case: Case, n: int) -> np.ndarray:
    return case.backward.resized((n, n)).nodes


# ---------------------------------------------------------------- methods


def full_firenet(weights: Path | None) -> Method:
    """FiReNet with its recovery."""
    network = FiReNet(FiReNetConfig()).eval()
    return _timed(
        "firenet_full",
        "FiReNet",
        network,
        lambda prompt: recover(PromptedFiReNet(network, prompt.answer), prompt.photo),
        lambda case: true_firenet_answer(case, network.config.input_px),
    )


def full_dewarpnet(weights: Path | None) -> Method:
    """DewarpNet, given its due: its map read as it is meant, the photo as for every other method."""
    network = DewarpNet(DewarpNetConfig()).eval()
    return _timed(
        "dewarpnet_full",
        DEWARPNET_DUE,
        network,
        lambda prompt: corrected(PromptedDewarpNet(network, prompt.answer), prompt.photo),
        true_dewarpnet_answer,
    )


def full_dewarpnet_published(weights: Path | None) -> Method:
    """DewarpNet run as released."""
    network = DewarpNet(DewarpNetConfig()).eval()

    def answering(prompt: Prompt) -> DewarpNet:
        return PromptedDewarpNet(network, prompt.answer)

    return _timed(
        "dewarpnet_published_full",
        DEWARPNET_PUBLISHED,
        network,
        lambda prompt: map_as_published(answering(prompt), prompt.photo),
        true_squeezed_answer,
        lambda prompt: flatten_as_published(answering(prompt), prompt.photo),
    )


def _timed(
    name: str,
    label: str,
    network: DewarpNet | FiReNet,
    find: Callable[[Prompt], BackwardMap | Recovery | None],
    answer: Callable[[Case], Any],
    flatten: Callable[[Prompt], Flattened] | None = None,
) -> Method:
    """A method of which only the run time means anything."""
    return Method(
        name,
        find,
        lambda case: Prompt(case.photo(), answer(case)),
        flatten,
        parameters=parameter_count(network),
        label=f"{label}, full width ({millions(network)})",
        unscored=TIME_ONLY,
        steady=True,
    )


__all__ = [
    "TIME_ONLY",
    "full_dewarpnet",
    "full_dewarpnet_published",
    "full_firenet",
]
