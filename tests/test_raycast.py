"""Ray casting: few rays see what many see, slivers and folds included; facets are as fine as the film needs."""

import numpy as np
import pytest

from hybrid.coords import pixel_centres
from hybrid.errors import SimulationError
from hybrid.mesh.camera import Camera, look_at
from hybrid.mesh.film import film_mesh
from hybrid.mesh.raycast import FilmCaster, facet_shape, true_backward_map
from hybrid.round_corners import RoundCorners

SIZE = (150, 180)


def film(shape):
    """A sheet of 430 x 350 mm, bent by ``shape``: (x, y) -> (x, y, z)."""
    mesh = film_mesh((430.0, 350.0), np.linspace(0, 1, 4), np.linspace(0, 1, 5), 3)
    return mesh.bent(np.stack(np.broadcast_arrays(*shape(mesh.vertices[..., 0], mesh.vertices[..., 1])), axis=-1))


SHAPES = {
    "flat": lambda x, y: (x, y, 0.0),
    "waves": lambda x, y: (x, y, 30 * np.sin(x / 60) + 12 * np.cos(y / 80)),
    "rolled over": lambda x, y: (70 * np.sin(x / 70), y, 70 * np.cos(x / 70)),
    "edge on": lambda x, y: (0.02 * x, y, x),
}


def camera(size=SIZE, eye=(60.0, -40.0, -700.0), roll=0.1, distortion=(0.05, -0.02)):
    f = 1.3 * size[1]
    intrinsics = np.array([[f, 0, size[1] / 2 + 3], [0, f, size[0] / 2 - 2], [0, 0, 1.0]])
    return Camera(intrinsics, look_at(np.array(eye), np.zeros(3), np.array([roll, 1.0, 0.0])), distortion, size)


def supersampled(caster, cam, n=8):
    """Coverage and mean of the uv seen in each pixel, by brute force."""
    h, w = cam.size
    mask, uv = caster.uv_map(cam.resized((n * h, n * w)))
    cells = np.where(mask[..., None], uv, 0).reshape(h, n, w, n, 2)
    count = mask.reshape(h, n, w, n).sum(axis=(1, 3))
    return count / n**2, cells.sum(axis=(1, 3)) / np.maximum(count, 1)[..., None]


@pytest.mark.parametrize("corners", [None, RoundCorners(0.12, 0.1)])
@pytest.mark.parametrize("roll", [0.0, 0.7])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_view_is_what_many_rays_see(shape, roll, corners):
    caster, cam = FilmCaster(film(SHAPES[shape]), corners=corners), camera(roll=roll)
    view = caster.view(cam)
    coverage, uv = supersampled(caster, cam)
    assert coverage.max() > 0
    mine = np.zeros(SIZE)
    mine[view.box] = view.coverage
    difference = mine - coverage
    assert np.abs(difference).max() <= 1 / 4  # eight rays against sixty-four
    assert abs(difference.mean()) < 1e-4
    assert set(np.flatnonzero(((coverage > 0) & (coverage < 1))[view.box])) <= set(view.rim)
    assert np.count_nonzero(difference) <= len(view.rim)
    seen = view.uv.copy()
    hits = np.count_nonzero(view.rim_hit, axis=1)
    means = (view.rim_uv * view.rim_hit[..., None]).sum(axis=1) / np.maximum(hits, 1)[:, None]
    seen.reshape(-1, 2)[view.rim] = means
    off = np.abs(seen - uv[view.box]) * [350, 430]  # mm; a pixel is about 3 mm
    inside = mine[view.box] > 0
    inside.flat[view.rim] = False
    assert not inside.any() or off[inside].max() < 0.3
    rim = off.reshape(-1, 2)[view.rim][(hits > 0) & (coverage[view.box].flat[view.rim] > 0)]
    assert np.median(rim) < 1.0  # at a fold, few rays mix the layers slightly differently from many


@pytest.mark.parametrize("shape", SHAPES)
def test_a_view_from_known_maps_is_the_view_that_is_cast(shape):
    caster, cam = FilmCaster(film(SHAPES[shape])), camera(roll=0.3)
    cast, known = caster.view(cam), caster.view(cam, caster.annotate(cam))
    np.testing.assert_array_equal(known.rim_hit, cast.rim_hit)
    assert np.abs(known.coverage - cast.coverage).mean() < 1e-3
    both = (known.coverage > 0) & (cast.coverage > 0)
    both.flat[cast.rim] = False  # rim pixels have the film points of their many rays
    assert np.abs(known.uv - cast.uv)[both].mean() * 430 < 0.05  # mm; a pixel is about 3 mm
    assert known.rays < cast.rays


def test_a_view_takes_far_fewer_rays_than_pixels_have():
    cam = camera((600, 720))
    view = FilmCaster(film(SHAPES["waves"])).view(cam)
    assert view.coverage.sum() > 1e5
    assert view.rays < 0.15 * 4 * 4 * view.coverage.size


def test_a_sliver_between_the_rays_is_seen():
    """A film seen edge on, less than a pixel in width: rays on a 4 px grid may all miss it."""
    caster, cam = FilmCaster(film(SHAPES["edge on"])), camera(eye=(0.0, 0.0, -1500.0))
    view = caster.view(cam)
    coverage, _ = supersampled(caster, cam)
    assert 0 < coverage.sum() < 3 * SIZE[0]
    assert view.coverage.sum() == pytest.approx(coverage.sum(), rel=0.01)


def test_a_film_that_leaves_the_frame_is_cut_off():
    view = FilmCaster(film(SHAPES["flat"])).view(camera(eye=(180.0, 150.0, -400.0)))
    assert view.coverage.shape[0] <= SIZE[0]
    assert (view.coverage[-1] > 0).any() or (view.coverage[0] > 0).any() or (view.coverage[:, 0] > 0).any()


def test_film_behind_the_camera_is_refused():
    caster = FilmCaster(film(SHAPES["waves"]))
    with pytest.raises(SimulationError, match="behind the camera"):
        caster.view(camera(eye=(0.0, 0.0, -10.0)))
    assert caster.annotate(camera(eye=(0.0, 0.0, -10.0))).mask.any()  # rays need no projection


@pytest.mark.parametrize("facet_mm", [0.2, 0.05])
@pytest.mark.parametrize("shape", ["waves", "rolled over"])
def test_facets_keep_to_their_distance_from_the_smooth_film(shape, facet_mm):
    bent = film(SHAPES[shape])
    rows, cols = facet_shape(bent, facet_mm)
    v, u = np.linspace(0, 1, rows), np.linspace(0, 1, cols)
    middle_u, middle_v = (u[1:] + u[:-1]) / 2, (v[1:] + v[:-1]) / 2
    smooth, corners = bent.surface(middle_u, middle_v), bent.surface(u, v)
    facet = (corners[1:, :-1] + corners[:-1, 1:]) / 2  # the diagonal's middle
    off = np.linalg.norm(smooth - facet, axis=-1).max()
    assert 0.1 * facet_mm < off <= 1.1 * facet_mm  # neither too coarse nor wastefully fine


def test_a_film_bent_one_way_is_cut_one_way():
    rows, cols = facet_shape(film(SHAPES["rolled over"]), 0.02)
    assert cols > 4 * rows
    assert facet_shape(film(SHAPES["flat"]), 0.02) == (17, 17)


def test_each_pixel_has_the_value_of_its_own_ray():
    """Compared with the smooth film: its point at a pixel's uv projects to that pixel's centre, at the edge too."""
    bent, cam = film(SHAPES["waves"]), camera()
    maps = FilmCaster(bent).annotate(cam)
    centres = pixel_centres(SIZE)[maps.mask]
    back = true_backward_map(bent, cam, (65, 65)).photo_from_film(maps.uv[maps.mask].astype(np.float64))
    assert np.abs(back - centres).max() < 0.02
    np.testing.assert_allclose(cam.photo_from_camera(maps.xyz[maps.mask].astype(np.float64)), centres, atol=1e-3)
