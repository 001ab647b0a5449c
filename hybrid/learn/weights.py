"""Weights files: safetensors with the configuration and the conventions version inside, loaded strictly."""

from __future__ import annotations

import json
from dataclasses import asdict
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from hybrid.coords import CONVENTIONS_VERSION
from hybrid.errors import DataError, describe
from hybrid.learn.network import FilmNet, FilmNetConfig


def save_weights(path: Path, network: FilmNet, notes: dict[str, Any]) -> None:
    """Write a network in half precision with its configuration; ``notes`` (JSON-able) say how it was trained."""
    metadata = {
        "kind": "FilmNet",
        "conventions": str(CONVENTIONS_VERSION),
        "config": json.dumps(asdict(network.config)),
        "notes": json.dumps(notes),
    }
    tensors = {
        name: (value.half() if value.is_floating_point() else value).contiguous()
        for name, value in network.state_dict().items()
    }
    save_file(tensors, path, metadata=metadata)


def load_weights(path: Path) -> FilmNet:
    """Read a network in single precision.

    Raises:
        DataError: no such file, not a weights file, of another kind, or made under other conventions.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
    except (OSError, SafetensorError) as error:
        raise DataError(describe(what="weights", where=path, got=error, do="Name a .safetensors file.")) from error
    got = (metadata.get("kind"), metadata.get("conventions"))
    if got != ("FilmNet", str(CONVENTIONS_VERSION)):
        allowed = ("FilmNet", str(CONVENTIONS_VERSION))
        raise DataError(describe(what="weights", where=path, got=got, allowed=allowed, do="Train them again."))
    options: dict[str, Any] = json.loads(metadata["config"])
    options = {**options, "widths": tuple(options["widths"]), "blocks": tuple(options["blocks"])}
    network = FilmNet(FilmNetConfig(**options))
    network.load_state_dict({k: v.float() if v.is_floating_point() else v for k, v in tensors.items()}, strict=True)
    return network


def packaged_weights() -> FilmNet:
    """The network that the package ships."""
    with as_file(files("hybrid.learn") / "packaged" / "filmnet.safetensors") as path:
        return load_weights(path)


def parameter_count(network: torch.nn.Module) -> int:
    """Number of trainable parameters."""
    return sum(p.numel() for p in network.parameters())
