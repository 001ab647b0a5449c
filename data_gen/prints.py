"""Typesets CT slices into the flat print of a film: grids, windows, rules, gutters, texts of many makers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from data_gen._labels import Labels, draw_labels, random_labels
from data_gen._layout import Layout, coverage, random_layout
from data_gen._typeset import Font, stamp, text_sprite
from data_gen.volumes import CtVolume, is_body
from hybrid.coords import film_from_pixel
from hybrid.errors import ConfigError, describe

HEAD_WINDOWS = ((35.0, 85.0, 0.5), (40.0, 200.0, 0.15), (40.0, 380.0, 0.1), (550.0, 2600.0, 0.25))
BODY_WINDOWS = ((40.0, 380.0, 0.45), (50.0, 250.0, 0.15), (-550.0, 1500.0, 0.25), (450.0, 2000.0, 0.15))
"""(level, width, share): brain, wide brain, soft tissue, bone; mediastinum, liver, lung, bone."""

PAPER_MARGIN = 0.1
"""The paper drops this share of the slices at the top and at the bottom of a scan."""

OUTSIDE_HU = -3000.0
"""Fills a cell beyond the scanned field: black in every window."""


@dataclass(frozen=True)
class PrintConfig:
    """How prints are made.

    longer_px: the longer side in pixels, before a variation of +- ``longer_spread`` (a share).
    style_weights: chances of cells with nothing between them, with rules, with gutters.
    margin_share, text_share, header_share, empty_share: chances of margins, of texts, of a header strip, and of empty
        cells at the end.
    """

    longer_px: int = 1792
    longer_spread: float = 0.14
    style_weights: tuple[float, float, float] = (0.34, 0.36, 0.30)
    margin_share: float = 0.4
    text_share: float = 0.94
    header_share: float = 0.1
    empty_share: float = 0.12

    def __post_init__(self) -> None:
        if self.longer_px < 128 or not 0 <= self.longer_spread < 1:
            got = f"longer_px={self.longer_px}, longer_spread={self.longer_spread}"
            allowed = "longer_px >= 128, longer_spread in [0, 1)"
            raise ConfigError(describe(what="PrintConfig", got=got, allowed=allowed, do="Change the print size"))
        if min(self.style_weights) < 0 or sum(self.style_weights) <= 0:
            raise ConfigError(
                describe(
                    what="PrintConfig.style_weights", got=self.style_weights, allowed=">= 0, not all 0", do="Set one"
                )
            )


@dataclass(frozen=True, eq=False)
class FilmPrint:
    """A flat print, the truth that a photo is taken of.

    image: (h, w) float32 display grey in [0, 1].
    size_mm: (height, width) of the sheet.
    rows, cols: slices down and across.
    vertices: (rows + 1, cols + 1, 2) film uv of the corners of the cells: the lines half way between neighbouring
        cells, at equal distances, and the outer borders of the grid, half a gap outside the outermost cells.
    style: none, rules or gutter.
    parameters: what was drawn, as plain JSON values.
    """

    image: Float[np.ndarray, "h w"]
    size_mm: tuple[float, float]
    rows: int
    cols: int
    vertices: Float[np.ndarray, "r c 2"]
    style: str
    parameters: dict[str, Any]


@dataclass(frozen=True)
class _Look:
    """Greys of a print, its window, how slices are chosen and placed.

    fill: share of the cell that the anatomy takes. interpolation: an OpenCV constant.
    """

    level: float
    width: float
    base: float
    white: float
    gap_grey: float
    margin_grey: float
    rule_grey: float
    fill: float
    offset: tuple[float, float]
    mirrored: bool
    upside_down: bool
    interpolation: int


def make_print(volume: CtVolume, rng: np.random.Generator, config: PrintConfig = PrintConfig()) -> FilmPrint:
    """A print of the volume's slices, different for every random state; the same state gives the same print."""
    layout = random_layout(rng, config.longer_px, config.longer_spread, config.style_weights, config.margin_share,
                           config.header_share)  # fmt: skip
    look = _random_look(rng, is_body(volume))
    count = layout.rows * layout.cols
    slices = choose_slices(rng, len(volume.hu), count)
    used = count - (int(rng.integers(1, layout.cols)) if rng.random() < config.empty_share and layout.cols > 1 else 0)
    centre, extent = _anatomy(volume)
    px_per_mm = _px_per_mm(layout, extent, look.fill)
    image = _draw_slices(volume, slices[:used], layout, look, centre, px_per_mm)
    _draw_lines(image, layout, look)
    labels: Labels | None = None
    if rng.random() < config.text_share:
        labels = random_labels(rng, volume, layout.cell_px, px_per_mm, (look.level, look.width))
        for k, position in enumerate(slices[:used]):
            draw_labels(image, layout.cell(k), labels, k, float(position) * volume.spacing_mm[0])
    if layout.header_px:
        _draw_header(rng, image, layout, look)
    height, width = image.shape
    vertices = film_from_pixel(layout.vertices_px(), (height, width))
    parameters = {
        "volume": volume.name,
        "level": look.level,
        "width": look.width,
        "base": look.base,
        "gap_px": layout.gap_px,
        "rule_px": layout.rule_px,
        "boxes": layout.boxes,
        "margins_px": list(layout.margins_px),
        "px_per_mm": px_per_mm,
        "slices": [float(s) for s in slices[:used]],
        "mirrored": look.mirrored,
        "upside_down": look.upside_down,
        "text": labels is not None,
    }
    return FilmPrint(image, layout.size_mm, layout.rows, layout.cols, vertices, layout.style, parameters)


# ---------------------------------------------------------------- choices


def choose_slices(rng: np.random.Generator, available: int, count: int) -> Float[np.ndarray, " count"]:
    """Slice positions (fractions lie between two slices) at equal distances, the ends of the scan left out.

    The paper's rule (10 % dropped at each end, equal spacing, random offset), the spacing sometimes much narrower; from
    either end, rarely in random order.
    """
    low, high = PAPER_MARGIN * (available - 1), (1 - PAPER_MARGIN) * (available - 1)
    narrow = rng.uniform(0.12, 0.6) if rng.random() < 0.3 else rng.uniform(0.85, 1.0)
    step = narrow * (high - low) / max(count - 1, 1)
    start = low + rng.uniform(0.0, 1.0) * (high - low - step * (count - 1))
    positions = start + step * np.arange(count)
    if step >= 1.0:
        positions = np.rint(positions)
    if rng.random() < 0.4:
        positions = positions[::-1].copy()
    return rng.permutation(positions) if rng.random() < 0.06 else positions


def _random_look(rng: np.random.Generator, body: bool) -> _Look:
    table = np.array(BODY_WINDOWS if body else HEAD_WINDOWS)
    level, width, _ = table[rng.choice(len(table), p=table[:, 2] / table[:, 2].sum())]
    base = float(rng.uniform(0.0, 0.12) * rng.random() ** 0.5)
    lift = [base + (rng.uniform(0.0, 0.12) if rng.random() < share else 0.0) for share in (0.5, 0.25)]
    return _Look(
        level=float(np.round(level + rng.normal(0, 0.05) * width)),
        width=float(np.round(width * np.exp(rng.normal(0, 0.15)))),
        base=base,
        white=float(rng.uniform(0.86, 1.0)),
        gap_grey=float(lift[0] if rng.random() < 0.7 else 0.0),
        margin_grey=float(lift[1]),
        rule_grey=float(rng.uniform(0.25, 1.0)),
        fill=float(0.98 - 0.48 * rng.random() ** 1.5),
        offset=(float(rng.normal(0, 0.02)), float(rng.normal(0, 0.02))),
        mirrored=bool(rng.random() < 0.08),
        upside_down=bool(rng.random() < 0.05),
        interpolation=cv2.INTER_LINEAR if rng.random() < 0.6 else cv2.INTER_CUBIC,
    )


def _anatomy(volume: CtVolume) -> tuple[tuple[float, float], tuple[float, float]]:
    """Centre (x, y) in voxels and extent (x, y) in mm of the anatomy, thin things such as the table left out."""
    rough = (volume.hu[:: max(1, len(volume.hu) // 10), ::4, ::4] > -300).sum(axis=0) > 0
    centre, extent = [], []
    for axis, spacing in ((0, volume.spacing_mm[2]), (1, volume.spacing_mm[1])):
        thick = np.flatnonzero(rough.sum(axis=axis) > 0.12 * rough.shape[axis])
        ends = (thick[0], thick[-1] + 1) if len(thick) else (0, rough.shape[1 - axis])
        centre.append(2.0 * (ends[0] + ends[1]))
        extent.append(4.0 * (ends[1] - ends[0]) * spacing)
    return (centre[0], centre[1]), (extent[0], extent[1])


def _px_per_mm(layout: Layout, extent_mm: tuple[float, float], fill: float) -> float:
    height, width = layout.cell_px
    return float(fill * min(width / extent_mm[0], height / extent_mm[1]))


# ---------------------------------------------------------------- drawing


def _draw_slices(
    volume: CtVolume,
    slices: Float[np.ndarray, " count"],
    layout: Layout,
    look: _Look,
    centre: tuple[float, float],
    px_per_mm: float,
) -> Float[np.ndarray, "h w"]:
    """The bare print: every slice in its cell, everything else base, gap or margin grey."""
    image = np.full(layout.shape, OUTSIDE_HU, np.float32)  # float32: OpenCV's warp is four times faster than in int16
    height, width = layout.cell_px
    scale_x, scale_y = px_per_mm * volume.spacing_mm[2], px_per_mm * volume.spacing_mm[1]
    sign_x, sign_y = (-1.0 if look.mirrored else 1.0), (-1.0 if look.upside_down else 1.0)
    middle = ((0.5 + look.offset[0]) * width, (0.5 + look.offset[1]) * height)
    affine = np.array(
        [
            [sign_x * scale_x, 0.0, middle[0] - sign_x * scale_x * centre[0]],
            [0.0, sign_y * scale_y, middle[1] - sign_y * scale_y * centre[1]],
        ]
    )
    for k, position in enumerate(slices):
        x, y = layout.cell(k)[:2]
        image[y : y + height, x : x + width] = cv2.warpAffine(
            _slice_at(volume, float(position)), affine, (width, height), flags=look.interpolation,
            borderMode=cv2.BORDER_CONSTANT, borderValue=(OUTSIDE_HU,),
        )  # fmt: skip
    image -= np.float32(look.level - look.width / 2)
    image *= np.float32((look.white - look.base) / look.width)
    np.clip(image, 0.0, look.white - look.base, out=image)
    image += np.float32(look.base)
    return image


def _slice_at(volume: CtVolume, position: float) -> Float[np.ndarray, "rows cols"]:
    """The slice at a position, mixed from two neighbours where it lies between them."""
    lower = int(np.clip(np.floor(position), 0, len(volume.hu) - 1))
    share = position - lower
    slice_hu = volume.hu[lower].astype(np.float32)
    if share < 0.05 or lower + 1 >= len(volume.hu):
        return slice_hu
    return cv2.addWeighted(slice_hu, 1 - share, volume.hu[lower + 1].astype(np.float32), share, 0.0)


def _draw_lines(image: Float[np.ndarray, "h w"], layout: Layout, look: _Look) -> None:
    """Margins, gutters, rules and boxes, in place. Rules lie on the vertices to a fraction of a pixel."""
    xs, ys = layout.lines_px()
    if look.margin_grey != look.base:
        for strip in (np.s_[: int(ys[0])], np.s_[int(ys[-1]) :], np.s_[:, : int(xs[0])], np.s_[:, int(xs[-1]) :]):
            image[strip] = look.margin_grey
    if layout.style == "gutter":
        _draw_bars(image, layout, xs, ys, layout.gap_px, look.gap_grey)
    if layout.style == "rules" and not layout.boxes:
        if layout.outer_rules:  # drawn just inside the border, where the sheet may end
            inset = 0.5 * layout.rule_px
            xs, ys = (np.array([line[0] + inset, *line[1:-1], line[-1] - inset]) for line in (xs, ys))
        else:
            xs, ys = xs[1:-1], ys[1:-1]
        _draw_bars(image, layout, xs, ys, layout.rule_px, look.rule_grey)
    if layout.boxes:
        for k in range(layout.rows * layout.cols):
            x, y, w, h = layout.cell(k)
            corner = (x + w - layout.rule_px, y + h - layout.rule_px)
            for strip in (
                np.s_[y : y + layout.rule_px, x : x + w],
                np.s_[corner[1] : y + h, x : x + w],
                np.s_[y : y + h, x : x + layout.rule_px],
                np.s_[y : y + h, corner[0] : x + w],
            ):
                image[strip] = look.rule_grey


def _draw_bars(
    image: Float[np.ndarray, "h w"],
    layout: Layout,
    xs: Float[np.ndarray, " c"],
    ys: Float[np.ndarray, " r"],
    thickness_px: int,
    grey: float,
) -> None:
    """Bars across the whole grid, centred on ``xs`` and ``ys``, mixed in by the share of each pixel they cover."""
    across, down = layout.lines_px()
    (left, right), (top, bottom) = ((int(line[0]), int(line[-1])) for line in (across, down))
    for x in xs.tolist():
        first, share = coverage(x, thickness_px, image.shape[1])
        region = image[top:bottom, first : first + len(share)]
        region += share * (np.float32(grey) - region)
    for y in ys.tolist():
        first, share = coverage(y, thickness_px, image.shape[0])
        region = image[first : first + len(share), left:right]
        region += share[:, None] * (np.float32(grey) - region)


def _draw_header(rng: np.random.Generator, image: Float[np.ndarray, "h w"], layout: Layout, look: _Look) -> None:
    """A strip above the grid with a line of text that names nobody."""
    strip = image[: layout.header_px]
    strip[:] = look.base + rng.uniform(0.0, 0.3)
    letters = "".join(rng.choice(list("ABCDEFGHIKLMNOPRSTUVXZ0123456789   "), int(rng.integers(12, 60))))
    height = max(6, round(0.4 * layout.header_px))
    sprite = text_sprite(letters, Font(str(rng.choice(["simplex", "duplex", "pillow"])), height))
    stamp(image, sprite, int(rng.uniform(0.01, 0.5) * image.shape[1]), (layout.header_px - height) // 2, 0.9)
