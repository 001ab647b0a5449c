"""Cells registered to what they have in common, to a small fraction of a pixel (congealing).

Corner texts, scale bars, tables and rules are the same in every cell; anatomy is not. Over all cells each pixel has a
median, the template, and a spread. Blocks of each cell are shifted onto the template by least squares (Lucas & Kanade
1981), with pixels weighted by one over the squared spread: what all cells share counts, what differs does not. The
median of misaligned texts is a blur that shows no shift, so a new template is made of the shifted blocks, and they are
shifted once more. A shift tells where a block's content lies relative to the other cells. Displacements that all cells
share stay an unknown smooth function of the place in the cell, and the pitch is unknown too: the sheet's outline has to
pin them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from hybrid.coords import centres_1d
from hybrid.errors import require_at_least, require_at_most
from hybrid.film_view import FilmView
from hybrid.rectify.grid.repeat import Repeats, cell_corners, detail, shrunk
from hybrid.rectify.splines.sightings import Sightings
from hybrid.rectify.splines.tps import MAD_TO_SIGMA


@dataclass(frozen=True)
class CongealConfig:
    """Options for registering cells to their template."""

    blurs_px: tuple[float, ...] = (2.0, 1.0)
    """One round each: details below this size, in pixels of the view, are smoothed away. Coarse rounds reach far, fine
    ones are exact."""
    light: tuple[float, float] = (2.0, 2.0)
    """Scales above ``light[0]`` blurs plus ``light[1]`` pixels of the view are light: strokes of letters are finer than
    the edges of bones, which differ from cell to cell."""
    steps: int = 2
    """Least-squares steps of a round, each against a template made of the blocks that the last one shifted."""
    block_px: float = 24.0
    """Approximate side of a block, in pixels of the view."""
    min_cells: int = 4
    """The median of fewer cells does not show what they share."""
    min_blocks: int = 12
    """Least number of blocks with a usable shift along an axis; fewer are left out."""
    min_gain: float = 0.3
    """Blocks that show the template with less contrast than this are covered, in glare, or empty."""
    min_correlation: float = 0.3
    """Least weighted correlation of a block with the template."""
    clip: float = 3.0
    """Differences from the template are clipped at this many spreads plus what a shift by the blur explains."""
    correlated_px: float = 10.0
    """Number of neighbouring pixels whose differences are alike."""
    sigma_px: float = 0.15
    """Noise of a shift in addition to what the spread explains, in pixels of the view."""
    worst_sigma_px: float = 1.0
    """Blocks whose shift is less exact than this do not count."""
    reach: float = 2.5
    """Largest shift believed, in multiples of the blur: a linear step does not reach beyond."""
    shared_sigma: float = 0.03
    """Prior standard deviation of the displacements that all cells share, and of the pitch, in film units."""
    shrink_blur_px: float = 2.0
    """From this blur on, a view of half the size shows as much, and is four times as quick."""

    def __post_init__(self) -> None:
        require_at_least(self, 0.001, "block_px", "min_gain")
        require_at_least(self, 0.1, "blurs_px", "light")
        require_at_least(self, 1e-6, "shared_sigma")
        require_at_least(self, 1, "steps", "min_blocks")
        require_at_most(self, 1, "min_gain", "min_correlation")

    def shrunk(self, factor: int) -> CongealConfig:
        """The same options in pixels of a view that is reduced by ``factor``."""
        return replace(
            self,
            block_px=self.block_px / factor,
            correlated_px=self.correlated_px / factor**2,
            sigma_px=self.sigma_px / factor,
            worst_sigma_px=self.worst_sigma_px / factor,
        )


@dataclass(frozen=True, eq=False)
class _Shifts:
    """Blocks of cells against the template, in pixels: n cells of (rows, columns) blocks.

    shift: offset (x, y) of the cell's content from the template's. sigma: of x and y, each by itself.
    good: blocks that show the template. at: where in the cell (x, y) each block's detail lies, as parts of the cell.
    """

    shift: Float[np.ndarray, "n by bx 2"]
    sigma: Float[np.ndarray, "n by bx 2"]
    good: Bool[np.ndarray, "n by bx"]
    at: Float[np.ndarray, "by bx 2"]


def register_cells(
    view: FilmView, columns: Repeats, rows: Repeats, blur_px: float, config: CongealConfig
) -> tuple[Sightings, ...]:
    """Where the blocks of each cell lie relative to the template: sightings of u and of v, each only if enough is seen.

    view: the flat grey film, covering [0, 1]^2. blur_px: details below this size are smoothed away.
    """
    if columns.cells * rows.cells < config.min_cells:
        return ()
    shrink = 2 if blur_px >= config.shrink_blur_px else 1
    config = config.shrunk(shrink)
    blur_px, light_px = blur_px / shrink, (config.light[0] * blur_px + config.light[1]) / shrink
    image = detail(shrunk(view.image[..., 0], shrink), blur_px, light_px)
    number = np.array([(j, i) for i in range(rows.cells) for j in range(columns.cells)])
    shifts = _settled_shifts(image, columns, rows, number, blur_px, config)
    found = (_sightings(shifts, number, axis, (columns, rows), image.shape, config) for axis in (0, 1))
    return tuple(s for s in found if s is not None)


def _settled_shifts(
    image: Float[np.ndarray, "h w"],
    columns: Repeats,
    rows: Repeats,
    number: Int[np.ndarray, "n 2"],
    blur_px: float,
    config: CongealConfig,
) -> _Shifts:
    """Shifts of the blocks of all cells after all steps. number: (column, row) of each cell."""
    (wide, tall), corners = cell_corners(image, columns, rows, number)
    edges = _block_edges(tall, config.block_px), _block_edges(wide, config.block_px)
    shift = np.zeros((len(number), len(edges[0]) - 1, len(edges[1]) - 1, 2))
    for _ in range(config.steps):
        found = block_shifts(_shifted_cells(image, corners, edges, shift), blur_px, config)
        shift += np.where(found.good[..., None], found.shift, 0.0)
    return replace(found, shift=shift)


def _shifted_cells(
    image: Float[np.ndarray, "h w"],
    corners: Float[np.ndarray, "n 2"],
    edges: tuple[Int[np.ndarray, " k"], Int[np.ndarray, " l"]],
    shift: Float[np.ndarray, "n by bx 2"],
) -> Float[np.ndarray, "n ch cw"]:
    """The cells with corners (x, y), in OpenCV's pixels, each block read from where ``shift`` places it."""
    tall, wide = (np.diff(e) for e in edges)
    across, down = np.arange(edges[1][-1]), np.arange(edges[0][-1])
    x = (shift[..., 0].repeat(wide, axis=2) + (corners[:, 0, None, None] + across)).astype(np.float32)
    y = (shift[..., 1].repeat(tall, axis=1) + (corners[:, 1, None, None] + down[:, None])).astype(np.float32)
    cells = np.empty((len(shift), len(down), len(across)), image.dtype)
    for cell, at_x, at_y in zip(cells, x, y, strict=True):  # one by one: the maps of a cell stay in the cache
        maps = at_x.repeat(tall, axis=0), at_y.repeat(wide, axis=1)
        cv2.remap(image, *maps, cv2.INTER_LINEAR, dst=cell, borderMode=cv2.BORDER_REPLICATE)
    return cells


def block_shifts(cells: Float[np.ndarray, "n ch cw"], blur_px: float, config: CongealConfig) -> _Shifts:
    """One least-squares step of all blocks of all cells towards the cells' median."""
    template = median_image(cells)
    spread = cv2.blur(MAD_TO_SIGMA * median_image(np.abs(cells - template)), (3, 3))
    spread = np.hypot(spread, np.median(spread) + 1e-3)
    weight = 1.0 / spread**2
    edges = tuple(_block_edges(n, config.block_px) for n in template.shape)
    blocks = tuple(_members(tuple(e.tolist()), template.dtype) for e in edges)
    gy, gx = np.gradient(template)
    xx, xy, yy = (_block_sums(weight * product, blocks) for product in (gx * gx, gx * gy, gy * gy))
    det = np.maximum(xx * yy - xy * xy, 1e-6 * (xx + yy) ** 2 + 1e-12)
    # Cell by cell and in place: intermediate results stay in the cache.
    between, weighted = np.empty_like(template), weight * template
    both, own, bx, by = (np.empty((len(cells), *xx.shape), template.dtype) for _ in range(4))
    for k, cell in enumerate(cells):
        both[k] = _block_sums(np.multiply(weighted, cell, out=between), blocks)
        np.multiply(cell, cell, out=between)
        own[k] = _block_sums(np.multiply(between, weight, out=between), blocks)
    energy = np.maximum(_block_sums(weight * template * template, blocks), 1e-9)
    gain = both / energy
    bounded = np.clip(gain, config.min_gain, 1.0 / config.min_gain)
    # A shift within reach makes differences too: only what exceeds both is clipped.
    bound = config.clip * spread + blur_px * np.hypot(gx, gy)
    tall, wide = (np.diff(e) for e in edges)
    least, along_x, along_y, difference = -bound, weight * gx, weight * gy, np.empty_like(template)
    for k, cell in enumerate(cells):
        np.divide(cell, bounded[k].repeat(wide, axis=1).repeat(tall, axis=0), out=difference)
        difference -= template
        np.minimum(difference, bound, out=difference)
        np.maximum(difference, least, out=difference)
        bx[k] = _block_sums(np.multiply(along_x, difference, out=between), blocks)
        by[k] = _block_sums(np.multiply(along_y, difference, out=between), blocks)
    shift = np.stack([xy * by - yy * bx, xy * bx - xx * by], axis=-1) / det[..., None]
    sigma = np.sqrt(config.correlated_px * np.stack([yy, xx], axis=-1) / det[..., None])
    good = (gain > config.min_gain) & (both > config.min_correlation * np.sqrt(energy * np.maximum(own, 1e-9)))
    good &= np.abs(shift).max(axis=-1) < config.reach * blur_px
    at = _block_centres(weight * (gx * gx + gy * gy), blocks) / np.array(template.shape[::-1])
    return _Shifts(shift, sigma / np.minimum(bounded, 1.0)[..., None], good, at)


def median_image(images: Float[np.ndarray, "n h w"]) -> Float[np.ndarray, "h w"]:
    """Median over the images, pixel by pixel: the same as NumPy's, which is ten times slower along the first axis."""
    planes = list(images.copy())
    lower = np.empty_like(planes[0])
    for a, b in _median_network(len(planes)):
        np.minimum(planes[a], planes[b], out=lower)
        np.maximum(planes[a], planes[b], out=planes[b])
        planes[a], lower = lower, planes[a]
    return 0.5 * (planes[(len(planes) - 1) // 2] + planes[len(planes) // 2])


@lru_cache(maxsize=32)
def _median_network(n: int) -> tuple[tuple[int, int], ...]:
    """Pairs to sort, one after the other, after which the middle holds the median of n.

    Batcher's odd-even merge sort (Knuth, The Art of Computer Programming 3, 5.2.2), without what the middle does not
    need.
    """
    pairs = []
    sizes = [2**k for k in range((n - 1).bit_length())]
    for size in sizes:
        for step in [s for s in reversed(sizes) if s <= size]:
            for first in range(step % size, n - step, 2 * step):
                for a in range(first, min(first + step, n - step)):
                    if a // (2 * size) == (a + step) // (2 * size):
                        pairs.append((a, a + step))
    needed, kept = {(n - 1) // 2, n // 2}, []
    for pair in reversed(pairs):
        if needed & set(pair):
            needed |= set(pair)
            kept.append(pair)
    return tuple(reversed(kept))


def _sightings(
    shifts: _Shifts,
    number: Int[np.ndarray, "n 2"],
    axis: int,
    layout: tuple[Repeats, Repeats],
    size: tuple[int, ...],
    config: CongealConfig,
) -> Sightings | None:
    """The shifts along one axis as sightings. number: (column, row) of each cell. size: (h, w) of the view."""
    cell, i, j = np.nonzero(shifts.good & (shifts.sigma[..., axis] < config.worst_sigma_px))
    if len(cell) < config.min_blocks:
        return None
    pixels = np.array([size[1], size[0]])
    at = shifts.at[i, j]
    place = np.array([r.first for r in layout]) + (number[cell] + at) * np.array([r.pitch for r in layout])
    x, y = (at - 0.5).T
    from_middle = number[cell, axis] - 0.5 * (layout[axis].cells - 1)
    shared = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y, from_middle])
    return Sightings(
        axis,
        seen=place + shifts.shift[cell, i, j] / pixels,
        known=place[:, axis].copy(),
        sigma=np.hypot(shifts.sigma[cell, i, j, axis], config.sigma_px) / pixels[axis],
        shared=shared,
        shared_sigma=np.full(shared.shape[1], config.shared_sigma),
        group=i * shifts.at.shape[1] + j,
    )


def _block_edges(n: int, block_px: float) -> Int[np.ndarray, " k"]:
    """Where the blocks along one axis of n pixels begin and end."""
    return np.linspace(0, n, max(1, round(n / block_px)) + 1).astype(int)


def _block_sums(values: Float[np.ndarray, "h w"], blocks: tuple[np.ndarray, ...]) -> Float[np.ndarray, "by bx"]:
    """Sums over blocks: as products with matrices that are 1 in a block and 0 elsewhere (_members, for both axes),
    which takes a quarter of the time of ``np.add.reduceat``."""
    down, across = blocks
    return down @ values @ across.T


@lru_cache(maxsize=16)
def _members(edges: tuple[int, ...], dtype: np.dtype) -> Float[np.ndarray, "b n"]:
    """Which places along an axis lie in which block."""
    return np.eye(len(edges) - 1, dtype=dtype).repeat(np.diff(edges), axis=1)


def _block_centres(density: Float[np.ndarray, "ch cw"], blocks: tuple[np.ndarray, ...]) -> Float[np.ndarray, "by bx 2"]:
    """Centre of mass (x, y) of each block."""
    total = np.maximum(_block_sums(density, blocks), 1e-12)
    x = _block_sums(density * centres_1d(density.shape[1]), blocks)
    y = _block_sums(density * centres_1d(density.shape[0])[:, None], blocks)
    return np.stack([x, y], axis=-1) / total[..., None]


__all__ = ["CongealConfig", "block_shifts", "median_image", "register_cells"]
