"""Where the cells of a print lie: grid, cell aspect, gutters, margins, film formats; whole pixels throughout."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hybrid.errors import ConfigError, describe

GRIDS = (
    ((4, 4), 0.14), ((6, 4), 0.14), ((5, 4), 0.11), ((4, 5), 0.09), ((3, 4), 0.07), ((4, 3), 0.06), ((6, 5), 0.06),
    ((5, 5), 0.04), ((3, 3), 0.04), ((4, 6), 0.04), ((5, 3), 0.03), ((3, 5), 0.03), ((8, 5), 0.03), ((5, 6), 0.02),
    ((7, 5), 0.02), ((5, 7), 0.01), ((6, 6), 0.02), ((7, 6), 0.02), ((8, 6), 0.02), ((6, 8), 0.01), ((4, 7), 0.01),
    ((6, 3), 0.01), ((3, 6), 0.01), ((3, 2), 0.01), ((2, 3), 0.01), ((2, 2), 0.02), ((9, 7), 0.01),
    ((4, 2), 0.01), ((2, 4), 0.006), ((1, 2), 0.006), ((2, 1), 0.006),
)  # fmt: skip
"""(rows, cols) and their frequency."""

FORMATS_MM = {
    "35 x 43 cm": ((430.0, 350.0), 0.35), "14 x 17 in": ((431.8, 355.6), 0.3), "11 x 14 in": ((355.6, 279.4), 0.12),
    "10 x 12 in": ((304.8, 254.0), 0.1), "8 x 10 in": ((254.0, 203.2), 0.08), "28 x 35 cm": ((350.0, 280.0), 0.05),
}  # fmt: skip
"""Sides of film formats, the longer first, and their frequency."""

HEADER_RANGE = 0.02, 0.12
"""Heights of header strips as shares of the film's longer side; half of them are below the geometric mean."""

LEAST_MARGIN, MOST_MARGIN = 0.003, 0.1
"""Margins that are asked for, as shares of the film's longer side; cells in its middle may leave wider ones."""

PLACINGS = ("free", "fitted", "centred")
"""A sheet as large as its square (or nearly square) cells need; a sheet of a film format, its cells stretched to fill
it; a sheet of a film format, with square cells in its middle."""

STYLES = ("none", "rules", "gutter")


@dataclass(frozen=True)
class PrintConfig:
    """How prints are made.

    longer_px: the longer side in pixels, before a variation of +- ``longer_spread`` (a share).
    style_weights: chances of cells with nothing between them, with rules, with gutters.
    placing_weights: chances of PLACINGS.
    margin_share, text_share, header_share, empty_share: chances of margins, of texts, of a header strip, and of empty
        cells at the end.
    footer_share, label_share: chances that a header strip stands below the cells, and that it is bright and its writing
        dark, as on a label.
    clear_share, frame_share: chances, where there are margins, that these are bare film, bright as the print's white
        (DICOM calls them borders of white density), and that a line is drawn through them around the grid.
    bright_gap_share: chance that gutters are bright.
    scout_share, windows_share, marks_share: chances of a scout view in the first cell, of several windows on one film,
        and of wedges and crosses in the cells.
    """

    longer_px: int = 1792
    longer_spread: float = 0.14
    style_weights: tuple[float, float, float] = (0.34, 0.36, 0.30)
    placing_weights: tuple[float, float, float] = (0.45, 0.33, 0.22)
    margin_share: float = 0.35
    text_share: float = 0.94
    header_share: float = 0.15
    footer_share: float = 0.25
    label_share: float = 0.4
    empty_share: float = 0.12
    scout_share: float = 0.1
    windows_share: float = 0.15
    marks_share: float = 0.2
    clear_share: float = 0.3
    frame_share: float = 0.2
    bright_gap_share: float = 0.12

    def __post_init__(self) -> None:
        if self.longer_px < 128 or not 0 <= self.longer_spread < 1:
            got = f"longer_px={self.longer_px}, longer_spread={self.longer_spread}"
            allowed = "longer_px >= 128, longer_spread in [0, 1)"
            raise ConfigError(describe(what="PrintConfig", got=got, allowed=allowed, do="Change the print size"))
        for name in ("style_weights", "placing_weights"):
            weights = getattr(self, name)
            if min(weights) < 0 or sum(weights) <= 0:
                what = f"PrintConfig.{name}"
                raise ConfigError(describe(what=what, got=weights, allowed=">= 0, not all 0", do="Set one"))


@dataclass(frozen=True)
class Layout:
    """The frame of a print in pixels.

    pitch_px: (down, across) from cell to cell. gap_px: even, between neighbouring cells, half of it outside the
    outermost. margins_px: (top, right, bottom, left) outside the grid. header_px: height of a strip in the top margin;
    footer: in the bottom one.
    rule_px: thickness of rules or boxes. boxes: a rule around each cell instead of between them.
    outer_rules: rules also along the grid's border. frame_px: thickness of a line around the grid, in the margins; 0
    for none. frame_at: its place, as a share of the way from the sheet's edges to the grid. film: name of its format,
    or free.
    """

    rows: int
    cols: int
    pitch_px: tuple[int, int]
    gap_px: int
    margins_px: tuple[int, ...]
    header_px: int
    footer: bool
    style: str
    rule_px: int
    boxes: bool
    outer_rules: bool
    frame_px: int
    frame_at: float
    film: str
    size_mm: tuple[float, float]

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the print."""
        top, right, bottom, left = self.margins_px
        return self.rows * self.pitch_px[0] + top + bottom, self.cols * self.pitch_px[1] + left + right

    @property
    def cell_px(self) -> tuple[int, int]:
        """(height, width) of one cell without the gaps."""
        return self.pitch_px[0] - self.gap_px, self.pitch_px[1] - self.gap_px

    def cell(self, k: int) -> tuple[int, int, int, int]:
        """(x, y, width, height) of cell ``k``, counted row by row."""
        row, col = divmod(k, self.cols)
        x = self.margins_px[3] + col * self.pitch_px[1] + self.gap_px // 2
        y = self.margins_px[0] + row * self.pitch_px[0] + self.gap_px // 2
        return x, y, self.cell_px[1], self.cell_px[0]

    def lines_px(self) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " r"]]:
        """x of the cols + 1 vertical and y of the rows + 1 horizontal lines of the grid."""
        xs = self.margins_px[3] + self.pitch_px[1] * np.arange(self.cols + 1, dtype=np.float64)
        ys = self.margins_px[0] + self.pitch_px[0] * np.arange(self.rows + 1, dtype=np.float64)
        return xs, ys

    def vertices_px(self) -> Float[np.ndarray, "r c 2"]:
        """(x, y) of the corners of the cells."""
        x, y = np.meshgrid(*self.lines_px())
        return np.stack([x, y], axis=-1)


def coverage(centre: float, thickness: float | int, length: int) -> tuple[int, Float[np.ndarray, " n"]]:
    """First pixel, and the share of it and the following ones, that a bar around ``centre`` covers on [0, length]."""
    low, high = max(centre - thickness / 2, 0.0), min(centre + thickness / 2, float(length))
    first, last = int(np.floor(low)), int(np.ceil(high))
    edges = np.clip(np.arange(first, last + 1), low, high)
    return first, np.diff(edges).astype(np.float32)


def random_layout(rng: np.random.Generator, config: PrintConfig) -> Layout:
    """A random frame whose longer side is about ``config.longer_px``."""
    weights = np.array([w for _, w in GRIDS])
    rows, cols = GRIDS[rng.choice(len(GRIDS), p=weights / weights.sum())][0]
    style = STYLES[rng.choice(3, p=np.array(config.style_weights) / sum(config.style_weights))]
    target = config.longer_px * rng.uniform(1 - config.longer_spread, 1 + config.longer_spread)
    header = float(np.exp(rng.uniform(*np.log(HEADER_RANGE)))) if rng.random() < config.header_share else 0.0
    margins = _random_margins(rng, config.margin_share)
    footer = bool(header and rng.random() < config.footer_share)
    margins[2 if footer else 0] += header
    placing = PLACINGS[rng.choice(3, p=np.array(config.placing_weights) / sum(config.placing_weights))]
    film, (long_mm, short_mm) = _random_format(rng)
    if placing == "free":
        aspect = float(np.exp(np.clip(rng.normal(0, 0.1), -0.2, 0.2))) if rng.random() < 0.4 else 1.0
        film, long_mm = "free", long_mm * rng.uniform(0.9, 1.0)
        pitch, margins = _square_pitch((rows, cols), (1.0, 1.0), margins, aspect), margins
    elif placing == "fitted":
        pitch = _fitted_pitch((rows, cols), short_mm / long_mm, margins)
    else:
        pitch, margins = _centred_pitch((rows, cols), short_mm / long_mm, margins)
    pitch_px = (max(8, round(pitch[0] * target)), max(8, round(pitch[1] * target)))
    boxes = style == "rules" and rng.random() < 0.3
    gap = 2 * int(rng.integers(0, 5)) if boxes else 0
    if style == "gutter":
        gap = 2 * max(1, round(float(np.exp(rng.uniform(np.log(0.003), np.log(0.03)))) * pitch_px[1] / 2))
    rule = int(rng.integers(1, 5)) if style == "rules" else 0
    frame, framed = int(rng.integers(1, 5)), rng.random() < config.frame_share and margins.min() > 0
    layout = Layout(
        rows, cols, pitch_px, gap, tuple(int(m * target) for m in margins), int(header * target), footer, style,
        rule, bool(boxes), bool(rng.random() < 0.5), frame if framed else 0, float(rng.uniform(0.1, 0.9)), film,
        (0.0, 0.0),
    )  # fmt: skip
    mm_per_px = long_mm / max(layout.shape)
    return replace(layout, size_mm=(layout.shape[0] * mm_per_px, layout.shape[1] * mm_per_px))


def _random_format(rng: np.random.Generator) -> tuple[str, tuple[float, float]]:
    weights = np.array([weight for _, weight in FORMATS_MM.values()])
    name = list(FORMATS_MM)[rng.choice(len(weights), p=weights / weights.sum())]
    return name, FORMATS_MM[name][0]


def _random_margins(rng: np.random.Generator, share: float) -> Float[np.ndarray, " 4"]:
    """(top, right, bottom, left) as shares of the longer side: usually none, else all equal or each different; half of
    them are below a quarter of the widest."""
    if rng.random() >= share:
        return np.zeros(4)
    drawn = np.full(4, rng.random()) if rng.random() < 0.6 else rng.random(4)
    return np.maximum(LEAST_MARGIN, MOST_MARGIN * drawn**2)


# Below, lengths are shares of the sheet's longer side; a sheet is (height, width), a pitch (down, across).


def _square_pitch(
    grid: tuple[int, int], sheet: tuple[float, float], margins: Float[np.ndarray, " 4"], aspect: float
) -> tuple[float, float]:
    """The largest cells of height by width ``aspect`` that fit on the sheet."""
    down, across = sheet[0] - margins[0] - margins[2], sheet[1] - margins[1] - margins[3]
    pitch = float(min(down / (grid[0] * aspect), across / grid[1]))
    return aspect * pitch, pitch


def _fitted_pitch(grid: tuple[int, int], short: float, margins: Float[np.ndarray, " 4"]) -> tuple[float, float]:
    """Cells that fill a sheet of ``short`` to 1, in the orientation that makes them squarer."""
    pitches = []
    for sheet in ((1.0, short), (short, 1.0)):
        down, across = sheet[0] - margins[0] - margins[2], sheet[1] - margins[1] - margins[3]
        pitches.append((float(down / grid[0]), float(across / grid[1])))
    return min(pitches, key=lambda pitch: abs(np.log(pitch[0] / pitch[1])))


def _centred_pitch(
    grid: tuple[int, int], short: float, margins: Float[np.ndarray, " 4"]
) -> tuple[tuple[float, float], Float[np.ndarray, " 4"]]:
    """Square cells in the middle of a sheet, in the orientation that makes them larger, and the remaining margins."""
    sheets = ((1.0, short), (short, 1.0))
    sheet = max(sheets, key=lambda sheet: _square_pitch(grid, sheet, margins, 1.0)[0])
    pitch = _square_pitch(grid, sheet, margins, 1.0)
    spare = np.array([sheet[0] - grid[0] * pitch[0] - margins[0] - margins[2],
                      sheet[1] - grid[1] * pitch[1] - margins[1] - margins[3]])  # fmt: skip
    return pitch, margins + 0.5 * spare[[0, 1, 0, 1]]
