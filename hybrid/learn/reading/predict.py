"""FilmNet applied to a photo: maps of what each view of it shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import UInt8

from hybrid.backward import BackwardMap, Orientation
from hybrid.errors import require_at_least, require_at_most
from hybrid.learn.networks.filmnet import STRIDE, FilmNet
from hybrid.learn.reading.views import output_points, view_image
from hybrid.records import CoarseMaps


@dataclass(frozen=True)
class PredictConfig:
    """How the network looks at a photo: first at the whole, then repeatedly at the film as last flattened."""

    looks: int = 4
    """Number of looks at most, including the first."""
    settled: float = 0.01
    """A look that moves the film by less than this, on average and as a fraction of its size, is the last."""
    margin: float = 0.07
    """Around the film (fraction of the view) in the looks at the film alone."""
    sides: tuple[int, ...] = (0, 2, 5, 7)
    """Orientations in which the last look shows the film (indices of Orientation): all looks use the first, the others
    count where refinement also starts from them (pipeline/starts.py). The mean over all is slightly nearer to the
    truth; after refinement that no longer shows."""
    least_px: int = 400
    """Large photos are reduced by powers of two to a longer side between this and twice this: several times what the
    network reads of them."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "looks", "least_px")
        require_at_least(self, 0, "sides", "margin")
        require_at_most(self, 7, "sides")
        require_at_most(self, 0.4, "margin")


def look(network: FilmNet, photo: UInt8[np.ndarray, "H W 3"], views: Sequence[BackwardMap]) -> list[CoarseMaps]:
    """The network's maps of what each view of the photo shows, in one pass. uv is of the film as seen."""
    n = network.config.input_px
    images = torch.from_numpy(np.stack([view_image(photo, view, n) for view in views])).permute(0, 3, 1, 2)
    with torch.inference_mode():
        output = network(images.float().div_(255).contiguous(memory_format=torch.channels_last))
        logits = (output.mask_logit, output.grid_logit, output.covered_logit)
        mask, in_grid, covered = (torch.sigmoid(logit).numpy() for logit in logits)
    uv, xyz = (maps.permute(0, 2, 3, 1).numpy() for maps in (output.uv, output.xyz))
    phases = output.phases.permute(0, 3, 4, 1, 2).numpy()
    albedo, error = output.albedo.clamp(0, 1).numpy(), torch.exp(output.log_scale).numpy()
    points = [output_points(view, n, STRIDE) for view in views]
    columns = (mask, uv, xyz, albedo, points, error, phases, in_grid, covered)
    return [CoarseMaps(*maps) for maps in zip(*columns, strict=True)]


def look_from_sides(
    network: FilmNet, photo: UInt8[np.ndarray, "H W 3"], view: BackwardMap, sides: Sequence[int]
) -> list[CoarseMaps]:
    """The maps of one view that the network sees turned and mirrored in several ways; film coordinates as in the
    view."""
    ways = [Orientation.from_index(side) for side in sides]
    looks = look(network, photo, [view.turned(way) for way in ways])
    return [as_in_view(maps, way) for maps, way in zip(looks, ways, strict=True)]


def as_in_view(maps: CoarseMaps, way: Orientation) -> CoarseMaps:
    """Maps of a turned view, with film coordinates as if it had not been turned.

    Where cells are counted from the other end, phases run backwards: a grid has a whole number of cells.
    """
    assert maps.phases is not None  # FilmNet predicts them
    moved = way.seen_from_film(np.eye(2)) - way.seen_from_film(np.zeros(2))  # where u and v go
    swapped, reverse = bool(moved[0, 1] != 0), moved.sum(axis=0) < 0
    phases = maps.phases[..., ::-1, :] if swapped else maps.phases
    return replace(
        maps, uv=way.seen_from_film(maps.uv), phases=phases * np.stack([[1, 1], np.where(reverse, -1, 1)], 1)
    )
