"""Options that cannot be are refused when they are given, by name, before any photo is touched."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any

import pytest

from hybrid import cli
from hybrid.effort import RectifyConfig
from hybrid.errors import ConfigError, FittedWeights, require_numbers
from hybrid.learn.predict import PredictConfig
from hybrid.learn.train import Plan, TrainConfig
from hybrid.rectify.cells import CellsConfig
from hybrid.rectify.congeal import CongealConfig
from hybrid.rectify.course import RefineConfig
from hybrid.rectify.deilluminate import DeilluminateConfig
from hybrid.rectify.film_size import FilmSizeConfig
from hybrid.rectify.foreshortening import ForeshorteningConfig
from hybrid.rectify.fuse import FuseConfig
from hybrid.rectify.grid import GridConfig
from hybrid.rectify.invert import InvertConfig
from hybrid.rectify.match import MatchConfig
from hybrid.rectify.outline import OutlineConfig
from hybrid.rectify.sheet import SheetConfig
from hybrid.rectify.sightings import SplineConfig
from hybrid.rectify.trust import TrustConfig

NAN = float("nan")


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (FilmSizeConfig, {"max_side_px": 0}),
        (FilmSizeConfig, {"max_aspect": float("nan")}),
        (DeilluminateConfig, {"work_px": 8}),
        (PredictConfig, {"sides": ()}),
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
    """The names and the value of each option that is a number or a tuple of them, in a record and in those within."""
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
    """Whichever option of whichever stage it is; weights of a sum, and what is usually below zero, may be."""
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


@dataclass(frozen=True)
class Nested:
    """As RectifyConfig, whose own types are checked in tests before it can look itself."""

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
