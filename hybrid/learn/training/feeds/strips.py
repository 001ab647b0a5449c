"""Feeds of EdgeNet and BorderNet: strips across the edges of films, and across the borders between cells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from hybrid.learn.datasets.borders import BorderAugment, border_view, open_borders
from hybrid.learn.datasets.edges import EdgeAugment, EdgePlace, edge_view, open_edges
from hybrid.learn.networks.edgenet import EdgeNetConfig, EdgeTargets, strips_tensor
from hybrid.learn.training.feeds.feed import Feed, in_batches


def edge_feed(config: EdgeNetConfig) -> Feed:
    """Strips across the edges of films, for a network of this configuration; four of each sample."""
    known, as_it_is = (partial(edge_view, augment=EdgeAugment(colours=colours)) for colours in (True, False))
    return Feed(open_edges, partial(_strip_batch, known, config), partial(_strip_test, as_it_is, config))


def border_feed(config: EdgeNetConfig) -> Feed:
    """Strips across the borders between cells of films, for a network of this configuration; four of each sample."""
    known, as_it_is = (partial(border_view, augment=BorderAugment(colours=colours)) for colours in (True, False))
    return Feed(open_borders, partial(_strip_batch, known, config), partial(_strip_test, as_it_is, config))


def _strip_batch(
    view: Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]],
    config: EdgeNetConfig,
    places: Sequence[EdgePlace],
    px: int,
    rngs: Sequence[np.random.Generator],
) -> tuple[Tensor, EdgeTargets]:
    strip, pairs = replace(config, input_px=px).strip, zip(places, rngs, strict=True)
    images, inside, rows = zip(*(view(place, strip, rng) for place, rng in pairs), strict=True)
    truth = torch.from_numpy(np.concatenate(rows)).float()
    return strips_tensor(np.concatenate(images), np.concatenate(inside)), EdgeTargets(truth)


@torch.inference_mode()
def _strip_test(
    view: Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]],
    config: EdgeNetConfig,
    network: nn.Module,
    places: Sequence[Any],
    px: int,
    device: str,
) -> dict[str, float]:
    """Of the columns that show the line: mean distance of the likeliest row (in % of the film if strips reach as far as
    those across edges do), and the share that is off by more than three rows; of all columns, the share correctly
    classified as showing the line or not."""
    rng, off, right = np.random.default_rng(0), [], []
    for part in in_batches(places):
        strips, truth = _strip_batch(view, config, part, px, [rng] * len(part))
        logits = network(strips.to(device)).float().cpu()
        shown = ~truth.row.isnan()
        off.append((logits[:, :-1].argmax(dim=1) - truth.row).abs()[shown])
        right.append(((logits.softmax(dim=1)[:, -1] < 0.5) == shown).flatten())
    rows, per_row = torch.cat(off), 100 * 2 * config.strip.reach / px
    return {
        "test_percent": per_row * float(rows.mean()),
        "test_wrong": float((rows > 3).float().mean()),
        "test_shown": float(torch.cat(right).float().mean()),
    }
