"""What the survey lets through and what it refuses, and the film's size."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from bent_sheets import bent_sheet, flat_sheet_seen, maps_of, smooth_noise

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, pixel_centres
from hybrid.records import CoarseMaps, SliceGrid, StatusCode
from hybrid.rectify.coarse.homography import apply_homography, survey_plane
from hybrid.rectify.coarse.invert import fit_backward
from hybrid.rectify.film.deilluminate import survey_light
from hybrid.rectify.film.size import FilmSizeConfig, film_size, known_by_plane, snap_aspect
from hybrid.rectify.verdict.survey import mask_overlap, survey_maps, survey_photo, survey_print


def verdict(maps: CoarseMaps):
    return survey_maps(maps, fit_backward(maps), (1024, 1024))


def noise_maps(rng: np.random.Generator, correlation: float) -> CoarseMaps:
    """Maps of a network that saw something film-like where there is nothing: blobs of mask, wandering uv."""
    fields = smooth_noise(rng, (64, 64), correlation, 1.0), smooth_noise(rng, (64, 64), correlation, 1.0)
    uv = 0.5 + 0.3 * fields[0]
    points = pixel_centres((64, 64)) * 16.0
    mask = (fields[1][..., 0] > 0).astype(np.float64)
    return CoarseMaps(mask, uv, np.zeros((64, 64, 3)), np.zeros((64, 64)), points)


def test_photos_that_show_nothing_are_refused():
    assert survey_photo(np.full((200, 300, 3), 90, np.uint8)).code is StatusCode.BLANK
    assert survey_photo(np.zeros((40, 3000, 3), np.uint8)).code is StatusCode.TOO_SMALL
    rng = np.random.default_rng(0)
    assert survey_photo(rng.integers(0, 255, (200, 300, 3), dtype=np.uint8)).ok


@pytest.mark.parametrize("bend", [0.0, 0.9])
def test_a_film_is_a_film_also_in_a_noisy_map(bend: float):
    maps = maps_of(BackwardMap.from_function(bent_sheet(bend)))
    assert verdict(maps).ok
    noise = smooth_noise(np.random.default_rng(3), (64, 64), 3.0, 0.01)
    found = verdict(replace(maps, uv=maps.uv + noise))
    assert found.ok, found.reason


def test_a_film_partly_outside_the_picture_is_a_film():
    photo = bent_sheet(0.5)
    assert verdict(maps_of(BackwardMap.from_function(lambda uv: photo(uv) + np.array([260.0, 0.0])))).ok


def test_of_a_film_that_lies_largely_outside_the_photo_it_is_said_so():
    """The picture that the network saw reaches beyond the photo, and shows nothing there."""
    maps = maps_of(BackwardMap.from_function(bent_sheet(0.5)))
    shown = maps.photo_points[..., 0] < 600
    seen = replace(maps, mask=np.where(shown, maps.mask, 0.0))
    inversion = fit_backward(maps)
    assert survey_maps(maps, inversion, (1024, 600)).ok
    assert survey_maps(seen, inversion, (1024, 600)).code is StatusCode.CUT_OFF
    assert survey_maps(seen, inversion, (1024, 1024)).code is StatusCode.NO_FILM


@pytest.mark.parametrize("correlation", [0.7, 2.0, 5.0, 10.0, 20.0])
def test_noise_is_never_a_film(correlation: float):
    rng = np.random.default_rng(4)
    for _ in range(20):
        found = verdict(noise_maps(rng, correlation))
        assert not found.ok, found.reason
        assert found.reason


def test_a_face_like_blob_is_not_a_film():
    """Round mask, uv that grows from the middle over only part of the range: what a network makes of a pale oval."""
    x, y = (pixel_centres((64, 64)) / 64.0 - 0.5).transpose(2, 0, 1)
    mask = ((x / 0.25) ** 2 + (y / 0.35) ** 2 < 1).astype(np.float64)
    uv = np.stack([0.5 + 0.5 * x, 0.5 + 0.5 * y], axis=-1)
    maps = CoarseMaps(mask, uv, np.zeros((64, 64, 3)), np.zeros((64, 64)), pixel_centres((64, 64)) * 16)
    assert verdict(maps).code is StatusCode.NO_FILM


def test_a_folded_map_is_named():
    points = pixel_centres((64, 64)) * 16.0
    maps = maps_of(BackwardMap.from_function(bent_sheet(0.3)))
    folded = BackwardMap.from_function(lambda uv: 300 + 500 * np.stack([np.sin(2.2 * uv[..., 0]), uv[..., 1]], -1))
    result = fit_backward(replace(maps, photo_points=points))
    found = survey_maps(replace(maps, photo_points=points), replace(result, backward=folded), (1024, 1024))
    assert not found.ok


def test_overlap_of_the_true_outline_is_nearly_one():
    true = BackwardMap.from_function(bent_sheet())
    maps = maps_of(true)
    assert mask_overlap(maps, true) > 0.93
    assert mask_overlap(maps, true.cropped((400.0, 0.0))) < 0.6


def test_a_plane_is_found_and_a_bend_is_not_called_one():
    homography = np.array([[600.0, 40.0, 150.0], [-50.0, 700.0, 200.0], [0.1, -0.05, 1.0]])
    flat = BackwardMap(apply_homography(homography, film_nodes((33, 33)).reshape(-1, 2)).reshape(33, 33, 2))
    decision, found = survey_plane(flat, 1e-3)
    assert decision.yes
    np.testing.assert_allclose(found.nodes, flat.nodes, atol=1e-6)
    assert not survey_plane(BackwardMap.from_function(bent_sheet(0.6)), 0.015)[0].yes


def test_even_light_is_even():
    gain, veil = np.ones((8, 8)), np.full((8, 8), 0.1)
    ramp = np.linspace(0, 1, 64).reshape(8, 8)
    assert survey_light(gain, veil, 0.03).yes
    assert not survey_light(gain + 0.2 * ramp, veil, 0.03).yes
    assert not survey_light(gain, veil + 0.1 * ramp, 0.03).yes


@pytest.mark.parametrize("aspect", [0.75, 1.0, 1.25, 1.5])
@pytest.mark.parametrize("focal", [0.7, 1.1, 2.0])
def test_the_ratio_of_a_flat_sheets_sides_comes_from_perspective_and_not_from_its_view(aspect: float, focal: float):
    """Seen obliquely from above and from one side, through any lens, in a photo of any size."""
    size = (768, 1024)
    flat = BackwardMap.from_function(flat_sheet_seen(aspect, focal, (0.6, 0.5, 0.2), size))
    down, across = flat.mean_film_pixels()
    assert abs(down / across / aspect - 1) > 0.1  # its view alone suggests another ratio
    assert known_by_plane(flat, size)[0] == pytest.approx(aspect, rel=0.01)
    larger = flat.cropped((0.0, 0.0), (3.0, 3.0))
    assert known_by_plane(larger, (3 * 768, 3 * 1024))[0] == pytest.approx(known_by_plane(flat, size)[0])


def test_the_ratio_of_a_flat_sheets_sides_from_the_front_needs_no_focal_length():
    """Without perspective the lens is unknown, but every lens gives the same ratio."""
    size = (1024, 768)
    for focal in (0.7, 3.0):
        flat = BackwardMap.from_function(flat_sheet_seen(1.37, focal, (0.0, 0.0, 0.4), size))
        assert known_by_plane(flat, size)[0] == pytest.approx(1.37, rel=1e-4)
        height, width = film_size(flat, size, None)
        assert height / width == pytest.approx(1.37, rel=2e-3)  # it is flat: exact, not snapped to a format


def test_the_ratio_of_a_bent_sheets_sides_is_nearly_that_of_the_nearest_plane():
    photo = bent_sheet(0.5, aspect=1.25, tilt=0.4)
    assert known_by_plane(BackwardMap.from_function(photo), (1024, 1024))[0] == pytest.approx(1.25, rel=0.06)


def test_aspect_snaps_to_square_cells_before_formats():
    config = FilmSizeConfig()
    assert snap_aspect(1.24, None, config) in (pytest.approx(43 / 35), pytest.approx(1.25))
    assert snap_aspect(1.6, None, config) == 1.6
    nodes = film_nodes((7, 5))
    grid = SliceGrid(6, 4, nodes, nodes, confidence=0.9)
    assert snap_aspect(1.46, grid, config) == pytest.approx(1.5)
    assert snap_aspect(1.25, grid, config) == pytest.approx(1.25)


def test_a_ratio_of_sides_that_is_known_exactly_is_hardly_changed():
    config = FilmSizeConfig()
    assert snap_aspect(1.235, None, config) == pytest.approx(43 / 35)
    assert snap_aspect(1.20, None, config) == pytest.approx(1.2)
    assert snap_aspect(1.18, None, config) == pytest.approx(1.2)
    assert snap_aspect(1.18, None, config, exact=True) == 1.18
    true = BackwardMap.from_function(bent_sheet(0.5))
    height, width = film_size(true, (1024, 1024), None, aspect=1.37)
    assert height / width == pytest.approx(1.37, rel=2e-3)


def test_size_holds_the_photo_and_stays_bounded():
    true, photo_size = BackwardMap.from_function(bent_sheet(0.5)), (1024, 1024)
    height, width = film_size(true, photo_size, None)
    down, across = true.mean_film_pixels()
    assert height >= down - 1
    assert width >= across - 1
    huge = true.cropped((0.0, 0.0), (50.0, 50.0))
    assert max(film_size(huge, photo_size, None)) == FilmSizeConfig().max_side_px
    tiny = true.cropped((0.0, 0.0), (0.01, 0.01))
    assert min(film_size(tiny, photo_size, None)) == FilmSizeConfig().min_side_px
    assert max(film_size(huge, photo_size, None, FilmSizeConfig(min_side_px=64, max_side_px=64))) == 64


def test_survey_takes_a_photo_of_any_shape():
    wide = cv2.resize(np.arange(256, dtype=np.uint8)[None].repeat(3, 0).T[None], (2000, 70))
    assert survey_photo(np.ascontiguousarray(wide.reshape(70, 2000, 3))).ok


@pytest.mark.parametrize(("paper", "okay"), [(False, True), (True, False)])
def test_bright_print_on_dark_is_film_and_dark_type_on_bright_is_paper(paper: bool, okay: bool):
    rng = np.random.default_rng(6)
    photo = np.full((400, 400, 3), 12, np.uint8)
    for y in range(30, 390, 18):
        cv2.putText(
            photo, "".join(rng.choice(list("ABCDEF 123"), 24)), (20, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (230,) * 3
        )
    whole = BackwardMap(film_nodes((4, 4)) * 400.0)
    found = survey_print(255 - photo if paper else photo, whole)
    assert found.ok is okay
    assert ("paper" in found.reason) is paper
    assert survey_print(np.full((400, 400, 3), 90, np.uint8), whole).ok
