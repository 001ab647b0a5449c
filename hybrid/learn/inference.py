"""Networks made ready to be used: what is done once, when they are loaded, is not done again at each look."""

from __future__ import annotations

from functools import lru_cache, partial

import torch
from jaxtyping import Float
from torch import Tensor, nn

from hybrid.learn.network import Residual
from hybrid.learn.tensors import Network
from hybrid.learn.upright import Mix

MOST_SIZES = 3
"""Sizes of input for which a convolution's weights are kept as they are wanted; of FilmNet those of one take 30 MB."""


class PackedConv(nn.Module):
    """A convolution whose weights lie as oneDNN wants them, and the ReLU that follows it, if one does.

    PyTorch lays them out anew at each call, which takes up to a third of the time of a look at one small image: FilmNet
    reads 30 MB of weights for 1.3 GFLOP. How they are wanted depends on the input's size, batch included, on the
    processor and on the precision: laid out for another size they are turned at each call after all, which on
    processors without AVX-512 makes a look five times as slow. So that is done once for each size that comes. The
    operators are those to which ``torch.compile`` turns convolutions on processors.
    """

    def __init__(self, conv: nn.Conv2d, relu: bool = False, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.precision, self.then = precision, "relu" if relu else "none"
        self.shape = (conv.padding, conv.stride, conv.dilation, conv.groups)
        self.bias = None if conv.bias is None else conv.bias.detach().to(precision)
        weights = conv.weight.detach().to(precision).contiguous()  # of others oneDNN packs none in bfloat16
        self.packed = lru_cache(MOST_SIZES)(partial(_laid_out, weights, self.shape))

    def forward(self, x: Float[Tensor, "b c H W"]) -> Float[Tensor, "b k h w"]:
        """The same as without, but for the last bits of its precision, in which it also is."""
        x = x.to(self.precision)
        weights = self.packed(x.shape)
        return torch.ops.mkldnn._convolution_pointwise(x, weights, self.bias, *self.shape, self.then, [], "")

    def added_to(self, beside: Float[Tensor, "b k h w"], x: Float[Tensor, "b c H W"]) -> Float[Tensor, "b k h w"]:
        """What the convolution makes of x, added to what lies beside it, and a ReLU: in one pass over the result."""
        x, beside = x.to(self.precision), beside.to(self.precision)
        return torch.ops.mkldnn._convolution_pointwise.binary(
            x, beside, self.packed(x.shape), self.bias, *self.shape, "add", 1.0, "relu", [], ""
        )


def _laid_out(weights: Tensor, shape: tuple, size: torch.Size) -> Tensor:
    """Weights as oneDNN wants them for inputs of one size, channels last."""
    return torch.ops.aten.mkldnn_reorder_conv2d_weight(weights.to_mkldnn(), *shape, size)


class PackedResidual(nn.Module):
    """Convolutions beside an identity (``Residual``, ``Mix``): the last of them adds it."""

    def __init__(self, first: nn.Module, last: PackedConv) -> None:
        super().__init__()
        self.first, self.last = first, last

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """The same as without, but for the last bits."""
        return self.last.added_to(x, self.first(x))


def ready(network: Network, precision: torch.dtype | None = None) -> Network:
    """A network for inference on the processor: batch normalisation folded into the convolutions, these with packed
    weights where PyTorch has oneDNN, channels last, no gradients.

    precision: of convolutions that a ReLU follows, which are most of the work; the others, which tell places and
    probabilities, are in single precision. If not told, bfloat16 where the processor has instructions for it: the
    networks have learnt in that, too.
    """
    precision = precision or (torch.bfloat16 if fast_bfloat16("cpu") else torch.float32)
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
        _pack(network, precision)
    return network


def fast_bfloat16(device: str) -> bool:
    """Whether bfloat16 is faster than float32: on GPUs, and on CPUs that have instructions for it."""
    return device == "cuda" or bool(
        torch.ops.mkldnn._is_mkldnn_bf16_supported() and torch.cpu._is_avx512_bf16_supported()
    )


def _pack(network: nn.Module, precision: torch.dtype) -> None:
    """Puts packed convolutions in the place of all others within a network, with the ReLU that follows on them."""
    for name, child in network.named_children():
        match child, [part for part in child.children() if not isinstance(part, nn.Identity)]:
            case nn.Conv2d(), _:
                setattr(network, name, PackedConv(child))
            case nn.Sequential(), [nn.Conv2d() as conv, nn.ReLU()]:
                setattr(network, name, _packed(conv, precision, relu=True))
            case Residual(), _:
                first, last = _packed(child.first[0], precision, relu=True), _packed(child.second[0], precision)
                setattr(network, name, PackedResidual(first, last))
            case Mix(), _:
                setattr(network, name, PackedResidual(nn.Identity(), _packed(child.conv[0], precision)))
            case nn.Linear() | nn.Conv1d(), _:
                child.register_forward_pre_hook(_in_its_precision)
            case _:
                _pack(child, precision)


def _packed(conv: nn.Module, precision: torch.dtype, relu: bool = False) -> PackedConv:
    assert isinstance(conv, nn.Conv2d)
    return PackedConv(conv, relu, precision)


def _in_its_precision(layer: nn.Module, given: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """What a layer is given, as precise as its weights."""
    return tuple(x.to(next(layer.parameters()).dtype) for x in given)


__all__ = ["PackedConv", "PackedResidual", "fast_bfloat16", "ready"]
