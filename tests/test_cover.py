"""What lies before the film is marked, tells nothing of the light, and gives way to a photo that shows the print."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from bent_sheets import bent_sheet, maps_of
from test_deilluminate import everywhere, light, print_of_cells, uneven

from hybrid.backward import BackwardMap, Orientation
from hybrid.coords import film_centres
from hybrid.rectify.cover import CoverConfig, covered_parts
from hybrid.rectify.deilluminate import deilluminate

SIZE = (300, 240)


def told(inside: np.ndarray, bend: float = 0.6):
    """What a network sees of a bent film before which something lies where ``inside`` says of film coordinates."""
    film = BackwardMap.from_function(bent_sheet(bend)[0])
    maps = maps_of(film)
    return replace(maps, covered=np.where(inside(maps.uv) & (maps.mask > 0.5), 0.97, 0.01)), film


def hand(uv: np.ndarray) -> np.ndarray:
    """A piece of the film at its right-hand edge."""
    return (uv[..., 0] > 0.7) & (abs(uv[..., 1] - 0.3) < 0.15)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def test_what_the_network_sees_before_the_film_is_marked_where_it_lies_on_the_film():
    maps, film = told(hand)
    assert overlap(covered_parts(maps, film, SIZE), hand(film_centres(SIZE))) > 0.85


def test_it_is_marked_alike_however_the_film_is_turned():
    maps, film = told(hand)
    upright = covered_parts(maps, film, SIZE)
    for index in range(8):
        way = Orientation.from_index(index)
        size = SIZE[::-1] if way.turns % 2 else SIZE
        assert overlap(covered_parts(maps, film.turned(way), size), way.moved(upright)) > 0.97


def test_nothing_is_marked_where_nothing_is_seen_or_told():
    maps, film = told(lambda uv: np.zeros(uv.shape[:2], bool))
    assert not covered_parts(maps, film, SIZE).any()
    assert not covered_parts(replace(maps, covered=None), film, SIZE).any()
    hands, _ = told(hand)
    assert not covered_parts(hands, film, SIZE, CoverConfig(least_chance=0.99)).any()


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

    known = deilluminate(photo, everywhere(), covered=covered)
    assert error(known.film) < 0.8 * error(deilluminate(photo, everywhere()).film)
    assert known.confidence[covered].max() == 0
    assert not known.glare[covered].any()
    assert known.film[covered].min() > 0, "what covers the film is shown, not blackened"
