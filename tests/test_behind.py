"""What is put behind films in training: only where nothing lies over them, up to their edge, in linear light."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, linear_from_srgb
from hybrid.learn.datasets import behind
from hybrid.learn.datasets.samples import Place, open_places
from hybrid.round_corners import RoundCorners

SIZE = (240, 220)
FILM = BackwardMap(film_nodes((9, 9)) * np.array([120.0, 140.0]) + np.array([50.0, 50.0]))
MILKY = {"clear": 0.1, "transmission": 0.5, "diffuse": 0.3}
CLEAR = {"clear": 0.6, "transmission": 0.05, "diffuse": 0.05}
SHARP = {"defocus_px": 0.0, "motion_px": 0.0}


@pytest.fixture
def place(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> Place:
    monkeypatch.setattr(behind, "SHARE", 1.0)
    return open_places([dataset])[0]


def told(monkeypatch: pytest.MonkeyPatch, place: Place, **changes: object) -> None:
    """Replaces the record of a sample."""
    record = {"material": MILKY, "lens": SHARP, "things": []} | changes
    monkeypatch.setattr(type(place[0]), "record", lambda self, index: record)


def drawn(place: Place, photo: np.ndarray, seeds: range) -> list[np.ndarray]:
    return [behind.behind_some(place, photo, FILM, np.random.default_rng(seed)) for seed in seeds]


def grey(level: int) -> np.ndarray:
    return np.full((*SIZE, 3), level, np.uint8)


@pytest.mark.parametrize(
    "changes",
    [{"things": [{"thing": "hand"}]}, {"lens": {"defocus_px": 0.0, "motion_px": 12.0}}],
    ids=["a hand over the film", "moved"],
)
def test_photos_in_which_nothing_can_lie_behind_alone_stay_as_they_were(
    place: Place, monkeypatch: pytest.MonkeyPatch, changes: dict[str, object]
) -> None:
    photo = grey(180)
    told(monkeypatch, place)
    assert all(put is not photo for put in drawn(place, photo, range(10)))
    told(monkeypatch, place, **changes)
    assert all(put is photo for put in drawn(place, photo, range(10)))


def test_samples_that_tell_nothing_of_their_scene_get_something_too(place: Place) -> None:
    photo = grey(180)
    assert all(put is not photo for put in drawn(place, photo, range(10)))


def test_behind_a_clear_film_nothing_but_its_shadow_is_put(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    for name in ("with_shadow", "with_sheet", "with_films", "with_pattern"):
        monkeypatch.setattr(behind, name, lambda photo, *_, name=name: asked.append(name) or photo)
    kinds = {}
    for material in (CLEAR, MILKY):
        told(monkeypatch, place, material=material)
        drawn(place, grey(180), range(60))
        kinds[material["clear"]] = set(asked)
        asked.clear()
    assert kinds == {0.6: {"with_shadow"}, 0.1: {"with_shadow", "with_sheet", "with_films", "with_pattern"}}


def test_the_wedges_of_round_corners_are_ground(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """They receive what is put behind the film, unlike any other part of the film."""
    corners, photo = RoundCorners(20 / 120, 20 / 140), grey(180)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    uv = np.stack([(x - 50) / 120, (y - 50) / 140], axis=-1)
    inner, deep = ((np.abs(uv - 1 / 2) < 1 / 2 - px / np.array([120, 140])).all(axis=-1) for px in (3, 6))
    cut = cv2.erode(corners.cut(uv).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) & inner
    left = deep & ~RoundCorners(34 / 120, 34 / 140).cut(uv)
    assert cut.sum() > 20
    monkeypatch.setattr(behind, "KINDS", {"sheet": 1.0})
    for radii, same in ((None, True), ((corners.u, corners.v), False)):
        told(monkeypatch, place, round_corners=radii)
        changed = np.max([np.abs(put.astype(int) - 180).max(axis=2) for put in drawn(place, photo, range(12))], axis=0)
        assert (changed[cut] == 0).all() == same
        assert same or changed[cut].min() > 4
        assert not changed[left].any()


@pytest.mark.parametrize("defocus_px", [0.0, 4.0, 8.0])
def test_of_the_old_ground_little_is_left_around_a_blurred_film(
    place: Place, monkeypatch: pytest.MonkeyPatch, defocus_px: float
) -> None:
    """A blurred black film on white ground gets a black sheet instead: little white is left along its edge."""
    told(monkeypatch, place, lens={"defocus_px": defocus_px, "motion_px": 0.0})
    monkeypatch.setattr(behind, "KINDS", {"sheet": 1.0})
    monkeypatch.setattr(behind, "with_sheet", lambda photo, nodes, free, rng: behind.mixed(photo, 0 * photo, free))
    sigma = float(np.hypot(0.5, defocus_px * max(SIZE) / 1000))
    photo = cv2.GaussianBlur(cv2.merge([255 - behind.filled(FILM.outline(), SIZE)] * 3), (0, 0), sigma)
    (put,) = drawn(place, photo, range(1))
    assert put.max() < 0.16 * 255


def test_light_is_taken_in_linear_light() -> None:
    """A dark and a bright ground lose the same share of light, and nothing is lost where the share is 0."""
    share = np.zeros(SIZE, np.uint8)
    share[100:] = 255
    for seed in range(10):
        left = []
        for level in (90, 250):
            put = behind._darkened(grey(level), share, np.random.default_rng(seed))
            np.testing.assert_array_equal(put[:100], level)
            light, before = linear_from_srgb(np.array([put[-1, 0], grey(level)[-1, 0]]) / 255)
            left.append(light / before)
        np.testing.assert_allclose(left[0], left[1], atol=0.02)
        assert np.min(left) > 0.05 - 0.02
        assert 0.1 - 0.02 < left[1][1] < 0.85 + 0.02  # of green, whose share is not varied
