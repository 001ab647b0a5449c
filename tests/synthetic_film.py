"""Small photos of drawn films with a known map: analytic, so that the truth is exact."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, opencv_from_photo, pixel_centres, pixel_from_film


@dataclass(frozen=True)
class FilmDrawing:
    """What is drawn: rows x cols cells in a margin, with rules, texts, or neither."""

    rows: int = 4
    cols: int = 3
    rules: bool = True
    texts: bool = True
    margin: float = 0.0
    base: int = 14


def draw_print(drawing: FilmDrawing, rng: np.random.Generator, size: tuple[int, int] = (1200, 960)) -> np.ndarray:
    """The print (h, w) uint8: another ellipse of tissue in every cell, and the same texts in all."""
    h, w = size
    image = np.full(size, drawing.base, np.uint8)
    left, top = drawing.margin * w, drawing.margin * h
    cell_w, cell_h = (w - 2 * left) / drawing.cols, (h - 2 * top) / drawing.rows
    for i in range(drawing.rows):
        for j in range(drawing.cols):
            x, y = left + j * cell_w, top + i * cell_h
            centre = (round(x + cell_w * rng.uniform(0.45, 0.55)), round(y + cell_h * rng.uniform(0.45, 0.55)))
            axes = (round(cell_w * rng.uniform(0.2, 0.32)), round(cell_h * rng.uniform(0.2, 0.32)))
            inside = np.zeros(size, np.uint8)
            cv2.ellipse(inside, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
            tissue = cv2.resize(rng.uniform(50, 220, (h // 14, w // 14)), (w, h), interpolation=cv2.INTER_CUBIC)
            image = np.where(inside > 0, np.clip(tissue, 0, 255).astype(np.uint8), image)
            if drawing.texts:
                for text, at in (("WXYZ 12", (0.05, 0.1)), ("SE 4", (0.05, 0.17)), ("L 40", (0.75, 0.95))):
                    corner = (round(x + at[0] * cell_w), round(y + at[1] * cell_h))
                    cv2.putText(image, text, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.55, 225, 2, cv2.LINE_AA)
    if drawing.rules:
        for i in range(drawing.rows + 1):
            y = round(np.clip(top + i * cell_h, 1, h - 2))
            cv2.line(image, (round(left), y), (round(w - left) - 1, y), 170, 2)
        for j in range(drawing.cols + 1):
            x = round(np.clip(left + j * cell_w, 1, w - 2))
            cv2.line(image, (x, round(top)), (x, round(h - top) - 1), 170, 2)
    return image


@dataclass(frozen=True, eq=False)
class Warp:
    """A smooth, turned, bent film in a photo: uv of photo points in closed form."""

    centre: np.ndarray
    scale: np.ndarray
    turn: np.ndarray
    bend: np.ndarray

    def film_from_photo(self, xy: np.ndarray) -> np.ndarray:
        p = ((xy - self.centre) @ self.turn) / self.scale
        waves = np.stack([np.sin(3.0 * p[..., 1] + 0.4), np.cos(2.5 * p[..., 0] - 0.3)], axis=-1)
        return p + 0.5 + self.bend * waves

    def backward(self) -> BackwardMap:
        """The exact inverse on nodes, by fixed-point iteration (the bend is a contraction)."""
        target = film_nodes((33, 33))
        xy = (target - 0.5) * self.scale @ self.turn.T + self.centre
        for _ in range(60):
            xy = xy - ((self.film_from_photo(xy) - target) * self.scale) @ self.turn.T
        return BackwardMap(xy)


def make_photo(
    drawing: FilmDrawing, rng: np.random.Generator, background: int | None = None, size: int = 640
) -> tuple[np.ndarray, BackwardMap]:
    """A photo (size, size, 3) uint8 and its true map. background: a grey level; None for a bright, cluttered one."""
    angle = rng.uniform(-0.2, 0.2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    warp = Warp(
        centre=np.array([size / 2, size / 2]) + rng.uniform(-10, 10, 2),
        scale=np.array([0.6, 0.75]) * size,
        turn=turn,
        bend=rng.uniform(0.01, 0.025, 2),
    )
    printed = draw_print(drawing, rng)
    uv = warp.film_from_photo(pixel_centres((size * 2, size * 2)) / 2.0)
    film = cv2.remap(
        printed,
        opencv_from_photo(pixel_from_film(uv, printed.shape)).astype(np.float32),
        None,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ).astype(np.float64)
    on_film = ((uv >= 0) & (uv <= 1)).all(axis=-1)
    light = 1.0 + 0.25 * np.sin(uv[..., 0] * 2.0) * np.cos(uv[..., 1])
    if background is None:
        behind = 120.0 + 40.0 * cv2.resize(rng.normal(size=(7, 7)), on_film.shape, interpolation=cv2.INTER_CUBIC)
    else:
        behind = np.full(on_film.shape, float(background))
    photo = cv2.resize(np.where(on_film, 12.0 + film * light, behind), (size, size), interpolation=cv2.INTER_AREA)
    photo = cv2.GaussianBlur(photo, (0, 0), 0.6)[..., None] + rng.normal(0, 1.5, (size, size, 3))
    return np.clip(np.rint(photo), 0, 255).astype(np.uint8), warp.backward()


def disturbed(true: BackwardMap, rms_px: float, rng: np.random.Generator) -> BackwardMap:
    """The map with a smooth random error (a random cubic in u and v) of ``rms_px``."""
    t = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, true.nodes.shape[0]), 3)
    error = np.einsum("ia,abk,jb->ijk", t, rng.normal(size=(4, 4, 2)), t)
    return BackwardMap(true.nodes + error * rms_px / np.sqrt(np.mean(np.sum(error**2, axis=-1))))
