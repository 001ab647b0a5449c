"""Beside edges in EdgeNet's training: shadows on the ground, to which the map reaches, bands and margins in prints."""

from pathlib import Path

import numpy as np
import pytest
from synthetic_film import FilmDrawing, make_photo

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.learn.datasets import near_edges as edges
from hybrid.learn.datasets.behind import ground_of, size_in_photo, with_shade
from hybrid.learn.datasets.edges import EdgeAugment, EdgePlace, edge_view, sides_far, true_rows
from hybrid.learn.datasets.near_edges import margins_some, near_edges, near_shadow, reaching, with_band, with_margins
from hybrid.learn.datasets.samples import Place, open_places
from hybrid.learn.networks.edgenet import strip_reader
from hybrid.learn.networks.inference import ready
from hybrid.learn.networks.weights import packaged_edge_net
from hybrid.pyramid import Pyramid
from hybrid.rectify.edges.paths import EdgeConfig, look_across, read_edges
from hybrid.strips import StripConfig

SIZE, GROUND = (480, 440), 180
FILM = BackwardMap(film_nodes((9, 9)) * np.array([240.0, 280.0]) + np.array([100.0, 100.0]))
STRIP = StripConfig()


@pytest.fixture
def place(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> Place:
    """A sample that gets a shadow; as sharp as drawing makes it, and maps reach all the way."""
    monkeypatch.setattr(edges, "SHADOW_SHARE", 1.0)
    monkeypatch.setattr(edges, "BAND_SHARE", 0.0)
    monkeypatch.setattr(edges, "MARGIN_SHARE", 0.0)
    monkeypatch.setattr(edges, "PART_SHARE", 0.0)
    monkeypatch.setattr(edges, "RIM", (0.0001, 0.0002))
    return open_places([dataset])[0]


def plain_photo(film: int = GROUND) -> np.ndarray:
    """Grey ground, and a film of one grey on it."""
    photo = np.full((*SIZE, 3), GROUND, np.uint8)
    photo[100:380, 100:340] = film
    return photo


def printed_photo() -> np.ndarray:
    """The same with something dark and something bright on the film."""
    photo = plain_photo(90)
    photo[200:220, 150:300], photo[240:300, 150:300] = 200, 20
    return photo


def shadowed(seed: int) -> tuple[np.ndarray, BackwardMap]:
    """The film's photo with a shadow on its ground, and the map that takes it for part of the sheet."""
    outline = FILM.outline()
    return near_shadow(plain_photo(), FILM, outline, ground_of(outline, SIZE), np.random.default_rng(seed))


def farthest(seed: int) -> float:
    """How far, in pixels, a map's nodes lie from the film's."""
    return float(np.abs(shadowed(seed)[1].nodes - FILM.photo_from_film(film_nodes((17, 17)))).max())


def test_the_shadow_lies_on_the_ground_and_the_map_ends_where_it_does(place: Place) -> None:
    met = 0
    for seed in range(40):
        photo, drawn = shadowed(seed)
        dark = photo[..., 1].astype(int) < GROUND - 12
        assert not dark[102:378, 102:338].any()
        lattice = drawn.lattice((33, 33))
        sides = [(lattice[0], [0, -1]), (lattice[-1], [0, 1]), (lattice[:, 0], [-1, 0]), (lattice[:, -1], [1, 0])]
        for line, outwards in sides:
            middle = line[12:21]
            beyond = (np.abs(middle - [220, 240]) - [120, 140]) @ np.abs(outwards)
            if beyond.min() < 5:  # moved by a line, or not at all
                continue
            met += 1
            just_inside, just_outside = ((middle + step * np.array(outwards)).astype(int) for step in (-3, 3))
            assert dark[just_inside[:, 1], just_inside[:, 0]].all()
            assert not dark[just_outside[:, 1], just_outside[:, 0]].any()
    assert met > 15


def test_a_part_of_the_maps_goes_part_of_the_way(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = [farthest(seed) for seed in range(9)]
    monkeypatch.setattr(edges, "PART_SHARE", 1.0)
    part = [farthest(seed) for seed in range(9)]
    assert all(a < b or b == 0 for a, b in zip(part, whole, strict=True))
    assert max(part) > 1


def test_bands_are_dark_and_lie_along_one_side_of_the_film_alone() -> None:
    film, free = printed_photo(), ground_of(FILM.outline(), SIZE)
    ground = plain_photo(0)[..., 0] > 0
    sides, lines = set(), []
    for seed in range(24):
        banded = with_band(film, FILM, free, np.random.default_rng(seed)).astype(int)
        changed = np.abs(banded - film).max(axis=2) > 3
        assert not (changed & ground).any()
        y, x = np.nonzero(changed)
        reach = {"top": y.max() - 100, "bottom": 380 - y.min(), "left": x.max() - 100, "right": 340 - x.min()}
        side = min(reach, key=lambda name: reach[name])
        sides.add(side)
        assert reach[side] < (edges.DEEP[1] + edges.THICK[1]) * 280 + 2
        rims = {"top": banded[102, 120:320], "bottom": banded[377, 120:320], "left": banded[120:360, 102]}
        if reach[side] > 12:  # the band is wider than where the line may be
            assert rims.get(side, banded[120:360, 337]).max() < 70
        lines.append(banded[changed].max())
    assert len(sides) == 4
    assert np.median(lines) > 100


def test_margins_are_blank_and_lie_along_sides_of_the_film_alone() -> None:
    """As dark as what is darkest nearby, or a little brighter; what is printed further in stays as it is."""
    film, free = printed_photo(), ground_of(FILM.outline(), SIZE)
    film[102:378, 140] = film[102:378, 290] = 250  # rules that reach through the margins
    rules, counts = film.max(axis=2) > 200, []
    for seed in range(24):
        changed = np.abs(with_margins(film, FILM, free, np.random.default_rng(seed)).astype(int) - film).max(axis=2)
        assert not changed[:98].any()
        assert not changed[382:].any()
        assert not changed[:, :98].any()
        assert not changed[:, 342:].any()
        assert not changed[100 + 32 : 380 - 32, 100 + 28 : 340 - 28].any()
        blank = [changed[102:104][rules[102:104]].min() > 80, changed[376:378][rules[376:378]].min() > 80]
        counts.append(sum(blank))
    assert 0 < np.mean(counts) < 2


@pytest.mark.parametrize(
    "changes",
    [{"things": [{"thing": "hand"}]}, {"lens": {"defocus_px": 0.0, "motion_px": 12.0}}],
    ids=["hand", "moved"],
)
def test_photos_that_nothing_is_put_behind_get_none(
    place: Place, monkeypatch: pytest.MonkeyPatch, changes: dict[str, object]
) -> None:
    photo = plain_photo()
    put, drawn = near_edges(place, photo, FILM, np.random.default_rng(1))
    assert put is not photo
    assert drawn is not None
    monkeypatch.setattr(type(place[0]), "record", lambda self, index: changes)
    same, drawn = near_edges(place, photo, FILM, np.random.default_rng(1))
    assert same is photo
    monkeypatch.setattr(edges, "MARGIN_SHARE", 1.0)
    assert margins_some(place, photo, FILM, np.random.default_rng(1)) is photo
    assert drawn is None


def test_bands_alone_move_no_map(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(edges, "SHADOW_SHARE", 0.0)
    monkeypatch.setattr(edges, "BAND_SHARE", 1.0)
    photo = printed_photo()
    put, drawn = near_edges(place, photo, FILM, np.random.default_rng(1))
    assert drawn is None
    assert (put != photo).any()


def test_views_through_such_maps_show_the_edge_further_in(place: Place) -> None:
    """By up to as much as the map was moved out, on the sides that it was; on none of them further out."""
    exact = EdgeAugment(drawn_share=1.0, found_error=(1e-6, 2e-6), far_share=0.0)
    views = [edge_view(EdgePlace(place, None), STRIP, np.random.default_rng(seed), exact) for seed in range(12)]
    depth = np.array([STRIP.depth_of(rows) for _, _, rows in views])  # NaN where no edge is shown
    assert np.nanmin(depth) > -0.004
    assert (np.nanmax(depth, axis=(1, 2)) > 0.004).mean() > 0.6
    assert np.nanmax(depth) < edges.REACHED[1] + 0.004


def test_maps_whose_sides_lie_far_off_show_the_edge_there_or_not_at_all() -> None:
    """One side or two, most of them outside of the film; the others stay, but for what was added to their ends."""
    film_everywhere, outwards, lost, augment = np.ones((48, 44), bool), [], 0, EdgeAugment()
    least, most = augment.far[0] * 0.8, augment.far[1] * 1.2
    for seed in range(60):
        far = sides_far(FILM, augment, np.random.default_rng(seed))
        at = (far.photo_from_film(np.array([[0.5, 0], [0.5, 1], [0, 0.5], [1, 0.5]])) - [100, 100]) / [240, 280]
        inside = np.array([at[0, 1], 1 - at[1, 1], at[2, 0], 1 - at[3, 0]])  # of the film's edges, in film units
        moved = np.abs(inside) > 1e-6
        assert moved.sum() in (1, 2)
        assert (np.abs(inside[moved]) >= least).all()
        assert (np.abs(inside[moved]) <= most).all()
        outwards += list(inside[moved] < 0)
        shown = np.isfinite(true_rows(FILM, far, SIZE, film_everywhere, STRIP)).any(axis=1)
        assert shown[~moved].all()
        assert shown[np.abs(inside) < 0.06].all()
        assert not shown[np.abs(inside) > 0.2].any()
        lost += int((~shown).sum())
    assert 0.55 < np.mean(outwards) < 0.85
    assert lost > 20


def test_the_packaged_network_tells_most_shadows_from_the_sheet_that_throws_them() -> None:
    """Through maps that take them for part of the sheet, as FilmNet's do, in four directions."""
    plain, film = make_photo(FilmDrawing(rules=False), np.random.default_rng(4), 170)
    outline = film.outline()
    free = ground_of(outline, plain.shape[:2])
    reader, config = strip_reader(ready(packaged_edge_net())), EdgeConfig()
    moved = []
    for turn in np.deg2rad([20, 110, 200, 290]):
        by = 0.03 * size_in_photo(outline) * np.array([np.cos(turn), np.sin(turn)])
        photo = Pyramid(with_shade(plain, outline + by, 1.0, free, np.random.default_rng(2)))
        drawn = reaching(film, film.photo_from_film(edges.CORNERS) + by)
        moved.append(read_edges(photo, drawn, reader, config).off)
        assert look_across(photo, film, reader, config).support.min() > 0.8  # through the true map, the true edges
    assert np.sum(np.array(moved) > 0.015) >= 3
