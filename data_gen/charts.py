"""Small charts for the data set's card, drawn with Pillow: histograms, bars, and many of them on a sheet."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageFont

PANEL_WIDTH, PANEL_HEIGHT = 480, 330
BINS = 36
MOST_BARS = 9
"""Kinds beyond this number are summed up as others."""

_INK, _FAINT, _LINE, _FILL, _MARK, _PAPER = "#22272e", "#6e7781", "#e4e7eb", "#4c8eda", "#d1495b", "#ffffff"
_LEFT, _RIGHT, _TOP, _BOTTOM = 26, 454, 62, 286


def histogram(title: str, unit: str, values: Float[np.ndarray, " n"]) -> Image.Image:
    """How often each range of values occurs, with the median marked; the outermost half per cent is cut off."""
    panel, draw = _panel(title)
    low, high = np.percentile(values, [0.5, 99.5])
    if high <= low:
        low, high = low - 1, high + 1
    counts, _ = np.histogram(np.clip(values, low, high), BINS, (low, high))
    edges = np.linspace(_LEFT, _RIGHT, BINS + 1)
    for count, left, right in zip(counts, edges[:-1], edges[1:], strict=True):
        if count:
            top = _BOTTOM - (_BOTTOM - _TOP) * count / counts.max()
            draw.rectangle([left + 1, min(top, _BOTTOM - 1), right - 1, _BOTTOM], fill=_FILL)
    draw.line([_LEFT, _BOTTOM, _RIGHT, _BOTTOM], fill=_FAINT)
    for tick in ticks(float(low), float(high)):
        x = _LEFT + (_RIGHT - _LEFT) * (tick - low) / (high - low)
        draw.line([x, _BOTTOM, x, _BOTTOM + 5], fill=_FAINT)
        draw.text((x, _BOTTOM + 9), f"{tick:g}", fill=_FAINT, font=_font(15), anchor="mt")
    median = float(np.median(values))
    x = _LEFT + (_RIGHT - _LEFT) * (median - low) / (high - low)
    draw.line([x, _TOP - 6, x, _BOTTOM], fill=_MARK, width=2)
    draw.text((458, 22), f"median {median:.3g} {unit}", fill=_MARK, font=_font(16), anchor="rt")
    return panel


def bars(title: str, kinds: Sequence[str]) -> Image.Image:
    """How often each kind occurs, the most frequent on top."""
    panel, draw = _panel(title)
    counts = Counter(kinds).most_common()
    shown = counts if len(counts) <= MOST_BARS else counts[: MOST_BARS - 1]
    rest = sum(count for _, count in counts[len(shown) :])
    shown = shown + ([(f"{len(counts) - len(shown)} others", rest)] if rest else [])
    height = min(30.0, (_BOTTOM + 20 - _TOP) / len(shown))
    left, longest = 168, max(count for _, count in shown)
    for row, (kind, count) in enumerate(shown):
        y = _TOP + row * height
        right = left + max(2.0, (_RIGHT - 52 - left) * count / longest)
        draw.rectangle([left, y + 3, right, y + height - 3], fill=_FILL)
        middle = y + height / 2
        draw.text((left - 8, middle), _shortened(kind, 16), fill=_INK, font=_font(15), anchor="rm")
        draw.text((right + 6, middle), f"{100 * count / len(kinds):.3g} %", fill=_FAINT, font=_font(15), anchor="lm")
    return panel


def sheet(panels: Sequence[Image.Image], columns: int) -> Image.Image:
    """Panels row by row on one page."""
    gap, width, height = 14, PANEL_WIDTH, PANEL_HEIGHT
    rows = -(-len(panels) // columns)
    page = Image.new("RGB", (gap + columns * (width + gap), gap + rows * (height + gap)), _LINE)
    for k, panel in enumerate(panels):
        page.paste(panel, (gap + k % columns * (width + gap), gap + k // columns * (height + gap)))
    return page


def ticks(low: float, high: float) -> list[float]:
    """Four to ten round numbers within a range."""
    power = 10.0 ** np.floor(np.log10((high - low) / 4))
    step = next(s * power for s in (5.0, 2.0, 1.0) if (high - low) / (s * power) >= 3.999 or s == 1.0)
    return [round(float(k * step), 10) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


def _panel(title: str) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    panel = Image.new("RGB", (PANEL_WIDTH, PANEL_HEIGHT), _PAPER)
    draw = ImageDraw.Draw(panel)
    draw.text((_LEFT - 8, 20), title, fill=_INK, font=_font(19))
    return panel, draw


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def _shortened(text: str, letters: int) -> str:
    return text if len(text) <= letters else text[: letters - 1] + "…"
