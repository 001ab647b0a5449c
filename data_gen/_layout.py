"""Where the cells of a print lie: grid, cell aspect, gutters, margins, film formats; whole pixels throughout."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

GRIDS = (
    ((4, 4), 0.18), ((6, 4), 0.18), ((5, 4), 0.12), ((4, 5), 0.10), ((3, 4), 0.10), ((3, 3), 0.04), ((6, 5), 0.06),
    ((5, 5), 0.04), ((4, 3), 0.06), ((5, 3), 0.04), ((4, 6), 0.04), ((8, 5), 0.04),
)  # fmt: skip
"""(rows, cols) and how often."""

FORMATS_MM = ((430.0, 350.0), (350.0, 280.0), (300.0, 250.0))
STYLES = ("none", "rules", "gutter")


@dataclass(frozen=True)
class Layout:
    """The frame of a print in pixels.

    pitch_px: (down, across) from cell to cell. gap_px: even, between neighbouring cells, half of it outside the
    outermost. margins_px: (top, right, bottom, left) outside the grid, the header in the top one.
    rule_px: thickness of rules or boxes. boxes: a rule around each cell instead of between them.
    outer_rules: rules also along the grid's border.
    """

    rows: int
    cols: int
    pitch_px: tuple[int, int]
    gap_px: int
    margins_px: tuple[int, ...]
    header_px: int
    style: str
    rule_px: int
    boxes: bool
    outer_rules: bool
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


def random_layout(
    rng: np.random.Generator,
    longer_px: int,
    spread: float,
    style_weights: tuple[float, float, float],
    margin_share: float,
    header_share: float,
) -> Layout:
    """A random frame whose longer side is about ``longer_px``."""
    weights = np.array([w for _, w in GRIDS])
    rows, cols = GRIDS[rng.choice(len(GRIDS), p=weights / weights.sum())][0]
    style = STYLES[rng.choice(3, p=np.array(style_weights) / sum(style_weights))]
    target = longer_px * rng.uniform(1 - spread, 1 + spread)
    margins = _random_margins(rng, margin_share) * target
    header = int(rng.uniform(0.02, 0.05) * target) if rng.random() < header_share else 0
    margins[0] += header
    aspect = float(np.exp(np.clip(rng.normal(0, 0.1), -0.2, 0.2))) if rng.random() < 0.4 else 1.0
    long_mm = float(rng.choice([430.0, 430.0, 350.0, 300.0]) * rng.uniform(0.9, 1.0))
    if rng.random() < 0.3:
        long_mm, short_mm = FORMATS_MM[rng.integers(len(FORMATS_MM))]
        aspect = _fitted_aspect(rows, cols, short_mm / long_mm, margins / target)
    high = rows * aspect + (margins[0] + margins[2]) * max(rows * aspect, cols) / target
    wide = cols + (margins[1] + margins[3]) * max(rows * aspect, cols) / target
    pitch_x = target / max(high, wide)
    pitch = (max(8, round(pitch_x * aspect)), max(8, round(pitch_x)))
    gap_share = float(np.exp(rng.uniform(np.log(0.003), np.log(0.03)))) if style == "gutter" else 0.0
    boxes = style == "rules" and rng.random() < 0.3
    gap = 2 * max(1, round(gap_share * pitch[1] / 2)) if style == "gutter" else 0
    if boxes:
        gap = 2 * int(rng.integers(0, 5))
    rule = int(rng.integers(1, 5)) if style == "rules" else 0
    layout = Layout(
        rows, cols, pitch, gap, tuple(int(m) for m in margins), header, style, rule, bool(boxes),
        bool(rng.random() < 0.5), (0.0, 0.0),
    )  # fmt: skip
    return _with_size(layout, long_mm)


def _with_size(layout: Layout, long_mm: float) -> Layout:
    height, width = layout.shape
    mm_per_px = long_mm / max(height, width)
    fields = {**vars(layout), "size_mm": (height * mm_per_px, width * mm_per_px)}
    return Layout(**fields)


def _random_margins(rng: np.random.Generator, share: float) -> Float[np.ndarray, " 4"]:
    """(top, right, bottom, left) as shares of the longer side: usually none, else all alike or each its own."""
    if rng.random() >= share:
        return np.zeros(4)
    if rng.random() < 0.6:
        return np.full(4, rng.uniform(0.003, 0.05))
    return rng.uniform(0.0, 0.05, 4)


def _fitted_aspect(rows: int, cols: int, short: float, margins: Float[np.ndarray, " 4"]) -> float:
    """Height by width of a cell so that the grid fills a film of ``short`` to 1, turned whichever way is squarer."""
    across, down = margins[1] + margins[3], margins[0] + margins[2]
    portrait = (1.0 - down) / rows / ((short - across) / cols)
    landscape = (short - down) / rows / ((1.0 - across) / cols)
    return float(min(portrait, landscape, key=lambda aspect: abs(np.log(aspect))))
