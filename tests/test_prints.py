"""Prints: the grid that is stated is the grid that is drawn, in every style."""

import json
from pathlib import Path

import numpy as np
import pytest

from data_gen.ct.phantom import head_phantom
from data_gen.ct.volumes import CtVolume
from data_gen.prints.layout import FORMATS_MM, GRIDS, STYLES, coverage, random_layout
from data_gen.prints.prints import FilmPrint, PrintConfig, choose_slices, make_print
from data_gen.prints.slices import deal_slices
from data_gen.prints.typeset import FAMILIES, TEXT_STYLES, Font, stamp, stamp_text, text_sprite, wedge_greys
from hybrid.coords import centres_1d, pixel_from_film
from hybrid.errors import ConfigError

SMALL = PrintConfig(longer_px=420)
BARE = {"text_share": 0.0, "header_share": 0.0, "empty_share": 0.0, "scout_share": 0.0, "windows_share": 0.0}


@pytest.fixture(scope="module")
def head() -> CtVolume:
    return head_phantom(np.random.default_rng(0), size=96, slices=16)


@pytest.fixture(scope="module")
def empty() -> CtVolume:
    """Air only: nothing is drawn but the typesetting."""
    return CtVolume(np.full((12, 32, 32), -1000, np.int16), (5.0, 7.0, 7.0), "air")


def make(volume: CtVolume, seed: int, **options: object) -> FilmPrint:
    return make_print(volume, np.random.default_rng(seed), PrintConfig(**{"longer_px": 420, **options}))


@pytest.mark.parametrize("seed", range(15))
def test_every_print_is_valid(head: CtVolume, seed: int):
    film = make_print(head, np.random.default_rng(seed), SMALL)
    height, width = film.image.shape
    assert film.image.dtype == np.float32
    assert 0.0 <= film.image.min() < 0.25
    assert film.image.max() <= 1.0
    assert 0.75 * 420 < max(height, width) < 1.25 * 420
    assert np.isclose(film.size_mm[0] / film.size_mm[1], height / width)
    assert 200 <= max(film.size_mm) <= 440
    assert film.style in STYLES
    assert film.vertices.shape == (film.rows + 1, film.cols + 1, 2)
    assert film.vertices.min() >= 0.0
    assert film.vertices.max() <= 1.0
    steps = np.diff(film.vertices[0, :, 0])
    assert np.allclose(steps, steps[0])
    assert np.allclose(np.diff(film.vertices[:, 0, 1]), film.vertices[1, 0, 1] - film.vertices[0, 0, 1])
    assert json.loads(json.dumps(film.parameters)) == film.parameters


def test_a_seed_repeats_and_another_differs(head: CtVolume):
    one, same, other = (make_print(head, np.random.default_rng(seed), SMALL) for seed in (5, 5, 6))
    assert np.array_equal(one.image, same.image)
    assert one.parameters == same.parameters
    assert one.image.shape != other.image.shape or not np.array_equal(one.image, other.image)


@pytest.mark.parametrize("seed", range(8))
def test_rules_lie_on_the_vertices_to_a_tenth_of_a_pixel(empty: CtVolume, seed: int):
    film = make(empty, seed, style_weights=(0.0, 1.0, 0.0), **BARE)
    if film.parameters["boxes"]:
        pytest.skip("boxes around the cells leave the lines between them free")
    height, width = film.image.shape
    lines = pixel_from_film(film.vertices, (height, width))[0, 1:-1, 0]
    middle = int(pixel_from_film(film.vertices, (height, width))[0, 0, 1]) + 8  # inside the first row of cells
    profile = film.image[middle] - np.median(film.image[middle])
    for x in lines:
        near = np.arange(int(x) - 6, int(x) + 6)
        centroid = (profile[near] * centres_1d(len(profile))[near]).sum() / profile[near].sum()
        assert abs(centroid - x) < 0.1


@pytest.mark.parametrize("seed", range(8))
def test_gutters_are_even_about_the_vertices(empty: CtVolume, seed: int):
    film = make(empty, seed, style_weights=(0.0, 0.0, 1.0), **BARE)
    gap = film.parameters["gap_px"]
    assert gap >= 2
    assert gap % 2 == 0
    x = pixel_from_film(film.vertices, film.image.shape)[0, 1, 0]
    assert np.isclose(x, round(x))
    x = round(x)
    row = film.image[film.image.shape[0] // 2]
    assert np.allclose(row[x - gap // 2 : x], row[x : x + gap // 2][::-1])


def test_cells_hold_their_slices_and_nothing_else_moves_between_them(empty: CtVolume):
    """A bright block in the volume's middle appears once in every cell, at the same place in each."""
    hu = empty.hu.copy()
    hu[:, 12:20, 12:20] = 1000
    volume = CtVolume(hu, empty.spacing_mm, "block")
    film = make(volume, 3, style_weights=(1.0, 0.0, 0.0), margin_share=0.0, **BARE)
    height, width = film.image.shape
    cells = film.image.reshape(film.rows, height // film.rows, film.cols, width // film.cols).swapaxes(1, 2)
    assert np.ptp(cells, axis=(0, 1)).max() < 1e-6
    assert (cells[0, 0] > 0.5).any()


def test_texts_repeat_from_cell_to_cell(empty: CtVolume):
    options = {**BARE, "longer_px": 900, "text_share": 1.0, "style_weights": (1.0, 0.0, 0.0), "margin_share": 0.0}
    film = make(empty, 1, **options)
    bare = make(empty, 1, **{**options, "text_share": 0.0})
    ink = film.image != bare.image
    height, width = ink.shape
    cells = ink.reshape(film.rows, height // film.rows, film.cols, width // film.cols).any(axis=(1, 3))
    assert cells.all()
    assert 0.0 < ink.mean() < 0.2


def test_empty_cells_stand_at_the_end(head: CtVolume):
    film = make(
        head, 2, empty_share=1.0, text_share=0.0, header_share=0.0, style_weights=(1.0, 0.0, 0.0), margin_share=0.0
    )
    assert len(film.parameters["slices"]) < film.rows * film.cols
    x, y = (int(t) for t in pixel_from_film(film.vertices, film.image.shape)[-2, -2])
    assert np.ptp(film.image[y + 1 :, x + 1 :]) == 0.0


def test_all_grids_and_styles_come_up():
    layouts = [random_layout(np.random.default_rng(s), PrintConfig(style_weights=(1.0, 1.0, 1.0))) for s in range(1500)]
    assert {(x.rows, x.cols) for x in layouts} == {grid for grid, _ in GRIDS}
    assert {x.style for x in layouts} == set(STYLES)
    aspects = np.array([x.pitch_px[0] / x.pitch_px[1] for x in layouts])
    assert 0.4 < np.mean(np.abs(aspects - 1) < 0.01) < 0.8  # square cells are typical
    assert aspects.min() > 0.5
    assert aspects.max() < 2.0
    assert 0.4 < np.mean([not any(x.margins_px) for x in layouts]) < 0.75


@pytest.mark.parametrize("seed", range(6))
def test_clear_margins_are_bright_all_around_and_dark_ones_are_not(empty: CtVolume, seed: int):
    plain = {**BARE, "style_weights": (1.0, 0.0, 0.0)}
    for clear_share in (0.0, 1.0):
        film = make(empty, seed, margin_share=1.0, clear_share=clear_share, frame_share=0.0, **plain)
        top, right, bottom, left = film.parameters["margins_px"]
        image = film.image
        margins = (image[:top], image[image.shape[0] - bottom :], image[:, :left], image[:, image.shape[1] - right :])
        for margin in (m for m in margins if m.size):
            assert (margin >= 0.6).all() if clear_share else (margin < 0.3).all()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("clear_share", [0.0, 1.0])
def test_a_frame_runs_through_the_margins_around_the_grid(empty: CtVolume, seed: int, clear_share: float):
    options = {**BARE, "longer_px": 900, "margin_share": 1.0, "style_weights": (1.0, 0.0, 0.0)}
    films = [make(empty, seed, clear_share=clear_share, frame_share=share, **options) for share in (0.0, 1.0)]
    changed = films[0].image != films[1].image
    assert films[1].parameters["frame_px"] >= 1
    rows, cols = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    assert changed[rows[0], cols[0] : cols[-1] + 1].all()
    assert changed[rows[-1], cols[0] : cols[-1] + 1].all()
    assert changed[rows[0] : rows[-1] + 1, [cols[0], cols[-1]]].all()
    thick = films[1].parameters["frame_px"]
    assert not changed[rows[0] + thick : rows[-1] + 1 - thick, cols[0] + thick : cols[-1] + 1 - thick].any()
    top, right, bottom, left = films[1].parameters["margins_px"]
    height, width = changed.shape
    assert rows[0] <= top
    assert cols[0] <= left
    assert rows[-1] >= height - bottom - 1
    assert cols[-1] >= width - right - 1


@pytest.mark.parametrize("footer", [False, True])
def test_headers_stand_above_the_cells_or_below_them_bright_as_labels_or_dark(empty: CtVolume, footer: bool):
    greys = {}
    for label in (False, True):
        options = {**BARE, "header_share": 1.0, "footer_share": float(footer), "label_share": float(label)}
        film = make(empty, 3, longer_px=800, margin_share=0.0, placing_weights=(1.0, 0.0, 0.0), **options)
        tall = film.parameters["header_px"]
        strip = film.image[-tall:] if footer else film.image[:tall]
        assert len(film.parameters["header"].strip()) > 1
        assert np.isclose(film.vertices[-1, 0, 1], 1.0, atol=1 / 800) != footer
        assert np.isclose(film.vertices[0, 0, 1], 0.0, atol=1 / 800) == footer
        greys[label] = float(np.median(strip))
        writing = strip[np.abs(strip - greys[label]) > 0.2]
        assert len(writing) > 20
        assert np.all((writing < greys[label]) == label)
    assert greys[False] < 0.45
    assert greys[True] >= 0.5


def test_bright_gutters_are_as_bright_as_bare_film(empty: CtVolume):
    film = make(empty, 2, style_weights=(0.0, 0.0, 1.0), bright_gap_share=1.0, **BARE)
    x, y = (round(t) for t in pixel_from_film(film.vertices, film.image.shape)[0, 1])
    assert (film.image[y + 8, x - 1 : x + 1] >= 0.6).all()


def test_slices_follow_the_papers_rule():
    for seed in range(200):
        positions = choose_slices(np.random.default_rng(seed), 100, 20)
        assert len(positions) == 20
        assert positions.min() >= 0.1 * 99 - 0.5
        assert positions.max() <= 0.9 * 99 + 0.5
    few = choose_slices(np.random.default_rng(0), 3, 20)  # fewer slices than cells: interpolated between neighbours
    assert few.min() >= 0
    assert few.max() <= 2


@pytest.mark.parametrize("shape", [(1, 40, 40), (3, 8, 8), (5, 40, 24)])
def test_odd_volumes_still_print(shape: tuple[int, int, int]):
    for seed in range(6):
        film = make(CtVolume(np.full(shape, 40, np.int16), (1.0, 4.0, 4.0), "odd"), seed)
        assert np.isfinite(film.image).all()


def test_coverage_adds_up_to_the_thickness():
    for centre, thickness in [(10.0, 1.0), (10.0, 3.0), (10.5, 2.2), (7.5, 1.0)]:
        first, share = coverage(centre, thickness, 20)
        assert np.isclose(share.sum(), thickness)
        pixels = first + centres_1d(len(share))
        assert np.isclose((share * pixels).sum() / share.sum(), centre)
    assert np.isclose(coverage(0.0, 3.0, 20)[1].sum(), 1.5)  # half of it hangs over the edge


@pytest.mark.parametrize("family", FAMILIES)
def test_fonts_have_ink_of_about_the_height_asked_for(family: str):
    for height in (7, 16):
        sprite = text_sprite("H8 -12.5", Font(family, height))
        assert sprite.max() > 120
        assert 0.5 * height <= sprite.shape[0] <= 2.1 * height


def test_stamps_are_cut_at_the_rim():
    image = np.zeros((20, 20), np.float32)
    sprite = np.full((8, 8), 255, np.uint8)
    for x, y in [(-4, -4), (16, 16), (-50, 3), (3, 90)]:
        stamp(image, sprite, x, y, 1.0)
    assert image.sum() == 2 * 16


@pytest.mark.parametrize("options", [{"longer_px": 3}, {"longer_spread": 1.0}, {"style_weights": (0.0, 0.0, 0.0)}])
def test_wrong_options_are_refused(options: dict):
    with pytest.raises(ConfigError, match="PrintConfig"):
        PrintConfig(**options)


# ---------------------------------------------------------------- film formats, windows, scouts, marks


def test_sheets_have_the_sides_of_their_format():
    seen = set()
    for seed in range(120):
        layout = random_layout(np.random.default_rng(seed), PrintConfig(placing_weights=(0.0, 1.0, 1.0)))
        longer, shorter = FORMATS_MM[layout.film][0]
        assert np.isclose(max(layout.size_mm), longer)
        assert np.isclose(min(layout.size_mm), shorter, rtol=0.01)  # cells and margins are whole pixels
        seen.add((layout.film, layout.size_mm[0] > layout.size_mm[1]))
    assert {film for film, _ in seen} == set(FORMATS_MM)
    assert {portrait for _, portrait in seen} == {True, False}


def test_centred_grids_have_square_cells_and_even_margins():
    for seed in range(30):
        config = PrintConfig(placing_weights=(0.0, 0.0, 1.0), margin_share=0.0, header_share=0.0)
        layout = random_layout(np.random.default_rng(seed), config)
        top, right, bottom, left = layout.margins_px
        assert layout.pitch_px[0] == layout.pitch_px[1]
        assert top == bottom
        assert left == right


@pytest.mark.parametrize("deal", ["halves", "pairs"])
def test_two_windows_show_the_same_slices(deal: str):
    got = deal_slices(np.random.default_rng(1), 60, 12, deal)
    first, second = (got.positions[np.array(got.windows) == i] for i in (0, 1))
    assert np.array_equal(first, second)
    odd = deal_slices(np.random.default_rng(1), 60, 11, deal)
    assert len(odd.positions) == len(odd.windows) == 11


def test_a_scout_takes_the_first_cell_and_marks_the_slices(head: CtVolume):
    options = {**BARE, "scout_share": 1.0, "style_weights": (1.0, 0.0, 0.0), "margin_share": 0.0}
    film = make(head, 4, **options)
    height, width = film.image.shape
    first = film.image[: height // film.rows, : width // film.cols]
    assert len(film.parameters["slices"]) == film.rows * film.cols - 1
    line = 0.5 * (film.parameters["base"] + film.parameters["white"])
    rows = np.isclose(first, line).sum(axis=1)
    assert (rows > 0.3 * first.shape[1]).sum() >= min(len(film.parameters["slices"]), 5)


def test_greys_stay_between_base_and_white(head: CtVolume):
    """Also where cubic interpolation overshoots."""
    for seed in range(8):
        film = make(head, seed, margin_share=0.0, style_weights=(1.0, 0.0, 0.0), **BARE)
        assert film.image.min() >= np.float32(film.parameters["base"]) - 1e-6
        assert film.image.max() <= np.float32(film.parameters["white"]) + 1e-6


@pytest.mark.parametrize("style", TEXT_STYLES)
def test_text_is_seen_on_black_and_on_white(style: str):
    sprite = text_sprite("WL 40", Font("sans", 14))
    for ground in (0.0, 1.0):
        image = np.full((60, 120), ground, np.float32)
        stamp_text(image, sprite, (20, 20), 0.9, style)
        inked = image[20 : 20 + sprite.shape[0], 20 : 20 + sprite.shape[1]]
        if (style, ground) != ("plain", 1.0):  # white on white: lost, as on real films
            assert np.ptp(inked) > 0.5


@pytest.mark.parametrize("steps", [0, 8])
def test_wedges_fall_from_white_to_black_in_equal_steps(steps: int):
    greys = wedge_greys(80, 5, steps, 0.9)
    assert greys[0, 0] == np.float32(0.9)
    assert greys[-1, 0] == 0.0
    assert np.all(np.diff(greys[:, 0]) <= 0)
    assert len(np.unique(greys.round(6))) == (steps or 80)


MARKERS = {"DA": "19110919", "TM": "191109", "DT": "19110919191109", "AS": "091Y", "UI": "1.9.1191.919", "CS": "ZQXJ"}
TEXT_KINDS = {"AE", "LO", "LT", "PN", "SH", "ST", "UC", "UR", "UT", *MARKERS}
NEEDED = {"Modality", "ImageType", "SOPClassUID", "SOPInstanceUID", "PhotometricInterpretation", "RescaleType",
          "SpecificCharacterSet", "SeriesInstanceUID", "PixelPresentation", "FrameType"}  # fmt: skip
"""Elements that the reader needs stay as they are."""


def test_nothing_of_the_patient_is_printed_or_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Every text-like element that may hold patient data carries a marker; no marker comes out anywhere."""
    pytest.importorskip("pydicom", reason="pydicom is not installed")
    from pydicom._dicom_dict import DicomDictionary
    from test_dicom import anatomy, write

    from data_gen.ct.dicom import read_all
    from data_gen.prints import labels, prints

    names = {}
    for tag, (kind, _, _, _, keyword) in DicomDictionary.items():
        if keyword and kind in TEXT_KINDS and keyword not in NEEDED and 0x0008 <= tag >> 16 < 0x7FE0:
            names[keyword] = MARKERS.get(kind, "ZQXJ")
    assert len(names) > 1000
    for z in range(6):
        write(tmp_path / f"{z}.dcm", anatomy(z) + 1024, 4.0 * z, SeriesInstanceUID=MARKERS["UI"], **names)
    reading = read_all(tmp_path)
    written: list[str] = []
    for module in (labels, prints):
        monkeypatch.setattr(module, "text_sprite", lambda text, font: written.append(text) or text_sprite(text, font))
    said = [str(reading.notes), *(refusal.reason for refusal in reading.refusals)]
    for seed in range(12):
        config = PrintConfig(longer_px=300, text_share=1.0, header_share=1.0)
        said.append(json.dumps(make_print(reading.volumes[0], np.random.default_rng(seed), config).parameters))
    assert len(written) > 500
    for marker in ("ZQXJ", *MARKERS.values()):
        assert not any(marker in text for text in (*said, *written))


def test_letters_of_the_sides_stand_on_the_sides_that_slices_have(head):
    """A film whose slices are mirrored or turned over has the patient's left and right, or front and back, swapped."""
    found = set()
    for seed in range(160):
        said = make_print(head, np.random.default_rng(seed), PrintConfig(longer_px=128)).parameters
        letters = said["labels"].get("letters", [""] * 4)
        top, right, bottom, left = letters
        if left == "R" or right == "R":
            assert (left == "R") != said["mirrored"]
            assert (right == "L") <= (not said["mirrored"])
            found.add(("mirrored", said["mirrored"]))
        if "A" in letters:
            assert (top, bottom) == (("P", "A") if said["upside_down"] else ("A", "P"))
            found.add(("upside down", said["upside_down"]))
    assert len(found) >= 3
