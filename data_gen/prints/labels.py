"""What is written on each cell of a print: ids, numbers, windows, orientation letters, scale bars. All invented."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float

from data_gen.ct.volumes import CtVolume
from data_gen.prints.typeset import (
    FAMILIES,
    TEXT_STYLES,
    Font,
    Sprite,
    cross_sprite,
    ruler_sprite,
    stamp,
    stamp_text,
    text_sprite,
    wedge_greys,
)  # fmt: skip

CORNERS = ("top left", "top right", "bottom left", "bottom right")

FIELDS = (
    "{id}", "SE {series}", "IM {image}", "Se:{series}", "Im:{image}", "{image}/{total}", "{position:.1f}",
    "SP {position:.1f}", "S {position:.2f}", "I{position:.1f} mm", "W {width}", "L {level}", "W:{width} L:{level}",
    "WW {width}", "WL {level}", "C{level} W{width}", "ST {thick:.1f}", "{thick:.2f} mm", "DFOV {field:.1f}cm",
    "{kv} kV", "{ma} mA", "TI {time:.2f}", "GT 0.0", "H{kernel}s", "Zoom {zoom}%", "{date}",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Marks:
    """What else is drawn in every cell, None or 0 for nothing.

    ruler: a scale bar, vertical at the right or horizontal at the bottom; at the left or the top if ``ruler_first``.
    cross: a plus sign in the middle. wedge: greys at the left edge. ticks_px: length of the strokes at the middles of
    the four edges.
    """

    ruler: Sprite | None
    ruler_vertical: bool
    ruler_first: bool
    cross: Sprite | None
    wedge: Float[np.ndarray, "_ _"] | None
    ticks_px: int


@dataclass(frozen=True, eq=False)
class Labels:
    """The texts of a print, the same in every cell except for their numbers.

    corners: lines for each of CORNERS. values: contents of the fields that do not change.
    letters: for top, right, bottom, left; empty for none. style: of TEXT_STYLES. pad_px: distance from the cell's edge.
    first_image: number of the first cell. first_mm: table position of the volume's first slice.
    """

    font: Font
    corners: tuple[tuple[str, ...], ...]
    values: dict[str, object]
    letters: tuple[str, ...]
    style: str
    marks: Marks
    grey: float
    pad_px: int
    leading: float
    first_image: int
    first_mm: float

    def numbers(self, k: int, position_mm: float, window: tuple[float, float]) -> dict[str, object]:
        """Contents of the k-th cell's fields."""
        moving = {"image": self.first_image + k, "position": self.first_mm + position_mm}
        return {**self.values, **moving, "level": round(window[0]), "width": round(window[1])}

    def parameters(self) -> dict[str, object]:
        """Everything that was chosen, as plain JSON values."""
        marks = self.marks
        return {
            "font": asdict(self.font), "corners": [list(lines) for lines in self.corners], "values": self.values,
            "letters": list(self.letters), "style": self.style, "grey": self.grey, "pad_px": self.pad_px,
            "leading": self.leading, "first_image": self.first_image, "first_mm": self.first_mm,
            "ruler": marks.ruler is not None, "ruler_vertical": marks.ruler_vertical, "ruler_first": marks.ruler_first,
            "cross": marks.cross is not None, "wedge": marks.wedge is not None, "ticks_px": marks.ticks_px,
        }  # fmt: skip


def random_labels(
    rng: np.random.Generator,
    volume: CtVolume,
    cell_px: tuple[int, int],
    px_per_mm: float,
    marks_share: float,
) -> Labels:
    """A random typesetting for cells of ``cell_px`` (height, width), with a scale bar in print pixels per mm."""
    share = float(np.exp(rng.uniform(np.log(0.017), np.log(0.045))))
    family = str(rng.choice(FAMILIES))
    stretch = 1.0 if family == "bitmap" or rng.random() < 0.6 else float(np.round(rng.uniform(0.8, 1.2), 2))
    font = Font(family, max(5, round(share * cell_px[0])), stretch, bool(rng.random() < 0.15))
    corners = _random_corners(rng)
    letters = rng.choice(np.array([("A", "L", "P", "R"), ("", "L", "", "R"), ("", "", "", "R"), ("", "", "", "")]),
                         p=[0.15, 0.1, 0.15, 0.6])  # fmt: skip
    marks = _random_marks(rng, cell_px, px_per_mm, marks_share)
    values: dict[str, object] = {
        "id": "".join(rng.choice(list("ABCDEFGHJKLMNPRSTUVWXYZ0123456789"), int(rng.integers(4, 11)))),
        "series": int(rng.integers(1, 13)),
        "total": int(rng.integers(30, 400)),
        "thick": float(volume.spacing_mm[0]),
        "field": volume.spacing_mm[2] * volume.hu.shape[2] / 10,
        "kv": int(rng.choice([80, 100, 120, 140])),
        "ma": int(rng.integers(60, 500)),
        "time": float(rng.uniform(0.3, 2.0)),
        "kernel": int(rng.integers(10, 70)),
        "zoom": int(rng.integers(80, 200)),
        "date": f"{rng.integers(1, 29):02d}-{rng.integers(1, 13):02d}-20{rng.integers(0, 30):02d}",
    }
    return Labels(
        font, corners, values, tuple(str(c) for c in letters), str(rng.choice(TEXT_STYLES, p=[0.86, 0.1, 0.04])), marks,
        float(rng.uniform(0.5, 1.0)),
        max(1, int(rng.uniform(0.005, 0.035) * cell_px[1])), float(rng.uniform(1.25, 1.7)),
        int(rng.integers(1, 40)), float(rng.uniform(-900, 300)),
    )  # fmt: skip


def _random_corners(rng: np.random.Generator) -> tuple[tuple[str, ...], ...]:
    """One to five lines in most corners; at least one line gives image number or position, as on every real film."""
    corners = []
    for chance in (0.9, 0.8, 0.75, 0.5):
        lines = int(rng.integers(1, 6)) if rng.random() < chance else 0
        corners.append(tuple(str(f) for f in rng.choice(np.array(FIELDS), lines, replace=False)))
    if not any("{image}" in line or "{position" in line for lines in corners for line in lines):
        corners[int(rng.integers(2))] += (str(rng.choice(["IM {image}", "{position:.1f}"])),)
    return tuple(corners)


def _random_marks(rng: np.random.Generator, cell_px: tuple[int, int], px_per_mm: float, share: float) -> Marks:
    """A scale bar on half of the prints, its ticks on either side; wedges, crosses and ticks on ``share`` of them."""
    ruler, vertical = _random_ruler(rng, cell_px, px_per_mm)
    cross, wedge, ticks = rng.random(3) < share
    height, width = cell_px
    thick = max(1, round(0.003 * width))
    steps = int(rng.choice([0, 8, 11, 16]))
    if ruler is not None and rng.random() < 0.5:
        ruler = ruler[:, ::-1] if vertical else ruler[::-1]
    return Marks(
        ruler,
        vertical,
        bool(rng.random() < 0.3),
        cross_sprite(max(2, round(rng.uniform(0.01, 0.03) * width)), thick) if cross else None,
        wedge_greys(int(rng.uniform(0.25, 0.5) * height), max(3, round(0.02 * width)), steps, 0.95) if wedge else None,
        max(2, round(rng.uniform(0.01, 0.025) * width)) if ticks else 0,
    )


def _random_ruler(rng: np.random.Generator, cell_px: tuple[int, int], px_per_mm: float) -> tuple[Sprite | None, bool]:
    if rng.random() < 0.45:
        return None, True
    vertical = bool(rng.random() < 0.8)
    room = 0.8 * (cell_px[0] if vertical else cell_px[1])
    ticks = int(min(rng.choice([5, 10, 15]), room // (10 * px_per_mm)))
    if ticks < 2:
        return None, vertical
    tick = max(1, round(rng.uniform(0.006, 0.014) * cell_px[1]))
    return ruler_sprite(10 * px_per_mm * ticks, ticks, tick, max(1, round(0.003 * cell_px[1])), vertical), vertical


def draw_labels(
    image: Float[np.ndarray, "h w"], cell: tuple[int, int, int, int], labels: Labels, numbers: dict[str, object]
) -> None:
    """Writes the texts of a cell (x, y, width, height) onto the image in place, fields filled with ``numbers``."""
    x, y, width, height = cell
    pad, inside = labels.pad_px, image[y : y + height, x : x + width]
    _draw_marks(inside, labels.marks, labels)
    for corner, lines in zip(CORNERS, labels.corners, strict=True):
        sprites = [text_sprite(line.format(**numbers), labels.font) for line in lines]
        _draw_corner(inside, sprites, corner, labels)
    anchors = ((0.5, 0.0), (1.0, 0.5), (0.5, 1.0), (0.0, 0.5))
    for letter, (across, down) in zip(labels.letters, anchors, strict=True):
        if letter:
            sprite = text_sprite(letter, labels.font)
            at_x = pad + across * (width - 2 * pad - sprite.shape[1])
            at_y = pad + down * (height - 2 * pad - sprite.shape[0])
            stamp_text(inside, sprite, (round(at_x), round(at_y)), labels.grey, labels.style)


def _draw_corner(inside: Float[np.ndarray, "h w"], sprites: Sequence[Sprite], corner: str, labels: Labels) -> None:
    height, width = inside.shape
    line_px = max(1, round(labels.leading * labels.font.height_px))
    for i, sprite in enumerate(sprites):
        at_y = labels.pad_px + i * line_px
        if corner.startswith("bottom"):
            at_y = height - labels.pad_px - (len(sprites) - i) * line_px
        at_x = width - labels.pad_px - sprite.shape[1] if corner.endswith("right") else labels.pad_px
        stamp_text(inside, sprite, (at_x, at_y), labels.grey, labels.style)


def _draw_marks(inside: Float[np.ndarray, "h w"], marks: Marks, labels: Labels) -> None:
    height, width = inside.shape
    if marks.ruler is not None:
        tall, wide = marks.ruler.shape
        across, down = width - wide, height - tall
        along = labels.pad_px if marks.ruler_first else (across if marks.ruler_vertical else down) - labels.pad_px
        at = (along, down // 2) if marks.ruler_vertical else (across // 2, along)
        stamp(inside, marks.ruler, *at, labels.grey)
    if marks.cross is not None:
        stamp(
            inside, marks.cross, (width - marks.cross.shape[1]) // 2, (height - marks.cross.shape[0]) // 2, labels.grey
        )
    if marks.wedge is not None:
        tall, wide = marks.wedge.shape
        top = (height - tall) // 2
        place = inside[top : top + tall, labels.pad_px : labels.pad_px + wide]
        place[:] = marks.wedge[:, : place.shape[1]]
    if marks.ticks_px:
        for place in (np.s_[: marks.ticks_px, width // 2], np.s_[-marks.ticks_px :, width // 2],
                      np.s_[height // 2, : marks.ticks_px], np.s_[height // 2, -marks.ticks_px :]):  # fmt: skip
            inside[place] = labels.grey
