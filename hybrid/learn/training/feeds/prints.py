"""Feeds of UprightNet and SliceNet: patches and slices of flat prints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from hybrid.learn.datasets.slices import SliceAugment, slice_view, sliced_prints
from hybrid.learn.datasets.upright import PrintAugment, print_paths, read_print, upright_view
from hybrid.learn.networks.slicenet import SliceNetConfig
from hybrid.learn.networks.uprightnet import UprightNetConfig
from hybrid.learn.training.feeds.feed import Feed, in_batches


def _open_all(those_of: Callable[[Path], list[Path]], folders: Sequence[Path]) -> list[Path]:
    return [path for folder in folders for path in those_of(folder)]


def print_feed(config: UprightNetConfig) -> Feed:
    """Patches of flat prints, for a network of this configuration."""
    return _votes_feed(print_paths, _print_view, config)


def slice_feed(config: SliceNetConfig) -> Feed:
    """Slices of flat prints, for a network of this configuration."""
    return _votes_feed(sliced_prints, _slice_view, config)


def _votes_feed(paths_of: Callable[[Path], list[Path]], view: Callable[..., np.ndarray], config: Any) -> Feed:
    """Views of flat prints, all upright; paths_of: the prints of a folder."""
    batch = partial(_votes_batch, view, config)
    return Feed(partial(_open_all, paths_of), batch, partial(_votes_test, batch))


def _print_view(path: Path, config: UprightNetConfig, rng: np.random.Generator) -> np.ndarray:
    return upright_view(read_print(path), config, rng, PrintAugment())


def _slice_view(path: Path, config: SliceNetConfig, rng: np.random.Generator) -> np.ndarray:
    return slice_view(path, config, rng, PrintAugment(), SliceAugment())


def _votes_batch(
    view: Callable[..., np.ndarray], config: Any, paths: Sequence[Path], px: int, rngs: Sequence[np.random.Generator]
) -> tuple[Tensor, Tensor]:
    cut = replace(config, input_px=px)
    views = [view(path, cut, rng) for path, rng in zip(paths, rngs, strict=True)]
    return torch.from_numpy(np.stack(views)), torch.zeros(len(views), dtype=torch.int64)


@torch.inference_mode()
def _votes_test(
    batch: Callable[..., tuple[Tensor, Tensor]], network: nn.Module, paths: Sequence[Path], px: int, device: str
) -> dict[str, float]:
    """Shares of films and of patches (or slices) that are read right, and the mean -log2 of the films' probabilities.

    Empty patches score alike in every orientation and are left out; a film with only such patches is not read right.
    """
    rng, films, patches = np.random.default_rng(0), [], []
    for part in in_batches(paths):
        output = network(batch(part, px, [rng] * len(part))[0].to(device))
        right = (output.films.argmax(dim=1) == 0) & output.written.any(dim=1)
        bits = -output.films.log_softmax(dim=1)[:, 0] / np.log(2)
        films.append(torch.stack([right.float(), bits], dim=1))
        patches.append((output.votes.argmax(dim=2) == 0)[output.written].float())
    film, bits = torch.cat(films).mean(dim=0).tolist()
    return {"test_upright": film, "test_patch": float(torch.cat(patches).mean()), "test_bits": bits}
