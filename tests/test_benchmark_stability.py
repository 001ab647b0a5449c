"""Stability and soak: the truth follows the damage, failures are counted as such, and an interrupted run resumes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kept_results import refused_elsewhere

import benchmarks.soak
import benchmarks.stability
from benchmarks.photos.cases import sample_cases
from benchmarks.photos.damage import DAMAGES, Damaged, cut_file, damaged, visible_error_px
from benchmarks.report.schema import problems, schema_of
from benchmarks.report.stress_records import DamagedPhoto, Part, SoakReport, StabilityReport
from benchmarks.scenes.problems import PROBLEMS, End, ended, part_of, random_sheet
from benchmarks.soak import digest, soak
from benchmarks.stability import TRUTHFUL_PX, Options, _cut_off, _rectified, run
from hybrid.backward import BackwardMap
from hybrid.coords import sample_bilinear
from hybrid.errors import ConfigError, DataError, PhotoError
from hybrid.image_io import read_photo
from hybrid.records import RectifyResult, Status, StatusCode
from hybrid.rectify.verdict.trust import REFERENCE_PX

SIZE = (240, 320)


def sheet() -> BackwardMap:
    return BackwardMap.from_function(lambda uv: np.array([60.0, 40.0]) + uv * np.array([200.0, 150.0]))


def ramp() -> np.ndarray:
    """A photo whose red and green values encode the position."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([x * 0.75, y, np.full_like(x, 90)], axis=-1).astype(np.uint8)


# ---------------------------------------------------------------- damage


@pytest.mark.parametrize("name", ["crop", "rotate", "resize"])
def test_damage_to_the_geometry_moves_the_truth_with_it(name: str) -> None:
    for seed in range(4):
        it = DAMAGES[name](Damaged(ramp(), sheet()), np.random.default_rng(seed))
        if it.photo.shape[0] * it.photo.shape[1] > 4e6 or min(it.photo.shape[:2]) < 60:
            continue
        middle = np.array([[[0.5, 0.5], [0.45, 0.55]]])
        points = it.backward.photo_from_film(middle)
        if not ((points > 2) & (points < np.array(it.photo.shape[1::-1]) - 2)).all():
            continue
        before = sample_bilinear(ramp(), sheet().photo_from_film(middle)).astype(float)
        assert np.abs(sample_bilinear(it.photo, points).astype(float) - before).max() < 3


def test_damage_is_reproducible_and_spares_its_input() -> None:
    photo = ramp()
    first, second = (damaged(photo, sheet(), np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first.photo, second.photo)
    np.testing.assert_array_equal(photo, ramp())
    kinds = {
        kind for seed in range(40) for kind in damaged(ramp()[::4, ::4], sheet(), np.random.default_rng(seed)).kinds
    }
    assert kinds == set(DAMAGES)


def test_cut_files_are_not_whole(tmp_path: Path) -> None:
    for seed in range(12):
        path = tmp_path / f"{seed}.jpg"
        path.write_bytes(cut_file(ramp(), np.random.default_rng(seed)))
        with pytest.raises(PhotoError):
            read_photo(path)


def test_only_what_is_in_the_photo_counts() -> None:
    true = sheet()
    moved = BackwardMap(true.nodes + np.array([3.0, 4.0]))
    assert visible_error_px(moved, true, SIZE) == pytest.approx(5)
    assert visible_error_px(moved, true, (100, 100)) == pytest.approx(5)
    assert visible_error_px(moved, true, (20, 20)) == float("inf")


# ---------------------------------------------------------------- statuses


def moved(off: float) -> BackwardMap:
    """The film, shifted right by a given number of pixels."""
    return BackwardMap(sheet().nodes + np.array([off, 0.0]))


class Says:
    """A rectifier that finds the film a given number of pixels off, or fails as told."""

    def __init__(
        self,
        off: float = 0.0,
        film: float = 0.5,
        error: Exception | None = None,
        code: StatusCode = StatusCode.OK,
    ) -> None:
        self.off, self.film, self.error, self.code = off, film, error, code

    def __call__(self, photo: np.ndarray) -> RectifyResult:
        if self.error is not None:
            raise self.error
        film = np.full((8, 8), self.film, np.float32)
        return RectifyResult(Status(self.code), film=film, backward=moved(self.off), confidence=film)


def refuses(photo: np.ndarray) -> RectifyResult:
    return RectifyResult(Status(StatusCode.NO_FILM))


@pytest.mark.parametrize(
    ("rectify", "outcome"),
    [
        (Says(), "ok"),
        (Says(off=4.9), "ok"),
        (Says(off=5.1), "untruthful"),
        (Says(film=np.nan), "nan"),
        (Says(film=1.5), "nan"),
        (Says(error=PhotoError("no photo")), "refused"),
        (Says(error=ZeroDivisionError()), "crash"),
        (Says(off=5.1, code=StatusCode.UNSURE), "unsure"),
        (Says(off=0.1, code=StatusCode.UNSURE), "unsure"),
        (Says(film=np.nan, code=StatusCode.UNSURE), "nan"),
        (Says(off=1e9, code=StatusCode.UNSURE), "unsure"),
        (refuses, "refused"),
    ],
)
def test_every_end_is_told_apart(rectify, outcome: str) -> None:
    it = Damaged(ramp(), sheet(), kinds=("noise",))
    assert _rectified(0, it, rectify, lambda photo: None).outcome == outcome


@pytest.mark.parametrize(("off", "shift", "outcome"), [(4.9, 0, "lost"), (5.1, 0, "refused"), (0.0, -150, "refused")])
def test_a_refusal_of_a_film_that_was_there_and_right_is_a_loss(off: float, shift: int, outcome: str) -> None:
    """This does not hold if much of the sheet lies outside the photo: ``shift`` moves it to the left."""
    it = Damaged(ramp(), sheet().cropped((float(-shift), 0.0)))
    found = BackwardMap(it.backward.nodes + np.array([off, 0.0]))
    assert it.visible_share() == pytest.approx(1.0 if shift == 0 else 0.55, abs=0.02)
    assert _rectified(0, it, refuses, lambda photo: found).outcome == outcome


@pytest.mark.parametrize("code", [StatusCode.NO_FILM, StatusCode.CUT_OFF, StatusCode.FOLDED, StatusCode.BLANK])
def test_refusals_of_every_kind_may_be_losses_but_of_a_photo_that_shows_nothing(code: StatusCode) -> None:
    refused = _rectified(0, Damaged(ramp(), sheet()), lambda photo: RectifyResult(Status(code)), lambda photo: sheet())
    assert refused.outcome == ("refused" if code is StatusCode.BLANK else "lost")


def test_a_film_that_is_read_the_other_way_up_is_where_it_is() -> None:
    upside_down = BackwardMap(sheet().nodes[::-1, ::-1])
    film = np.full((8, 8), 0.5, np.float32)
    result = RectifyResult(Status(StatusCode.OK), film=film, backward=upside_down, confidence=film)
    assert _rectified(0, Damaged(ramp(), sheet()), lambda photo: result, lambda photo: None).outcome == "ok"


def test_half_a_file_that_is_taken_for_a_film_is_untruthful(dataset: Path) -> None:
    case, rng = sample_cases([dataset])[0], np.random.default_rng(0)
    for rectify, outcome in ((Says(), "untruthful"), (refuses, "refused"), (Says(error=ZeroDivisionError()), "crash")):
        assert _cut_off(0, case, rectify, rng).outcome == outcome


def test_a_process_that_does_not_answer_hangs(tmp_path: Path) -> None:
    class Silent:
        def send(self, number: int) -> None: ...

        def poll(self, seconds: float) -> bool:
            return False

    watched = benchmarks.stability._Watched((tmp_path,), Options(tmp_path, damaged=0))
    watched._line = Silent()
    assert watched.try_photo(0).outcome == "hang"


def test_commands_fail_where_something_failed(capsys: pytest.CaptureFixture[str]) -> None:
    part = Part("some", "what", 4, 1, 0, 2.0, "px", {}, ())
    photo = DamagedPhoto(0, ("noise",), SIZE, "ok", "", 0.1)
    well = StabilityReport({}, 0, 5.0, (part,), (photo,))
    assert benchmarks.stability._verdict(well) == 0
    assert benchmarks.stability._verdict(replace(well, parts=(replace(part, failed=1),))) == 2
    assert benchmarks.stability._verdict(replace(well, photos=(replace(photo, outcome="hang"),))) == 2
    flat = SoakReport({}, 100, 2, 64, 10, (100.0,) * 20, (0.1,) * 100, 0)
    assert benchmarks.soak._verdict(flat) == 0
    assert benchmarks.soak._verdict(replace(flat, different=1)) == 2
    slower = (0.1,) * 50 + (0.2,) * 50
    assert benchmarks.soak._verdict(replace(flat, cpu_seconds=slower)) == 2
    assert benchmarks.soak._verdict(replace(flat, memory_mib=tuple(100.0 + k for k in range(20)))) == 2
    assert "1 results differ" in capsys.readouterr().out


def test_a_shrunk_photo_may_be_off_by_one_of_its_own_pixels() -> None:
    it = Damaged(ramp(), sheet(), scale=0.1)
    assert _rectified(0, it, Says(off=0.9), lambda photo: None).outcome == "ok"
    assert _rectified(0, it, Says(off=1.1), lambda photo: None).outcome == "untruthful"


def test_errors_are_told_as_of_a_photo_of_reference_size() -> None:
    """A sheet 9 px off in a photo of three times the reference size counts as 3 px off, in the limit's units."""
    it = replace(Damaged(ramp(), sheet()), before_px=3 * REFERENCE_PX)
    told = _rectified(0, it, Says(off=9.0), lambda photo: None)
    assert (told.outcome, told.end_point_px, told.allowed_px) == ("ok", pytest.approx(3.0, rel=1e-3), TRUTHFUL_PX)
    assert _rectified(0, replace(it, before_px=540), Says(off=3.0), lambda photo: None).outcome == "untruthful"
    photo = np.zeros((20, 30, 3), np.uint8)
    assert damaged(photo, sheet(), np.random.default_rng(0)).before_px == 30


# ---------------------------------------------------------------- parts


@pytest.mark.parametrize("name", list(PROBLEMS))
def test_no_problem_breaks_a_part(name: str) -> None:
    problem, what, unit = PROBLEMS[name]
    part = part_of(name, what, unit, [ended(problem, seed) for seed in range(8 if name == "solver" else 25)])
    assert part.failed == 0, part.failures
    assert part.refused < part.tried


def test_broken_parts_are_counted() -> None:
    def breaks(rng: np.random.Generator) -> End:
        raise ZeroDivisionError("x")

    def mumbles(rng: np.random.Generator) -> End:
        raise PhotoError("no")

    part = part_of("some", "what", "px", [ended(breaks, 1), ended(mumbles, 2), End(residual=2.0), End(refusal="No")])
    assert (part.tried, part.refused, part.failed, part.worst) == (4, 1, 2, 2.0)
    assert "ZeroDivisionError" in part.failures[0]


def test_random_sheets_do_not_fold() -> None:
    assert not any(random_sheet(np.random.default_rng(seed)).folds() for seed in range(20))


# ---------------------------------------------------------------- the commands


def test_a_stability_run_is_whole_and_goes_on(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy = Path(shutil.copytree(dataset, tmp_path / "data"))
    options = Options(tmp_path, data=(copy,), damaged=2, problems=3, threads=1)
    report = run(options, ["python -m benchmarks.stability"])
    value = json.loads((tmp_path / "stability.json").read_text())
    assert problems(value, schema_of(StabilityReport)) == []
    assert [part.tried for part in report.parts] == [3] * len(PROBLEMS)
    assert len(report.photos) == 2
    assert sum(report.counts().values()) == 2
    (tmp_path / "damaged" / "0_1.json").unlink()
    again = run(replace(options, damaged=1), ["x"])
    assert again.photos == report.photos[:1]
    with pytest.raises(ConfigError, match="results of other settings"):
        run(replace(options, seed=1), ["x"])
    refused_elsewhere(lambda: run(options, ["x"]), copy, monkeypatch)
    with pytest.raises(ConfigError, match="--damaged -1"):
        Options(tmp_path, damaged=-1)


def test_photos_and_weights_that_cannot_be_read_are_told_before_anything_is_kept(dataset: Path, tmp_path: Path) -> None:
    options = Options(tmp_path / "out", data=(dataset,), damaged=1, problems=0, threads=1)
    for wrong in (replace(options, data=(tmp_path,)), replace(options, weights=tmp_path / "none.safetensors")):
        with pytest.raises(DataError):
            run(wrong, ["x"])
    assert len(run(options, ["x"]).photos) == 1


def test_a_process_that_dies_is_a_crash(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    watched = benchmarks.stability._Watched((tmp_path / "no data",), Options(tmp_path, damaged=0))
    assert watched.try_photo(0).outcome == "crash"
    watched.end()


def test_counts_by_damage() -> None:
    ends = [("ok", ("noise",)), ("refused", ("noise", "crop")), ("untruthful", ("crop",)), ("lost", ("noise",))]
    ends += [("unsure", ("crop",)), ("unsure", ("crop",))]
    photos = tuple(
        DamagedPhoto(k, kinds, SIZE, end, "", 0.1, end_point_px=float(k), allowed_px=4.5)
        for k, (end, kinds) in enumerate(ends)
    )
    report = StabilityReport({}, 0, 5.0, (), photos)
    assert [(row.damage, row.ok, row.unsure, row.refused, row.failed) for row in report.by_damage()] == [
        ("crop", 0, 2, 1, 1),
        ("noise", 1, 0, 1, 1),
    ]
    assert (report.failures, report.cautious) == (2, 1)


def test_soak_counts_what_differs() -> None:
    calls = []

    def rectify(photo: np.ndarray) -> RectifyResult:
        calls.append(1)
        return Says(off=0.0 if len(calls) != 30 else 1e-9)(photo)

    memory, seconds, different = soak(rectify, [ramp(), ramp()[::2]], 40)
    assert (len(seconds), len(memory), different) == (40, 36, 1)
    result = Says()(ramp())
    assert digest(result) != digest(refuses(ramp()))
    covered = np.zeros(result.film.shape, bool)
    for change in (
        {"expected_error_px": 9.0},
        {"upright_probability": 0.1},
        {"covered": covered},
    ):
        assert digest(replace(result, **change)) != digest(result)


def test_growth_and_drift() -> None:
    flat = SoakReport({}, 100, 2, 64, 10, (100.0,) * 20, (0.1,) * 100, 0)
    assert (flat.memory_growth(), flat.time_drift()) == (0, 0)
    rising = replace(
        flat, memory_mib=tuple(100.0 + k for k in range(20)), cpu_seconds=tuple(1.0 + k for k in range(100))
    )
    assert rising.memory_growth() == pytest.approx(18 / 100.5)
    assert rising.time_drift() > 1


def test_a_soak_is_whole(dataset: Path, tmp_path: Path) -> None:
    options = benchmarks.soak.Options(tmp_path, data=(dataset,), films=20, photos=2, photo_px=64, threads=1)
    report = benchmarks.soak.run(options, ["python -m benchmarks.soak"])
    assert problems(json.loads((tmp_path / "soak.json").read_text()), schema_of(SoakReport)) == []
    assert (report.films, report.different) == (20, 0)
    with pytest.raises(ConfigError, match="films >= 20"):
        benchmarks.soak.Options(tmp_path, films=3)
