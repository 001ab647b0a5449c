"""Networks made ready to be used: what is done once, when they are loaded, is not done again at each look."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from hybrid.learn.network import Residual
from hybrid.learn.tensors import Network
from hybrid.learn.upright import Mix


class PackedConv(nn.Module):
    """A convolution whose weights lie as oneDNN wants them, and the ReLU that follows it, if one does.

    PyTorch lays them out anew at each call, which takes a third of the time of a look at one small image: FilmNet reads
    30 MB of weights for 1.3 GFLOP. The operators are those to which ``torch.compile`` turns convolutions on processors.
    """

    def __init__(self, conv: nn.Conv2d, relu: bool = False) -> None:
        super().__init__()
        self.then = "relu" if relu else "none"
        self.shape = (conv.padding, conv.stride, conv.dilation, conv.groups)
        self.bias = conv.bias
        self.packed = torch.ops.aten.mkldnn_reorder_conv2d_weight(conv.weight.to_mkldnn(), *self.shape)

    def forward(self, x: Float[Tensor, "b c H W"]) -> Float[Tensor, "b k h w"]:
        """The same as without, but for the last bits."""
        return torch.ops.mkldnn._convolution_pointwise(x, self.packed, self.bias, *self.shape, self.then, [], "")

    def added_to(self, beside: Float[Tensor, "b k h w"], x: Float[Tensor, "b c H W"]) -> Float[Tensor, "b k h w"]:
        """What the convolution makes of x, added to what lies beside it, and a ReLU: in one pass over the result."""
        return torch.ops.mkldnn._convolution_pointwise.binary(
            x, beside, self.packed, self.bias, *self.shape, "add", 1.0, "relu", [], ""
        )


class PackedResidual(nn.Module):
    """Convolutions beside an identity (``Residual``, ``Mix``): the last of them adds it."""

    def __init__(self, first: nn.Module, last: nn.Module) -> None:
        super().__init__()
        assert isinstance(last, PackedConv)
        self.first, self.last = first, last

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """The same as without, but for the last bits."""
        return self.last.added_to(x, self.first(x))


def ready(network: Network) -> Network:
    """A network for inference on the processor: batch normalisation folded into the convolutions, these with packed
    weights where PyTorch has oneDNN, channels last, no gradients."""
    network = network.eval().requires_grad_(False)
    for module in network.modules():
        if isinstance(module, nn.Sequential):
            for k in range(len(module) - 1):
                conv, norm = module[k], module[k + 1]
                if isinstance(conv, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                    module[k] = nn.utils.fuse_conv_bn_eval(conv, norm)
                    module[k + 1] = nn.Identity()
    network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    if torch.backends.mkldnn.is_available():
        _pack(network)
    return network


def _pack(network: nn.Module) -> None:
    """Puts packed convolutions in the place of all others within a network, with the ReLU that follows on them."""
    for name, child in network.named_children():
        match child, [part for part in child.children() if not isinstance(part, nn.Identity)]:
            case nn.Conv2d(), _:
                setattr(network, name, PackedConv(child))
            case nn.Sequential(), [nn.Conv2d() as conv, nn.ReLU()]:
                setattr(network, name, PackedConv(conv, relu=True))
            case Residual(), _:
                _pack(child)
                setattr(network, name, PackedResidual(child.first, child.second[0]))
            case Mix(), _:
                _pack(child)
                setattr(network, name, PackedResidual(nn.Identity(), child.conv[0]))
            case _:
                _pack(child)


__all__ = ["PackedConv", "PackedResidual", "ready"]
