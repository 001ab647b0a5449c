"""Training views of LightNet: flat films under some light, with the levels of print black and print white in it.

A film of ``python -m data_gen.lit_films`` is a print and photos of it that are already flat. In half of the views, its
light falls on another print or a test pattern instead, which its known gain and veil describe exactly: so the network
cannot learn prints by heart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, UInt8
from torch import Tensor
from torch.nn import functional

from hybrid.backward import Orientation
from hybrid.coords import film_centres, linear_from_srgb, srgb_from_linear
from hybrid.errors import NPZ_ERRORS, DataError, describe
from hybrid.gsdf import USUAL_DENSITIES, light_through
from hybrid.learn.datasets.patterns import drawn_pattern
from hybrid.learn.networks.lightnet import LightTargets, films_tensor, linear_grey
from hybrid.levels import CHANNEL_SHARES, LEAST_CONTRAST

_LINEAR = linear_from_srgb(np.arange(256) / 255).astype(np.float32)


@dataclass(frozen=True, eq=False)
class LitFilm:
    """A print and flat photos of it. Levels are linear grey, stored as sRGB.

    photos: (k, n, n, 3) sRGB. flat: (n, n) display grey. black, white: (k, m, m) levels in each photo.
    """

    photos: UInt8[np.ndarray, "k n n 3"]
    flat: UInt8[np.ndarray, "n n"]
    black: UInt8[np.ndarray, "k m m"]
    white: UInt8[np.ndarray, "k m m"]


@dataclass(frozen=True)
class LitPlace:
    """One photo of a file, and the files of all films of its folder, whose prints may be shown in its light."""

    path: Path
    number: int
    films: tuple[Path, ...]


@dataclass(frozen=True)
class LightAugment:
    """How light and print are varied further.

    other_print: share of views with another print. Of these alone: patterns, cropped, joined, windowed, milder, shares
    in which the print is a test pattern, is cut out of a film, has one side from a third film or has its darkest and
    brightest greys cut off, and in which the light is partly evened out; print_gamma, one sigma of the log of a power
    applied to the print; gsdf, share printed by DICOM's display function; densities, range of the optical density of
    print black; tint, one sigma of the log of the channels of veil and gain.
    uneven, reflected: share of views with a further smooth factor, or veil, and the most of the factor's log, or of the
    veil as a fraction of white.
    toned: share of views with a further tone curve; tones, least and most of its strength, above 0 where it brightens
    middle greys, as cameras do that expose for the dark parts of a film. Strengths near the most are rare.
    spots, bars: shares of views with a small bright reflection, sharp or soft, that mostly clips, and with parallel
    bars, possibly faint, as of lamps, windows and blinds.
    exposure, cast: one sigma of the log of all light and of each channel. noise: largest sigma (linear).
    covered: share of views in which something lies in front of the film; told: how often the network is told so.
    cut: share of views in which the film leaves the photo.
    """

    other_print: float = 0.5
    patterns: float = 0.25
    cropped: float = 0.4
    joined: float = 0.3
    windowed: float = 0.4
    milder: float = 0.6
    print_gamma: float = 0.2
    gsdf: float = 0.5
    densities: tuple[float, float] = USUAL_DENSITIES
    tint: float = 0.2
    uneven: tuple[float, float] = (0.4, 0.5)
    reflected: tuple[float, float] = (0.35, 0.5)
    toned: float = 0.6
    tones: tuple[float, float] = (-0.5, 6.0)
    spots: float = 0.25
    bars: float = 0.25
    exposure: float = 0.25
    cast: float = 0.08
    noise: float = 0.006
    covered: float = 0.3
    told: float = 0.5
    cut: float = 0.1


UNDISTURBED = LightAugment(
    other_print=0.0, patterns=0.0, cropped=0.0, joined=0.0, windowed=0.0, milder=0.0, print_gamma=0.0, gsdf=0.0,
    tint=0.0, uneven=(0.0, 0.0), reflected=(0.0, 0.0), toned=0.0, spots=0.0, bars=0.0, exposure=0.0, cast=0.0,
    noise=0.0, covered=0.0, told=0.0, cut=0.0,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class LightView:
    """What the network sees of a film (sRGB), where it sees the film, and the truth (as ``LightTargets``)."""

    image: UInt8[np.ndarray, "n n 3"]
    seen: Bool[np.ndarray, "n n"]
    black: Float32[np.ndarray, "n n"]
    white: Float32[np.ndarray, "n n"]
    flat: Float32[np.ndarray, "n n"]
    shows_print: Bool[np.ndarray, "n n"]


def open_lit_films(folders: Sequence[Path]) -> list[LitPlace]:
    """All photos of the films of some folders, in order.

    Raises:
        DataError: a folder has none.
    """
    return [place for folder in folders for place in _open_folder(folder)]


def split_films(places: Sequence[LitPlace], held_out: int) -> tuple[list[LitPlace], list[LitPlace]]:
    """The photos of the first films, at least ``held_out`` of them, and all other photos, which do not borrow those
    prints either."""
    held = {place.path for place in places[:held_out]}
    free = {films: tuple(path for path in films if path not in held) for films in {place.films for place in places}}
    first = [place for place in places if place.path in held]
    return first, [replace(place, films=free[place.films]) for place in places if place.path not in held]


def _open_folder(folder: Path) -> list[LitPlace]:
    paths = tuple(sorted(folder.glob("*.npz")))
    if not paths:
        do = "Make some: python -m data_gen.lit_films."
        raise DataError(describe(what="Flat films", where=folder, got="no .npz", do=do))
    count = len(read_lit_film(paths[0]).photos)
    return [LitPlace(path, number, paths) for path in paths for number in range(count)]


def read_lit_film(path: Path) -> LitFilm:
    """A film with its photos.

    Raises:
        DataError: it is not such a file.
    """
    return LitFilm(**_arrays(path, ("photos", "flat", "black", "white")))


def _arrays(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Some of a film's arrays; photos make up nearly all of a file, and a print alone needs none of them."""
    try:
        with np.load(path) as file:
            return {name: file[name] for name in names}
    except NPZ_ERRORS as error:
        raise DataError(describe(what="Flat film", where=path, got=error, do="Make it again.")) from error


def light_view(place: LitPlace, px: int, rng: np.random.Generator, augment: LightAugment) -> LightView:
    """A view of a photo, or of the print of another film in its light."""
    film, size = read_lit_film(place.path), (px, px)
    black, white = (
        cv2.resize(_LINEAR[x[place.number]], size, interpolation=cv2.INTER_LINEAR) for x in (film.black, film.white)
    )
    if rng.random() < augment.other_print:
        black, white = _evened(black, white, rng, augment)
        drawn = rng.random() < augment.patterns
        flat = drawn_pattern(px, rng) if drawn else _other_print(place.films, rng, augment)
        flat, light = _in_light(flat, black, white, rng, augment)
    else:
        flat = _resized(film.flat, size).astype(np.float32) / 255
        light = _LINEAR[_resized(film.photos[place.number], size)]
    light, black, white = _lit_anew(light, black, white, rng, augment)
    light, shows_print, seen = _hidden(light, float(white.max()), rng, augment)
    way = Orientation(int(rng.integers(4)), bool(rng.random() < 0.5))
    image = np.rint(255 * srgb_from_linear(light)).astype(np.uint8)
    return LightView(*(way.moved(x) for x in (image, seen, black, white, flat, shows_print)))


def _resized(image: UInt8[np.ndarray, "h w *c"], size: tuple[int, int]) -> UInt8[np.ndarray, "n n *c"]:
    return image if image.shape[:2] == size else cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _other_print(films: Sequence[Path], rng: np.random.Generator, augment: LightAugment) -> UInt8[np.ndarray, "h w"]:
    """The print of one of these films, or of two of them side by side, as it is or with greys cut off at both ends."""
    one, other = (films[int(k)] for k in rng.integers(len(films), size=2))
    flat = _arrays(one, ("flat",))["flat"]
    if rng.random() < augment.joined:
        way = Orientation(int(rng.integers(4)), False)
        turned, part = way.moved(flat).copy(), way.moved(_arrays(other, ("flat",))["flat"])
        count = int(len(turned) * rng.uniform(0.2, 0.8))
        turned[:count] = _resized(part, turned.shape[::-1])[:count]
        flat = way.inverse.moved(turned)
    if rng.random() < augment.windowed:
        low, high = 255 * rng.uniform(0, 0.3), 255 * rng.uniform(0.7, 1)
        flat = np.clip((flat - low) * (255 / (high - low)), 0, 255).astype(np.uint8)
    return np.ascontiguousarray(flat)


def _evened(
    black: Float32[np.ndarray, "n n"], white: Float32[np.ndarray, "n n"], rng: np.random.Generator,
    augment: LightAugment,
) -> tuple[Float32[np.ndarray, "n n"], Float32[np.ndarray, "n n"]]:  # fmt: skip
    """Levels that vary less, on some views: most photos are lit more evenly than those of a data set."""
    left = np.float32(rng.random() if rng.random() < augment.milder else 1.0)
    gain = np.maximum(white - black, 1e-4)
    gain = np.median(gain) * (gain / np.median(gain)) ** left
    black = black.mean() + left * (black - black.mean())
    return black, black + gain


def _in_light(
    flat: UInt8[np.ndarray, "h w"], black: Float32[np.ndarray, "n n"], white: Float32[np.ndarray, "n n"],
    rng: np.random.Generator, augment: LightAugment,
) -> tuple[Float32[np.ndarray, "n n"], Float32[np.ndarray, "n n 3"]]:  # fmt: skip
    """A print (display grey), and its linear light between black and white; some prints are darker than others."""
    if rng.random() < augment.cropped:
        sides = [round(n * rng.uniform(0.5, 1)) for n in flat.shape]
        top, left = (int(rng.integers(n - side + 1)) for n, side in zip(flat.shape, sides, strict=True))
        flat = cv2.resize(flat[top : top + sides[0], left : left + sides[1]], black.shape, interpolation=cv2.INTER_AREA)
    power = np.float32(np.exp(rng.normal(0, augment.print_gamma)))
    grey = (_resized(flat, black.shape).astype(np.float32) / 255) ** power
    printed = _printed(grey, float(rng.uniform(*augment.densities)) if rng.random() < augment.gsdf else None)
    tints = np.exp(rng.normal(0, augment.tint, (2, 3))).astype(np.float32)
    veil, gain = tints / (tints @ np.array(CHANNEL_SHARES, np.float32))[:, None]
    return grey, black[..., None] * veil + ((white - black) * printed)[..., None] * gain


def _printed(grey: Float32[np.ndarray, "n n"], densest: float | None) -> Float32[np.ndarray, "n n"]:
    """Linear light of a print, white: 1, printed by DICOM's display function, or with a display's greys."""
    if densest is None:
        return linear_from_srgb(grey).astype(np.float32)
    greys = np.linspace(0, 1, 256)
    return np.interp(grey, greys, light_through(greys, densest)).astype(np.float32)


def _lit_anew(
    light: Float32[np.ndarray, "n n 3"], black: Float32[np.ndarray, "n n"], white: Float32[np.ndarray, "n n"],
    rng: np.random.Generator, augment: LightAugment,
) -> tuple[Float32[np.ndarray, "n n 3"], Float32[np.ndarray, "n n"], Float32[np.ndarray, "n n"]]:  # fmt: skip
    """Further gain and veil, another exposure, other colours and noise; then the sensor clips."""
    px = len(black)
    share, most = augment.uneven
    factor = np.exp(rng.normal(0, augment.exposure)) * np.ones((px, px), np.float32)
    if rng.random() < share:
        factor *= np.exp(rng.uniform(0, most) * _smooth(px, 4, rng))
    added = np.zeros((px, px), np.float32)
    share, most = augment.reflected
    if rng.random() < share:
        added = np.maximum(rng.uniform(0, most) * _smooth(px, 5, rng), 0) * (white * factor).mean()
    if rng.random() < augment.spots:
        spot = _ellipse(px, rng.random(2), rng.uniform(0.02, 0.15, 2), rng)
        added = added + _lamp(spot, 0.3, rng) * (white * factor).mean()
    if rng.random() < augment.bars:
        added = added + _lamp(_bars(px, rng), 0.05, rng) * (white * factor).mean()
    cast = np.exp(rng.normal(0, augment.cast, 3)).astype(np.float32)
    cast /= cast @ np.array(CHANNEL_SHARES, np.float32)  # leaves grey unchanged, and so the levels
    noise = rng.standard_normal(light.shape, dtype=np.float32) * np.float32(augment.noise * rng.random())
    lit = (light * factor[..., None] + added[..., None]) * cast
    lit, black, white = (np.clip(x, 0, 1) for x in (lit, black * factor + added, white * factor + added))
    if rng.random() < augment.toned:
        least, most = augment.tones
        strength = least + (most - least) * rng.random() ** 2
        grey = np.maximum(lit @ np.array(CHANNEL_SHARES, np.float32), 1e-6)
        lit = lit * (toned(grey, strength) / grey)[..., None]
        black, white = toned(black, strength), toned(white, strength)
    return tuple(np.clip(x, 0, 1).astype(np.float32) for x in (lit + noise, black, white))  # type: ignore[return-value]


def toned(light: Float[np.ndarray, "*n"], strength: float) -> Float[np.ndarray, "*n"]:
    """Light in [0, 1] after a tone curve that fixes 0 and 1: strength 1 turns a quarter into two fifths, strength -1
    into a seventh."""
    if strength < 0:
        return light / (1 - strength * (1 - light))
    return light * (1 + strength) / (1 + strength * light)


def _smooth(px: int, nodes: int, rng: np.random.Generator) -> Float32[np.ndarray, "n n"]:
    """A smooth random field of unit variance at its nodes."""
    return cv2.resize(rng.standard_normal((nodes, nodes), dtype=np.float32), (px, px), interpolation=cv2.INTER_CUBIC)


def _lamp(shape: Bool[np.ndarray, "n n"], least: float, rng: np.random.Generator) -> Float32[np.ndarray, "n n"]:
    """A reflection of this shape, sharp or soft, from ``least`` to four times as bright as white."""
    soft = cv2.GaussianBlur(shape.astype(np.float32), (0, 0), rng.uniform(0.3, 3))
    return soft * np.float32(np.exp(rng.uniform(np.log(least), np.log(4))))


def _bars(px: int, rng: np.random.Generator) -> Bool[np.ndarray, "n n"]:
    """One to four parallel bars at any angle, slightly bent as on a bent sheet."""
    bent = rng.uniform(0, 0.06) * np.stack([_smooth(px, 4, rng) for _ in range(2)], axis=-1)
    angle, (half, length) = rng.uniform(0, np.pi), np.exp(rng.uniform(np.log([0.008, 0.04]), np.log([0.12, 0.6])))
    at = film_centres((px, px)) + bent - rng.random(2)
    along, across = at @ np.array([np.cos(angle), np.sin(angle)]), at @ np.array([-np.sin(angle), np.cos(angle)])
    step = half * rng.uniform(2.2, 6)
    bar = np.clip(np.rint(across / step), 0, int(rng.integers(0, 4)))
    return (np.abs(along) < length) & (np.abs(across - step * bar) < half)


def _hidden(
    light: Float32[np.ndarray, "n n 3"], white: float, rng: np.random.Generator, augment: LightAugment
) -> tuple[Float32[np.ndarray, "n n 3"], Bool[np.ndarray, "n n"], Bool[np.ndarray, "n n"]]:
    """The film with something in front of it, or cut off; where print is seen, and where the network is told so."""
    shown = seen = np.ones(light.shape[:2], bool)
    if rng.random() < augment.covered:
        inside = _blob(len(light), rng)
        colour = white * rng.random(3) * (0.8, 0.5, 0.4) * (1 + 0.1 * rng.standard_normal((*inside.shape, 1)))
        light = np.where(inside[..., None], np.clip(colour, 0, 1), light).astype(np.float32)
        shown = ~inside
        seen = shown if rng.random() < augment.told else seen
    if rng.random() < augment.cut:
        within = film_centres((len(shown), len(shown)))[..., 0] < rng.uniform(0.7, 1)
        shown, seen = shown & within, seen & within
    return light, shown, seen


def _blob(px: int, rng: np.random.Generator) -> Bool[np.ndarray, "n n"]:
    """A long blob that reaches in from an edge, as fingers do."""
    centre, side = rng.random(2), int(rng.integers(4))
    centre[side % 2] = side // 2
    return _ellipse(px, centre, np.array([rng.uniform(0.06, 0.3), rng.uniform(0.02, 0.1)]), rng)


def _ellipse(
    px: int, centre: Float[np.ndarray, "2"], half: Float[np.ndarray, "2"], rng: np.random.Generator
) -> Bool[np.ndarray, "n n"]:
    """An ellipse with these half axes, turned by any angle."""
    angle = rng.uniform(0, np.pi)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return (((film_centres((px, px)) - centre) @ axes.T / half) ** 2).sum(axis=-1) < 1


def light_batch(views: Sequence[LightView]) -> tuple[Tensor, LightTargets]:
    """Images and targets of some views."""
    stacked = {name: np.stack([getattr(view, name) for view in views]) for name in LightView.__dataclass_fields__}
    images = films_tensor(stacked["image"], stacked["seen"])
    black, white, flat = (torch.from_numpy(stacked[name]) for name in ("black", "white", "flat"))
    contrast = torch.from_numpy(srgb_from_linear(stacked["white"]) - srgb_from_linear(stacked["black"])).float()
    counted = torch.from_numpy(stacked["shows_print"] & stacked["seen"]) & (contrast > LEAST_CONTRAST)
    grey = linear_grey(torch.from_numpy(_LINEAR[stacked["image"]]).permute(0, 3, 1, 2))
    black, white, contrast = (functional.avg_pool2d(x[:, None], 2)[:, 0] for x in (black, white, contrast))
    rim = functional.max_pool2d(1 - counted[:, None].float(), 3, 1, 1)[:, 0]
    return images, LightTargets(grey, black, white, contrast, flat, 1 - rim)
