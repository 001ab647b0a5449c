"""Options that cannot be are refused when they are given, by name, before any photo is touched."""

from __future__ import annotations

from pathlib import Path

import pytest

from hybrid import cli
from hybrid.effort import RectifyConfig
from hybrid.errors import ConfigError
from hybrid.learn.predict import PredictConfig
from hybrid.learn.train import Plan, TrainConfig
from hybrid.rectify.congeal import CongealConfig
from hybrid.rectify.course import RefineConfig
from hybrid.rectify.deilluminate import DeilluminateConfig
from hybrid.rectify.film_size import FilmSizeConfig
from hybrid.rectify.foreshortening import ForeshorteningConfig
from hybrid.rectify.fuse import FuseConfig
from hybrid.rectify.grid import GridConfig
from hybrid.rectify.invert import InvertConfig
from hybrid.rectify.outline import OutlineConfig
from hybrid.rectify.sheet import SheetConfig
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
    ],
)
def test_an_option_that_cannot_be_is_refused(kind: type, options: dict) -> None:
    (name,) = options
    with pytest.raises(ConfigError, match=f"{kind.__name__}.{name}: got .*; allowed: >= "):
        kind(**options)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"again_above": NAN}, "RectifyConfig.again_above"),
        ({"trust": TrustConfig(safety=NAN)}, "TrustConfig.safety"),
        ({"refine": RefineConfig(sheet=SheetConfig(settled=NAN))}, "SheetConfig.settled"),
    ],
)
def test_what_is_not_a_number_is_refused_wherever_it_stands(options: dict, name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name}: got nan; allowed: numbers"):
        RectifyConfig(**options)


@pytest.mark.parametrize("options", [{"passes": 0}, {"held_out": -1}, {"batch": 0}, {"ema": 2.0}, {"loaders": -1}])
def test_a_training_that_cannot_be_is_refused(options: dict) -> None:
    with pytest.raises(ConfigError, match=f"--{next(iter(options)).replace('_', '-')}: got "):
        Plan.of(TrainConfig((Path("data"),), Path("out"), **options))


def test_the_command_line_says_which(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["rectify", "a.jpg", "--size.max-side-px", "0"]) == 1
    assert capsys.readouterr().err == "hybrid: FilmSizeConfig.max_side_px: got 0; allowed: >= 64. Choose another.\n"
