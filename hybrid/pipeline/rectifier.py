"""Rectifies photos: runs all stages of the way from a photo to the flat film, each only where it is needed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.backward import BackwardMap
from hybrid.camera import FOCALS, TOLD_SIGMA, told_focal
from hybrid.effort import Effort, RectifyConfig
from hybrid.errors import ConfigError, FusionError, describe
from hybrid.grid_edit import GridEdit
from hybrid.image_io import PhotoSource, as_photo
from hybrid.pipeline.doubt import beyond_doubt, judged
from hybrid.pipeline.finish import finished, made_anew
from hybrid.pipeline.geometry import flat_itself, shape_of
from hybrid.pipeline.job import Job, Readers
from hybrid.pipeline.looks import checked, network_beside, see, see_at, see_from_sides
from hybrid.pipeline.whole_sheet import WholeSheet, whole_sheet
from hybrid.pyramid import Photo, Pyramid
from hybrid.records import RectifyResult, Status, StatusCode
from hybrid.rectify.coarse.corners import Corners, film_at
from hybrid.rectify.coarse.invert import Inversion, agreed
from hybrid.rectify.fusion.fuse import fuse
from hybrid.rectify.sheet.shape import SheetConfig
from hybrid.rectify.verdict.survey import Verdict, survey_photo, survey_print
from hybrid.rectify.verdict.trust import expected_error_px, largest_error_px
from hybrid.stages import Clock
from hybrid.threads import one_thread


class Rectifier:
    """Rectifies photos. The networks are loaded once, here, and once more in each process that it is sent to.

    Nothing in it changes: threads may share it, and a copy is the same object.

    Raises:
        ConfigError: ``config`` is not a RectifyConfig. DataError: ``config.weights`` is not a weights file.
    """

    def __init__(self, config: RectifyConfig | None = None) -> None:
        self.config = RectifyConfig() if config is None else config
        if not isinstance(self.config, RectifyConfig):
            do = 'For an effort: Rectifier(RectifyConfig.of("fast")).'
            raise ConfigError(describe(what="Rectifier", got=repr(config), allowed="a RectifyConfig or None", do=do))
        self._readers = Readers.packaged(self.config.weights)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.config,)

    def __copy__(self) -> Rectifier:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Rectifier:
        return self

    def __call__(
        self, source: PhotoSource, corners: Corners | None = None, focal: float | None = None
    ) -> RectifyResult:
        """The flat film of a photo.

        Args:
            source: a path, (H, W, 3) uint8 RGB, (H, W) uint8, or a Pillow image.
            corners: the sheet's corners, if a person knows them better than the network: four photo points (x, y), in
                any order, accurate to about a hundredth of the film. A film is then returned whatever the network sees.
            focal: the lens's focal length in units of the photo's longer side, where it is known. By default what the
                source tells (EXIF); an array tells nothing (``hybrid.camera.told_focal`` reads it from a file).

        Raises:
            PhotoError: the source cannot be read as a photo. A photo without a film is not an error but a status.
            ConfigError: these cannot be the corners of a sheet in the photo, or there is no such focal length.
        """
        if focal is not None and not (isinstance(focal, Real) and FOCALS[0] <= focal <= FOCALS[1]):
            do = "Give it in units of the photo's longer side, as 0.75, or leave it out."
            allowed = f"a number from {FOCALS[0]:g} to {FOCALS[1]:g}"
            raise ConfigError(describe(what="Focal length", got=repr(focal), allowed=allowed, do=do))
        clock = Clock()
        with one_thread():
            return self._rectified(*_photo_of(source, clock, focal), corners, clock)

    def fuse(self, sources: Iterable[PhotoSource], names: Sequence[str] | None = None) -> RectifyResult:
        """One film from several photos of it, between which the phone or the lamps moved, so that glare vanishes.

        names: the photos' names in messages; by default they are numbered.

        film, glare, covered and confidence combine all photos in which a film is found, at the size of the largest of
        their films; the others are left out (``result.left_out``). The rest belongs to the first of these photos whose
        map is sure, or to the first of them if no map is (``result.photo``). Its map is moved to where all photos with
        sure maps (or all photos, if no map is sure) place the print; status and expected error are theirs. If no photo
        shows a film, the first photo's result is returned.

        Args:
            sources: as for a single photo; two or more.

        Raises:
            PhotoError: a source cannot be read as a photo.
            FusionError: fewer than two photos, or photos of different films.
        """
        if isinstance(sources, (str, Path, np.ndarray)) or not isinstance(sources, Iterable):
            do = "Put them into a list."
            got = f"one {type(sources).__name__}"
            raise FusionError(describe(what="Photos to fuse", got=got, allowed="a sequence of them", do=do))
        sources = list(sources)
        if len(sources) < 2:
            do = "Name two or more photos of one film; a single one is rectified."
            raise FusionError(describe(what="Photos to fuse", got=len(sources), allowed="two or more", do=do))
        if names is not None and len(names) != len(sources):
            got, allowed = f"{len(names)} of {len(sources)} photos", "one of each"
            raise FusionError(describe(what="Names to fuse", got=got, allowed=allowed, do="Name all, or none."))
        clocks = [Clock() for _ in sources]
        with one_thread():
            read = [_photo_of(source, clock) for source, clock in zip(sources, clocks, strict=True)]
            results = [self._rectified(*one, None, clock) for one, clock in zip(read, clocks, strict=True)]
            photos = [photo for photo, _ in read]
            options = self.config.fuse, self.config.light, self.config.resample
            fused = fuse(photos, results, self._readers.levels, *options, names)
            return replace(fused, photos=len(photos))

    def edited(self, source: PhotoSource, edit: GridEdit) -> RectifyResult:
        """The film of a photo, made anew through the map and grid that a person edited, at the same size and way up.

        If nothing was changed, the original result is returned. Otherwise the evidence for the map is not known: the
        result is ``UNSURE``, without an expected error.

        Args:
            source: the photo that was rectified, as for a single photo; for a fused film, the photo ``result.photo``.
                The new film is then made from that photo alone, and its result is that of a single photo.
            edit: an edit of a result of this rectifier.

        Raises:
            PhotoError: the source cannot be read as a photo. ConfigError: it is a different photo (of another size), or
            the edit is not a GridEdit.
        """
        if not isinstance(edit, GridEdit):
            got, do = f"a {type(edit).__name__}", "Make one: GridEdit.of(result)."
            raise ConfigError(describe(what="Edited grid", got=got, allowed="a GridEdit", do=do))
        before = edit.result
        if edit.grid is before.grid and edit.backward is before.backward:
            return before
        clock = Clock()
        with one_thread():
            photo, _ = _photo_of(source, clock)
            before.of_photo(photo.shape)
            return made_anew(Job(Pyramid(photo), self._readers, self.config), edit, clock)

    def network_map(self, source: PhotoSource) -> BackwardMap | None:
        """The network's own map of a photo, before refinement: that of the film as it lies in the photo.

        None if it sees no film. For comparing networks, whose differences refinement would hide.

        Raises:
            PhotoError: the source cannot be read as a photo.
        """
        with one_thread():
            seen = see(self._readers.network, Pyramid(as_photo(source)), self.config, Clock())
            sides = see_from_sides(self._readers.network, seen, self.config)
        mean = agreed(sides) if sides else None
        return mean.backward if isinstance(mean, Inversion) else None

    def _rectified(self, photo: Photo, focal: float | None, corners: Corners | None, clock: Clock) -> RectifyResult:
        """Run all stages in turn, until one finds no film. focal: as returned by ``_photo_of``."""
        with clock.stage("survey") as report:
            shown = survey_photo(photo, self.config.survey)
            report.reason = shown.reason
        size = (photo.shape[0], photo.shape[1])
        if not shown.ok:
            return RectifyResult(Status(shown.code), clock.reports, photo_size=size)
        pyramid, network, config = Pyramid(photo), self._readers.network, _with_lens(self.config, focal)
        job = Job(pyramid, self._readers, config)
        told = None if corners is None else film_at(corners, size)
        if told is None:
            seen = see(network, pyramid, config, clock)
            seen, checks = checked(network, pyramid, seen, config, clock)
        else:
            seen = see_at(network, pyramid, told, config, clock)
            checks = Verdict(StatusCode.OK, "its corners are given")
        phases = job.phases_of(seen.maps)
        whole: WholeSheet | None = None
        if checks.ok:
            assert isinstance(seen.inversion, Inversion)  # else there is no film
            refined = shape_of(job, seen.inversion.backward, phases, clock)
            beside = partial(network_beside, network, seen, config)
            whole = whole_sheet(job, phases, refined, beside, clock) if corners is None else WholeSheet(refined)
        flat = flat_itself(job, seen, phases, whole and whole.refinement, told, clock)
        if flat is not None:
            whole = WholeSheet(flat)
        if whole is None:
            return RectifyResult(Status(checks.code), clock.reports, photo_size=size)
        first = judged(job, seen, whole, flat is not None, clock)
        found = beyond_doubt(job, seen, first, corners is None, clock)
        clock.counts(found.stages)
        verdict, signs = found.verdict, found.signs
        if verdict.code is StatusCode.NO_FILM:
            if corners is None:
                return RectifyResult(Status(verdict.code), clock.reports, photo_size=size)
            verdict = replace(verdict, code=StatusCode.UNSURE)
        if corners is not None and not survey_print(pyramid, found.refinement.backward, config.survey).ok:
            doubts = (*verdict.doubts, "it is printed dark on bright: of a negative, invert the picture first")
            verdict = replace(verdict, code=StatusCode.UNSURE, doubts=doubts)
        lens = None if flat is not None else config.refine.sheet
        result = finished(job, seen.maps, found.refinement, lens, clock)
        return replace(
            result,
            status=Status(verdict.code, verdict.doubts),
            expected_error_px=expected_error_px(signs, config.trust),
            limit_px=largest_error_px(signs.photo_px, config.trust),
            signs=signs,
            photo_size=size,
        )


def _photo_of(source: PhotoSource, clock: Clock, focal: float | None = None) -> tuple[Photo, float | None]:
    """The photo, as a stage, and the focal length in units of its longer side if it is given or its file states it."""
    with clock.stage("read") as report:
        photo, focal = as_photo(source), told_focal(source) if focal is None else focal
        lens = "" if focal is None else f", by a lens of {focal:.2f} times its longer side"
        report.reason = f"{photo.shape[1]} x {photo.shape[0]} pixels{lens}"
    return photo, focal


def _with_lens(config: RectifyConfig, focal: float | None) -> RectifyConfig:
    """The options for a photo whose focal length, in its longer sides, is known; one that was asked for is kept."""
    usual = config.refine.sheet
    if focal is None or usual.focal != SheetConfig().focal:
        return config
    limits = min(usual.focal_range[0], focal), max(usual.focal_range[1], focal)
    sheet = replace(usual, focal=focal, focal_sigma=(TOLD_SIGMA, TOLD_SIGMA), focal_range=limits, main_lens=0.0)
    return replace(config, refine=replace(config.refine, sheet=sheet))


@lru_cache(maxsize=3)
def _rectifier(config: RectifyConfig) -> Rectifier:
    return Rectifier(config)


def rectify(
    photo: PhotoSource, effort: Effort | str = "default", corners: Corners | None = None, focal: float | None = None
) -> RectifyResult:
    """Rectify one photo with the packaged network and an effort's options; see Rectifier.

    Raises:
        ConfigError: there is no such effort or focal length, or these cannot be a film's corners.
    """
    return _rectifier(RectifyConfig.of(effort))(photo, corners, focal)
