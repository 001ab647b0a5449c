"""Film before a background: comparison with brute force, the film's edge, and energy in the reduced print."""

import numpy as np
import pytest
from test_raycast import SHAPES, SIZE, camera, film

from data_gen.render.composite import at_photo_scale, composite, film_radiance_at, on_film, print_levels
from data_gen.render.shade import FilmLight
from hybrid.mesh.raycast import FilmCaster, true_backward_map


def flat_light(gain=(1.0, 0.8, 0.5), veil=(0.1, 0.2, 0.3), n=8):
    return FilmLight(*(np.broadcast_to(np.float32(c), (n, n, 3)).copy() for c in (gain, veil)))


def grid_print(size=(896, 768)):
    """Rules every 64 pixels and a ramp between them."""
    image = np.tile(np.linspace(0.1, 0.5, size[1], dtype=np.float32), (size[0], 1))
    image[::64] = image[:, ::64] = 1.0
    return image


@pytest.mark.parametrize("shape", ["waves", "rolled over"])
def test_a_photo_is_the_mean_of_many_rays(shape):
    caster, cam = FilmCaster(film(SHAPES[shape])), camera()
    levels, light = print_levels(grid_print()), flat_light()
    behind = np.full((*SIZE, 3), 2.0, np.float32)
    reflectance = at_photo_scale(levels.reflectance, true_backward_map(caster.film, cam).mean_film_pixels())
    photo = composite(caster.view(cam), reflectance, light, behind.copy())
    n, (h, w) = 6, SIZE
    mask, uv = caster.uv_map(cam.resized((n * h, n * w)))
    fine = film_radiance_at(np.where(mask[..., None], uv, np.float32(0)), levels.reflectance[1], light)
    brute = np.where(mask[..., None], fine, 2.0).reshape(h, n, w, n, 3).mean(axis=(1, 3))
    off = np.abs(photo - brute)
    assert off.mean() < 0.004
    assert np.quantile(off, 0.99) < 0.06
    assert off.max() < 0.5  # a rule is 1 against 0.01


def test_the_rim_is_film_and_background_by_their_shares_and_nothing_else():
    """A white film before black: each pixel shows its coverage, with no darker or brighter seam."""
    view = FilmCaster(film(SHAPES["waves"])).view(camera(roll=0.4))
    white = np.ones((64, 64), np.float32)
    photo = composite(view, white, flat_light((1, 1, 1), (0, 0, 0)), np.zeros((*SIZE, 3), np.float32))
    np.testing.assert_allclose(photo[view.box], np.repeat(view.coverage[..., None], 3, axis=-1), atol=1e-6)
    same = composite(view, white, flat_light((1, 1, 1), (0, 0, 0)), np.ones((*SIZE, 3), np.float32))
    np.testing.assert_allclose(same, 1.0, atol=1e-6)


@pytest.mark.parametrize("film_px", [(90.0, 70.0), (300.0, 400.0), (2000.0, 1500.0)])
def test_reduced_prints_keep_their_mean_light_and_their_places(film_px):
    levels = print_levels(grid_print())
    reduced = at_photo_scale(levels.reflectance, film_px)
    assert reduced.mean() == pytest.approx(levels.reflectance[0].mean(), rel=0.02)
    ramp = np.tile(np.linspace(0, 1, 512, dtype=np.float32), (512, 1))
    at = np.array([[[0.25, 0.5], [0.5, 0.5], [0.75, 0.5]]], np.float32)
    (seen,) = on_film([at_photo_scale((ramp,), film_px)], at)
    np.testing.assert_allclose(seen.ravel(), [0.25, 0.5, 0.75], atol=2e-3)
