"""The truth that the paper's networks are trained on: FilmNet's, normals and the backward map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes


@dataclass(frozen=True, eq=False)
class PaperTargets:
    """Truth at a network's output resolution; 0 where the mask is False.

    uv: film coordinates in [0, 1], v down. xyz: camera axes, relative to the film's centre, in film diagonals.
    normal: unit vectors in camera axes. albedo: display grey of the print. backward: photo points on n x n nodes of
    the film, in units of the photo's sides; true everywhere, also where the film leaves the photo or hides itself.
    """

    mask: Bool[Tensor, "b h w"]
    uv: Float[Tensor, "b 2 h w"]
    xyz: Float[Tensor, "b 3 h w"]
    normal: Float[Tensor, "b 3 h w"]
    albedo: Float[Tensor, "b h w"]
    backward: Float[Tensor, "b 2 n n"]

    @property
    def depth(self) -> Float[Tensor, "b h w"]:
        """Depth along the optical axis relative to the film's centre, in film diagonals.

        With 3D coordinates in the camera's axes it is the third of them; the paper's are in the world's.
        """
        return self.xyz[:, 2]

    @property
    def deformation(self) -> Float[Tensor, "b 2 n n"]:
        """The backward map less the node itself: how far each film point has moved, in units of the photo's sides."""
        return self.backward - nodes_like(self.backward)


def nodes_like(backward: Float[Tensor, "b 2 n m"]) -> Float[Tensor, "2 n m"]:
    """The film's nodes (u, v) as a tensor of a backward map's type, device and resolution."""
    nodes = torch.from_numpy(film_nodes((backward.shape[-2], backward.shape[-1])))
    return nodes.permute(2, 0, 1).to(backward)


# ---------------------------------------------------------------- from a shard


def backward_in_view(
    nodes: Float[np.ndarray, "gh gw 2"], photo_from_view: Float[np.ndarray, "2 3"], px: int, count: int
) -> Float[np.ndarray, "count count 2"]:
    """A sample's backward map as a view of ``px`` pixels sees it: on count x count nodes, in units of the view's side.

    nodes: of the sample, in pixels of its photo. photo_from_view: affine, between the two frames (convention 2).
    """
    linear, shift = photo_from_view[:, :2], photo_from_view[:, 2]
    in_view = (np.asarray(nodes, dtype=np.float64) - shift) @ np.linalg.inv(linear).T
    return (BackwardMap(in_view / px).resized((count, count)).nodes).astype(np.float32)


def normal_in_view(
    normal: Float[np.ndarray, "h w 3"], seen: Bool[np.ndarray, "h w"], turn: float
) -> Float[np.ndarray, "h w 3"]:
    """Sampled normals in the axes of a camera turned by ``turn`` radians, of unit length again; 0 off the film."""
    cos, sin = np.cos(turn), np.sin(turn)
    x, y, z = np.moveaxis(normal, -1, 0)
    turned = np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-1)
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.where(seen[..., None], turned / np.maximum(length, 1e-6), 0.0).astype(np.float32)
