"""Several photos of one film, flattened with small errors and lit differently, become one film without glare."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from itertools import permutations
from pathlib import Path

import cv2
import numpy as np
import pytest
from light_reader import READER, without_light
from PIL import Image
from synthetic_film import FilmDrawing, draw_print

from hybrid.backward import BackwardMap, Orientation
from hybrid.cli import main
from hybrid.coords import film_centres, film_nodes, pixel_from_film, sample_bilinear, srgb_from_linear
from hybrid.errors import FusionError
from hybrid.levels import LevelReader, Levels
from hybrid.metrics import psnr_after_gain_offset
from hybrid.outputs import photo_digest
from hybrid.pipeline import Rectifier
from hybrid.records import RectifyResult, Signs, SliceGrid, Status, StatusCode
from hybrid.rectify.film.resample import rectify_photo
from hybrid.rectify.fusion.fuse import fuse
from hybrid.rectify.fusion.merge import MergeConfig, _blurred, merge
from hybrid.rectify.fusion.register import FuseConfig, phase_shift, register

SIZE = (600, 480)
MARGIN = 12
"""Pixels of the photo around the film."""
DRAWING = FilmDrawing(rows=4, cols=3, rules=False)


@lru_cache
def printed(seed: int = 0) -> np.ndarray:
    """(h, w) display grey of a print."""
    drawn = draw_print(DRAWING, np.random.default_rng(seed)).astype(np.float32) / 255
    return cv2.resize(drawn, SIZE[::-1], interpolation=cv2.INTER_AREA)


def seen(
    spot: tuple[float, float], seed: int = 0, error_px: float = 2.0, film: int = 0, way: int = 0
) -> tuple[np.ndarray, RectifyResult]:
    """A photo of the flat print with clipped glare around ``spot``, and the result by a map with a smooth error."""
    rng = np.random.default_rng(100 + seed)
    u, v = film_centres(SIZE).transpose(2, 0, 1)
    glare = 2.0 * np.exp(-((((u - spot[0]) ** 2 + (v - spot[1]) ** 2) / 0.012) ** 2))
    linear = printed(film).astype(np.float64) ** 2.2 * (0.5 - 0.15 * u * rng.uniform(-1, 1)) + glare
    photo = np.rint(255 * srgb_from_linear(linear))[..., None] + rng.normal(0, 2, (*SIZE, 3))
    photo = np.pad(np.clip(photo, 0, 255).astype(np.uint8), ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)))
    t = np.polynomial.legendre.legvander(np.linspace(-1, 1, 17), 2)
    error = np.einsum("ia,abk,jb->ijk", t, rng.normal(size=(3, 3, 2)), t)
    nodes = MARGIN + pixel_from_film(film_nodes((17, 17)), SIZE) + error * error_px / np.sqrt((error**2).sum(-1).mean())
    turn = Orientation.from_index(way)
    backward = BackwardMap(nodes).turned(turn)
    size = (SIZE[1], SIZE[0]) if turn.turns % 2 else SIZE
    flat = rectify_photo(photo, backward, size)
    lines = film_nodes((DRAWING.rows + 1, DRAWING.cols + 1))
    grid = SliceGrid(DRAWING.rows, DRAWING.cols, lines, lines, 1.0).turned(turn)
    light = without_light(flat.image, flat.valid)
    return photo, RectifyResult(
        Status(StatusCode.OK),
        film=light.film,
        rectified=flat.image,
        backward=backward,
        grid=grid,
        glare=light.glare,
        confidence=light.confidence,
    )


SPOTS = ((0.2, 0.2), (0.8, 0.4), (0.3, 0.85))


def fused(*shown: tuple[np.ndarray, RectifyResult]) -> RectifyResult:
    return fuse([photo for photo, _ in shown], [result for _, result in shown], READER)


def psnr(film: np.ndarray | None, backward: BackwardMap | None) -> float:
    """PSNR of a film against the print, both seen through the film's own map."""
    assert film is not None
    assert backward is not None
    truth = sample_bilinear(printed(), backward.dense(film.shape) - np.float32(MARGIN))
    inner = np.s_[12:-12, 12:-12]
    return psnr_after_gain_offset(film[inner], truth[inner])


def test_glare_in_different_places_vanishes():
    shown = [seen(spot, k) for k, spot in enumerate(SPOTS)]
    result = fused(*shown)
    assert all(one.glare.mean() > 0.02 for _, one in shown if one.glare is not None)
    assert result.glare is not None
    assert not result.glare.any()
    best = max(psnr(one.film, one.backward) for _, one in shown)
    assert psnr(result.film, result.backward) > best + 3
    assert result.stages[-1].name == "fuse"


def test_two_photos_do():
    shown = [seen(spot, k) for k, spot in enumerate(SPOTS[:2])]
    result = fused(*shown)
    assert psnr(result.film, result.backward) > max(psnr(one.film, one.backward) for _, one in shown) + 2


def test_glare_that_stays_in_place_stays_marked():
    (a, first), (b, second) = seen(SPOTS[0], 0), seen(SPOTS[0], 1)
    result = fuse([a, b], [first, second], READER)
    assert result.glare is not None
    assert first.glare is not None
    both = np.count_nonzero(result.glare & first.glare) / np.count_nonzero(result.glare | first.glare)
    assert both > 0.7
    assert result.confidence is not None
    assert (result.confidence[result.glare] == 0).all()


def test_what_hides_the_film_in_one_photo_only_is_not_hidden_in_the_fused_film():
    """Hands cover two photos at different ends: what one hides comes from the other, what both hide stays marked."""
    (a, first), (b, second) = seen(SPOTS[0], 0), seen(SPOTS[0], 1)
    u, v = film_centres(SIZE).transpose(2, 0, 1)
    left, right, both = v > 0.75, v < 0.25, (np.abs(u - 0.8) < 0.1) & (np.abs(v - 0.5) < 0.1)
    result = fuse([a, b], [replace(first, covered=left | both), replace(second, covered=right | both)], READER)
    assert result.covered is not None
    assert result.confidence is not None
    assert result.covered[both].mean() > 0.8
    assert result.covered[left | right].mean() < 0.02
    assert (result.confidence[result.covered] == 0).all()
    inner = np.s_[int(0.8 * SIZE[0]) : -12, 12:-12]
    assert np.median(result.confidence[inner]) > 0.3


def test_registration_finds_the_true_map():
    (_, first), (_, second) = seen(SPOTS[0], 0), seen(SPOTS[1], 1)
    found = register(first, second, FuseConfig())
    assert first.backward is not None
    uv = film_nodes((9, 9))[1:-1, 1:-1]
    error = np.linalg.norm(found.backward.photo_from_film(uv) - first.backward.photo_from_film(uv), axis=-1)
    assert error.mean() < 0.3
    assert second.backward is not None
    before = np.linalg.norm(second.backward.photo_from_film(uv) - first.backward.photo_from_film(uv), axis=-1)
    assert before.mean() > 1.5


def map_error_px(result: RectifyResult) -> float:
    """Mean distance of a film's map from the true one, in pixels of the photo, without the outermost cells."""
    assert result.backward is not None
    uv = film_nodes((9, 9))[1:-1, 1:-1]
    return float(
        np.linalg.norm(result.backward.photo_from_film(uv) - MARGIN - pixel_from_film(uv, SIZE), axis=-1).mean()
    )


def test_the_maps_of_several_photos_together_err_less_than_one():
    shown = [seen(spot, k) for k, spot in enumerate(SPOTS)]
    assert map_error_px(fused(*shown)) < 0.8 * np.mean([map_error_px(one) for _, one in shown])


def test_one_map_of_three_that_is_far_off_does_not_move_the_film_much():
    first, second = seen(SPOTS[0], 0, error_px=0.5), seen(SPOTS[1], 1, error_px=0.5)
    for third in (0.5, 8.0):
        assert map_error_px(fused(first, second, seen(SPOTS[2], 2, error_px=third))) < 1.5
    assert map_error_px(fused(seen(SPOTS[2], 2, error_px=8.0), first, second)) < 1.5


def unsure(shown: tuple[np.ndarray, RectifyResult]) -> tuple[np.ndarray, RectifyResult]:
    return shown[0], replace(shown[1], status=Status(StatusCode.UNSURE), expected_error_px=9.0)


def test_an_unsure_map_does_not_move_a_sure_one():
    sure, other = seen(SPOTS[0], 0, error_px=0.5), unsure(seen(SPOTS[1], 1, error_px=8.0))
    signs = Signs(*[0.9] * 3, True, True, 4, 400.0, 600, *[0.9] * 3, *[0.001] * 3, 0.9, 0.001, True)
    sure = sure[0], replace(sure[1], expected_error_px=0.5, signs=signs)
    for shown in ((sure, other), (other, sure)):
        result = fused(*shown)
        assert map_error_px(result) < 1.5
        assert result.status.ok
        assert result.expected_error_px == pytest.approx(0.5, rel=0.02)  # in pixels of the first photo
        assert "itself unsure" in result.stages[-1].reason
        assert shown[result.photo] is sure
        assert result.signs == sure[1].signs  # the evidence for the status that is given
    result = fused(other, unsure(sure))
    assert result.status.code is StatusCode.UNSURE
    assert result.expected_error_px == pytest.approx(9.0, rel=0.02)


def test_the_grid_is_that_of_the_surest_photo_that_counts():
    first, second = seen(SPOTS[0], 0, error_px=8.0), seen(SPOTS[1], 1, error_px=0.5)
    blind = first[0], replace(unsure(first)[1], grid=None)
    result = fused(blind, second)
    assert result.status.ok
    assert result.grid is not None
    assert (result.grid.rows, result.grid.cols) == (DRAWING.rows, DRAWING.cols)
    lines = MARGIN + pixel_from_film(film_nodes((DRAWING.rows + 1, DRAWING.cols + 1)), SIZE)
    assert np.linalg.norm(result.grid.vertices_photo - lines, axis=-1)[1:-1, 1:-1].mean() < 1.5  # instead of 8 px
    np.testing.assert_allclose(result.backward.photo_from_film(result.grid.vertices), result.grid.vertices_photo)


def test_film_beyond_the_photos_edges_is_no_glare():
    first, second = seen(SPOTS[0], 0), seen(SPOTS[1], 1)
    cut = [photo[:, : SIZE[1] // 2] for photo, _ in (first, second)]
    result = fuse(cut, [first[1], second[1]], READER)
    beyond = result.confidence[:, 3 * SIZE[1] // 4 :]
    assert (beyond == 0).all()
    assert not result.glare[:, 3 * SIZE[1] // 4 :].any()


def test_the_picture_of_a_fused_film_is_what_its_map_reads():
    shown = [seen(spot, k) for k, spot in enumerate(SPOTS[:2])]
    result = fused(*shown)
    assert result.backward is not None
    np.testing.assert_array_equal(result.rectified, rectify_photo(shown[0][0], result.backward, SIZE).image)


@pytest.mark.parametrize("larger", [0, 1])
def test_the_fused_film_is_as_large_as_the_largest(larger: int):
    shown = [seen(spot, k) for k, spot in enumerate(SPOTS[:2])]
    photo, one = shown[larger]
    film, rectified, confidence = (
        cv2.resize(picture, None, fx=2, fy=2) for picture in (one.film, one.rectified, one.confidence)
    )
    glare = np.repeat(np.repeat(one.glare, 2, axis=0), 2, axis=1)
    shown[larger] = photo, replace(one, film=film, rectified=rectified, confidence=confidence, glare=glare)
    it = fused(*shown)
    for picture in (it.film, it.glare, it.confidence, it.covered, it.rectified[..., 0]):
        assert picture.shape == (2 * SIZE[0], 2 * SIZE[1])
    assert psnr(it.film, it.backward) > 25


@pytest.mark.parametrize("width", [1016, 1018, 1019])
def test_a_wide_blur_of_any_size_stays_in_place(width: int):
    """It is computed at a quarter of the size, which is not a whole number of pixels for every width."""
    step = np.zeros((200, width), np.float32)
    step[:, width - 100 :] = 1
    exact = cv2.GaussianBlur(step, (0, 0), 12.0)
    np.testing.assert_allclose(_blurred(step, 12.0), exact, atol=0.02)


@pytest.mark.parametrize("size", [(64, 64), (75, 80), (80, 74), (74, 77)])
def test_a_known_shift_is_found_and_the_pictures_stay_as_they_were(size: tuple[int, int]):
    """64 suits OpenCV's Fourier transform, which then works in place; 74 is transformed as 75, which is odd."""
    noise = np.random.default_rng(0).normal(size=(size[0] + 8, size[1] + 8)).astype(np.float32)
    fixed, moving = noise[4:-4, 4:-4].copy(), noise[1:-7, 6:-2].copy()
    copies = fixed.copy(), moving.copy()
    x, y, _ = phase_shift(fixed, moving)
    assert (x, y) == pytest.approx((-2, 3), abs=0.15)
    np.testing.assert_array_equal(fixed, copies[0])
    np.testing.assert_array_equal(moving, copies[1])


@pytest.mark.parametrize("way", [1, 2, 4])
def test_a_film_that_was_read_another_way_round_is_turned(way: int):
    (_, first), (_, second) = seen(SPOTS[0], 0), seen(SPOTS[1], 1, way=way)
    found = register(first, second, FuseConfig())
    assert found.way.index == Orientation.from_index(way).inverse.index


def test_photos_of_one_film_are_given_one_tone():
    """However differently the network reads their tones: otherwise what one lends to the other would differ in grey."""
    photos, results = zip(*(seen(spot, k) for k, spot in enumerate(SPOTS[:2])), strict=True)
    shares: list[float] = []

    def told(film: np.ndarray, seen: np.ndarray) -> Levels:
        shares.append(0.5 + 0.2 * len(shares))
        return replace(READER.read(film, seen), root_share=shares[-1])

    result = fuse(photos, results, LevelReader(READER.side_px, told))
    tone = float(np.mean(shares[:2]))
    one_tone = LevelReader(READER.side_px, lambda film, seen: replace(READER.read(film, seen), root_share=tone))
    middle = fuse(photos, results, one_tone)
    np.testing.assert_array_equal(result.film, middle.film)


def test_an_unsure_photo_of_something_else_is_left_out_and_no_part_of_the_film():
    shown = [seen(SPOTS[0], 0), unsure(seen(SPOTS[1], 1, film=1)), seen(SPOTS[2], 2)]
    result = fused(*shown)
    assert [(one.photo, one.why) for one in result.left_out] == [(1, "itself unsure, it is not like photo 1")]
    assert result.stages[-1].reason.startswith("2 photos; photo 2 left out: itself unsure, it is not like photo 1; ")
    assert fused(NO_FILM, shown[0]).stages[-1].reason.startswith("1 photo; photo 1 left out")


def test_which_photos_are_left_out_does_not_depend_on_their_order():
    sure, other, blind = seen(SPOTS[0], 0), unsure(seen(SPOTS[1], 1, film=1)), NO_FILM
    for shown in permutations((sure, other, blind)):
        result = fused(*shown)
        assert shown[result.photo] is sure
        assert {id(shown[one.photo]) for one in result.left_out} == {id(other), id(blind)}


NO_FILM = np.zeros((64, 64, 3), np.uint8), RectifyResult(Status(StatusCode.NO_FILM))


def test_photos_without_a_film_are_left_out_wherever_they_stand():
    shown = [seen(spot, k) for k, spot in enumerate(SPOTS[:2])]
    result, without = fused(NO_FILM, shown[0], NO_FILM, shown[1]), fused(*shown)
    np.testing.assert_array_equal(result.film, without.film)
    np.testing.assert_array_equal(result.rectified, without.rectified)
    assert (result.photo, without.photo) == (1, 0)
    assert ([one.photo for one in result.left_out], without.left_out) == ([0, 2], ())
    assert result.made_of("abcd") == ["b", "d"]
    assert "photo 1 left out: no film was found in it; photo 3 left out" in result.stages[-1].reason


def test_photos_that_all_lack_a_film_end_as_the_first():
    assert fused(NO_FILM, NO_FILM) is NO_FILM[1]


def test_the_photo_that_shows_the_film_is_named_where_another_is_refused():
    with pytest.raises(FusionError, match=r"\(photo 3\): got another film than on photo 2"):
        fused(NO_FILM, seen(SPOTS[0], 0), seen(SPOTS[1], 1, film=1))


def test_different_films_are_refused_with_a_reason():
    with pytest.raises(FusionError, match=r"photo 2.*another film.*Leave it out"):
        fused(seen(SPOTS[0], 0), seen(SPOTS[1], 1, film=1))


def test_one_film_merged_with_itself_is_itself():
    film = printed().astype(np.float32)
    nothing, trust = np.zeros(SIZE, bool), np.ones(SIZE, np.float32)
    result = merge([film, film], [nothing, nothing], [trust, trust], MergeConfig())
    np.testing.assert_allclose(result.film, film, atol=1e-5)
    np.testing.assert_allclose(result.shares, 0.5, atol=1e-3)


def test_veiled_photos_do_not_outvote_a_clear_one():
    """Two of three photos, hardly trusted, agree only because light was left on both."""
    film = printed()
    none = np.zeros(film.shape, bool)
    sure, unsure = np.full(film.shape, 0.9, np.float32), np.full(film.shape, 0.3, np.float32)
    veiled = np.clip(film + np.float32(0.3), 0, 1)
    merged = merge([veiled, film, veiled], [none] * 3, [unsure, sure, unsure], MergeConfig()).film
    assert float(np.abs(merged - film).mean()) < 0.01


def test_a_broad_remains_of_light_in_one_of_three_is_left_out():
    film = printed().astype(np.float32)
    u, _ = film_centres(SIZE).transpose(2, 0, 1)
    veiled = (film + 0.3 * (u > 0.6)).astype(np.float32)
    nothing, trust = np.zeros(SIZE, bool), np.ones(SIZE, np.float32)
    less = np.full(SIZE, 0.8, np.float32)
    result = merge([veiled, film, film], [nothing] * 3, [trust, less, less], MergeConfig())
    assert np.abs(result.film - film).mean() < 0.005
    np.testing.assert_allclose(result.confidence[u > 0.7], 0.8, atol=1e-3)  # not that of the photo left out there
    np.testing.assert_allclose(result.confidence[u < 0.5], 1.0, atol=1e-3)


def test_fewer_than_two_photos_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["fuse", str(tmp_path / "one.jpg"), "-o", str(tmp_path)]) == 2
    assert "two or more photos" in capsys.readouterr().err


def test_a_single_source_is_refused_as_such():
    """The letters of its name are not taken for names."""
    with pytest.raises(FusionError, match="one str"):
        Rectifier.fuse(None, "film.jpg")


def test_names_of_some_photos_only_are_refused():
    with pytest.raises(FusionError, match="1 of 2 photos"):
        Rectifier.fuse(None, ["a.jpg", "b.jpg"], ["a"])


def test_the_command_leaves_out_photos_without_a_film_and_says_whose_the_map_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    blank = tmp_path / "blank.png"
    cv2.imwrite(str(blank), np.full((300, 400, 3), 90, np.uint8))
    assert main(["fuse", str(blank), "hybrid/examples/film.jpg", "-o", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "\n  LOOK  blank.png is left out: no film was found in it.\n" in printed
    assert "\n  fuse: 1 photo; blank.png left out" in printed
    record = json.loads((tmp_path / "blank_fused.json").read_text())
    assert (record["photo"], record["map_of"]) == ("film.jpg", "film.jpg")
    assert (record["left_out"], "further_photos" in record) == (["blank.png"], False)
    assert record["photo_sha256"] == photo_digest(Path("hybrid/examples/film.jpg"))
    assert record["photo_size"] == list(cv2.imread("hybrid/examples/film.jpg").shape[:2])
    assert (tmp_path / "blank_fused_side_by_side.jpg").exists()


def test_the_command_fails_where_no_photo_shows_a_film(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    photos = [str(tmp_path / name) for name in ("one.png", "two.png")]
    for photo in photos:
        cv2.imwrite(photo, np.full((300, 400, 3), 90, np.uint8))
    assert main(["fuse", *photos, "-o", str(tmp_path)]) == 1
    assert "" not in capsys.readouterr().out.splitlines()


def test_the_command_writes_one_film(tmp_path: Path):
    example = "hybrid/examples/film.jpg"
    assert main(["fuse", example, example, "-o", str(tmp_path)]) == 0
    assert (tmp_path / "film_fused_film.png").exists()
    stages = json.loads((tmp_path / "film_fused.json").read_text())["stages"]
    assert stages[-1]["name"] == "fuse"


def test_the_command_tells_of_pages_that_are_not_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    example, pages = "hybrid/examples/film.jpg", tmp_path / "pages.tif"
    with Image.open(example) as photo:
        photo.save(pages, save_all=True, append_images=[photo.copy()])
    assert main(["fuse", example, str(pages), "-o", str(tmp_path)]) == 0
    assert "pages.tif is the first of 2 pictures in its file." in capsys.readouterr().out
