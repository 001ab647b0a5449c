"""From the flat film with its light to the print: light and reflections removed, the grey scale kept.

In linear light the photo shows ``a * film + b``, with a smooth gain a (light through and onto the sheet) and a veil b
(the room reflected in it). The black between the slices pins b, the white texts and bone pin a; both are found on a
small copy, and applied at full resolution so that every detail comes from the photo. One tone curve for all films then
turns light into display grey. Where the photo is clipped, or veiled until nothing is left between black and white,
nothing is known, and nothing is made up.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from hybrid.coords import linear_from_srgb, srgb_from_linear
from hybrid.errors import require_at_least
from hybrid.records import SliceGrid
from hybrid.rectify.light import Light, LightConfig, find_light, share_seen
from hybrid.rectify.reflections import ReflectionConfig, find_reflections
from hybrid.rectify.survey import survey_light

CHANNEL_TRUST = np.array([0.25, 0.6, 0.15])
"""Shares of red, green and blue in the grey: green is the sharpest and least noisy channel of a phone's picture."""
CLIPPED = 253
"""Channel values from here on say only "at least"."""
LEAST_CONTRAST = 12 / 255
"""Display levels between print black and print white below which nothing can be recovered: noise and coding eat it."""
STRIP_ROWS = 64
"""Rows worked on at a time: few enough that all steps of a strip stay in the processor's cache."""


@dataclass(frozen=True)
class DeilluminateConfig:
    """How light and reflections are told from the print."""

    work_px: int = 512
    """Longer side of the copy on which the light is estimated."""
    light: LightConfig = field(default_factory=LightConfig)
    """How gain and smooth veil are found."""
    reflections: ReflectionConfig = field(default_factory=ReflectionConfig)
    """How reflections with edges are found."""
    even_light: float = 0.03
    """Gain (relative) and veil that vary less are left alone."""
    print_black: float = 0.05
    """Display grey of the print's black surround."""
    print_white: float = 0.95
    """Display grey of the brightest parts."""
    root_share: float = 0.75
    """Tone curve: share of the square root (a print seen by reflection: the display's own gamma) against the straight
    line (a print whose transmission is proportional to its grey). Which it is, one photo does not tell."""

    def __post_init__(self) -> None:
        require_at_least(self, 16, "work_px")


@dataclass(frozen=True, eq=False)
class Deillumination:
    """The recovered print.

    film: (h, w) float32 display grey in [0, 1]; black where the photo does not reach.
    glare: (h, w) bool, clipped or veiled in the photo: nothing could be recovered.
    confidence: (h, w) float32 in [0, 1], how much of what the photo shows there is print; 0 on glare, outside, and
        where something lies before the film.
    ran: whether the light was uneven, so that something was removed; reason: the evidence, with numbers.
    """

    film: Float32[np.ndarray, "h w"]
    glare: Bool[np.ndarray, "h w"]
    confidence: Float32[np.ndarray, "h w"]
    ran: bool
    reason: str


@dataclass(frozen=True)
class _Tone:
    """Display grey of light x in [0, 1]: ``black + straight * x + root * sqrt(x)``, monotone as both are positive."""

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
    grid: SliceGrid | None = None,
    config: DeilluminateConfig | None = None,
    covered: Bool[np.ndarray, "h w"] | None = None,
) -> Deillumination:
    """The print in display grey from the flat film with its light.

    grid: the slice grid: there are as many tiles as slices then in which white is looked for, and slices tell what is
    black in all of them. covered: where something lies before the film: it tells nothing of the light, and stays in the
    film, with no confidence.
    """
    config = config or DeilluminateConfig()
    print_seen = valid if covered is None else valid & ~covered
    small, small_valid = _small_copy(rectified, print_seen, config.work_px)
    table = _grey_table(small)
    grey = _linear_grey(small, table)
    light = find_light(grey, small_valid, grid, config.light)
    light = _with_reflections(light, grey, small_valid, grid, config.reflections)
    decision = survey_light(light.gain, light.veil / max(_white(grey, small_valid), 1e-6), config.even_light)
    if decision.yes:
        light = Light.even(light.pedestal)
    white = _white(_corrected(grey, light), small_valid)
    tone = _find_tone(_corrected(grey, light) / white, small_valid, config)
    film = _apply(rectified, table, light, white, tone)
    # Glare wider than a stroke shows on the small copy; most films have none.
    glare = find_clipped(rectified) if small.max() >= CLIPPED else np.zeros(film.shape, bool)
    clipped = np.count_nonzero(glare)
    _add_veiled(glare, light, white - light.pedestal)
    if not print_seen.all():
        film[~valid] = 0.0
        glare &= print_seen
    lost = np.count_nonzero(glare)
    note = f"{decision.reason}; {clipped / glare.size:.1%} clipped, {lost / glare.size:.1%} lost in all"
    confidence = _confidence(light, white - light.pedestal, glare, print_seen)
    return Deillumination(film, glare, confidence, not decision.yes, note)


def find_clipped(rectified: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Where green and another channel are clipped, over more than the width of a printed stroke.

    White strokes that just reach the limit are white by print, and thinner than a hundred and fiftieth of the film.
    """
    warm = cv2.inRange(rectified, (CLIPPED, CLIPPED, 0), (255, 255, 255))
    cold = cv2.inRange(rectified, (0, CLIPPED, CLIPPED), (255, 255, 255))
    clipped = cv2.bitwise_or(warm, cold)
    if cv2.countNonZero(clipped) == 0:
        return clipped.astype(bool)
    width = 2 * (max(rectified.shape[:2]) // 300) + 1
    kernel = np.ones((width, width), np.uint8)
    return cv2.morphologyEx(clipped, cv2.MORPH_OPEN, kernel).astype(bool)


# ---------------------------------------------------------------- light in grey


def _small_copy(
    rectified: UInt8[np.ndarray, "h w 3"], valid: Bool[np.ndarray, "h w"], longer_px: int
) -> tuple[UInt8[np.ndarray, "sh sw 3"], Bool[np.ndarray, "sh sw"]]:
    """The film and its validity averaged down to about ``longer_px``; a pixel is valid if all that it averages is.

    Whole numbers of pixels are averaged, which is several times as quick; what is left over at the right and bottom
    edges (less than 1 % of the film) does not matter to fields as smooth as these.
    """
    shrink = max(round(max(rectified.shape[:2]) / longer_px), 1)
    height, width = (max(n // shrink, 1) for n in rectified.shape[:2])
    kept = (slice(0, height * shrink), slice(0, width * shrink))
    small = cv2.resize(rectified[kept], (width, height), interpolation=cv2.INTER_AREA)
    return small, share_seen(valid[kept], (width, height)) > 0.999


def _grey_table(small: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "256 3"]:
    """Each channel's contribution to linear grey, by its 8-bit value; channels that clip count for less.

    Any fixed weights keep the form gain * film + veil, and a cast of the light only changes its gain.
    """
    clipped = np.array([cv2.countNonZero(cv2.inRange(x, CLIPPED, 255)) for x in cv2.split(small)]) / small[..., 0].size
    trust = CHANNEL_TRUST * np.clip(1.0 - 4.0 * (clipped - clipped.min()), 0.1, 1.0)
    linear = linear_from_srgb(np.arange(256) / 255.0)
    return (linear[:, None] * (trust / trust.sum())).astype(np.float32)


def _linear_grey(image: UInt8[np.ndarray, "h w 3"], table: Float32[np.ndarray, "256 3"]) -> Float32[np.ndarray, "h w"]:
    """Linear grey of sRGB pixels."""
    red, green, blue = (cv2.LUT(x, np.ascontiguousarray(table[:, k])) for k, x in enumerate(cv2.split(image)))
    return cv2.add(cv2.add(red, green, dst=red), blue, dst=red)


def _white(grey: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"]) -> float:
    """The light of the print's white: all but a few thousandths of the film are darker."""
    seen = grey[::2, ::2][valid[::2, ::2]]
    return max(float(np.quantile(seen, 0.997)), 1e-4) if seen.size else 1.0


def _with_reflections(
    light: Light,
    grey: Float32[np.ndarray, "h w"],
    valid: Bool[np.ndarray, "h w"],
    grid: SliceGrid | None,
    config: ReflectionConfig,
) -> Light:
    """The light with what reflections with edges add to the veil."""
    shrink = max(grey.shape) / config.side_px
    size = (max(round(grey.shape[1] / shrink), 1), max(round(grey.shape[0] / shrink), 1))
    coarse = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    seen = share_seen(valid, size) > 0.99
    white = _white(_corrected(coarse, light), seen)
    found = find_reflections((_corrected(coarse, light) - light.pedestal) / white, seen, grid, config)
    if not found.any():
        return light
    gain, veil = (cv2.resize(x, size, interpolation=cv2.INTER_LINEAR) for x in (light.gain, light.veil))
    return replace(light, veil=veil + found * np.float32(white) * gain)


def _corrected(grey: Float32[np.ndarray, "h w"], light: Light) -> Float32[np.ndarray, "h w"]:
    """Even light of linear grey on a small copy."""
    gain, veil = (cv2.resize(x, grey.shape[::-1], interpolation=cv2.INTER_LINEAR) for x in (light.gain, light.veil))
    return np.maximum((grey - veil) / gain + np.float32(light.pedestal), np.float32(0))


# ---------------------------------------------------------------- tone and output


def _find_tone(even: Float32[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"], config: DeilluminateConfig) -> _Tone:
    """The tone curve that takes the film's black and white to those of a print."""
    valid = valid[::2, ::2]
    seen = np.minimum(even[::2, ::2][valid], 1.0) if valid.any() else np.array([0.0, 1.0])
    share, black = config.root_share, float(np.quantile(seen, 0.02))
    low = (1.0 - share) * black + share * np.sqrt(black)
    contrast = (config.print_white - config.print_black) / max(1.0 - low, 0.1)
    return _Tone(config.print_black - contrast * low, contrast * (1.0 - share), contrast * share)


def _apply(
    rectified: UInt8[np.ndarray, "h w 3"], table: Float32[np.ndarray, "256 3"], light: Light, white: float,
    tone: _Tone,
) -> Float32[np.ndarray, "h w"]:  # fmt: skip
    """Display grey of the whole film, strip by strip."""
    height, width = rectified.shape[:2]
    film = np.empty((height, width), np.float32)
    gain = cv2.resize(light.gain, light.veil.shape[::-1], interpolation=cv2.INTER_LINEAR)
    fields = (1.0 / (gain * white), (light.pedestal - light.veil / gain) / white)
    rows = [cv2.resize(x.astype(np.float32), (x.shape[1], height), interpolation=cv2.INTER_LINEAR) for x in fields]

    def strip(top: int) -> None:
        part = slice(top, min(top + STRIP_ROWS, height))
        even = _linear_grey(rectified[part], table)
        scale, shift = (cv2.resize(x[part], even.shape[::-1], interpolation=cv2.INTER_LINEAR) for x in rows)
        cv2.add(cv2.multiply(even, scale, dst=even), shift, dst=even)
        np.clip(even, tone.least, 1.0, out=even)
        cv2.addWeighted(even, tone.straight, cv2.sqrt(even), tone.root, tone.black, dst=film[part])
        np.clip(film[part], 0.0, 1.0, out=film[part])  # rounding leaves a hair below black

    with ThreadPoolExecutor(max_workers=2) as pool:
        list(pool.map(strip, range(0, height, STRIP_ROWS)))
    return film


def _add_veiled(lost: Bool[np.ndarray, "h w"], light: Light, signal: float) -> None:
    """Mark in ``lost`` where the photo's black and white come out less than ``LEAST_CONTRAST`` apart, as far as the
    light is known.

    signal: light of the print's white less that of its black, at a gain of 1.
    """
    veil = np.maximum(light.veil, 0.0)
    gain = cv2.resize(light.gain, veil.shape[::-1], interpolation=cv2.INTER_LINEAR)
    worst = float(veil.max())  # contrast falls as the veil grows: where even this leaves enough, nothing is lost
    if np.diff(srgb_from_linear(np.array([worst, worst + float(gain.min()) * signal])))[0] >= LEAST_CONTRAST:
        return
    contrast = (srgb_from_linear(veil + gain * signal) - srgb_from_linear(veil)).astype(np.float32)
    if contrast.min() < LEAST_CONTRAST:
        lost |= cv2.resize(contrast, lost.shape[::-1], interpolation=cv2.INTER_LINEAR) < LEAST_CONTRAST


def _confidence(
    light: Light, contrast: float, glare: Bool[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w"]:
    """Share of the print's contrast in what the photo shows, relative to the usual light; 0 where unknown.

    Noise of the photo grows with its light, and is amplified as the print's share of it falls.
    """
    gain = cv2.resize(light.gain, light.veil.shape[::-1], interpolation=cv2.INTER_LINEAR)
    signal = gain * np.float32(contrast)
    lit = np.minimum(gain / max(float(np.median(gain)), 1e-9), 1.0)
    share = np.clip(signal / np.maximum(signal + np.maximum(light.veil, 0.0), 1e-9) * lit, 0.0, 1.0)
    trust = cv2.resize(share.astype(np.float32), glare.shape[::-1], interpolation=cv2.INTER_LINEAR)
    if glare.any() or not valid.all():
        trust[glare | ~valid] = 0.0
    return trust
