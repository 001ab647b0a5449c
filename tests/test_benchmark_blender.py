"""Check photos by Blender: what is drawn, kept and refused, with a small script in place of Blender."""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.blender_photos import Job, Options, draw_job, main, room_files, write_print
from benchmarks.photos.truth import load_photos
from data_gen.prints.prints import PrintConfig, make_print
from data_gen.sources import SourceConfig, draw_volume

FAKE = """#!{python}
import json, pathlib, sys
import numpy as np
job = json.loads(pathlib.Path(sys.argv[-1]).read_text())
photo = pathlib.Path(job["photo"])
photo.with_name(photo.stem + ".log").open("a").write("made")
from PIL import Image
Image.new("RGB", (job["side"], job["side"])).save(photo)
lattice = np.stack(np.meshgrid(*2 * [np.linspace(0.0, job["side"], 9)]), axis=-1)
np.savez(photo.with_suffix(".npz"), lattice=lattice, texture=pathlib.Path(job["texture"]).name, meta=json.dumps(job))
"""
SMALL = PrintConfig(longer_px=200)


@pytest.fixture
def blender(tmp_path):
    """A command that takes the place of a Python with bpy."""
    made = tmp_path / "blender"
    made.write_text(FAKE.format(python=sys.executable))
    made.chmod(0o755)
    return made


def print_of(seed):
    rng = np.random.default_rng(seed)
    return make_print(draw_volume(SourceConfig(), rng), rng, SMALL), rng


def test_a_job_survives_json_and_is_drawn_the_same_again(tmp_path):
    jobs = []
    for _ in range(2):
        film_print, rng = print_of(3)
        jobs.append(draw_job(rng, film_print, [], Options(tmp_path, Path("python"))))
    assert jobs[0] == jobs[1]
    again = json.loads(json.dumps(vars(jobs[0])))
    assert set(again) == set(Job.__dataclass_fields__)
    assert max(again["size"]) == 2


def test_films_that_no_room_lights_have_a_lamp_and_those_lit_from_behind_let_light_through(tmp_path):
    options = Options(tmp_path, Path("python"))
    film_print, rng = print_of(1)
    for room in ([], [tmp_path / "room.hdr"]):
        jobs = [draw_job(rng, film_print, room, options) for _ in range(60)]
        assert all(job.lamps for job in jobs if not job.room)
        behind = [job for job in jobs if job.through > 0]
        assert behind
        assert all(lamp["at"][2] < 0 for job in behind for lamp in job.lamps)
        assert all(max(job.pins) < (job.cuts + 2) ** 2 for job in jobs)


def test_photos_are_read_as_others_and_made_once(tmp_path, blender):
    out = tmp_path / "photos"
    words = ["--out", str(out), "--python", str(blender), "--side", "64", "--count"]
    assert main([*words, "1"]) == 0
    assert main([*words, "2"]) == 0
    photos = load_photos(out)
    assert [photo.name for photo in photos] == ["film_000", "film_001"]
    assert all(photo.read().shape == (64, 64, 3) for photo in photos)
    assert all(photo.read_print().shape[0] > photo.rows for photo in photos)
    assert all((out / f"{photo.name}.log").read_text() == "made" for photo in photos)
    assert photos[0].meta["seed"] != photos[1].meta["seed"]


def test_photos_made_with_other_options_are_left_alone(tmp_path, blender, capsys, monkeypatch):
    out = tmp_path / "photos"
    words = ["--out", str(out), "--python", str(blender), "--side", "64", "--count"]
    assert main([*words, "1"]) == 0
    assert main([*words, "2", "--seed", "5"]) == 1
    assert main([*words, "2", "--hard-shadows"]) == 1
    assert "another seed" in capsys.readouterr().err
    scene = tmp_path / "scene.py"
    scene.write_text("# another scene\n")
    with monkeypatch.context() as changed:
        changed.setattr("benchmarks.blender_photos.SCENE", scene)
        assert main([*words, "2"]) == 1
    assert "another generator" in capsys.readouterr().err
    (out / "dataset.json").unlink()
    assert main([*words, "2"]) == 1
    assert "photos without dataset.json" in capsys.readouterr().err
    assert not (out / "film_001.jpg").exists()


def test_environments_of_subfolders_are_found(tmp_path):
    assert room_files(SourceConfig()) == []
    for name in ("a/hall", "bath"):
        path = tmp_path / f"{name}.hdr"
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), np.ones((8, 16, 3), np.float32))
    assert room_files(SourceConfig(hdri=tmp_path, only=("hall",))) == [tmp_path / "a" / "hall.hdr"]


def test_the_name_of_a_print_tells_its_grid(tmp_path):
    film_print, _ = print_of(2)
    (tmp_path / "textures").mkdir()
    name = write_print(tmp_path, 7, film_print).name
    assert name.startswith(f"film_007_{film_print.rows}x{film_print.cols}_{film_print.style}_m")


def test_a_python_without_blender_is_told_of_in_a_line(tmp_path, capsys):
    assert main(["--out", str(tmp_path), "--python", sys.executable, "--count", "1"]) == 1
    told = capsys.readouterr().err
    assert "bpy" in told
    assert "film_000.jpg" in told
    assert main(["--out", str(tmp_path), "--python", str(tmp_path / "none"), "--count", "1"]) == 1
    assert "none" in capsys.readouterr().err
    assert main(["--out", str(tmp_path), "--python", sys.executable, "--count", "0"]) == 1
