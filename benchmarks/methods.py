"""What is compared: each method finds, in a photo, where every film point is seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

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


def photo_of_case(case: Case) -> Any:
    """What most methods are given: the photo."""
    return case.photo()


@dataclass(frozen=True)
class Method:
    """One way from a photo to a backward map.

    find: the map, in pixels of the photo, or None (or a PhotoError) where no film is found. given: what ``find`` takes,
    read from a case before the clock starts: the photo, if nothing else is said. says_up: whether the map is meant to
    be of the film that reads right, and not of the film as it lies. parameters: of its network.
    """

    name: str
    find: Callable[[Any], BackwardMap | None]
    given: Callable[[Case], Any] = photo_of_case
    says_up: bool = False
    parameters: int | None = None

    def find_or_lose(self, given: Any) -> BackwardMap | None:
        """As ``find``, with None for a photo in which no film is found."""
        try:
            return self.find(given)
        except PhotoError:
            return None


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
    return Method("filmnet", Rectifier(RectifyConfig(weights=path)).network_map, parameters=count)


def hybrid_pipeline(folder: Path | None) -> Method | None:
    """The whole pipeline, all stages up to the film without light."""
    rectifier = Rectifier(RectifyConfig(weights=weights_path(folder, "filmnet")))
    return Method("hybrid", lambda photo: rectifier(photo).backward, says_up=True)


# ---------------------------------------------------------------- baselines


def firenet(folder: Path | None, name: str = "firenet") -> Method | None:
    """FiReNet, or an ablation of it, with its recovery."""
    network: FiReNet | None = trained(folder, name)
    if network is None:
        return None
    return Method(name, lambda photo: recover(network, photo).backward, parameters=parameter_count(network))


def dewarpnet(folder: Path | None) -> Method | None:
    """DewarpNet, given its due: trained as one, else its two stages put together."""
    network: DewarpNet | None = trained(folder, "dewarpnet")
    if network is None:
        shape: ShapeNet | None = trained(folder, "dewarpnet_shape")
        backward: BackwardNet | None = trained(folder, "dewarpnet_bw")
        network = None if shape is None or backward is None else joined(shape, backward).eval()
    if network is None:
        return None
    return Method("dewarpnet", lambda photo: corrected(network, photo), parameters=parameter_count(network))


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

__all__ = ["METHODS", "Method", "photo_of_case", "trained", "weights_path"]
