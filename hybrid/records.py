"""The frozen records that pass between stages: one for each arrow in the design's data flow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap, Orientation
from hybrid.errors import ConfigError, describe

Photo = TypeVar("Photo")

# ---------------------------------------------------------------- what the network sees


@dataclass(frozen=True, eq=False)
class CoarseMaps:
    """What the network predicts, at its own resolution, for a view: the whole photo, or the film flattened by a plane.

    mask: probability that a pixel shows film.
    uv: coordinates of the film as it is seen (backward.film_as_seen), meaningful where the mask is high.
    xyz: 3D coordinates in camera axes turned and mirrored with the view, relative to the film's centre, in units of the
        film's diagonal.
    albedo: display grey of the print in [0, 1], blurred to the network's resolution.
    photo_points: (h, w, 2) photo points (full-resolution pixels) of the pixel centres.
    expected_error: how wrong the network expects uv to be, in film units; None where it does not say.
    phases: cosine and sine of where in its cell each pixel lies, a full turn from cell to cell: across the film, then
        down. The shorter the pair, the less sure the network is. in_grid: probability that a film pixel lies in a cell.
        covered: probability that something lies in front of a pixel of the sheet. None where the network does not say.
    """

    mask: Float[np.ndarray, "h w"]
    uv: Float[np.ndarray, "h w 2"]
    xyz: Float[np.ndarray, "h w 3"]
    albedo: Float[np.ndarray, "h w"]
    photo_points: Float[np.ndarray, "h w 2"]
    expected_error: Float[np.ndarray, "h w"] | None = None
    phases: Float[np.ndarray, "h w 2 2"] | None = None
    in_grid: Float[np.ndarray, "h w"] | None = None
    covered: Float[np.ndarray, "h w"] | None = None

    @property
    def film(self) -> Bool[np.ndarray, "h w"]:
        """Pixels that show film, more likely than not."""
        return np.asarray(self.mask >= 0.5)

    def enlarged(self, factor: int) -> CoarseMaps:
        """The same for the photo enlarged ``factor`` times."""
        return replace(self, photo_points=self.photo_points * factor)


# ---------------------------------------------------------------- what the print says


@dataclass(frozen=True, eq=False)
class SliceGrid:
    """The grid of slices found on the film.

    rows, cols: number of slices down and across.
    vertices: (rows + 1, cols + 1, 2) film uv of the corners of the cells, row 0 the top.
    vertices_photo: (rows + 1, cols + 1, 2) the same corners as photo points.
    confidence: in [0, 1], how well the photo supports the grid.
    """

    rows: int
    cols: int
    vertices: Float[np.ndarray, "r c 2"]
    vertices_photo: Float[np.ndarray, "r c 2"]
    confidence: float

    def __post_init__(self) -> None:
        expected = (self.rows + 1, self.cols + 1, 2)
        for name in ("vertices", "vertices_photo"):
            got = getattr(self, name).shape
            if got != expected:
                raise ValueError(f"SliceGrid.{name}: got shape {got}; allowed: {expected}")
        if not 0.0 <= self.confidence <= 1.0:
            raise ValueError(f"SliceGrid.confidence: got {self.confidence}; allowed: [0, 1]")

    def along(self, axis: int) -> tuple[float, float, int]:
        """Film coordinate at which the first cell begins, pitch, and number of cells, across (0) or down (1)."""
        lines = self.vertices[0, :, 0] if axis == 0 else self.vertices[:, 0, 1]
        cells = len(lines) - 1
        return float(lines[0]), float(lines[-1] - lines[0]) / cells, cells

    @property
    def margins(self) -> Float[np.ndarray, "2 2"]:
        """Film between the sheet's edges and the grid, in film units: left and top, then right and bottom."""
        return np.stack([self.vertices[0, 0], 1.0 - self.vertices[-1, -1]])

    @property
    def lopsided(self) -> float:
        """How much the margins on opposite sides of the grid differ, along the worse axis, in film units."""
        before, after = self.margins
        return float(np.abs(before - after).max())

    def turned(self, way: Orientation) -> SliceGrid:
        """The grid of the film after it was moved as ``way`` says; see ``BackwardMap.turned``."""
        vertices, photo = (way.moved(points) for points in (way.film_from_seen(self.vertices), self.vertices_photo))
        rows, cols = photo.shape[0] - 1, photo.shape[1] - 1
        return SliceGrid(rows, cols, vertices.copy(), photo.copy(), self.confidence)


# ---------------------------------------------------------------- the result


class StatusCode(Enum):
    """How a rectification ended; the value is the sentence shown to a person."""

    OK = "The film was found and flattened."
    UNSURE = (
        "A film was found and flattened, but parts of it may be off by more than a few pixels. Compare it with the "
        "photo; for a surer result, photograph the whole sheet from the front, on a plain background, without glare."
    )
    NO_FILM = (
        "No film was found in the photo. Photograph the whole sheet, edges included, "
        "so that it fills at least a third of the picture; one film per photo. "
        "If there is one, give its corners (--corners of hybrid rectify)."
    )
    CUT_OFF = (
        "A film was seen, but a large part of the sheet lies outside the photo. "
        "Step back, so that all four edges are in the picture. "
        "If they are, give its corners (--corners of hybrid rectify)."
    )
    PAPER = (
        "The photo shows dark print on a bright sheet, as on paper, not bright print on dark, as on CT films. "
        "Photograph a film; invert the picture of a negative first."
    )
    TOO_SMALL = "The photo is too small. Use one of at least 64 x 64 pixels; 1000 or more are better."
    BLANK = "The photo shows nothing (all of it has one colour). Check the lens and the exposure and take it again."
    FOLDED = (
        "A film was seen, but its shape could not be made out (the map folds over itself). "
        "Hold the sheet flatter, photograph it from the front, and avoid covering it; "
        "or give its corners (--corners of hybrid rectify)."
    )


@dataclass(frozen=True)
class Status:
    """How a rectification ended: ``status.ok``, and ``str(status)`` for a person.

    ok: the film lies where the result says. has_film: there is a film, sure (ok) or not (``StatusCode.UNSURE``).
    doubts: why it is not sure, each in a few words.
    """

    code: StatusCode
    doubts: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        return self.code is StatusCode.OK

    @property
    def has_film(self) -> bool:
        return self.code in (StatusCode.OK, StatusCode.UNSURE)

    def __str__(self) -> str:
        return self.code.value


@dataclass(frozen=True)
class StageReport:
    """One stage of a rectification: whether it ran, the evidence for that, and the seconds it took."""

    name: str
    ran: bool
    reason: str
    seconds: float

    def __str__(self) -> str:
        return f"{self.name:<14} {'ran' if self.ran else 'skipped':<8} {1e3 * self.seconds:7.1f} ms  {self.reason}"


@dataclass(frozen=True)
class LeftOut:
    """A photo that a fused film is not made of: its index among the given photos, and why."""

    photo: int
    why: str


@dataclass(frozen=True)
class Signs:
    """The evidence for and against a map.

    overlap_before: intersection over union of the network's mask with the sheet's outline before refinement.
    overlap_after: the same for the mask seen in one more look and the outline of the finished map.
    alike: share of detail that the cells have in common, beyond chance; 0 without a grid.
    grid: whether the grid is known along both axes. corrected: whether the correction was believed.
    edges: number of the sheet's edges that were seen.
    film_px, photo_px: side of a square of the film's area in the photo, and the photo's longer side.
    levels: number of grey levels, of 255, that the photo uses.
    support: mean probability that the sheet's edge lies where the finished map puts it, for the side where it is least.
    in_step: agreement of the grid with the cells seen in the last look, along the worse axis; 0 without a grid.
    seen_beside: root mean square over the film of the displacement between the finished map and what that look sees,
        smoothed to a quadratic function of film points, as a fraction of the film's size.
    stated: the error that refinement itself expects, as a fraction of the film's size.
    edges_beside: distance between an edge as it is read and as the finished map has it, at the median along the edge
        where it is largest, in film units.
    borders_shown: mean probability that borders between cells are visible where the grid has them.
    lopsided: ``SliceGrid.lopsided`` of the grid.
    sheet: whether a bent sheet explains what was seen.
    flat: whether the photo was found to be the flat film itself; then only ``lopsided`` and ``off_frame`` count.
    off_frame: for such a photo, how far from its frame a refinement started there ends, in parts of the film's size.
    doubted: how many refinements of the film had been tried and left a doubt; at least 1 where it was in doubt at
        first, so that this is one of several.
    weakest: the edge with the least support, as the film lies in the photo: top, bottom, left or right.
    outside: edges, named the same way, that lie mostly outside the photo.
    near: whether the film shows only in a look at a part of the photo.
    goes_on: how likely the edges of a longer sheet are, in which the print fits less well; 0 where there is none.
    """

    overlap_before: float
    overlap_after: float
    alike: float
    grid: bool
    corrected: bool
    edges: int
    film_px: float
    photo_px: int
    levels: float
    support: float
    in_step: float
    seen_beside: float
    stated: float
    edges_beside: float
    borders_shown: float
    lopsided: float
    sheet: bool
    flat: bool = False
    off_frame: float = 0.0
    doubted: int = 0
    weakest: str = "weakest"
    outside: tuple[str, ...] = ()
    near: bool = False
    goes_on: float = 0.0


@dataclass(frozen=True, eq=False)
class RectifyResult:
    """All that is known about one photo. Everything but status and stages is None unless ``status.has_film``.

    film: (h, w) float32 display grey in [0, 1]: flat, light removed.
    rectified: (h, w, 3) uint8 sRGB: flat, light kept.
    backward: the map from film uv to photo points.
    grid: the slice grid, or None where none was found.
    orientation: how the film was moved, from the way it lay in the photo, to read right; not at all if that is unsure.
    upright_probability: probability that the film as returned reads right; None if nothing could be read.
    glare: (h, w) bool, where the photo is so clipped or veiled that nothing could be recovered. Not beyond the photo's
        edge, where the film is black and its confidence 0.
    covered: (h, w) bool, where something hides the film (a hand, a clip, tape): the film shows it, not the print.
    confidence: (h, w) float32 in [0, 1], how far the film can be trusted; 0 on glare, where it is covered, and beyond
        the photo or the sheet's round corners.
    expected_error_px: mean distance, in pixels of the photo, by which film points are expected to be off; the true one
        is larger as often as smaller.
    limit_px: largest error, in pixels of the photo, that the status OK allows. The true one must be smaller with a
        probability of 95 % (``TrustConfig.least_chance``), and nothing else may speak against the film
        (``status.doubts``).
    signs: the evidence for and against the map, from which both are computed (``rectify/verdict/trust.py``).
    photo_size: height and width of the photo in pixels.
    photo: for a film fused from several photos, the index of the photo that rectified, backward and the grid's vertices
        in the photo are of: the first whose map is sure, or else the first that shows a film. photos: how many photos
        were given to be fused; 1 for other films.
    left_out: the photos that the film is not made of.
    """

    status: Status
    stages: tuple[StageReport, ...] = ()
    film: Float[np.ndarray, "h w"] | None = field(default=None, repr=False)
    rectified: UInt8[np.ndarray, "h w 3"] | None = field(default=None, repr=False)
    backward: BackwardMap | None = field(default=None, repr=False)
    grid: SliceGrid | None = field(default=None, repr=False)
    orientation: Orientation | None = None
    upright_probability: float | None = None
    glare: Bool[np.ndarray, "h w"] | None = field(default=None, repr=False)
    covered: Bool[np.ndarray, "h w"] | None = field(default=None, repr=False)
    confidence: Float[np.ndarray, "h w"] | None = field(default=None, repr=False)
    expected_error_px: float | None = None
    limit_px: float | None = None
    signs: Signs | None = None
    photo_size: tuple[int, int] | None = None
    photo: int = 0
    photos: int = 1
    left_out: tuple[LeftOut, ...] = ()

    def made_of(self, photos: Sequence[Photo]) -> list[Photo]:
        """Those of the given photos that the film is made of, in their order."""
        without = {one.photo for one in self.left_out}
        return [photo for index, photo in enumerate(photos) if index not in without]

    def of_photo(self, size: tuple[int, ...], where: object = None) -> None:
        """Refuse a photo whose ``size`` (height, width) differs from that of the photo that this result is of.

        Raises:
            ConfigError: it is a different photo.
        """
        if self.photo_size is not None and tuple(size[:2]) != self.photo_size:
            got, allowed = (f"{w} x {h} pixels" for h, w in (size[:2], self.photo_size))
            do = "Name the photo that the result is of."
            raise ConfigError(describe(what="Another photo", where=where, got=got, allowed=allowed, do=do))

    def slices(self) -> list[Float[np.ndarray, "sh sw"]]:
        """The slice images cut out of the film, row by row; empty where no grid was found."""
        if self.film is None or self.grid is None:
            return []
        size = np.array(self.film.shape[::-1], dtype=np.float64)
        corners = np.rint(np.clip(self.grid.vertices, 0.0, 1.0) * size).astype(int)
        cells = []
        for i in range(self.grid.rows):
            for j in range(self.grid.cols):
                (x0, y0), (x1, y1) = corners[i, j], corners[i + 1, j + 1]
                cells.append(self.film[y0:y1, x0:x1])
        return cells
