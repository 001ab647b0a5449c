"""The benchmark: a perfect rectifier scores perfect, a wrong one does not, and the report is complete and anonymous."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.machine import describe_run, relative_command
from benchmarks.photos import load_photo, load_photos
from benchmarks.rectify import FIGURES, Options, by_style, one_line, run, score_photo, table
from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, opencv_from_photo, pixel_centres
from hybrid.errors import DataError
from hybrid.image_io import read_photo, write_rgb
from hybrid.records import RectifyResult, SliceGrid, StageReport, Status, StatusCode

SIZE = (320, 400)
FILM_SIZE = (512, 512)


def true_map(shift: float = 0.0) -> BackwardMap:
    """A slightly bent film that is seen in a 400 x 320 photo."""

    def photo_from_film(uv: np.ndarray) -> np.ndarray:
        u, v = uv[:, 0], uv[:, 1]
        return np.stack([50 + 290 * u + 12 * np.sin(3 * v) + shift, 30 + 250 * v + 18 * u * (1 - u)], axis=-1)

    return BackwardMap.from_function(photo_from_film)


def write_true_photo(folder: Path, name: str, style: str) -> None:
    """A photo with truth: the print (blobs and bars) as the true map shows it, in dim light."""
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
    """A rectifier that knows the truth, off by ``shift`` pixels; it finds no film in a photo that ``fails`` says."""

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


def test_the_truth_scores_perfect(folder: Path) -> None:
    rectify = StandIn()
    score, _ = score_photo(load_photo(folder / "film_a.npz"), rectify, runs=3)
    assert rectify.calls == 3
    assert score.end_point is not None
    assert score.paper is not None
    assert score.end_point.max_px < 1e-3  # the stored lattice is float32
    assert score.paper.raw.psnr > 60
    assert score.paper.raw.ms_ssim > 0.9999
    assert score.print_psnr is not None
    assert score.print_psnr > 30  # what JPEG and two resamplings leave
    assert score.print_psnr == pytest.approx(score.print_psnr_lit, abs=0.1)  # even light: one gain takes it away
    assert (score.grid, score.true_grid, score.style) == ("2x3", "2x3", "rules")
    assert score.stages["network"]["seconds"] == pytest.approx(0.25)  # the median of 0.5, 0.25, 0.17
    assert score.fastest_seconds <= score.seconds


def test_a_shift_is_measured_as_such(folder: Path) -> None:
    score, _ = score_photo(load_photo(folder / "film_a.npz"), StandIn(shift=5.0), runs=1)
    assert score.end_point is not None
    assert score.paper is not None
    assert (score.end_point.mean_px, score.end_point.p95_px) == pytest.approx((5, 5), abs=1e-3)
    assert score.end_point.mean_percent == pytest.approx(100 * 5 / np.hypot(*SIZE), abs=1e-3)
    assert score.paper.deshifted.psnr > score.paper.raw.psnr + 20


def test_report_and_pictures(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "made" / "result.json"
    options = Options(folder, out, pictures=tmp_path / "sheets", runs=1)
    command = ["python -m benchmarks.rectify", "--photos", str(folder), f"--json={out}"]
    run(options, StandIn(shift=1.0), command)
    text = out.read_text()
    report = json.loads(text)
    assert [row["name"] for row in report["photos"]] == ["film_a", "film_bb"]
    assert set(report["summary"]) == {"rules", "none", "all"}
    assert report["summary"]["all"]["end_point_px"]["median"] == pytest.approx(1.0, abs=1e-3)
    assert set(FIGURES) <= set(report["summary"]["all"])
    assert {"command", "machine", "packages", "commit", "threads", "python"} <= set(report["run"])
    assert str(tmp_path) not in text, "no machine's folders in what is published"
    sheet = read_photo(tmp_path / "sheets" / "contact_sheet.jpg")
    assert sheet.std() > 10
    printed = capsys.readouterr().out
    assert "film_bb" in printed
    assert "2 of 2 photos ok; end-point error median 1.00 px, worst 1.00 px" in printed


def test_photos_that_fail_are_counted_and_listed(folder: Path, tmp_path: Path) -> None:
    options = Options(folder, tmp_path / "result.json", pictures=tmp_path, runs=1)
    scores = run(options, StandIn(fails=2), [])  # the warm-up and the first photo
    assert [score.ok for score in scores] == [False, True]
    summary = by_style(scores)["all"]
    assert (summary["ok"], summary["photos"]) == (1, 2)
    assert summary["end_point_px"]["worst"] < 1e-3
    assert "FAILED: No film was found" in table(scores)
    assert one_line(scores).startswith("1 of 2 photos ok")
    none_ok = run(options, StandIn(fails=9), [])
    assert one_line(none_ok) == "0 of 2 photos ok; no film was found in any"


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
