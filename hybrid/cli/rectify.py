"""``hybrid rectify``: the options, the run over the photos, the exit code."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated

import tyro
from tqdm import tqdm

from hybrid.cli.options import PhotoOptions, made_by, parse, photos_among
from hybrid.cli.rectify_files import Rectify, rectify_files
from hybrid.errors import ConfigError, describe
from hybrid.pipeline import Rectifier, RectifyConfig

Point = tuple[float, float]


def _points_of(numbers: Sequence[str]) -> tuple[Point, ...]:
    values = [float(number) for number in numbers]
    return tuple(zip(values[::2], values[1::2], strict=True))


_FOUR_POINTS = tyro.constructors.PrimitiveConstructorSpec(
    nargs=8,
    metavar="X Y X Y X Y X Y",
    instance_from_str=_points_of,
    is_instance=lambda value: value is None or isinstance(value, tuple),
    str_from_instance=lambda points: ["None"] if points is None else [str(x) for point in points for x in point],
)
"""Eight numbers, no more: what follows may be a photo."""


@dataclass(frozen=True)
class FewOptions(PhotoOptions):
    """Those of ``PhotoOptions``, and how the photos are shared among processes."""

    workers: int = 1
    """Processes that share the photos: for many photos on two cores, two processes take about two thirds of the time
    and twice the memory."""

    corners: Annotated[tuple[Point, ...] | None, _FOUR_POINTS] = None
    """The sheet's corners in a single photo, x and y of each in pixels, in any order: for a photo whose film is not
    found or is found wrong. An accuracy of a hundredth of the film is enough."""

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise ConfigError(describe(what="--workers", got=self.workers, allowed="1 or more", do="Name how many."))
        numbers = [x for point in self.corners or () for x in point]
        if not all(map(math.isfinite, numbers)):
            got = " ".join(f"{x:g}" for x in numbers)
            raise ConfigError(describe(what="--corners", got=got, allowed="numbers", do="Name pixels of the photo."))


@dataclass(frozen=True)
class RectifyOptions(FewOptions):
    """Flatten photos of CT films.

    For each photo NAME this writes NAME_film.png (16 bit, light removed), NAME_confidence.png (white where the film can
    be trusted), NAME_rectified (flat, light kept), NAME_slices/01.png and so on, NAME_side_by_side.jpg and NAME.json. A
    photo that fails is reported, and the next one follows; the exit code is 1 if any failed. Films that may be off, or
    may lie on their side, are written too, and listed at the end.
    """

    config: Annotated[RectifyConfig, tyro.conf.arg(name="")] = field(default_factory=RectifyConfig)
    """How to rectify."""


def run(arguments: list[str]) -> int:
    """Parse the command line and rectify; 0 if every photo gave a film."""
    options = parse(RectifyOptions, FewOptions, arguments, "hybrid rectify", RectifyConfig.of)
    photos = photos_among(options.photos)
    if not photos:
        told = "no photos; name at least one, for example: hybrid rectify photo.jpg -o out"
        print(f"hybrid rectify: {told}", file=sys.stderr)
        return 2
    if options.corners is not None and len(photos) > 1:
        got, do = f"{len(photos)} photos", "Rectify this photo by itself."
        told = describe(what="--corners", got=got, allowed="one photo", do=do)
        print(f"hybrid rectify: {told}", file=sys.stderr)
        return 2
    made = made_by(options.effort, RectifyConfig.of(options.effort), options.config)
    outcomes = rectify_files(
        photos,
        options.out,
        partial(_rectifier, options.config, options.corners),
        options.rectified_format,
        tqdm.write,
        made | ({} if options.corners is None else {"corners": options.corners}),
        options.verbose,
        options.workers,
        options.dicom,
    )
    failed = [outcome for outcome in outcomes if not outcome.ok]
    if len(outcomes) > 1:
        unsure = sum(outcome.unsure for outcome in outcomes)
        told = f", {unsure} of them UNSURE" if unsure else ""
        print(f"{len(outcomes) - len(failed)} of {len(outcomes)} photos flattened{told}, in {options.out}")
        for outcome in failed:
            print(f"  failed: {outcome.photo}: {outcome.message}")
        for outcome in outcomes:
            for warning in outcome.warnings:
                print(f"  look at {outcome.photo}: {warning}")
    return 1 if failed else 0


def _rectifier(config: RectifyConfig, corners: tuple[Point, ...] | None) -> Rectify:
    """What rectifies photos, with the sheet's corners if any are given."""
    return partial(Rectifier(config), corners=corners)
