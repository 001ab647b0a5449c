"""A film whose every map is known in closed form, for the paper's networks: a flat sheet, tilted, seen from afar."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from hybrid.coords import film_centres, film_nodes
from hybrid.learn.paper.targets import PaperTargets
from hybrid.learn.training.presets import weighted_sum

CORNER = np.array([0.14, 0.11])
PHOTO_PER_FILM = np.array([[0.68, -0.07], [0.09, 0.72]])
"""photo = CORNER + PHOTO_PER_FILM @ uv, in units of the photo's sides: the film fills about half of the photo."""


def photo_from_film(uv: np.ndarray) -> np.ndarray:
    """(..., 2) film uv -> (..., 2) photo points in units of the photo's sides."""
    return CORNER + uv @ PHOTO_PER_FILM.T


def film_from_photo(xy: np.ndarray) -> np.ndarray:
    """The inverse, also off the film."""
    return (xy - CORNER) @ np.linalg.inv(PHOTO_PER_FILM).T


def flat_case(px: int, nodes: int, batch: int = 2) -> tuple[Tensor, PaperTargets]:
    """Photos (batch, 3, px, px) and their truth; each film of the batch has a different print."""
    uv = film_from_photo(film_centres((px, px)))
    mask = ((uv > 0) & (uv < 1)).all(axis=-1)
    tilt = np.array([[0.55, 0.0, 0.25], [0.0, 0.7, -0.1]])  # film axes in camera coordinates, in diagonals
    xyz = (uv - 0.5) @ tilt
    normal = np.broadcast_to(np.cross(tilt[0], tilt[1]) / np.linalg.norm(np.cross(tilt[0], tilt[1])), xyz.shape)
    rng = np.random.default_rng(5)
    prints = rng.uniform(0.2, 1.0, (batch, 4, 4))
    cell = np.clip((uv * 4).astype(int), 0, 3)
    albedo = np.where(mask, prints[:, cell[..., 1], cell[..., 0]], 0.0)
    grey = np.where(mask, 0.2 + 0.6 * albedo, 0.05)
    tint = np.where(mask[..., None], uv[..., [0]] * [0.1, 0.0, -0.1], 0.0)
    photo = (grey[..., None] + tint).clip(0, 1)

    def maps(values: np.ndarray) -> Tensor:
        """(h, w, c), zero off the film, repeated over the batch."""
        kept = torch.from_numpy(np.where(mask[..., None], values, 0.0)).float().permute(2, 0, 1)
        return kept.expand(batch, -1, -1, -1).clone()

    backward = torch.from_numpy(photo_from_film(film_nodes((nodes, nodes)))).float().permute(2, 0, 1)
    return torch.from_numpy(photo).float().permute(0, 3, 1, 2).contiguous(), PaperTargets(
        mask=torch.from_numpy(mask).expand(batch, -1, -1).clone(),
        uv=maps(uv),
        xyz=maps(xyz),
        normal=maps(normal),
        albedo=torch.from_numpy(albedo).float(),
        backward=backward.expand(batch, -1, -1, -1).clone(),
    )


def assert_a_few_steps_lower_the_loss(
    network: nn.Module, losses: Callable[[Any, Any], dict[str, Tensor]], inputs: Tensor, targets: PaperTargets
) -> None:
    """The network learns the case, and every parameter gets a gradient."""
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    values = []
    for _ in range(8):
        loss = weighted_sum(losses(network(inputs), targets), {})
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        values.append(float(loss.detach()))
    assert all(p.grad is not None for p in network.parameters())
    assert values[-1] < 0.9 * values[0]
