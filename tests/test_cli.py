"""The command line: what it writes, what it says, how it fails. Its rectifier is a stand-in here."""

from __future__ import annotations

import inspect
import io
import json
import sys
import types
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NoReturn

import cv2
import numpy as np
import pytest
from PIL import Image

import hybrid
from hybrid import cli
from hybrid.backward import BackwardMap, Orientation
from hybrid.cli.options import made_by
from hybrid.cli.rectify_files import rectify_files, warnings_of
from hybrid.coords import film_nodes
from hybrid.errors import ConfigError
from hybrid.image_io import read_photo, write_rgb
from hybrid.outputs import is_result, result_record, write_result
from hybrid.records import LeftOut, RectifyResult, SliceGrid, StageReport, Status, StatusCode

Effort = Literal["fast", "default"]
ROWS = {"fast": 1, "default": 2}


@dataclass(frozen=True)
class StandInConfig:
    """Options of the stand-in."""

    rows: int = 2
    """Rows of the grid that it claims to have found."""

    @staticmethod
    def of(effort: Effort) -> StandInConfig:
        """Like ``RectifyConfig.of``, with a number of rows for each effort."""
        if effort not in ROWS:
            raise ConfigError(f"no effort {effort}")
        return StandInConfig(ROWS[effort])


@dataclass
class StandIn:
    """Finds a film that fills the photo. If the photo is black: it finds none. If it is white: it crashes.

    It is unsure of dark photos.
    """

    config: StandInConfig = field(default_factory=StandInConfig)

    def __call__(self, photo: np.ndarray, corners: object = None, focal: float | None = None) -> RectifyResult:
        stages = (
            StageReport("network", True, "always", 0.01),
            StageReport("spline", False, "no grid was found", 0.0),
        )
        if photo.max() == 0:
            return RectifyResult(Status(StatusCode.NO_FILM), stages)
        if photo.min() == 255:
            raise IndexError("a defect")
        vertices = film_nodes((self.config.rows + 1, 4))
        scale = np.array(photo.shape[1::-1], dtype=np.float64)
        size = photo.shape[:2]
        return RectifyResult(
            Status(StatusCode.OK if photo.max() > 99 else StatusCode.UNSURE),
            stages,
            film=(photo[..., 0] / 255).astype(np.float32),
            rectified=photo,
            backward=BackwardMap.from_function(lambda uv: uv * scale, (4, 4)),
            grid=SliceGrid(self.config.rows, 3, vertices, vertices * scale, 0.8),
            glare=np.zeros(size, dtype=bool),
            confidence=np.ones(size, dtype=np.float32),
            expected_error_px=1.234,
            limit_px=5.0,
            photo_size=size,
        )


@pytest.fixture
def _stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    module = types.ModuleType("hybrid.pipeline")
    module.__dict__.update(Effort=Effort, Rectifier=StandIn, RectifyConfig=StandInConfig)
    monkeypatch.setitem(sys.modules, "hybrid.pipeline", module)
    for command in ("hybrid.cli.rectify", "hybrid.cli.fuse"):
        monkeypatch.delitem(sys.modules, command, raising=False)
    yield
    for command in ("hybrid.cli.rectify", "hybrid.cli.fuse"):
        sys.modules.pop(command, None)


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    path = tmp_path / "in" / "film.png"
    path.parent.mkdir()
    write_rgb(path, np.random.default_rng(0).integers(1, 250, (60, 90, 3), dtype=np.uint8))
    return path


def folder(path: Path) -> Path:
    path.mkdir()
    return path


def black_photo(folder: Path, name: str = "black.png") -> Path:
    write_rgb(folder / name, np.zeros((64, 64, 3), dtype=np.uint8))
    return folder / name


# ---------------------------------------------------------------- what is written


@pytest.mark.usefixtures("_stand_in")
def test_one_photo(photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "deep" / "out"
    assert cli.main(["rectify", str(photo), "-o", str(out)]) == 0
    written = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    slices = {f"film_slices/{k:02d}.png" for k in range(1, 7)}
    pictures = {"film_film.png", "film_confidence.png", "film_rectified.jpg", "film_side_by_side.jpg"}
    assert written == slices | pictures | {"film.json"}
    assert (record_of(out)["effort"], record_of(out)["options"]) == ("default", {})
    film = cv2.imread(str(out / "film_film.png"), cv2.IMREAD_UNCHANGED)
    assert film.dtype == np.uint16
    assert np.array_equal(film, read_photo(photo)[..., 0].astype(np.uint16) * 257)
    record = json.loads((out / "film.json").read_text())
    assert record["ok"] is True
    assert (record["expected_error_px"], record["limit_px"]) == (1.23, 5.0)
    assert (record["grid"]["rows"], record["grid"]["cols"]) == (2, 3)
    assert (record["photo_size"], record["film_size"]) == ([60, 90], [60, 90])
    assert set(record["files"]) == slices | pictures
    assert record["corners_photo"] == [[0, 0], [90, 0], [0, 60], [90, 60]]
    assert [stage["name"] for stage in record["stages"]] == ["file", "network", "spline"]
    printed = capsys.readouterr().out
    assert "network" not in printed
    assert f"{StatusCode.OK.value}  (2 x 3 slices" in printed
    assert cli.main(["rectify", str(photo), "-o", str(out), "-v", "--rows", "3"]) == 0
    printed = capsys.readouterr().out
    assert "network" in printed
    assert "skipped" in printed
    assert record_of(out)["options"] == {"rows": 3}


@pytest.mark.usefixtures("_stand_in")
def test_results_of_earlier_runs_are_no_photos(photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["rectify", str(photo), "-o", str(photo.parent)]) == 0
    there = sorted(path for path in photo.parent.iterdir() if path.suffix in (".png", ".jpg"))
    assert len(there) == 5
    foreign = photo.with_name("other_film.png")
    write_rgb(foreign, read_photo(photo))
    assert cli.main(["rectify", *map(str, there), str(foreign), "-o", str(tmp_path / "out")]) == 0
    assert "4 of these files are left out" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").glob("*.json")} == {"film.json", "other_film.json"}


@pytest.mark.usefixtures("_stand_in")
def test_results_that_alone_are_named_are_photos(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Named alone, they must be meant; in a folder or ``*.jpg``, they are what an earlier run put beside the photos."""
    assert cli.main(["rectify", str(photo), "-o", str(tmp_path)]) == 0
    result = tmp_path / "film_rectified.jpg"
    assert is_result(result)
    capsys.readouterr()
    assert cli.main(["rectify", str(result), "-o", str(tmp_path / "out")]) == 0
    assert "left out" not in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").glob("*.json")} == {"film_rectified.json"}
    assert cli.main(["rectify", str(photo), str(result), "-o", str(tmp_path / "two")]) == 0
    assert "1 of these files is left out: it is a result of an earlier run" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "two").glob("*.json")} == {"film.json"}
    for path in tmp_path.glob("film_*.png"):
        path.unlink()
    assert cli.main(["rectify", str(tmp_path), "-o", str(tmp_path / "none")]) == 2
    assert "2 of these files are left out" in capsys.readouterr().out


@pytest.mark.usefixtures("_stand_in")
def test_results_are_not_fused(photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["rectify", str(photo), "-o", str(tmp_path)]) == 0
    capsys.readouterr()
    named = [str(photo), str(tmp_path / "film_rectified.jpg"), str(tmp_path / "film_side_by_side.jpg")]
    assert cli.main(["fuse", *named, "-o", str(tmp_path)]) == 2
    out, err = capsys.readouterr()
    assert "2 of these files are left out" in out
    assert "two or more photos" in err


@pytest.mark.usefixtures("_stand_in")
def test_corners_are_of_one_photo_and_are_told(photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    at = ["--corners", "-3", "2", "80", "2.5", "85", "50", "1", "58"]
    assert cli.main(["rectify", str(photo), "-o", str(tmp_path / "out"), *at]) == 0
    told = json.loads((tmp_path / "out" / "film.json").read_text())["corners"]
    assert told == [[-3, 2], [80, 2.5], [85, 50], [1, 58]]
    assert cli.main(["rectify", "-o", str(tmp_path / "out"), *at, str(photo)]) == 0  # takes eight numbers and no more
    capsys.readouterr()
    assert cli.main(["rectify", str(photo), str(black_photo(tmp_path)), "-o", str(tmp_path / "out"), *at]) == 2
    assert "hybrid rectify: --corners: got 2 photos; allowed: one photo" in capsys.readouterr().err


@pytest.mark.usefixtures("_stand_in")
def test_dicom_files_are_written_where_they_are_asked_for(photo: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert cli.main(["rectify", str(photo), "-o", str(out)]) == 0
    assert not (out / "film_dicom").exists()
    assert cli.main(["rectify", str(photo), "-o", str(out), "--dicom"]) == 0
    assert len(list((out / "film_dicom").iterdir())) == 7


@pytest.mark.usefixtures("_stand_in")
def test_slices_of_earlier_runs_are_results(photo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cli.main(["rectify", str(photo), "-o", str(tmp_path)]) == 0
    slices, foreign = tmp_path / "film_slices", tmp_path / "other_slices"
    assert all(is_result(path) for path in slices.iterdir())
    foreign.mkdir()
    for path in (slices / "99.png", foreign / "01.png"):
        write_rgb(path, read_photo(photo))
        assert not is_result(path)
    monkeypatch.chdir(slices)
    assert is_result(Path("01.png"))
    assert not is_result(Path("99.png"))


@pytest.mark.usefixtures("_stand_in")
def test_a_name_that_cannot_be_printed_costs_no_photo(
    photo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    strange = photo.with_name("胶片 \udcbd.png")
    strange.write_bytes(photo.read_bytes())
    told = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(told, encoding="ascii", errors="strict"))
    assert cli.main(["rectify", str(strange), str(photo), "-o", str(tmp_path / "out")]) == 0
    sys.stdout.flush()
    assert b"2 of 2 photos flattened" in told.getvalue()


@pytest.mark.usefixtures("_stand_in")
def test_a_result_is_saved_from_python_as_the_command_writes_it(photo: Path, tmp_path: Path) -> None:
    commanded, saved = tmp_path / "commanded", tmp_path / "deep" / "saved"
    assert cli.main(["rectify", str(photo), "-o", str(commanded)]) == 0
    files = hybrid.save_result(str(photo), StandIn()(read_photo(photo)), str(saved))
    assert {path.relative_to(saved): path.read_bytes() for path in files[:-1]} == {
        path.relative_to(commanded): path.read_bytes()
        for path in commanded.rglob("*")
        if path.is_file() and path.suffix != ".json"
    }
    assert files[-1] == saved / "film.json"
    of_two = replace(StandIn()(read_photo(photo)), photos=2)
    fused = hybrid.save_result([photo, black_photo(tmp_path)], of_two, saved)
    assert fused[-1] == saved / "film_fused.json"
    assert json.loads(fused[-1].read_text())["further_photos"] == ["black.png"]
    with pytest.raises(ConfigError, match="Photos of a film: got 1; allowed: 2"):
        hybrid.save_result(photo, of_two, saved)
    with pytest.raises(ConfigError, match=r"Another photo \(.*black.png\): got 64 x 64 pixels; allowed: 90 x 60"):
        hybrid.save_result(black_photo(tmp_path), StandIn()(read_photo(photo)), saved)
    for no_path in (None, [None], read_photo(photo)):
        with pytest.raises(ConfigError, match=r"Photo to save: got a \w+; allowed: a path, or several\. Name the"):
            inspect.unwrap(hybrid.save_result)(no_path, StandIn()(read_photo(photo)), saved)
    told = hybrid.save_result(black_photo(tmp_path), RectifyResult(Status(StatusCode.NO_FILM)), saved)
    assert told == (saved / "black.json",)
    with pytest.raises(ConfigError, match="Nothing can be written there"):
        hybrid.save_result(photo, StandIn()(read_photo(photo)), photo / "out")


def record_of(out: Path) -> dict:
    return json.loads((out / "film.json").read_text())


def test_help_shows_what_most_need_and_help_all_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    shown = []
    for option in ("--help", "--help-all"):
        with pytest.raises(SystemExit) as ended:
            cli.main(["rectify", option])
        assert ended.value.code == 0
        shown.append(capsys.readouterr().out)
    assert shown[0].count("\n") < 60
    assert "--help-all" in shown[0]
    assert "--upright.turn" in shown[1]
    assert all("--workers" in text for text in shown)


def test_a_film_is_turned_as_it_is_asked_for() -> None:
    """The film as found is turned a quarter clockwise, whatever is read on it."""
    photo = "hybrid/examples/film.jpg"
    found = hybrid.rectify(photo, effort="fast")
    config = hybrid.RectifyConfig.of("fast")
    asked = hybrid.Rectifier(replace(config, upright=replace(config.upright, turn="90")))(photo)
    assert found.orientation is not None
    assert asked.orientation == Orientation(1, False)
    assert asked.upright_probability is None
    lies = hybrid.Rectifier(replace(config, upright=replace(config.upright, turn="0")))(photo)
    assert np.array_equal(asked.rectified, np.rot90(lies.rectified, -1))
    with pytest.raises(ConfigError, match="Name the turn as well"):
        replace(config.upright, mirror=True)


@pytest.mark.usefixtures("_stand_in")
def test_a_film_that_may_be_off_is_written_with_a_warning(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_rgb(photo.with_name("dark.png"), read_photo(photo) // 4)
    out = tmp_path / "out"
    assert cli.main(["rectify", str(photo), str(photo.with_name("dark.png")), "-o", str(out)]) == 0
    assert (out / "dark_film.png").exists()
    record = json.loads((out / "dark.json").read_text())
    assert (record["ok"], record["status"]) == (False, "UNSURE")
    printed = capsys.readouterr().out
    assert f"UNSURE  {StatusCode.UNSURE.value}" in printed
    assert "2 of 2 photos flattened, 1 of them UNSURE, in " in printed
    assert f"look at {photo.with_name('dark.png')}: It may be off." in printed
    assert f"look at {photo}:" not in printed


@pytest.mark.usefixtures("_stand_in")
def test_what_cannot_even_be_looked_up_costs_no_other_photo(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shut = folder(tmp_path / "shut")
    read = Path.iterdir
    monkeypatch.setattr(Path, "iterdir", lambda path: refuse() if path == shut else read(path))
    arguments = [str(shut), str(tmp_path / ("long" * 80)), str(photo)]
    assert cli.main(["rectify", *arguments, "-o", str(tmp_path / "out")]) == 1
    assert (tmp_path / "out" / "film_film.png").exists()
    assert "File name too long" in capsys.readouterr().out


def refuse() -> NoReturn:
    raise PermissionError(13, "Permission denied")


def test_options_that_json_has_no_word_for_are_told_as_text() -> None:
    @dataclass(frozen=True)
    class Options:
        pair: tuple[float, float] = (1.0, 2.0)
        single: float = 1.0

    made = made_by("default", Options(), Options((1.0, float("inf")), float("inf")))
    assert made["options"] == {"pair": "(1.0, inf)", "single": "inf"}
    assert made_by("default", Options(), Options((1.0, 3.0)))["options"] == {"pair": (1.0, 3.0)}


@pytest.mark.usefixtures("_stand_in")
def test_options_of_the_rectifier_are_options_of_the_command(photo: Path, tmp_path: Path) -> None:
    arguments = ["rectify", str(photo), "-o", str(tmp_path / "out"), "--rows", "3", "--rectified-format", "png"]
    assert cli.main(arguments) == 0
    assert len(list((tmp_path / "out" / "film_slices").iterdir())) == 9
    assert np.array_equal(read_photo(tmp_path / "out" / "film_rectified.png"), read_photo(photo))


@pytest.mark.usefixtures("_stand_in")
@pytest.mark.parametrize(
    ("options", "rows"),
    [(["--effort", "fast"], 1), (["--effort=fast"], 1), ([], 2), (["--effort", "fast", "--rows", "4"], 4)],
)
def test_an_effort_sets_the_options_that_are_not_named(
    options: list[str], rows: int, photo: Path, tmp_path: Path
) -> None:
    assert cli.main(["rectify", str(photo), "-o", str(tmp_path / "out"), *options]) == 0
    assert json.loads((tmp_path / "out" / "film.json").read_text())["grid"]["rows"] == rows


@pytest.mark.usefixtures("_stand_in")
def test_an_effort_that_does_not_exist_is_refused(photo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(["rectify", str(photo), "--effort", "huge"])
    assert stopped.value.code == 2
    assert "huge" in capsys.readouterr().err


@pytest.mark.usefixtures("_stand_in")
def test_nothing_but_a_result_s_own_files_is_removed(photo: Path, tmp_path: Path) -> None:
    """This holds whatever a JSON from elsewhere says."""
    out = tmp_path / "out"
    assert cli.main(["rectify", str(photo), "-o", str(out), "--rows", "3"]) == 0
    foreign = [tmp_path / "precious.txt", out / "other.png"]
    for path in foreign:
        path.write_text("not of this result")
    record = record_of(out)
    record["files"] += ["../precious.txt", str(foreign[0]), "other.png"]
    (out / "film.json").write_text(json.dumps(record))
    assert cli.main(["rectify", str(photo), "-o", str(out)]) == 0
    assert all(path.exists() for path in foreign)
    assert not (out / "film_slices" / "09.png").exists()


@pytest.mark.usefixtures("_stand_in")
def test_again_over_the_same_photo_leaves_no_slices_of_the_old_grid(photo: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert cli.main(["rectify", str(photo), "-o", str(out), "--rows", "3"]) == 0
    (out / "film_slices" / "mine.txt").write_text("not written by the command")
    assert cli.main(["rectify", str(photo), "-o", str(out)]) == 0
    names = {path.name for path in (out / "film_slices").iterdir()}
    assert names == {*(f"{k:02d}.png" for k in range(1, 7)), "mine.txt"}
    assert not (out / "film_2.json").exists()


@pytest.mark.usefixtures("_stand_in")
def test_photos_of_one_name_do_not_overwrite_each_other(photo: Path, tmp_path: Path) -> None:
    other = tmp_path / "other" / "film.png"
    other.parent.mkdir()
    write_rgb(other, np.full((50, 50, 3), 9, dtype=np.uint8))
    out = tmp_path / "out"
    assert cli.main(["rectify", str(photo), str(other), "-o", str(out)]) == 0
    assert cv2.imread(str(out / "film_film.png"), cv2.IMREAD_UNCHANGED).shape == (60, 90)
    assert cv2.imread(str(out / "film_2_film.png"), cv2.IMREAD_UNCHANGED).shape == (50, 50)
    assert cli.main(["rectify", str(other), "-o", str(out)]) == 0  # alone in a later run: it keeps its own name
    assert cv2.imread(str(out / "film_film.png"), cv2.IMREAD_UNCHANGED).shape == (60, 90)
    assert not (out / "film_3.json").exists()


@pytest.mark.usefixtures("_stand_in")
@pytest.mark.parametrize("name", ["film.json", "film_film.png", "film_rectified.png", "film_side_by_side.jpg"])
def test_a_foreign_file_of_that_name_is_left_alone(name: str, photo: Path, tmp_path: Path) -> None:
    out = folder(tmp_path / "out")
    (out / name).write_text("[1, 2]")
    assert cli.main(["rectify", str(photo), "-o", str(out)]) == 0
    assert cli.main(["rectify", str(photo), "-o", str(out)]) == 0
    assert (out / name).read_text() == "[1, 2]"
    assert {path.stem for path in out.glob("*.json")} - {"film"} == {"film_2"}


@pytest.mark.usefixtures("_stand_in")
def test_a_photo_is_not_written_over(photo: Path, tmp_path: Path) -> None:
    """This includes a photo that is named like a result and still to be read."""
    out = folder(tmp_path / "out")
    photos = [out / "film.png", out / "film_rectified.jpg"]
    for number, path in enumerate(photos):
        write_rgb(path, np.full((60, 90, 3), 100 + number, dtype=np.uint8))
    before = [path.read_bytes() for path in photos]
    assert cli.main(["rectify", *map(str, photos), "-o", str(out)]) == 0
    assert [path.read_bytes() for path in photos] == before
    records = {path.name: json.loads(path.read_text())["photo"] for path in out.glob("*.json")}
    assert records == {"film_2.json": "film.png", "film_rectified.json": "film_rectified.jpg"}


def write(photos: list[Path], out: Path, result: RectifyResult | None = None) -> tuple[Path, ...]:
    picture = read_photo(photos[0])
    return write_result(out, photos, picture, result or StandIn()(picture), "png")


def test_again_without_a_film_loses_nothing_and_says_so(photo: Path, tmp_path: Path) -> None:
    """The earlier film stays, listed as such, and goes when a later run makes a film again."""
    out = folder(tmp_path / "out")
    first = write([photo], out)
    for _ in range(2):
        write([photo], out, RectifyResult(Status(StatusCode.NO_FILM)))
        record = json.loads((out / "film.json").read_text())
        assert (record["status"], record["files"]) == ("NO_FILM", [])
        assert set(record["earlier_files"]) == {path.relative_to(out).as_posix() for path in first[:-1]}
        assert all(path.exists() for path in first)
    write_result(out, [photo], read_photo(photo), StandIn()(read_photo(photo)), "jpg")
    assert "earlier_files" not in json.loads((out / "film.json").read_text())
    assert not (out / "film_rectified.png").exists()


def test_a_result_that_is_cut_off_says_so_and_keeps_its_name(
    photo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = folder(tmp_path / "out")
    for _ in range(2):  # the first run, and one over a complete result
        with monkeypatch.context() as patch:
            patch.setattr("hybrid.outputs.write_rgb", lambda *_: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                write([photo], out)
        record = json.loads((out / "film.json").read_text())
        assert (record["status"], record["ok"]) == ("UNFINISHED", False)
        assert all(is_result(path) for path in out.iterdir() if path.suffix == ".png")  # else they would be rectified
        other = tmp_path / "other" / "film.png"
        other.parent.mkdir(exist_ok=True)
        write_rgb(other, np.full((50, 50, 3), 9, dtype=np.uint8))
        assert write([other], out)[-1] == out / "film_2.json"
        assert write([photo], out)[-1] == out / "film.json"
        assert json.loads((out / "film.json").read_text())["status"] == "OK"


def test_what_a_run_that_was_cut_off_left_is_removed_by_the_next(
    photo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = folder(tmp_path / "out")
    picture = read_photo(photo)
    with monkeypatch.context() as patch:
        patch.setattr("hybrid.outputs.side_by_side", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write_result(out, [photo], picture, StandIn(StandInConfig(rows=3))(picture), "png")
    assert (out / "film_slices" / "09.png").exists()
    (out / "film_slices" / "notes.png").write_bytes(b"of somebody else")
    write_result(out, [photo], picture, StandIn()(picture), "jpg")
    assert {path.name for path in out.glob("film_rectified.*")} == {"film_rectified.jpg"}
    assert {path.name for path in (out / "film_slices").iterdir()} == {*(f"0{k}.png" for k in range(1, 7)), "notes.png"}


def test_fused_photos_are_others_if_one_of_them_is(photo: Path, tmp_path: Path) -> None:
    out = folder(tmp_path / "out")
    second, third = (black_photo(tmp_path, name) for name in ("second.png", "third.png"))
    write_rgb(third, np.full((64, 64, 3), 7, dtype=np.uint8))
    for further, name in ((second, "film_fused"), (third, "film_fused_2"), (second, "film_fused")):
        assert write([photo, further], out)[-1] == out / f"{name}.json"
    record = json.loads((out / "film_fused_2.json").read_text())
    assert (record["photo"], record["further_photos"]) == ("film.png", ["third.png"])
    assert write([photo], out)[-1] == out / "film.json"


def test_results_of_the_same_photos_are_replaced_whichever_are_left_out(photo: Path, tmp_path: Path) -> None:
    """Another effort may find a film where one found none, and earlier versions named all photos as the film's."""
    out, both = folder(tmp_path / "out"), [black_photo(tmp_path), photo]
    found = replace(StandIn()(read_photo(photo)), photo=1, photos=2)
    for left_out in ((LeftOut(0, "no film was found in it"),), (), (LeftOut(0, "no film was found in it"),)):
        files = write_result(out, both, read_photo(photo), replace(found, left_out=left_out), "png")
        assert files[-1] == out / "black_fused.json"
    other = black_photo(folder(tmp_path / "other"))
    write_rgb(other, np.full((64, 64, 3), 7, dtype=np.uint8))
    files = write_result(out, [other, photo], read_photo(photo), replace(found, left_out=left_out), "png")
    assert files[-1] == out / "black_fused_2.json"


# ---------------------------------------------------------------- how it fails


@pytest.mark.usefixtures("_stand_in")
def test_bad_photos_do_not_stop_the_good_ones(photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = photo.parent
    (folder / "empty.jpg").touch()
    (folder / "text.jpg").write_text("no picture")
    write_rgb(folder / "white.png", np.full((64, 64, 3), 255, dtype=np.uint8))
    bad = [folder / "gone.jpg", folder / "empty.jpg", folder / "text.jpg", black_photo(folder)]
    bad.append(folder / "white.png")
    out = tmp_path / "out"
    assert cli.main(["rectify", *map(str, bad), str(photo), "-o", str(out)]) == 1
    printed = capsys.readouterr().out
    for message in (
        "No such file",
        "is empty",
        "got text",
        StatusCode.NO_FILM.value,
        "IndexError: a defect",
    ):
        assert message in printed
    assert "1 of 6 photos flattened" in printed
    assert (out / "film_film.png").exists()
    record = json.loads((out / "black.json").read_text())
    assert (record["ok"], record["status"], record["files"]) == (False, "NO_FILM", [])


@pytest.mark.usefixtures("_stand_in")
def test_a_folder_stands_for_the_photos_in_it(photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = photo.parent, tmp_path / "out"
    for name in ("b.PNG", "deeper/c.png"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(photo.read_bytes())
    (folder / "notes.txt").write_text("no photo")
    (folder / "._film.png").write_text("what macOS leaves beside a photo")
    assert cli.main(["rectify", str(folder), "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "2 of 2 photos flattened, in" in printed
    assert f"{folder}: folders within it are left out: deeper" in printed
    assert sorted(path.stem for path in out.glob("*.json")) == ["b", "film"]


@pytest.mark.usefixtures("_stand_in")
def test_a_link_in_a_folder_that_leads_nowhere_is_told(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photo.with_name("link.jpg").symlink_to("gone.jpg")
    folder(photo.with_name("folder.jpg"))
    assert cli.main(["rectify", str(photo.parent), "-o", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr().out
    assert f"ERROR  No such file ({photo.with_name('link.jpg')})" in printed
    assert "1 of 2 photos flattened" in printed


@pytest.mark.usefixtures("_stand_in")
def test_a_folder_without_photos_costs_no_others(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (empty := tmp_path / "empty").mkdir()
    assert cli.main(["rectify", str(empty), str(photo), "-o", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr().out
    assert "1 of 2 photos flattened, in" in printed
    assert f"This is a folder, not a photo ({empty})" in printed


@pytest.mark.usefixtures("_stand_in")
def test_of_several_pages_the_first_is_used_which_is_told(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = Image.fromarray(read_photo(photo))
    page.save(tmp_path / "pages.tif", save_all=True, append_images=[page])
    assert cli.main(["rectify", str(tmp_path / "pages.tif"), "-o", str(tmp_path / "out")]) == 0
    assert "LOOK  It is the first of 2 pictures in its file." in capsys.readouterr().out


@pytest.mark.usefixtures("_stand_in")
def test_a_photo_that_fails_leaves_earlier_results_alone(photo: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert cli.main(["rectify", str(photo), "-o", str(out)]) == 0
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    write_rgb(photo, np.zeros((64, 64, 3), dtype=np.uint8))  # another photo of the same name, without a film
    assert cli.main(["rectify", str(photo), "-o", str(out)]) == 1
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.usefixtures("_stand_in")
def test_no_photos_is_a_wrong_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["rectify"]) == 2
    assert "name at least one" in capsys.readouterr().err


@pytest.mark.usefixtures("_stand_in")
def test_what_the_system_refuses_is_told_with_its_place_and_what_to_do(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    long = photo.with_name(f"{'a' * 250}.jpg")
    long.write_bytes(photo.read_bytes())
    out = tmp_path / "out"
    assert cli.main(["rectify", str(long), str(photo), "-o", str(out)]) == 1
    told = f"A file cannot be read or written ({out / ('a' * 250)}_film.png): got File name too long. Mend that"
    assert f"ERROR  {told}" in capsys.readouterr().out

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")  # as from a write, which names no file

    monkeypatch.setattr("hybrid.outputs.write_film", full)
    assert cli.main(["rectify", str(photo), "-o", str(out)]) == 1
    assert f"cannot be read or written ({out}): got No space left on device. Mend" in capsys.readouterr().out


@pytest.mark.usefixtures("_stand_in")
@pytest.mark.parametrize("command", ["rectify", "fuse"])
def test_a_photo_whose_name_is_taken_for_an_option_is_told(
    command: str, photo: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(photo.parent)
    Path("-dash.JPG").write_bytes(photo.read_bytes())
    with pytest.raises(SystemExit) as stopped:
        cli.main([command, "-dash.JPG", "film.png", "-o", "out"])
    assert stopped.value.code == 2
    told = "Photos (-dash.JPG): got a name that is taken for an option. Write ./-dash.JPG."
    assert capsys.readouterr().err == f"hybrid {command}: {told}\n"
    assert cli.main(["rectify", "./-dash.JPG", "film.png", "-o", "out"]) == 0


def test_output_folder_that_cannot_be(photo: Path) -> None:
    with pytest.raises(ConfigError, match=r"Nothing can be written there.*Name a folder"):
        rectify_files([photo], photo / "out", StandIn, "jpg", print)


@pytest.mark.usefixtures("_stand_in")
def test_user_errors_are_one_line(photo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["rectify", str(photo), "-o", str(photo / "out")]) == 1
    message = capsys.readouterr().err
    assert message.startswith("hybrid: Nothing can be written there")
    assert message.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--workers", "0"], "--workers: got 0; allowed: 1 or more. Name how many."),
        (["--corners", *"009090", "nan", "9"], "--corners: got 0 0 9 0 9 0 nan 9; allowed: numbers."),
        (["--corners", *"009099", "-inf", "9"], "--corners: got 0 0 9 0 9 9 -inf 9; allowed: numbers."),
        (["--upright.mirror"], "--upright.mirror: got no turn beside it."),
        (["--size.max-side-px", "0"], "--size.max-side-px: got 0; allowed: >= 64."),
    ],
)
def test_options_that_cannot_be_are_told_by_their_flags(
    options: list[str], told: str, photo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(["rectify", str(photo), *options])
    assert stopped.value.code == 2
    assert f"hybrid rectify: {told}" in capsys.readouterr().err


# ---------------------------------------------------------------- the dispatcher


def test_help_and_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert "hybrid rectify PHOTO... -o DIR" in shown
    assert "--help-all" in shown
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"hybrid {hybrid.__version__}\n"


def test_unknown_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["flatten"]) == 2
    assert "unknown command 'flatten'; allowed: rectify, fuse, train, info" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--width", "0"], "--width: got 0.0; allowed: > 0."),
        (["--width", "0.5"], "--width: got 0.5; allowed: presets of the paper's networks."),
        (["--preset", "silly"], "--preset: got silly; allowed: filmnet, "),
        (["--seed", "99999999999999999999"], "--seed: got 99999999999999999999; allowed: <= "),
        (["--minutes-per-save", "nan"], "--minutes-per-save: got nan; allowed: >= 0."),
    ],
)
def test_a_training_that_cannot_be_is_a_wrong_command_line(
    options: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["train", "--data", "nothing", "--out", str(tmp_path / "out"), *options]) == 2
    assert capsys.readouterr().err.startswith(f"hybrid train: {told}")


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("rectify", "stopped; what is finished is kept (a film whose JSON says UNFINISHED is not)"),
        ("fuse", "stopped; the film is not finished (its JSON says UNFINISHED, if files of it are written)"),
        ("train", "stopped; what is learnt is saved, and the same command goes on"),
    ],
)
def test_ctrl_c_tells_what_is_kept(
    command: str, told: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(_: list[str]) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, f"_{command}", stopped)
    assert cli.main([command]) == 130
    assert capsys.readouterr().err == f"hybrid: {told}\n"


def test_a_file_that_cannot_be_written_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    def full(_: list[str]) -> int:
        raise OSError(28, "No space left on device", "out/film.png")

    monkeypatch.setattr(cli, "_fuse", full)
    assert cli.main(["fuse", "a.jpg", "b.jpg"]) == 1
    told = "A file cannot be read or written (out/film.png): got No space left on device. Mend that (free space, "
    assert capsys.readouterr().err == f"hybrid: {told}permissions, names) and run the same command again.\n"
    assert cli.main([]) == 2


@pytest.mark.usefixtures("_stand_in")
@pytest.mark.parametrize("command", ["rectify", "info"])
def test_each_command_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main([command, "--help"])
    assert ended.value.code == 0
    assert f"hybrid {command}" in capsys.readouterr().out


def test_info(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info"]) == 0
    printed = capsys.readouterr().out
    assert hybrid.__version__ in printed
    assert "torch" in printed


def test_the_record_holds_what_the_result_says():
    uv = film_nodes((3, 4))
    film = np.zeros((10, 20), np.float32)
    covered = np.zeros((10, 20), bool)
    covered[:5] = True
    result = RectifyResult(
        Status(StatusCode.OK), film=film, covered=covered, grid=SliceGrid(2, 3, uv, 100 * uv, 0.9),
        orientation=Orientation(1, True), upright_probability=0.97,
    )  # fmt: skip
    record = result_record((100, 120, 3), result)
    assert record["covered_share"] == 0.5
    assert record["orientation"] == {"quarter_turns_clockwise": 1, "mirrored_first": True, "upright_probability": 0.97}
    np.testing.assert_allclose(record["grid"]["vertices_film"], uv, atol=1e-6)
    np.testing.assert_allclose(record["grid"]["vertices_photo"], 100 * uv, atol=1e-3)
    assert record["photo_size"] == [100, 120]


def test_what_is_lost_of_a_film_is_told():
    film, glare = np.zeros((10, 20), np.float32), np.zeros((10, 20), bool)
    result = RectifyResult(Status(StatusCode.OK), film=film, glare=glare, covered=glare)
    assert warnings_of(result) == []
    glare = glare.copy()
    glare[:2] = True
    assert "20% of it is lost to glare" in warnings_of(replace(result, glare=glare))[0]
    assert "20% of it is hidden" in warnings_of(replace(result, covered=glare))[0]


def test_a_film_that_may_lie_on_its_side_is_told():
    result = RectifyResult(Status(StatusCode.OK), film=np.zeros((10, 20), np.float32), upright_probability=0.5)
    assert "on its side" in warnings_of(result)[0]
    assert warnings_of(replace(result, upright_probability=0.99)) == []
