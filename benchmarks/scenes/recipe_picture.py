"""A contact sheet of bent films, shaded, with their lattice: what the recipes make."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from hybrid.coords import node_centres_1d
from hybrid.mesh.film import FilmMesh

TILE_PX = 300
_LIGHT = np.array([0.4, -0.5, -0.77])
_LINES = 8
"""Number of cells of the drawn surface between two lines."""


def picture_of(film: FilmMesh, title: str, size_mm: float) -> UInt8[np.ndarray, "h w 3"]:
    """A film seen obliquely from the reader's side; ``size_mm`` fills the tile."""
    t = node_centres_1d(6 * _LINES + 1)
    surface = film.surface(t, t) - film.vertices.mean(axis=(0, 1))
    normals = film.normals(t, t)
    seen, depth = _project(surface, size_mm)
    tile = np.full((TILE_PX, TILE_PX, 3), 250, np.uint8)
    shade = normals @ (_LIGHT / np.linalg.norm(_LIGHT))
    cells = [(r, c) for r in range(len(t) - 1) for c in range(len(t) - 1)]
    for r, c in sorted(cells, key=lambda cell: -depth[cell]):
        corners = np.round(seen[[r, r, r + 1, r + 1], [c, c + 1, c + 1, c]] * 8).astype(np.int32)
        front = shade[r, c] > 0
        level = 90 + 150 * abs(float(shade[r, c]))
        colour = (level, level, level) if front else (0.75 * level, 0.8 * level, level)
        cv2.fillConvexPoly(tile, corners, colour, cv2.LINE_AA, 3)
        for on_line, ends in ((r % _LINES == 0, (0, 1)), (c % _LINES == 0, (0, 3))):
            if on_line:
                cv2.line(tile, corners[ends[0]], corners[ends[1]], (70, 60, 50), 1, cv2.LINE_AA, 3)
    cv2.putText(tile, title, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (30, 30, 30), 1, cv2.LINE_AA)
    return tile


def contact_sheet(tiles: list[UInt8[np.ndarray, "t t 3"]], across: int) -> UInt8[np.ndarray, "h w 3"]:
    """Tiles in rows of ``across``, the last row filled up with white."""
    white = np.full((TILE_PX, TILE_PX, 3), 255, np.uint8)
    filled = tiles + [white] * (-len(tiles) % across)
    return np.concatenate([np.concatenate(filled[k : k + across], axis=1) for k in range(0, len(filled), across)])


def _project(points: Float[np.ndarray, "h w 3"], size_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Tile points (h, w, 2) and depth (h, w) of an oblique view, turned about x and y."""
    about_y, about_x = np.deg2rad(28.0), np.deg2rad(-24.0)
    turn_y = np.array([[np.cos(about_y), 0, np.sin(about_y)], [0, 1, 0], [-np.sin(about_y), 0, np.cos(about_y)]])
    turn_x = np.array([[1, 0, 0], [0, np.cos(about_x), -np.sin(about_x)], [0, np.sin(about_x), np.cos(about_x)]])
    turned = points @ (turn_x @ turn_y).T
    return turned[..., :2] * (TILE_PX / size_mm) + TILE_PX / 2, turned[..., 2]
