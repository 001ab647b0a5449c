"""What covers the film is marked, does not affect the light, and gives way to a photo that shows the print."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from bent_sheets import bent_sheet, maps_of
from light_reader import without_light
from test_deilluminate import everywhere, light, print_of_cells, uneven

import hybrid
from data_gen.sample import SampleConfig, film_samples
from data_gen.scene.scene import SceneConfig
from hybrid.backward import BackwardMap, Orientation
from hybrid.coords import film_centres, rescale_points, rgb_from_bgr, sample_bilinear
from hybrid.effort import RectifyConfig
from hybrid.rectify.film.cover import CoverConfig, covered_parts

SIZE = (300, 240)
ALL = np.ones(SIZE, bool)


def told(inside: np.ndarray, bend: float = 0.6):
    """What a network sees of a bent film that is covered where ``inside`` says so for film coordinates."""
    film = BackwardMap.from_function(bent_sheet(bend))
    maps = maps_of(film)
    return replace(maps, covered=np.where(inside(maps.uv) & (maps.mask > 0.5), 0.97, 0.01)), film


def hand(uv: np.ndarray) -> np.ndarray:
    """A piece of the film at its right-hand edge."""
    return (uv[..., 0] > 0.7) & (abs(uv[..., 1] - 0.3) < 0.15)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def test_what_the_network_sees_before_the_film_is_marked_where_it_lies_on_the_film():
    maps, film = told(hand)
    assert overlap(covered_parts(maps, film, ALL), hand(film_centres(SIZE))) > 0.85


def test_it_is_marked_alike_however_the_film_is_turned():
    maps, film = told(hand)
    upright = covered_parts(maps, film, ALL)
    for index in range(8):
        way = Orientation.from_index(index)
        assert overlap(covered_parts(maps, film.turned(way), way.moved(ALL)), way.moved(upright)) > 0.97


def test_nothing_is_marked_beyond_the_photo():
    maps, film = told(hand)
    valid = film_centres(SIZE)[..., 0] < 0.8
    covered = covered_parts(maps, film, valid)
    assert covered.any()
    assert not covered[~valid].any()


def test_nothing_is_marked_where_nothing_is_seen_or_told():
    maps, film = told(lambda uv: np.zeros(uv.shape[:2], bool))
    assert not covered_parts(maps, film, ALL).any()
    assert not covered_parts(replace(maps, covered=None), film, ALL).any()
    hands, _ = told(hand)
    assert not covered_parts(hands, film, ALL, CoverConfig(least_chance=0.99)).any()


def test_what_covers_the_film_does_not_change_its_light():
    gain, veil = uneven()
    photo, truth = light(gain, veil), print_of_cells()
    u, v = film_centres(photo.shape[:2]).transpose(2, 0, 1)
    covered = (u > 0.55) & (v > 0.5)
    photo[covered] = (225, 180, 150)
    rest = ~covered & everywhere()

    def error(film: np.ndarray) -> float:
        slope, offset = np.polyfit(film[rest].astype(np.float64), truth[rest], 1)
        return float(np.sqrt(np.mean((slope * film[rest] + offset - truth[rest]) ** 2)))

    known = without_light(photo, everywhere(), covered=covered)
    assert error(known.film) < 0.04
    assert error(photo[..., 1] / 255) > 0.08  # the error before
    assert known.confidence[covered].max() == 0
    assert not known.glare[covered].any()
    assert known.film[covered].min() > 0, "what covers the film is shown, not blackened"


def test_hands_and_clips_on_simulated_photos_are_marked():
    """The packaged network marks them on photos unseen in training."""
    config = SampleConfig(size=540, map_size=270, photos_per_film=4, scene=SceneConfig(thing_share=1.0))
    rectifier = hybrid.Rectifier(RectifyConfig.of("fast"))
    both = hidden = marked = seen = 0
    for sample in (sample for film in range(3) for sample in film_samples(7001, film, config)):
        photo = rgb_from_bgr(cv2.imdecode(np.frombuffer(sample.photo, np.uint8), cv2.IMREAD_COLOR))
        result = rectifier(photo)
        if result.backward is None or result.covered is None:
            continue
        points = result.backward.photo_from_film(film_centres(result.covered.shape))
        points = rescale_points(points, (540, 540), (270, 270))
        film = sample_bilinear(sample.maps.mask.astype(np.float32), points) > 0.5
        both, hidden = both + (result.covered & ~film).sum(), hidden + (~film).sum()
        marked, seen = marked + (result.covered & film).sum(), seen + film.sum()
    assert hidden > 0.01 * seen
    assert both / hidden > 20 * marked / seen
    assert both > 0.2 * hidden
