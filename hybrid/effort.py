"""The options of all stages, and how much work a photo is worth."""

from __future__ import annotations

from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import Literal

from hybrid.errors import ConfigError, describe, require_at_most, require_numbers
from hybrid.learn.reading.orientation import UprightConfig
from hybrid.learn.reading.predict import PredictConfig
from hybrid.rectify.coarse.foreshortening import ForeshorteningConfig
from hybrid.rectify.coarse.invert import InvertConfig
from hybrid.rectify.edges.paths import EdgeConfig
from hybrid.rectify.film.cover import CoverConfig
from hybrid.rectify.film.deilluminate import DeilluminateConfig
from hybrid.rectify.film.resample import ResampleConfig
from hybrid.rectify.film.size import FilmSizeConfig
from hybrid.rectify.fusion.register import FuseConfig
from hybrid.rectify.margins.clear import ClearMarginsConfig
from hybrid.rectify.margins.ground import FalseMarginsConfig
from hybrid.rectify.refine.config import RefineConfig
from hybrid.rectify.refine.plane import PlaneConfig
from hybrid.rectify.sheet.shape import SheetConfig
from hybrid.rectify.verdict.nearness import NearnessConfig
from hybrid.rectify.verdict.survey import SurveyConfig
from hybrid.rectify.verdict.trust import ErrorConfig, TrustConfig

Effort = Literal["fast", "default", "thorough"]
"""How much work a photo is worth; RectifyConfig.of says what each of them does."""


@dataclass(frozen=True)
class RectifyConfig:
    """How photos are rectified. Every stage has its own options; ``of`` sets those that affect the running time."""

    weights: Path | None = None
    """A FilmNet file made by ``hybrid train``; None for the packaged one."""
    survey: SurveyConfig = field(default_factory=SurveyConfig)
    predict: PredictConfig = field(default_factory=PredictConfig)
    invert: InvertConfig = field(default_factory=InvertConfig)
    edges: EdgeConfig = field(default_factory=EdgeConfig)
    margins: ClearMarginsConfig = field(default_factory=ClearMarginsConfig)
    false_margins: FalseMarginsConfig = field(default_factory=FalseMarginsConfig)
    told_cells: bool = True
    """Whether a map starts from the cells as the network sees them; otherwise they are found from the print alone."""
    foreshortening: ForeshorteningConfig = field(default_factory=ForeshorteningConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    plane: PlaneConfig = field(default_factory=PlaneConfig)
    tries: int = 4
    """How many more times a film is refined at most while it is in doubt: from where the first refinement ended, then
    from elsewhere (pipeline/starts.py). The result that is likely nearest to the truth counts."""
    enough: float = 0.7
    """A film is not refined from elsewhere once its map is right with this probability."""
    nearness: NearnessConfig = field(default_factory=NearnessConfig)
    """Which of the results counts."""
    hopeless: float = 0.03
    """Least probability that the map is right: below it, refining a film again would not help and is not tried."""
    size: FilmSizeConfig = field(default_factory=FilmSizeConfig)
    resample: ResampleConfig = field(default_factory=ResampleConfig)
    upright: UprightConfig = field(default_factory=UprightConfig)
    cover: CoverConfig = field(default_factory=CoverConfig)
    light: DeilluminateConfig = field(default_factory=DeilluminateConfig)
    trust: TrustConfig = field(default_factory=TrustConfig)
    fuse: FuseConfig = field(default_factory=FuseConfig)

    def __post_init__(self) -> None:
        require_numbers(self)
        require_at_most(self, 1, "enough", "hopeless")

    @staticmethod
    def of(effort: Effort | str) -> RectifyConfig:
        """The options of an effort.

        fast: the network's map, refined in two rounds and by one unstretched sheet, which is fitted once; the photo is
        read bilinearly. default: the options' own values. Sheets that do not explain what is seen are also tried bent
        the other way round, and up to three sheets are fitted one after the other; a film still in doubt is refined
        once more from where that ended and, unless its map is then rather sure to be right, from elsewhere.
        thorough: a film is refined from elsewhere as long as there is any doubt.

        Raises:
            ConfigError: there is no such effort.
        """
        efforts = {
            "fast": RectifyConfig(
                tries=0,
                refine=RefineConfig(matched=False, sheet_rounds=1, sheet=SheetConfig(doubtful=float("inf"))),
                resample=ResampleConfig(cubic_below=0.0),
                trust=TrustConfig(error=ErrorConfig(constant=ErrorConfig.constant + 0.26)),  # 1.3 times as much
            ),
            "default": RectifyConfig(),
            "thorough": RectifyConfig(tries=8, enough=1.0),
        }
        if not isinstance(effort, str) or effort not in efforts:
            got = repr(effort) if isinstance(effort, str) else f"a {type(effort).__name__}"
            do = "For options of your own: Rectifier(config)(photo)." if is_dataclass(effort) else "Name one of them."
            raise ConfigError(describe(what="Effort", got=got, allowed=", ".join(efforts), do=do))
        return efforts[effort]
