"""What a photo's file says about the lens, and how that helps where the photo leaves the film's side ratio open."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bent_sheets import flat_sheet_seen
from PIL import Image
from PIL.ExifTags import IFD, Base

from hybrid.backward import BackwardMap
from hybrid.camera import told_focal
from hybrid.cli.rectify_files import rectify_files
from hybrid.effort import RectifyConfig
from hybrid.errors import ConfigError
from hybrid.pipeline import Rectifier, rectify
from hybrid.pipeline.rectifier import _with_lens
from hybrid.records import RectifyResult, Status, StatusCode
from hybrid.rectify.film.size import FilmSizeConfig, known_by_plane, snap_aspect

SIZE = 400, 300
"""Width and height of the photos."""

LEANING, ASLANT = (0.5, 0.0, 0.0), (0.5, 0.5, 0.2)
"""Rotations of a sheet that only leans, and of one whose sides all converge."""


def photo_with(path: Path, orientation: int = 1, **tags: float) -> Path:
    """A photo whose EXIF has these tags."""
    picture = Image.new("RGB", SIZE)
    exif = picture.getexif()
    exif[Base.Orientation] = orientation
    exif.get_ifd(IFD.Exif).update({Base[name]: value for name, value in tags.items()})
    picture.save(path, exif=exif)
    return path


@pytest.mark.parametrize("suffix", ["jpg", "png", "webp"])
@pytest.mark.parametrize("orientation", [1, 6])
def test_a_lens_of_26_mm_is_three_quarters_of_the_longer_side(tmp_path: Path, suffix: str, orientation: int):
    path = photo_with(tmp_path / f"a.{suffix}", orientation, FocalLengthIn35mmFilm=26)
    assert told_focal(path) == pytest.approx(26 / 43.27 * 5 / 4, rel=1e-3)
    assert told_focal(str(path)) == told_focal(path)
    with Image.open(path) as opened:
        assert told_focal(opened) == told_focal(path)


def test_a_photo_that_was_cropped_tells_none(tmp_path: Path):
    tags = {"FocalLengthIn35mmFilm": 26, "ExifImageWidth": 4000, "ExifImageHeight": 3000}
    assert told_focal(photo_with(tmp_path / "a.jpg", **tags)) is not None
    assert told_focal(photo_with(tmp_path / "b.jpg", **{**tags, "ExifImageWidth": 5000})) is None
    turned = {**tags, "ExifImageWidth": 3000, "ExifImageHeight": 4000}
    assert told_focal(photo_with(tmp_path / "c.jpg", **turned)) is not None


def test_what_is_no_lens_of_a_phone_is_none(tmp_path: Path):
    for equivalent_mm in (0, 3, 2000):
        assert told_focal(photo_with(tmp_path / "a.jpg", FocalLengthIn35mmFilm=equivalent_mm)) is None
    assert told_focal(photo_with(tmp_path / "a.jpg")) is None
    assert told_focal(np.zeros((8, 8, 3), np.uint8)) is None
    (tmp_path / "b.jpg").write_bytes(b"no picture")
    assert told_focal(tmp_path / "b.jpg") is None


def test_the_lens_is_told_with_the_photo(tmp_path: Path):
    result = rectify(photo_with(tmp_path / "a.jpg", FocalLengthIn35mmFilm=26))
    assert result.stages[0].reason == "400 x 300 pixels, by a lens of 0.75 times its longer side"


def test_photos_that_are_rectified_from_files_are_so_with_their_lens(tmp_path: Path):
    seen = []

    def tool(photo: np.ndarray, *, focal: float | None) -> RectifyResult:
        seen.append(focal)
        return RectifyResult(Status(StatusCode.NO_FILM), ())

    photos = [photo_with(tmp_path / "a.jpg", FocalLengthIn35mmFilm=26), photo_with(tmp_path / "b.jpg")]
    rectify_files(photos, tmp_path / "out", lambda: tool, "jpg", print)
    assert seen == [told_focal(photos[0]), None]


def test_the_lens_of_an_array_may_be_given():
    photo = np.zeros((300, 400, 3), np.uint8)
    assert (
        Rectifier()(photo, focal=0.75).stages[0].reason == "400 x 300 pixels, by a lens of 0.75 times its longer side"
    )
    for wrong in (0.0, -1.0, 26.0, float("nan"), float("inf")):
        with pytest.raises(
            ConfigError, match=r"Focal length: got .*; allowed: a number from 0.1 to 20. Give it in units"
        ):
            rectify(photo, focal=wrong)


def test_a_lens_that_was_asked_for_counts_for_more():
    asked, usual = RectifyConfig(), RectifyConfig()
    asked = replace(asked, refine=replace(asked.refine, sheet=replace(asked.refine.sheet, focal=2.0)))
    assert _with_lens(asked, 0.75) is asked
    assert _with_lens(usual, 0.75).refine.sheet.focal == 0.75
    assert _with_lens(usual, None) is usual


def seen(turned: tuple[float, float, float], focal: float, aspect: float = 43 / 35) -> BackwardMap:
    return BackwardMap.from_function(flat_sheet_seen(aspect, focal, turned, (768, 1024)))


@pytest.mark.parametrize("focal", [0.4, 0.75, 1.5])
def test_the_ratio_of_a_sheet_that_leans_is_open_but_for_the_lens(focal: float):
    """Its upper and lower side are parallel in the photo, whatever the lens."""
    known = _with_lens(RectifyConfig(), focal).refine.sheet
    ratio, sigma = known_by_plane(seen(LEANING, focal), (768, 1024), known)
    assert ratio == pytest.approx(43 / 35, rel=0.01)
    assert sigma < 0.03
    _, left_open = known_by_plane(seen(LEANING, focal), (768, 1024))
    assert left_open > 0.05
    _, told = known_by_plane(seen(ASLANT, focal), (768, 1024))
    assert told < 0.01


def test_what_the_lens_leaves_open_formats_and_square_cells_tell():
    config = FilmSizeConfig()
    assert snap_aspect(1.30, None, config, exact=True, sigma=0.001) == 1.30
    assert snap_aspect(1.30, None, config, exact=True, sigma=0.02) == pytest.approx(1.25)
    assert snap_aspect(1.45, None, config, exact=True, sigma=0.5) == 1.45  # no format is that near


def test_the_ratio_is_nearly_right_without_a_told_lens():
    for focal in (0.7, 0.8):
        ratio, sigma = known_by_plane(seen(LEANING, focal), (768, 1024))
        snapped = snap_aspect(ratio, None, FilmSizeConfig(), exact=True, sigma=sigma)
        assert snapped == pytest.approx(43 / 35, rel=0.03)
