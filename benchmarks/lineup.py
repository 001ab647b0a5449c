"""Who runs in ``benchmarks.run``: the floor, the scanner, the paper's networks, and ``hybrid`` in its configurations.

Networks without weights run untrained: as wide as published, with random weights, so that their time is right, since
it does not depend on the values. What follows the network does (recovery looks at film pixels, resampling at places in
the photo), so the network's answer is exchanged for the true one after it has been waited for. Such a method has a
run time and no error.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor, nn

from benchmarks.cases import Case
from benchmarks.methods import (
    METHODS,
    Flattened,
    Method,
    configured,
    dewarpnet,
    firenet,
    trained_dewarpnet,
    weights_path,
)
from benchmarks.scanner import map_of_corners, scan, true_corners
from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, opencv_from_photo, pixel_centres, rescale_points
from hybrid.errors import ConfigError, describe
from hybrid.learn.baselines import corrected, dewarpnet_map, published_image, published_map, recover
from hybrid.learn.dewarpnet import NODES, BackwardOutput, DewarpNet, DewarpNetConfig
from hybrid.learn.firenet import FiReNet, FiReNetConfig, FiReNetOutput
from hybrid.learn.predict import PredictConfig
from hybrid.learn.weights import parameter_count
from hybrid.pipeline import RectifyConfig
from hybrid.rectify.deilluminate import DeilluminateConfig
from hybrid.rectify.refine import RefineConfig
from hybrid.rectify.repeat import RepeatConfig

Maker = Callable[[Path | None], Method | None]
"""Makes a method from a folder of weights; None where it needs some that are not there."""

NOT_TRAINED, TOLD = "not trained", "told the true map"

CONFIGURATIONS: dict[str, tuple[str, RectifyConfig]] = {
    "hybrid_four_sides": ("hybrid, looks from four sides", RectifyConfig(predict=PredictConfig(sides=(0, 2, 5, 7)))),
    "hybrid_two_looks": ("hybrid, two looks", RectifyConfig(predict=PredictConfig(looks=2))),
    "hybrid_no_lines": ("hybrid, no rules or gutters", RectifyConfig(refine=RefineConfig(line_rounds=0))),
    "hybrid_no_repeats": (
        "hybrid, no repeated cells",
        RectifyConfig(refine=RefineConfig(repeat=RepeatConfig(min_correlation=2.0))),  # no correlation reaches 2
    ),
    "hybrid_no_spline": ("hybrid, spline never believed", RectifyConfig(refine=RefineConfig(min_gain=0.0))),
    "hybrid_light_kept": ("hybrid, light kept", RectifyConfig(light=DeilluminateConfig(even_light=float("inf")))),
}
"""The pipeline with one thing changed, by name: label and options. What is worth measuring apart is added here."""


# ---------------------------------------------------------------- floor and scanner


def remap(weights: Path | None) -> Method:
    """The floor: one bilinear lookup by OpenCV through a map that is there already, to a film of the common size."""

    def given(case: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        at = opencv_from_photo(case.backward.dense(case.film_size()))
        return case.photo(), np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])

    def flatten(known: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Flattened:
        photo, x, y = known
        return Flattened(image=cv2.remap(photo, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    return Method("remap", lambda known: None, given, flatten, label="cv2.remap alone", unscored=TOLD)


def scanner(weights: Path | None) -> Method:
    """Four corners found by OpenCV."""
    return Method("scanner", scan, label="four-corner scanner")


def scanner_true(weights: Path | None) -> Method:
    """The scanner's upper bound: it is told the true corners."""
    return Method(
        "scanner_true",
        lambda known: map_of_corners(known[1]),
        lambda case: (case.photo(), true_corners(case.backward)),
        label="four corners, told the true ones",
    )


# ---------------------------------------------------------------- the paper's networks


class Prompted(nn.Module):
    """A network that is waited for; then another answer is given in its place."""

    def __init__(self, network: Any, answer: Any) -> None:
        nn.Module.__init__(self)  # not the network's own: nothing is to be built
        self.network, self.answer, self.config = network, answer, network.config

    def forward(self, image: Tensor) -> Any:
        self.network(image)
        return self.answer


class PromptedFiReNet(Prompted, FiReNet):
    """FiReNet, to all who look at types."""


class PromptedDewarpNet(Prompted, DewarpNet):
    """DewarpNet, to all who look at types."""


@dataclass(frozen=True, eq=False)
class Prompt:
    """A photo, and the answer that a perfect network would give."""

    photo: UInt8[np.ndarray, "h w 3"]
    answer: Any


def true_dewarpnet_answer(case: Case) -> BackwardOutput:
    """The true map on DewarpNet's nodes, in units of the photo's sides."""
    return BackwardOutput(_planes(_in_units(case, NODES)))


def true_firenet_answer(case: Case, px: int) -> FiReNetOutput:
    """The true mask, uv map and deformation map at px x px; the other maps are zero."""
    height, width = case.photo().shape[:2]
    uv = case.backward.film_from_photo(rescale_points(pixel_centres((px, px)), (px, px), (height, width)))
    film = torch.from_numpy(np.isfinite(uv).all(axis=-1))[None]
    return FiReNetOutput(
        mask_logit=torch.where(film, 9.0, -9.0),
        xyz=torch.zeros(1, 3, px, px),
        uv=_planes(np.nan_to_num(uv)),
        albedo=torch.zeros(1, px, px),
        deformation=_planes(_in_units(case, px) - film_nodes((px, px))),
    )


def _in_units(case: Case, n: int) -> np.ndarray:
    height, width = case.photo().shape[:2]
    return rescale_points(case.backward.resized((n, n)).nodes, (height, width), (1, 1))


def _planes(maps: np.ndarray) -> Tensor:
    return torch.from_numpy(maps.astype(np.float32)).permute(2, 0, 1)[None]


def untrained_firenet() -> Method:
    """FiReNet at full width with random weights."""
    network = FiReNet(FiReNetConfig()).eval()
    return Method(
        "firenet",
        lambda prompt: recover(PromptedFiReNet(network, prompt.answer), prompt.photo).backward,
        lambda case: Prompt(case.photo(), true_firenet_answer(case, network.config.input_px)),
        parameters=parameter_count(network),
        label="FiReNet",
        unscored=NOT_TRAINED,
    )


def untrained_dewarpnet() -> Method:
    """DewarpNet, its map read rightly, at full width with random weights."""
    network = DewarpNet(DewarpNetConfig()).eval()
    return Method(
        "dewarpnet",
        lambda prompt: corrected(PromptedDewarpNet(network, prompt.answer), prompt.photo),
        lambda case: Prompt(case.photo(), true_dewarpnet_answer(case)),
        parameters=parameter_count(network),
        label="DewarpNet, its map read rightly",
        unscored=NOT_TRAINED,
    )


def dewarpnet_published(weights: Path | None) -> Method:
    """DewarpNet run as released: the map's mean and resize, and a lookup in double precision at the photo's size."""
    network = trained_dewarpnet(weights)
    unscored = NOT_TRAINED if network is None else ""
    network = network or DewarpNet(DewarpNetConfig()).eval()

    def flatten(known: Prompt) -> Flattened:
        runs = network if known.answer is None else PromptedDewarpNet(network, known.answer)
        backward = dewarpnet_map(runs, known.photo, cv2.INTER_LINEAR)
        image = published_image(backward, known.photo)
        found = published_map(backward, (image.shape[0], image.shape[1]))
        return Flattened(found, np.rint(image * 255).astype(np.uint8))

    def find(known: Prompt) -> BackwardMap | None:
        return flatten(known).backward

    return Method(
        "dewarpnet_published",
        find,
        lambda case: Prompt(case.photo(), true_dewarpnet_answer(case) if unscored else None),
        flatten,
        parameters=parameter_count(network),
        label="DewarpNet as published",
        unscored=unscored,
    )


# ---------------------------------------------------------------- all


def _configuration(name: str) -> Maker:
    label, config = CONFIGURATIONS[name]
    return lambda weights: configured(name, replace(config, weights=weights_path(weights, "filmnet")), label)


LINEUP: dict[str, Maker] = {
    "remap": remap,
    "scanner": scanner,
    "scanner_true": scanner_true,
    "dewarpnet_published": dewarpnet_published,
    "dewarpnet": lambda weights: dewarpnet(weights) or untrained_dewarpnet(),
    "firenet": lambda weights: firenet(weights) or untrained_firenet(),
    "filmnet": METHODS["filmnet"],
    "hybrid": METHODS["hybrid"],
    **{name: _configuration(name) for name in CONFIGURATIONS},
}
"""All that is compared, in the order of the tables."""


def lineup(added: tuple[Path, ...] = ()) -> dict[str, Maker]:
    """All methods, with those of the files that were added.

    Raises:
        ConfigError: a file that is no Python module with a table METHODS, or a name that is taken.
    """
    everyone = dict(LINEUP)
    for path in added:
        found = _methods_of(path)
        taken = sorted(set(found) & set(everyone))
        if taken:
            raise ConfigError(describe(what="--add", where=path, got=", ".join(taken), do="Choose other names."))
        everyone |= found
    return everyone


def _methods_of(path: Path) -> Mapping[str, Maker]:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ConfigError(describe(what="--add", where=path, got="no Python file", do="Name a .py file."))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    methods = getattr(module, "METHODS", None)
    if not isinstance(methods, dict) or not all(callable(make) for make in methods.values()):
        do = "Give it METHODS = {name: function of a folder of weights}, as benchmarks/methods.py says."
        raise ConfigError(describe(what="--add", where=path, got="no table METHODS", do=do))
    return methods


__all__ = ["CONFIGURATIONS", "LINEUP", "NOT_TRAINED", "TOLD", "Maker", "lineup"]
