"""The baselines, from photo to backward map: DewarpNet as published and corrected, FiReNet with its recovery."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import (
    film_nodes,
    photo_from_opencv,
    pixel_from_film,
    rescale_points,
    sample_bilinear,
    sample_photo,
)
from hybrid.learn.networks.tensors import first_map, image_batch
from hybrid.learn.paper.dewarpnet import NODES, DewarpNet
from hybrid.learn.paper.firenet import FiReNet
from hybrid.learn.paper.uv_recovery import interpolated, joined, points_of_deformation, points_of_uv
from hybrid.learn.reading.views import view_image, whole_view

# ---------------------------------------------------------------- DewarpNet


def dewarpnet_map(network: DewarpNet, photo: UInt8[np.ndarray, "H W 3"]) -> BackwardMap:
    """The network's map of a photo resized to its square input, as released, in units of the photo's sides."""
    px = network.config.input_px
    return BackwardMap(first_map(_answer(network, cv2.resize(photo, (px, px))).backward))


def corrected(network: DewarpNet, photo: UInt8[np.ndarray, "H W 3"]) -> BackwardMap:
    """DewarpNet corrected, in pixels: the photo is shown as in training, nodes are read as nodes (convention 5)."""
    view = whole_view((photo.shape[0], photo.shape[1]))
    output = _answer(network, view_image(photo, view, network.config.input_px))
    return _in_photo(BackwardMap(first_map(output.backward)), view)


def published_points(backward: BackwardMap, size: tuple[int, int]) -> Float[np.ndarray, "h w 2"]:
    """Photo points that the published inference reads for every pixel of a film image of the photo's ``size``.

    backward: in units of the photo's sides. The released network predicts values at the centres of a 128 x 128 film
    image; the map is first sampled there, so that our nodes cause none of the errors below. Then follow, as released, a
    3 x 3 mean, which mirrors the values at the rim and so pulls the outline inwards; a resize as if the map were an
    image, which repeats its rim; and a lookup in which 0 and 1 are the centres of the photo's outermost pixels (the
    meaning of ``grid_sample`` when the code was written), whereas the training data put them at the photo's sides.
    """
    height, width = size
    blurred = cv2.blur(backward.dense((NODES, NODES)), (3, 3))
    resized = cv2.resize(blurred, (width, height), interpolation=cv2.INTER_LINEAR)
    return photo_from_opencv(resized.astype(np.float64) * np.array([width - 1, height - 1]))


def published_image(backward: BackwardMap, photo: UInt8[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """The film image that the published inference makes: of the photo's size, sRGB in [0, 1], in double precision.

    256 px image -> 3D map -> 128 x 128 map (``backward``, in units of the photo's sides) -> mean -> resize -> bilinear
    lookup.
    """
    points = published_points(backward, (photo.shape[0], photo.shape[1]))
    image = torch.from_numpy(photo).permute(2, 0, 1)[None].double().div_(255)
    return first_map(sample_photo(image, torch.from_numpy(points)[None]))


def published_map(backward: BackwardMap, size: tuple[int, int]) -> BackwardMap:
    """What ``published_points`` reads in a photo of ``size``, at the nodes of a film, edges included."""
    blurred = cv2.blur(backward.dense((NODES, NODES)), (3, 3))
    at = pixel_from_film(film_nodes((NODES, NODES)), (NODES, NODES))
    read = np.stack([sample_bilinear(np.ascontiguousarray(blurred[..., k]), at) for k in range(2)], axis=-1)
    return BackwardMap(photo_from_opencv(read.astype(np.float64) * np.array([size[1] - 1, size[0] - 1])))


# ---------------------------------------------------------------- FiReNet


@dataclass(frozen=True, eq=False)
class Recovery:
    """FiReNet's result for a photo, which it sees as in training: in the smallest square around it.

    seen: its map in units of the square's sides, on as many nodes as the network's maps have pixels. albedo: the print
    as the square shows it, display grey. view: the square, in pixels of the photo.
    """

    seen: BackwardMap
    albedo: Float[np.ndarray, "n n"]
    view: BackwardMap

    @property
    def backward(self) -> BackwardMap:
        """The map in pixels of the photo."""
        return _in_photo(self.seen, self.view)

    def film(self, size: tuple[int, int]) -> Float[np.ndarray, "h w"]:
        """The paper's final output D_ab: the albedo map unwarped at the network's resolution and then enlarged, in
        display grey."""
        maps = self.albedo.shape
        flat = sample_bilinear(self.albedo, rescale_points(self.seen.dense(maps), (1, 1), maps))
        return cv2.resize(flat, size[::-1], interpolation=cv2.INTER_LINEAR)


def recover(network: FiReNet, photo: UInt8[np.ndarray, "H W 3"], outline: bool = True) -> Recovery:
    """FiReNet with its recovery. outline: also use the points of its deformation map, if it has one.

    Raises:
        PhotoError: the network finds no film.
    """
    px, view = network.config.input_px, whole_view((photo.shape[0], photo.shape[1]))
    output = _answer(network, view_image(photo, view, px))
    points = points_of_uv(first_map(output.uv), torch.sigmoid(output.mask_logit)[0].numpy())
    if outline and output.deformation is not None:
        points = joined(points, points_of_deformation(first_map(output.deformation)))
    return Recovery(BackwardMap(interpolated(points, (px, px))), output.albedo[0].numpy(), view)


# ---------------------------------------------------------------- common


@torch.inference_mode()
def _answer(network: torch.nn.Module, image: UInt8[np.ndarray, "px px 3"]) -> Any:
    """The network's output for an image of its input's size."""
    network = network.eval().to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    batch = image_batch([image])
    return network(batch.contiguous(memory_format=torch.channels_last))  # a tenth faster on CPUs, as with FilmNet


def _in_photo(backward: BackwardMap, view: BackwardMap) -> BackwardMap:
    """Convert a map in units of a view's sides to pixels of the photo."""
    return BackwardMap(view.photo_from_film(backward.nodes))


def in_pixels(backward: BackwardMap, size: tuple[int, int]) -> BackwardMap:
    """Convert a map in units of the photo's sides to pixels of a photo of ``size`` (height, width)."""
    return backward.cropped((0.0, 0.0), (float(size[1]), float(size[0])))
