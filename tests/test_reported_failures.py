"""Failures that users of other systems report, by their numbers in the project's list.

Numbers that other files test at length: 7 (test_deilluminate), 9 (test_pipeline), 13 (test_pipeline), 15 and 18
(test_metrics), 16 (test_shards, test_views), 20 (test_deilluminate), 28 (test_grid_edit), 29 (test_secondary_captures),
26, 27 and 30 to 33 (the trainer's, the solver's and the generator's tests).
"""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from film_photos import GUTTERS, PHOTO_PX, RULES, Photographed, Shot, film_print, photographed, table

from benchmarks.photos.cases import read_alike
from benchmarks.soak import MEMORY_BOUND, digest, soak
from data_gen.light.rooms import procedural_room
from data_gen.prints.prints import FilmPrint
from hybrid.backward import BackwardMap
from hybrid.coords import film_centres, film_nodes, linear_from_srgb, pixel_centres, sample_bilinear, srgb_from_linear
from hybrid.draw import resized
from hybrid.effort import RectifyConfig
from hybrid.pipeline import Rectifier
from hybrid.records import RectifyResult, StatusCode
from hybrid.rectify.film.size import FilmSizeConfig
from hybrid.rectify.verdict.trust import TrustConfig

OK_PX = 5.0
"""Largest mean error of a film that is called flattened, in pixels of a 1080 px photo."""
SHEET = 19
"""The print in most photos: 4 x 5 slices with rules and legible texts, wider than high."""


@pytest.fixture(scope="module")
def rectifier() -> Rectifier:
    return Rectifier()


@lru_cache(maxsize=16)
def shot(
    seed: int = SHEET, style: tuple[float, float, float] = RULES, text: float = 1.0, **how: object
) -> Photographed:
    return photographed(film_print(seed, style, text), Shot(**how))  # pyright: ignore[reportArgumentType]


@pytest.fixture(scope="module")
def plain(rectifier: Rectifier) -> tuple[Photographed, RectifyResult]:
    """An easy photo of a film with rules, and its result."""
    return shot(), rectifier(shot().photo)


def flat_picture(sheet: FilmPrint, scale: float = 0.8) -> np.ndarray:
    """The print itself as a picture, RGB."""
    small = cv2.resize(sheet.image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.repeat(np.rint(255 * small).astype(np.uint8)[..., None], 3, axis=2)


def blob_on(it: Photographed, ellipse: tuple, soft_px: float) -> np.ndarray:
    """1 inside a blob on the photo, 0 outside: the ellipse is (centre x, y), (half axes), degrees."""
    blob = np.zeros(it.photo.shape[:2], np.float32)
    centre, axes, degrees = ellipse
    cv2.ellipse(blob, tuple(map(round, centre)), tuple(map(round, axes)), degrees, 0, 360, 1.0, -1)
    return cv2.GaussianBlur(blob, (0, 0), soft_px)


def over(it: Photographed, ellipse: tuple, colour: tuple[int, int, int], soft_px: float = 1.5) -> Photographed:
    """The photo with a blob of one colour over it: the ellipse is (centre x, y), (half axes), degrees."""
    blob = blob_on(it, ellipse, soft_px)[..., None]
    mixed = it.photo * (1 - blob) + blob * np.array(colour, np.float32)
    return replace(it, photo=np.clip(np.rint(mixed), 0, 255).astype(np.uint8))


def at_film(it: Photographed, u: float, v: float) -> np.ndarray:
    return it.truth.photo_from_film(np.array([[u, v]]))[0]


def assert_truthful(it: Photographed, result: RectifyResult) -> float:
    """Asserts that a film is given and called flattened only if it is; returns its error in px of a 1080 px photo."""
    assert result.status.has_film, str(result.status)
    assert result.backward is not None
    error = it.error_px(result.backward)
    assert not result.status.ok or error <= OK_PX, f"called flattened, but {error:.1f} px off"
    return error


# ---------------------------------------------------------------- geometry

FLAT_PRINTS = [(1, RULES, 1.0), (2, RULES, 1.0), (1, GUTTERS, 1.0), (4, RULES, 1.0), (8, GUTTERS, 1.0), (7, RULES, 1.0)]
"""By itself, the network would call the last three cut off, or see their ends elsewhere."""


@pytest.mark.parametrize(("seed", "style", "text"), FLAT_PRINTS)
def test_01_a_flat_film_is_left_as_it_is(rectifier: Rectifier, seed: int, style: tuple, text: float) -> None:
    picture = flat_picture(film_print(seed, style, text))
    found = rectifier(picture)
    nodes = film_nodes((33, 33))
    assert found.status.ok
    assert found.backward is not None
    off = found.backward.photo_from_film(nodes) - nodes * np.array(picture.shape[1::-1])
    assert np.linalg.norm(off, axis=-1).max() < 1.0
    assert any(stage.name == "flat" and stage.ran for stage in found.stages)
    assert found.rectified.shape == picture.shape


@pytest.mark.parametrize("stretch", [0.95, 1.03])
def test_01_a_flat_film_whose_cells_are_not_square_is_not_stretched(rectifier: Rectifier, stretch: float) -> None:
    picture = cv2.resize(flat_picture(film_print(1)), None, fx=1.0, fy=stretch, interpolation=cv2.INTER_AREA)
    found = rectifier(picture)
    assert any(stage.name == "flat" and stage.ran for stage in found.stages)
    assert found.rectified.shape == picture.shape


@pytest.mark.parametrize(("seed", "border"), [(2, 0.06), (8, 0.02), (11, 0.02), (11, 0.06)])
def test_01_of_a_scan_with_a_white_border_the_border_is_no_film(rectifier: Rectifier, seed: int, border: float) -> None:
    """Cells are as alike through the picture's frame as through the sheet's map; only the sheet's edges decide."""
    picture = flat_picture(film_print(seed))
    wide = int(border * len(picture))
    found = rectifier(cv2.copyMakeBorder(picture, *(4 * [wide]), cv2.BORDER_CONSTANT, value=(255, 255, 255)))
    nodes = film_nodes((33, 33))
    assert found.backward is not None
    off = found.backward.photo_from_film(nodes) - (nodes * np.array(picture.shape[1::-1]) + wide)
    assert np.linalg.norm(off, axis=-1).mean() < 1.5


@pytest.mark.parametrize(("seed", "style"), [(8, RULES), (8, GUTTERS), (9, GUTTERS)])
def test_04_a_scan_that_lacks_part_of_the_sheet_is_not_called_flattened(
    rectifier: Rectifier, seed: int, style: tuple
) -> None:
    picture = flat_picture(film_print(seed, style))
    found = rectifier(np.ascontiguousarray(picture[:, : int(0.93 * picture.shape[1])]))
    assert found.status.code is StatusCode.UNSURE
    assert any("may lack part of the sheet" in doubt for doubt in found.status.doubts)


def test_01_what_was_flattened_is_left_as_it_is(rectifier: Rectifier, plain) -> None:
    picture = plain[1].rectified
    found = rectifier(picture)
    nodes = film_nodes((33, 33))
    off = found.backward.photo_from_film(nodes) - nodes * np.array(picture.shape[1::-1])
    assert np.linalg.norm(off, axis=-1).max() < 1.0


@pytest.mark.parametrize(("inset", "seed"), [(0.02, 2), (0.035, 19)])
def test_01_a_flat_film_with_a_little_table_around_it_is_cut_out(rectifier: Rectifier, inset: float, seed: int) -> None:
    print_ = flat_picture(film_print(seed, GUTTERS))
    beside = round(inset * max(print_.shape))
    photo = np.full((print_.shape[0] + 2 * beside, print_.shape[1] + 2 * beside, 3), (138, 130, 120), np.uint8)
    photo = np.clip(photo + np.random.default_rng(0).normal(0, 3, photo.shape), 0, 255).astype(np.uint8)
    photo[beside:-beside, beside:-beside] = print_
    found = rectifier(photo)
    nodes = film_nodes((33, 33))
    assert found.backward is not None
    off = found.backward.photo_from_film(nodes) - nodes * np.array(print_.shape[1::-1]) - beside
    assert np.linalg.norm(off, axis=-1).max() < 2.0


@pytest.mark.parametrize("at", [(0.61, 0.5), (0.62, 0.6)])
def test_02_an_edge_or_a_corner_outside_stretches_nothing(rectifier: Rectifier, at: tuple[float, float]) -> None:
    it = shot(fill=0.85, at=at)
    found = rectifier(it.photo)
    assert assert_truthful(it, found) < 10
    nodes = film_nodes((33, 33))
    seen, way = read_alike(found.backward, it.truth)
    assert way.index == 0
    true = it.truth.photo_from_film(nodes)
    outside = (it.truth.photo_from_film(film_centres(found.confidence.shape)) > PHOTO_PX + 5).any(axis=-1)
    assert outside.any()
    assert found.confidence[outside].max() == 0, "what is outside of the photo is not known"
    inside = (true < PHOTO_PX - 15).all(axis=-1)
    areas = [abs(np.linalg.det(m.jacobian(nodes)))[inside] for m in (seen, it.truth)]
    assert np.median(areas[0] / areas[1]) == pytest.approx(1, abs=0.06)


@pytest.mark.parametrize(("colour", "axes"), [((225, 170, 140), (70, 28)), ((20, 20, 24), (45, 40))])
def test_03_a_finger_or_a_clip_over_a_corner_crops_nothing(rectifier: Rectifier, colour, axes) -> None:
    plain = shot()
    it = over(plain, (at_film(plain, 0.97, 0.97), axes, 40.0), colour)
    found = rectifier(it.photo)
    assert assert_truthful(it, found) < 10
    seen, _ = read_alike(found.backward, it.truth)
    corner = seen.photo_from_film(np.array([[1.0, 1.0]]))[0]
    assert np.linalg.norm(corner - at_film(plain, 1.0, 1.0)) < 0.02 * PHOTO_PX


def test_04_a_film_that_touches_all_borders_of_the_photo(rectifier: Rectifier) -> None:
    sheet = film_print(SHEET)
    it = photographed(sheet, Shot(fill=1.0, angle=0.0, roll=(0.0, 0.05)))
    height = round(PHOTO_PX * sheet.size_mm[0] / sheet.size_mm[1])  # the sheet is wider than high
    top = (PHOTO_PX - height) // 2
    it = Photographed(it.photo[top : top + height], it.truth.cropped((0.0, float(top))), it.on_film, it.uv)
    found = rectifier(np.ascontiguousarray(it.photo))
    error = assert_truthful(it, found)
    assert error < 12


@pytest.mark.parametrize("kind", ["dark", "busy"])
def test_05_dark_on_dark_and_on_a_busy_table(rectifier: Rectifier, kind: str) -> None:
    if kind == "dark":
        background = table(24)
    else:
        rng = np.random.default_rng(8)
        background = cv2.resize(
            rng.integers(0, 256, (45, 45, 3)).astype(np.float32), (PHOTO_PX, PHOTO_PX), interpolation=cv2.INTER_NEAREST
        )
    it = photographed(film_print(SHEET), Shot(background=background.astype(np.float64)))
    assert assert_truthful(it, rectifier(it.photo)) < 15


def test_06_glare_at_the_edge_does_not_move_the_outline(rectifier: Rectifier) -> None:
    plain = shot()
    it = over(plain, (at_film(plain, 1.0, 0.5), (60, 40), 20.0), (255, 255, 252), soft_px=6)
    found = rectifier(it.photo)
    assert assert_truthful(it, found) < OK_PX
    seen, _ = read_alike(found.backward, it.truth)
    edge = np.stack([np.ones(21), np.linspace(0, 1, 21)], axis=-1)
    off = np.linalg.norm(seen.photo_from_film(edge) - it.truth.photo_from_film(edge), axis=-1)
    assert off.max() < 0.02 * PHOTO_PX


def test_08_a_film_without_any_text(rectifier: Rectifier) -> None:
    it = shot(1, RULES, 0.0)
    assert assert_truthful(it, rectifier(it.photo)) < OK_PX


def test_12_vertical_lines_come_out_vertical(plain) -> None:
    """The affine map nearest to true film -> found film has at most half a percent of shear or unequal scale."""
    it, found = plain
    seen, _ = read_alike(found.backward, it.truth)
    true_uv = film_nodes((15, 15))[1:-1, 1:-1].reshape(-1, 2)
    found_uv = seen.film_from_photo(it.truth.photo_from_film(true_uv))
    ones = np.column_stack([true_uv, np.ones(len(true_uv))])
    affine, *_ = np.linalg.lstsq(ones, found_uv, rcond=None)
    assert affine[:2] == pytest.approx(np.eye(2), abs=0.005)


# ---------------------------------------------------------------- which side is up


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_13_a_turned_photo_gives_an_upright_film(rectifier: Rectifier, turns: int) -> None:
    found = rectifier(np.ascontiguousarray(np.rot90(shot(4).photo, turns)))
    assert found.orientation is not None
    assert (found.orientation.turns, found.orientation.mirrored) == (turns, False)


def test_14_a_mirrored_film_is_detected(rectifier: Rectifier) -> None:
    """Only where texts can be read: without them, a film seen from behind looks like any other."""
    found = rectifier(np.ascontiguousarray(shot(SHEET).photo[:, ::-1]))
    assert found.orientation is not None
    assert (found.orientation.turns, found.orientation.mirrored) == (0, True)
    assert found.upright_probability > 0.98


# ---------------------------------------------------------------- what comes out


def test_07_clipped_glare_is_marked_and_not_invented(rectifier: Rectifier) -> None:
    plain = shot()
    it = over(plain, (at_film(plain, 0.4, 0.45), (50, 35), 10.0), (255, 255, 255))
    found = rectifier(it.photo)
    assert_truthful(it, found)
    height, width = found.glare.shape
    points = found.backward.photo_from_film(film_nodes((height, width)))
    x, y = (np.clip(points[..., k].astype(int), 0, PHOTO_PX - 1) for k in range(2))
    clipped = it.photo.min(axis=-1)[y, x] >= 254
    core = cv2.erode(clipped.astype(np.uint8), np.ones((9, 9))) > 0
    assert core.sum() > 500
    assert found.glare[core].mean() > 0.95
    assert found.confidence[core & found.glare].max() == 0
    assert found.glare[~cv2.dilate(clipped.astype(np.uint8), np.ones((61, 61))).astype(bool)].mean() < 0.02


@pytest.mark.parametrize("printed", ["nothing", "one slice"])
def test_09_an_empty_film_and_one_slice_end_with_a_sentence(rectifier: Rectifier, printed: str) -> None:
    sheet = film_print(SHEET)
    image = np.full_like(sheet.image, 0.08)
    if printed == "one slice":
        h, w = image.shape[0] // sheet.rows, image.shape[1] // sheet.cols
        image[h : 2 * h, w : 2 * w] = sheet.image[h : 2 * h, w : 2 * w]
    it = photographed(replace(sheet, image=image))
    found = rectifier(it.photo)
    if found.status.has_film:
        assert_truthful(it, found)
    else:
        assert found.status.code in (StatusCode.NO_FILM, StatusCode.FOLDED)
    assert str(found.status).endswith(".")


@pytest.mark.parametrize("size", [(64, 64), (120, 2400), (3000, 3000)])
def test_10_sizes_are_bounded_and_numbers_are_numbers(rectifier: Rectifier, size: tuple[int, int]) -> None:
    found = rectifier(resized(shot().photo, size))
    assert found.status.has_film or size != (3000, 3000)
    if not found.status.has_film:
        assert found.film is None
        return
    most = FilmSizeConfig().max_side_px
    assert max(found.film.shape) <= most
    assert max(found.film.shape) == most or size != (3000, 3000)  # whose film would be larger
    assert min(found.film.shape) >= 1
    for numbers in (found.film, found.confidence, found.backward.nodes, np.array(found.expected_error_px)):
        assert np.isfinite(numbers).all()


def test_11_nothing_is_cut_and_no_resolution_is_lost(plain) -> None:
    it, found = plain
    seen, _ = read_alike(found.backward, it.truth)
    rim = np.concatenate([film_nodes((33, 33))[0], film_nodes((33, 33))[-1]])
    beside = seen.film_from_photo(it.truth.photo_from_film(0.5 + 0.98 * (rim - 0.5)))
    assert np.isfinite(beside).all(), "all but a hundredth of the true film is on the found one"
    down, across = it.truth.mean_film_pixels()
    assert found.film.shape[0] >= 0.97 * down
    assert found.film.shape[1] >= 0.97 * across


def test_17_there_and_back_is_less_than_half_a_pixel(plain) -> None:
    """Warping the flat film back into the photo gives the photo, as far as the film reaches."""
    it, found = plain
    size = found.rectified.shape[:2]
    uv = found.backward.film_from_photo(pixel_centres((PHOTO_PX, PHOTO_PX))[::9, ::9].reshape(-1, 2))
    on = np.isfinite(uv).all(axis=1)
    points = found.backward.dense(size)
    at = np.clip((uv[on] * np.array(size[::-1])).astype(int), 0, np.array(size[::-1]) - 1)
    photo_points = pixel_centres((PHOTO_PX, PHOTO_PX))[::9, ::9].reshape(-1, 2)[on]
    step = np.sqrt(np.prod(it.truth.mean_film_pixels()) / np.prod(size))  # photo pixels per film pixel
    assert on.sum() > 1000
    assert np.linalg.norm(points[at[:, 1], at[:, 0]] - photo_points, axis=1).max() < 0.5 * np.sqrt(2) * step * 1.2
    again = found.backward.photo_from_film(uv[on])
    assert np.linalg.norm(again - photo_points, axis=1).max() < 0.01


def test_19_dark_film_is_not_inverted_and_black_stays_black(plain) -> None:
    found = plain[1]
    sheet = film_print(SHEET).image
    print_at = cv2.resize(sheet, found.film.shape[::-1], interpolation=cv2.INTER_AREA)
    assert np.corrcoef(found.film.ravel(), print_at.ravel())[0, 1] > 0.7
    black = cv2.erode((print_at < 0.1).astype(np.uint8), np.ones((9, 9))) > 0
    assert np.median(found.film[black]) < 0.12
    assert np.quantile(found.film[black], 0.9) < 0.25


def test_20_coloured_light_leaves_no_trace_and_grey_stays_in_order(rectifier: Rectifier, plain) -> None:
    """Under a warm lamp the film is the same grey film, and what is brighter in the print is brighter in the film."""
    warm = shot(light=(1.0, 0.82, 0.6))
    found = rectifier(warm.photo)
    assert_truthful(warm, found)
    size = plain[1].film.shape[::-1]
    assert np.corrcoef(cv2.resize(found.film, size).ravel(), plain[1].film.ravel())[0, 1] > 0.9
    print_at = cv2.GaussianBlur(cv2.resize(film_print(SHEET).image, size, interpolation=cv2.INTER_AREA), (0, 0), 4)
    film = cv2.GaussianBlur(plain[1].film, (0, 0), 4)
    steps = [np.median(film[(print_at >= low) & (print_at < low + 0.1)]) for low in (0.0, 0.1, 0.2, 0.3, 0.4)]
    assert all(np.diff(steps) > 0), steps


@pytest.mark.parametrize(("soft_px", "most"), [(4.0, 0.7), (20.0, 0.55)])
def test_22_a_cast_shadow_is_removed_in_part(rectifier: Rectifier, plain, soft_px: float, most: float) -> None:
    """A hand, near (sharp) or far (soft), takes 60 % of the light; at most the given share of its ghost may stay."""
    it, bright = plain
    shadow = blob_on(it, (at_film(it, 0.35, 0.6), (170, 110), 30), soft_px)
    dark = srgb_from_linear(linear_from_srgb(it.photo / 255.0) * (1 - 0.6 * shadow[..., None]))
    shaded = replace(it, photo=np.rint(255 * dark).astype(np.uint8))
    found = rectifier(shaded.photo)
    assert_truthful(shaded, found)
    size = found.film.shape
    on_film = sample_bilinear(shadow, found.backward.photo_from_film(film_centres(size)))
    film, lit = (cv2.resize(x, size[::-1]) for x in (bright.film, bright.rectified.mean(axis=2) / 255))
    printed = film > 0.15

    def ghost(after: np.ndarray, before: np.ndarray) -> float:
        """How much darker the print is in the shadow than beside it, relative to the print without a shadow."""
        inside, outside = (
            float(after[k].sum() / before[k].sum()) for k in (printed & (on_film > 0.9), printed & (on_film < 0.1))
        )
        return 1 - inside / outside

    left, was = ghost(found.film, film), ghost(found.rectified.mean(axis=2) / 255, lit)
    assert was > 0.25
    assert left < most * was


def document() -> np.ndarray:
    """Black lines of type on white paper on a table."""
    rng = np.random.default_rng(2)
    photo = table(110).astype(np.uint8)[:540, :420].copy()
    photo[60:480, 60:360] = 235
    for y in range(85, 460, 14):
        for x in range(80, 330, 9):
            if rng.random() < 0.8:
                cv2.putText(photo, chr(97 + int(rng.integers(26))), (x, y), cv2.FONT_HERSHEY_PLAIN, 0.8, (40,) * 3, 1)
    return photo


def room() -> np.ndarray:
    """A crop of the generator's own room."""
    radiance = procedural_room(np.random.default_rng(4)).radiance[60:190, 100:300]
    return np.clip(255 * (radiance / np.quantile(radiance, 0.97)) ** 0.45, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("make", [document, room])
def test_21_what_is_no_film_is_refused_with_a_reason(rectifier: Rectifier, make) -> None:
    found = rectifier(resized(make(), (540, 540)))
    assert not found.status.has_film
    assert found.film is None
    assert "film" in str(found.status)


def test_23_points_of_the_film_lead_back_to_the_photo(plain) -> None:
    """The result's own maps agree to less than a pixel, and rules of the print lie where the photo shows them."""
    it, found = plain
    inner = found.grid.vertices[1:-1, 1:-1]
    assert np.abs(found.backward.photo_from_film(inner) - found.grid.vertices_photo[1:-1, 1:-1]).max() < 1e-6
    uv = np.random.default_rng(0).uniform(0.02, 0.98, (200, 2))
    assert np.abs(found.backward.film_from_photo(found.backward.photo_from_film(uv)) - uv).max() * PHOTO_PX < 1
    sheet = film_print(SHEET)
    assert (found.grid.rows, found.grid.cols) == (sheet.rows, sheet.cols)
    true = it.truth.photo_from_film(sheet.vertices[1:-1, 1:-1])
    assert np.linalg.norm(found.grid.vertices_photo[1:-1, 1:-1] - true, axis=-1).mean() < 1


# ---------------------------------------------------------------- many times


def test_24_many_films_in_flat_memory(rectifier: Rectifier) -> None:
    """The list's thousand are run by ``python -m benchmarks.soak``; thirty small ones also show what keeps a result."""
    results = []

    def watched(photo: np.ndarray) -> RectifyResult:
        result = rectifier(photo)
        results.append(weakref.ref(result))
        return result

    photos = [resized(shot().photo, (160, 160)), resized(shot(1, RULES, 0.0).photo, (160, 160))]
    soak(rectifier, photos, 6)
    memory, _, different = soak(watched, photos, 30)
    assert different == 0
    assert memory[-1] / memory[0] - 1 < MEMORY_BOUND
    gc.collect()
    assert len(results) == 30
    assert not any(result() for result in results)


def test_25_another_rectifier_gives_the_same_bits(plain) -> None:
    assert digest(Rectifier()(plain[0].photo)) == digest(plain[1])


def test_a_status_that_is_not_sure_still_gives_the_film(plain) -> None:
    it, known = plain
    found = Rectifier(RectifyConfig(tries=0, trust=TrustConfig(safety=1e-3)))(it.photo)
    assert found.status.code is StatusCode.UNSURE
    assert found.status.doubts
    assert found.film is not None
    assert found.expected_error_px == known.expected_error_px > 0
    assert isinstance(found.backward, BackwardMap)
