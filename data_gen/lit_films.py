"""Flat films under many lights, for LightNet to learn from: ``python -m data_gen.lit_films --count N --out DIR``.

A bent film is lit as in ``data_gen.sample``, but photographed in its own coordinates: no ray is cast, and the look of
print black and print white at each point is known exactly.
"""

from __future__ import annotations

import io
import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import tyro
from jaxtyping import Float, UInt8

from data_gen.camera.develop import REFERENCE_SIDE, develop, local_tone, scattered
from data_gen.light.rooms import prefilter
from data_gen.manifest import deciding, describe_dataset, described_sources, generator_digest, sole_writer
from data_gen.prints.prints import make_print
from data_gen.render.composite import print_levels
from data_gen.render.shade import FilmLight
from data_gen.sample import SampleConfig, black_and_white, densest_of, metered, on_sensor, scene_light, sheet_of
from data_gen.scene.scene import Scene, passes, placed, sample_scene
from data_gen.sources import SourceConfig, draw_environment, draw_volume
from data_gen.work import check_open3d, run_command, source_names, start_worker, write_missing
from hybrid.coords import linear_from_srgb, rgb_from_bgr, srgb_from_linear
from hybrid.errors import require_at_least
from hybrid.files import write_bytes
from hybrid.learn.datasets.light import LitFilm
from hybrid.levels import CHANNEL_SHARES
from hybrid.mesh.recipes import bend

FLAT_PX, FILM_PX, LEVEL_PX = 384, 128, 64
"""Sides of the film as it is photographed, as it is stored, and of its levels."""

_PHOTO_SIZE = (384, 384)
"""Size of the photo in which the film would lie; what is behind it is drawn at this size."""


@dataclass(frozen=True)
class LitFilmsConfig:
    """Write flat films under many lights, where ``hybrid train --preset light`` finds them."""

    count: int
    """Films to make; existing ones are kept."""
    out: Path
    """Their folder, one for each seed."""
    seed: int = 0
    """The same seed gives the same films."""
    photos: int = 10
    """Photos of each film, each in a different light."""
    workers: int = os.cpu_count() or 1
    """Number of processes; 0 does everything in this one."""
    sources: tyro.conf.OmitArgPrefixes[SourceConfig] = field(default_factory=SourceConfig)
    """Sources of CT volumes and of light."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "count", "photos")
        require_at_least(self, 0, "seed", "workers")


def lit_films(config: LitFilmsConfig) -> None:
    """Write the films that are missing.

    Raises:
        ConfigError: ``out`` holds films made with other options, or another run writes there; no Open3D.
    """
    check_open3d()
    with sole_writer(config.out):
        sources = described_sources(config.sources, source_names(config.sources))
        options = deciding(generator=generator_digest(), sources=sources, seed=config.seed, photos=config.photos)
        describe_dataset(config.out, options, max(config.count, sum(1 for _ in config.out.glob("*.npz"))))
        write_missing(_write_film, config, _path, "film")


def lit_film(seed: int, number: int, photos: int, sources: SourceConfig) -> LitFilm:
    """Film ``number`` of a seed, photographed flat in several lights; no data set of that seed contains it."""
    rng, made_of = np.random.default_rng([seed, number, 2]), SampleConfig(sources=sources)
    film_print = make_print(draw_volume(sources, rng), rng, made_of.prints)
    _, frames = bend(sheet_of(film_print), rng, made_of.bend)
    room = prefilter(draw_environment(sources, rng))
    full = print_levels(film_print.image, densest_of([seed, number, 2], made_of))
    reflectance, flat = (
        cv2.resize(x[0], (px, px), interpolation=cv2.INTER_AREA)
        for x, px in ((full.reflectance, FLAT_PX), (full.grey, FILM_PX))
    )
    lit = []
    for _ in range(photos):
        film = placed(frames[int(rng.integers(len(frames)))].mesh)
        scene = sample_scene(film, _PHOTO_SIZE, rng, made_of.scene)
        light, around = scene_light(film, scene, room, float(np.median(reflectance)))
        light = on_sensor(light, film, scene)
        lit.append(_photographed(light, around.behind, scene, reflectance ** np.float32(passes(scene)), rng))
    shown, black, white = (np.stack(x) for x in zip(*lit, strict=True))
    return LitFilm(shown, _bytes(flat), black, white)


def _photographed(
    light: FilmLight, behind: Float[np.ndarray, "h w 3"], scene: Scene, reflectance: Float[np.ndarray, "f f"],
    rng: np.random.Generator,
) -> tuple[UInt8[np.ndarray, "n n 3"], UInt8[np.ndarray, "m m"], UInt8[np.ndarray, "m m"]]:  # fmt: skip
    """The flat film as the camera shows it, and its levels. behind: what the rest of the photo shows."""
    gain, veil = (cv2.resize(x, reflectance.shape, interpolation=cv2.INTER_LINEAR) for x in (light.gain, light.veil))
    linear = gain * reflectance[..., None] + veil
    white = metered(light, np.concatenate([x[::4, ::4].reshape(-1, 3) for x in (linear, behind)]))
    even = replace(scene, lens=replace(scene.lens, vignette=0.0))  # the light already includes vignetting
    local = local_tone(linear, even.lens)  # of a photo that the film fills
    code = np.frombuffer(develop(linear, even.lens, white, rng, local), np.uint8)
    photo = rgb_from_bgr(np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR), np.uint8))
    levels = (
        cv2.resize(linear_from_srgb(x) @ np.array(CHANNEL_SHARES), (LEVEL_PX,) * 2, interpolation=cv2.INTER_AREA)
        for x in black_and_white(_brightened(_with_bloom(gain, veil, linear, scene.lens.bloom), local), even, white)
    )
    black, bright = (_bytes(srgb_from_linear(x)) for x in levels)
    return cv2.resize(photo, (FILM_PX,) * 2, interpolation=cv2.INTER_AREA), black, bright


def _with_bloom(
    gain: Float[np.ndarray, "n n 3"], veil: Float[np.ndarray, "n n 3"], linear: Float[np.ndarray, "n n 3"], bloom: float
) -> FilmLight:
    """The light on a film when the lens scatters some: that is lost at its own place and veils what is around."""
    if bloom == 0:
        return FilmLight(gain, veil)
    return FilmLight(
        (1 - bloom) * gain, (1 - bloom) * veil + bloom * scattered(linear, max(linear.shape) / REFERENCE_SIDE)
    )


def _brightened(light: FilmLight, local: Float[np.ndarray, "a b"]) -> FilmLight:
    """The light multiplied by the factors of a local tone."""
    factor = cv2.resize(local, light.gain.shape[1::-1], interpolation=cv2.INTER_CUBIC)[..., None]
    return FilmLight(light.gain * factor, light.veil * factor)


def _bytes(display: Float[np.ndarray, "n n"]) -> UInt8[np.ndarray, "n n"]:
    return np.rint(255 * np.clip(display, 0, 1)).astype(np.uint8)


def _path(config: LitFilmsConfig, number: int) -> Path:
    return config.out / f"{number:06d}.npz"


def _write_film(config: LitFilmsConfig, number: int) -> None:
    start_worker()
    film, file = lit_film(config.seed, number, config.photos, config.sources), io.BytesIO()
    np.savez(file, photos=film.photos, flat=film.flat, black=film.black, white=film.white)
    write_bytes(_path(config, number), file.getvalue())


def main() -> None:
    """Command line."""
    run_command("data_gen.lit_films", LitFilmsConfig, lit_films)


if __name__ == "__main__":
    main()
