"""The baselines from photo to backward map: DewarpNet as published and with its due, FiReNet with its recovery."""

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
from hybrid.learn.dewarpnet import NODES, DewarpNet
from hybrid.learn.firenet import FiReNet
from hybrid.learn.tensors import first_map, image_batch
from hybrid.learn.uv_recovery import interpolated, joined, points_of_deformation, points_of_uv

# ---------------------------------------------------------------- DewarpNet


def dewarpnet_map(network: DewarpNet, photo: UInt8[np.ndarray, "H W 3"], interpolation: int) -> BackwardMap:
    """The network's backward map in units of the photo's sides; ``interpolation`` (OpenCV's) shrinks the photo."""
    output = _forward(network, network.config.input_px, photo, interpolation)
    return BackwardMap(first_map(output.backward))


def corrected(network: DewarpNet, photo: UInt8[np.ndarray, "H W 3"]) -> BackwardMap:
    """DewarpNet given its due: the photo shrunk without aliasing, its nodes read as nodes (convention 5), in pixels."""
    return in_pixels(dewarpnet_map(network, photo, cv2.INTER_AREA), (photo.shape[0], photo.shape[1]))


def published_points(backward: BackwardMap, size: tuple[int, int]) -> Float[np.ndarray, "h w 2"]:
    """Photo points that the published inference reads for every pixel of a film image of the photo's ``size``.

    backward: in units of the photo's sides. The released network predicts values at the centres of a 128 x 128 film
    image; these are taken from the map first, so that nothing below is the fault of our nodes. Then, as released:
    a 3 x 3 mean, which mirrors the values at the rim and so pulls the outline inwards; a resize as if the map were an
    image, which repeats its rim; and a lookup in which 0 and 1 are the centres of the photo's outermost pixels (the
    meaning of ``grid_sample`` when the code was written), where the training data had them at the photo's sides.
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
    """What FiReNet makes of a photo.

    backward: in pixels of the photo, on as many nodes as the network's maps have pixels. albedo: the print as the
    photo shows it, display grey, the photo squeezed into the network's square. photo_size: (height, width).
    """

    backward: BackwardMap
    albedo: Float[np.ndarray, "n n"]
    photo_size: tuple[int, int]

    def film(self, size: tuple[int, int]) -> Float[np.ndarray, "h w"]:
        """The paper's final output D_ab: the albedo map unwarped, display grey, no finer than the network's maps."""
        n = self.albedo.shape[0]
        return sample_bilinear(self.albedo, rescale_points(self.backward.dense(size), self.photo_size, (n, n)))


def recover(network: FiReNet, photo: UInt8[np.ndarray, "H W 3"]) -> Recovery:
    """FiReNet with its recovery.

    Raises:
        PhotoError: the network finds no film.
    """
    px = network.config.input_px
    output = _forward(network, px, photo, cv2.INTER_AREA)
    points = points_of_uv(first_map(output.uv), torch.sigmoid(output.mask_logit)[0].numpy())
    if output.deformation is not None:
        points = joined(points, points_of_deformation(first_map(output.deformation)))
    size = (photo.shape[0], photo.shape[1])
    return Recovery(in_pixels(BackwardMap(interpolated(points, (px, px))), size), output.albedo[0].numpy(), size)


# ---------------------------------------------------------------- common


@torch.inference_mode()
def _forward(network: torch.nn.Module, px: int, photo: np.ndarray, interpolation: int) -> Any:
    """The network's output for the whole photo, squeezed into its square input."""
    small = image_batch([cv2.resize(photo, (px, px), interpolation=interpolation)])
    network = network.eval().to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    return network(small.contiguous(memory_format=torch.channels_last))  # a tenth quicker on processors, as FilmNet's


def in_pixels(backward: BackwardMap, size: tuple[int, int]) -> BackwardMap:
    """A map in units of the photo's sides, in pixels of a photo of ``size`` (height, width)."""
    return backward.cropped((0.0, 0.0), (float(size[1]), float(size[0])))
