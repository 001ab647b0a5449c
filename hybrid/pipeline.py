"""The whole way from a photo to the flat film, as a sequence of stages that each report what they did and why."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Literal

import numpy as np
from threadpoolctl import ThreadpoolController

from hybrid.backward import BackwardMap, Orientation
from hybrid.errors import ConfigError, FusionError, describe
from hybrid.image_io import as_photo
from hybrid.learn.network import FilmNet, FilmNetConfig, fused
from hybrid.learn.predict import PredictConfig, look, look_from_sides
from hybrid.learn.upright import UprightConfig, UprightNet, orientation_chances, upright_way
from hybrid.learn.views import film_view, plane_of, whole_view
from hybrid.learn.weights import load_weights, packaged_film_net, packaged_upright_net
from hybrid.pyramid import Photo, Pyramid
from hybrid.records import CoarseMaps, RectifyResult, SliceGrid, StageReport, Status, StatusCode
from hybrid.rectify.deilluminate import DeilluminateConfig, deilluminate
from hybrid.rectify.film_size import FilmSizeConfig, film_size
from hybrid.rectify.fuse import FuseConfig, fuse
from hybrid.rectify.glance import VIEW_PX, glance
from hybrid.rectify.invert import Inversion, InvertConfig, NotInverted, agreed, change, fit_backward
from hybrid.rectify.refine import RefineConfig, Refinement, refine
from hybrid.rectify.resample import Rectified, ResampleConfig, rectify_photo
from hybrid.rectify.survey import SurveyConfig, Verdict, expected_error, survey_maps, survey_photo
from hybrid.rectify.trust import TrustConfig, expected_error_px, film_verdict, signs_of

Effort = Literal["fast", "default", "thorough"]
"""How much work a photo is worth; RectifyConfig.of says what each of them does."""


@dataclass(frozen=True)
class RectifyConfig:
    """How photos are rectified; every stage has its own options, and ``of`` sets those on which time depends."""

    weights: Path | None = None
    """A FilmNet file made by ``hybrid train``; None for the packaged one."""
    survey: SurveyConfig = field(default_factory=SurveyConfig)
    predict: PredictConfig = field(default_factory=PredictConfig)
    invert: InvertConfig = field(default_factory=InvertConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    exact: bool = True
    """Whether the network's map is made exact by what is seen of the film; else it is only searched for the grid."""
    again: bool = False
    """Whether refinement is started again: from its own result, or, where that is not believed, from what the network
    saw of each side apart."""
    size: FilmSizeConfig = field(default_factory=FilmSizeConfig)
    resample: ResampleConfig = field(default_factory=ResampleConfig)
    upright: UprightConfig = field(default_factory=UprightConfig)
    light: DeilluminateConfig = field(default_factory=DeilluminateConfig)
    trust: TrustConfig = field(default_factory=TrustConfig)
    fuse: FuseConfig = field(default_factory=FuseConfig)

    @staticmethod
    def of(effort: Effort) -> RectifyConfig:
        """The options of an effort.

        fast: the network's map as it is, the photo read bilinearly. default: the options' own values. thorough: as
        default, with more looks where they move the film, and refinement started again.

        Raises:
            ConfigError: there is no such effort.
        """
        efforts = {
            "fast": RectifyConfig(
                predict=PredictConfig(sides=(0,)),
                exact=False,
                resample=ResampleConfig(cubic_below=0.0),
            ),
            "default": RectifyConfig(),
            "thorough": RectifyConfig(predict=PredictConfig(looks=5, settled=0.003), again=True),
        }
        if effort not in efforts:
            raise ConfigError(
                describe(what="Effort", got=repr(effort), allowed=", ".join(efforts), do="Name one of them.")
            )
        return efforts[effort]


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

        film, glare and confidence are made of all photos; the rest is the first photo's, to which the others are
        registered: its status if no film is found in it. Others without a film are left out, which the last stage says.

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
        if not results[0].status.has_film:
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
            inversion = self._see(Pyramid(as_photo(source)), _Clock()).inversion
        return None if isinstance(inversion, NotInverted) else inversion.backward

    def _rectified(self, source: str | Path | np.ndarray) -> RectifyResult:
        """All stages, one after the other, until one says that there is no film."""
        clock = _Clock()
        with clock.stage("read") as report:
            photo = as_photo(source)
            report.reason = f"{photo.shape[1]} x {photo.shape[0]} pixels"
        with clock.stage("survey") as report:
            shown = survey_photo(photo, self.config.survey)
            report.reason = shown.reason
        if not shown.ok:
            return RectifyResult(Status(shown.code), clock.reports)
        pyramid = Pyramid(photo)
        seen = self._see(pyramid, clock)
        maps, inversion = seen.maps, seen.inversion
        with clock.stage("check") as report:
            verdict = survey_maps(maps, inversion, self.config.survey)
            report.reason = verdict.reason
        if not verdict.ok or isinstance(inversion, NotInverted):
            code = StatusCode.NO_FILM if verdict.ok else verdict.code
            return RectifyResult(Status(code), clock.reports)
        refinement = self._refine(pyramid, inversion, seen.sides, clock)
        with clock.stage("verdict") as report:
            verdict, expected = self._trusted(pyramid, maps, inversion.backward, refinement)
            report.reason = verdict.reason
        result = self._finish(pyramid, maps, refinement, clock)
        return replace(result, status=Status(verdict.code), expected_error_px=expected)

    def _trusted(
        self, pyramid: Pyramid, maps: CoarseMaps, coarse: BackwardMap, refinement: Refinement
    ) -> tuple[Verdict, float]:
        """Whether the refined map is as good as certain, and its expected error; the network looks once more for it."""
        config = self.config
        small, factor = pyramid.reduced(max(pyramid.photo.shape[:2]) / config.predict.least_px)
        plane = plane_of(refinement.backward.cropped((0.0, 0.0), (1 / factor, 1 / factor)))
        (again,) = look(self._network, small, [film_view(plane, config.predict.margin)])
        signs = signs_of(pyramid, maps, coarse, refinement, again.enlarged(factor))
        return film_verdict(signs, config.trust), expected_error_px(signs, config.trust)

    def _see(self, pyramid: Pyramid, clock: _Clock) -> _Seen:
        """What the network makes of the photo: of the whole, then of the film, flattened by the plane seen last."""
        config, predict = self.config, self.config.predict
        with clock.stage("network") as report:
            photo, factor = pyramid.reduced(max(pyramid.photo.shape[:2]) / predict.least_px)
            (maps,) = look(self._network, photo, [whole_view((photo.shape[0], photo.shape[1]))])
            inversion, looks, moved = fit_backward(maps, config.invert), 1, np.inf
            view: BackwardMap | None = None
            while looks < predict.looks and moved > predict.settled:
                if isinstance(inversion, NotInverted) or inversion.backward.folds((9, 9)):
                    break
                if looks > 1 and expected_error(maps) > config.survey.max_expected_error:
                    break  # no film, it seems: a further look would only flatter it
                view = film_view(plane_of(inversion.backward), predict.margin)
                (maps,) = look_from_sides(self._network, photo, view, predict.sides[:1])
                last, inversion = inversion, fit_backward(maps, config.invert)
                looks, moved = looks + 1, change(last, inversion)
            sides = [inversion]
            if view is not None and len(predict.sides) > 1 and not isinstance(inversion, NotInverted):
                others = look_from_sides(self._network, photo, view, predict.sides[1:])
                sides = [*(fit_backward(other, config.invert) for other in others), inversion]
            seen = _Seen.of(maps, sides, factor)
            if isinstance(inversion, NotInverted):
                report.reason = inversion.reason
            else:
                explained = f"the last explained to {inversion.residual_px * factor:.1f} px"
                report.reason = f"{looks} looks, the last from {len(sides)} sides; {explained}"
        return seen

    def _refine(self, pyramid: Pyramid, coarse: Inversion, sides: Sequence[Inversion], clock: _Clock) -> Refinement:
        """The network's map made exact; where that leaves doubt, the best of what comes of each side's map."""
        config = self.config
        if not config.exact:
            found = _on_copy(pyramid, coarse.backward, VIEW_PX, partial(glance, config=config.refine))
            clock.reports += found.stages
            return found
        exact, px = partial(refine, config=config.refine), config.refine.working_px
        best = _on_copy(pyramid, coarse.backward, px, exact)
        clock.reports += best.stages
        with clock.stage("again") as report:
            report.ran, report.reason = config.again, "one refinement is enough in this effort"
            if config.again:
                starts = [best] if _believed(best) else sides
                further = [_on_copy(pyramid, start.backward, px, exact) for start in starts]
                report.reason = f"from {'its own result' if _believed(best) else f'each of {len(sides)} sides'}"
                further = [one for one in further if _believed(one)]
                report.reason += f": {len(further)} of {len(starts)} believed"
                best = min(further, key=lambda one: one.expected_px or 0.0, default=best)
        return best

    def _finish(self, pyramid: Pyramid, maps: CoarseMaps, refinement: Refinement, clock: _Clock) -> RectifyResult:
        """Read the photo once through the map, turn the film upright, then take the light out."""
        backward: BackwardMap = refinement.backward
        grid: SliceGrid | None = refinement.grid
        with clock.stage("resample") as report:
            size = film_size(backward, maps, grid, self.config.size)
            flat = rectify_photo(pyramid, backward, size, self.config.resample)
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


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the network saw. maps: in its last look. inversion: the map that follows. sides: that of each side apart."""

    maps: CoarseMaps
    inversion: Inversion | NotInverted
    sides: tuple[Inversion, ...]

    @staticmethod
    def of(maps: CoarseMaps, sides: Sequence[Inversion | NotInverted], factor: int) -> _Seen:
        """The maps of a photo reduced by ``factor``, for the photo itself; ``sides``: the one that counts most last."""
        whole = [side if isinstance(side, NotInverted) else side.enlarged(factor) for side in sides]
        apart = tuple(side for side in whole if isinstance(side, Inversion))
        return _Seen(maps.enlarged(factor), agreed(whole), apart)


def _on_copy(
    pyramid: Pyramid, coarse: BackwardMap, film_px: int, work: Callable[[Photo, BackwardMap], Refinement]
) -> Refinement:
    """What ``work`` makes of the map on a copy of the photo in which the film's longer side has about ``film_px``."""
    photo, (x, y) = pyramid.scaled(film_px / max(coarse.mean_film_pixels()))
    found = work(photo, coarse.cropped((0.0, 0.0), (x, y)))
    up = (1.0 / x, 1.0 / y)
    grid = found.grid and replace(found.grid, vertices_photo=found.grid.vertices_photo * np.array(up))
    left = None if found.expected_px is None else found.expected_px * up[0]
    return replace(found, backward=found.backward.cropped((0.0, 0.0), up), grid=grid, expected_px=left)


def _believed(refinement: Refinement) -> bool:
    """Whether refinement took what it found for better than the map that it started from."""
    return refinement.expected_px is not None


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    """Control of the linear algebra's threads: on matrices this small, several wait more than they work."""
    return ThreadpoolController()


@lru_cache(maxsize=3)
def _rectifier(effort: Effort) -> Rectifier:
    return Rectifier(RectifyConfig.of(effort))


def rectify(photo: str | Path | np.ndarray, effort: Effort = "default") -> RectifyResult:
    """Rectify one photo with the packaged network and an effort's options; see Rectifier.

    Raises:
        ConfigError: there is no such effort.
    """
    return _rectifier(effort)(photo)


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
