"""The verdict's regressions find the weights that errors were drawn with; no film is judged by weights fitted to it."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simple_samples import simple_dataset

from benchmarks.photos.cases import sample_cases
from benchmarks.verdict import Options, Rectifiers, counted, figures, judge_all, judged, main
from benchmarks.verdict_fit import FOLDS, Judged, fit_chance, fit_error, trust_of_others
from hybrid.effort import RectifyConfig
from hybrid.pipeline import Rectifier
from hybrid.records import RectifyResult, Signs, Status, StatusCode
from hybrid.rectify.verdict.trust import TrustConfig, chance_features, features

TRUST = TrustConfig()
SURE: dict[str, Any] = {
    "support": 0.97, "in_step": 0.98, "overlap_after": 0.99, "alike": 0.7, "seen_beside": 0.002, "stated": 0.0004,
    "edges_beside": 0.0002, "borders_shown": 1.0, "lopsided": 0.0, "sheet": True,
}  # fmt: skip
"""Signs of a film that is called ``OK``."""


def drawn_signs(rng: np.random.Generator) -> Signs:
    """Random signs, spread as in photos and drawn independently."""
    beside, stated, edges = np.exp(rng.normal(np.log([0.006, 0.002, 0.001]), 0.7)).tolist()
    return Signs(
        overlap_before=rng.uniform(0.8, 1), overlap_after=rng.uniform(0.9, 1), alike=rng.uniform(), grid=True,
        corrected=True, edges=4, film_px=rng.uniform(300, 900), photo_px=1080, levels=200.0,
        support=rng.uniform(0.5, 1), in_step=rng.uniform(0.8, 1), seen_beside=beside, stated=stated,
        edges_beside=edges, borders_shown=rng.uniform(0.5, 1), lopsided=rng.uniform(0, 0.05),
        sheet=bool(rng.random() < 0.7),
    )  # fmt: skip


def drawn_films(count: int, seed: int) -> list[Judged]:
    """Films whose chance to be right within any limit follows from their signs by the packaged weights."""
    rng, weights, films = np.random.default_rng(seed), asdict(TRUST.chance), []
    for k in range(count):
        signs = drawn_signs(rng)
        score = sum(weights[name] * value for name, value in chance_features(signs, signs.film_px).items())
        error = np.exp((rng.logistic() - score) / weights["limit"]) * signs.film_px
        films.append(Judged(f"sheet {k // 4}", k % 4, float(error), signs))
    return films


def test_the_weights_that_errors_were_drawn_with_are_found() -> None:
    found, true = asdict(fit_chance(drawn_films(4000, 0), TRUST)), asdict(TRUST.chance)
    for name in ("limit", "seen_beside", "stated", "edges_beside", "lopsided"):
        assert found[name] == pytest.approx(true[name], abs=0.15 + 0.15 * abs(true[name])), name


def test_the_weights_of_the_expected_error_are_found_whatever_a_tenth_of_the_films_is() -> None:
    rng, true, films = np.random.default_rng(1), asdict(TRUST.error), []
    for k in range(2000):
        signs = drawn_signs(rng)
        log = sum(true[name] * value for name, value in features(signs).items()) + rng.laplace(0, 0.2)
        films.append(Judged("sheet", k, float(np.exp(log + 4.0 * (k % 10 == 0))) * signs.film_px, signs))
    found = asdict(fit_error(films))
    table = [features(one.signs) for one in films]
    for name, weight in true.items():
        if name != "constant":  # the constant absorbs what a tenth of the films adds
            spread = np.std([row[name] for row in table])
            assert spread * found[name] == pytest.approx(spread * weight, abs=0.02), name


def test_photos_that_are_the_flat_film_themselves_do_not_count_for_the_weights() -> None:
    films = drawn_films(100, 6)
    flat = [replace(one, error_px=500.0, signs=replace(one.signs, flat=True)) for one in drawn_films(50, 7)]
    assert fit_chance(films + flat, TRUST) == fit_chance(films, TRUST)
    assert fit_error(films + flat) == fit_error(films)


def test_no_film_is_judged_by_weights_that_its_own_sheet_made() -> None:
    films = drawn_films(8 * FOLDS, 2)
    before = trust_of_others(films, TRUST)
    first = films[0].sheet
    changed = [replace(one, error_px=1e3 * one.error_px) if one.sheet == first else one for one in films]
    after = trust_of_others(changed, TRUST)
    same = [one == other for one, other in zip(before, after, strict=True)]
    assert all(alike for alike, one in zip(same, films, strict=True) if one.sheet == first)
    assert not all(same)


def test_the_figures_add_up() -> None:
    films = drawn_films(400, 3)
    found = figures(films, 420, TRUST)
    assert (found["photos"], found["films"]) == (420, 400)
    assert found["right"] == sum(part["right"] for part in found["by_probability"])
    assert found["films"] == sum(part["films"] for part in found["by_probability"])
    for part in found["by_probability"]:  # within four standard deviations, as these probabilities drew the errors
        low, high, films_there = part["from"], part["to"], max(part["films"], 1)
        slack = 2.0 / np.sqrt(films_there)
        assert low - slack <= part["right"] / films_there <= high + slack or part["films"] < 10
    assert found["packaged"] == counted(films, 400 * [TRUST])
    assert counted(films, 400 * [replace(TRUST, least_chance=1.0)]) == {"ok": 0, "wrong": 0}


class Told(Rectifier):
    """Finds the true film, slightly shifted, with the given signs; finds none without signs."""

    def __init__(self, case, signs: Signs | None, aside: float = 2.0) -> None:
        self.case, self.signs, self.aside = case, signs, aside

    def __call__(self, source) -> RectifyResult:
        if self.signs is None:
            return RectifyResult(Status(StatusCode.NO_FILM))
        shifted = self.case.backward.cropped((-self.aside, 0.0))
        return RectifyResult(Status(StatusCode.OK), backward=shifted, signs=self.signs)


def test_a_photo_is_judged_by_its_true_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (elsewhere := tmp_path / "far" / "away" / "from").mkdir(parents=True)
    monkeypatch.chdir(elsewhere)
    case = sample_cases([simple_dataset(tmp_path / "data")])[1]
    sure = replace(drawn_signs(np.random.default_rng(4)), **SURE)
    found = judged(Rectifiers(Told(case, None), Told(case, sure)), case)
    assert found is not None
    assert (found.error_px, found.signs, found.first) == (pytest.approx(2.0), sure, None)
    assert found.sheet == ".../data - 0"  # without this machine's folders
    assert judged(Rectifiers(Told(case, sure), Told(case, None)), case) is None


def test_of_what_was_refined_again_both_are_told(tmp_path: Path) -> None:
    case = sample_cases([simple_dataset(tmp_path / "data")])[1]
    sure = replace(drawn_signs(np.random.default_rng(4)), **SURE)
    unsure, again = replace(sure, edges=3), replace(sure, doubted=True)
    found = judged(Rectifiers(Told(case, unsure), Told(case, again, 1.0)), case)
    assert found is not None
    assert found.first is not None
    assert (found.error_px, found.signs) == (pytest.approx(1.0), again)
    assert (found.first.error_px, found.first.signs) == (pytest.approx(2.0), unsure)
    assert found.that_counts(TRUST) is found
    assert found.that_counts(replace(TRUST, min_edges=3)) is found.first
    alone = judged(Rectifiers(Told(case, unsure), Told(case, unsure)), case)
    assert alone is not None
    assert alone.first is None


def test_weights_are_fitted_to_what_films_were_at_first_too() -> None:
    films = drawn_films(200, 8)
    again = [replace(one, first=other) for one, other in zip(films[:100], films[100:], strict=True)]
    assert asdict(fit_chance(again, TRUST)) == pytest.approx(asdict(fit_chance(films, TRUST)), abs=0.002)


def test_the_command_judges_photos_and_writes_what_it_saw(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    films = iter(drawn_films(40, 5))
    monkeypatch.setattr("benchmarks.verdict.judge_all", lambda options: (list(films), 44))
    assert main(["--data", str(tmp_path), "--json", str(tmp_path / "out" / "verdict.json")]) == 0
    written = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert len(written["films"]) == 40
    assert set(written["figures"]["fitted"]["chance"]) == set(asdict(TRUST.chance))
    assert "40 films in 44 photos" in capsys.readouterr().out
    assert main(["--data", str(tmp_path), "--json", str(tmp_path / "x.json"), "--every", "0"]) == 1
    assert "every" in capsys.readouterr().err


def test_data_that_no_weights_can_be_fitted_to_are_told_before_anything_is_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = simple_dataset(tmp_path / "data")
    assert main(["--data", str(data), "--json", str(tmp_path / "out.json"), "--every", "100"]) == 1
    assert "photos of one sheet" in capsys.readouterr().err


def test_photos_are_judged_with_the_effort_that_was_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    monkeypatch.setattr("benchmarks.verdict.Rectifier", lambda config: made.append(config) or Rectifier(config))
    options = Options((simple_dataset(tmp_path / "data"),), tmp_path / "x.json", "fast", every=2, workers=1)
    assert judge_all(options) == ([], 2)  # photos of 48 px are too small for a film to be found in
    assert made == 2 * [RectifyConfig.of("fast")]  # this effort does not go on when in doubt
