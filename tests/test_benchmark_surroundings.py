"""Surroundings: changes lie around the film, its truth moves with it, and results are counted as they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import benchmarks.surroundings
from benchmarks.photos.cases import Case
from benchmarks.photos.grounds import CHANGES, Sheet
from benchmarks.photos.marks import MARKS
from benchmarks.report.schema import read_record
from benchmarks.report.surroundings_records import Ended, SurroundingsReport
from benchmarks.report.tables import surroundings_table
from benchmarks.surroundings import Options, Rectifiers, Task, counted, main, tasks_of, tried
from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, sample_bilinear
from hybrid.effort import RectifyConfig
from hybrid.errors import ConfigError, DataError
from hybrid.pipeline import Rectifier
from hybrid.records import RectifyResult, Status, StatusCode

SIZE = (240, 300)
MOVING = ("wide", "tall", "small", "turned")
ALL_BUT_LIKE = ("plain", "moved", "rounded")


def sheet(seed: int = 0) -> Sheet:
    """A smooth random photo with a slightly slanted film."""
    rng = np.random.default_rng(seed)
    photo = cv2.GaussianBlur(rng.integers(30, 220, (*SIZE, 3), dtype=np.uint8), (0, 0), 4)
    slant = np.array([[120.0, 10.0 + seed], [-8.0, 140.0]])
    return Sheet(photo, BackwardMap(film_nodes((9, 9)) @ slant + np.array([90.0, 45.0])))


def inner() -> np.ndarray:
    """Film points away from the edge."""
    return 0.06 + 0.88 * film_nodes((25, 25))


@pytest.mark.parametrize("name", [name for name in CHANGES if name != "moved"])
def test_the_film_is_as_it_was_where_the_truth_says(name: str) -> None:
    for seed in range(3):
        before, other = sheet(seed), sheet(seed + 5)
        it = CHANGES[name][1](before, other, np.random.default_rng(seed))
        was = sample_bilinear(before.photo, before.backward.photo_from_film(inner())).astype(float)
        now = sample_bilinear(it.photo, it.backward.photo_from_film(inner())).astype(float)
        assert np.abs(now - was).max() <= (8 if name in MOVING else 0), seed
        expected = 0.72 if name == "turned" else 0.5 if name == "small" else 1.0
        if name in ("small", "turned"):
            sides = np.array(it.backward.mean_film_pixels()) / before.backward.mean_film_pixels()
            assert sides == pytest.approx([it.scale, it.scale])
        assert it.scale == pytest.approx(1.0 if name == "small" else expected)


@pytest.mark.parametrize("name", [name for name in CHANGES if name not in (*MOVING, *ALL_BUT_LIKE)])
def test_what_is_around_the_film_is_changed(name: str) -> None:
    before = sheet()
    it = CHANGES[name][1](before, sheet(5), np.random.default_rng(3))
    apart = np.abs(it.photo.astype(int) - before.photo).max(axis=2) > 8
    assert apart[before.ground == 255].mean() > 0.01
    assert not np.array_equal(it.photo, before.photo)


def test_a_film_beside_is_the_other_one_where_this_one_is_not() -> None:
    before = sheet()
    dark = replace(sheet(5), photo=np.full((*SIZE, 3), 7, np.uint8))
    it = CHANGES["films_around"][1](before, dark, np.random.default_rng(0))
    new = (it.photo == 7).all(axis=2)
    assert new.mean() > 0.15
    assert not new[before.ground == 0].any()
    assert it.photo[:, :60].std() > 0  # the other film's ground is not copied


def test_round_corners_show_ground_and_nothing_else_is_changed() -> None:
    """A rim left along the sides once misled networks more than the corners did."""
    before = sheet()
    dark = replace(before, photo=np.where(before.ground[..., None] == 255, before.photo, np.uint8(5)))
    it = CHANGES["rounded"][1](dark, before, np.random.default_rng(3))
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    corners = before.backward.photo_from_film(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))
    apart = np.hypot(x[..., None] - corners[:, 0], y[..., None] - corners[:, 1])
    changed = np.abs(it.photo.astype(int) - dark.photo).max(axis=2) > 0
    assert changed.any()
    assert apart.min(axis=2)[changed].max() < 10
    film = changed & (dark.photo == 5).all(axis=2)
    assert film.any()
    assert it.photo[film].min() > 5
    assert it.photo[film].max() > 60


def test_motion_leaves_the_film_where_it_is() -> None:
    before = sheet()
    it = CHANGES["moved"][1](before, before, np.random.default_rng(0))
    np.testing.assert_array_equal(it.backward.nodes, before.backward.nodes)
    least = min(
        (float(np.square(np.roll(it.photo, (y, x), (0, 1)).astype(float) - before.photo).mean()), (y, x))
        for y in (-1, 0, 1)
        for x in (-1, 0, 1)
    )
    assert least[1] == (0, 0)


@pytest.mark.parametrize("name", ["labels", "written"])
def test_marks_cover_a_little_of_the_film_and_nothing_else(name: str) -> None:
    for seed in range(3):
        before = sheet()
        it = MARKS[name][1](before, sheet(5), np.random.default_rng(seed))
        assert it.backward is before.backward
        changed = (it.photo != before.photo).any(axis=2)
        assert 0.002 < changed[before.ground == 0].mean() < 0.2
        assert not changed[before.ground == 255].any()


def test_labels_are_bright_and_printed_dark() -> None:
    before = replace(sheet(), photo=np.full((*SIZE, 3), 90, np.uint8))
    it = MARKS["labels"][1](before, before, np.random.default_rng(0))
    assert (it.photo.min(axis=2) > 160).any()
    assert (it.photo.max(axis=2) < 40).any()


def test_flare_only_adds_light() -> None:
    before = sheet()
    it = MARKS["flare"][1](before, before, np.random.default_rng(0))
    added = it.photo.astype(int) - before.photo
    assert added.min() >= 0
    assert added.max() > 20
    np.testing.assert_array_equal(it.backward.nodes, before.backward.nodes)


# ---------------------------------------------------------------- what is found


class Finds(Rectifier):
    """A rectifier that returns the truth, off by a given number of pixels."""

    def __init__(self, task: Task, off: float, code: StatusCode = StatusCode.OK, limit: float | None = 2.0) -> None:
        self.task, self.off, self.code, self.limit = task, off, code, limit

    def network_map(self, photo: np.ndarray) -> BackwardMap | None:
        return self.at(2 * self.off) if Status(self.code).has_film else None

    def __call__(self, photo: np.ndarray) -> RectifyResult:
        if not Status(self.code).has_film:
            return RectifyResult(Status(self.code))
        return RectifyResult(Status(self.code), backward=self.at(self.off), limit_px=self.limit)

    def at(self, off: float) -> BackwardMap:
        true = self.task.made().backward
        return BackwardMap(true.nodes + np.array([off, 0.0]))


def both(finds: Finds) -> Rectifiers:
    """The same rectifier for the network alone and for the pipeline."""
    return Rectifiers(finds, finds)


def task(change: str = "plain") -> Task:
    one, other = sheet(), sheet(5)
    return Task(change, *(Case("a", Path("a"), s.backward, held=lambda s=s: s.photo) for s in (one, other)))


@pytest.mark.parametrize("change", ["plain", "small", "wide"])
def test_errors_are_in_pixels_of_the_photo_before(change: str) -> None:
    told = task(change)
    scale = told.made().scale
    ended = tried(True, both(Finds(told, 1.0)), told)
    assert ended.film_px == pytest.approx(1080 / 300 / scale)
    assert ended.network_px == pytest.approx(2 * 1080 / 300 / scale)
    assert not ended.wrong
    assert tried(False, both(Finds(told, 1.0)), told) == Ended(change, "a", ended.network_px)


@pytest.mark.parametrize(("off", "code", "wrong"), [
    (1.9, StatusCode.OK, False), (2.1, StatusCode.OK, True), (2.1, StatusCode.UNSURE, False),
])  # fmt: skip
def test_a_film_called_ok_is_wrong_beyond_its_limit(off: float, code: StatusCode, wrong: bool) -> None:
    told = task("small")
    assert tried(True, both(Finds(told, off, code)), told).wrong == wrong


def test_a_photo_without_a_film_is_lost() -> None:
    told = task()
    assert tried(True, both(Finds(told, 0.0, StatusCode.NO_FILM)), told) == Ended("plain", "a", None, None, "NO_FILM")


def test_the_network_alone_looks_from_one_side_and_the_pipeline_as_it_always_does() -> None:
    rectifiers = Rectifiers.of(RectifyConfig.of("thorough"))
    assert rectifiers.whole.config == RectifyConfig.of("thorough")
    assert rectifiers.alone.config.predict.sides == rectifiers.whole.config.predict.sides[:1]
    told = task()
    ended = tried(True, Rectifiers(Finds(told, 1.0), Finds(told, 3.0)), told)
    assert (ended.network_px, ended.film_px) == (pytest.approx(2 * 3.6), pytest.approx(3 * 3.6))


def test_counts_are_of_each_change() -> None:
    ended = [
        Ended("plain", "a", 4.0, 0.5, "OK"),
        Ended("plain", "b", 16.0, 2.0, "OK", wrong=True),
        Ended("plain", "c", None, None, "NO_FILM"),
        Ended("checks", "a", 9.0, 8.0, "UNSURE"),
    ]
    plain, checks = counted(ended)
    assert (plain.change, plain.photos, plain.network_found, plain.found) == ("plain", 3, 2, 2)
    assert (plain.network_px, plain.film_px) == (pytest.approx(8.0), pytest.approx(1.0))
    assert (plain.network_to_10, plain.to_1, plain.to_5, plain.ok, plain.wrong) == (1, 1, 2, 2, 1)
    assert (checks.to_5, checks.ok, checks.network_to_10) == (0, 0, 1)
    text = surroundings_table(SurroundingsReport({}, True, (plain, checks), tuple(ended)))
    assert "| as they were | 3 | 8.00 | 1 | 2 | 1.00 | 1 | 2 | 2 (1) |" in text
    assert "`OK`" not in surroundings_table(SurroundingsReport({}, False, (plain,), ()))


# ---------------------------------------------------------------- the command


def test_each_photo_meets_each_change_beside_another_film(dataset: Path, tmp_path: Path) -> None:
    tasks = tasks_of(Options(tmp_path / "a.json", data=(dataset,), only=("checks", "film_beside")))
    assert [one.change for one in tasks] == ["checks"] * 4 + ["film_beside"] * 4
    assert all(one.case.name != one.other.name for one in tasks)
    first, again = tasks[5].made(), tasks[5].made()
    np.testing.assert_array_equal(first.photo, again.photo)


def test_the_command_writes_what_it_counts(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Blind(Rectifier):
        def __init__(self, config: object) -> None: ...

        def network_map(self, photo: np.ndarray) -> None: ...

        def __call__(self, photo: np.ndarray) -> RectifyResult:
            return RectifyResult(Status(StatusCode.NO_FILM))

    monkeypatch.setattr(benchmarks.surroundings, "Rectifier", Blind)
    path = tmp_path / "surroundings.json"
    words = ["--json", str(path), "--data", str(dataset), "--only", "stripes", "--workers", "1", "--every", "2"]
    assert main([*words, "--pictures", str(tmp_path / "drawn")]) == 0
    report = read_record(path, SurroundingsReport)
    assert [(c.change, c.photos, c.found) for c in report.counts] == [("stripes", 2, 0)]
    assert (tmp_path / "drawn" / "surroundings.jpg").exists()
    assert "on a striped cloth" in capsys.readouterr().out


def test_what_cannot_be_done_is_told(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nothing to change"):
        tasks_of(Options(tmp_path / "a.json"))
    with pytest.raises(ConfigError, match="snow"):
        Options(tmp_path / "a.json", data=(dataset,), only=("snow",))
    with pytest.raises(DataError, match="two or more"):
        tasks_of(Options(tmp_path / "a.json", data=(dataset,), every=4))
