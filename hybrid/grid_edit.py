"""The slice grid edited by hand: corners of cells are moved in the photo, undone and redone; the map follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hybrid.backward import BackwardMap
from hybrid.coords import film_nodes
from hybrid.errors import ConfigError, describe
from hybrid.records import RectifyResult, SliceGrid
from hybrid.rectify.splines.tps import fit_tps

NEAR = 0.02
"""Corners of the sheet closer than this (film units) to a corner of a cell move with it."""
CORRECTIONS = 4
"""Number of splines that are added up, each fitted to what the ones before leave: with ten by ten cells, a corner moved
by 30 pixels is off by 1.2 after one spline, by a hundredth after three."""

MOST_CELLS = 24
"""Most rows or columns that may be named: with more than 30 the map's nodes are too far apart to follow each corner."""


@dataclass(frozen=True)
class Move:
    """A corner of cells, given by its row and column, moved to a photo point (x, y)."""

    row: int
    col: int
    to: tuple[float, float]


@dataclass(frozen=True, eq=False)
class GridEdit:
    """A result whose grid is edited: an immutable value; every change returns another. Rectifier.edited makes its film.

    start: the grid that editing began with. done: the moves in effect, in order. undone: the moves taken back, the last
    one first.
    """

    result: RectifyResult
    start: SliceGrid
    done: tuple[Move, ...] = ()
    undone: tuple[Move, ...] = ()

    @staticmethod
    def of(result: RectifyResult, cells: tuple[int, int] | None = None) -> GridEdit:
        """The edit of a result's grid or, if ``cells`` (rows, columns) are given, of a grid of that size that fills the
        sheet.

        Raises:
            ConfigError: this is not a result, it has no film, it has no grid and no cells are given, or the cells are
            not valid numbers of slices.
        """
        if not isinstance(result, RectifyResult):
            got, do = f"a {type(result).__name__}", "Rectify the photo first: GridEdit.of(Rectifier()(photo))."
            raise ConfigError(describe(what="Grid to edit", got=got, allowed="a RectifyResult", do=do))
        if result.backward is None:
            do = "Name the sheet's corners: Rectifier()(photo, corners)."
            raise ConfigError(describe(what="Grid to edit", got=f"a result {result.status.code.name}", do=do))
        if cells is None:
            if result.grid is None:
                do = "Name rows and columns: GridEdit.of(result, (4, 5))."
                raise ConfigError(describe(what="Grid to edit", got="a film without one", do=do))
            return GridEdit(result, result.grid)
        if np.shape(cells) != (2,) or not _whole(*cells) or not all(1 <= each <= MOST_CELLS for each in cells):
            allowed = f"rows and columns from 1 to {MOST_CELLS}"
            raise ConfigError(describe(what="Slices", got=cells, allowed=allowed, do="Count."))
        rows, cols = cells
        vertices = film_nodes((rows + 1, cols + 1))
        grid = SliceGrid(rows, cols, vertices, result.backward.photo_from_film(vertices), confidence=0.0)
        return GridEdit(result, grid)

    def moved(self, row: int, col: int, to: Sequence[float] | np.ndarray) -> GridEdit:
        """With one more corner moved to the photo point ``to``; moves that were undone can then no longer be redone.

        Raises:
            ConfigError: there is no such corner, the target is not a point, or the film would fold.
        """
        rows, cols = self.start.vertices_photo.shape[:2]
        x, y = _point(to)
        if not (_whole(row, col) and 0 <= row < rows and 0 <= col < cols):
            allowed = f"rows 0 to {rows - 1}, columns 0 to {cols - 1}"
            raise ConfigError(describe(what="Corner of a cell", got=(row, col), allowed=allowed, do="Choose another."))
        further = replace(self, done=(*self.done, Move(row, col, (x, y))), undone=())
        if further.backward.folds((33, 33)):
            got, allowed = f"({x:g}, {y:g})", "points in between its neighbours: the film would fold"
            raise ConfigError(describe(what="Place of a corner", got=got, allowed=allowed, do="Move it less far."))
        return further

    def undo(self) -> GridEdit:
        """Without the last move; unchanged if there is none."""
        return replace(self, done=self.done[:-1], undone=self.done[-1:] + self.undone) if self.done else self

    def redo(self) -> GridEdit:
        """With the move that was undone last; unchanged if there is none."""
        return replace(self, done=self.done + self.undone[:1], undone=self.undone[1:])

    def reset(self) -> GridEdit:
        """As it began; all moves can be redone."""
        return replace(self, done=(), undone=self.done + self.undone)

    @cached_property
    def grid(self) -> SliceGrid:
        """The grid with its moved corners; ``start`` itself if none was moved."""
        if not self.done:
            return self.start
        at = np.array(self.start.vertices_photo)
        for move in self.done:
            at[move.row, move.col] = move.to
        return replace(self.start, vertices_photo=at)

    @cached_property
    def backward(self) -> BackwardMap:
        """The map, displaced by the thin-plate spline of least bending that puts the corners there; corners that were
        not moved stay, and so do the sheet's. The result's own map if none was moved."""
        film = self.result.backward
        assert film is not None  # or there would be nothing to edit
        if not self.done:
            return film
        uv = self.start.vertices.reshape(-1, 2)
        apart = (self.grid.vertices_photo - self.start.vertices_photo).reshape(-1, 2)
        ends = film_nodes((2, 2)).reshape(-1, 2)
        free = np.linalg.norm(ends[:, None] - uv[None], axis=-1).min(axis=1) > NEAR
        at, by = np.vstack([uv, ends[free]]), np.vstack([apart, np.zeros((int(free.sum()), 2))])
        nodes, left, edited = film_nodes((film.nodes.shape[0], film.nodes.shape[1])), by, film
        for _ in range(CORRECTIONS):  # a map holds the spline's values at its nodes: in between it is off a little
            edited = BackwardMap(edited.nodes + fit_tps(at, left)(nodes))
            left = by - (edited.photo_from_film(at) - film.photo_from_film(at))
        return edited


def _point(to: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """The coordinates of a photo point; ConfigError if it is not one."""
    try:
        x, y = (float(each) for each in to)
    except (TypeError, ValueError):
        x = y = np.nan
    if not np.isfinite([x, y]).all():
        allowed, do = "a photo point (x, y)", "Name two numbers."
        raise ConfigError(describe(what="Place of a corner", got=repr(to), allowed=allowed, do=do))
    return x, y


def _whole(*numbers: object) -> bool:
    return all(isinstance(each, (int, np.integer)) for each in numbers)


__all__ = ["GridEdit", "Move"]
