"""FiReNet's recovery: exact where linear interpolation is, and what the deformation map adds at the rim."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from paper_case import film_from_photo, flat_case, photo_from_film
from scipy.interpolate import griddata
from torch import nn

from hybrid.coords import film_centres, film_nodes
from hybrid.errors import PhotoError
from hybrid.learn.paper.baselines import recover
from hybrid.learn.paper.firenet import FiReNet, FiReNetConfig, FiReNetOutput
from hybrid.learn.paper.uv_recovery import (
    MASK_LEVEL,
    ScatteredPoints,
    interpolated,
    joined,
    points_of_deformation,
    points_of_uv,
)

PX = 64
FLOAT32 = 1e-6  # uv and deformation are handed over in float32


def maps_of(photo_from_film_, film_from_photo_) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """uv (PX, PX, 2), mask and deformation of a film, as a perfect network would give them."""
    uv = film_from_photo_(film_centres((PX, PX)))
    mask = ((uv > 0) & (uv < 1)).all(axis=-1)
    nodes = film_nodes((PX, PX))
    deformation = photo_from_film_(nodes) - nodes
    return np.where(mask[..., None], uv, 0).astype(np.float32), mask.astype(float), deformation.astype(np.float32)


def bent(uv: np.ndarray) -> np.ndarray:
    """A film bowed sideways: x is bent by v, y is as in the flat case."""
    xy = photo_from_film(uv)
    return np.stack([xy[..., 0] + 0.08 * np.sin(np.pi * uv[..., 1]), xy[..., 1]], axis=-1)


def from_bent(xy: np.ndarray) -> np.ndarray:
    """The inverse by fixed-point steps: the bow moves points by an eighth of the film at the most."""
    uv = film_from_photo(xy)
    for _ in range(60):
        uv = film_from_photo(xy - (bent(uv) - photo_from_film(uv)))
    return uv


def test_a_flat_film_comes_back_exactly_with_its_edges():
    uv, mask, deformation = maps_of(photo_from_film, film_from_photo)
    points = joined(points_of_uv(uv, mask), points_of_deformation(deformation))
    nodes = interpolated(points, (33, 17))
    np.testing.assert_allclose(nodes, photo_from_film(film_nodes((33, 17))), atol=FLOAT32)


def test_without_the_deformation_map_the_rim_is_filled_by_the_nearest_point():
    uv, mask, _ = maps_of(photo_from_film, film_from_photo)
    nodes = interpolated(points_of_uv(uv, mask), (33, 33))
    error = np.linalg.norm(nodes - photo_from_film(film_nodes((33, 33))), axis=-1)
    assert error[2:-2, 2:-2].max() < FLOAT32
    assert 0.1 / PX < error[0].max() < 2 / PX  # within two pixels, but not exact


def test_the_deformation_map_adds_four_corners_and_three_points_an_edge():
    points = points_of_deformation(maps_of(bent, from_bent)[2])
    assert len(points.film) == 4 + 4 * 3
    on_edge = (points.film == 0) | (points.film == 1)
    assert on_edge.any(axis=1).all()
    assert on_edge.all(axis=1).sum() == 4
    np.testing.assert_allclose(points.photo, bent(points.film), atol=FLOAT32)


def test_the_deformation_map_lowers_the_error_of_a_bent_film():
    uv, mask, deformation = maps_of(bent, from_bent)
    true = bent(film_nodes((33, 33)))
    alone = interpolated(points_of_uv(uv, mask), (33, 33))
    filled = interpolated(joined(points_of_uv(uv, mask), points_of_deformation(deformation)), (33, 33))
    for lines in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        assert np.abs(filled - true)[lines].mean() < np.abs(alone - true)[lines].mean()
    assert np.abs(filled - true)[3:-3, 3:-3].max() < 0.1 / PX


def test_one_triangulation_gives_what_the_authors_four_calls_give():
    uv, mask, deformation = maps_of(bent, from_bent)
    points = joined(points_of_uv(uv, mask), points_of_deformation(deformation))
    nodes = film_nodes((21, 21))
    for axis in range(2):
        linear, nearest = (griddata(points.film, points.photo[:, axis], nodes, method=m) for m in ("linear", "nearest"))
        theirs = np.where(np.isnan(linear), nearest, linear)
        np.testing.assert_allclose(interpolated(points, (21, 21))[..., axis], theirs, atol=1e-12)


def test_only_pixels_above_the_published_level_count():
    uv, mask, _ = maps_of(photo_from_film, film_from_photo)
    count = int(mask.sum())
    assert len(points_of_uv(uv, mask * (MASK_LEVEL + 0.01)).film) == count
    assert len(points_of_uv(uv, mask * (MASK_LEVEL - 0.01)).film) == 0


@pytest.mark.parametrize("count", [0, 2, 50])
def test_points_that_span_no_area_are_refused_with_a_reason(count):
    line = np.linspace(0, 1, count)[:, None] * np.ones((1, 2))
    with pytest.raises(PhotoError, match="span no area"):
        interpolated(ScatteredPoints(line, line), (5, 5))


class _Knowing(FiReNet):
    """A FiReNet that has learnt one film by heart."""

    def __init__(self) -> None:
        nn.Module.__init__(self)
        self.config, self.found = FiReNetConfig(input_px=PX), 9.0

    def forward(self, image):
        _, t = flat_case(PX, PX, batch=1)
        logit = torch.where(t.mask, self.found, -9.0)
        deformation = t.deformation if self.found > 0 else None
        return FiReNetOutput(logit, t.xyz, t.uv, t.albedo, t.normal, t.depth, deformation)


def test_from_photo_to_backward_map_and_film():
    photo = np.zeros((200, 300, 3), dtype=np.uint8)
    recovery = recover(_Knowing(), photo)
    uv = film_centres((9, 7))
    # The square around the photo has sides of 300 pixels, of which 50 lie above the photo and 50 below.
    np.testing.assert_allclose(recovery.backward.photo_from_film(uv), photo_from_film(uv) * 300 - [0, 50], atol=0.01)
    # The print has 4 x 4 even cells: their centres in the film are what the albedo map shows at their photo points.
    _, targets = flat_case(PX, PX, batch=1)
    at = np.floor(photo_from_film(film_centres((4, 4))) * PX).astype(int)
    np.testing.assert_allclose(recovery.film((4, 4)), targets.albedo[0].numpy()[at[..., 1], at[..., 0]], atol=1e-5)


def test_a_photo_without_film_is_refused_with_a_reason():
    network = _Knowing()
    network.found = -9.0
    with pytest.raises(PhotoError, match="span no area"):
        recover(network, np.zeros((20, 30, 3), dtype=np.uint8))
