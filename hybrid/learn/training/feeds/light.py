"""LightNet's feed: films that are flat already, as a photo shows them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from hybrid.learn.datasets.light import (
    UNDISTURBED,
    LightAugment,
    LitPlace,
    light_batch,
    light_view,
    open_lit_films,
    split_films,
)
from hybrid.learn.networks.lightnet import LightTargets, displayed_contrast, film_error, light_losses
from hybrid.learn.training.feeds.feed import Feed, in_batches
from hybrid.levels import LEAST_CONTRAST


def _light_views(
    places: Sequence[LitPlace], px: int, rngs: Sequence[np.random.Generator], augment: LightAugment
) -> tuple[Tensor, LightTargets]:
    return light_batch([light_view(place, px, rng, augment) for place, rng in zip(places, rngs, strict=True)])


def _light_batch(places: Sequence[Any], px: int, rngs: Sequence[np.random.Generator]) -> tuple[Tensor, LightTargets]:
    return _light_views(places, px, rngs, LightAugment())


@torch.inference_mode()
def _light_test(network: nn.Module, places: Sequence[Any], px: int, device: str) -> dict[str, float]:
    """Terms of the loss, mean dB of the recovered films after one gain and offset, and the intersection over union of
    the pixels lost to glare."""
    rows, sizes, decibels, overlaps = [], [], [], []
    for part in in_batches(places):
        rngs = [np.random.default_rng(k) for k in range(len(part))]
        images, truth = _light_views(part, px, rngs, UNDISTURBED)
        output, truth = network(images.to(device)), truth.to(device)
        terms = light_losses(output, truth)
        error, enough = film_error(output, truth)
        decibels.append((-10 * error.clamp(min=1e-10).log10())[enough > 0].cpu())
        found, lost = (contrast < LEAST_CONTRAST for contrast in (displayed_contrast(output), truth.contrast))
        overlaps.append([int((found & lost).sum()), int((found | lost).sum())])
        rows.append([float(terms["black"]), float(terms["gain"])])
        sizes.append(len(part))
    black, gain = np.average(rows, axis=0, weights=sizes).tolist()
    both, either = np.sum(overlaps, axis=0).tolist()
    return {
        "test_black": black,
        "test_gain": gain,
        "test_decibels": float(torch.cat(decibels).mean()),
        "test_glare": both / max(either, 1),
    }


LIGHT_FEED = Feed(open_lit_films, _light_batch, _light_test, split=split_films)
