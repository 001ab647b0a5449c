"""Which way a flat film reads right: the evidence of its writing, its slices and their order, combined with a prior."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor
from torch.nn import functional

from hybrid.backward import Orientation
from hybrid.errors import ConfigError, describe, require_at_least, require_at_most
from hybrid.learn.networks.slicenet import SliceNet, least_side, turn_logits
from hybrid.learn.networks.upright_patches import text_patches
from hybrid.learn.networks.uprightnet import WAYS, PatchVotes, UprightNet, joined
from hybrid.learn.reading.slice_order import order_chances

AT_ONCE = 16
"""Patches that are read before each check whether that was enough."""
TURNS_OF_WAYS = tuple(-way.turns % 4 if way.mirrored else way.turns for way in WAYS)
"""The turn that slices, mirrored or not, take in each way: mirroring comes first and swaps left and right quarters."""


@dataclass(frozen=True)
class OrientationReader:
    """The networks that see which way is up: one reads the writing, one looks at slices."""

    writing: UprightNet
    slices: SliceNet


@dataclass(frozen=True)
class UprightConfig:
    """When a film is turned or mirrored.

    turned, mirrored: shares of films that are photographed turned by quarter turns, and from behind. min_probability: a
    film is moved only if, given these shares, it is this probable that it then reads right, or that it does not as it
    lies. enough: reading stops once it is this probable that a film reads right as it lies; a film that is to be moved
    is read to the end. min_film_px: writing is not read on films whose longer side is less than this; min_slice_px:
    slices are not read where a cell's shorter side is less. turn: how far every film is turned clockwise, if not as it
    reads; mirror: whether it is mirrored left to right before that.
    """

    turned: float = 0.1
    mirrored: float = 0.02
    min_probability: float = 0.9
    enough: float = 0.995
    min_film_px: int = 400
    min_slice_px: int = 24
    turn: Literal["read", "0", "90", "180", "270"] = "read"
    mirror: bool = False

    def __post_init__(self) -> None:
        require_at_least(self, 1, "min_slice_px")
        require_at_least(self, 0, "turned", "mirrored", "min_probability", "enough")
        require_at_most(self, 1, "turned", "mirrored", "min_probability")
        if self.mirror and self.turn == "read":
            do = "Name the turn as well: 0, 90, 180 or 270."
            raise ConfigError(describe(what="UprightConfig.mirror", got="no turn beside it", do=do))

    @property
    def given(self) -> Orientation | None:
        """How every film is moved; None where each is moved as it reads."""
        return None if self.turn == "read" else Orientation(int(self.turn) // 90, self.mirror)

    @property
    def prior(self) -> Float[np.ndarray, " 8"]:
        """Probability of each of the eight ways before anything is read; turning and mirroring are independent."""
        turns = np.array([1 - self.turned, *[self.turned / 3] * 3])
        return np.concatenate([(1 - self.mirrored) * turns, self.mirrored * turns])


def orientation_chances(
    reader: OrientationReader, film: UInt8[np.ndarray, "h w 3"], vertices: Float[np.ndarray, "r c 2"] | None,
    config: UprightConfig,
) -> tuple[Float32[np.ndarray, " 8"] | None, str]:  # fmt: skip
    """Probabilities that a flat film (sRGB) has to be moved in each of the eight ways to read right, and what was read;
    None if everything is too small.

    Reading stops once the film surely reads right as it lies. vertices: film uv of the grid's corners, where one was
    found.
    """
    if vertices is not None and least_side(vertices, film.shape) < config.min_slice_px:
        vertices = None
    written = max(film.shape[:2]) >= config.min_film_px
    if vertices is None and not written:
        return None, ""
    chances, read = None, ""
    before = torch.from_numpy(config.prior).log().float()  # where a way cannot be: minus infinity
    for logits, of in _readings(reader, cv2.cvtColor(film, cv2.COLOR_RGB2GRAY), vertices, written):
        chances, read = functional.softmax(logits + before, dim=0).numpy(), of
        if chances[0] >= config.enough:
            break
    return chances, read


def _readings(
    reader: OrientationReader, grey: UInt8[np.ndarray, "h w"], vertices: Float[np.ndarray, "r c 2"] | None,
    written: bool,
) -> Iterator[tuple[Float[Tensor, " 8"], str]]:  # fmt: skip
    """Logits of the eight ways from more and more of the film, and what that is: the order of slices, where there is a
    grid; the patches with most writing, which usually are enough; what slices show; then the other patches, a few at a
    time."""
    by_writing = by_cells = torch.zeros(8, dtype=torch.float32, device="cpu")
    first_read = "writing"
    if vertices is not None:
        by_cells, first_read = torch.from_numpy(order_chances(grey, vertices)).log().float(), "writing, order of slices"
    parts: Sequence[Tensor] = ()
    if written:
        patches = torch.from_numpy(text_patches(grey, reader.writing.config.cut))
        parts = patches[patches.flatten(1).any(dim=1)].split(AT_ONCE)
    votes: list[PatchVotes] = []
    for part in parts[:1]:
        by_writing = _by_writing(reader.writing, part, votes)
        yield by_writing + by_cells, first_read
    if vertices is not None:
        by_cells = by_cells + turn_logits(reader.slices, grey, vertices)[list(TURNS_OF_WAYS)]
        yield by_writing + by_cells, "writing, slices" if written else "slices"
    for part in parts[1:]:
        by_writing = _by_writing(reader.writing, part, votes)
        yield by_writing + by_cells, "writing" if vertices is None else "writing, slices"


@torch.inference_mode()
def _by_writing(network: UprightNet, patches: Float32[Tensor, "n p p"], votes: list[PatchVotes]) -> Float[Tensor, " 8"]:
    """Logits of the eight ways from some more patches and the earlier ``votes``, to which theirs are appended."""
    votes.append(network(patches[None]))
    return joined(votes).films[0]


def upright_way(chances: Float32[np.ndarray, " 8"], config: UprightConfig) -> tuple[Orientation, str]:
    """How to move a film with these ``orientation_chances``, and why, in words."""
    best = WAYS[int(chances.argmax())]
    probability = float(chances[best.index])
    said = ", ".join([f"turned by {90 * best.turns} degrees"] * (best.turns > 0) + ["mirrored"] * best.mirrored)
    if best.index == 0:
        return best, f"left as it lies, which reads right: {probability:.1%} probable"
    if probability < config.min_probability and chances[0] > 1 - config.min_probability:
        return WAYS[0], f"left as it lies: {said} it would read right, but that is only {probability:.0%} probable"
    return best, f"{said} to read right: {probability:.1%} probable"
