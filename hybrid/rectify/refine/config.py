"""The options of the refinement of a coarse map."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

from hybrid.errors import require_at_least, require_at_most
from hybrid.rectify.edges.outline import OutlineConfig
from hybrid.rectify.grid.borders import BorderConfig
from hybrid.rectify.grid.cells import CellsConfig
from hybrid.rectify.grid.congeal import CongealConfig
from hybrid.rectify.grid.lines import GridConfig
from hybrid.rectify.grid.match import MatchConfig
from hybrid.rectify.grid.repeat import RepeatConfig
from hybrid.rectify.grid.rim import RimConfig
from hybrid.rectify.margins.placing import MarginsConfig
from hybrid.rectify.sheet.shape import SheetConfig
from hybrid.rectify.splines.displacement import SplineConfig


@dataclass(frozen=True)
class RefineConfig:
    """Options of the refinement of a coarse map."""

    outline: OutlineConfig = field(default_factory=OutlineConfig)
    sheet: SheetConfig = field(default_factory=SheetConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    repeat: RepeatConfig = field(default_factory=RepeatConfig)
    match: MatchConfig = field(default_factory=MatchConfig)
    cells: CellsConfig = field(default_factory=CellsConfig)
    borders: BorderConfig = field(default_factory=BorderConfig)
    margins: MarginsConfig = field(default_factory=MarginsConfig)
    congeal: CongealConfig = field(default_factory=CongealConfig)
    rim: RimConfig = field(default_factory=RimConfig)
    spline: SplineConfig = field(default_factory=partial(SplineConfig, reweightings=4))
    """Options of the displacement: with edges alone (edges/paths.py) it takes one more reweighting to settle."""
    working_px: int = 1000
    """Longer side of the film, in pixels, in the copy of the photo that is looked at; no photo is enlarged."""
    near_band: float = 0.015
    """Half width of the search band for edges once the map has been improved, in film units."""
    rule_width: float = 0.002
    """How far a rule printed on the film's edge may shift the edge that is seen, in film units."""
    settled_move: float = 3e-3
    """A round that moves the film by less than this is the last, in film units."""
    settled_sheet: float = 1e-3
    """The same for the rounds from an unstretched sheet."""
    settled_end: float = 5e-4
    """No further sheet is fitted after one that moved the film by less than this from where the one before left it: the
    mean move, in parts of the film."""
    settled_margins: float = 2.5e-4
    """Once a sheet has settled, other margins that move the film by less than this do not count."""
    matched: bool = True
    """Whether the cells are first matched to their mean, in a round of its own that reaches farther, before they are
    registered."""
    line_rounds: int = 2
    """Rounds in which lines are looked for where they have not been found: they show better in a straighter view."""
    max_move: float = 0.08
    """Largest displacement believed, in film units."""
    min_gain: float = 0.9
    """Without a sheet the spline counts only if held-out sightings disagree with it by less than this fraction of their
    disagreement before."""
    counts: float = 0.3
    """Sightings with a larger robust weight than this are used to fit the sheet."""
    sheet_prior_px: float = 5.0
    """As SplineConfig.prior_px, for the displacement of the sheet's map."""
    sheet_rounds: int = 3
    """Most rounds from the unstretched sheet that best explains what the last round saw; 0: no sheet is fitted."""
    sheet_doubt: float = 1.1
    """The result with an unstretched sheet may be this many times as doubtful as the one bent freely
    (refine/refine.py)."""
    usual_doubt: float = 1.05
    """A sheet with usual margins that explained less well what was seen, before it was seen through that sheet, may in
    the end be this many times as doubtful as the one without (refine/refine.py)."""
    least_likeness: float = 0.05
    """Added to how alike the cells look where the two results are weighed by that: perhaps neither has cells."""
    max_residual: float = 2.5
    """Where held-out sightings disagree with the spline by more than this, in their stated deviations, some of them are
    wrong in the same way, as where cells were mistaken for their neighbours: the map is not believed."""

    def __post_init__(self) -> None:
        require_at_least(self, 64, "working_px")
        require_at_least(self, 1e-3, "sheet_prior_px")
        require_at_least(self, 1e-6, "rule_width")
        require_at_most(self, 1, "counts")

    @property
    def outline_again(self) -> OutlineConfig:
        """Options of the search for edges once the map has been improved."""
        return replace(self.outline, band=self.near_band)

    @property
    def edges_held(self) -> RefineConfig:
        """The same, with the sheet's edges held to where they were read (edges/paths.py)."""
        return replace(self, outline=self.outline.held)

    @property
    def print_free(self) -> RefineConfig:
        """The same, but no print is taken to end at the sheet's edges, so that it moves none of them."""
        return replace(self, grid=replace(self.grid, snug=0.0, beyond=0.0))
