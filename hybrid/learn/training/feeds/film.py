"""FilmNet's feed: photos, windows of photos, films flattened by coarse maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from hybrid.learn.datasets.film import UNDISTURBED, AugmentConfig, batch_of, training_view
from hybrid.learn.datasets.samples import open_places
from hybrid.learn.networks.losses import Targets
from hybrid.learn.training.feeds.feed import Feed, in_batches
from hybrid.learn.training.pictures import PICTURE_VIEWS, Picture, lines_of_uv, sample_sheet


def _film_batch(places: Sequence[Any], px: int, rngs: Sequence[np.random.Generator]) -> tuple[Tensor, Targets]:
    pairs = zip(places, rngs, strict=True)
    return batch_of([training_view(place, px, rng, AugmentConfig()) for place, rng in pairs])


@torch.inference_mode()
def _film_test(network: nn.Module, places: Sequence[Any], px: int, device: str) -> dict[str, float]:
    """Errors of views of each kind: mean |uv error| in % of the film; for windows, the mask's intersection over union
    and the share of films whose orientation is right; for films flattened by a plane, the intersection over union of
    the covered pixels, over all views together."""
    kinds = {"whole": (1.0, 0.0), "plane": (0.0, 1.0), "bent": (0.0, 0.0)}
    row: dict[str, float] = {}
    for kind, (whole, plane) in kinds.items():
        augment = replace(UNDISTURBED, whole_share=whole, plane_share=plane)
        rng = np.random.default_rng(0)
        scores = []
        for part in in_batches(places):
            views = [training_view(place, px, rng, augment) for place in part]
            scores.append(_film_scores(network, *batch_of(views), device))
        error, overlap, upright, both, either = np.concatenate(scores).mean(axis=0)
        row[f"test_{kind}_percent"] = 100 * float(error)
        if kind == "plane":
            row["test_covered_iou"] = float(both / either) if either else 1.0
        if kind == "whole":
            row |= {"test_mask_iou": float(overlap), "test_upright": float(upright)}
    return row


def _film_scores(network: nn.Module, images: Tensor, targets: Targets, device: str) -> np.ndarray:
    """(B, 5): mean distance of uv, intersection over union of the mask, 1 where the orientation is right; number of
    pixels that are covered in both prediction and truth, and number in either."""
    output = network(images.to(device))
    uv, logit, guess = output.uv.cpu(), output.mask_logit.cpu(), output.orientation.cpu().argmax(dim=1)
    inside = targets.mask.float()
    error = ((uv - targets.uv).norm(dim=1) * inside).sum(dim=(1, 2)) / inside.sum(dim=(1, 2)).clamp(min=1)
    both, either = (logit > 0) & targets.mask, (logit > 0) | targets.mask
    overlap = both.sum(dim=(1, 2)) / either.sum(dim=(1, 2)).clamp(min=1)
    sheet, said = targets.mask | targets.covered, output.covered_logit.cpu() > 0
    counts = ((said & targets.covered).sum(dim=(1, 2)), ((said & sheet) | targets.covered).sum(dim=(1, 2)))
    return torch.stack([error, overlap, (guess == targets.orientation).float(), *counts], dim=1).numpy()


@torch.inference_mode()
def _film_picture(network: nn.Module, places: Sequence[Any], px: int, device: str) -> Picture:
    """Whole photos, then films flattened by a bent map, each with the lines of its uv map."""
    rng, views = np.random.default_rng(0), []
    for k, place in enumerate(places[:PICTURE_VIEWS]):
        whole = 1.0 if k < PICTURE_VIEWS // 2 else 0.0
        views.append(training_view(place, px, rng, replace(UNDISTURBED, whole_share=whole, plane_share=0.0)))
    images, targets = batch_of(views)
    output = network(images.to(device))
    true = [lines_of_uv(*pair) for pair in zip(targets.uv, targets.mask, strict=True)]
    return sample_sheet(images, true, [lines_of_uv(*p) for p in zip(output.uv, output.mask_logit > 0, strict=True)])


FILM_FEED = Feed(open_places, _film_batch, _film_test, _film_picture)
