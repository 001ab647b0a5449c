"""The truth that the paper's networks are trained on: FilmNet's, normals and the backward map."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hybrid.coords import film_nodes
from hybrid.learn.networks.tensors import Tensors


@dataclass(frozen=True, eq=False)
class PaperTargets(Tensors):
    """Truth at a network's output resolution; 0 where the mask is False.

    uv: film coordinates in [0, 1], v down. xyz: camera axes, relative to the film's centre, in film diagonals. normal:
    unit vectors in camera axes, towards the side that is seen. albedo: display grey of the print. backward: photo
    points on n x n nodes of the film, in units of the photo's sides; true everywhere, even where the film leaves the
    photo or hides itself.
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

        With 3D coordinates in camera axes it is the third of them; the paper's coordinates are in world axes.
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
