"""What is written on each cell of a print: ids, numbers, windows, orientation letters, scale bars. All invented."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from data_gen._typeset import FAMILIES, Font, Sprite, ruler_sprite, stamp, text_sprite
from data_gen.volumes import CtVolume

CORNERS = ("top left", "top right", "bottom left", "bottom right")

FIELDS = (
    "{id}", "SE {series}", "IM {image}", "Se:{series}", "Im:{image}", "{image}/{total}", "{position:.1f}",
    "SP {position:.1f}", "S {position:.2f}", "I{position:.1f} mm", "W {width}", "L {level}", "W:{width} L:{level}",
    "WW {width}", "WL {level}", "C{level} W{width}", "ST {thick:.1f}", "{thick:.2f} mm", "DFOV {field:.1f}cm",
    "{kv} kV", "{ma} mA", "TI {time:.2f}", "GT 0.0", "H{kernel}s", "Zoom {zoom}%", "{date}",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Labels:
    """The texts of a print, the same on every cell but for their numbers.

    corners: lines for each of CORNERS. values: what stands in for the fields that do not change.
    letters: for top, right, bottom, left; empty for none. ruler: a scale bar, or None, and where it stands.
    pad_px: distance from the cell's edge. first_image: number of the first cell.
    """

    font: Font
    corners: tuple[tuple[str, ...], ...]
    values: dict[str, object]
    letters: tuple[str, ...]
    ruler: Sprite | None
    ruler_vertical: bool
    grey: float
    pad_px: int
    leading: float
    first_image: int
    first_mm: float


def random_labels(
    rng: np.random.Generator,
    volume: CtVolume,
    cell_px: tuple[int, int],
    px_per_mm: float,
    window: tuple[float, float],
) -> Labels:
    """A random typesetting for cells of ``cell_px`` (height, width), with a scale bar in print pixels per mm."""
    share = float(np.exp(rng.uniform(np.log(0.017), np.log(0.045))))
    family = str(rng.choice(FAMILIES))
    stretch = 1.0 if family == "bitmap" or rng.random() < 0.6 else float(np.round(rng.uniform(0.8, 1.2), 2))
    font = Font(family, max(5, round(share * cell_px[0])), stretch, bool(rng.random() < 0.15))
    corners = _random_corners(rng)
    letters = rng.choice(np.array([("A", "L", "P", "R"), ("", "L", "", "R"), ("", "", "", "R"), ("", "", "", "")]),
                         p=[0.15, 0.1, 0.15, 0.6])  # fmt: skip
    ruler, vertical = _random_ruler(rng, cell_px, px_per_mm)
    values: dict[str, object] = {
        "id": "".join(rng.choice(list("ABCDEFGHJKLMNPRSTUVWXYZ0123456789"), int(rng.integers(4, 11)))),
        "series": int(rng.integers(1, 13)),
        "total": int(rng.integers(30, 400)),
        "width": round(window[1]),
        "level": round(window[0]),
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
        font, corners, values, tuple(str(c) for c in letters), ruler, vertical, float(rng.uniform(0.5, 1.0)),
        max(1, int(rng.uniform(0.005, 0.035) * cell_px[1])), float(rng.uniform(1.25, 1.7)),
        int(rng.integers(1, 40)), float(rng.uniform(-900, 300)),
    )  # fmt: skip


def _random_corners(rng: np.random.Generator) -> tuple[tuple[str, ...], ...]:
    """One to five lines in most corners; at least one of them counts, as on every real film."""
    corners = []
    for chance in (0.9, 0.8, 0.75, 0.5):
        lines = int(rng.integers(1, 6)) if rng.random() < chance else 0
        corners.append(tuple(str(f) for f in rng.choice(np.array(FIELDS), lines, replace=False)))
    if not any("{image}" in line or "{position" in line for lines in corners for line in lines):
        corners[int(rng.integers(2))] += (str(rng.choice(["IM {image}", "{position:.1f}"])),)
    return tuple(corners)


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
    image: Float[np.ndarray, "h w"], cell: tuple[int, int, int, int], labels: Labels, k: int, position_mm: float
) -> None:
    """Writes the texts of the k-th cell (x, y, width, height) onto the image in place."""
    x, y, width, height = cell
    pad, inside = labels.pad_px, image[y : y + height, x : x + width]
    moving = {"image": labels.first_image + k, "position": labels.first_mm + position_mm}
    for corner, lines in zip(CORNERS, labels.corners, strict=True):
        texts = [line.format(**labels.values, **moving) for line in lines]
        _draw_corner(inside, [text_sprite(t, labels.font) for t in texts], corner, labels)
    anchors = ((0.5, 0.0), (1.0, 0.5), (0.5, 1.0), (0.0, 0.5))
    for letter, (across, down) in zip(labels.letters, anchors, strict=True):
        if letter:
            sprite = text_sprite(letter, labels.font)
            at_x = pad + across * (width - 2 * pad - sprite.shape[1])
            at_y = pad + down * (height - 2 * pad - sprite.shape[0])
            stamp(inside, sprite, round(at_x), round(at_y), labels.grey)
    if labels.ruler is not None:
        _draw_ruler(inside, labels.ruler, labels)


def _draw_corner(inside: Float[np.ndarray, "h w"], sprites: Sequence[Sprite], corner: str, labels: Labels) -> None:
    height, width = inside.shape
    line_px = max(1, round(labels.leading * labels.font.height_px))
    for i, sprite in enumerate(sprites):
        at_y = labels.pad_px + i * line_px
        if corner.startswith("bottom"):
            at_y = height - labels.pad_px - (len(sprites) - i) * line_px
        at_x = width - labels.pad_px - sprite.shape[1] if corner.endswith("right") else labels.pad_px
        stamp(inside, sprite, at_x, at_y, labels.grey)


def _draw_ruler(inside: Float[np.ndarray, "h w"], ruler: Sprite, labels: Labels) -> None:
    height, width = inside.shape
    if labels.ruler_vertical:
        stamp(inside, ruler, width - labels.pad_px - ruler.shape[1], (height - ruler.shape[0]) // 2, labels.grey)
    else:
        stamp(inside, ruler, (width - ruler.shape[1]) // 2, height - labels.pad_px - ruler.shape[0], labels.grey)
