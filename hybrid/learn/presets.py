"""Every network that the trainer can train, by name: its configuration, its losses and the truth that it needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from hybrid.errors import ConfigError, describe
from hybrid.learn import paper_losses
from hybrid.learn.dewarpnet import NODES, BackwardNet, DewarpNet, DewarpNetConfig, ShapeNet, coordinate_code
from hybrid.learn.firenet import MULTI_MAP, UV_ONLY, FiReNet, FiReNetConfig
from hybrid.learn.losses import LossWeights, loss_terms
from hybrid.learn.network import STRIDE, FilmNet, FilmNetConfig
from hybrid.learn.paper_targets import PaperTargets
from hybrid.learn.uvbw import NetBw, NetUv, UvBwConfig


def image_input(images: Tensor, targets: Any) -> Tensor:
    """The photo: sRGB in [0, 1]."""
    return images


def coordinate_input(images: Tensor, targets: PaperTargets) -> Tensor:
    """The true 3D map, as a network of 3D maps sees it: what such a network is trained on alone."""
    return coordinate_code(targets.xyz, targets.mask)


def no_nodes(px: int) -> int:
    """No backward map is needed."""
    return 0


def node_per_pixel(px: int) -> int:
    """As many nodes as the maps have pixels."""
    return px


def dewarpnet_nodes(px: int) -> int:
    """DewarpNet's fixed number, whatever its input."""
    return NODES


@dataclass(frozen=True)
class Preset:
    """One network, and how it is trained.

    config, build: ``build(config)`` makes the network; ``config.input_px`` is the side of its input. losses: terms by
    name, of output and targets. fields: of the targets that the losses and the input read. weights: of the terms;
    those left out count once. stride: input pixels per pixel of the targets' maps, along each axis. nodes: side of
    the true backward map for an input of so many pixels; 0 if it is not needed. inputs: what the network reads.
    ship_width: width at which weights are shipped: the largest that fits 25 MB in half precision, or that two cores
    can train, if that is less. batch, learning_rate: as published.
    """

    config: Any
    build: Callable[[Any], nn.Module]
    losses: Callable[[Any, Any], dict[str, Tensor]]
    fields: tuple[str, ...]
    weights: Mapping[str, float]
    stride: int = 1
    nodes: Callable[[int], int] = no_nodes
    inputs: Callable[[Tensor, Any], Tensor] = image_input
    ship_width: float = 1.0
    batch: int = 16
    learning_rate: float = 1e-3

    def network(self) -> nn.Module:
        """The network with fresh weights."""
        return self.build(self.config)

    def at_width(self, width: float) -> Preset:
        """The same with all channel counts scaled by ``width``.

        Raises:
            ConfigError: the network has no width factor.
        """
        if not hasattr(self.config, "width"):
            raise ConfigError(
                describe(what="width", got=width, allowed="presets of the paper's networks", do="Leave it out.")
            )
        return replace(self, config=replace(self.config, width=width))


_MAPS = ("mask", "uv", "xyz", "albedo")
_FIRENET: dict[str, Any] = {
    "build": FiReNet,
    "losses": paper_losses.firenet_losses,
    "weights": {},  # alpha and beta stand within the terms; the paper adds the terms up as they are
    "ship_width": 0.23,
}
_READ = DewarpNetConfig(layers="read")
_DEWARPNET: dict[str, Any] = {"ship_width": 0.5, "batch": 50, "learning_rate": 1e-4}
_BACKWARD_WEIGHTS = {"backward": 10.0, "reconstruction": 0.5}
_PAIR: dict[str, Any] = {"inputs": coordinate_input, "ship_width": 0.125, "weights": {}}

PRESETS: dict[str, Preset] = {
    "filmnet": Preset(
        FilmNetConfig(),
        FilmNet,
        loss_terms,
        _MAPS,
        asdict(LossWeights()),
        stride=STRIDE,
        batch=32,
        learning_rate=2e-3,
    ),
    "firenet": Preset(FiReNetConfig(), fields=(*_MAPS, "normal", "backward"), nodes=node_per_pixel, **_FIRENET),
    "firenet_multimap": Preset(MULTI_MAP, fields=(*_MAPS, "normal"), **_FIRENET),
    "firenet_uv_only": Preset(UV_ONLY, fields=_MAPS, **_FIRENET),
    "dewarpnet": Preset(
        _READ,
        DewarpNet,
        paper_losses.dewarpnet_losses,
        ("mask", "xyz", "albedo", "backward"),
        _BACKWARD_WEIGHTS,
        nodes=dewarpnet_nodes,
        **_DEWARPNET,
    ),
    "dewarpnet_shape": Preset(_READ, ShapeNet, paper_losses.shape_net_losses, ("mask", "xyz"), {}, **_DEWARPNET),
    "dewarpnet_bw": Preset(
        _READ,
        BackwardNet,
        paper_losses.backward_net_losses,
        ("mask", "xyz", "albedo", "backward"),
        _BACKWARD_WEIGHTS,
        nodes=dewarpnet_nodes,
        inputs=coordinate_input,
        **_DEWARPNET,
    ),
    "net_bw": Preset(
        UvBwConfig(), NetBw, paper_losses.net_bw_losses, ("mask", "xyz", "backward"), nodes=node_per_pixel, **_PAIR
    ),
    "net_uv": Preset(UvBwConfig(), NetUv, paper_losses.net_uv_losses, ("mask", "xyz", "uv"), **_PAIR),
}
"""DewarpNet's stages are trained apart first (shape from photos, map from true 3D maps), then as one ("dewarpnet")."""


def preset(name: str) -> Preset:
    """The preset of that name.

    Raises:
        ConfigError: there is none.
    """
    if name not in PRESETS:
        raise ConfigError(describe(what="preset", got=name, allowed=", ".join(PRESETS), do="Name one of these."))
    return PRESETS[name]


def weighted_sum(terms: Mapping[str, Tensor], weights: Mapping[str, float]) -> Tensor:
    """The loss: terms times their weights; a term without a weight counts once."""
    return torch.stack([weights.get(name, 1.0) * term for name, term in terms.items()]).sum()
