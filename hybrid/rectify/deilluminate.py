"""From the flat film with its light to the print: smooth light and reflections removed, the grey scale kept.

In linear light the photo shows ``a * film + b``, with a smooth gain a (light through and onto the sheet) and a smooth
veil b (the room reflected in it). The black between the slices pins b, the white texts and bone pin a; both are found
on a small copy, and applied at full resolution so that every detail comes from the photo. One tone curve for the whole
film then turns light into display grey. Where the photo is clipped nothing is known, and nothing is made up.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from hybrid.backward import BackwardMap
from hybrid.coords import linear_from_srgb
from hybrid.records import CoarseMaps, SliceGrid
from hybrid.rectify.light import FIELD_SIZE, Light, LightConfig, find_light
from hybrid.rectify.resample import rectify_map
from hybrid.rectify.survey import survey_light

CHANNEL_TRUST = np.array([0.25, 0.6, 0.15])
"""Shares of red, green and blue in the grey: green is the sharpest and least noisy channel of a phone's picture."""
CLIPPED = 253
"""Channel values from here on say only "at least"."""
STRIP_ROWS = 64
"""Rows worked on at a time: few enough that all steps of a strip stay in the processor's cache."""


@dataclass(frozen=True)
class DeilluminateConfig:
    """How light and reflections are told from the print."""

    work_px: int = 512
    """Longer side of the copy on which the light is estimated."""
    light: LightConfig = field(default_factory=LightConfig)
    """How gain and veil are found."""
    even_light: float = 0.03
    """Gain (relative) and veil that vary less are left alone."""
    print_black: float = 0.05
    """Display grey of the print's black surround."""
    print_white: float = 0.95
    """Display grey of the brightest parts."""
    root_share: float = 0.5
    """Blind tone curve: share of the square root (a print seen by reflection: the display's own gamma) against the
    straight line (a print whose transmission is proportional to its grey)."""


@dataclass(frozen=True, eq=False)
class Deillumination:
    """The recovered print.

    film: (h, w) float32 display grey in [0, 1]; black where the photo does not reach.
    glare: (h, w) bool, clipped in the photo: nothing could be recovered.
    confidence: (h, w) float32 in [0, 1], how much of what the photo shows there is print; 0 on glare and outside.
    ran: whether the light was uneven, so that something was removed; reason: the evidence, with numbers.
    """

    film: Float[np.ndarray, "h w"]
    glare: Bool[np.ndarray, "h w"]
    confidence: Float[np.ndarray, "h w"]
    ran: bool
    reason: str


@dataclass(frozen=True)
class _Tone:
    """Display grey of light x in [0, 1]: ``black + straight * x + root * sqrt(x)``, monotone as both are positive."""

    black: float
    straight: float
    root: float


def deilluminate(
    rectified: UInt8[np.ndarray, "h w 3"],
    valid: Bool[np.ndarray, "h w"],
    guide: Float[np.ndarray, "gh gw"] | None = None,
    grid: SliceGrid | None = None,
    config: DeilluminateConfig | None = None,
) -> Deillumination:
    """The print in display grey from the flat film with its light.

    guide: predicted display grey in film space (``film_guide``), NaN where unknown; it sets the tone curve.
    grid: the slice grid; its cells then are the tiles in which white is looked for.
    """
    config = config or DeilluminateConfig()
    small, small_valid = _small_copy(rectified, valid, config.work_px)
    table = _grey_table(small)
    grey = _linear_grey(small, table)
    light = find_light(grey, small_valid, grid, config.light)
    decision = survey_light(light.gain, light.veil / max(_white(grey, small_valid), 1e-6), config.even_light)
    if decision.yes:
        light = Light(np.ones(FIELD_SIZE), np.full(FIELD_SIZE, light.pedestal), light.pedestal)
    scale, shift, white = _correction(light, grey, small_valid)
    even = _corrected(grey, scale, shift)
    tone = _find_tone(even, small_valid, guide, config)
    film = _apply(rectified, table, (scale, shift), tone)
    glare = find_glare(rectified) & valid
    if not valid.all():
        film[~valid] = 0.0
    confidence = _confidence(light, white, glare, valid)
    lost = float(glare.mean())
    note = f"{decision.reason}; {lost:.1%} clipped; tone {'from the predicted print' if guide is not None else 'blind'}"
    return Deillumination(film, glare, confidence, not decision.yes, note)


def film_guide(maps: CoarseMaps, backward: BackwardMap, size: tuple[int, int] = (48, 48)) -> Float[np.ndarray, "gh gw"]:
    """The network's display grey in film space, (gh, gw) float32 on pixel centres; NaN where it saw no film."""
    film = np.where(maps.mask >= 0.5, maps.albedo, np.nan).astype(np.float32)
    return rectify_map(film, maps.photo_points, backward, size)


def find_glare(rectified: UInt8[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
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
    if valid.all():
        return small, np.ones(small.shape[:2], bool)
    share = cv2.resize(valid[kept].astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    return small, share > 0.999


def _grey_table(small: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "1 256 3"]:
    """Each channel's contribution to linear grey, by its 8-bit value; channels that clip count for less.

    Any fixed weights keep the form gain * film + veil, and a cast of the light only changes its gain.
    """
    clipped = (small >= CLIPPED).mean(axis=(0, 1))
    trust = CHANNEL_TRUST * np.clip(1.0 - 4.0 * (clipped - clipped.min()), 0.1, 1.0)
    linear = linear_from_srgb(np.arange(256) / 255.0)
    return (linear[:, None] * (trust / trust.sum())).astype(np.float32)[None]


def _linear_grey(image: UInt8[np.ndarray, "h w 3"], table: Float[np.ndarray, "1 256 3"]) -> Float[np.ndarray, "h w"]:
    """Linear grey (float32) of sRGB pixels."""
    return cv2.transform(cv2.LUT(image, table), np.ones((1, 3), np.float32))


def _correction(
    light: Light, grey: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"]
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"], float]:
    """Fields scale and shift with ``x = scale * grey + shift`` the even light, 1 at white; and white before scaling."""
    scale = (1.0 / light.gain).astype(np.float32)
    shift = (light.pedestal - light.veil / light.gain).astype(np.float32)
    white = _white(_corrected(grey, scale, shift), valid)
    return scale / np.float32(white), shift / np.float32(white), white


def _white(grey: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"]) -> float:
    """The light of the print's white: all but a few thousandths of the film are darker."""
    seen = grey[valid]
    return max(float(np.quantile(seen, 0.997)), 1e-4) if seen.size else 1.0


def _corrected(
    grey: Float[np.ndarray, "h w"], scale: Float[np.ndarray, "n n"], shift: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, "h w"]:
    """Even light of linear grey on the small copy."""
    size = grey.shape[::-1]
    return np.clip(grey * cv2.resize(scale, size) + cv2.resize(shift, size), 0.0, None)


# ---------------------------------------------------------------- tone and output


def _find_tone(
    even: Float[np.ndarray, "h w"],
    valid: Bool[np.ndarray, "h w"],
    guide: Float[np.ndarray, "gh gw"] | None,
    config: DeilluminateConfig,
) -> _Tone:
    """The tone curve: blind, or with the share of the root that the predicted print asks for."""
    share = config.root_share if guide is None else _guided_share(even, valid, guide, config.root_share)
    seen = np.minimum(even[valid], 1.0) if valid.any() else np.array([0.0, 1.0])
    black = float(np.quantile(seen, 0.02))
    low = (1.0 - share) * black + share * np.sqrt(black)
    contrast = (config.print_white - config.print_black) / max(1.0 - low, 0.1)
    return _Tone(config.print_black - contrast * low, contrast * (1.0 - share), contrast * share)


def _guided_share(
    even: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"], guide: Float[np.ndarray, "gh gw"], prior: float
) -> float:
    """Share of the root with which the even light, blurred as the guide is, comes closest to the guide."""
    light = np.clip(even, 0.0, 1.0).astype(np.float32)
    size = guide.shape[::-1]
    straight, root = (cv2.resize(x, size, interpolation=cv2.INTER_AREA) for x in (light, np.sqrt(light)))
    share = cv2.resize(valid.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    use = np.isfinite(guide) & (share > 0.99)
    if np.count_nonzero(use) < 50:
        return prior
    rows = np.stack([straight[use], root[use], np.ones(np.count_nonzero(use))], axis=1).astype(np.float64)
    best, least = prior, np.inf
    for candidate in np.linspace(0.0, 1.0, 11):
        curve = np.stack([rows[:, 0] * (1 - candidate) + rows[:, 1] * candidate, rows[:, 2]], axis=1)
        fit = np.linalg.lstsq(curve, guide[use].astype(np.float64), rcond=None)[0]
        # the guide is blurred and noisy: it must speak clearly before it moves the curve far from the prior
        cost = float(np.abs(curve @ fit - guide[use]).mean()) * (1.0 + 0.05 * abs(candidate - prior))
        if cost < least and fit[0] > 0:
            best, least = float(candidate), cost
    return best


def _apply(
    rectified: UInt8[np.ndarray, "h w 3"],
    table: Float[np.ndarray, "1 256 3"],
    fields: tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]],
    tone: _Tone,
) -> Float[np.ndarray, "h w"]:
    """Display grey (float32) of the whole film, strip by strip."""
    height, width = rectified.shape[:2]
    film = np.empty((height, width), np.float32)
    rows = [cv2.resize(field, (FIELD_SIZE[1], height), interpolation=cv2.INTER_LINEAR) for field in fields]
    for top in range(0, height, STRIP_ROWS):
        part = slice(top, min(top + STRIP_ROWS, height))
        light = _linear_grey(rectified[part], table)
        size = (width, light.shape[0])
        light *= cv2.resize(rows[0][part], size, interpolation=cv2.INTER_LINEAR)
        light += cv2.resize(rows[1][part], size, interpolation=cv2.INTER_LINEAR)
        np.clip(light, 0.0, 1.0, out=light)
        root = cv2.sqrt(light)
        film[part] = cv2.addWeighted(light, tone.straight, root, tone.root, tone.black)
    return np.clip(film, 0.0, 1.0, out=film)


def _confidence(
    light: Light, white: float, glare: Bool[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Share of the print's contrast in what the photo shows, relative to the usual light; 0 where unknown."""
    signal = light.gain * white
    share = signal / (signal + np.maximum(light.veil, 0.0))
    lit = np.minimum(light.gain / max(float(np.median(light.gain)), 1e-9), 1.0)
    trust = cv2.resize((share * lit).astype(np.float32), glare.shape[::-1], interpolation=cv2.INTER_LINEAR)
    if glare.any() or not valid.all():
        trust[glare | ~valid] = 0.0
    return np.clip(trust, 0.0, 1.0, out=trust)
