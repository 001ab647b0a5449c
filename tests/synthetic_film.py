"""Small photos of drawn films with a known map: analytic, so that the truth is exact."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes, opencv_from_photo, pixel_centres, pixel_from_film


@dataclass(frozen=True)
class FilmDrawing:
    """What is drawn: rows x cols cells within a margin, with or without rules and texts."""

    rows: int = 4
    cols: int = 3
    rules: bool = True
    texts: bool = True
    margin: float = 0.0
    base: int = 14


def draw_print(drawing: FilmDrawing, rng: np.random.Generator, size: tuple[int, int] = (1200, 960)) -> np.ndarray:
    """The print (h, w) uint8: a different ellipse of tissue in every cell, and the same texts in all."""
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
class RolledFilm:
    """A film that is rolled without stretching, in front of a camera; its projection has a closed form.

    centre: pixel in which its middle is seen. height: height of the film there, in pixels. aspect: width over height.
    turn: rotation in the photo. roll: (direction on the film, turn per film height), both in radians. tilt: rotation of
    its middle about the axis of the roll. focal: focal length, in film heights as seen.
    """

    centre: np.ndarray
    height: float
    aspect: float
    turn: float
    roll: tuple[float, float]
    tilt: float
    focal: float = 1.6

    def _pose(self) -> np.ndarray:
        """Rotation to the camera's axes from those of the roll: across it, along it, and away."""
        c, s = np.cos(self.tilt), np.sin(self.tilt)
        return _rotation(self.turn + self.roll[0]) @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    def film_from_photo(self, xy: np.ndarray) -> np.ndarray:
        bend = self.roll[1]
        eye = -self.focal * self._pose()[2]
        plane = np.concatenate([(xy - self.centre) / self.height, np.full((*xy.shape[:-1], 1), self.focal)], axis=-1)
        ray = plane @ self._pose()
        a = ray[..., 0] ** 2 + ray[..., 2] ** 2
        b = eye[0] * ray[..., 0] + (eye[2] - 1.0 / bend) * ray[..., 2]
        c = eye[0] ** 2 + eye[2] ** 2 - 2.0 * eye[2] / bend
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        far = (-b + root) / a
        near = c / (a * far)
        at = eye + np.where(np.abs(near - 1.0) < np.abs(far - 1.0), near, far)[..., None] * ray
        along = np.stack([np.arctan2(bend * at[..., 0], 1.0 - bend * at[..., 2]) / bend, at[..., 1]], axis=-1)
        film = along @ _rotation(self.roll[0])[:2, :2].T
        uv = film / [self.aspect, 1.0] + 0.5
        return np.where((b * b >= a * c)[..., None], uv, -1.0)

    def backward(self) -> BackwardMap:
        """The map on nodes."""
        bend = self.roll[1]
        film = (film_nodes((33, 33)) - 0.5) * [self.aspect, 1.0] @ _rotation(self.roll[0])[:2, :2]
        across, along = film[..., 0], film[..., 1]
        rolled = np.stack([np.sin(bend * across) / bend, along, (1.0 - np.cos(bend * across)) / bend], axis=-1)
        seen = rolled @ self._pose().T + np.array([0.0, 0.0, self.focal])
        return BackwardMap(self.height * self.focal * seen[..., :2] / seen[..., 2:] + self.centre)


def _rotation(angle: float) -> np.ndarray:
    """Rotation by an angle about the camera's axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def make_photo(
    drawing: FilmDrawing, rng: np.random.Generator, background: int | None = None, size: int = 640
) -> tuple[np.ndarray, BackwardMap]:
    """A photo (size, size, 3) uint8 and its true map. background: a grey level; None for a bright, cluttered one."""
    warp = RolledFilm(
        centre=np.array([size / 2, size / 2]) + rng.uniform(-10, 10, 2),
        height=0.75 * size,
        aspect=0.8,
        turn=rng.uniform(-0.2, 0.2),
        roll=(rng.uniform(-np.pi, np.pi), rng.uniform(0.2, 0.6)),
        tilt=rng.uniform(-0.2, 0.2),
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
