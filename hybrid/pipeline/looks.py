"""What the network sees of a photo: in looks at the whole, then at the film, and through a map once one is found."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from hybrid.backward import BackwardMap
from hybrid.effort import RectifyConfig
from hybrid.learn.networks.filmnet import FilmNet
from hybrid.learn.reading.predict import look, look_from_sides
from hybrid.learn.reading.views import film_view, near_views, plane_of, whole_view
from hybrid.pyramid import Photo, Pyramid
from hybrid.records import CoarseMaps, StatusCode
from hybrid.rectify.coarse.corners import put_on_corners
from hybrid.rectify.coarse.invert import Inversion, InvertConfig, NotInverted, change, fit_backward
from hybrid.rectify.verdict.survey import SurveyConfig, Verdict, expected_error, film_share, survey_maps, survey_print
from hybrid.rectify.verdict.trust import seen_beside
from hybrid.stages import Clock

WIDER, NEARER = 1.25, 0.7
"""Widths, relative to the photo's, of the first looks that are tried in turn if a look at the whole shows no film."""


@dataclass(frozen=True, eq=False)
class LastLook:
    """What the network saw in its last look: the maps, the film's map fitted to them, and the view of the film, if any.

    All but ``inversion`` and ``maps`` refer to ``photo``, the copy of the photo, ``factor`` times smaller, that it saw.
    filled: share of the photo that showed film in the first look. near: whether that look was at only a part of the
    photo, because the whole showed no film.
    """

    maps: CoarseMaps
    inversion: Inversion | NotInverted
    view: BackwardMap | None
    photo: Photo
    factor: int
    filled: float = 0.0
    near: bool = False


def see(
    network: FilmNet, pyramid: Pyramid, config: RectifyConfig, clock: Clock, first: BackwardMap | None = None
) -> LastLook:
    """The network's looks at the photo: at the whole, then at the film, flattened by the plane seen last.

    first: what the first look is at, if not the whole.
    """
    predict = config.predict
    with clock.stage("network") as report:
        photo, factor = pyramid.reduced(max(pyramid.size) / predict.least_px)
        whole = whole_view((photo.shape[0], photo.shape[1]))
        shown = whole if first is None else first.cropped((0.0, 0.0), (1 / factor, 1 / factor))
        (maps,) = look(network, photo, [shown])
        filled = film_share(maps, photo.shape)
        inversion, looks, moved = fit_backward(maps, config.invert), 1, np.inf
        view: BackwardMap | None = None
        while looks < predict.looks and moved > predict.settled:
            if isinstance(inversion, NotInverted) or inversion.backward.folds((9, 9)):
                break
            if looks > 1 and expected_error(maps) > config.survey.max_expected_error:
                break  # no film, it seems: a further look would only flatter it
            view = film_view(plane_of(inversion.backward), predict.margin)
            (maps,) = look_from_sides(network, photo, view, predict.sides[:1])
            last, inversion = inversion, fit_backward(maps, config.invert)
            looks, moved = looks + 1, change(last, inversion)
        if isinstance(inversion, NotInverted):
            report.reason = inversion.reason
        else:
            inversion = inversion.enlarged(factor)
            report.reason = f"{looks} looks, the last one fitted to {inversion.residual_px:.1f} px"
    return LastLook(maps.enlarged(factor), inversion, view, photo, factor, filled)


def see_at(network: FilmNet, pyramid: Pyramid, told: BackwardMap, config: RectifyConfig, clock: Clock) -> LastLook:
    """The network's look at a film whose corners a person gave, flattened by the plane sheet ``told`` that has them.

    The map is displaced to have these corners; if the network sees no film there, it is that of the plane sheet.
    """
    predict = config.predict
    with clock.stage("network") as report:
        photo, factor = pyramid.reduced(max(pyramid.size) / predict.least_px)
        told = told.cropped((0.0, 0.0), (1 / factor, 1 / factor))
        view = film_view(told, predict.margin)
        (maps,) = look_from_sides(network, photo, view, predict.sides[:1])
        inversion = fit_backward(maps, config.invert)
        if isinstance(inversion, Inversion):
            inversion = replace(inversion, backward=put_on_corners(inversion.backward, told))
            report.reason = f"a look at the given corners, fitted to {inversion.residual_px * factor:.1f} px"
        if isinstance(inversion, NotInverted) or inversion.backward.folds((17, 17)):
            inversion = Inversion(told, residual_px=0.0, coverage=0.0, inlier_share=0.0)
            report.reason = "the plane sheet with the given corners, as no film is seen there"
    return LastLook(maps.enlarged(factor), inversion.enlarged(factor), view, photo, factor)


def check(pyramid: Pyramid, seen: LastLook, config: SurveyConfig) -> Verdict:
    """Whether what the network saw is one sheet, seen whole, and printed as films are."""
    verdict = survey_maps(seen.maps, seen.inversion, pyramid.size, config)
    if not verdict.ok or isinstance(seen.inversion, NotInverted):
        return verdict
    printed = survey_print(pyramid, seen.inversion.backward, config)
    return Verdict(printed.code, f"{printed.reason}; {verdict.reason}")


def checked(
    network: FilmNet, pyramid: Pyramid, seen: LastLook, config: RectifyConfig, clock: Clock
) -> tuple[LastLook, Verdict]:
    """What the network saw, and whether it is a film; if not, what it sees after a wider first look, or after first
    looks at parts of the photo.

    A film with little room around it may look as if it continued beyond the photo; of several side by side, the whole
    may show none. What is seen then counts only if the whole sheet lies in the photo: of a sheet that does leave it,
    the visible part would be taken for all.
    """
    with clock.stage("check") as report:
        verdict = check(pyramid, seen, config.survey)
        if verdict.code in (StatusCode.NO_FILM, StatusCode.CUT_OFF, StatusCode.PAPER):
            if found := _found(network, pyramid, [whole_view(pyramid.size, WIDER)], config):
                seen, verdict = found[0], Verdict(found[1].code, f"from a wider look: {found[1].reason}")
            elif verdict.code is StatusCode.NO_FILM and (
                found := _found(network, pyramid, near_views(pyramid.size, NEARER), config)
            ):
                seen = replace(found[0], filled=0.0, near=True)
                verdict = Verdict(found[1].code, f"from a nearer look: {found[1].reason}")
        report.reason = verdict.reason
    return seen, verdict


def _found(
    network: FilmNet, pyramid: Pyramid, first: Sequence[BackwardMap], config: RectifyConfig
) -> tuple[LastLook, Verdict] | None:
    """What is seen from the first looks that lead to a film which lies in the photo as a whole: the surest, or None."""
    looks = [see(network, pyramid, config, Clock(), one) for one in first]
    films = [
        (seen, verdict)
        for seen in looks
        if (verdict := check(pyramid, seen, config.survey)).ok and _lies_within(seen.inversion, pyramid.size)
    ]
    return min(films, key=lambda film: expected_error(film[0].maps), default=None)


def _lies_within(inversion: Inversion | NotInverted, size: tuple[int, int]) -> bool:
    """Whether a photo of ``size`` (height, width) shows all of the sheet."""
    if isinstance(inversion, NotInverted):
        return False
    nodes = inversion.backward.nodes
    return bool((nodes >= 0).all() and (nodes <= np.array(size[::-1])).all())


def see_from_sides(network: FilmNet, seen: LastLook, config: RectifyConfig) -> list[Inversion]:
    """The maps of the last look, with the view turned and mirrored in several ways; that of ``seen`` is the last."""
    first, others = seen.inversion, config.predict.sides[1:]
    if isinstance(first, NotInverted):
        return []
    if seen.view is None or not others:
        return [first]
    looks = look_from_sides(network, seen.photo, seen.view, others)
    found = [fit_backward(maps, config.invert) for maps in looks]
    return [*(side.enlarged(seen.factor) for side in found if isinstance(side, Inversion)), first]


def network_beside(network: FilmNet, seen: LastLook, config: RectifyConfig, film: BackwardMap) -> float:
    """How far beside a map the network sees the film, smoothed, as a fraction of its size."""
    return seen_beside(seen_through(network, seen, config, film), film)


def seen_through(network: FilmNet, seen: LastLook, config: RectifyConfig, film: BackwardMap) -> CoarseMaps:
    """What the network sees of the film when a map flattens it (as a plane sheet)."""
    plane = plane_of(_reduced(film, seen))
    (again,) = look(network, seen.photo, [film_view(plane, config.predict.margin)])
    return again.enlarged(seen.factor)


def see_bent(
    network: FilmNet, seen: LastLook, config: RectifyConfig, films: Sequence[BackwardMap], kept: Sequence[int]
) -> list[LastLook]:
    """The looks through ``films`` that the network is surest of, then of looks through the maps of these, and so on.

    What is seen through a map that is off is nearer to the truth, as a rule, so each round brings good ones closer to
    it. kept: how many looks each round leaves; the last one's are returned, the surest first, if any shows a film.
    """
    views = [film_view(_reduced(film, seen), config.predict.margin) for film in films]
    found: list[tuple[CoarseMaps, Inversion, BackwardMap]] = []
    for most in kept:
        looks = zip(look(network, seen.photo, views), views, strict=True)
        surest = sorted(looks, key=lambda each: expected_error(each[0]))
        found = list(islice(_fitted(surest, config.invert), most))
        if not found:
            break
        views = [film_view(inversion.backward, config.predict.margin) for _, inversion, _ in found]
    return [
        replace(seen, maps=maps.enlarged(seen.factor), inversion=inversion.enlarged(seen.factor), view=view)
        for maps, inversion, view in found
    ]


def _fitted(
    looks: Iterable[tuple[CoarseMaps, BackwardMap]], config: InvertConfig
) -> Iterator[tuple[CoarseMaps, Inversion, BackwardMap]]:
    """The looks, maps and view each, that show a film, with its map; each is fitted when it is asked for."""
    for maps, view in looks:
        inversion = fit_backward(maps, config)
        if isinstance(inversion, Inversion) and not inversion.backward.folds((17, 17)):
            yield maps, inversion, view


def _reduced(film: BackwardMap, seen: LastLook) -> BackwardMap:
    """The map of a film in the copy of the photo that the network saw."""
    return film.cropped((0.0, 0.0), (1 / seen.factor, 1 / seen.factor))


__all__ = [
    "LastLook",
    "check",
    "checked",
    "network_beside",
    "see",
    "see_at",
    "see_bent",
    "see_from_sides",
    "seen_through",
]
