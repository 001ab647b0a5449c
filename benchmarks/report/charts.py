"""Charts drawn with Pillow: points over two axes, which may be logarithmic, and stacked bars. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

WIDTH, HEIGHT = 820, 560
_LEFT, _RIGHT, _TOP, _BOTTOM = 84, 800, 52, 490
_INK, _FAINT, _LINE, _PAPER = "#22272e", "#6e7781", "#e4e7eb", "#ffffff"
COLOURS = (
    "#d1495b", "#2f6db5", "#2e8b57", "#e08a1e", "#7a4fa3", "#0b7a75", "#8c564b", "#5d6771", "#c2185b", "#9aa300",
    "#14181d", "#1aa3c4",
)  # fmt: skip

Picture = UInt8[np.ndarray, "_ _ 3"]


@dataclass(frozen=True)
class Points:
    """Points of one kind: x, y, and the label beside each ("" for none); rings instead of dots if hollow."""

    name: str
    xy: tuple[tuple[float, float], ...]
    labels: tuple[str, ...] = ()
    hollow: bool = False


@dataclass(frozen=True)
class Axis:
    """The title of an axis, and its range."""

    title: str
    low: float
    high: float
    log: bool = True

    def part(self, value: float) -> float:
        """Position of a value on the axis, from 0 to 1; values beyond the ends lie at the ends."""
        low, high, at = (np.log(v) if self.log else v for v in (self.low, self.high, max(value, 1e-12)))
        return float(np.clip((at - low) / (high - low), 0, 1))

    def ticks(self) -> list[float]:
        """Round values within the range."""
        if self.log:
            powers = range(int(np.floor(np.log10(self.low))), int(np.ceil(np.log10(self.high))) + 1)
            values = [round(m * 10.0**p, 9) for p in powers for m in (1, 2, 5)]
        else:
            step = 10.0 ** np.floor(np.log10((self.high - self.low) / 3))
            step *= 5 if (self.high - self.low) / step > 25 else 2 if (self.high - self.low) / step > 10 else 1
            values = [float(k * step) for k in range(int(self.low // step), int(self.high // step) + 1)]
        return [v for v in values if self.low <= v <= self.high]


@dataclass(frozen=True)
class Chart:
    """Points over two axes. marks: names of vertical lines by their x. colours: by name of the points."""

    title: str
    x: Axis
    y: Axis
    points: tuple[Points, ...]
    marks: dict[str, float] = field(default_factory=dict)
    colours: dict[str, str] = field(default_factory=dict)
    legend: bool = False


def scatter(chart: Chart) -> Picture:
    """The chart; labels move up or down, or to the other side, until they overlap nothing, and a line leads to them."""
    image = Image.new("RGB", (WIDTH, HEIGHT), _PAPER)
    draw = ImageDraw.Draw(image)
    draw.text((_LEFT, 14), chart.title, fill=_INK, font=_font(21))
    _draw_axes(image, draw, chart)
    taken = [_dot(chart, point) for points in chart.points for point in points.xy]
    for name, at in chart.marks.items():
        x = _LEFT + (_RIGHT - _LEFT) * chart.x.part(at)
        for y in range(_TOP, _BOTTOM, 12):
            draw.line([x, y, x, y + 6], fill=_FAINT, width=2)
        left, top = x + 6, _BOTTOM - 22.0
        draw.text((left, top), name, fill=_FAINT, font=_font(15))
        taken.append((left, top, left + draw.textlength(name, font=_font(15)), top + 17))
    for k, points in enumerate(chart.points):
        colour = chart.colours.get(points.name, COLOURS[k % len(COLOURS)])
        for j, (x, y) in enumerate(points.xy):
            box = _dot(chart, (x, y))
            draw.ellipse(box, fill=None if points.hollow else colour, outline=colour, width=3)
            if points.labels and points.labels[j]:
                _label(draw, (box[0] + 6, box[1] + 6), points.labels[j], colour, taken)
    if chart.legend:
        _legend(
            draw, [(p.name, chart.colours.get(p.name, COLOURS[k % len(COLOURS)])) for k, p in enumerate(chart.points)]
        )
    return np.asarray(image)


def stacked_bars(
    title: str, bars: Sequence[tuple[str, Sequence[tuple[str, float]]]], unit: str, scale: float | None = None
) -> Picture:
    """Bars of named parts, from the left; ``scale``: the value at the right end, the longest bar's if None."""
    image = Image.new("RGB", (WIDTH, HEIGHT), _PAPER)
    draw = ImageDraw.Draw(image)
    draw.text((24, 14), title, fill=_INK, font=_font(21))
    names = list(dict.fromkeys(name for _, parts in bars for name, _ in parts))
    longest = scale or max((sum(v for _, v in parts) for _, parts in bars), default=1.0) or 1.0
    left, right, top = 150, WIDTH - 120, 120
    height = (HEIGHT - top - 30) / max(len(bars), 1)
    for row, (label, parts) in enumerate(bars):
        y, x = top + row * height, float(left)
        draw.text((left - 12, y + height / 2), label, fill=_INK, font=_font(16), anchor="rm")
        for name, value in parts:
            end = x + (right - left) * value / longest
            draw.rectangle(
                [x, y + 0.18 * height, end, y + 0.82 * height], fill=COLOURS[names.index(name) % len(COLOURS)]
            )
            x = end
        total = sum(v for _, v in parts)
        draw.text((x + 8, y + height / 2), f"{total:.0f} {unit}", fill=_FAINT, font=_font(16), anchor="lm")
    x, y = 24.0, 52.0
    for k, name in enumerate(names):
        width = draw.textlength(name, font=_font(15))
        if x + width + 26 > WIDTH - 12:
            x, y = 24.0, y + 24
        draw.rectangle([x, y + 2, x + 13, y + 15], fill=COLOURS[k % len(COLOURS)])
        draw.text((x + 19, y), name, fill=_INK, font=_font(15))
        x += width + 42
    return np.asarray(image)


def page_of(charts: Sequence[Picture], columns: int) -> Picture:
    """Charts of equal size, row by row."""
    blank = np.full_like(charts[0], 255)
    cells = [*charts, *([blank] * (-len(charts) % columns))]
    rows = [np.concatenate(cells[k : k + columns], axis=1) for k in range(0, len(cells), columns)]
    return np.concatenate(rows, axis=0)


def _dot(chart: Chart, xy: tuple[float, float]) -> tuple[float, float, float, float]:
    """Where a point is drawn: left, top, right, bottom."""
    x, y = _LEFT + (_RIGHT - _LEFT) * chart.x.part(xy[0]), _BOTTOM - (_BOTTOM - _TOP) * chart.y.part(xy[1])
    return x - 6, y - 6, x + 6, y + 6


def _draw_axes(image: Image.Image, draw: ImageDraw.ImageDraw, chart: Chart) -> None:
    for tick in chart.x.ticks():
        x = _LEFT + (_RIGHT - _LEFT) * chart.x.part(tick)
        draw.line([x, _TOP, x, _BOTTOM], fill=_LINE)
        draw.text((x, _BOTTOM + 8), f"{tick:g}", fill=_FAINT, font=_font(15), anchor="mt")
    for tick in chart.y.ticks():
        y = _BOTTOM - (_BOTTOM - _TOP) * chart.y.part(tick)
        draw.line([_LEFT, y, _RIGHT, y], fill=_LINE)
        draw.text((_LEFT - 8, y), f"{tick:g}", fill=_FAINT, font=_font(15), anchor="rm")
    draw.rectangle([_LEFT, _TOP, _RIGHT, _BOTTOM], outline=_FAINT)
    draw.text(((_LEFT + _RIGHT) / 2, HEIGHT - 26), chart.x.title, fill=_INK, font=_font(16), anchor="mm")
    upright = Image.new("RGB", (_BOTTOM - _TOP, 24), _PAPER)
    ImageDraw.Draw(upright).text(((_BOTTOM - _TOP) / 2, 12), chart.y.title, fill=_INK, font=_font(16), anchor="mm")
    image.paste(upright.rotate(90, expand=True), (6, _TOP))


def _label(
    draw: ImageDraw.ImageDraw,
    at: tuple[float, float],
    text: str,
    colour: str,
    taken: list[tuple[float, float, float, float]],
) -> None:
    """Write a label as near to a point as it can without overlapping ``taken``, and add its place to that."""
    width, height = draw.textlength(text, font=_font(15)), 17
    moves = sorted(range(_TOP - _BOTTOM, _BOTTOM - _TOP, 4), key=abs)
    for y in (at[1] - height / 2 + move for move in moves):
        for x in (at[0] + 11, at[0] - 11 - width):
            box = (x, y, x + width, y + height)
            inside = x > _LEFT and box[2] < _RIGHT and y > _TOP and box[3] < _BOTTOM
            if inside and not any(x < b[2] and b[0] < box[2] and y < b[3] and b[1] < box[3] for b in taken):
                taken.append(box)
                if abs(y + height / 2 - at[1]) > height / 2:
                    draw.line([at, (x - 3 if x > at[0] else box[2] + 3, y + height / 2)], fill=colour)
                draw.text((x, y - 1), text, fill=colour, font=_font(15))
                return


def _legend(draw: ImageDraw.ImageDraw, names: Sequence[tuple[str, str]]) -> None:
    for k, (name, colour) in enumerate(names):
        y = _TOP + 10 + 22 * k
        draw.ellipse([_LEFT + 12, y, _LEFT + 24, y + 12], fill=colour)
        draw.text((_LEFT + 32, y - 3), name, fill=_INK, font=_font(15))


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


__all__ = ["Axis", "Chart", "Picture", "Points", "page_of", "scatter", "stacked_bars"]
