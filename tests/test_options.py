"""Impossible options are refused by name when they are given, before any photo is touched."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hybrid import cli
from hybrid.effort import RectifyConfig
from hybrid.errors import ConfigError, FittedWeights, require_at_least, require_numbers
from hybrid.learn.reading.predict import PredictConfig
from hybrid.learn.training.plan import Plan, TrainConfig
from hybrid.rectify.coarse.foreshortening import ForeshorteningConfig
from hybrid.rectify.coarse.invert import InvertConfig
from hybrid.rectify.edges.outline import OutlineConfig
from hybrid.rectify.edges.paths import PathConfig
from hybrid.rectify.film.deilluminate import DeilluminateConfig
from hybrid.rectify.film.size import FilmSizeConfig
from hybrid.rectify.fusion.register import FuseConfig
from hybrid.rectify.grid.cells import CellsConfig
from hybrid.rectify.grid.congeal import CongealConfig
from hybrid.rectify.grid.lines import GridConfig
from hybrid.rectify.grid.match import MatchConfig
from hybrid.rectify.refine.config import RefineConfig
from hybrid.rectify.refine.plane import PlaneConfig
from hybrid.rectify.sheet.shape import SheetConfig
from hybrid.rectify.splines.displacement import SplineConfig
from hybrid.rectify.verdict.trust import TrustConfig

NAN = float("nan")


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (FilmSizeConfig, {"max_side_px": 0}),
        (FilmSizeConfig, {"max_aspect": float("nan")}),
        (DeilluminateConfig, {"work_px": 8}),
        (PredictConfig, {"sides": ()}),
        (CellsConfig, {"widths_px": ()}),
        (InvertConfig, {"nodes": (33, 1)}),
        (GridConfig, {"widths_px": (2, 0)}),
        (ForeshorteningConfig, {"steps": (0.0, 0.0)}),
        (DeilluminateConfig, {"gain_blur": 0.0}),
        (DeilluminateConfig, {"print_white": 0.05}),
        (InvertConfig, {"smoothing": -1.0}),
        (PredictConfig, {"margin": -1.0}),
        (OutlineConfig, {"profiles": 0}),
        (CongealConfig, {"block_px": 0.0}),
        (SheetConfig, {"focal": 0.0}),
        (RefineConfig, {"working_px": -5}),
        (TrustConfig, {"limit_px": -1.0}),
        (FuseConfig, {"patch_px": 1}),
        (SplineConfig, {"lattice": (2, 9)}),
        (SplineConfig, {"prior_px": 0.0}),
        (SplineConfig, {"stiffness": (0.0, 5e5, 5)}),
        (SheetConfig, {"every": (4, 0)}),
        (SheetConfig, {"distortion": 0.0}),
        (SheetConfig, {"bent": 0.0}),
        (SheetConfig, {"stretched": 0.0}),
        (OutlineConfig, {"windows_px": (4, 0)}),
        (OutlineConfig, {"sigma_px": 0.0}),
        (MatchConfig, {"shrink": 0}),
        (CellsConfig, {"kept": 0}),
        (CongealConfig, {"steps": 0}),
        (CongealConfig, {"min_gain": 0.0}),
        (RefineConfig, {"sheet_prior_px": 0.0}),
        (ForeshorteningConfig, {"edge_sigma": 0.0}),
    ],
)
def test_an_option_that_cannot_be_is_refused(kind: type, options: dict) -> None:
    (name,) = options
    with pytest.raises(ConfigError, match=f"{kind.__name__}.{name}: got .*; allowed: >= "):
        kind(**options)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"hopeless": NAN}, "RectifyConfig.hopeless"),
        ({"trust": TrustConfig(safety=NAN)}, "TrustConfig.safety"),
        ({"refine": RefineConfig(sheet=SheetConfig(settled=NAN))}, "SheetConfig.settled"),
    ],
)
def test_what_is_not_a_number_is_refused_wherever_it_stands(options: dict, name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name}: got nan; allowed: >= 0"):
        RectifyConfig(**options)


def every_number(config: Any, before: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Names and value of each option that is a number or a tuple of numbers, in a record and in those nested in it."""
    for one in fields(config):
        value = getattr(config, one.name)
        if is_dataclass(value):
            yield from every_number(value, (*before, one.name))
        elif all(type(each) in (int, float) for each in (value if isinstance(value, tuple) else (value,))):
            yield (*before, one.name), value


def with_option(config: Any, names: tuple[str, ...], value: Any) -> Any:
    first, *rest = names
    return replace(config, **{first: with_option(getattr(config, first), tuple(rest), value) if rest else value})


def test_no_size_count_or_share_is_below_zero() -> None:
    """Only weights of a sum, and options that are usually below zero, may be negative."""
    signed = 0
    for names, value in every_number(RectifyConfig()):
        less = tuple(-type(each)(5) for each in value) if isinstance(value, tuple) else -type(value)(5)
        owner = reduce(getattr, names[:-1], RectifyConfig())
        if isinstance(owner, FittedWeights) or names[-1] in ("floor", "min_skewness"):
            with_option(RectifyConfig(), names, less)
            signed += 1
        else:
            with pytest.raises(ConfigError, match=f"{type(owner).__name__}.{names[-1]}: got "):
                with_option(RectifyConfig(), names, less)
    assert signed > 40


DIVIDES = """
    PredictConfig.least_px InvertConfig.intervals InvertConfig.nodes InvertConfig.scale_floor
    PathConfig.row_sigma BorderConfig.sharp BorderConfig.min_columns EdgeConfig.min_columns
    SplineConfig.lattice SplineConfig.prior_px SplineConfig.stiffness
    ForeshorteningConfig.steps ForeshorteningConfig.pitches ForeshorteningConfig.sigma ForeshorteningConfig.edge_sigma
    ForeshorteningConfig.shared_sigma
    OutlineConfig.profiles OutlineConfig.windows_px OutlineConfig.gap_windows_px OutlineConfig.sigma_px
    OutlineConfig.rule_sigma_px OutlineConfig.covered_px OutlineConfig.noise_levels OutlineConfig.prior
    OutlineConfig.read_prior OutlineConfig.held_prior
    SheetConfig.intervals SheetConfig.every SheetConfig.focal SheetConfig.focal_sigma SheetConfig.focal_range
    SheetConfig.beyond_sigma SheetConfig.distortion SheetConfig.stretched SheetConfig.bent SheetConfig.edge_px
    SheetConfig.print_px SheetConfig.network_px SheetConfig.strain SheetConfig.square
    GridConfig.widths_px GridConfig.strips GridConfig.stations GridConfig.min_levels GridConfig.sigma_px
    GridConfig.centre_sigma GridConfig.pitch_sigma GridConfig.inset_sigma GridConfig.snug_sigma GridConfig.flush_sigma
    MatchConfig.reach_px MatchConfig.fine_px MatchConfig.shrink MatchConfig.constant_sigma MatchConfig.pitch_sigma
    CellsConfig.side_px CellsConfig.widths_px CellsConfig.detail_px CellsConfig.kept MarginsConfig.sigma
    CongealConfig.blurs_px CongealConfig.light CongealConfig.steps CongealConfig.block_px CongealConfig.min_gain
    CongealConfig.shared_sigma CongealConfig.min_blocks ClearMarginsConfig.least SurveyConfig.max_stretch
    RefineConfig.working_px RefineConfig.rule_width RefineConfig.sheet_prior_px
    FilmSizeConfig.max_side_px FilmSizeConfig.min_side_px FilmSizeConfig.max_aspect
    CoverConfig.side_px DeilluminateConfig.work_px DeilluminateConfig.gain_blur UprightConfig.min_slice_px
    FuseConfig.patch_px FuseConfig.intervals MergeConfig.outlier
"""
"""Options that are divided by, or of which there must be some: they may not be 0, nor may any value of a tuple."""

SHARES = """
    RectifyConfig.hopeless SurveyConfig.min_mask_share SurveyConfig.min_inlier_share SurveyConfig.min_coverage
    SurveyConfig.min_overlap PredictConfig.margin EdgeConfig.doubtful EdgeConfig.surer EdgeConfig.sure
    ClearMarginsConfig.noticed ClearMarginsConfig.least ClearMarginsConfig.likely
    ForeshorteningConfig.least_slope ForeshorteningConfig.least_length
    OutlineConfig.min_share OutlineConfig.clipped_share SheetConfig.firm
    GridConfig.share GridConfig.lone_share GridConfig.believed_share GridConfig.sure_share GridConfig.coverage
    RepeatConfig.octave_ratio MatchConfig.window_share MatchConfig.min_match CellsConfig.least_filled
    CongealConfig.min_gain CongealConfig.min_correlation RefineConfig.counts
    UprightConfig.turned UprightConfig.mirrored CoverConfig.least_chance
    DeilluminateConfig.print_black DeilluminateConfig.print_white DeilluminateConfig.least_print
    TrustConfig.least_chance TrustConfig.min_support TrustConfig.least_support TrustConfig.min_overlap
    TrustConfig.min_in_step TrustConfig.min_alike
"""
"""Shares, probabilities and correlations that may not be above 1. Others may, which means never: the benchmark leaves
stages out with PathConfig.min_mass and RepeatConfig.min_correlation, and tests try it with ClearMarginsConfig.sure and
least_support."""


def named(names: tuple[str, ...]) -> str:
    """The name of the option in messages."""
    return f"{type(reduce(getattr, names[:-1], RectifyConfig())).__name__}.{names[-1]}"


def zeros(value: Any) -> list[Any]:
    """The option set to 0; of a tuple, each value in turn."""
    if not isinstance(value, tuple):
        return [type(value)(0)]
    return [(*value[:k], type(each)(0), *value[k + 1 :]) for k, each in enumerate(value)]


def test_what_divides_is_not_zero() -> None:
    options, asked = set(DIVIDES.split()), set()
    for names, value in every_number(RectifyConfig()):
        if named(names) in options:
            asked.add(named(names))
            for zero in zeros(value):
                with pytest.raises(ConfigError, match=rf"{named(names)}: got .*; allowed: >= "):
                    with_option(RectifyConfig(), names, zero)
    assert asked == options


def test_no_share_is_above_one() -> None:
    options, asked = set(SHARES.split()), set()
    for names, value in every_number(RectifyConfig()):
        if named(names) in options:
            asked.add(named(names))
            with pytest.raises(ConfigError, match=rf"{named(names)}: got 1\.5; allowed: <= "):
                with_option(RectifyConfig(), names, type(value)(1.5))
    assert asked == options


@pytest.mark.parametrize(
    "config",
    [
        lambda: PredictConfig(sides=(0, 9)),
        lambda: PathConfig(floor=0.5),
        lambda: PlaneConfig(min_parts=9),
        lambda: DeilluminateConfig(print_black=1.5, print_white=1.6),
    ],
)
def test_what_is_more_than_there_is_is_refused(config: Callable[[], Any]) -> None:
    with pytest.raises(ConfigError, match=r"got .*; allowed: <= "):
        config()


@dataclass(frozen=True)
class Anything:
    """Like a stage's options, but typed as Any, since type checks in tests come before the options' own checks."""

    count: Any = 1
    share: Any = 0.5
    whether: Any = True
    sides: Any = (0, 2)
    bend: Any = (0.1, 3)

    def __post_init__(self) -> None:
        require_at_least(self, 0, "count", "share", "sides")


@pytest.mark.parametrize(
    ("options", "allowed"),
    [
        ({"count": "2"}, ">= 0"),
        ({"count": None}, ">= 0"),
        ({"count": 1.5}, "a whole number"),
        ({"share": "a half"}, ">= 0"),
        ({"whether": "no"}, "True or False"),
        ({"sides": [0, 2]}, ">= 0"),
        ({"sides": (0.5, 2.0)}, "a tuple of whole numbers"),
        ({"bend": (0.1, 2.5)}, "a tuple of numbers"),
        ({"bend": 3.0}, "a tuple of numbers"),
    ],
)
def test_something_else_than_such_a_number_is_refused(options: dict, allowed: str) -> None:
    require_numbers(Anything(np.int64(2), np.float32(0.25), False, (1, 2, 3), (1, 2)))
    (name,) = options
    with pytest.raises(ConfigError, match=rf"Anything\.{name}: got .*; allowed: {allowed}"):
        require_numbers(Anything(**options))


@dataclass(frozen=True)
class Nested:
    """Like RectifyConfig, but typed as Any, since type checks in tests come before its own checks."""

    trust: Any = field(default_factory=TrustConfig)


@pytest.mark.parametrize("given", [{"limit_px": 5.0}, None, 5.0, RefineConfig()])
def test_something_else_than_the_options_of_a_stage_is_refused(given: Any) -> None:
    require_numbers(Nested())
    with pytest.raises(ConfigError, match=r"Nested\.trust: got .*; allowed: a TrustConfig"):
        require_numbers(Nested(given))


@pytest.mark.parametrize("options", [{"passes": 0}, {"held_out": -1}, {"batch": 0}, {"ema": 2.0}, {"loaders": -1}])
def test_a_training_that_cannot_be_is_refused(options: dict) -> None:
    with pytest.raises(ConfigError, match=f"--{next(iter(options)).replace('_', '-')}: got "):
        Plan.of(TrainConfig((Path("data"),), Path("out"), **options))


def test_the_command_line_says_which(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(["rectify", "a.jpg", "--size.max-side-px", "0"])
    assert stopped.value.code == 2
    told = "hybrid rectify: --size.max-side-px: got 0; allowed: >= 64. Choose another.\n"
    assert capsys.readouterr().err == told
