"""The whole pipeline with the packaged network: what a result promises, and what comes of photos without a film."""

import copy
import os
import pickle
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from itertools import combinations
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest
from test_plane import flat_photo, plane_map
from threadpoolctl import threadpool_info

import hybrid
import hybrid.records
from data_gen.sample import SampleConfig, film_samples
from hybrid.backward import Orientation, end_point_error, film_as_seen, mean_move
from hybrid.effort import Effort
from hybrid.errors import ConfigError, DataError, PhotoError
from hybrid.learn.reading.views import plane_of
from hybrid.pipeline import Rectifier, RectifyConfig
from hybrid.pipeline.doubt import Judged, beyond_doubt, judged
from hybrid.pipeline.geometry import shape_of
from hybrid.pipeline.job import Job
from hybrid.pipeline.looks import checked, see, see_bent
from hybrid.pipeline.starts import BENDS, BENT, KEPT, other_starts
from hybrid.pipeline.whole_sheet import WholeSheet
from hybrid.pyramid import Pyramid
from hybrid.records import StageReport, StatusCode
from hybrid.rectify.coarse.foreshortening import turned_away
from hybrid.rectify.coarse.invert import Inversion, NotInverted
from hybrid.rectify.verdict.nearness import nearness
from hybrid.rectify.verdict.survey import Verdict
from hybrid.rectify.verdict.trust import chance_right, floored
from hybrid.stages import Clock

ROOT = Path(__file__).parents[1]
EXAMPLE = Path(hybrid.__file__).parent / "examples" / "film.jpg"


@pytest.fixture(scope="module")
def rectifier():
    return Rectifier()


@pytest.fixture(scope="module")
def photo():
    return cv2.imread(str(EXAMPLE))[..., ::-1].copy()


@pytest.fixture(scope="module")
def result(rectifier, photo):
    return rectifier(photo)


def test_the_example_is_flattened(result, photo):
    assert result.status.ok, result.status
    h, w = result.film.shape
    assert result.film.dtype == np.float32
    assert 0 <= result.film.min() <= result.film.max() <= 1
    assert result.rectified.shape == (h, w, 3)
    assert result.rectified.dtype == np.uint8
    assert result.glare.shape == result.confidence.shape == (h, w)
    assert result.backward.film_from_photo(result.backward.photo_from_film(np.array([[0.3, 0.6]]))) == pytest.approx(
        np.array([[0.3, 0.6]])
    )
    nodes = result.backward.nodes
    assert nodes.min() > -0.1 * max(photo.shape)
    assert nodes.max() < 1.1 * max(photo.shape)


def test_the_corners_of_the_example_are_where_they_are_seen(result):
    """They agree with its true maps to a pixel or two of 1,400; a sheet bent too sharply there would round them off."""
    true = np.array([[190.2, 532.3], [1174.5, 374.5], [279.9, 1199.9], [1289.3, 1052.6]])
    corners = result.backward.photo_from_film(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]))
    assert np.linalg.norm(corners - true, axis=1).max() < 2.0


def test_every_stage_reports(result):
    names = [stage.name for stage in result.stages]
    geometry = "network check edges plane spacing outline grid sheet spline reread margins flat verdict again"
    assert names == f"read survey {geometry} resample upright cover light".split()
    assert all(stage.reason and stage.seconds >= 0 for stage in result.stages)


def test_the_shortcut_takes_corners_however_often_it_is_called(photo, result):
    """From the second call on, the package of the same name answers."""
    corners = result.backward.nodes[[0, 0, -1, -1], [0, -1, -1, 0]]
    for _ in range(2):
        assert hybrid.rectify(photo, corners=corners).backward is not None


def test_efforts_differ_in_what_runs(photo, result):
    """Fast refines once and fits one sheet; default and thorough refine again, but only what is in doubt."""
    fast = hybrid.rectify(photo, effort="fast")
    ran = {stage.name: stage.ran for stage in fast.stages}
    assert fast.status.ok
    assert [ran[name] for name in ("outline", "grid", "sheet", "spline")] == [True, True, True, True]
    assert fast.limit_px == result.limit_px
    assert len(fast.slices()) == len(result.slices())
    thorough = hybrid.rectify(photo, effort="thorough")
    assert not {stage.name: stage.ran for stage in thorough.stages}["again"]
    assert np.array_equal(thorough.backward.nodes, result.backward.nodes)


@pytest.fixture(scope="module")
def doubted(rectifier, photo):
    """What is seen of the example, and its refinement, in doubt because the trust options ask for too much."""
    config, clock = rectifier.config, Clock()
    job = Job(Pyramid(photo), rectifier._readers, config)
    seen = see(job.readers.network, job.pyramid, config, clock)
    refined = WholeSheet(shape_of(job, seen.inversion.backward, job.phases_of(seen.maps), clock))
    never = replace(job, config=replace(config, trust=replace(config.trust, least_chance=1.0)))
    first = judged(never, seen, refined, False, clock)
    assert first.verdict.code is StatusCode.UNSURE
    return never, seen, first


def with_options(job: Job, **options) -> Job:
    return replace(job, config=replace(job.config, **options))


def judging(monkeypatch) -> list[Judged]:
    """Record whatever is judged from now on."""
    found: list[Judged] = []

    def noted(*given) -> Judged:
        found.append(judged(*given))
        return found[-1]

    monkeypatch.setattr("hybrid.pipeline.doubt.judged", noted)
    return found


def test_what_is_in_doubt_is_refined_from_where_it_ended_and_from_other_sides(doubted, monkeypatch):
    job, seen, first = doubted
    refined = judging(monkeypatch)
    for tries in (1, 3, 9):
        clock = Clock()
        found = beyond_doubt(with_options(job, tries=tries, enough=1.0), seen, first, True, clock)
        (report,) = clock.reports
        assert (report.name, report.ran) == ("again", True)
        assert len(refined) == min(tries, 6)  # one number of cells is likely: where it ended, plane, network, 3 sides
        assert floored(first.after(1, job.config).chance) in report.reason
        refined.clear()
        assert found.signs.doubted
        assert nearness(found.signs) >= nearness(first.signs)
        apart = np.linalg.norm(found.refinement.backward.nodes - first.refinement.backward.nodes, axis=-1)
        assert apart.mean() < 1.0  # of 1,400 px: each try ends at the same film


def test_the_first_refinement_that_leaves_no_doubt_ends_the_tries(doubted, rectifier, monkeypatch):
    job, seen, first = doubted
    once = with_options(job, tries=3, trust=rectifier.config.trust)
    refined = judging(monkeypatch)
    assert beyond_doubt(once, seen, first, True, Clock()).verdict.ok
    assert len(refined) == 1


def test_nor_is_a_film_refined_from_elsewhere_that_is_sure_enough(doubted, monkeypatch):
    job, seen, first = doubted
    refined = judging(monkeypatch)
    beyond_doubt(job, seen, first, True, Clock())
    assert len(refined) == 1
    assert first.after(1, job.config).chance > job.config.enough


def test_other_starts_assume_other_things(doubted, monkeypatch):
    """A plane; the network's map with other numbers of cells, or as if it said nothing of them; other orientations."""
    job, seen, first = doubted
    monkeypatch.setattr("hybrid.pipeline.starts.LEAST_COUNTED", 0.0)
    film, grid = first.refinement.backward, first.refinement.grid
    plane, *counted, plain, right, below, mirrored = other_starts(job, seen, film, grid)
    assert plane.phases is None
    assert plane.edges.through is not film
    assert 1 <= len(counted) <= 2
    for start in counted:
        assert start.counts not in (None, (grid.cols, grid.rows))
        assert start.phases is not None
        assert start.film is plain.film
        assert job.granting(start.counts).config.refine.cells.counts == start.counts
    assert plain.phases is None
    for start in (right, below, mirrored):
        assert start.counts is None
        assert 0.0 < mean_move(film, start.film) < 0.02


def test_looks_through_maps_that_are_off_lead_nearer_to_the_film(doubted):
    job, seen, first = doubted
    network, film = job.readers.network, first.refinement.backward
    wrong = turned_away(film, BENDS)
    left = []
    for one in wrong:
        (found,) = see_bent(network, seen, job.config, [one], (1, 1))
        left.append(mean_move(film, found.inversion.backward) / mean_move(film, one))
    assert max(left) < 1.0
    assert np.median(left) < 0.75
    surest, *others = see_bent(network, seen, job.config, [*wrong, film], (4, 3, 2))
    assert len(others) == 1
    assert mean_move(film, surest.inversion.backward) < 0.01


def test_looks_that_show_no_film_lead_nowhere(doubted, monkeypatch):
    job, seen, first = doubted
    monkeypatch.setattr("hybrid.pipeline.looks.fit_backward", lambda *_: NotInverted("nothing is seen"))
    assert see_bent(job.readers.network, seen, job.config, [first.refinement.backward], KEPT) == []


def test_an_end_of_a_bent_sheet_may_turn_away_further_than_it_seems(doubted, monkeypatch):
    """What the network then sees takes the place of the plane, which no bent sheet is near."""
    job, seen, first = doubted
    film, grid = first.refinement.backward, first.refinement.grid
    usual = list(other_starts(job, seen, film, grid))
    monkeypatch.setattr("hybrid.pipeline.starts.BENT", 0.0)
    bent = list(other_starts(job, seen, film, grid))
    assert len(bent) == len(usual) - 1 + KEPT[-1]
    for start in bent[: KEPT[-1]]:
        assert start.phases is not None
        assert mean_move(film, start.film) < 0.02
    assert mean_move(film, plane_of(film)) < BENT  # the example's film hardly bends


def test_a_film_whose_cells_were_counted_wrongly_is_put_right(doubted):
    job, seen, first = doubted
    grid = first.refinement.grid
    wrong = job.granting((grid.cols // 2, grid.rows))
    refined = shape_of(wrong, seen.inversion.backward, job.phases_of(seen.maps), Clock())
    mistaken = judged(job, seen, WholeSheet(refined), False, Clock())
    assert (refined.grid is None) or (refined.grid.cols, refined.grid.rows) != (grid.cols, grid.rows)
    found = beyond_doubt(with_options(job, enough=1.0), seen, mistaken, True, Clock()).refinement
    assert (found.grid.cols, found.grid.rows) == (grid.cols, grid.rows)
    assert mean_move(first.refinement.backward, found.backward) < 0.001


def test_a_film_is_not_lost_by_being_refined_again(doubted, monkeypatch):
    """A refinement that shows nothing of a film does not count, however probable its other signs make it."""
    job, seen, first = doubted
    signs = replace(first.signs, grid=False, corrected=False, support=0.0, seen_beside=1e-4)
    monkeypatch.setattr("hybrid.pipeline.doubt.judged", lambda *_: replace(first, signs=signs))
    found = beyond_doubt(job, seen, first, True, Clock())
    assert found.refinement is first.refinement
    assert found.verdict.code is StatusCode.UNSURE
    assert chance_right(replace(signs, doubted=1), job.config.trust) > found.chance


def test_a_film_is_refined_again_only_if_that_may_help(doubted):
    job, seen, first = doubted
    hopeless, sure = replace(first, chance=0.02), replace(first, verdict=Verdict(StatusCode.OK, "sure"))
    for before, tried, text in (
        (first, with_options(job, tries=0), "this effort"),
        (hopeless, job, "too little"),
        (sure, job, "no doubt"),
    ):
        clock = Clock()
        assert beyond_doubt(tried, seen, before, True, clock) is before
        assert not clock.reports[0].ran
        assert text in clock.reports[0].reason


def test_the_stages_of_the_refinement_that_counts_are_reported():
    """Their seconds are those of the first run; those of later runs belong to the stage that called for them."""
    clock = Clock()
    for name in ("outline", "grid", "verdict"):
        with clock.stage(name) as report:
            report.reason = "first"
    clock.counts([StageReport("grid", False, "second", 7.0), StageReport("verdict", True, "second", 7.0)])
    assert [(one.name, one.ran, one.reason) for one in clock.reports] == [
        ("outline", True, "first"),
        ("grid", False, "second"),
        ("verdict", True, "second"),
    ]
    assert all(one.seconds < 7.0 for one in clock.reports)


def test_the_efforts_are_those_of_the_type_and_no_other():
    assert RectifyConfig.of("default") == RectifyConfig()
    assert len({repr(RectifyConfig.of(effort)) for effort in get_args(Effort)}) == 3
    with pytest.raises(ConfigError, match="fast, default, thorough"):
        RectifyConfig.of("huge")


def test_a_flat_film_needs_no_network_from_several_sides_and_no_spline(rectifier):
    true = plane_map()
    found = rectifier(flat_photo())
    stages = {stage.name: stage for stage in found.stages}
    assert stages["plane"].reason.startswith("flat"), stages["plane"].reason
    assert "sides" not in stages
    assert not stages["spline"].ran
    assert end_point_error(found.backward, true.nodes).mean() < 1.0


def test_slices_are_the_grids_cells(result):
    assert result.grid is not None
    slices = result.slices()
    assert len(slices) == result.grid.rows * result.grid.cols
    assert min(min(s.shape) for s in slices) > 20


def test_reruns_are_bit_identical_and_leave_the_photo_alone(rectifier, photo, result):
    before = photo.copy()
    again = rectifier(photo)
    np.testing.assert_array_equal(again.film, result.film)
    np.testing.assert_array_equal(again.backward.nodes, result.backward.nodes)
    np.testing.assert_array_equal(photo, before)


def test_a_path_is_as_good_as_its_pixels(rectifier, result):
    np.testing.assert_array_equal(rectifier(EXAMPLE).film, result.film)


def test_a_grey_photo_will_do(rectifier, photo):
    assert rectifier(cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)).status.has_film


def test_a_synthetic_film_is_found_where_it_is(rectifier):
    """The mean end-point error is below 1 % of the photo's side on most photos generated from another seed."""
    errors = []
    for number in range(3, 8):
        sample = next(film_samples(991, number, SampleConfig(size=480, map_size=64, photos_per_film=1)))
        photo = cv2.imdecode(np.frombuffer(sample.photo, np.uint8), cv2.IMREAD_COLOR)[..., ::-1].copy()
        found = rectifier(photo)
        if not found.status.has_film:
            errors.append(np.inf)
            continue
        as_it_lies = found.backward.turned(found.orientation.inverse)
        errors.append(float(end_point_error(as_it_lies, film_as_seen(sample.backward).nodes).mean()))
    assert np.median(errors) < 4.8


def test_twice_the_pixels_give_the_same_film_points(rectifier, photo, result):
    """Photo points scale with the photo."""
    small = cv2.resize(photo, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    nodes = rectifier(small).backward.nodes * 2
    off = np.linalg.norm(nodes - result.backward.nodes, axis=-1).mean()
    assert off < 0.01 * max(photo.shape)


@pytest.mark.parametrize("way", [Orientation(1, False), Orientation(2, False), Orientation(3, False)])
def test_a_turned_photo_gives_the_same_film(rectifier, photo, result, way):
    """A turned photo is a new one to the network, so the films differ by pixels, but their correlation exceeds a half;
    in any other orientation it would be less than 0.3."""
    found = rectifier(np.ascontiguousarray(way.inverse.moved(photo)))
    assert found.orientation == way
    assert found.upright_probability > 0.98
    assert found.grid is not None
    assert (found.grid.rows, found.grid.cols) == (result.grid.rows, result.grid.cols)
    size = result.film.shape[::-1]
    alike = np.corrcoef(cv2.resize(found.film, size).ravel(), result.film.ravel())[0, 1]
    assert alike > 0.5


def test_the_map_turns_with_the_film(rectifier, photo, result):
    """The photo point of a film point turns with the photo: half a turn takes (x, y) to (width - x, height - y)."""
    found = rectifier(np.ascontiguousarray(Orientation(2, False).moved(photo)))
    uv = np.array([[0.2, 0.3], [0.7, 0.6]])
    back = np.array(photo.shape[1::-1]) - found.backward.photo_from_film(uv)
    assert np.linalg.norm(back - result.backward.photo_from_film(uv), axis=1).max() < 0.02 * max(photo.shape)


# ---------------------------------------------------------------- photos without a film


def wall(rng):
    tilt = np.linspace(120, 190, 400)[:, None] + np.linspace(0, 30, 500)
    return np.clip(tilt[..., None] + rng.normal(0, 3, (400, 500, 3)), 0, 255).astype(np.uint8)


def face(rng):
    image = np.full((500, 400, 3), 90, np.uint8)
    cv2.ellipse(image, (200, 250), (120, 170), 0, 0, 360, (215, 175, 150), -1)
    for x in (150, 250):
        cv2.ellipse(image, (x, 210), (22, 12), 0, 0, 360, (245, 245, 245), -1)
        cv2.circle(image, (x, 210), 9, (60, 40, 30), -1)
    cv2.ellipse(image, (200, 340), (50, 18), 0, 0, 180, (170, 70, 70), -1)
    return cv2.GaussianBlur(image, (0, 0), 2)


def noise(rng):
    return rng.integers(0, 256, (300, 400, 3), dtype=np.uint8)


@pytest.mark.parametrize("make", [wall, face, noise])
def test_a_photo_without_a_film_is_a_status_not_a_film(rectifier, make):
    found = rectifier(make(np.random.default_rng(0)))
    assert not found.status.has_film
    assert found.film is None
    assert found.slices() == []
    assert "film" in str(found.status)


@pytest.mark.parametrize(
    ("image", "code"),
    [
        (np.zeros((300, 300, 3), np.uint8), StatusCode.BLANK),
        (np.full((300, 300, 3), 255, np.uint8), StatusCode.BLANK),
        (np.zeros((20, 300, 3), np.uint8), StatusCode.TOO_SMALL),
    ],
)
def test_blank_and_small_photos_end_at_once(rectifier, image, code):
    found = rectifier(image)
    assert found.status.code is code
    assert [stage.name for stage in found.stages] == ["read", "survey"]
    assert found.photo_size == image.shape[:2]


@pytest.mark.parametrize(
    "bad", [np.full((64, 64, 3), np.nan), np.zeros((64, 64, 3), np.int64), np.zeros((4, 4, 4, 4), np.uint8), "no.jpg"]
)
def test_what_is_no_photo_is_refused(rectifier, bad):
    with pytest.raises(PhotoError):
        rectifier(bad)


def test_missing_weights_are_refused(tmp_path):
    with pytest.raises(DataError, match="weights"):
        Rectifier(RectifyConfig(weights=tmp_path / "none.safetensors"))


def test_the_shortcut_is_the_rectifier(photo, result):
    np.testing.assert_array_equal(hybrid.rectify(photo).film, result.film)


def test_what_rectifies_can_be_sent_to_other_processes(rectifier, photo, result):
    sent = pickle.loads(pickle.dumps(rectifier))
    np.testing.assert_array_equal(sent(photo).film, result.film)
    assert pickle.loads(pickle.dumps(hybrid.rectify)) is hybrid.rectify


class OwnRectifier(Rectifier):
    """A user's own subclass."""


def test_copies_load_no_network_and_what_is_sent_stays_what_it_is(rectifier, monkeypatch):
    own = OwnRectifier()
    assert type(pickle.loads(pickle.dumps(own))) is OwnRectifier
    monkeypatch.setattr("hybrid.pipeline.job.packaged_film_net", None)
    for it in (rectifier, own):
        assert copy.copy(it) is it
        assert copy.deepcopy([it])[0] is it


def test_threads_may_share_a_rectifier(rectifier, photo):
    """Six calls in three threads give bit for bit what one thread gives, and change no library's number of threads."""
    photos = [cv2.resize(photo, None, fx=x, fy=x, interpolation=cv2.INTER_AREA) for x in (0.5, 0.4)]
    alone = [rectifier(each) for each in photos]
    before = [(pool["filepath"], pool["num_threads"]) for pool in threadpool_info()], cv2.getNumThreads()
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(rectifier, 3 * photos))
    for k, found in enumerate(together):
        for name in ("film", "rectified", "confidence", "glare", "covered"):
            np.testing.assert_array_equal(getattr(found, name), getattr(alone[k % 2], name))
        np.testing.assert_array_equal(found.backward.nodes, alone[k % 2].backward.nodes)
        assert found.expected_error_px == alone[k % 2].expected_error_px
    assert before == ([(pool["filepath"], pool["num_threads"]) for pool in threadpool_info()], cv2.getNumThreads())


def test_which_arrays_of_a_result_are_the_callers(photo):
    """As docs/using.md says, also for a second result of the same rectifier."""
    result = hybrid.rectify(cv2.resize(photo, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    whose = (result.film, result.rectified, result.glare, result.covered, result.confidence)
    assert all(array.flags.writeable for array in (*whose, result.grid.vertices, result.grid.vertices_photo))
    assert not result.backward.nodes.flags.writeable
    assert not any(np.shares_memory(one, other) for one, other in combinations(whose, 2))
    result.slices()[0][:] = 0.25
    assert (result.film == 0.25).any()


FORKED = """
import multiprocessing
import sys
import hybrid

rectifier = hybrid.Rectifier(hybrid.RectifyConfig.of("fast"))
here = rectifier(sys.argv[1])
with multiprocessing.get_context("fork").Pool(1) as pool:
    (there,) = pool.map(rectifier, [sys.argv[1]])
assert there.status == here.status
assert (there.film == here.film).all()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_rectifies_what_its_parent_has(tmp_path):
    """It has none of the parent's threads, which have worked by then."""
    example = Path(hybrid.__file__).parent / "examples" / "film.jpg"
    environment = {**os.environ, "OMP_NUM_THREADS": "2"}
    subprocess.run([sys.executable, "-c", FORKED, str(example)], check=True, env=environment, timeout=300)


WRONG_TYPES = """
import numpy as np
import hybrid

result = hybrid.RectifyResult(hybrid.Status(hybrid.StatusCode.NO_FILM))
config = hybrid.RectifyConfig()
for call in (
    lambda: hybrid.RectifyConfig(tries="2"),
    lambda: hybrid.RectifyConfig(tries=1.5),
    lambda: hybrid.rectify(np.zeros((90, 90, 3), np.uint8), effort=config),
    lambda: hybrid.rectify(np.zeros((90, 90, 3), np.uint8), effort=["fast"]),
    lambda: hybrid.rectify(np.zeros((90, 90, 3), np.uint8), focal="26 mm"),
    lambda: hybrid.GridEdit.of("x.jpg"),
    lambda: hybrid.Rectifier().edited("x.jpg", result),
):
    try:
        call()
    except hybrid.ConfigError as error:
        print(error)
"""


def test_something_else_than_what_is_asked_for_is_refused_by_name():
    """Run in a process of its own: here, types are checked before the package can check them itself."""
    run = subprocess.run([sys.executable, "-c", WRONG_TYPES], capture_output=True, text=True, check=True, cwd=ROOT)
    assert run.stdout.splitlines() == [
        "RectifyConfig.tries: got '2'; allowed: a whole number. Choose another.",
        "RectifyConfig.tries: got 1.5; allowed: a whole number. Choose another.",
        "Effort: got a RectifyConfig; allowed: fast, default, thorough. For options of your own: "
        "Rectifier(config)(photo).",
        "Effort: got a list; allowed: fast, default, thorough. Name one of them.",
        "Focal length: got '26 mm'; allowed: a number from 0.1 to 20. Give it in units of the photo's longer side, as "
        "0.75, or leave it out.",
        "Grid to edit: got a str; allowed: a RectifyResult. Rectify the photo first: GridEdit.of(Rectifier()(photo)).",
        "Edited grid: got a RectifyResult; allowed: a GridEdit. Make one: GridEdit.of(result).",
    ]


def test_public_fields_have_public_types():
    assert set(get_args(hybrid.Effort)) == {"fast", "default", "thorough"}
    for record in (hybrid.RectifyResult, hybrid.SliceGrid, hybrid.StageReport, hybrid.Status, hybrid.GridEdit):
        told = " ".join(str(one.type) for one in fields(record))
        types = {name for name in re.findall(r"\b[A-Z]\w+", told) if hasattr(hybrid.records, name)}
        own = {name for name in types if getattr(hybrid.records, name).__module__.startswith("hybrid.")}
        assert own <= set(hybrid.__all__)


def test_of_two_films_side_by_side_one_is_found_by_a_nearer_look(rectifier, photo, result):
    both = rectifier(np.concatenate([photo, photo], axis=1))
    assert both.status.ok
    assert any("nearer look" in stage.reason for stage in both.stages if stage.name == "check")
    x = both.backward.photo_from_film(np.array([0.5, 0.5]))[0]
    alone = both.backward.cropped((photo.shape[1] * float(x > photo.shape[1]), 0.0), (1.0, 1.0))
    assert mean_move(alone, result.backward) < 0.002


def test_public_names_are_listed_before_they_are_used():
    assert set(hybrid.__all__) <= set(dir(hybrid))
    assert all(callable(getattr(hybrid, name)) for name in hybrid.__all__)


def test_a_film_that_the_first_looks_miss_is_found_from_a_wider_one(rectifier, photo):
    pyramid, clock = Pyramid(photo), Clock()
    missed = replace(
        see(rectifier._readers.network, pyramid, rectifier.config, clock), inversion=NotInverted("nothing like a film")
    )
    seen, verdict = checked(rectifier._readers.network, pyramid, missed, rectifier.config, clock)
    assert verdict.ok
    assert "wider look" in clock.reports[-1].reason
    assert isinstance(seen.inversion, Inversion)
    cut = Pyramid(photo[:, : photo.shape[1] // 2].copy())  # the visible part of a cut film is not taken for all
    seen, verdict = checked(
        rectifier._readers.network,
        cut,
        see(rectifier._readers.network, cut, rectifier.config, clock),
        rectifier.config,
        clock,
    )
    assert verdict.code is StatusCode.CUT_OFF


def test_the_room_named_rectify_answers_as_the_shortcut(photo, result):
    """hybrid.rectify is both the room and the public call, whichever was imported first."""
    import hybrid.rectify.splines.tps

    assert callable(hybrid.rectify)
    np.testing.assert_array_equal(hybrid.rectify(photo).film, result.film)
