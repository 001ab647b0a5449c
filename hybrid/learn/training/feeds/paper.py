"""The feed of the paper's networks: windows of photos with all maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from hybrid.learn.datasets.film import UNDISTURBED, AugmentConfig
from hybrid.learn.datasets.samples import open_places
from hybrid.learn.networks.losses import masked_mean
from hybrid.learn.paper.targets import PaperTargets
from hybrid.learn.paper.views import PaperView, paper_batch
from hybrid.learn.training.feeds.feed import Feed, in_batches
from hybrid.learn.training.pictures import PICTURE_VIEWS, Picture, lines_of_backward, lines_of_uv, sample_sheet


def paper_feed(nodes: Callable[[int], int], inputs: Callable[[Tensor, Any], Tensor]) -> Feed:
    """Windows of photos with all maps. nodes, inputs: as in a Preset."""

    def batch(places: Sequence[Any], px: int, rngs: Sequence[np.random.Generator]) -> tuple[Tensor, PaperTargets]:
        return paper_batch(places, PaperView(px, nodes(px)), rngs, AugmentConfig())

    @torch.inference_mode()
    def test(network: nn.Module, places: Sequence[Any], px: int, device: str) -> dict[str, float]:
        """Mean distance from the true uv over the film (in % of the film) and from the true backward map (in % of the
        photo), where the network predicts them."""
        rng, rows, sizes = np.random.default_rng(0), [], []
        for part in in_batches(places):
            images, targets = paper_batch(part, PaperView(px, nodes(px)), [rng] * len(part), UNDISTURBED)
            output = network(inputs(images.to(device), targets.to(device)))
            rows.append(_paper_scores(output, targets))
            sizes.append(len(part))
        return {name: float(np.average([row[name] for row in rows], weights=sizes)) for name in rows[0]}

    @torch.inference_mode()
    def picture(network: nn.Module, places: Sequence[Any], px: int, device: str) -> Picture:
        view = PaperView(px, nodes(px))
        shown = places[:PICTURE_VIEWS]
        images, targets = paper_batch(shown, view, [np.random.default_rng(0)] * len(shown), UNDISTURBED)
        return _paper_picture(images, targets, network(inputs(images.to(device), targets.to(device))))

    return Feed(open_places, batch, test, picture)


def _paper_scores(output: Any, targets: PaperTargets) -> dict[str, float]:
    row: dict[str, float] = {}
    if getattr(output, "uv", None) is not None:
        error = (output.uv.cpu() - targets.uv).norm(dim=1)
        row["test_uv_percent"] = 100 * float(masked_mean(error, targets.mask))
    if getattr(output, "backward", None) is not None:
        row["test_backward_percent"] = 100 * float((output.backward.cpu() - targets.backward).norm(dim=1).mean())
    if getattr(output, "xyz", None) is not None:
        error = (output.xyz.cpu() - targets.xyz).norm(dim=1)
        row["test_xyz_percent"] = 100 * float(masked_mean(error, targets.mask))
    return row


def _paper_picture(images: Tensor, targets: PaperTargets, output: Any) -> Picture:
    """Lines of the predicted uv map, else of the backward map; only the true lines for a network with neither."""
    uv, backward = getattr(output, "uv", None), getattr(output, "backward", None)
    if uv is None and backward is not None:
        return sample_sheet(
            images, *([lines_of_backward(one) for one in maps] for maps in (targets.backward, backward))
        )
    logit = getattr(output, "mask_logit", None)
    masks = targets.mask if logit is None else logit > 0
    true = [lines_of_uv(*pair) for pair in zip(targets.uv, targets.mask, strict=True)]
    found = [[]] * len(images) if uv is None else [lines_of_uv(*pair) for pair in zip(uv, masks, strict=True)]
    return sample_sheet(images, true, found)
