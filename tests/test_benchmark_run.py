"""The benchmark of run time against error: the truth scores perfect, results are kept, a method is one small file."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kept_results import refused_elsewhere
from simple_samples import simple_dataset
from threadpoolctl import threadpool_info, threadpool_limits

import benchmarks.lineup
import benchmarks.methods
import benchmarks.report.tables
import benchmarks.rivals.published
import benchmarks.run
from benchmarks.claims import Claim
from benchmarks.lineup import EFFORTS, LINEUP, MAIN, OWN, lineup
from benchmarks.measure import forward_time, measure, peak_memory
from benchmarks.methods import Method, flattened
from benchmarks.page import BEGIN, END, read_results, readme_table, with_table, write_page
from benchmarks.photos.cases import Case, sample_cases
from benchmarks.report.pictures import best_to_worst, seconds_by_stage
from benchmarks.report.results import Report
from benchmarks.report.schema import kept, problems, read_record, schema_of, write_record
from benchmarks.report.summary import duels, rows_of, spread
from benchmarks.report.tables import duel_text, losses_text, photos_text, size_section
from benchmarks.report.text import page_text
from benchmarks.report.traits import _coverage
from benchmarks.rivals.published import TIME_ONLY, Prompt, PromptedFiReNet, true_dewarpnet_answer, true_firenet_answer
from benchmarks.rivals.scanner import find_corners, map_of_corners, true_corners
from benchmarks.run import Options, main, make_methods, run
from benchmarks.scores import CaseScore, score_map, summarise
from hybrid.backward import BackwardMap, end_point_error
from hybrid.coords import film_nodes, pixel_centres
from hybrid.errors import ConfigError, DataError
from hybrid.image_io import read_photo
from hybrid.learn.datasets.samples import truth_at
from hybrid.learn.networks.filmnet import FilmNet, FilmNetConfig
from hybrid.learn.networks.weights import save_weights
from hybrid.learn.paper.baselines import recover
from hybrid.learn.paper.dewarpnet import DewarpNetConfig
from hybrid.learn.paper.firenet import FiReNet, FiReNetConfig
from hybrid.learn.training.presets import PRESETS
from hybrid.pipeline import Rectifier
from hybrid.pipeline.looks import see
from hybrid.pyramid import Pyramid
from hybrid.rectify.coarse.invert import Inversion
from hybrid.rectify.film.resample import rectify_photo
from hybrid.rectify.verdict.trust import REFERENCE_PX
from hybrid.stages import Clock

EXAMPLE = Path(__file__).parents[1] / "hybrid/examples/film.jpg"

MINE = '''"""A method in one small file: it takes every film to fill the middle of the photo."""

import numpy as np

from benchmarks.methods import Method
from hybrid.backward import BackwardMap


def middle(photo):
    h, w = photo.shape[:2]
    return BackwardMap.from_function(lambda uv: (0.2 + 0.6 * uv) * np.array([w, h]))


METHODS = {"middle": lambda weights: Method("middle", middle, label="the middle")}
'''


@pytest.fixture(scope="module")
def cases(dataset: Path) -> list[Case]:
    return sample_cases([dataset])


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(MINE)
    return path


def truth_of(case: Case) -> Method:
    return Method("truth", lambda photo: case.backward)


# ---------------------------------------------------------------- cases and methods


def test_a_resized_photo_keeps_its_truth(cases: list[Case]) -> None:
    large = cases[0].at(0.05)
    assert large.photo().shape[0] == pytest.approx(0.05e6**0.5, abs=1)
    scale = large.photo().shape[0] / 48
    np.testing.assert_allclose(large.backward.nodes, cases[0].backward.nodes * scale, rtol=1e-9)
    assert cases[0].at(48 * 48 / 1e6) is cases[0]
    assert max(cases[0].at(100.0).film_size()) == 2048


def test_the_truth_is_perfect_at_any_size(cases: list[Case]) -> None:
    for case in (cases[0], cases[0].at(0.05)):
        found = measure(truth_of(case), case, 0.05, repeats=2, warm=False)
        assert found.score is not None
        assert found.score.end_point_px < 1e-6
        assert found.score.distortion_px < 1e-6
        assert found.score.paper.deshifted.ms_ssim == pytest.approx(1)
        assert len(found.seconds) == 2
        assert set(found.parts) == {"map", "resample"}


def test_every_photo_is_read_with_one_thread_of_linear_algebra_each(
    cases: list[Case], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Strips are read in parallel, each with one BLAS thread, as the thread pool of BLAS would wait for them."""
    seen: dict[str, set[int]] = {}

    def blas(at: str) -> None:
        seen[at] = {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    def find(photo: np.ndarray) -> BackwardMap:
        blas("map")
        return cases[0].backward

    def read(*arguments: Any) -> Any:
        blas("resample")
        return rectify_photo(*arguments)

    monkeypatch.setattr(benchmarks.methods, "rectify_photo", read)
    photo = cases[0].photo()
    with threadpool_limits(limits=2, user_api="blas"):
        blas("before")
        assert set(flattened(Method("map", find), photo, photo, (48, 48)).parts) == {"map", "resample"}
        blas("after")
    assert seen == {"before": {2}, "map": {1}, "resample": {1}, "after": {2}}


def test_a_method_that_makes_the_print_itself_gives_it_at_the_films_size(cases: list[Case]) -> None:
    case = cases[0].at(0.05)
    network = FiReNet(FiReNetConfig(width=0.03, input_px=64)).eval()
    answer, photo = true_firenet_answer(case, 64), case.photo()
    method = Method("firenet", lambda photo: recover(PromptedFiReNet(network, answer), photo))
    made, alone = flattened(method, photo, photo, (40, 48)), method.find_or_lose(photo)
    assert made.film is not None
    assert made.film.shape == (40, 48)
    assert made.backward is not None
    assert alone is not None
    np.testing.assert_array_equal(alone.nodes, made.backward.nodes)
    by_uv = recover(PromptedFiReNet(network, answer), photo, outline=False).backward
    outwards = end_point_error(by_uv, alone.lattice((9, 9))).mean()  # uv alone moves the corners outwards
    assert 0 < outwards < 1.0


def test_a_lost_film_has_no_score(cases: list[Case]) -> None:
    found = measure(Method("none", lambda photo: None), cases[0], 0.002, repeats=1, warm=True)
    assert (found.found, found.score, found.message) == (False, None, "no film")


def test_the_scanner_finds_a_plain_sheet_and_its_bound_is_a_homography() -> None:
    corners = np.array([[210.3, 130.8], [700.2, 180.1], [655.7, 590.4], [160.9, 540.6]])
    true = map_of_corners(corners)
    photo = np.full((720, 900, 3), 190, np.uint8)
    on_film = np.isfinite(true.film_from_photo(pixel_centres((720, 900)))).all(axis=-1)
    photo[on_film] = 40
    found = find_corners(photo)
    assert found is not None
    assert np.abs(found - corners).max() < 2.0
    np.testing.assert_allclose(true_corners(true), corners, atol=1e-3)
    assert find_corners(np.full((300, 300, 3), 90, np.uint8)) is None


def test_a_network_of_random_weights_is_waited_for_and_answered_for(cases: list[Case]) -> None:
    case = cases[0].at(0.05)
    network = FiReNet(FiReNetConfig(width=0.03, input_px=64)).eval()
    prompt = Prompt(case.photo(), true_firenet_answer(case, 64))
    found = recover(PromptedFiReNet(network, prompt.answer), prompt.photo).backward
    assert score_map(found, case.backward, prompt.photo).end_point_percent < 1
    nodes = true_dewarpnet_answer(case).backward[0].permute(1, 2, 0).numpy()
    assert BackwardMap(nodes).nodes.max() < 1.2  # in units of the photo's sides


@pytest.mark.parametrize("name", ["dewarpnet_full", "dewarpnet_published_full", "firenet_full"])
def test_networks_of_full_width_have_a_run_time_and_no_error(
    name: str, cases: list[Case], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmarks.rivals.published, "FiReNetConfig", lambda: FiReNetConfig(width=0.03, input_px=64))
    monkeypatch.setattr(
        benchmarks.rivals.published, "DewarpNetConfig", lambda: DewarpNetConfig(width=0.03, input_px=128)
    )
    method = LINEUP[name](None)
    assert method is not None
    assert (method.unscored, method.steady, method.training) == (TIME_ONLY, True, "")
    found = measure(method, cases[0].at(0.05), 0.05, repeats=1, warm=True)
    assert (found.found, found.score, len(found.seconds)) == (True, None, 1)


def test_trained_networks_are_scored_and_say_how_they_were_trained(
    cases: list[Case], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    packaged, own = tmp_path / "packaged", tmp_path / "own"
    notes = {"passes": 120_000, "data": ["a", "b"]}
    for folder, width in ((packaged, 0.03), (own, 0.04)):
        folder.mkdir()
        for name in ("firenet", "dewarpnet"):
            chosen = PRESETS[name].at_width(width).at_input(128)
            save_weights(folder / f"{name}.safetensors", chosen.network(), chosen.config, notes)
    names = ("dewarpnet", "dewarpnet_published", "firenet")
    monkeypatch.setattr(benchmarks.methods, "packaged_path", lambda name: tmp_path / "none" / name)
    assert not any(LINEUP[name](None) for name in names)
    monkeypatch.setattr(benchmarks.methods, "packaged_path", lambda name: packaged / f"{name}.safetensors")
    for name in names:
        method, other = LINEUP[name](None), LINEUP[name](own)
        assert method is not None
        assert other is not None
        assert "trained at width 0.03 (" in method.label
        assert "M parameters" in method.label
        assert method.training == "trained on 120,000 images of a, b"
        assert "trained at width 0.04" in other.label
        assert not method.unscored
        assert (method.parameters or 0) < (other.parameters or 0)
    method = LINEUP["dewarpnet_published"](None)
    assert method is not None
    found = measure(method, cases[0], 0.002, repeats=1, warm=True)
    assert found.score is not None
    assert found.output == cases[0].photo().shape[:2]  # as released: the photo's size
    photo = cases[0].photo()
    made = flattened(method, photo, photo, (48, 48)).backward
    monkeypatch.setattr(benchmarks.methods, "published_image", None)  # the map alone needs no picture
    alone = method.find(photo)
    assert made is not None
    assert alone is not None
    np.testing.assert_array_equal(alone.nodes, made.nodes)


@pytest.mark.parametrize("name", ["firenet", "firenet_multimap", "firenet_uv_only"])
def test_weights_of_one_ablation_do_not_pass_for_those_of_another(name: str, tmp_path: Path) -> None:
    made = PRESETS["firenet_multimap"].at_width(0.03).at_input(64)
    save_weights(tmp_path / f"{name}.safetensors", made.network(), made.config, {"passes": 8, "before": 4})
    if name == "firenet_multimap":
        known = benchmarks.methods.trained(tmp_path, name)
        assert known is not None
        assert known.training == "trained on 12 images"
    else:
        with pytest.raises(DataError, match=f"(maps|heads) of {name} .*: got .*; allowed: .*--preset {name}"):
            benchmarks.methods.trained(tmp_path, name)


def test_methods_without_weights_stay_out_unless_they_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = {"here": lambda weights: Method("here", lambda photo: None), "gone": lambda weights: None}
    monkeypatch.setattr(benchmarks.run, "lineup", lambda added: table)
    assert list(make_methods(Options(tmp_path))) == ["here"]
    with pytest.raises(ConfigError, match=r"gone.*--weights"):
        make_methods(Options(tmp_path, methods=("gone",)))


def test_the_network_alone_is_what_refinement_starts_from() -> None:
    """That is the map of its last look from one side, not the mean over all sides."""
    method, photo = LINEUP["filmnet"](None), read_photo(EXAMPLE)
    assert method is not None
    alone, rectifier = method.find(photo), Rectifier()
    start = see(rectifier._readers.network, Pyramid(photo), rectifier.config, Clock()).inversion
    mean = rectifier.network_map(photo)
    assert alone is not None
    assert mean is not None
    assert isinstance(start, Inversion)
    np.testing.assert_array_equal(alone.nodes, start.backward.nodes)
    assert np.abs(mean.nodes - alone.nodes).max() > 0


def test_own_methods_are_efforts_and_parts() -> None:
    assert set(EFFORTS) <= OWN <= set(LINEUP)
    assert MAIN in EFFORTS


def test_configurations_are_methods_like_others(cases: list[Case]) -> None:
    method = LINEUP["hybrid_light_kept"](None)
    assert method is not None
    photo = cases[0].at(0.05).photo()
    made = flattened(method, photo, photo, (64, 64))
    assert {"read", "survey", "network"} <= set(made.parts)
    assert made.message


# ---------------------------------------------------------------- a method in one small file


def test_anyone_can_add_a_method(mine: Path, dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = Options(
        out,
        data=(dataset,),
        sizes=(0.003,),
        counts=(2,),
        repeats=1,
        add=(mine,),
        methods=("middle", "remap"),
        memory=(),
        networks=("FilmNet",),
    )
    report = run(options, ["python -m benchmarks.run"])
    (row, floor) = rows_of(report, 0.003)
    assert (row.method.label, row.photos, row.lost) == ("the middle", 2, 0)
    assert row.error is not None
    assert row.error > 0
    assert floor.method.unscored
    assert (out / "pictures" / "time_error.png").exists()


def test_a_file_without_methods_is_refused(tmp_path: Path, mine: Path) -> None:
    (tmp_path / "empty.py").write_text("x = 1\n")
    with pytest.raises(ConfigError, match=r"empty\.py.*METHODS"):
        lineup((tmp_path / "empty.py",))
    with pytest.raises(ConfigError, match=r"Name a \.py file"):
        lineup((tmp_path / "missing.py",))
    mine.write_text(MINE.replace('"middle":', '"hybrid":'))
    with pytest.raises(ConfigError, match="Choose other names"):
        lineup((mine,))


# ---------------------------------------------------------------- reports


@pytest.fixture(scope="module")
def made(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Options, Report]:
    folder = tmp_path_factory.mktemp("run")
    (folder / "mine.py").write_text(MINE)
    options = Options(
        folder / "out",
        data=(dataset,),
        sizes=(0.003, 0.05),
        counts=(3, 2),
        repeats=2,
        add=(folder / "mine.py",),
        methods=("remap", "scanner_true", "middle"),
        memory=(),
        networks=("FilmNet",),
        page=folder / "docs" / "benchmarks.md",
    )
    return options, run(options, ["python -m benchmarks.run", "--data", str(dataset)])


def test_the_report_is_as_its_schema_says(made: tuple[Options, Report]) -> None:
    options, report = made
    value = json.loads((options.out / "run.json").read_text())
    schema = schema_of(Report)
    assert problems(value, schema) == []
    assert read_record(options.out / "run.json", Report) == report
    assert str(options.out) not in json.dumps(value)
    del value["measured"][0]["seconds"]
    value["memory"] = [{"method": 3}]
    value["surprise"] = True
    found = " ".join(problems(value, schema))
    assert all(text in found for text in ("no seconds", "memory[0].method: got int", "no peak_mib", "unknown surprise"))


def test_a_run_goes_on_where_it_was_cut_off(made: tuple[Options, Report]) -> None:
    options, report = made
    lost = options.out / "measured" / f"0.003_{report.cases[0].name}_middle.json"
    assert lost.exists()
    lost.unlink()
    again = run(options, ["python -m benchmarks.run"])
    same = [one for one in again.measured if (one.method, one.case) != ("middle", report.cases[0].name)]
    assert set(map(repr, same)) <= set(map(repr, report.measured))
    assert len(again.measured) == len(report.measured) == 3 * 3 + 3 * 2
    with pytest.raises(ConfigError, match="other settings"):
        run(replace(options, repeats=3), ["x"])


def one_photo(out: Path, data: Path, mine: Path) -> Options:
    """The smallest run: one added method on a single small photo of a data set."""
    return Options(
        out,
        data=(data,),
        sizes=(0.003,),
        counts=(1,),
        repeats=1,
        add=(mine,),
        methods=("middle",),
        memory=(),
        networks=(),
    )


def test_results_of_other_photos_or_elsewhere_are_not_put_together(
    tmp_path: Path, mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run refuses results from another processor, and from a data set that replaced one of the same name."""
    data = simple_dataset(tmp_path / "data")
    options = one_photo(tmp_path / "out", data, mine)
    first = run(options, ["x"])
    assert run(options, ["x"]).measured == first.measured
    refused_elsewhere(lambda: run(options, ["x"]), data, monkeypatch)


def test_the_page_and_the_readme_come_from_the_figures(made: tuple[Options, Report]) -> None:
    options, report = made
    assert options.page is not None
    text = options.page.read_text()
    assert text == page_text(read_results(options.page.parent, "benchmarks_"))
    assert all(word in text for word in ("cv2.remap alone", "the middle", "### 0.05 megapixels", "No GPU was at hand"))
    assert (options.page.parent / "images" / "benchmarks_time_error.png").exists()
    readme = with_table(f"a\n{BEGIN}\nformer\n{END}\nb\n", readme_table(report))
    assert readme.startswith(f"a\n{BEGIN}\n")
    assert readme.endswith(f"{END}\nb\n")
    assert "former" not in readme
    assert "the middle" in readme
    assert with_table("no marks", "x") == "no marks"


def test_every_loss_is_listed(made: tuple[Options, Report], monkeypatch: pytest.MonkeyPatch) -> None:
    """The worse of two methods is taken for ours: losses are listed for both sizes and every kind of photo."""
    _, report = made
    assert losses_text(report) == "`hybrid` was not run."
    monkeypatch.setattr(benchmarks.report.tables, "EFFORTS", {"middle": None})
    monkeypatch.setattr(benchmarks.report.tables, "OWN", frozenset({"middle"}))
    lines = losses_text(report).splitlines()
    assert sum(line.endswith(" times its error at 0.003, 0.05 MP") for line in lines) == 1
    assert any("photos of one kind (cell style" in line and "four corners" in line for line in lines)
    kinds = sum(len(part) for part in ({c.style for c in report.cases}, {c.light for c in report.cases}))
    assert sum("photos of one kind" in line for line in lines) >= kinds


def test_a_method_that_wins_everywhere_has_no_losses(
    made: tuple[Options, Report], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, report = made
    slow = [replace(m, seconds=(99.0,), cpu_seconds=(99.0,)) if m.method == "middle" else m for m in report.measured]
    monkeypatch.setattr(benchmarks.report.tables, "EFFORTS", {"scanner_true": None})
    monkeypatch.setattr(benchmarks.report.tables, "OWN", frozenset({"scanner_true"}))
    assert losses_text(replace(report, measured=tuple(slow))).startswith("Nothing: it is faster than every rival")


def test_a_duel_is_one_line_whatever_the_sizes(made: tuple[Options, Report]) -> None:
    _, report = made
    head, _, *rows = duel_text(duels(report, ("scanner_true",), "middle")).splitlines()
    assert "times as fast, 0.003 MP | times as fast, 0.05 MP | times as near" in head
    photos = duels(report, ("scanner_true",), "middle")[0].both  # the same photos, whatever their size
    assert len(rows) == 1
    assert rows[0].endswith(f" of {photos} |")


def test_duels_are_ratios_in_the_methods_favour(made: tuple[Options, Report]) -> None:
    _, report = made
    for duel, back in zip(
        duels(report, ("scanner_true",), "middle"), duels(report, ("middle",), "scanner_true"), strict=True
    ):
        assert duel.faster * back.faster == pytest.approx(1)
        assert duel.closer is not None
        assert back.closer is not None
        assert duel.closer < 1 < back.closer
        assert duel.lost
        assert duel.nearer + back.nearer == duel.both > 0


def test_photos_are_listed_and_drawn_from_best_to_worst(made: tuple[Options, Report]) -> None:
    _, report = made
    ours = replace(
        report,
        measured=tuple(replace(m, method="hybrid", grid="2x3") for m in report.measured if m.method == "middle"),
    )
    errors = {m.case: m.score.end_point_px for m in ours.measured if m.score and m.megapixels == 0.003}
    order = [name for _, name in best_to_worst(ours, 99)]
    assert order == sorted(errors, key=lambda name: errors[name])
    assert [label for label, _ in best_to_worst(ours, 3)] == ["best", "median", "worst"]
    assert best_to_worst(report, 3) == []
    rows = photos_text(ours).splitlines()[2:]
    assert [row.split(" | ")[0].strip("| ") for row in rows] == order
    assert all("2x3" in row for row in rows)


def claiming(report: Report, claims: list[Claim]) -> Report:
    """The report with these claims of `middle`, one for each photo of the first size."""
    told = iter(claims)
    measured = tuple(
        replace(m, claim=next(told)) if (m.method, m.megapixels) == ("middle", 0.003) else m for m in report.measured
    )
    return replace(report, measured=measured)


def test_films_called_ok_are_counted_and_so_are_those_wrongly_called_so(
    made: tuple[Options, Report], tmp_path: Path
) -> None:
    options, report = made
    claims = [Claim("OK", 1.0, limit_px=1e-9), Claim("OK", 1.0, limit_px=1e9), Claim("UNSURE", 9.0, limit_px=1e-9)]
    told = claiming(report, claims)
    rows = {row.method.name: row for row in rows_of(told, 0.003)}
    assert (rows["middle"].ok, rows["middle"].wrongly_ok) == (2, 1)
    assert rows["remap"].ok is None
    head, _, *cells = size_section(told, 0.003).splitlines()[2:]
    assert head.endswith("| `OK` (wrongly) |")
    assert [row.rpartition("| ")[2] for row in [line.removesuffix(" |") for line in cells]] == ["-", "-", "2 (1)"]
    text = page_text(replace(read_results(options.out), run=told))
    assert "above the limit that it states for such films (1e-09, 1e+09 px)" in text
    write_record(tmp_path / "run.json", told)
    assert read_record(tmp_path / "run.json", Report) == told


def test_results_from_before_there_were_claims_are_read_and_shown_without(
    made: tuple[Options, Report], tmp_path: Path
) -> None:
    _, report = made
    write_record(tmp_path / "run.json", report)
    value = json.loads((tmp_path / "run.json").read_text())
    for one in value["measured"]:
        del one["claim"]
    (tmp_path / "run.json").write_text(json.dumps(value))
    assert read_results(tmp_path).run == report
    assert "`OK`" not in page_text(read_results(tmp_path))


def test_published_figures_make_the_published_page() -> None:
    docs = Path(__file__).parents[1] / "docs"
    assert (docs / "benchmarks.md").read_text() == page_text(read_results(docs, "benchmarks_"))


def test_the_page_has_the_charts_of_its_run_whatever_lies_there(made: tuple[Options, Report], tmp_path: Path) -> None:
    shutil.copyfile(made[0].out / "run.json", tmp_path / "run.json")
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "stages.png").write_bytes(b"of another run")
    write_page(tmp_path / "page.md", tmp_path)
    drawn = seconds_by_stage(read_record(tmp_path / "run.json", Report))
    assert np.array_equal(read_photo(tmp_path / "images" / "benchmarks_stages.png"), drawn)


def test_published_figures_make_the_readme_s_table() -> None:
    root = Path(__file__).parents[1]
    readme = (root / "README.md").read_text()
    assert with_table(readme, readme_table(read_results(root / "docs", "benchmarks_").run)) == readme


def test_results_that_are_none_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="Run the benchmark again"):
        read_results(tmp_path)
    (tmp_path / "run.json").write_text('{"run": {}}')
    with pytest.raises(DataError, match="no settings"):
        read_record(tmp_path / "run.json", Report)


def test_kept_results_are_not_made_twice(made: tuple[Options, Report], tmp_path: Path) -> None:
    note, calls = made[1].cases[0], []
    path = tmp_path / "note.json"
    for _ in range(2):
        assert kept(path, type(note), lambda: calls.append(1) or note) == note
    assert len(calls) == 1
    path.write_text("{}")
    assert kept(path, type(note), lambda: None) is None
    write_record(path, note)
    assert read_record(path, type(note)) == note


def test_a_run_that_failed_before_its_first_photo_decides_nothing(dataset: Path, mine: Path, tmp_path: Path) -> None:
    wrong = one_photo(tmp_path / "out", tmp_path, mine)
    with pytest.raises(DataError):
        run(wrong, ["x"])
    assert len(run(replace(wrong, data=(dataset,)), ["x"]).measured) == 1
    with pytest.raises(ConfigError, match="other settings"):
        run(wrong, ["x"])


# ---------------------------------------------------------------- memory, networks, options


class _First:
    """Picklable: the first case of a data set, for use in a separate process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __call__(self) -> Case:
        return sample_cases([self.folder])[0]


class _Hungry:
    """Picklable: a method that takes about 100 MiB."""

    def __call__(self) -> Method:
        def find(photo: np.ndarray) -> None:
            np.ones(100 * 2**20, np.uint8)

        return Method("hungry", find)


def test_memory_is_the_methods_own(dataset: Path) -> None:
    found = peak_memory(_First(dataset), _Hungry(), 0.003, threads=1)
    if found is None:
        pytest.skip("this system does not tell a process's memory")
    assert 95 < found.own_mib < 130
    assert found.peak_mib > found.own_mib


def test_networks_alone_are_timed() -> None:
    network = FilmNet(FilmNetConfig(widths=(4, 8, 8, 8), blocks=(1, 1, 1), input_px=64))
    found = forward_time("filmnet", network, "cpu", 2, repeats=2)
    assert (found.batch, found.device, len(found.seconds), len(found.cpu_seconds)) == (2, "cpu", 2, 2)


def test_wrong_options_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ConfigError, match="as many counts as sizes"):
        Options(tmp_path, sizes=(1.0,), counts=(1, 2))
    with pytest.raises(ConfigError, match=r"UNet.*allowed: FilmNet"):
        Options(tmp_path, networks=("UNet",))
    with pytest.raises(ConfigError, match="no negative numbers"):
        Options(tmp_path, gallery=-1)
    with pytest.raises(ConfigError, match="unet"):
        Options(tmp_path, methods=("unet",))
    assert main(["--out", str(tmp_path), "--photos", str(tmp_path)]) == 1
    assert "Name a folder" in capsys.readouterr().err


def test_photos_are_spread_over_the_set(cases: list[Case]) -> None:
    assert spread(cases, 2) == [cases[0], cases[2]]
    assert spread(cases, 9) == cases


def test_a_photo_and_its_truth_are_scored_without_being_touched(cases: list[Case]) -> None:
    photo, true = cases[1].photo(), cases[1].backward
    before, nodes = photo.copy(), true.nodes.copy()
    first = score_map(true, true, photo)
    assert score_map(true, true, photo) == first
    np.testing.assert_array_equal(photo, before)
    np.testing.assert_array_equal(true.nodes, nodes)
    assert end_point_error(true, true.lattice((9, 9))).max() == 0
    assert end_point_error(true, true.photo_from_film(film_nodes((9, 9)))).max() < 1e-9


@pytest.mark.parametrize("px", [16, 24, 29, 48])
def test_resized_maps_hold_no_pixel_mixed_with_background(cases: list[Case], px: int) -> None:
    for case in cases:
        assert not isinstance(case.source, Path)
        points = pixel_centres((px, px)) * (48 / px)
        truth = truth_at(case.source, points, (48, 48))
        assert truth.mask.any()
        film, seen = truth.uv[truth.mask].astype(np.float64), points[truth.mask]
        film_per_px = np.median(film / seen)  # these films lie flat, with their top left corner at the photo's
        assert np.linalg.norm(film / film_per_px - seen, axis=-1).max() * px / 48 < 1.0


def test_scores_are_of_all_points_of_all_photos(cases: list[Case]) -> None:
    """A map is 10 px off in an eighth of its width: the 95th percentile shows this, the mean hardly does."""
    case = cases[0]
    photo = case.photo()
    nodes = case.backward.lattice((65, 65)).copy()
    nodes[:, -8:, 0] += 10.0
    one, true = (score_map(BackwardMap(n), case.backward, photo) for n in (nodes, case.backward.lattice((65, 65))))
    px = REFERENCE_PX / max(photo.shape[:2])
    assert one.end_point_p95_px > 5 * px > one.end_point_px
    both = summarise([CaseScore("a", 1.0, one), CaseScore("b", 1.0, true)], says_up=False)
    assert both["raw"]["psnr"] == pytest.approx((one.paper.raw.psnr + true.paper.raw.psnr) / 2)


def test_coverage_is_the_share_of_the_photo_within_the_outline() -> None:
    outline = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 50.0], [0.0, 50.0]])
    assert _coverage(outline, (200, 100)) == pytest.approx(0.25, abs=0.02)
