"""SliceNet: looks at the slices of a flat film and tells which of the film's four sides is up.

Where writing is too small to be read (``hybrid.learn.networks.uprightnet``), anatomy still shows: spines and tables lie
below. Heads look alike from both sides, and some bodies nearly so, so slices are not used to tell whether a film is
mirrored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, UInt8
from torch import Tensor, nn

from hybrid.coords import film_centres
from hybrid.learn.networks.filmnet import ConvNorm
from hybrid.learn.networks.uprightnet import Mix, PatchVotes

LEAST_SPREAD = 6.0
"""Grey levels: spread in its disc below which a cell is taken for empty."""
WITHIN = 0.96
"""Diameter of the disc that is looked at, as a fraction of a cell's shorter side: text in the corners is left out, so
that the network does not learn the print's typography."""

UNLIKE = 0.002
"""Share of films that show what the network has not learnt, so that it may be wrong however sure it is."""
UPSIDE_DOWN = 0.02
"""Share of films whose slices are printed upside down: more than there are, for a film is not turned over lightly."""


@dataclass(frozen=True)
class SliceNetConfig:
    """widths: channels at 1/2, 1/4, 1/8 and 1/16 of a picture. input_px: side of the pictures. count: pictures of a
    film, at most."""

    widths: tuple[int, int, int, int] = (12, 24, 48, 80)
    input_px: int = 48
    count: int = 16


class SliceNet(nn.Module):
    """Scores how much a slice looks like one that is the right way up; each is scored in all four turns.

    It is trained on mirrored slices as well as on others.
    """

    def __init__(self, config: SliceNetConfig) -> None:
        super().__init__()
        self.config = config
        w2, w4, w8, w16 = config.widths
        self.stages = nn.Sequential(
            ConvNorm(1, w2, 5, 2), ConvNorm(w2, w4, 3, 2), Mix(w4), ConvNorm(w4, w8, 3, 2), Mix(w8),
            ConvNorm(w8, w16, 3, 2), Mix(w16),
        )  # fmt: skip
        self.score = nn.Linear(w16 * (config.input_px // 16) ** 2, 1)  # where a feature lies counts
        self.alike_logit = nn.Parameter(torch.tensor(0.0))

    def forward(self, pictures: Float[Tensor, "b n p p"]) -> PatchVotes:
        """Votes, for 0 to 3 quarter turns clockwise, of the slices of some films (``slice_pictures``)."""
        held = torch.stack([torch.rot90(pictures, -turns, (-2, -1)) for turns in range(4)], dim=2)
        scores = self.score(self.stages(held.flatten(0, 2)[:, None]).flatten(1)).float()
        votes = scores.view(held.shape[:3]).log_softmax(dim=2)
        return PatchVotes(votes, pictures.flatten(2).any(dim=2), self.alike_logit.sigmoid())


# ---------------------------------------------------------------- pictures


def slice_pictures(
    film: UInt8[np.ndarray, "h w"], vertices: Float[np.ndarray, "r c 2"], config: SliceNetConfig
) -> Float32[np.ndarray, "n p p"]:
    """Pictures of at most ``config.count`` cells of a flat film (sRGB grey), spread over it, without the empty ones.

    vertices: film uv of the grid's corners.
    """
    shown = standardised(cell_pictures(film, vertices, config.input_px))
    shown = shown[shown.any(axis=(1, 2))]
    return shown[np.linspace(0, len(shown) - 1, min(len(shown), config.count)).round().astype(int)]


def cell_pictures(
    film: UInt8[np.ndarray, "h w"], vertices: Float[np.ndarray, "r c 2"], px: int
) -> UInt8[np.ndarray, "n p p"]:
    """The squares of ``cell_squares``, row by row, each resized to ``px`` pixels."""
    return np.stack([_inner(film, *square, px) for square in cell_squares(vertices, film.shape)])


def cell_squares(
    vertices: Float[np.ndarray, "r c 2"], shape: Sequence[int]
) -> list[tuple[Float[np.ndarray, " 2"], float]]:
    """Middle (x, y) and side, in pixels of a film of this shape, of the largest upright square within each cell."""
    corners = np.clip(vertices, 0.0, 1.0) * np.array(shape[1::-1])
    low, high = corners[:-1, :-1].reshape(-1, 2), corners[1:, 1:].reshape(-1, 2)
    return [((a + b) / 2, float((b - a).min())) for a, b in zip(low, high, strict=True)]


def least_side(vertices: Float[np.ndarray, "r c 2"], shape: Sequence[int]) -> float:
    """The side of the smallest of these squares."""
    return min(side for _, side in cell_squares(vertices, shape))


def _inner(
    film: UInt8[np.ndarray, "h w"], middle: Float[np.ndarray, " 2"], side: float, px: int
) -> UInt8[np.ndarray, "p p"]:
    """The square, resized to ``px`` pixels."""
    near = [slice(max(round(at - side / 2), 0), max(round(at + side / 2), round(at - side / 2) + 2)) for at in middle]
    part = film[near[1], near[0]]
    shrinks = min(part.shape) >= px
    return cv2.resize(part, (px, px), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)


def standardised(pictures: UInt8[np.ndarray, "n p p"]) -> Float32[np.ndarray, "n p p"]:
    """Greys within the disc minus their mean, over their spread, clipped to +-4; 0 outside and in empty cells."""
    inside = disc(pictures.shape[-1])
    grey = pictures[:, inside].astype(np.float32)
    grey -= grey.mean(axis=1, keepdims=True)
    spread = grey.std(axis=1, keepdims=True)
    shown = np.zeros(pictures.shape, np.float32)
    shown[:, inside] = np.where(spread < LEAST_SPREAD, 0, np.clip(grey / np.maximum(spread, 1e-3), -4, 4))
    return shown


def disc(px: int) -> Bool[np.ndarray, "p p"]:
    """Which pixels of a square are looked at."""
    return np.linalg.norm(film_centres((px, px)) - 0.5, axis=-1) < WITHIN / 2


# ---------------------------------------------------------------- in use


def turn_logits(network: SliceNet, film: UInt8[np.ndarray, "h w"], vertices: Float[np.ndarray, "r c 2"]) -> Tensor:
    """How likely a flat film with this grid has to be turned by 0 to 3 quarters clockwise: (4,) logits, all equal if
    all cells are empty."""
    pictures = slice_pictures(film, vertices, network.config)
    if not len(pictures):
        return torch.zeros(4, dtype=torch.float32, device="cpu")
    with torch.inference_mode():
        chances = network(torch.from_numpy(pictures)[None]).films[0].softmax(dim=0)
    chances = (1 - UPSIDE_DOWN) * chances + UPSIDE_DOWN * chances.roll(2)
    return torch.log((1 - UNLIKE) * chances + UNLIKE / 4)


__all__ = [
    "SliceNet",
    "SliceNetConfig",
    "cell_pictures",
    "cell_squares",
    "disc",
    "least_side",
    "slice_pictures",
    "standardised",
    "turn_logits",
]
