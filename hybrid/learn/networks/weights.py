"""Weights files: safetensors with the network's kind, configuration and conventions version, loaded strictly."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from hybrid.coords import CONVENTIONS_VERSION
from hybrid.errors import DataError, describe
from hybrid.files import write_bytes
from hybrid.learn.networks.edgenet import EdgeNet, EdgeNetConfig
from hybrid.learn.networks.filmnet import FilmNet, FilmNetConfig
from hybrid.learn.networks.lightnet import LightNet, LightNetConfig
from hybrid.learn.networks.slicenet import SliceNet, SliceNetConfig
from hybrid.learn.networks.tensors import Network
from hybrid.learn.networks.uprightnet import UprightNet, UprightNetConfig


def save_weights(path: Path, network: nn.Module, config: Any, notes: dict[str, Any]) -> None:
    """Write a network in half precision with its configuration; ``notes`` (JSON-able) say how it was trained.

    Raises:
        DataError: a weight is not a finite number in half precision.
    """
    metadata = {
        "kind": type(network).__name__,
        "conventions": str(CONVENTIONS_VERSION),
        "config": json.dumps(asdict(config)),
        "notes": json.dumps(notes),
    }
    tensors = {
        name: (value.half() if value.is_floating_point() else value).contiguous()
        for name, value in network.state_dict().items()
    }
    lost = [name for name, value in tensors.items() if not value.isfinite().all()]
    if lost:
        got, do = f"no finite number in {lost[0]}", "Train with a lower --learning-rate."
        raise DataError(describe(what="weights", where=path, got=got, do=do))
    write_bytes(path, _sorted(save(tensors, metadata)))


def load_weights(path: Path, build: Callable[[Any], Network], config_type: type) -> Network:
    """Read a network in single precision, as ``build(config_type(...))`` with the configuration of the file.

    It is built without weights and takes those of the file: PyTorch's random state does not change, and its default
    type and device do not matter.

    Raises:
        DataError: no such file, not a weights file, of another kind or configuration, or made under other conventions.
    """
    metadata, tensors = _read(path, getattr(build, "__name__", str(build)))
    try:
        options: dict[str, Any] = json.loads(metadata["config"])
        config = config_type(**{name: _frozen(value) for name, value in options.items()})
        with torch.device("meta"):
            network = build(config)
        network.load_state_dict(tensors, strict=True, assign=True)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        got = str(error).splitlines()[0]
        raise DataError(describe(what="weights", where=path, got=got, do="Train them again.")) from error
    return network


def load_into(network: nn.Module, path: Path) -> None:
    """Read weights into a network of the same kind and shape.

    Raises:
        DataError: as ``load_weights``, or weights of another shape.
    """
    _, tensors = _read(path, type(network).__name__)
    try:
        network.load_state_dict(tensors, strict=True)
    except RuntimeError as error:
        got = str(error).splitlines()[0]
        raise DataError(describe(what="weights", where=path, got=got, do="Use the same preset and width.")) from error


def packaged_path(name: str) -> Path:
    """Where the package keeps the weights of a preset, if it ships them."""
    return Path(__file__).parents[1] / "packaged" / f"{name}.safetensors"


def packaged_film_net() -> FilmNet:
    """The FilmNet that the package ships."""
    return load_weights(packaged_path("filmnet"), FilmNet, FilmNetConfig)


def packaged_upright_net() -> UprightNet:
    """The UprightNet that the package ships."""
    return load_weights(packaged_path("upright"), UprightNet, UprightNetConfig)


def packaged_slice_net() -> SliceNet:
    """The SliceNet that the package ships."""
    return load_weights(packaged_path("slices"), SliceNet, SliceNetConfig)


def packaged_edge_net() -> EdgeNet:
    """The EdgeNet that the package ships."""
    return load_weights(packaged_path("edges"), EdgeNet, EdgeNetConfig)


def packaged_border_net() -> EdgeNet:
    """The EdgeNet for borders between cells, BorderNet, that the package ships."""
    return load_weights(packaged_path("borders"), EdgeNet, EdgeNetConfig)


def packaged_light_net() -> LightNet:
    """The LightNet that the package ships."""
    return load_weights(packaged_path("light"), LightNet, LightNetConfig)


def notes_of(path: Path) -> dict[str, Any]:
    """How the weights in a file were trained: the notes of ``save_weights``.

    Raises:
        DataError: no such file, or not a weights file.
    """
    notes: dict[str, Any] = json.loads(_opened(path)[0].get("notes", "{}"))
    return notes


def images_shown(notes: dict[str, Any]) -> int | None:
    """How many images a network has been shown in all, by its notes: in its training, and in those of the weights that
    it started from (of several, the most). None where the notes do not say."""
    return notes["passes"] + notes.get("before", 0) if "passes" in notes else None


def parameter_count(network: nn.Module) -> int:
    """Number of parameters, including those that training never changes."""
    return sum(p.numel() for p in network.parameters())


def _read(path: Path, kind: str) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Metadata and tensors, in single precision, of a file of this kind."""
    metadata, tensors = _opened(path)
    if metadata.get("kind") != kind:
        got = metadata.get("kind", "no network of this package")
        raise DataError(describe(what="weights", where=path, got=got, allowed=kind, do=f"Name a file of a {kind}."))
    made, version = metadata.get("conventions"), str(CONVENTIONS_VERSION)
    if made != version:
        do = "Train them again."
        raise DataError(describe(what="weights", where=path, got=f"conventions {made}", allowed=version, do=do))
    return metadata, {k: v.to(torch.float32) if v.is_floating_point() else v for k, v in tensors.items()}


def _sorted(file: bytes) -> bytes:
    """A safetensors file with its header in order, as the library's order is random: the same training gives the same
    bytes."""
    begin, end = 8, 8 + int.from_bytes(file[:8], "little")
    header = json.dumps(json.loads(file[begin:end]), sort_keys=True, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + file[end:]


def _opened(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Metadata and tensors of a file, as stored."""
    try:
        with safe_open(path, framework="pt") as file:
            return file.metadata() or {}, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        raise DataError(describe(what="weights", where=path, got=error, do="Name a .safetensors file.")) from error


def _frozen(value: Any) -> Any:
    """JSON's lists as the tuples that configurations hold."""
    return tuple(_frozen(v) for v in value) if isinstance(value, list) else value
