"""From the flat film with its light to the print: light and reflections removed, the grey scale kept.

In linear light the photo shows ``gain * print + black``: black is the veil, the room reflected in the sheet, and black
plus gain is what print white looks like. A network (``hybrid.levels``) reads both on a small copy. They are applied at
full resolution, so that every detail comes from the photo. A tone curve, also told by the network, then turns light
into display grey. Where the photo is clipped, or veiled until nothing is left between black and white, nothing is
known, and nothing is made up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from hybrid.coords import srgb_from_linear
from hybrid.errors import require_at_least, require_at_most
from hybrid.levels import CLIPPED, LEAST_CONTRAST, LevelReader, Levels, grey_table
from hybrid.stages import Decision
from hybrid.threads import in_strips

CLIPPED_CONTRAST = 50 / 255
"""Display grey between black and white below which clipped pixels are lost; above, they are white print. More than
``LEAST_CONTRAST``: clipped areas end sharply, and levels are read on a coarse lattice."""
FREE = 245
"""Channel values, averaged over a pixel of the small copy, below which a channel still shows the print where others are
clipped."""
HAIR = 1e-7
"""Display grey by which the film is made darker: less than any picture shows, but more than rounding adds where the
curve leaves 0."""
LEAST_SEEN = 0.1
"""Share of the film that must be seen for its light to be read."""
STRIP_ROWS = 64
"""Rows worked on at a time: few enough that all steps of a strip stay in the processor's cache."""


@dataclass(frozen=True)
class DeilluminateConfig:
    """How light and reflections are told from the print."""

    work_px: int = 512
    """Longer side of the copy on which black, white and the tone are found."""
    gain_blur: float = 0.06
    """Sigma of the blur of the gain, in parts of the film: finer variation is more often print than light."""
    even_light: float = 0.12
    """Gain (relative) and veil that vary less are left alone: the network cannot tell such light from print."""
    least_print: float = 0.02
    """Light of print black, in parts of print white: some grey is left even where the film is blackest."""
    print_black: float = 0.05
    """Display grey of the print's black surround."""
    print_white: float = 0.95
    """Display grey of the brightest parts."""

    def __post_init__(self) -> None:
        require_at_least(self, 16, "work_px")
        require_at_least(self, 1e-3, "gain_blur")
        require_at_least(self, 0, "print_black")
        require_at_most(self, 1, "print_black", "print_white", "least_print")
        require_at_least(self, self.print_black + 0.05, "print_white")


@dataclass(frozen=True, eq=False)
class LightRead:
    """A small copy of a flat film, where it shows the print, and the levels that were read from it."""

    small: UInt8[np.ndarray, "sh sw 3"]
    small_seen: Bool[np.ndarray, "sh sw"]
    levels: Levels

    def of_tone(self, root_share: float) -> LightRead:
        """The same, with another tone."""
        return replace(self, levels=replace(self.levels, root_share=root_share))


@dataclass(frozen=True, eq=False)
class Deillumination:
    """The recovered print.

    film: (h, w) float32 display grey in [0, 1]; black where the photo does not reach.
    glare: (h, w) bool, clipped or veiled in the photo: nothing could be recovered.
    confidence: (h, w) float32 in [0, 1], how much of what the photo shows there is print; 0 on glare, outside, and
        where something lies in front of the film.
    ran: whether the light was uneven, so that something was removed; reason: the evidence, with numbers.
    """

    film: Float32[np.ndarray, "h w"]
    glare: Bool[np.ndarray, "h w"]
    confidence: Float32[np.ndarray, "h w"]
    ran: bool
    reason: str


@dataclass(frozen=True)
class _ToneCurve:
    """Display grey of light x in [0, 1]: ``black + straight * x + root * sqrt(x)``. It is monotone, because root is
    not negative and straight is at most half as large where it is below 0."""

    black: float
    straight: float
    root: float

    @property
    def least(self) -> float:
        """The light at which the curve leaves 0."""
        if self.black >= 0:
            return 0.0
        if self.root == 0:
            return -self.black / self.straight
        # the positive root of straight * r^2 + root * r + black, r = sqrt(x), without loss of digits
        return (2 * self.black / (self.root + np.sqrt(self.root**2 - 4 * self.straight * self.black))) ** 2


def deilluminate(
    rectified: UInt8[np.ndarray, "h w 3"],
    valid: Bool[np.ndarray, "h w"],
    reader: LevelReader,
    config: DeilluminateConfig | None = None,
    covered: Bool[np.ndarray, "h w"] | None = None,
) -> Deillumination:
    """The print in display grey from the flat film with its light.

    reader: reads the levels of black and white. covered: where something lies in front of the film: it says nothing
    about the light, and stays in the film, with no confidence.
    """
    config = config or DeilluminateConfig()
    print_seen = valid if covered is None else valid & ~covered
    return recovered(rectified, valid, print_seen, read_light(rectified, print_seen, reader, config), config)


def read_light(
    rectified: UInt8[np.ndarray, "h w 3"], print_seen: Bool[np.ndarray, "h w"], reader: LevelReader,
    config: DeilluminateConfig,
) -> LightRead:  # fmt: skip
    """The light of a flat film, read where the photo shows the print."""
    small, small_seen = _small_copy(rectified, print_seen, config.work_px)
    return LightRead(small, small_seen, read_levels(small, small_seen, reader, config.gain_blur))


def recovered(
    rectified: UInt8[np.ndarray, "h w 3"], valid: Bool[np.ndarray, "h w"], print_seen: Bool[np.ndarray, "h w"],
    light: LightRead, config: DeilluminateConfig,
) -> Deillumination:  # fmt: skip
    """The print of a flat film whose light was read."""
    small, small_seen, levels = light.small, light.small_seen, light.levels
    decision = survey_light(levels.gain, levels.black / np.median(levels.gain), config.even_light)
    if decision.yes:
        even_black, even_gain = (np.full_like(x, np.median(x)) for x in (levels.black, levels.gain))
        levels = replace(levels, black=even_black, gain=even_gain)
    table = grey_table()
    even = _even(_linear_grey(small, table), levels)
    contrast = _contrast(levels, 0.0, 1.0)
    on_small = cv2.resize(contrast, even.shape[::-1], interpolation=cv2.INTER_LINEAR)
    black, white = _print_range(even, small_seen & (on_small >= LEAST_CONTRAST))
    tone = _tone_curve(min(black / white + config.least_print, 1.0), levels.root_share, config)
    film = _apply(rectified, table, replace(levels, gain=levels.gain * np.float32(white)), config.least_print, tone)
    clipped = np.zeros(film.shape, bool)
    if small.max() >= CLIPPED:  # glare wider than a stroke shows on the small copy; most films have none
        clipped = find_clipped(rectified)
        contrast = _contrast_of_free(on_small, small, table, levels.gain)
    glare = _lost(contrast, clipped)
    if _contrast(levels, black, white).max() < LEAST_CONTRAST:  # black and white are told apart nowhere
        glare[:] = True
    if not print_seen.all():
        film[~valid] = 0.0
        glare &= print_seen
    note = f"{decision.reason}; {clipped.mean():.1%} clipped, {glare.mean():.1%} lost"
    return Deillumination(film, glare, _confidence(levels, glare, print_seen), not decision.yes, note)


def find_clipped(rectified: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Where all channels are clipped on most pixels around: noise leaves holes in clipped areas.

    White strokes that just reach the limit are white print; thinner than a hundred and fiftieth of the film, they do
    not count.
    """
    clipped = cv2.inRange(rectified, (CLIPPED, CLIPPED, CLIPPED), (255, 255, 255))
    if cv2.countNonZero(clipped) == 0:
        return clipped.astype(bool)
    width = 4 * (max(rectified.shape[:2]) // 300) + 1
    return cv2.blur(clipped, (width, width)) > 127


def survey_light(gain: Float[np.ndarray, "gh gw"], veil: Float[np.ndarray, "vh vw"], even: float) -> Decision:
    """Whether the light is even: over the film ``gain`` varies by less than ``even`` (relative), and ``veil``, given
    in parts of the light of white, by less than a third of that, as a veil shows more on black than a gain on white."""
    spread = float(np.percentile(gain, 98) / max(float(np.percentile(gain, 2)), 1e-6) - 1.0)
    lift = float(np.percentile(veil, 98) - np.percentile(veil, 2))
    text = f"light varies by {spread:.0%}, reflections by {lift:.1%} of white over the film"
    return Decision(spread <= even and lift <= even / 3, text)


# ---------------------------------------------------------------- light in grey


def read_levels(
    film: UInt8[np.ndarray, "h w 3"], seen: Bool[np.ndarray, "h w"], reader: LevelReader, gain_blur: float
) -> Levels:
    """The levels of a film, with the logarithm of the gain blurred; even light, from black to white, where too little
    is seen.

    gain_blur: sigma, in parts of the film.
    """
    size = (reader.side_px, reader.side_px)
    square, seen_there = cv2.resize(film, size, interpolation=cv2.INTER_AREA), share_seen(seen, size) > 0.99
    if seen_there.mean() < LEAST_SEEN:
        return Levels(np.zeros((1, 1), np.float32), np.ones((1, 1), np.float32))
    read = reader.read(square, seen_there)
    sigma = gain_blur * len(read.gain)
    logs = cv2.GaussianBlur(np.log(read.gain), (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    return replace(read, gain=np.exp(logs))


def _small_copy(
    rectified: UInt8[np.ndarray, "h w 3"], valid: Bool[np.ndarray, "h w"], longer_px: int
) -> tuple[UInt8[np.ndarray, "sh sw 3"], Bool[np.ndarray, "sh sw"]]:
    """The film and its validity averaged down to about ``longer_px``; a pixel is valid if all those that it averages
    are.

    Whole numbers of pixels are averaged, which is several times as quick; what is left over at the right and bottom
    edges (less than 1 % of the film) does not matter to fields as smooth as these.
    """
    shrink = max(round(max(rectified.shape[:2]) / longer_px), 1)
    height, width = (max(n // shrink, 1) for n in rectified.shape[:2])
    kept = (slice(0, height * shrink), slice(0, width * shrink))
    small = cv2.resize(rectified[kept], (width, height), interpolation=cv2.INTER_AREA)
    return small, share_seen(valid[kept], (width, height)) > 0.999


def share_seen(valid: Bool[np.ndarray, "h w"], size: tuple[int, int]) -> Float32[np.ndarray, "sh sw"]:
    """Share of each pixel of a picture of ``size`` (width, height) where a mask, such as that of valid pixels, is true.
    Usually all of the mask is true, which is quick."""
    if valid.all():
        return np.ones(size[::-1], np.float32)
    return cv2.resize(valid.astype(np.float32), size, interpolation=cv2.INTER_AREA)


def _linear_grey(image: UInt8[np.ndarray, "h w 3"], table: Float32[np.ndarray, "256 3"]) -> Float32[np.ndarray, "h w"]:
    """Linear grey of sRGB pixels."""
    red, green, blue = (cv2.LUT(x, np.ascontiguousarray(table[:, k])) for k, x in enumerate(cv2.split(image)))
    return cv2.add(cv2.add(red, green, dst=red), blue, dst=red)


def _even(grey: Float32[np.ndarray, "h w"], levels: Levels) -> Float32[np.ndarray, "h w"]:
    """Light of the print on a small copy: 0 where it is black, 1 where it is white."""
    gain, black = (cv2.resize(x, grey.shape[::-1], interpolation=cv2.INTER_LINEAR) for x in (levels.gain, levels.black))
    return np.maximum((grey - black) / gain, np.float32(0))


# ---------------------------------------------------------------- tone and output


def _print_range(even: Float32[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"]) -> tuple[float, float]:
    """The light of the print's black and of its white: all but a few hundredths of the film are brighter than black,
    and all but a few thousandths darker than white."""
    seen = even[::2, ::2][known[::2, ::2]]
    if not seen.size:
        return 0.0, 1.0
    black, white = np.quantile(seen, (0.02, 0.997))
    return float(black), max(float(white), 1e-4)


def _tone_curve(black: float, share: float, config: DeilluminateConfig) -> _ToneCurve:
    """The tone curve with a given root share that maps the film's black (white: 1) and white to those of a print."""
    low = (1.0 - share) * black + share * np.sqrt(black)
    contrast = (config.print_white - config.print_black) / max(1.0 - low, 0.1)
    return _ToneCurve(config.print_black - contrast * low, contrast * (1.0 - share), contrast * share)


def _apply(
    rectified: UInt8[np.ndarray, "h w 3"], table: Float32[np.ndarray, "256 3"], levels: Levels, least: float,
    tone: _ToneCurve,
) -> Float32[np.ndarray, "h w"]:  # fmt: skip
    """Display grey of the whole film, strip by strip. least: light of print black."""
    height, width = rectified.shape[:2]
    film = np.empty((height, width), np.float32)
    fields = (1.0 / levels.gain, least - levels.black / levels.gain)
    rows = [cv2.resize(x.astype(np.float32), (x.shape[1], height), interpolation=cv2.INTER_LINEAR) for x in fields]

    def apply(part: slice) -> None:
        even = _linear_grey(rectified[part], table)
        scale, shift = (cv2.resize(x[part], even.shape[::-1], interpolation=cv2.INTER_LINEAR) for x in rows)
        cv2.add(cv2.multiply(even, scale, dst=even), shift, dst=even)
        np.clip(even, tone.least, 1.0, out=even)
        cv2.addWeighted(even, tone.straight, cv2.sqrt(even), tone.root, tone.black - HAIR, dst=film[part])
        np.clip(film[part], 0.0, 1.0, out=film[part])

    in_strips(apply, height, STRIP_ROWS)
    return film


def _contrast(levels: Levels, black: float, white: float) -> Float32[np.ndarray, "h w"]:
    """Display grey between the print's black and white. black, white: their light (0 and 1: that of the levels)."""
    return _shown_between(*(levels.black + x * levels.gain for x in (black, white)))


def _shown_between(dark: Float32[np.ndarray, "*n"], bright: Float32[np.ndarray, "*n"]) -> Float32[np.ndarray, "*n"]:
    """Display grey between two linear greys."""
    dark, bright = (srgb_from_linear(np.clip(x, 0, 1)) for x in (dark, bright))
    return (bright - dark).astype(np.float32)


def _contrast_of_free(
    contrast: Float32[np.ndarray, "sh sw"], small: UInt8[np.ndarray, "sh sw 3"],
    table: Float32[np.ndarray, "256 3"], gain: Float32[np.ndarray, "h w"],
) -> Float32[np.ndarray, "sh sw"]:  # fmt: skip
    """The contrast on a small copy, but where some channels are clipped, that of the others: the whole gain is theirs.

    gain: on any lattice.
    """
    free = small < FREE
    partly = free.any(axis=2) & ~free.all(axis=2)
    if not partly.any():
        return contrast
    share = free[partly] @ table[-1]
    light = (table[small[partly], range(3)] * free[partly]).sum(axis=1) / share
    reach = cv2.resize(gain, contrast.shape[::-1], interpolation=cv2.INTER_LINEAR)[partly] / share / 2
    left = contrast.copy()
    left[partly] = _shown_between(light - reach, light + reach)
    return left


def _lost(contrast: Float32[np.ndarray, "h w"], clipped: Bool[np.ndarray, "h2 w2"]) -> Bool[np.ndarray, "h2 w2"]:
    """Where too little is left between black and white; for clipped pixels, by the mean contrast of the clipped pixels
    around."""
    some = bool(clipped.any())
    if not some and contrast.min() >= LEAST_CONTRAST:
        return np.zeros(clipped.shape, bool)
    lost = cv2.resize(contrast, clipped.shape[::-1], interpolation=cv2.INTER_LINEAR) < LEAST_CONTRAST
    if some:
        share = share_seen(clipped, contrast.shape[::-1])
        width = (max(contrast.shape) // 25 + 1,) * 2
        around = cv2.blur(contrast * share, width) / np.maximum(cv2.blur(share, width), np.float32(1e-6))
        lost |= clipped & (cv2.resize(around, clipped.shape[::-1], interpolation=cv2.INTER_LINEAR) < CLIPPED_CONTRAST)
    return lost


def _confidence(
    levels: Levels, glare: Bool[np.ndarray, "h w"], seen: Bool[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w"]:
    """Share of the print's contrast in what the photo shows, relative to the usual light; 0 where unknown.

    The photo's noise grows with its light, and is amplified as the print's share of that light falls.
    """
    lit = np.minimum(levels.gain / max(float(np.median(levels.gain)), 1e-9), 1.0)
    share = np.clip(levels.gain / np.maximum(levels.gain + np.maximum(levels.black, 0.0), 1e-9) * lit, 0.0, 1.0)
    trust = cv2.resize(share.astype(np.float32), glare.shape[::-1], interpolation=cv2.INTER_LINEAR)
    if glare.any() or not seen.all():
        trust[glare | ~seen] = 0.0
    return trust
