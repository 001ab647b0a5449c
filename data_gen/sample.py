"""Samples: one film bent once, photographed several times in different light, with every map."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float

from data_gen.background import background, occluders
from data_gen.develop import develop
from data_gen.prints import FilmPrint, PrintConfig, make_print
from data_gen.rooms import prefilter
from data_gen.scene import Scene, SceneConfig, sample_scene
from data_gen.shade import film_light, film_radiance
from data_gen.sources import SourceConfig, draw_environment, draw_volume
from hybrid.backward import BackwardMap
from hybrid.coords import node_centres_1d, pixel_from_film, sample_bilinear
from hybrid.mesh.camera import Camera
from hybrid.mesh.film import FilmMesh, film_mesh
from hybrid.mesh.raycast import AnnotationMaps, FilmCaster, true_backward_map
from hybrid.mesh.recipes import BendConfig, bend

SIMULATION_VERTICES = 26
"""The sheet is subdivided as long as its longer side then has at most this many lattice intervals."""


@dataclass(frozen=True)
class SampleConfig:
    """What samples are made of.

    size: side of the photo in pixels. map_size: side of the maps. supersample: rays per pixel and axis for the photo.
    photos_per_film: photos taken of one bent film. sources: of CT volumes and of light. The rest: of each stage.
    """

    size: int = 256
    map_size: int = 256
    supersample: int = 2
    photos_per_film: int = 8
    sources: SourceConfig = field(default_factory=SourceConfig)
    prints: PrintConfig = field(default_factory=PrintConfig)
    bend: BendConfig = field(default_factory=BendConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)


@dataclass(frozen=True, eq=False)
class Sample:
    """A photo with its truth.

    photo: JPEG bytes. maps: at the map size; film that something covers is not film in the mask.
    albedo: (h, w) display grey of the print. glare: (h, w) film that is clipped or veiled beyond recovery.
    backward: exact map into the photo's frame.
    grid_world, grid_camera: (rows + 1, cols + 1, 3) mm. grid_photo, grid_film: (rows + 1, cols + 1, 2).
    camera: of the photo. size_mm: (height, width) of the film. parameters: everything drawn, JSON-able.
    """

    photo: bytes
    maps: AnnotationMaps
    albedo: Float[np.ndarray, "h w"]
    glare: Bool[np.ndarray, "h w"]
    backward: BackwardMap
    grid_world: Float[np.ndarray, "r c 3"]
    grid_camera: Float[np.ndarray, "r c 3"]
    grid_photo: Float[np.ndarray, "r c 2"]
    grid_film: Float[np.ndarray, "r c 2"]
    camera: Camera
    size_mm: tuple[float, float]
    parameters: dict[str, Any]


def film_samples(seed: int, number: int, config: SampleConfig) -> Iterator[Sample]:
    """The photos of film ``number`` of the data set ``seed``; the same numbers give the same bytes."""
    rng = np.random.default_rng([seed, number])
    film_print = make_print(draw_volume(config.sources, rng), rng, config.prints)
    recipe, frames = bend(_sheet(film_print), rng, config.bend)
    room = prefilter(draw_environment(config.sources, rng))
    casters: dict[int, FilmCaster] = {}
    for k in range(config.photos_per_film):
        chosen = int(rng.integers(len(frames)))
        if chosen not in casters:
            casters[chosen] = FilmCaster(frames[chosen].mesh)
        scene = sample_scene(frames[chosen].mesh, (config.size, config.size), rng, config.scene)
        sample = _photograph(casters[chosen], film_print, scene, room, rng, config)
        sample.parameters.update(
            seed=seed, film=number, photo=k, recipe=recipe, frame=chosen, room=room.environment.name
        )
        yield sample


def _photograph(
    caster: FilmCaster, film_print: FilmPrint, scene: Scene, room: Any, rng: np.random.Generator, config: SampleConfig
) -> Sample:
    """One photo of a bent film."""
    film, camera = caster.film, scene.camera
    light = film_light(film, scene, room, rng)
    image = _print_at_photo_scale(film_print.image, film, camera, config.supersample)
    linear = _composite(caster, film_radiance(image, light), background(scene, room, rng), camera, config.supersample)
    white = float(np.percentile(light.gain, 90)) + float(np.percentile(light.veil, 50))
    cover = np.zeros(camera.size, np.float32)
    if scene.occluders:
        rim = camera.photo_from_world(_rim(film))
        picture, cover = occluders(rim, camera.size, scene.occluders, max(float(light.gain.mean()), 0.05), rng)
        linear = linear * (1 - cover[..., None]) + picture * cover[..., None]
    photo = develop(linear, scene.lens, white, rng)

    map_size = (config.map_size, config.map_size)
    covered = cv2.resize(cover, map_size[::-1], interpolation=cv2.INTER_AREA) > 0.02
    maps = _uncovered(caster.annotate(camera.resized(map_size)), covered)
    grid_world = film.grid_vertices
    return Sample(
        photo=photo,
        maps=maps,
        albedo=_lookup(film_print.image, maps, camera.resized(map_size), film),
        glare=np.zeros_like(maps.mask),  # until the shading says where
        backward=true_backward_map(film, camera),
        grid_world=grid_world,
        grid_camera=camera.camera_points(grid_world),
        grid_photo=camera.photo_from_world(grid_world),
        grid_film=film_print.vertices,
        camera=camera,
        size_mm=film_print.size_mm,
        parameters=scene.parameters()
        | {"print": film_print.parameters, "rows": film_print.rows, "cols": film_print.cols, "style": film_print.style},
    )


def _composite(
    caster: FilmCaster, radiance: np.ndarray, behind: np.ndarray, camera: Camera, supersample: int
) -> Float[np.ndarray, "h w 3"]:
    """The film's radiance put before the background, anti-aliased by ``supersample`` rays per pixel and axis."""
    h, w = camera.size
    mask, uv = caster.uv_map(camera.resized((h * supersample, w * supersample)))
    seen = sample_bilinear(radiance, pixel_from_film(np.where(mask[..., None], uv, 0.0), radiance.shape[:2]))
    alpha = mask.astype(np.float32)
    seen *= alpha[..., None]
    seen = cv2.resize(seen, (w, h), interpolation=cv2.INTER_AREA)
    alpha = cv2.resize(alpha, (w, h), interpolation=cv2.INTER_AREA)
    return seen + (1 - alpha[..., None]) * cv2.resize(behind, (w, h), interpolation=cv2.INTER_LINEAR)


def _print_at_photo_scale(image: np.ndarray, film: FilmMesh, camera: Camera, supersample: int) -> np.ndarray:
    """The print reduced by area averaging to about the resolution at which the photo samples it."""
    down, across = true_backward_map(film, camera, (5, 5)).mean_film_pixels()
    scale = max(down / image.shape[0], across / image.shape[1]) * supersample
    if scale >= 1:
        return image
    size = (max(8, round(image.shape[1] * scale)), max(8, round(image.shape[0] * scale)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _lookup(image: np.ndarray, maps: AnnotationMaps, camera: Camera, film: FilmMesh) -> Float[np.ndarray, "h w"]:
    """Display grey of the print seen by each pixel of the maps; NaN where there is no film."""
    small = _print_at_photo_scale(image, film, camera, 1).astype(np.float32)
    uv = np.where(maps.mask[..., None], maps.uv, 0.0)
    seen = sample_bilinear(small, pixel_from_film(uv, (small.shape[0], small.shape[1])))
    return np.where(maps.mask, seen, np.nan)


def _uncovered(maps: AnnotationMaps, covered: Bool[np.ndarray, "h w"]) -> AnnotationMaps:
    """The maps without the pixels that something covers."""
    if not covered.any():
        return maps
    mask = maps.mask & ~covered
    kept = mask[..., None]
    return AnnotationMaps(
        mask, np.where(kept, maps.uv, np.nan), np.where(kept, maps.xyz, np.nan), np.where(kept, maps.normal, np.nan)
    )


def _rim(film: FilmMesh) -> Float[np.ndarray, "n 3"]:
    """Points of the sheet's outline, in order."""
    t = node_centres_1d(25)
    s = film.surface(t, t)
    return np.concatenate([s[0], s[1:, -1], s[-1, -2::-1], s[-2:0:-1, 0]])


def _sheet(film_print: FilmPrint) -> FilmMesh:
    """The flat mesh of a print: its grid corners are vertices, subdivided as far as the simulation affords."""
    grid_u, grid_v = film_print.vertices[0, :, 0], film_print.vertices[:, 0, 1]
    intervals = max(len(grid_u), len(grid_v)) + 1
    levels = max(1, int(np.log2(max(SIMULATION_VERTICES / intervals, 2.0))))
    return film_mesh(film_print.size_mm, grid_u, grid_v, levels)
