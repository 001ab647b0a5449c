"""Typesets CT slices into the flat print of a film: the grids, windows, rules, gutters and texts of many makers."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from data_gen.ct.volumes import CtVolume, Plane
from data_gen.prints.labels import Labels, draw_labels, random_labels
from data_gen.prints.layout import Layout, PrintConfig, coverage, random_layout
from data_gen.prints.slices import Deal, Look, anatomy, choose_slices, deal_slices, draw_scout, draw_slices, random_look
from data_gen.prints.typeset import FAMILIES, Font, stamp, text_sprite
from hybrid.coords import film_from_pixel


@dataclass(frozen=True, eq=False)
class FilmPrint:
    """A flat print, the truth that a photo shows.

    image: (h, w) float32 display grey in [0, 1].
    size_mm: (height, width) of the sheet.
    rows, cols: slices down and across.
    vertices: (rows + 1, cols + 1, 2) film uv of the corners of the cells: on equidistant lines halfway between
        neighbouring cells, and on the outer borders of the grid, half a gap outside the outermost cells.
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


DEFAULT_CONFIG = PrintConfig()

PLANE_LETTERS: dict[Plane, dict[str, str]] = {
    "axial": {},
    "coronal": {"A": "H", "P": "F"},
    "sagittal": {"A": "H", "P": "F", "R": "A", "L": "P"},
}
"""Replaces the side letters of an axial slice in planes that show others: head, feet."""


def make_print(volume: CtVolume, rng: np.random.Generator, config: PrintConfig = DEFAULT_CONFIG) -> FilmPrint:
    """A print of the volume's slices, different for every random state; the same state gives the same print."""
    layout = random_layout(rng, config)
    look = random_look(rng, volume, config)
    count = layout.rows * layout.cols - look.scout
    used = count - (int(rng.integers(1, layout.cols)) if rng.random() < config.empty_share and layout.cols > 1 else 0)
    deal = deal_slices(rng, len(volume.hu), used, look.deal)
    px_per_mm = _px_per_mm(layout, anatomy(volume)[1], look.fill)
    image = np.full(layout.shape, look.base, np.float32)
    draw_slices(image, volume, deal, layout, look, px_per_mm)
    if look.scout:
        draw_scout(image, volume, deal.positions, layout, look)
    _draw_lines(image, layout, look)
    labels: Labels | None = None
    if rng.random() < config.text_share:
        labels = random_labels(rng, volume, layout.cell_px, px_per_mm, config.marks_share)
        letters = tuple(PLANE_LETTERS[volume.plane].get(letter, letter) for letter in labels.letters)
        labels = replace(labels, letters=_letters_as_drawn(letters, look))
        for k, (position, number) in enumerate(zip(deal.positions.tolist(), deal.windows, strict=True)):
            numbers = labels.numbers(k, position * volume.spacing_mm[0], look.windows[number])
            draw_labels(image, layout.cell(k + look.scout), labels, numbers)
    header = _draw_header(rng, image, layout, look, config.label_share) if layout.header_px else ""
    vertices = film_from_pixel(layout.vertices_px(), (image.shape[0], image.shape[1]))
    parameters = {"volume": volume.label, "plane": volume.plane, "px_per_mm": px_per_mm, "header": header}
    parameters |= _layout_parameters(layout) | _look_parameters(look, deal, labels)
    return FilmPrint(image, layout.size_mm, layout.rows, layout.cols, vertices, layout.style, parameters)


def _layout_parameters(layout: Layout) -> dict[str, Any]:
    fields = asdict(layout)
    return {name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()}


def _look_parameters(look: Look, deal: Deal, labels: Labels | None) -> dict[str, Any]:
    """What was drawn, and which cues show the way up: text, and the anatomy unless it is upside down."""
    fields = asdict(look) | {"windows": [list(window) for window in look.windows], "offset": list(look.offset)}
    return fields | {
        "slices": [float(s) for s in deal.positions],
        "window_of_slice": list(deal.windows),
        "text": labels is not None,
        "labels": labels.parameters() if labels is not None else {},
        "anatomy_upright": not look.upside_down,
    }


def _letters_as_drawn(letters: tuple[str, ...], look: Look) -> tuple[str, ...]:
    """The letters of the patient's sides (top, right, bottom, left), swapped with them if slices are flipped."""
    top, right, bottom, left = letters
    if look.mirrored:
        right, left = left, right
    if look.upside_down:
        top, bottom = bottom, top
    return top, right, bottom, left


def _px_per_mm(layout: Layout, extent_mm: tuple[float, float], fill: float) -> float:
    height, width = layout.cell_px
    return float(fill * min(width / extent_mm[0], height / extent_mm[1]))


# ---------------------------------------------------------------- drawing


def _draw_lines(image: Float[np.ndarray, "h w"], layout: Layout, look: Look) -> None:
    """Draw margins, gutters, rules and boxes, in place. Rules lie on the vertices to a fraction of a pixel."""
    xs, ys = layout.lines_px()
    if look.margin_grey != look.base:
        for strip in (np.s_[: int(ys[0])], np.s_[int(ys[-1]) :], np.s_[:, : int(xs[0])], np.s_[:, int(xs[-1]) :]):
            image[strip] = look.margin_grey
    if layout.frame_px:
        _draw_frame(image, layout, look.base if look.clear else look.rule_grey)
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


def _draw_frame(image: Float[np.ndarray, "h w"], layout: Layout, grey: float) -> None:
    """A line around the grid, through the margins."""
    top, right, bottom, left = (round(layout.frame_at * margin) for margin in layout.margins_px)
    height, width = layout.shape
    frame = np.zeros(layout.shape, bool)
    frame[top : height - bottom, left : width - right] = True
    thick = layout.frame_px
    frame[top + thick : height - bottom - thick, left + thick : width - right - thick] = False
    image[frame] = grey


def _draw_bars(
    image: Float[np.ndarray, "h w"],
    layout: Layout,
    xs: Float[np.ndarray, " c"],
    ys: Float[np.ndarray, " r"],
    thickness_px: int,
    grey: float,
) -> None:
    """Bars across the whole grid, centred on ``xs`` and ``ys``, blended by the share of each pixel that they cover."""
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


def _draw_header(
    rng: np.random.Generator, image: Float[np.ndarray, "h w"], layout: Layout, look: Look, label_share: float
) -> str:
    """Draw a strip above or below the grid with up to three lines that name nobody; return the text."""
    strip = image[-layout.header_px :] if layout.footer else image[: layout.header_px]
    on_bare_film, label = look.clear and rng.random() < 0.6, rng.random() < label_share
    if on_bare_film:
        strip[:] = look.margin_grey
    else:
        strip[:] = rng.uniform(0.5, 1.0) if label else look.base + rng.uniform(0.0, 0.3)
    count = int(rng.integers(1, 4))
    spacing = layout.header_px / count
    font = Font(str(rng.choice(FAMILIES)), max(6, round(float(rng.uniform(0.4, 0.75)) * spacing)))
    blocks = [float(rng.uniform(0.01, 0.5))] if rng.random() < 0.5 else [0.02, float(rng.uniform(0.5, 0.75))]
    lines: list[str] = []
    for k in range(count):
        top = round((k + 0.5) * spacing - font.height_px / 2)
        for left in blocks:
            lines.append(_random_line(rng, most=60 // len(blocks)))
            at = round(left * image.shape[1]), top
            stamp(strip, text_sprite(lines[-1], font), *at, look.base if on_bare_film or label else 0.9)
    return "\n".join(lines)


def _random_line(rng: np.random.Generator, most: int) -> str:
    """Capitals, digits and spaces that mean nothing."""
    return "".join(rng.choice(list("ABCDEFGHIKLMNOPRSTUVXZ0123456789   "), int(rng.integers(6, most))))


__all__ = ["FilmPrint", "PrintConfig", "choose_slices", "make_print"]
