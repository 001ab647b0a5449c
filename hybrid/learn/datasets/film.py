"""Training samples: a random view of a photo and the truth in the same view, with the colours disturbed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8

from hybrid.backward import MIN_NODES, BackwardMap, Orientation, film_as_seen, orientation_of
from hybrid.coords import film_centres, film_nodes
from hybrid.learn.datasets import behind, rounded
from hybrid.learn.datasets.colours import disturbed, taken_badly
from hybrid.learn.datasets.draws import log_uniform
from hybrid.learn.datasets.samples import Place, Truth, film_of, photo_of, round_corners_of, truth_at
from hybrid.learn.networks.filmnet import STRIDE
from hybrid.learn.networks.losses import Targets
from hybrid.learn.networks.tensors import image_batch, map_batch
from hybrid.learn.reading.views import (
    VIEW_NODES,
    film_view,
    output_points,
    plane_of,
    square_view,
    view_image,
    whole_view,
)


@dataclass(frozen=True)
class AugmentConfig:
    """How the view and the colours are varied.

    empty_share: share of views without a film, where the photo has room for one: many photos contain no film.
    whole_share: share of views that are windows of the photo, as in the first look. plane_share: share of views that
    flatten the film by a homography, as in the later looks; the rest use a bent map. zoom: of the windows. roll_deg,
    shift: one sigma of their rotation and shift (as a fraction of their side). margin: around a flattened film.
    plane_error, bend_error: range of the error, as a fraction of the film, of the maps that flatten films. Every view
    is turned by a random number of quarter turns and mirrored or not. colours: whether colours are disturbed, something
    is put behind some films, and some films get round corners.
    """

    empty_share: float = 0.04
    whole_share: float = 0.35
    plane_share: float = 0.55
    zoom: tuple[float, float] = (0.55, 1.25)
    roll_deg: float = 8.0
    shift: float = 0.03
    margin: tuple[float, float] = (0.04, 0.12)
    plane_error: tuple[float, float] = (0.006, 0.06)
    bend_error: tuple[float, float] = (0.002, 0.03)
    colours: bool = True


BEND_ERROR_NODES = 5
"""Nodes along each side of the smooth random error of a bent map."""
UNDISTURBED = AugmentConfig(empty_share=0.0, colours=False)
"""Views with which networks are tested."""
UNKNOWN_GRID = np.array([[0.0, 1.0, 1.0], [0.0, 1.0, 1.0]])
"""Placeholder where a film's cells are not known; it adds nothing to the loss."""
WHOLE_WEIGHT, FLATTENED_WEIGHT = 1.0, 4.0
"""Flattened views weigh more, since their smaller errors are what counts in the end."""


@dataclass(frozen=True, eq=False)
class View:
    """A training view: image (n, n, 3) uint8 and the truth at the pixel centres of the network's output.

    uv: film coordinates of the film as seen in the view. grid: of its cells, across and down: start of the first, pitch
    and number; None where unknown. orientation: index of the move that makes the film read right. weight: of the view
    in the loss. has_shape, has_print: whether xyz, normal and covered, and whether albedo, are known.
    """

    image: UInt8[np.ndarray, "n n 3"]
    mask: np.ndarray
    uv: np.ndarray
    xyz: np.ndarray
    albedo: np.ndarray
    normal: np.ndarray
    covered: np.ndarray
    grid: Float[np.ndarray, "2 3"] | None
    orientation: int
    weight: float
    has_shape: bool
    has_print: bool


def training_view(place: Place, px: int, rng: np.random.Generator, config: AugmentConfig | None) -> View:
    """A sample in a random view of ``px`` pixels; with no ``config``, the whole photo, undisturbed."""
    photo, film = photo_of(place), film_of(place)
    corners = None
    if config is not None and config.colours:
        photo = behind.behind_some(place, photo, film, rng)
        photo, corners = rounded.round_some(photo, film, round_corners_of(place), rng)
        photo = taken_badly(photo, rng)
    size = (photo.shape[0], photo.shape[1])
    view, weight = (whole_view(size), 1.0) if config is None else random_view(film, size, rng, config)
    image = view_image(photo, view, px)
    if config is not None and config.colours:
        image = disturbed(image, rng)
    truth = truth_at(place, output_points(view, px, STRIDE), size)
    if corners is not None:
        truth = truth.without(corners.cut(truth.uv))
    way, axes = orientation_in(truth), axes_of(view)
    return View(
        image,
        truth.mask,
        np.where(truth.mask[..., None], way.seen_from_film(truth.uv), np.float32(0)),
        turned_axes(truth.xyz, axes),
        truth.albedo,
        turned_axes(truth.normal, axes),
        truth.covered,
        None if truth.vertices is None else grid_along(way.seen_from_film(truth.vertices)),
        way.index,
        weight,
        truth.has_shape,
        truth.has_print,
    )


def batch_of(views: list[View]) -> tuple[torch.Tensor, Targets]:
    """Images (B, 3, n, n) float32 in [0, 1], channels last, and targets."""
    images = image_batch([v.image for v in views])
    names = ("mask", "uv", "xyz", "albedo", "normal", "covered")
    maps = {name: map_batch([getattr(v, name) for v in views]) for name in names}
    grids = np.stack([UNKNOWN_GRID if v.grid is None else v.grid for v in views])
    return images.contiguous(memory_format=torch.channels_last), Targets(
        **maps,
        grid=torch.from_numpy(grids).float(),
        orientation=torch.tensor([v.orientation for v in views]),
        weight=torch.tensor([v.weight for v in views]),
        has_shape=torch.tensor([float(v.has_shape) for v in views]),
        has_print=torch.tensor([float(v.has_print) for v in views]),
        has_grid=torch.tensor([float(v.grid is not None) for v in views]),
    )


# ---------------------------------------------------------------- geometry


def random_view(
    film: BackwardMap, size: tuple[int, int], rng: np.random.Generator, config: AugmentConfig
) -> tuple[BackwardMap, float]:
    """A view of a film in a photo of ``size`` (height, width), and its weight."""
    if rng.random() < config.empty_share and (view := _without_film(film, size, rng)) is not None:
        return _turned_anyhow(view, rng), WHOLE_WEIGHT
    kind = rng.random()
    if kind < config.whole_share:
        view = random_window(size, rng, config)
    else:
        seen = film_as_seen(film)
        if kind < config.whole_share + config.plane_share:
            seen = disturbed_map(plane_of(seen), 2, log_uniform(rng, config.plane_error), rng)
        else:
            seen = disturbed_map(seen, BEND_ERROR_NODES, log_uniform(rng, config.bend_error), rng)
        view = film_view(seen, rng.uniform(*config.margin))
    return _turned_anyhow(view, rng), WHOLE_WEIGHT if kind < config.whole_share else FLATTENED_WEIGHT


def _turned_anyhow(view: BackwardMap, rng: np.random.Generator) -> BackwardMap:
    """The view in a random one of its eight orientations."""
    return view.turned(Orientation(int(rng.integers(4)), bool(rng.random() < 0.5)))


def _without_film(film: BackwardMap, size: tuple[int, int], rng: np.random.Generator) -> BackwardMap | None:
    """A window of the photo that shows no film, or None if a few tries find none."""
    points = film.nodes.reshape(-1, 2)
    for _ in range(12):
        side = max(size) * rng.uniform(0.2, 0.5)
        corner = rng.uniform(0, 1, 2) * (np.array([size[1], size[0]]) - side)
        if not ((points > corner) & (points < corner + side)).all(axis=1).any():
            x, y = (corner + side / 2).tolist()
            return square_view((x, y), side)
    return None


def random_window(size: tuple[int, int], rng: np.random.Generator, config: AugmentConfig) -> BackwardMap:
    """A window of the photo, about as large as the photo."""
    side = max(size) / rng.uniform(*config.zoom)
    x, y = (np.array([size[1], size[0]]) / 2 + rng.normal(0, config.shift, 2) * side).tolist()
    return square_view((x, y), side, float(rng.normal(0, np.deg2rad(config.roll_deg))))


def disturbed_map(film: BackwardMap, nodes: int, error: float, rng: np.random.Generator) -> BackwardMap:
    """A film's map with a smooth random error: one sigma is ``error`` (fraction of the film) at ``nodes``^2 points."""
    at_nodes = rng.normal(0, error, (nodes, nodes, 2))
    if nodes < MIN_NODES:
        return corners_moved(film, at_nodes)
    lattice = film_nodes(VIEW_NODES)
    return BackwardMap(film.photo_from_film(lattice + BackwardMap(at_nodes).photo_from_film(lattice)))


def corners_moved(film: BackwardMap, by: Float[np.ndarray, "2 2 2"]) -> BackwardMap:
    """A film's map with its corners moved by offsets in film units, and all else by bilinear interpolation."""
    lattice = film_nodes(VIEW_NODES)
    u, v = lattice[..., :1], lattice[..., 1:]
    (a, b), (c, d) = by
    offset = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
    return BackwardMap(film.photo_from_film(lattice + offset))


def orientation_in(truth: Truth) -> Orientation:
    """How the film lies in a view, from its film coordinates there; upright if hardly any film is seen."""
    seen = truth.mask
    if seen.sum() < 8:
        return Orientation(0, False)
    ones = np.ones((int(seen.sum()), 1))
    at = film_centres((seen.shape[0], seen.shape[1]))[seen]
    slope = np.linalg.lstsq(np.hstack([at, ones]), truth.uv[seen], rcond=None)[0][:2].T
    if abs(np.linalg.det(slope)) < 1e-6:
        return Orientation(0, False)
    directions = np.linalg.inv(slope)
    return orientation_of(directions[:, 0], directions[:, 1])


def grid_along(vertices: Float[np.ndarray, "r c 2"]) -> Float[np.ndarray, "2 3"]:
    """Start of the first cell, pitch and number of cells along both axes, from the cell corners of an even grid."""
    low, high = vertices.min(axis=(0, 1)), vertices.max(axis=(0, 1))
    upright = np.ptp(vertices[0, :, 0]) > np.ptp(vertices[0, :, 1])
    cells = np.array(vertices.shape[1::-1] if upright else vertices.shape[:2]) - 1
    return np.stack([low, (high - low) / cells, cells], axis=1)


def axes_of(view: BackwardMap) -> Float[np.ndarray, "2 2"]:
    """The view's axes in the photo (columns), orthonormal: rotation and reflection of the view as a whole."""
    jacobian = view.jacobian(film_nodes((3, 3))[1, 1])
    left, _, right = np.linalg.svd(jacobian)
    return left @ right


def turned_axes(vectors: np.ndarray, axes: Float[np.ndarray, "2 2"]) -> np.ndarray:
    """Vectors (..., 3) in camera axes, expressed in the axes of a camera turned (and mirrored) with the view."""
    turned = vectors.copy()
    turned[..., :2] = vectors[..., :2] @ axes
    return turned
