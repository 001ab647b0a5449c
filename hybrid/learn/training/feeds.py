"""Feeds: where a network's batches come from, how it is tested and how its output is drawn.

Batches are pure functions of places and a seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from hybrid.learn.datasets.borders import BorderAugment, border_view, open_borders
from hybrid.learn.datasets.edges import EdgeAugment, EdgePlace, edge_view, open_edges
from hybrid.learn.datasets.film import AugmentConfig, batch_of, training_view
from hybrid.learn.datasets.light import (
    UNDISTURBED,
    LightAugment,
    LitPlace,
    light_batch,
    light_view,
    open_lit_films,
    split_films,
)
from hybrid.learn.datasets.samples import open_places
from hybrid.learn.datasets.slices import SliceAugment, slice_view, sliced_prints
from hybrid.learn.datasets.upright import PrintAugment, print_paths, read_print, upright_view
from hybrid.learn.networks.edgenet import EdgeNetConfig, EdgeTargets, strips_tensor
from hybrid.learn.networks.lightnet import LightTargets, displayed_contrast, film_error, light_losses
from hybrid.learn.networks.losses import Targets, masked_mean
from hybrid.learn.networks.slicenet import SliceNetConfig
from hybrid.learn.networks.uprightnet import UprightNetConfig
from hybrid.learn.paper.targets import PaperTargets
from hybrid.learn.paper.views import PaperView, paper_batch
from hybrid.learn.training.pictures import PICTURE_VIEWS, Picture, lines_of_backward, lines_of_uv, sample_sheet
from hybrid.levels import LEAST_CONTRAST

TEST_BATCH = 32
_UNDISTURBED = replace(AugmentConfig(), empty_share=0.0, colours=False)


def _first_of(places: Sequence[Any], held_out: int) -> tuple[list[Any], list[Any]]:
    return list(places[:held_out]), list(places[held_out:])


@dataclass(frozen=True)
class Feed:
    """Data for one kind of network.

    open: the places (samples, or prints) of some folders. split: into places for testing, at least a given number, and
    places for training; photos of one film are adjacent, so both share at most the film at the cut. batch: images and
    targets of some places at an input size in pixels, each disturbed by its own random numbers. test: figures of a
    network on held-out places, by name. picture: drawing of the network's output on some of these places; None where
    there is nothing to draw.
    """

    open: Callable[[Sequence[Path]], list[Any]]
    batch: Callable[[Sequence[Any], int, Sequence[np.random.Generator]], tuple[Tensor, Any]]
    test: Callable[[nn.Module, Sequence[Any], int, str], dict[str, float]]
    picture: Callable[[nn.Module, Sequence[Any], int, str], Picture] | None = None
    split: Callable[[Sequence[Any], int], tuple[list[Any], list[Any]]] = _first_of


def _test_batches(places: Sequence[Any]) -> list[Sequence[Any]]:
    """The places in groups that are tested together."""
    return [places[start : start + TEST_BATCH] for start in range(0, len(places), TEST_BATCH)]


# ---------------------------------------------------------------- FilmNet


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
        augment = replace(_UNDISTURBED, whole_share=whole, plane_share=plane)
        rng = np.random.default_rng(0)
        scores = []
        for part in _test_batches(places):
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
        views.append(training_view(place, px, rng, replace(_UNDISTURBED, whole_share=whole, plane_share=0.0)))
    images, targets = batch_of(views)
    output = network(images.to(device))
    true = [lines_of_uv(*pair) for pair in zip(targets.uv, targets.mask, strict=True)]
    return sample_sheet(images, true, [lines_of_uv(*p) for p in zip(output.uv, output.mask_logit > 0, strict=True)])


FILM_FEED = Feed(open_places, _film_batch, _film_test, _film_picture)


# ---------------------------------------------------------------- the paper's networks


def paper_feed(nodes: Callable[[int], int], inputs: Callable[[Tensor, Any], Tensor]) -> Feed:
    """Windows of photos with all maps. nodes, inputs: as in a Preset."""

    def batch(places: Sequence[Any], px: int, rngs: Sequence[np.random.Generator]) -> tuple[Tensor, PaperTargets]:
        return paper_batch(places, PaperView(px, nodes(px)), rngs, AugmentConfig())

    @torch.inference_mode()
    def test(network: nn.Module, places: Sequence[Any], px: int, device: str) -> dict[str, float]:
        """Mean distance from the true uv over the film (in % of the film) and from the true backward map (in % of the
        photo), where the network predicts them."""
        rng, rows, sizes = np.random.default_rng(0), [], []
        for part in _test_batches(places):
            images, targets = paper_batch(part, PaperView(px, nodes(px)), [rng] * len(part), _UNDISTURBED)
            output = network(inputs(images.to(device), targets.to(device)))
            rows.append(_paper_scores(output, targets))
            sizes.append(len(part))
        return {name: float(np.average([row[name] for row in rows], weights=sizes)) for name in rows[0]}

    @torch.inference_mode()
    def picture(network: nn.Module, places: Sequence[Any], px: int, device: str) -> Picture:
        view = PaperView(px, nodes(px))
        shown = places[:PICTURE_VIEWS]
        images, targets = paper_batch(shown, view, [np.random.default_rng(0)] * len(shown), _UNDISTURBED)
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


# ---------------------------------------------------------------- UprightNet, SliceNet


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
    for part in _test_batches(paths):
        output = network(batch(part, px, [rng] * len(part))[0].to(device))
        right = (output.films.argmax(dim=1) == 0) & output.written.any(dim=1)
        bits = -output.films.log_softmax(dim=1)[:, 0] / np.log(2)
        films.append(torch.stack([right.float(), bits], dim=1))
        patches.append((output.votes.argmax(dim=2) == 0)[output.written].float())
    film, bits = torch.cat(films).mean(dim=0).tolist()
    return {"test_upright": film, "test_patch": float(torch.cat(patches).mean()), "test_bits": bits}


# ---------------------------------------------------------------- EdgeNet, BorderNet


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
    for part in _test_batches(places):
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


# ---------------------------------------------------------------- LightNet


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
    for part in _test_batches(places):
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
