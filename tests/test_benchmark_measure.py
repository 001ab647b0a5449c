"""Photos with truth: a perfect rectifier scores perfect, a wrong one does not, and run records are anonymous."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.claims import Claim
from benchmarks.machine import describe_run, relative_command
from benchmarks.measure import measure, peak_memory
from benchmarks.methods import Method, of_rectifier
from benchmarks.photos.cases import Case, photo_cases
from benchmarks.photos.truth import load_photo, load_photos
from benchmarks.report.traits import note_of
from hybrid.backward import BackwardMap, Orientation
from hybrid.coords import film_nodes, opencv_from_photo, pixel_centres
from hybrid.errors import DataError
from hybrid.image_io import write_rgb
from hybrid.records import RectifyResult, SliceGrid, StageReport, Status, StatusCode

SIZE = (320, 400)
FILM_SIZE = (512, 512)


def true_map(shift: float = 0.0) -> BackwardMap:
    """The map of a slightly bent film in a 400 x 320 photo."""

    def photo_from_film(uv: np.ndarray) -> np.ndarray:
        u, v = uv[:, 0], uv[:, 1]
        return np.stack([50 + 290 * u + 12 * np.sin(3 * v) + shift, 30 + 250 * v + 18 * u * (1 - u)], axis=-1)

    return BackwardMap.from_function(photo_from_film)


def write_true_photo(folder: Path, name: str, style: str) -> None:
    """Writes a photo with truth: the print (blobs) as seen through the true map, in dim light."""
    rng = np.random.default_rng(len(name))
    blobs = cv2.resize(rng.random((24, 24)).astype(np.float32), (640, 640), interpolation=cv2.INTER_CUBIC)
    texture = np.clip(blobs * 255, 0, 255).astype(np.uint8)
    (folder / "textures").mkdir(exist_ok=True)
    write_rgb(folder / "textures" / f"film_7_2x3_{style}_m0.png", np.repeat(texture[:, :, None], 3, axis=2))
    film_points = true_map().film_from_photo(pixel_centres(SIZE))
    at = opencv_from_photo(np.nan_to_num(film_points, nan=-1.0).astype(np.float32) * 640)
    photo = cv2.remap(texture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    write_rgb(folder / f"{name}.jpg", np.repeat((0.7 * photo).astype(np.uint8)[:, :, None], 3, axis=2))
    lattice = true_map().photo_from_film(film_nodes((41, 41))).astype(np.float32)
    np.savez(
        folder / f"{name}.npz", lattice=lattice, texture=f"film_7_2x3_{style}_m0.png", meta=json.dumps({"seed": 7})
    )


class StandIn:
    """A rectifier that returns the truth, off by ``shift`` pixels; it finds no film in its first ``fails`` calls."""

    def __init__(self, shift: float = 0.0, fails: int = 0) -> None:
        self.shift, self.fails, self.calls = shift, fails, 0

    def __call__(self, photo: np.ndarray) -> RectifyResult:
        self.calls += 1
        stages = (
            StageReport("network", True, "always", 0.5 / self.calls),
            StageReport("spline", False, "no grid", 0.0),
        )
        if self.calls <= self.fails:
            return RectifyResult(Status(StatusCode.NO_FILM), stages)
        backward = true_map(self.shift)
        at = opencv_from_photo(backward.dense(FILM_SIZE))
        rectified = cv2.remap(photo, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        film = (rectified[..., 0] / (0.7 * 255)).astype(np.float32)
        vertices = film_nodes((3, 4))
        grid = SliceGrid(2, 3, vertices, backward.photo_from_film(vertices), 1.0)
        return RectifyResult(Status(StatusCode.OK), stages, film, rectified, backward, grid, glare=film > 0.99)


@pytest.fixture(scope="module")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    write_true_photo(folder, "film_a", "rules")
    write_true_photo(folder, "film_bb", "none")
    return folder


@pytest.fixture
def folder(made_once: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made_once, tmp_path / "photos"))


@pytest.fixture
def case(made_once: Path) -> Case:
    return photo_cases(made_once)[0]


def method_of(rectify: StandIn) -> Method:
    return of_rectifier("stand_in", rectify)


def test_the_truth_scores_perfect(case: Case) -> None:
    rectify = StandIn()
    found = measure(method_of(rectify), case, 0.128, repeats=3, warm=True)
    assert rectify.calls == len(found.seconds) == 3
    assert found.score is not None
    assert found.film is not None
    assert found.score.end_point_px < 1e-3  # the stored lattice is float32
    assert found.score.paper.raw.psnr > 60
    assert found.score.paper.raw.ms_ssim > 0.9999
    assert found.film.psnr is not None
    assert found.film.psnr > 30  # what JPEG and two resamplings leave
    assert found.film.psnr == pytest.approx(found.film.lit_psnr, abs=0.1)  # even light: one gain removes it
    assert found.parts["network"] == pytest.approx(0.25)  # the median of 0.5, 0.25, 0.17
    assert (found.grid, found.output, found.sides) == ("2x3", FILM_SIZE, 0.0)
    note = note_of(case)
    assert (note.grid, note.style, note.size) == ("2x3", "rules", SIZE)


def test_a_shift_is_measured_as_such(case: Case) -> None:
    found = measure(method_of(StandIn(shift=5.0)), case, 0.128, repeats=1, warm=True)
    assert found.score is not None
    px = 5 * 1080 / max(SIZE)  # as in a photo of 1080 px
    assert (found.score.end_point_px, found.score.end_point_p95_px) == pytest.approx((px, px), abs=1e-2)
    assert found.score.paper.deshifted.psnr > found.score.paper.raw.psnr + 20


@pytest.mark.parametrize("way", [Orientation(0, False), Orientation(1, False), Orientation(3, True)])
def test_a_film_that_is_flattened_to_another_shape_is_off_by_that(way: Orientation, case: Case) -> None:
    """This includes a film that is given on its side."""

    def rectify(photo: np.ndarray) -> RectifyResult:
        wide = np.ascontiguousarray(way.moved(np.zeros((400, 500, 3), np.uint8)))
        return RectifyResult(Status(StatusCode.UNSURE), rectified=wide, backward=true_map().turned(way))

    assert case.sheet_ratio == 1.0
    found = measure(of_rectifier("wide", rectify), case, 0.128, repeats=1, warm=True)
    assert found.score is not None
    assert found.score.end_point_px < 1e-3  # this error does not show it
    assert found.sides == pytest.approx(np.log(1.25))
    told = measure(Method("told", lambda photo: true_map()), case, 0.128, repeats=1, warm=True)
    assert told.sides is None


def test_a_film_that_is_not_found_has_no_score_and_a_reason(case: Case) -> None:
    found = measure(method_of(StandIn(fails=9)), case, 0.128, repeats=1, warm=True)
    assert (found.found, found.score, found.film, found.output) == (False, None, None, None)
    assert "No film was found" in found.message


@pytest.mark.parametrize(("shift", "code", "wrong"), [(1.9, "OK", False), (2.1, "OK", True), (2.1, "UNSURE", False)])
def test_a_film_called_ok_that_is_off_by_more_than_the_limit_is_wrongly_so(
    shift: float, code: str, wrong: bool, case: Case
) -> None:
    def rectify(photo: np.ndarray) -> RectifyResult:
        return RectifyResult(Status(StatusCode[code]), backward=true_map(shift), expected_error_px=0.5, limit_px=2.0)

    found = measure(of_rectifier("says", rectify), case, 0.128, repeats=1, warm=True)
    scale = 1080 / max(SIZE)  # as in a photo of 1080 px
    assert found.claim == Claim(code, 0.5 * scale, 2.0 * scale)
    assert found.wrongly_ok == wrong
    assert measure(Method("silent", lambda photo: true_map()), case, 0.128, repeats=1, warm=True).claim is None


def test_a_photo_in_memory_is_everyones_own(case: Case) -> None:
    held = case.in_memory()
    photo = held.photo()
    photo[:] = 0
    np.testing.assert_array_equal(held.photo(), case.photo())


def test_folder_without_truth(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(DataError, match=r"No photos with truth.*Name a folder"):
        load_photos(tmp_path)
    (folder / "film_a.jpg").unlink()
    with pytest.raises(DataError, match=r"incomplete.*film_a\.jpg"):
        load_photos(folder)
    (folder / "film_bb.npz").write_bytes(b"no archive")
    with pytest.raises(DataError, match=r"Truth cannot be read.*film_bb\.npz"):
        load_photo(folder / "film_bb.npz")


def test_command_shows_no_absolute_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "a" / "b")
    inside, beside, far = tmp_path / "a" / "b" / "x.json", tmp_path / "a" / "photos", tmp_path / "c" / "photos"
    command = relative_command(["python -m x", "--a", str(far), f"--b={beside}", "--c", str(inside), "-d", "plain"])
    assert command == "python -m x --a .../photos --b=../photos --c x.json -d plain"


def test_run_is_described() -> None:
    described = describe_run(["python -m x"])
    json.dumps(described)
    assert described["machine"]["usable_processors"] >= 1
    assert described["packages"]["numpy"] == np.__version__


def test_real_photos_are_read() -> None:
    shared = os.environ.get("HYBRID_SHARED_DATA")
    if shared is None:
        pytest.skip("HYBRID_SHARED_DATA names no folder of real data")
    truths = load_photos(Path(shared) / "photos")
    for truth in truths:
        assert {truth.style} <= {"none", "rules", "gutter"}
        assert not truth.backward.folds()
    scores = truths[0].read().shape, truths[0].read_print().shape
    assert scores[0] == (1080, 1080, 3)


def _empty_case() -> Case:
    return Case("empty", Path("none"), true_map(), held=np.zeros((3000, 4000, 3), np.uint8).copy)


def _idle() -> Method:
    return Method("idle", lambda photo: None)


def _told() -> Method:
    return Method("told", lambda known: None, lambda case: (case.photo(), case.photo().shape))


@pytest.mark.parametrize("make", [_idle, _told])
def test_the_photo_is_not_counted_as_a_methods_memory(make: Callable[[], Method]) -> None:
    found = peak_memory(_empty_case, make, 12.0, threads=1)
    if found is None:
        pytest.skip("the system does not tell how much memory a process takes")
    assert found.own_mib < 8
