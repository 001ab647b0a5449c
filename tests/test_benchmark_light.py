"""How light removal is scored: bounds that keep their promise, pooled overlaps, and the command itself."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from film_photos import film_print

from benchmarks import light
from benchmarks.light import (
    Compared,
    LightScore,
    affine,
    best_curve,
    best_local,
    decibels,
    flat_size,
    scored,
    summarise,
)
from hybrid.backward import BackwardMap
from hybrid.coords import film_centres, film_nodes, linear_from_srgb, srgb_from_linear
from hybrid.image_io import write_rgb

SIZE = (96, 80)
SEEN = np.ones(SIZE, bool)


def printed() -> np.ndarray:
    return np.random.default_rng(0).uniform(0.05, 0.95, SIZE).astype(np.float32)


def gain() -> np.ndarray:
    u, v = film_centres(SIZE).transpose(2, 0, 1)
    return (0.4 + 0.3 * u + 0.2 * v).astype(np.float32)


def test_what_is_alike_after_gain_and_offset_scores_no_less_than_its_rounding():
    truth = printed()
    assert decibels(affine(0.3 * truth + 0.2, truth, SEEN), truth, SEEN) == pytest.approx(100, abs=15)
    half = SEEN.copy()
    half[:, 40:] = False
    spoilt = np.where(half, 0.3 * truth + 0.2, np.float32(0.9))
    assert decibels(affine(spoilt, truth, half), truth, half) > 80  # unseen pixels do not count
    assert decibels(affine(spoilt, truth, SEEN), truth, SEEN) < 20


def test_an_inverted_film_is_no_better_than_an_even_one():
    truth = printed()
    inverted = decibels(affine(1 - truth, truth, SEEN), truth, SEEN)
    assert inverted == pytest.approx(decibels(np.full_like(truth, truth.mean()), truth, SEEN), abs=1e-3)


def test_the_best_curve_undoes_a_curve_and_stays_monotone():
    truth = printed()
    curved = truth**2.2
    assert decibels(affine(curved, truth, SEEN), truth, SEEN) < 30
    undone = best_curve(curved, truth, SEEN)
    assert decibels(undone, truth, SEEN) > 45
    order = np.argsort(curved, axis=None)
    assert np.diff(undone.reshape(-1)[order]).min() >= 0


def test_the_best_local_gain_undoes_uneven_light():
    truth = printed()
    lit = gain() * truth + 0.1 * gain()
    assert decibels(affine(lit, truth, SEEN), truth, SEEN) < 22
    assert decibels(best_local(lit, truth, SEEN), truth, SEEN) > 28


def test_a_picture_is_scored_against_its_print():
    truth = printed()
    glare = np.zeros((50, 40), bool)
    glare[:5] = True
    found = scored("one", Compared(gain() * truth, 0.5 * truth, truth, SEEN), glare, 3.0, 20, 40)
    assert found.film > 80 > found.best_both > found.lit
    assert found.film_ssim == pytest.approx(1, abs=1e-3)
    assert found.lit_ssim < found.film_ssim
    assert (found.glare_share, found.film_px, found.milliseconds) == (0.1, (50, 40), 3.0)


def test_overlaps_of_glare_are_pooled_and_what_has_no_truth_stays_out():
    def one(both: int | None, either: int | None, db: float) -> LightScore:
        return LightScore("x", db, db + 2, 0.5, 0.6, db, db, db, 0.1, both, either, 7.0)

    summary = summarise([one(10, 10, 20.0), one(0, 30, 22.0), one(None, None, 30.0)])
    assert summary["glare_iou"] == pytest.approx(0.25)
    assert summary["lit"] == {"median": 22.0, "mean": 24.0, "worst": 20.0}
    assert summary["film"]["median"] == 24.0
    assert (summary["count"], summary["milliseconds"]) == (3, 7.0)
    assert summarise([one(None, None, 20.0)])["glare_iou"] is None


def test_a_film_is_as_large_as_keeps_its_pixels():
    film = BackwardMap(film_nodes((9, 9)) * np.array([300.0, 500.0]))
    assert flat_size(film, 1.25) == (500, 400)
    height, width = flat_size(BackwardMap(film.nodes * 20), 1.25)
    assert (height, width) == (light.MAX_SIDE_PX, round(light.MAX_SIDE_PX / 1.25))


def test_the_command_measures_photos_with_their_prints(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """A print in uneven light fills the photo but for a rim: the light stage must improve it."""
    sheet = cv2.resize(film_print(19).image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    h, w = sheet.shape
    u, v = film_centres((h, w)).transpose(2, 0, 1)
    lit = srgb_from_linear(linear_from_srgb(sheet.astype(float)) * (0.08 + 0.9 * u * v) + 0.02 * u)
    photo = np.full((h + 40, w + 40), 0.5)
    photo[20:-20, 20:-20] = lit
    folder, name = tmp_path / "photos", "film_7_4x5_rules_m0.png"
    (folder / "textures").mkdir(parents=True)
    for path, grey in ((folder / "a.jpg", photo), (folder / "textures" / name, sheet)):
        write_rgb(path, np.repeat(np.rint(255 * grey).astype(np.uint8)[..., None], 3, axis=2))
    lattice = film_nodes((9, 9)) * np.array([w, h]) + 20.0
    np.savez(folder / "a.npz", lattice=lattice, texture=name, meta="{}")
    out = tmp_path / "light.json"
    arguments = ["--photos", str(folder), "--json", str(out), "--pictures", str(tmp_path / "pictures")]
    assert light.main(arguments) == 0
    (score,) = json.loads(out.read_text())["scores"]["photos"]
    assert score["film"] > score["lit"] + 1
    assert score["best_local"] > score["lit"]
    assert score["milliseconds"] > 0
    assert (tmp_path / "pictures" / "light.jpg").stat().st_size > 1000
    assert "photos: 1, medians: lit" in capsys.readouterr().out
    assert light.main(["--json", str(out)]) == 1
    assert "Name --photos or --data" in capsys.readouterr().err
