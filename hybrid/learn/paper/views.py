"""Training views of the paper's networks: windows of the photo, with the film's maps and its backward map.

As for FilmNet, coordinates are of the film as seen (``hybrid.backward.Orientation``): a film that lies on its side, or
is seen from behind, would otherwise ask these networks for what they cannot read at their resolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from torch import Tensor

from hybrid.backward import BackwardMap, film_as_seen, orientation
from hybrid.errors import DataError, describe
from hybrid.learn.datasets.colours import disturbed
from hybrid.learn.datasets.film import AugmentConfig, axes_of, random_window, turned_axes
from hybrid.learn.datasets.samples import Place, film_of, photo_of, truth_at
from hybrid.learn.networks.tensors import image_batch, map_batch
from hybrid.learn.paper.targets import PaperTargets
from hybrid.learn.reading.views import view_image


@dataclass(frozen=True)
class PaperView:
    """What a network sees: image and maps of ``px`` pixels a side, and the backward map on nodes x nodes (0: none)."""

    px: int
    nodes: int


def paper_batch(
    places: Sequence[Place], view: PaperView, rngs: Sequence[np.random.Generator], config: AugmentConfig
) -> tuple[Tensor, PaperTargets]:
    """Images (B, 3, px, px) float32 in [0, 1] and targets of random windows of some samples, one of each."""
    seen = [_sample(place, view, rng, config) for place, rng in zip(places, rngs, strict=True)]
    images = image_batch([image for image, _ in seen])
    names = ("mask", "uv", "xyz", "normal", "albedo", "backward")
    return images.contiguous(), PaperTargets(**{name: map_batch([maps[name] for _, maps in seen]) for name in names})


def _sample(
    place: Place, view: PaperView, rng: np.random.Generator, config: AugmentConfig
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """One window's image and maps."""
    photo, film = photo_of(place), film_of(place)
    size = (photo.shape[0], photo.shape[1])
    window = random_window(size, rng, config)
    image = view_image(photo, window, view.px)
    if config.colours:
        image = disturbed(image, rng)
    truth = truth_at(place, window.dense((view.px, view.px)), size)
    if not (truth.has_shape and truth.has_print):
        do = "Train FilmNet on these, or this network on data made by python -m data_gen.generate."
        raise DataError(describe(what="sample", where=place[0].path, got="no xyz, normal or albedo", do=do))
    way, axes = orientation(film), axes_of(window)
    return image, {
        "mask": truth.mask,
        "uv": np.where(truth.mask[..., None], way.seen_from_film(truth.uv), np.float32(0)),
        "xyz": turned_axes(truth.xyz, axes).astype(np.float32),
        "normal": turned_axes(truth.normal, axes).astype(np.float32),
        "albedo": truth.albedo,
        "backward": backward_in_window(film_as_seen(film), window, max(view.nodes, 4)),
    }


def backward_in_window(film: BackwardMap, window: BackwardMap, nodes: int) -> Float[np.ndarray, "n n 2"]:
    """A film's backward map as a window (a similarity) sees it: n x n nodes, in units of the window's sides."""
    corner, right, down = window.photo_from_film(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    axes = np.column_stack([right - corner, down - corner])
    return ((film.lattice((nodes, nodes)) - corner) @ np.linalg.inv(axes).T).astype(np.float32)
