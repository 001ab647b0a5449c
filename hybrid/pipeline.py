"""The whole way from a photo to the flat film, as a sequence of stages that each report what they did and why."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from threadpoolctl import ThreadpoolController

from hybrid.backward import BackwardMap, Orientation
from hybrid.errors import FusionError, describe
from hybrid.image_io import as_photo
from hybrid.learn.network import FilmNet, FilmNetConfig, fused
from hybrid.learn.predict import PredictConfig, look, look_from_sides
from hybrid.learn.upright import UprightConfig, UprightNet, orientation_chances, upright_way
from hybrid.learn.views import film_view, plane_of, reduced, whole_view
from hybrid.learn.weights import load_weights, packaged_film_net, packaged_upright_net
from hybrid.records import CoarseMaps, RectifyResult, SliceGrid, StageReport, Status, StatusCode
from hybrid.rectify.deilluminate import DeilluminateConfig, deilluminate
from hybrid.rectify.film_size import FilmSizeConfig, film_size
from hybrid.rectify.fuse import FuseConfig, fuse
from hybrid.rectify.invert import Inversion, InvertConfig, NotInverted, agreed, change, fit_backward
from hybrid.rectify.refine import RefineConfig, Refinement, refine
from hybrid.rectify.resample import Rectified, rectify_photo
from hybrid.rectify.survey import SurveyConfig, expected_error, survey_maps, survey_photo

Photo = UInt8[np.ndarray, "H W 3"]


@dataclass(frozen=True)
class RectifyConfig:
    """How photos are rectified; every stage has its own options.

    weights: a FilmNet file made by ``hybrid train``, or None for the packaged one.
    """

    weights: Path | None = None
    survey: SurveyConfig = field(default_factory=SurveyConfig)
    predict: PredictConfig = field(default_factory=PredictConfig)
    invert: InvertConfig = field(default_factory=InvertConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    size: FilmSizeConfig = field(default_factory=FilmSizeConfig)
    upright: UprightConfig = field(default_factory=UprightConfig)
    light: DeilluminateConfig = field(default_factory=DeilluminateConfig)
    fuse: FuseConfig = field(default_factory=FuseConfig)


class Rectifier:
    """Rectifies photos; the network is loaded once, here.

    Raises:
        DataError: ``config.weights`` is not a weights file.
    """

    def __init__(self, config: RectifyConfig | None = None) -> None:
        self.config = config or RectifyConfig()
        weights = self.config.weights
        self._network: FilmNet = fused(
            packaged_film_net() if weights is None else load_weights(weights, FilmNet, FilmNetConfig)
        )
        self._reader: UprightNet = fused(packaged_upright_net())

    def __call__(self, source: str | Path | np.ndarray) -> RectifyResult:
        """The flat film of a photo.

        Args:
            source: a path, (H, W, 3) uint8 RGB, or (H, W) uint8.

        Raises:
            PhotoError: the source cannot be read as a photo. A photo without a film is no error but a status.
        """
        with _blas().limit(limits=1, user_api="blas"):
            return self._rectified(source)

    def fuse(self, sources: Sequence[str | Path | np.ndarray]) -> RectifyResult:
        """One film of several photos of it, between which phone or lamps moved, so that glare vanishes.

        film, glare and confidence are made of all photos; the rest is the first photo's, its map moved to where all
        say that the print lies: its status if no film is found in it. Others without a film are left out, which the
        last stage says.

        Args:
            sources: as for a single photo, two or more.

        Raises:
            PhotoError: a source cannot be read as a photo.
            FusionError: fewer than two photos, or photos of different films.
        """
        if len(sources) < 2:
            do = "Name two or more photos of one film; a single one is rectified."
            raise FusionError(describe(what="Photos to fuse", got=len(sources), allowed="two or more", do=do))
        photos = [as_photo(source) for source in sources]
        results = [self(photo) for photo in photos]
        if not results[0].status.ok:
            return results[0]
        with _blas().limit(limits=1, user_api="blas"):
            return fuse(photos, results, self.config.fuse, self.config.light)

    def network_map(self, source: str | Path | np.ndarray) -> BackwardMap | None:
        """What the network alone makes of a photo, before refinement: the map of the film as it lies in the photo.

        None where it sees no film. For comparing networks, which refinement would make alike.

        Raises:
            PhotoError: the source cannot be read as a photo.
        """
        with _blas().limit(limits=1, user_api="blas"):
            _, inversion = self._see(as_photo(source), _Clock())
        return None if isinstance(inversion, NotInverted) else inversion.backward

    def _rectified(self, source: str | Path | np.ndarray) -> RectifyResult:
        """All stages, one after the other, until one says that there is no film."""
        clock = _Clock()
        with clock.stage("read") as report:
            photo = as_photo(source)
            report.reason = f"{photo.shape[1]} x {photo.shape[0]} pixels"
        with clock.stage("survey") as report:
            seen = survey_photo(photo, self.config.survey)
            report.reason = seen.reason
        if not seen.ok:
            return RectifyResult(Status(seen.code), clock.reports)
        maps, inversion = self._see(photo, clock)
        with clock.stage("check") as report:
            verdict = survey_maps(maps, inversion, self.config.survey)
            report.reason = verdict.reason
        if not verdict.ok or isinstance(inversion, NotInverted):
            code = StatusCode.NO_FILM if verdict.ok else verdict.code
            return RectifyResult(Status(code), clock.reports)
        refinement = refine(photo, inversion.backward, self.config.refine)
        clock.reports += refinement.stages
        return self._finish(photo, maps, refinement, clock)

    def _see(self, photo: Photo, clock: _Clock) -> tuple[CoarseMaps, Inversion | NotInverted]:
        """What the network makes of the photo: of the whole, then of the film, flattened by the plane seen last."""
        config = self.config
        with clock.stage("network") as report:
            photo, factor = reduced(photo, config.predict.least_px)
            (maps,) = look(self._network, photo, [whole_view((photo.shape[0], photo.shape[1]))])
            inversion, looks, moved = fit_backward(maps, config.invert), 1, np.inf
            while looks < config.predict.looks and moved > config.predict.settled:
                if isinstance(inversion, NotInverted) or inversion.backward.folds((9, 9)):
                    break
                if looks > 1 and expected_error(maps) > config.survey.max_expected_error:
                    break  # no film, it seems: a further look would only flatter it
                view = film_view(plane_of(inversion.backward), config.predict.margin)
                seen = look_from_sides(self._network, photo, view, config.predict.sides)
                last, inversion = inversion, agreed([fit_backward(maps, config.invert) for maps in seen])
                maps, looks, moved = seen[0], looks + 1, change(last, inversion)
            if isinstance(inversion, NotInverted):
                report.reason = inversion.reason
            else:
                inversion = inversion.enlarged(factor)
                report.reason = f"{looks} looks, the last explained to {inversion.residual_px:.1f} px"
        return maps.enlarged(factor), inversion

    def _finish(self, photo: Photo, maps: CoarseMaps, refinement: Refinement, clock: _Clock) -> RectifyResult:
        """Read the photo once through the map, turn the film upright, then take the light out."""
        backward: BackwardMap = refinement.backward
        grid: SliceGrid | None = refinement.grid
        with clock.stage("resample") as report:
            size = film_size(backward, maps, grid, self.config.size)
            flat = rectify_photo(photo, backward, size)
            report.reason = f"to {size[1]} x {size[0]} pixels"
        with clock.stage("upright") as report:
            way, probability = self._read(flat, report)
            if way.index:
                flat, backward, grid = flat.turned(way), backward.turned(way), grid and grid.turned(way)
        with clock.stage("light") as report:
            light = deilluminate(flat.image, flat.valid, grid, self.config.light)
            report.ran, report.reason = light.ran, light.reason
        return RectifyResult(
            status=Status(StatusCode.OK),
            stages=clock.reports,
            film=light.film,
            rectified=flat.image,
            backward=backward,
            grid=grid,
            orientation=way,
            upright_probability=probability,
            glare=light.glare,
            confidence=light.confidence,
        )

    def _read(self, flat: Rectified, report: _Report) -> tuple[Orientation, float | None]:
        """How the flat film has to be moved to read right, by what is written on it, and how sure that is then."""
        config = self.config.upright
        if max(flat.valid.shape) < config.min_film_px:
            report.ran, report.reason = False, "left as it lies: writing this small cannot be read"
            return Orientation(0, False), None
        chances = orientation_chances(self._reader, flat.image, config.prior)
        way, report.reason = upright_way(chances, config)
        return way, float(chances[way.index])


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    """Control of the linear algebra's threads: on matrices this small, several wait more than they work."""
    return ThreadpoolController()


@lru_cache(maxsize=1)
def _default_rectifier() -> Rectifier:
    return Rectifier()


def rectify(photo: str | Path | np.ndarray) -> RectifyResult:
    """Rectify one photo with the packaged network and default options; see Rectifier."""
    return _default_rectifier()(photo)


@dataclass
class _Report:
    """What a stage says of itself while it runs."""

    reason: str = ""
    ran: bool = True


class _Clock:
    """Collects the reports of the stages of one photo, with their seconds."""

    def __init__(self) -> None:
        self.reports: tuple[StageReport, ...] = ()

    @contextmanager
    def stage(self, name: str) -> Iterator[_Report]:
        report, start = _Report(), time.perf_counter()
        yield report
        self.reports += (StageReport(name, report.ran, report.reason, time.perf_counter() - start),)
