"""Where the sheet ends across its edge, to a fraction of a pixel: at a step, or at the outer flank of a printed rule.

A bright rule along the very edge of the print has two steps, and the inner one, to the black film, is usually steeper.
So profiles across the edge are fitted twice by least squares: as a blurred step between two levels, and with a thin
band of a third level at the sheet's end. The band counts where it explains the whole side far better and is brighter
than what lies on both sides of it: it is then neither a shadow nor the bright seam left by a camera's sharpening. If a
rule lies along another edge of the sheet, weaker evidence is enough.

Wider bands, such as bright gutters around the print or a narrow margin of clear film, are found in the same way, and
their outer flank is located by itself. But bars and gaps beside the film look alike, so edges/outline.py requires such
bands on two sides, with the edge read near that flank.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr

from hybrid.coords import linear_from_srgb
from hybrid.rectify.edges.curves import parabola_peak

REACH = 4
"""Pixels from the path within which the edge lies."""
PLACES = np.arange(-REACH, REACH + 1e-9, 0.25)
"""Places of the edge that are tried, in pixels from the path; inwards is positive."""
BEYOND = 5
"""Pixels beyond these places that the models explain."""
BLURS_PX = (0.45, 0.8, 1.3)
"""Standard deviations of the blur that are tried."""
MORE_BLUR_PX = 2.1
"""One more where frames are thought of: a rule that is out of focus looks as wide as a frame."""
RULES_PX = (0.9, 2.0)
"""Widths of rules that are tried. Thinner ones differ only in level, so their width cannot be told."""
FRAMES_PX = (3.4, 4.2, 5.2, 6.4)
"""The same for frames."""
OUTSIDE = 1.5
"""Pixels by which the path may lie outside a frame."""
FLANK_PX = 0.8
"""Spread of the filter that locates a frame's outer flank."""
WIDER = 0.6
"""By how much better any wider band must explain a side than the thinnest one does, measured as LEAST_GAIN."""
LEAST_GAIN = 1.4
"""Natural logarithm by which a rule must lower the unexplained share of the variance, at the median of a side's
profiles."""
LEAST_EXCESS = 0.35
"""How much brighter a rule must be than what lies beside it, in parts of the contrast between both sides."""
EXPECTED_GAIN, EXPECTED_EXCESS = 0.8, 0.2
"""The same where a rule is expected: it must be brighter than the film, and may be darker than the background."""
JUDGED_EVERY = 3
"""One profile in so many is used to decide whether there is a rule."""
UNEXPLAINED = 2e-3
"""Share of a profile's variance that no model is asked to explain."""
BESIDE = 8
"""Pixels beyond REACH whose medians are the levels on both sides of a step."""

CLIPPED = 248.0
"""Grey level from which the photo is taken to be clipped."""


@dataclass(frozen=True, eq=False)
class Profiles:
    """Profiles across an edge, from outside (top) to inside, around a path along it.

    path: row of each in the strip that they come from. light: linear, n = 2 (REACH + BESIDE) + 1 rows with the path in
    the middle one. clipped: for each, whether the photo is clipped in all colours outside the edge.
    """

    path: Int[np.ndarray, " p"]
    light: Float[np.ndarray, "n p 3"]
    clipped: Bool[np.ndarray, " p"]

    def around(self, rows: Int[np.ndarray, " r"]) -> Float[np.ndarray, "r p 3"]:
        """Some consecutive rows, counted from the path."""
        first = len(self.light) // 2 + int(rows[0])
        return self.light[first : first + len(rows)]

    @cached_property
    def may_have_frame(self) -> bool:
        """Whether some rows are brighter than those on both sides of them, at the median: else there is no frame to
        look for."""
        level = np.median(self.around(_rows(FRAMES_PX)).mean(axis=-1), axis=1)
        band = np.minimum(np.minimum(level[:-2], level[1:-1]), level[2:]).max()
        outer, inner = float(np.median(level[:3])), float(np.median(level[-4:]))
        return bool(band > max(outer, inner) + 0.5 * LEAST_EXCESS * abs(outer - inner))


def profiles_along(image: Float[np.ndarray, "d p 3"], path: Int[np.ndarray, " p"]) -> Profiles:
    """The profiles of a strip of grey levels around a path: one row for each column."""
    beyond = REACH + BESIDE
    padded = np.pad(image, ((beyond, beyond), (0, 0), (0, 0)), mode="edge")
    grey = padded[path + np.arange(2 * beyond + 1)[:, None], np.arange(len(path))]
    clipped = np.median(grey[: beyond - 3], axis=0).min(axis=-1) >= CLIPPED
    # Blur adds up light, not grey levels: in grey levels a blurred step is steepest on its dark side.
    return Profiles(path, linear_from_srgb(grey / 255.0), clipped)


@dataclass(frozen=True, eq=False)
class EndOfSheet:
    """Where the sheet ends in a strip across its edge.

    rows: of each profile, to a fraction. band_px: width of the rule or frame printed along it, whose outer flank was
    found; 0 for none. clipped: for each profile, whether the photo is clipped in all colours outside the edge.
    """

    rows: Float[np.ndarray, " p"]
    band_px: float
    clipped: Bool[np.ndarray, " p"]

    @property
    def has_rule(self) -> bool:
        """Whether a rule is printed along it."""
        return self.band_px > 0.0 and not self.has_frame

    @property
    def has_frame(self) -> bool:
        """Whether the band printed along it is wider than a rule is: the print ends inside it."""
        return _is_frame(self.band_px)


def end_of_sheet(profiles: Profiles, expected: bool, frames: bool = False) -> EndOfSheet:
    """Where the sheet ends across its edge, within REACH of the path; with a frame, as much further out as the frame is
    wider than a rule.

    expected: whether a band is likely, because other edges have one. frames: whether bands wider than rules are
    considered; if one is expected, only these are.
    """
    wide = FRAMES_PX if expected else RULES_PX + FRAMES_PX
    band = banded_edge(profiles, wide if frames else RULES_PX, expected)
    at, width = (stepped_edge(profiles.light), 0.0) if band is None else band
    return EndOfSheet(profiles.path + at, width, profiles.clipped)


def stepped_edge(local: Float[np.ndarray, "n p 3"]) -> Float[np.ndarray, " p"]:
    """Pixels from the middle row of linear profiles to the steepest place of the step near it."""
    middle = len(local) // 2
    outer, inner = (np.median(side, axis=0) for side in (local[: middle - 3], local[middle + 4 :]))
    step = outer - inner
    direction = step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-6)
    slope = -gaussian_filter1d(np.einsum("dpc,pc->dp", local, direction), 1.0, axis=0, order=1)
    return parabola_peak(slope[middle - REACH - 1 : middle + REACH + 2]) - REACH - 1


def banded_edge(
    profiles: Profiles, widths: tuple[float, ...], expected: bool
) -> tuple[Float[np.ndarray, " p"], float] | None:
    """Pixels from the path to the outer flank of a band along the edge, and the band's width; None without one."""
    rows = _rows(widths)
    local = profiles.around(rows)
    bases, inverses = _models(widths)
    some = local[:, 1::JUDGED_EVERY]
    score = np.median(_unexplained(bases[:, :, ::2], some).min(axis=2), axis=2)  # by width and blur of the model
    best = score.min(axis=1)
    best[2:] += 0.0 if _is_frame(widths[0]) else WIDER
    k = 1 + int(np.argmin(best[1:]))
    if best[0] - best[k] < (EXPECTED_GAIN if expected else LEAST_GAIN):
        return None
    model, width = (k, int(np.argmin(score[k]))), widths[k - 1]
    at = parabola_peak(-_unexplained(bases[model], local))
    nearest = np.rint(at).astype(np.intp)
    outer, inner, band = np.einsum("pkn,npc->kpc", inverses[model][nearest], local)
    contrast = np.linalg.norm(outer - inner, axis=-1)
    if expected and not _is_frame(width):
        excess, least = (band - inner).mean(axis=-1), EXPECTED_EXCESS
    else:
        excess, least = np.linalg.norm(np.maximum(band - np.maximum(outer, inner), 0.0), axis=-1), LEAST_EXCESS
    if np.median(excess - least * contrast) <= 0.0:
        return None
    place = np.interp(at, np.arange(len(PLACES)), _places(width))
    if _is_frame(width):  # its flanks are apart: only the outer one tells where it is
        place = rows[0] + _steepest(local, band - outer, np.rint(place - rows[0]).astype(np.intp))
    return place, width


def _steepest(
    local: Float[np.ndarray, "n p 3"], rise: Float[np.ndarray, "p 3"], near: Int[np.ndarray, " p"]
) -> Float[np.ndarray, " p"]:
    """Row, to a fraction, at which each profile rises most along its own direction of colour, within 1 of ``near``."""
    slope = gaussian_filter1d(np.einsum("npc,pc->np", local, rise), FLANK_PX, axis=0, order=1)
    first = np.clip(near - 2, 0, len(local) - 5)
    return first + parabola_peak(np.take_along_axis(slope, first + np.arange(5)[:, None], axis=0))


def _places(width: float) -> Float[np.ndarray, " x"]:
    """The places tried for an edge along which a band of some width is printed: the path may follow either flank of a
    frame."""
    if not _is_frame(width):
        return PLACES
    return np.linspace(-REACH - (width - RULES_PX[-1]), OUTSIDE, len(PLACES))


def _is_frame(width: float) -> bool:
    """Whether a band is wider than any rule."""
    return width > RULES_PX[-1]


def _rows(widths: tuple[float, ...]) -> Int[np.ndarray, " n"]:
    """Pixels around the path that the models explain, for bands up to these widths."""
    outermost = int(np.floor(_places(widths[-1])[0])) - BEYOND
    return np.arange(max(outermost, -REACH - BESIDE), REACH + BEYOND + 1)


def _unexplained(bases: Float[np.ndarray, "*models k n"], local: Float[np.ndarray, "n p 3"]) -> np.ndarray:
    """(*models, p) logarithm of the share of each profile's variance that each model leaves unexplained."""
    squares = bases.reshape(-1, len(local)) @ local.reshape(len(local), -1)
    np.square(squares, out=squares)
    colours = squares.reshape(*bases.shape[:-1], -1).sum(axis=-2)
    explained = colours[..., 0::3] + colours[..., 1::3] + colours[..., 2::3]  # NumPy sums slowly along so short an axis
    total, variance = (np.square(y).sum(axis=(0, 2)) for y in (local, local - local.mean(axis=0)))
    return np.log(np.maximum(total - explained, 0.0) / np.maximum(variance, 1e-5) + UNEXPLAINED)


@lru_cache(maxsize=3)
def _models(widths: tuple[float, ...]) -> tuple[Float[np.ndarray, "w s x k n"], Float[np.ndarray, "w s x k n"]]:
    """For no band and each width of one, each blur and each place: an orthonormal basis of the profiles, and the
    pseudo-inverse that gives their levels outside, inside and in the band."""
    rows = _rows(widths)
    blurs = (*BLURS_PX, MORE_BLUR_PX) if _is_frame(widths[-1]) else BLURS_PX
    shape = (1 + len(widths), len(blurs), len(PLACES), 3, len(rows))
    bases, inverses = np.zeros(shape), np.zeros(shape)
    for w, width in enumerate((0.0, *widths)):
        for s, blur in enumerate(blurs):
            for x, place in enumerate(_places(width)):
                begins, ends = (ndtr((rows - place - offset) / blur) for offset in (0.0, width))
                levels = np.stack([1 - begins, ends, begins - ends][: 3 if width else 2], axis=-1)
                bases[w, s, x, : levels.shape[1]] = np.linalg.qr(levels)[0].T
                inverses[w, s, x, : levels.shape[1]] = np.linalg.pinv(levels)
    return bases, inverses


__all__ = ["EndOfSheet", "Profiles", "banded_edge", "end_of_sheet", "profiles_along", "stepped_edge"]
