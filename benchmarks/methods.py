"""What is compared: each method finds, in a photo, where every film point is seen, and makes the flat film.

To add a method, write a file with a table ``METHODS`` and name it: ``python -m benchmarks.run --add my_method.py``.

    from benchmarks.methods import Method

    def make(weights):  # a folder with weights, or None
        return Method("mine", find)  # find: (h, w, 3) uint8 RGB -> hybrid.backward.BackwardMap, or None for no film

    METHODS = {"mine": make}

The photo is then read through the map as it is for everyone. A method that makes its own picture says so by
``flatten``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8

from benchmarks.cases import Case, TrueShape, true_shape
from hybrid.backward import BackwardMap
from hybrid.errors import PhotoError
from hybrid.learn.baselines import corrected, recover
from hybrid.learn.dewarpnet import BackwardNet, DewarpNet, ShapeNet, joined
from hybrid.learn.firenet import FiReNet
from hybrid.learn.presets import PRESETS
from hybrid.learn.uv_recovery import interpolated, points_of_uv
from hybrid.learn.uvbw import NetBw, NetUv
from hybrid.learn.weights import load_weights, packaged_film_net, parameter_count
from hybrid.pipeline import Rectifier, RectifyConfig
from hybrid.rectify.resample import rectify_photo


def photo_of_case(case: Case) -> Any:
    """What most methods are given: the photo."""
    return case.photo()


@dataclass(frozen=True, eq=False)
class Flattened:
    """What a method makes of a photo.

    backward: its map, in pixels of the photo; None where it finds no film. image: the flat film with its light, RGB.
    film: the same without light, display grey in [0, 1], from methods that take it away. parts: seconds, by part.
    message: what the method says of the photo.
    """

    backward: BackwardMap | None = None
    image: UInt8[np.ndarray, "h w 3"] | None = None
    film: Float[np.ndarray, "h w"] | None = None
    parts: Mapping[str, float] = field(default_factory=dict)
    message: str = ""


@dataclass(frozen=True)
class Method:
    """One way from a photo to a backward map, and on to the flat film.

    find: the map, in pixels of the photo, or None (or a PhotoError) where no film is found. given: what ``find`` and
    ``flatten`` take, read from a case before the clock starts: the photo, if nothing else is said. flatten: the whole
    way; None for those whose photo is read through their map as everyone's. says_up: whether the map is meant to
    be of the film that reads right, and not of the film as it lies. parameters: of its network. label: for people.
    unscored: why only its run time means anything; empty for methods that are scored.
    """

    name: str
    find: Callable[[Any], BackwardMap | None]
    given: Callable[[Case], Any] = photo_of_case
    flatten: Callable[[Any], Flattened] | None = None
    says_up: bool = False
    parameters: int | None = None
    label: str = ""
    unscored: str = ""

    def find_or_lose(self, given: Any) -> BackwardMap | None:
        """As ``find``, with None for a photo in which no film is found."""
        try:
            return self.find(given)
        except PhotoError:
            return None


def flattened(method: Method, given: Any, photo: UInt8[np.ndarray, "h w 3"], size: tuple[int, int]) -> Flattened:
    """The whole way of a method, to a film of ``size`` (h, w) unless it chooses its own."""
    try:
        if method.flatten is not None:
            return method.flatten(given)
        start = time.perf_counter()
        backward = method.find(given)
        found = time.perf_counter()
        if backward is None:
            return Flattened(parts={"map": found - start}, message="no film")
        image = rectify_photo(photo, backward, size).image
        parts = {"map": found - start, "resample": time.perf_counter() - found}
        return Flattened(backward, image, parts=parts)
    except PhotoError as error:
        return Flattened(message=str(error))


def weights_path(folder: Path | None, name: str) -> Path | None:
    """FOLDER/NAME.safetensors, or FOLDER/NAME/NAME.safetensors as trainings leave it; None if neither is there."""
    if folder is None:
        return None
    places = (folder / f"{name}.safetensors", folder / name / f"{name}.safetensors")
    return next((path for path in places if path.exists()), None)


def trained(folder: Path | None, name: str) -> Any:
    """The network of a preset with its weights, at the width and input of the file; None if it is not trained.

    Raises:
        DataError: the file holds other weights.
    """
    path, chosen = weights_path(folder, name), PRESETS[name]
    return None if path is None else load_weights(path, chosen.build, type(chosen.config)).eval()


# ---------------------------------------------------------------- this project


def filmnet(folder: Path | None) -> Method | None:
    """FilmNet alone: all its looks at the photo, before refinement. The packaged one, if the folder has none."""
    path = weights_path(folder, "filmnet")
    count = parameter_count(packaged_film_net() if path is None else trained(folder, "filmnet"))
    find = Rectifier(RectifyConfig(weights=path)).network_map
    return Method("filmnet", find, parameters=count, label="hybrid, network alone")


def hybrid_pipeline(folder: Path | None) -> Method | None:
    """The whole pipeline, all stages up to the film without light."""
    return configured("hybrid", RectifyConfig(weights=weights_path(folder, "filmnet")))


def configured(name: str, config: RectifyConfig, label: str = "") -> Method:
    """The pipeline with other options."""
    rectifier = Rectifier(config)

    def flatten(photo: Any) -> Flattened:
        result = rectifier(photo)
        parts = {stage.name: stage.seconds for stage in result.stages}
        return Flattened(result.backward, result.rectified, result.film, parts, str(result.status))

    return Method(name, lambda photo: rectifier(photo).backward, flatten=flatten, says_up=True, label=label)


# ---------------------------------------------------------------- baselines


def firenet(folder: Path | None, name: str = "firenet") -> Method | None:
    """FiReNet, or an ablation of it, with its recovery."""
    network: FiReNet | None = trained(folder, name)
    if network is None:
        return None
    count = parameter_count(network)
    return Method(name, lambda photo: recover(network, photo).backward, parameters=count, label="FiReNet")


def trained_dewarpnet(folder: Path | None) -> DewarpNet | None:
    """DewarpNet trained as one, else its two stages put together; None if neither is trained."""
    network: DewarpNet | None = trained(folder, "dewarpnet")
    if network is None:
        shape: ShapeNet | None = trained(folder, "dewarpnet_shape")
        backward: BackwardNet | None = trained(folder, "dewarpnet_bw")
        network = None if shape is None or backward is None else joined(shape, backward).eval()
    return network


def dewarpnet(folder: Path | None) -> Method | None:
    """DewarpNet, given its due: its map read as it is meant, the photo as everyone's."""
    network = trained_dewarpnet(folder)
    if network is None:
        return None
    label, count = "DewarpNet, its map read rightly", parameter_count(network)
    return Method("dewarpnet", lambda photo: corrected(network, photo), parameters=count, label=label)


def net_bw(folder: Path | None) -> Method | None:
    """True 3D map -> backward map."""
    network: NetBw | None = trained(folder, "net_bw")
    if network is None:
        return None

    @torch.inference_mode()
    def find(shape: TrueShape) -> BackwardMap:
        return _in_pixels(network(shape.code).backward[0].permute(1, 2, 0).numpy(), shape.photo_size)

    px = network.config.input_px
    return Method("net_bw", find, lambda case: true_shape(case, px), parameters=parameter_count(network))


def net_uv(folder: Path | None) -> Method | None:
    """True 3D map -> uv map -> backward map by interpolation between the film pixels of the true mask."""
    network: NetUv | None = trained(folder, "net_uv")
    if network is None:
        return None
    px = network.config.input_px

    @torch.inference_mode()
    def find(shape: TrueShape) -> BackwardMap:
        uv = network(shape.code).uv[0].permute(1, 2, 0).numpy()
        return _in_pixels(interpolated(points_of_uv(uv, shape.mask.astype(np.float32)), (px, px)), shape.photo_size)

    return Method("net_uv", find, lambda case: true_shape(case, px), parameters=parameter_count(network))


def _in_pixels(nodes: np.ndarray, size: tuple[int, int]) -> BackwardMap:
    """A map in units of the photo's sides, in its pixels."""
    return BackwardMap(nodes).cropped((0.0, 0.0), (float(size[1]), float(size[0])))


METHODS: dict[str, Callable[[Path | None], Method | None]] = {
    "filmnet": filmnet,
    "hybrid": hybrid_pipeline,
    "firenet": firenet,
    "firenet_multimap": lambda folder: firenet(folder, "firenet_multimap"),
    "firenet_uv_only": lambda folder: firenet(folder, "firenet_uv_only"),
    "dewarpnet": dewarpnet,
    "net_bw": net_bw,
    "net_uv": net_uv,
}
"""How each method is made from a folder of weights; None where its network is not trained."""

__all__ = [
    "METHODS",
    "Flattened",
    "Method",
    "configured",
    "flattened",
    "photo_of_case",
    "trained",
    "trained_dewarpnet",
    "weights_path",
]
