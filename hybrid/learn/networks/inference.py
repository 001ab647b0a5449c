"""Networks prepared to be used: work that is done once, at loading, is not repeated at each look."""

from __future__ import annotations

import os
from functools import lru_cache, partial

import torch
from jaxtyping import Float
from torch import Tensor, nn

from hybrid.learn.networks.filmnet import Residual
from hybrid.learn.networks.tensors import Network
from hybrid.learn.networks.uprightnet import Mix

if hasattr(os, "register_at_fork"):
    # A forked process has none of its parent's threads, and PyTorch's would be waited for without end.
    os.register_at_fork(after_in_child=partial(torch.set_num_threads, 1))

MOST_SIZES = 3
"""Input sizes for which a convolution keeps its packed weights; for one size, FilmNet's take 30 MB."""


class PackedConv(nn.Module):
    """A convolution whose weights are packed in oneDNN's layout, and the ReLU that follows it, if any.

    PyTorch packs weights anew at each call, which takes up to a third of the time of a look at one small image: FilmNet
    reads 30 MB of weights for 1.3 GFLOP. oneDNN's layout depends on the input's size, batch included, on the processor
    and on the precision: weights packed for another size are still repacked at each call, which makes a look five times
    as slow on processors without AVX-512. So weights are packed once for each input size. The operators are those to
    which ``torch.compile`` lowers convolutions on CPUs.
    """

    def __init__(self, conv: nn.Conv2d, relu: bool = False, precision: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.precision, self.then = precision, "relu" if relu else "none"
        self.shape = (conv.padding, conv.stride, conv.dilation, conv.groups)
        self.bias = None if conv.bias is None else conv.bias.detach().to(precision)
        weights = conv.weight.detach().to(precision).contiguous()  # in bfloat16, oneDNN packs only contiguous ones
        self.packed = lru_cache(MOST_SIZES)(partial(_laid_out, weights, self.shape))

    def forward(self, x: Float[Tensor, "b c H W"]) -> Float[Tensor, "b k h w"]:
        """The plain convolution's result up to the last bits, in the precision of the weights."""
        x = x.to(self.precision)
        weights = self.packed(x.shape)
        return torch.ops.mkldnn._convolution_pointwise(x, weights, self.bias, *self.shape, self.then, [], "")

    def added_to(self, beside: Float[Tensor, "b k h w"], x: Float[Tensor, "b c H W"]) -> Float[Tensor, "b k h w"]:
        """The convolution of x added to a skip connection, and a ReLU: in one pass over the result."""
        x, beside = x.to(self.precision), beside.to(self.precision)
        return torch.ops.mkldnn._convolution_pointwise.binary(
            x, beside, self.packed(x.shape), self.bias, *self.shape, "add", 1.0, "relu", [], ""
        )


def _laid_out(weights: Tensor, shape: tuple, size: torch.Size) -> Tensor:
    """Weights packed by oneDNN for inputs of one size, channels last."""
    return torch.ops.aten.mkldnn_reorder_conv2d_weight(weights.to_mkldnn(), *shape, size)


class PackedResidual(nn.Module):
    """Convolutions with an identity shortcut (``Residual``, ``Mix``): the last of them adds it."""

    def __init__(self, first: nn.Module, last: PackedConv) -> None:
        super().__init__()
        self.first, self.last = first, last

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """The plain module's result up to the last bits."""
        return self.last.added_to(x, self.first(x))


def ready(network: Network, precision: torch.dtype | None = None) -> Network:
    """A network for inference on the processor: batch normalisation folded into the convolutions, their weights packed
    where PyTorch has oneDNN, channels last, no gradients.

    precision: of convolutions followed by a ReLU, which are most of the work; the others, which output positions and
    probabilities, are in single precision. By default bfloat16 where the processor has instructions for it: the
    networks were trained in it, too.
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
    """Replace all convolutions within a network by packed ones that include the ReLU after them."""
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
    """A layer's inputs, cast to the type of its weights."""
    return tuple(x.to(next(layer.parameters()).dtype) for x in given)


__all__ = ["PackedConv", "PackedResidual", "fast_bfloat16", "ready"]
