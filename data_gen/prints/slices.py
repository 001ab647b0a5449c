"""Which slices a print shows, in which windows, and how they are drawn into its cells."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from data_gen.ct.volumes import CtVolume, is_body
from data_gen.prints.layout import Layout, PrintConfig
from hybrid.coords import centres_1d

HEAD_WINDOWS = ((35.0, 85.0, 0.5), (40.0, 200.0, 0.15), (40.0, 380.0, 0.1), (550.0, 2600.0, 0.25))
BODY_WINDOWS = ((40.0, 380.0, 0.45), (50.0, 250.0, 0.15), (-550.0, 1500.0, 0.25), (450.0, 2000.0, 0.15))
"""(level, width, share): brain, wide brain, soft tissue, bone; mediastinum, liver, lung, bone."""

DEALS = ("one", "halves", "pairs")
"""One window; every slice in the first window and then all again in the second; each slice in both, side by side."""

PAPER_MARGIN = 0.1
"""The paper drops this share of the slices at the top and at the bottom of a scan."""

OUTSIDE_HU = -3000.0
"""Fills what lies beyond the scanned field: black in every window."""

Point = tuple[float, float]


@dataclass(frozen=True)
class Look:
    """Greys of a print, its windows, and how slices are placed.

    windows: (level, width) of each. deal: of DEALS. clear: margins, if there are any, are bare film, which is bright.
    fill: share of the cell that the anatomy takes, over 1 if it is zoomed in. offset: of the anatomy's middle, in
    cells. round_field: black outside the scanner's circle. scout: a scout view is in the first cell.
    interpolation: an OpenCV constant.
    """

    windows: tuple[tuple[float, float], ...]
    deal: str
    base: float
    white: float
    gap_grey: float
    margin_grey: float
    clear: bool
    rule_grey: float
    fill: float
    offset: Point
    mirrored: bool
    upside_down: bool
    round_field: bool
    scout: bool
    interpolation: int


@dataclass(frozen=True, eq=False)
class Deal:
    """Contents of the used cells after the scout: positions among the slices (fractions lie between two) and windows
    by number.
    """

    positions: Float[np.ndarray, " cells"]
    windows: tuple[int, ...]


def random_look(rng: np.random.Generator, volume: CtVolume, config: PrintConfig) -> Look:
    """Greys, windows and slice placement of one print."""
    table = np.array(BODY_WINDOWS if is_body(volume) else HEAD_WINDOWS)
    several = rng.random() < config.windows_share
    chosen = rng.choice(len(table), 2 if several else 1, replace=False, p=table[:, 2] / table[:, 2].sum())
    windows = [(float(np.round(table[i, 0] + rng.normal(0, 0.05) * table[i, 1])),
                float(np.round(table[i, 1] * np.exp(rng.normal(0, 0.15))))) for i in chosen]  # fmt: skip
    base = float(rng.uniform(0.0, 0.12) * rng.random() ** 0.5)
    lift = [base + (rng.uniform(0.0, 0.12) if rng.random() < share else 0.0) for share in (0.5, 0.25)]
    clear, bright_gaps = rng.random() < config.clear_share, rng.random() < config.bright_gap_share
    bare, like_margin = float(rng.uniform(0.6, 1.0)), rng.random() < 0.4
    zoomed = rng.random() < 0.1
    spread = 0.06 if zoomed else 0.02
    return Look(
        windows=tuple(windows),
        deal=str(rng.choice(DEALS[1:])) if several else "one",
        base=base,
        white=float(rng.uniform(0.86, 1.0)),
        gap_grey=bare if bright_gaps or (clear and like_margin) else float(lift[0] if rng.random() < 0.7 else 0.0),
        margin_grey=bare if clear else float(lift[1]),
        clear=bool(clear),
        rule_grey=float(rng.uniform(0.25, 1.0)),
        fill=float(rng.uniform(1.0, 1.35) if zoomed else 0.98 - 0.48 * rng.random() ** 1.5),
        offset=(float(rng.normal(0, spread)), float(rng.normal(0, spread))),
        mirrored=bool(rng.random() < 0.08),
        upside_down=bool(rng.random() < 0.05),
        round_field=bool(rng.random() < 0.2 and volume.plane == "axial"),
        scout=bool(rng.random() < config.scout_share and len(volume.hu) > 3 and volume.plane == "axial"),
        interpolation=cv2.INTER_LINEAR if rng.random() < 0.6 else cv2.INTER_CUBIC,
    )


def deal_slices(rng: np.random.Generator, available: int, count: int, deal: str) -> Deal:
    """Slices and windows for ``count`` cells."""
    if deal == "one":
        return Deal(choose_slices(rng, available, count), (0,) * count)
    half = -(-count // 2)
    positions = choose_slices(rng, available, half)
    if deal == "halves":
        return Deal(np.concatenate([positions, positions])[:count], (0,) * half + (1,) * (count - half))
    return Deal(np.repeat(positions, 2)[:count], ((0, 1) * half)[:count])


def choose_slices(rng: np.random.Generator, available: int, count: int) -> Float[np.ndarray, " count"]:
    """Equally spaced slice positions (fractions lie between two slices), without the ends of the scan.

    The paper's rule (10 % dropped at each end, equal spacing, random offset), but sometimes with much narrower spacing;
    slices begin at either end, or rarely come in random order.
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


def anatomy(volume: CtVolume) -> tuple[Point, Point]:
    """Centre (x, y) in voxels and extent (x, y) in mm of the anatomy, without thin things such as the table."""
    rough = (volume.hu[:: max(1, len(volume.hu) // 10), ::4, ::4] > -300).sum(axis=0) > 0
    centre, extent = [], []
    for axis, spacing in ((0, volume.spacing_mm[2]), (1, volume.spacing_mm[1])):
        thick = np.flatnonzero(rough.sum(axis=axis) > 0.12 * rough.shape[axis])
        ends = (thick[0], thick[-1] + 1) if len(thick) else (0, rough.shape[1 - axis])
        centre.append(2.0 * (ends[0] + ends[1]))
        extent.append(4.0 * (ends[1] - ends[0]) * spacing)
    return (centre[0], centre[1]), (extent[0], extent[1])


# ---------------------------------------------------------------- drawing


def draw_slices(
    image: Float[np.ndarray, "h w"], volume: CtVolume, deal: Deal, layout: Layout, look: Look, px_per_mm: float
) -> None:
    """Draws every slice into its cell in place, windowed before it is magnified, as printers do."""
    height, width = layout.cell_px
    scale_x, scale_y = px_per_mm * volume.spacing_mm[2], px_per_mm * volume.spacing_mm[1]
    sign_x, sign_y = (-1.0 if look.mirrored else 1.0), (-1.0 if look.upside_down else 1.0)
    centre = anatomy(volume)[0]
    middle = ((0.5 + look.offset[0]) * width, (0.5 + look.offset[1]) * height)
    affine = np.array(
        [
            [sign_x * scale_x, 0.0, middle[0] - sign_x * scale_x * centre[0]],
            [0.0, sign_y * scale_y, middle[1] - sign_y * scale_y * centre[1]],
        ]
    )
    beyond = _beyond_the_circle(volume.hu.shape[1:]) if look.round_field else None
    for k, (position, number) in enumerate(zip(deal.positions.tolist(), deal.windows, strict=True)):
        shown = _slice_at(volume, position)
        if beyond is not None:
            shown[beyond] = OUTSIDE_HU
        x, y = layout.cell(k + look.scout)[:2]
        cell = image[y : y + height, x : x + width]
        _to_grey(shown, look.windows[number], look)
        cell[:] = cv2.warpAffine(
            shown, affine, (width, height), flags=look.interpolation, borderMode=cv2.BORDER_CONSTANT,
            borderValue=(look.base,),
        )  # fmt: skip
        if look.interpolation == cv2.INTER_CUBIC:  # which overshoots at edges
            np.clip(cell, look.base, look.white, out=cell)


def _to_grey(hu: Float[np.ndarray, "rows cols"], window: tuple[float, float], look: Look) -> None:
    """Maps Hounsfield units to greys between the film's base and its white, in place."""
    level, width = window
    gain = (look.white - look.base) / width
    hu *= np.float32(gain)
    hu += np.float32(look.base - gain * (level - width / 2))
    np.clip(hu, look.base, look.white, out=hu)


def _beyond_the_circle(shape: tuple[int, ...]) -> np.ndarray:
    rows, cols = (np.arange(n, dtype=np.float32) - (n - 1) / 2 for n in shape)
    return np.hypot(rows[:, None], cols[None]) > min(shape) / 2


def _slice_at(volume: CtVolume, position: float) -> Float[np.ndarray, "rows cols"]:
    """The slice at a position, interpolated from its two neighbours if it lies between them; always a new array."""
    lower = int(np.clip(np.floor(position), 0, len(volume.hu) - 1))
    share = position - lower
    slice_hu = volume.hu[lower].astype(np.float32)
    if share < 0.05 or lower + 1 >= len(volume.hu):
        return slice_hu
    return cv2.addWeighted(slice_hu, 1 - share, volume.hu[lower + 1].astype(np.float32), share, 0.0)


def draw_scout(
    image: Float[np.ndarray, "h w"], volume: CtVolume, positions: Float[np.ndarray, " n"], layout: Layout, look: Look
) -> None:
    """Draws the front view that the scan was planned on in the first cell, with the slices' heights as lines."""
    step = max(1, volume.hu.shape[1] // 128)
    view = np.maximum(volume.hu[::-1, ::step], -1000).mean(axis=1, dtype=np.float32)  # the head at the top
    low, high = float(view.min()), float(np.percentile(view, 99.5))
    view = np.clip((view - low) / max(high - low, 1.0), 0.0, 1.0) ** np.float32(0.7)
    x, y, width, height = layout.cell(0)
    tall, wide = len(view) * volume.spacing_mm[0], view.shape[1] * volume.spacing_mm[2]
    scale = 0.92 * min(height / tall, width / wide)
    size = (max(4, round(wide * scale)), max(4, round(tall * scale)))
    view = cv2.resize(view, size, interpolation=cv2.INTER_CUBIC)
    left, top = x + (width - size[0]) // 2, y + (height - size[1]) // 2
    region = image[top : top + size[1], left : left + size[0]]
    region[:] = look.base + (look.white - look.base) * np.clip(view, 0.0, 1.0)
    slices = len(volume.hu)
    heights = np.interp(positions, np.arange(slices), centres_1d(slices)) / slices
    for share in heights.tolist():
        row = round((1.0 - share) * size[1])
        region[min(max(row, 0), size[1] - 1)] = 0.5 * (look.base + look.white)


__all__ = [
    "BODY_WINDOWS", "HEAD_WINDOWS", "Deal", "Look", "anatomy", "choose_slices", "deal_slices", "draw_scout",
    "draw_slices", "random_look",
]  # fmt: skip
