"""The methods that are compared: each finds, in a photo, where every film point is seen, and makes the flat film.

To add a method, write a file with a table ``METHODS`` and name it: ``python -m benchmarks.run --add my_method.py``.

    from benchmarks.methods import Method

    def make(weights):  # a folder with weights, or None
        return Method("mine", find)  # find: (h, w, 3) uint8 RGB -> hybrid.backward.BackwardMap, or None for no film

    METHODS = {"mine": make}

The photo is then read through the map as for every other method. A method that makes its own picture sets ``flatten``.
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
from torch import nn

from benchmarks.claims import Claim, claim_of
from benchmarks.photos.cases import Case, TrueShape, true_shape
from hybrid.backward import BackwardMap
from hybrid.errors import DataError, PhotoError, describe
from hybrid.learn.networks.tensors import first_map
from hybrid.learn.networks.weights import images_shown, load_weights, notes_of, packaged_path, parameter_count
from hybrid.learn.paper.baselines import (
    Recovery,
    corrected,
    dewarpnet_map,
    in_pixels,
    published_image,
    published_map,
    recover,
)
from hybrid.learn.paper.dewarpnet import DewarpNet, joined
from hybrid.learn.paper.uv_recovery import interpolated, points_of_uv
from hybrid.learn.paper.uvbw import NetBw, NetUv
from hybrid.learn.reading.predict import PredictConfig
from hybrid.learn.training.presets import PRESETS, PaperConfig
from hybrid.pipeline import Rectifier, RectifyConfig
from hybrid.records import RectifyResult
from hybrid.rectify.film.resample import rectify_photo
from hybrid.threads import one_thread


def photo_of_case(case: Case) -> Any:
    """What most methods are given: the photo."""
    return case.photo()


@dataclass(frozen=True, eq=False)
class Flattened:
    """What a method makes of a photo.

    backward: its map, in pixels of the photo; None where it finds no film. image: the flat film with its light, RGB.
    film: the same without light, display grey in [0, 1], from methods that remove it. parts: seconds, by part.
    message: what the method says of the photo. grid: the slices that it found, as ROWSxCOLS. claim: what it says of its
    result; None from methods that say nothing.
    """

    backward: BackwardMap | None = None
    image: UInt8[np.ndarray, "h w 3"] | None = None
    film: Float[np.ndarray, "h w"] | None = None
    parts: Mapping[str, float] = field(default_factory=dict)
    message: str = ""
    grid: str = ""
    claim: Claim | None = None


@dataclass(frozen=True)
class Method:
    """One way from a photo to a backward map, and on to the flat film.

    find: returns the map, in pixels of the photo, with the print where the method makes one at the map's resolution (a
    Recovery); returns None (or raises a PhotoError) where no film is found. given: the input of ``find`` and
    ``flatten``, read from a case before the clock starts: by default the photo. flatten: the whole way; None where the
    photo is read through the map as for every other method. says_up: whether the map is meant to be of the film that
    reads right, and not of the film as it lies. parameters: of its network. label: for people. training: of its
    network, in words. unscored: why only its run time means anything; empty for methods that are scored.
    steady: whether the run time hardly depends on the photo, so that a few calls are enough.
    """

    name: str
    find: Callable[[Any], BackwardMap | Recovery | None]
    given: Callable[[Case], Any] = photo_of_case
    flatten: Callable[[Any], Flattened] | None = None
    says_up: bool = False
    parameters: int | None = None
    label: str = ""
    training: str = ""
    unscored: str = ""
    steady: bool = False

    def find_or_lose(self, given: Any) -> BackwardMap | None:
        """The map alone; None for a photo in which no film is found."""
        try:
            found = self.find(given)
        except PhotoError:
            return None
        return None if found is None else map_in(found)


def map_in(found: BackwardMap | Recovery) -> BackwardMap:
    """The map alone, from what a method found."""
    return found.backward if isinstance(found, Recovery) else found


def flattened(method: Method, given: Any, photo: UInt8[np.ndarray, "h w 3"], size: tuple[int, int]) -> Flattened:
    """Run a method from photo to film, of ``size`` (h, w) unless it chooses its own."""
    try:
        if method.flatten is not None:
            return method.flatten(given)
        with one_thread():  # as hybrid does: reading the photo takes all methods equally long
            start = time.perf_counter()
            found = method.find(given)
            until_map = time.perf_counter()
            if found is None:
                return Flattened(parts={"map": until_map - start}, message="no film")
            backward = map_in(found)
            image = rectify_photo(photo, backward, size).image
            film = found.film(size) if isinstance(found, Recovery) else None
            parts = {"map": until_map - start, "resample": time.perf_counter() - until_map}
        return Flattened(backward, image, film, parts)
    except PhotoError as error:
        return Flattened(message=str(error))


def weights_path(folder: Path | None, name: str) -> Path | None:
    """FOLDER/NAME.safetensors, FOLDER/NAME/NAME.safetensors as trainings write it, or the packaged file; else None."""
    packaged = packaged_path(name)
    return path_in(folder, name) or (packaged if packaged.exists() else None)


def path_in(folder: Path | None, name: str) -> Path | None:
    """The weights of a preset, from a folder only; None if they are not there."""
    if folder is None:
        return None
    places = (folder / f"{name}.safetensors", folder / name / f"{name}.safetensors")
    return next((path for path in places if path.exists()), None)


@dataclass(frozen=True, eq=False)
class Trained:
    """A network with its weights, at the width and input size of their file. training: on what, in words."""

    network: Any
    training: str

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return parameter_count(self.network)

    def label(self, of: str) -> str:
        """The name of a row with this network."""
        config = self.network.config
        width = f" at width {config.width:g}" if isinstance(config, PaperConfig) else ""
        return f"{of}, trained{width} ({millions(self.network)})"


def millions(network: nn.Module) -> str:
    """The size of a network, in words."""
    return f"{parameter_count(network) / 1e6:.1f} M parameters"


def trained(folder: Path | None, name: str) -> Trained | None:
    """The network of a preset; None if neither the folder nor the package has its weights.

    Raises:
        DataError: the file holds other weights.
    """
    path = weights_path(folder, name)
    return None if path is None else _loaded(path, name)


def _loaded(path: Path, name: str) -> Trained:
    chosen, notes = PRESETS[name], notes_of(path)
    shown = images_shown(notes)
    seen = "images that its file does not count" if shown is None else f"{shown:,} images"
    of = f" of {', '.join(map(str, notes['data']))}" if notes.get("data") else ""
    network = load_weights(path, chosen.build, type(chosen.config)).eval()
    for part in ("maps", "heads"):
        got, allowed = (getattr(config, part, None) for config in (network.config, chosen.config))
        if got != allowed:
            do = f"Name the file that --preset {name} wrote."
            raise DataError(describe(what=f"{part} of {name}", where=path, got=got, allowed=allowed, do=do))
    return Trained(network, f"trained on {seen}{of}")


# ---------------------------------------------------------------- this project


def filmnet(folder: Path | None) -> Method | None:
    """FilmNet alone: all its looks at the photo, from one side, as refinement starts from them. Uses the packaged one
    if the folder has none."""
    return _filmnet("filmnet", folder, PredictConfig(sides=(0,)), "hybrid, network alone")


def filmnet_one_look(folder: Path | None) -> Method | None:
    """FilmNet's first look, at the whole photo: one pass of a network, as with the paper's."""
    return _filmnet("filmnet_one_look", folder, PredictConfig(looks=1, sides=(0,)), "hybrid, one look of its network")


def _filmnet(name: str, folder: Path | None, looks: PredictConfig, label: str) -> Method | None:
    known = trained(folder, "filmnet")
    if known is None:
        return None
    find = Rectifier(RectifyConfig(weights=path_in(folder, "filmnet"), predict=looks)).network_map
    return Method(name, find, parameters=known.parameters, label=label, training=known.training)


def hybrid_pipeline(folder: Path | None) -> Method | None:
    """The whole pipeline, all stages up to the film without light."""
    return configured("hybrid", RectifyConfig(weights=path_in(folder, "filmnet")))


def configured(name: str, config: RectifyConfig, label: str = "") -> Method:
    """The pipeline with other options."""
    return of_rectifier(name, Rectifier(config), label)


def of_rectifier(name: str, rectify: Callable[[Any], RectifyResult], label: str = "") -> Method:
    """Everything a rectifier makes of a photo, with the seconds of its stages."""

    def flatten(photo: Any) -> Flattened:
        result = rectify(photo)
        parts = {stage.name: stage.seconds for stage in result.stages}
        grid = "" if result.grid is None else f"{result.grid.rows}x{result.grid.cols}"
        claim = claim_of(result, (photo.shape[0], photo.shape[1]))
        return Flattened(result.backward, result.rectified, result.film, parts, str(result.status), grid, claim)

    return Method(name, lambda photo: rectify(photo).backward, flatten=flatten, says_up=True, label=label)


# ---------------------------------------------------------------- baselines

DEWARPNET_DUE = "DewarpNet, its map read rightly"
"""Label of DewarpNet without what its published inference does to its map."""
DEWARPNET_PUBLISHED = "DewarpNet as published"
FIRENET_UV = "FiReNet, by its uv map alone"
"""Label of FiReNet without what its deformation map adds."""


def firenet(folder: Path | None, name: str = "firenet") -> Method | None:
    """FiReNet, or an ablation of it, with its recovery."""
    known = trained(folder, name)
    if known is None:
        return None
    return _of_network(name, "FiReNet", known, lambda photo: recover(known.network, photo))


def firenet_uv(folder: Path | None) -> Method | None:
    """FiReNet by its uv map alone: its deformation map needs more training than there was, and costs more than it
    gains."""
    known = trained(folder, "firenet")
    if known is None:
        return None
    return _of_network("firenet_uv", FIRENET_UV, known, lambda photo: recover(known.network, photo, outline=False))


def trained_dewarpnet(folder: Path | None) -> Trained | None:
    """DewarpNet trained as one, else its two stages joined, else the packaged one; None if there is none."""
    shape, backward = (path_in(folder, f"dewarpnet_{stage}") for stage in ("shape", "bw"))
    if path_in(folder, "dewarpnet") is not None or shape is None or backward is None:
        return trained(folder, "dewarpnet")
    first, second = _loaded(shape, "dewarpnet_shape"), _loaded(backward, "dewarpnet_bw")
    return Trained(joined(first.network, second.network).eval(), f"{second.training}, its stages apart")


def dewarpnet(folder: Path | None) -> Method | None:
    """DewarpNet, given its due: its map read as it is meant, the photo as for every other method."""
    known = trained_dewarpnet(folder)
    if known is None:
        return None
    return _of_network("dewarpnet", DEWARPNET_DUE, known, lambda photo: corrected(known.network, photo))


def dewarpnet_published(weights: Path | None) -> Method | None:
    """DewarpNet run as released, with what weights there are: its error, and the run time at their width."""
    known = trained_dewarpnet(weights)
    if known is None:
        return None
    return Method(
        "dewarpnet_published",
        lambda photo: map_as_published(known.network, photo),
        flatten=lambda photo: flatten_as_published(known.network, photo),
        parameters=known.parameters,
        label=known.label(DEWARPNET_PUBLISHED),
        training=known.training,
    )


def map_as_published(network: DewarpNet, photo: UInt8[np.ndarray, "h w 3"]) -> BackwardMap:
    """Where the released inference reads the photo; its picture is not made."""
    return published_map(dewarpnet_map(network, photo), (photo.shape[0], photo.shape[1]))


def flatten_as_published(network: DewarpNet, photo: UInt8[np.ndarray, "h w 3"]) -> Flattened:
    """The released inference: the map averaged and resized, and a lookup in double precision at the photo's size."""
    backward = dewarpnet_map(network, photo)
    image = published_image(backward, photo)
    found = published_map(backward, (image.shape[0], image.shape[1]))
    return Flattened(found, np.rint(image * 255).astype(np.uint8))


def net_bw(folder: Path | None) -> Method | None:
    """True 3D map -> backward map."""
    known = trained(folder, "net_bw")
    if known is None:
        return None
    network: NetBw = known.network

    @torch.inference_mode()
    def find(shape: TrueShape) -> BackwardMap:
        return in_pixels(BackwardMap(first_map(network(shape.code).backward)), shape.photo_size)

    return _of_network("net_bw", "Net_bw", known, find, _shape_for(network))


def net_uv(folder: Path | None) -> Method | None:
    """True 3D map -> uv map -> backward map by interpolation between the film pixels of the true mask."""
    known = trained(folder, "net_uv")
    if known is None:
        return None
    network: NetUv = known.network
    px = network.config.input_px

    @torch.inference_mode()
    def find(shape: TrueShape) -> BackwardMap:
        uv = first_map(network(shape.code).uv)
        nodes = interpolated(points_of_uv(uv, shape.mask.astype(np.float32)), (px, px))
        return in_pixels(BackwardMap(nodes), shape.photo_size)

    return _of_network("net_uv", "Net_uv", known, find, _shape_for(network))


def _shape_for(network: NetBw | NetUv) -> Callable[[Case], TrueShape]:
    """What a network of 3D maps is given: the true one, at the size of its input."""
    return lambda case: true_shape(case, network.config.input_px)


def _of_network(
    name: str,
    label: str,
    known: Trained,
    find: Callable[[Any], BackwardMap | Recovery | None],
    given: Callable[[Case], Any] = photo_of_case,
) -> Method:
    """A method made of a trained network and a function that finds the map from its output."""
    return Method(name, find, given, parameters=known.parameters, label=known.label(label), training=known.training)


METHODS: dict[str, Callable[[Path | None], Method | None]] = {
    "filmnet_one_look": filmnet_one_look,
    "filmnet": filmnet,
    "hybrid": hybrid_pipeline,
    "firenet": firenet,
    "firenet_uv": firenet_uv,
    "firenet_multimap": lambda folder: firenet(folder, "firenet_multimap"),
    "firenet_uv_only": lambda folder: firenet(folder, "firenet_uv_only"),
    "dewarpnet": dewarpnet,
    "dewarpnet_published": dewarpnet_published,
    "net_bw": net_bw,
    "net_uv": net_uv,
}
"""How each method is made from a folder of weights; None where neither it nor the package has the network's weights."""

__all__ = [
    "DEWARPNET_DUE",
    "DEWARPNET_PUBLISHED",
    "METHODS",
    "Flattened",
    "Method",
    "configured",
    "flatten_as_published",
    "flattened",
    "map_as_published",
    "of_rectifier",
    "path_in",
    "photo_of_case",
    "trained",
    "trained_dewarpnet",
    "weights_path",
]
