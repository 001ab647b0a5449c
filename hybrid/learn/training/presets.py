"""Every network that the trainer can train, by name: its configuration, its losses and the truth that it needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import torch
from torch import Tensor, nn

from hybrid.errors import ConfigError, describe
from hybrid.learn.networks.edgenet import EdgeNet, EdgeNetConfig, edge_losses
from hybrid.learn.networks.filmnet import FilmNet, FilmNetConfig
from hybrid.learn.networks.lightnet import LightNet, LightNetConfig, light_losses
from hybrid.learn.networks.losses import LossWeights, loss_terms
from hybrid.learn.networks.slicenet import SliceNet, SliceNetConfig
from hybrid.learn.networks.uprightnet import UprightNet, UprightNetConfig, upright_losses
from hybrid.learn.paper import losses as paper_losses
from hybrid.learn.paper.dewarpnet import NODES, BackwardNet, DewarpNet, DewarpNetConfig, ShapeNet, coordinate_code
from hybrid.learn.paper.firenet import MULTI_MAP, UV_ONLY, FiReNet, FiReNetConfig
from hybrid.learn.paper.targets import PaperTargets
from hybrid.learn.paper.uvbw import NetBw, NetUv, UvBwConfig
from hybrid.learn.training.feeds.feed import Feed
from hybrid.learn.training.feeds.film import FILM_FEED
from hybrid.learn.training.feeds.light import LIGHT_FEED
from hybrid.learn.training.feeds.paper import paper_feed
from hybrid.learn.training.feeds.prints import print_feed, slice_feed
from hybrid.learn.training.feeds.strips import border_feed, edge_feed

PaperConfig = FiReNetConfig | DewarpNetConfig | UvBwConfig
"""Configurations with a width factor."""


def image_input(images: Tensor, targets: Any) -> Tensor:
    """The photo: sRGB in [0, 1]."""
    return images


def coordinate_input(images: Tensor, targets: PaperTargets) -> Tensor:
    """The true 3D map, as a network of 3D maps reads it: the input when such a network is trained alone."""
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
    name, from output and targets. weights: of the terms; those left out count once. nodes: side of the true backward
    map for an input of so many pixels; 0 if it is not needed. inputs: what the network reads. own_feed: where its
    batches come from, if not the paper's. batch, learning_rate: as published. px_multiple: the input's side is a
    multiple of this. one_size: whether the network takes only inputs of its configuration's size. least_batch: images
    that each process needs in a step: networks whose maps shrink to a single pixel cannot be normalised over fewer.
    layout: of the weights in memory during training.
    """

    config: FilmNetConfig | UprightNetConfig | SliceNetConfig | EdgeNetConfig | LightNetConfig | PaperConfig
    build: Callable[[Any], nn.Module]
    losses: Callable[[Any, Any], dict[str, Tensor]]
    weights: Mapping[str, float] = field(default_factory=dict)
    nodes: Callable[[int], int] = no_nodes
    inputs: Callable[[Tensor, Any], Tensor] = image_input
    own_feed: Feed | None = None
    batch: int = 16
    learning_rate: float = 1e-3
    px_multiple: int = 32
    one_size: bool = False
    least_batch: int = 1
    layout: torch.memory_format = torch.channels_last

    @property
    def feed(self) -> Feed:
        """Where its batches come from."""
        return self.own_feed or paper_feed(self.nodes, self.inputs)

    def network(self) -> nn.Module:
        """The network with fresh weights."""
        return self.build(self.config)

    def at_width(self, width: float) -> Preset:
        """The same with all channel counts scaled by ``width``.

        Raises:
            ConfigError: the network has no width factor.
        """
        if not isinstance(self.config, PaperConfig):
            raise ConfigError(
                describe(what="width", got=width, allowed="presets of the paper's networks", do="Leave it out.")
            )
        return replace(self, config=replace(self.config, width=width))

    def at_input(self, px: int) -> Preset:
        """The same for an input of another size."""
        return replace(self, config=replace(self.config, input_px=px))


_EDGES = Preset(
    EdgeNetConfig(),
    EdgeNet,
    edge_losses,
    own_feed=edge_feed(EdgeNetConfig()),
    batch=16,
    learning_rate=2e-3,
    px_multiple=24,  # 2 columns for 3 rows, both halved three times
)
_FIRENET = Preset(
    FiReNetConfig(),
    FiReNet,
    paper_losses.firenet_losses,
    nodes=node_per_pixel,
    px_multiple=64,
    layout=torch.contiguous_format,  # twice as fast: group normalisation is slow with the channels last
)
_DEWARPNET = Preset(
    DewarpNetConfig(layers="read"),
    DewarpNet,
    paper_losses.dewarpnet_losses,
    weights={"backward": 10.0, "reconstruction": 0.5},
    nodes=dewarpnet_nodes,
    batch=50,
    learning_rate=1e-4,
    px_multiple=128,
    least_batch=2,
)
_NET_BW = Preset(
    UvBwConfig(),
    NetBw,
    paper_losses.net_bw_losses,
    nodes=node_per_pixel,
    inputs=coordinate_input,
)

PRESETS: dict[str, Preset] = {
    "filmnet": Preset(
        FilmNetConfig(),
        FilmNet,
        loss_terms,
        weights=asdict(LossWeights()),
        own_feed=FILM_FEED,
        batch=32,
        learning_rate=2e-3,
    ),
    "upright": Preset(
        UprightNetConfig(),
        UprightNet,
        upright_losses,
        own_feed=print_feed(UprightNetConfig()),
        batch=16,
        learning_rate=3e-3,
        px_multiple=8,
    ),
    "slices": Preset(
        SliceNetConfig(),
        SliceNet,
        upright_losses,
        own_feed=slice_feed(SliceNetConfig()),
        batch=32,
        learning_rate=3e-3,
        px_multiple=16,
        one_size=True,
    ),
    "edges": _EDGES,
    "borders": replace(_EDGES, own_feed=border_feed(EdgeNetConfig())),
    "light": Preset(
        LightNetConfig(),
        LightNet,
        light_losses,
        weights={"black": 4.0, "contrast": 4.0, "slope": 10.0, "film": 0.15},
        own_feed=LIGHT_FEED,
        batch=48,
        learning_rate=2.5e-3,
        px_multiple=16,
    ),
    "firenet": _FIRENET,
    "firenet_multimap": replace(_FIRENET, config=MULTI_MAP, nodes=no_nodes),
    "firenet_uv_only": replace(_FIRENET, config=UV_ONLY, nodes=no_nodes),
    "dewarpnet": _DEWARPNET,
    "dewarpnet_shape": replace(
        _DEWARPNET,
        build=ShapeNet,
        losses=paper_losses.shape_net_losses,
        weights={},
        nodes=no_nodes,
        least_batch=1,
    ),
    "dewarpnet_bw": replace(
        _DEWARPNET, build=BackwardNet, losses=paper_losses.backward_net_losses, inputs=coordinate_input
    ),
    "net_bw": _NET_BW,
    "net_uv": replace(_NET_BW, build=NetUv, losses=paper_losses.net_uv_losses, nodes=no_nodes),
}
"""DewarpNet's stages are first trained separately, shape from photos and the map from true 3D maps.
``dewarpnet.joined`` makes one network of them, which "dewarpnet" trains further (``hybrid train --start``)."""


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
