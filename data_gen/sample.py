"""Samples: one film bent once, photographed several times in different light, with every map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float

from data_gen.camera.develop import NO_LOCAL_TONE, develop, displayed, local_tone, vignetting
from data_gen.camera.viewpoint import view_parameters
from data_gen.light.rooms import FilteredEnvironment, prefilter
from data_gen.prints.prints import FilmPrint, PrintConfig, make_print
from data_gen.render.composite import PrintLevels, at_photo_scale, composite, on_film, print_levels
from data_gen.render.ground_shadows import NEAR_MM
from data_gen.render.shade import FilmLight, light_before, light_through, lit_film, room_behind
from data_gen.render.surroundings import Surroundings, surroundings
from data_gen.render.through import behind_film
from data_gen.scene.patches import hidden_share, put_over, shading_only
from data_gen.scene.scene import Scene, SceneConfig, passes, placed, sample_scene
from data_gen.sources import SourceConfig, draw_environment, draw_volume
from hybrid.backward import BackwardMap
from hybrid.coords import film_centres_1d, opencv_from_photo
from hybrid.gsdf import USUAL_DENSITIES
from hybrid.levels import LEAST_CONTRAST
from hybrid.mesh.camera import Camera
from hybrid.mesh.film import FilmMesh, base_lines, film_mesh
from hybrid.mesh.raycast import FACET_MM, AnnotationMaps, FilmCaster, true_backward_map
from hybrid.mesh.recipes import BendConfig, bend
from hybrid.round_corners import RoundCorners

SIMULATION_VERTICES = 26
"""The sheet is subdivided as long as its longer side then has at most this many lattice intervals."""

FACET_SIDE = 1000.0
"""Side of a photo, in pixels, for which facets of FACET_MM are made; smaller photos use coarser ones."""

METERING = 0.5
"""Power by which a photo brighter than the film's white lowers the exposure: 0 none, 1 as if it were all background."""

CLIPPED = 6.0
"""Times the film's white: metering clips radiance here."""

METERED_EVERY = 3
"""Metering uses every third point, along both axes, of those at which light is known."""

COLOUR_TAKEN_OUT = 0.6
"""Power by which white balance follows the light's colour."""

_CORNERS, _DENSITY, _DEVELOPMENT = 7, 8, 9
"""Separate the random numbers of corners, of the print's greys and of each photo's development from those of the rest
of a film: a photo's noise draws as many as it has pixels."""

PLACES = (32, 32)
"""Film points whose place in the photo, and thus vignetting, is looked up; it varies slowly."""


@dataclass(frozen=True)
class SampleConfig:
    """What samples are made of.

    size: side of the photo in pixels. map_size: side of the maps.
    photos_per_film: photos taken of one bent film. round_share: sheets with round corners. corner_mm: range of their
    radius. gsdf_share: films printed with DICOM's display function; the others have a display's greys. densities:
    range of the optical density of their black. sources: of CT volumes and of light. The rest: options of each stage.
    """

    size: int = 256
    map_size: int = 256
    photos_per_film: int = 8
    round_share: float = 0.4
    corner_mm: tuple[float, float] = (2.0, 14.0)
    gsdf_share: float = 0.5
    densities: tuple[float, float] = USUAL_DENSITIES
    sources: SourceConfig = field(default_factory=SourceConfig)
    prints: PrintConfig = field(default_factory=PrintConfig)
    bend: BendConfig = field(default_factory=BendConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)


@dataclass(frozen=True, eq=False)
class Sample:
    """A photo with its truth.

    photo: JPEG bytes. maps: at the map size; covered film is not film in the mask.
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
    recipe, frames = bend(sheet_of(film_print), rng, config.bend)
    films = [placed(frame.mesh) for frame in frames]
    room = prefilter(draw_environment(config.sources, rng))
    densest = densest_of([seed, number], config)
    levels = print_levels(film_print.image, densest)
    corners = corners_of(film_print.size_mm, [seed, number], config)
    casters: dict[int, FilmCaster] = {}
    size, map_size = (config.size, config.size), (config.map_size, config.map_size)
    for k in range(config.photos_per_film):
        chosen = int(rng.integers(len(films)))
        if chosen not in casters:
            facet_mm = FACET_MM * max(1.0, FACET_SIDE / config.size)
            casters[chosen] = FilmCaster(films[chosen], facet_mm, corners)
        scene = sample_scene(films[chosen], size, rng, config.scene)
        noise = np.random.default_rng([seed, number, k, _DEVELOPMENT])
        sample = _photograph(casters[chosen], film_print, levels, scene, room, noise, map_size)
        sample.parameters.update(
            seed=seed, film=number, photo=k, recipe=recipe, frame=chosen, room=room.environment.name,
            round_corners=None if corners is None else (corners.u, corners.v), densest=densest,
        )  # fmt: skip
        yield sample


def corners_of(size_mm: tuple[float, float], seeds: Sequence[int], config: SampleConfig) -> RoundCorners | None:
    """Round corners of some sheets; None for the others. Drawn separately, so that nothing else depends on it."""
    rng = np.random.default_rng([*seeds, _CORNERS])
    if rng.random() >= config.round_share:
        return None
    radius = float(rng.uniform(*config.corner_mm))
    return RoundCorners(radius / size_mm[1], radius / size_mm[0])


def densest_of(seeds: Sequence[int], config: SampleConfig) -> float | None:
    """Optical density of some films' black; None for those with a display's greys. Drawn separately, as corners are."""
    rng = np.random.default_rng([*seeds, _DENSITY])
    return float(rng.uniform(*config.densities)) if rng.random() < config.gsdf_share else None


def _photograph(
    caster: FilmCaster, film_print: FilmPrint, levels: PrintLevels, scene: Scene, room: FilteredEnvironment,
    rng: np.random.Generator, map_size: tuple[int, int],
) -> Sample:  # fmt: skip
    """One photo of a bent film. rng: for its development."""
    film, camera = caster.film, scene.camera
    light, around = scene_light(film, scene, room, float(np.median(levels.reflectance[-1])))
    backward = true_backward_map(film, camera)
    reflectance = at_photo_scale(levels.reflectance, backward.mean_film_pixels()) ** np.float32(passes(scene))
    seen = caster.annotate(camera.resized(map_size))
    view = caster.view(camera, seen if camera.size == map_size else None)
    before = around.before
    if not scene.light.box and (scene.backdrop.kind == "room" or scene.backdrop.gap_mm > NEAR_MM):
        alone = np.zeros(camera.size, np.float32)
        alone[view.box] = view.coverage
        before = [shading_only(patch, alone) for patch in before]  # nothing shades what is far behind
    linear = put_over(composite(view, reflectance, light, around.behind), before)
    white = metered(light, linear)
    local = local_tone(linear, scene.lens)
    photo = develop(linear, scene.lens, white, rng, local)

    covered = cv2.resize(hidden_share(around.before, camera.size), map_size[::-1], interpolation=cv2.INTER_AREA) > 0.02
    maps = _uncovered(seen, covered)
    grid_world = film.grid_vertices
    glare = _glare(maps, film, light, scene, white, local)
    return Sample(
        photo=photo,
        maps=maps,
        albedo=_albedo(levels, maps, backward, camera.size),
        glare=glare,
        backward=backward,
        grid_world=grid_world,
        grid_camera=camera.camera_points(grid_world),
        grid_photo=camera.photo_from_world(grid_world),
        grid_film=film_print.vertices,
        camera=camera,
        size_mm=film_print.size_mm,
        parameters=scene.parameters()
        | {"print": film_print.parameters, "rows": film_print.rows, "cols": film_print.cols, "style": film_print.style}
        | {"view": view_parameters(film, camera, backward), "film_light": _light_statistics(light, maps, glare)},
    )


def scene_light(film: FilmMesh, scene: Scene, room: FilteredEnvironment, grey: float) -> tuple[FilmLight, Surroundings]:
    """Light that leaves the film, and its surroundings, which shine and show through it.

    grey: the print's usual reflectance. A dark background is matched to what the film shows without it. It may be the
    mask of a light box; then the box is all there is behind the film.
    """
    lit = lit_film(film, scene)
    light, masked = light_before(lit, room), scene.light.light_box and scene.backdrop.kind != "panel"
    if masked:
        light = light + light_through(lit, room_behind(lit, room))
    around = surroundings(scene, film, room, np.median(light.veil + light.gain * np.float32(grey), axis=(0, 1)))
    if not masked:
        light = light + light_through(lit, behind_film(lit, room, around.behind))
    return light, around


def metered(light: FilmLight, linear: Float[np.ndarray, "*pixels 3"]) -> Float[np.ndarray, "3"]:
    """RGB radiance that the camera takes for white: of the film's bright parts, adjusted for the rest of the photo.

    Phones meter all they see, so a bright background darkens the film; they also remove most of the light's colour.
    """
    every = np.s_[::METERED_EVERY, ::METERED_EVERY]
    bright = np.percentile(light.gain[every], 90, axis=(0, 1)) + np.percentile(light.veil[every], 50, axis=(0, 1))
    level = max(float(bright.mean()), 1e-6)
    around = float(np.minimum(linear, CLIPPED * level).mean())
    metered = level * max(around / level, 1.0) ** METERING
    return metered * np.maximum(bright / level, 1e-2) ** COLOUR_TAKEN_OUT


def _albedo(
    levels: PrintLevels, maps: AnnotationMaps, backward: BackwardMap, photo_size: tuple[int, int]
) -> Float[np.ndarray, "h w"]:
    """Display grey of the print seen by each pixel of the maps; NaN where there is no film."""
    share = [m / p for m, p in zip(maps.mask.shape, photo_size, strict=True)]
    down, across = backward.mean_film_pixels()
    image = at_photo_scale(levels.grey, (down * share[0], across * share[1]))
    (grey,) = on_film([image], maps.uv)
    return np.where(maps.mask, grey, np.float32(np.nan))


def _glare(
    maps: AnnotationMaps, film: FilmMesh, light: FilmLight, scene: Scene, white: Float[np.ndarray, "3"],
    local: Float[np.ndarray, "a b"],
) -> Bool[np.ndarray, "h w"]:  # fmt: skip
    """Film pixels that cannot be recovered: print black and print white come out less than ``LEAST_CONTRAST`` apart.

    There, reflections clip both, or veil them so much that tone curve and eight bits leave nothing between them.
    Computed in film space from the light's gain and veil, exposure, white balance, vignetting and tone curve, for the
    channel in which black and white differ most. Blur, bloom and noise are ignored.
    """
    black, bright = black_and_white(on_sensor(light, film, scene, local), scene, white)
    red, green, blue = cv2.split(cv2.subtract(bright, black))
    (contrast,) = on_film([cv2.max(cv2.max(red, green), blue)], maps.uv)
    return maps.mask & (contrast < LEAST_CONTRAST)


def on_sensor(
    light: FilmLight, film: FilmMesh, scene: Scene, local: Float[np.ndarray, "a b"] = NO_LOCAL_TONE
) -> FilmLight:
    """The light of the film's points as the sensor records it: less towards the photo's corners.

    local: factors over the photo by which the camera brightens dark parts.
    """
    v, u = (film_centres_1d(n) for n in PLACES)
    place = scene.camera.photo_from_world(film.surface(u, v)) / np.array(scene.camera.size[::-1])
    place = cv2.resize(place.astype(np.float32), light.gain.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    share = vignetting(place, scene.lens)
    x, y = np.moveaxis(opencv_from_photo(place * np.array(local.shape[::-1], np.float32)), -1, 0)
    share = share * cv2.remap(local, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[..., None]
    return FilmLight(light.gain * share, light.veil * share)


def black_and_white(
    light: FilmLight, scene: Scene, white: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "n n 3"], Float[np.ndarray, "n n 3"]]:
    """What the photo shows of print black and print white at each point of the film, display RGB in [0, 1]."""
    return displayed(light.veil, scene.lens, white), displayed(light.veil + light.gain, scene.lens, white)


def _light_statistics(light: FilmLight, maps: AnnotationMaps, glare: Bool[np.ndarray, "h w"]) -> dict[str, float]:
    """Mean gain and veil over the film, and the share of the visible film that is glare."""
    return {
        "mean_gain": float(light.gain.mean()),
        "mean_veil": float(light.veil.mean()),
        "glare_share": float(glare.sum() / max(int(maps.mask.sum()), 1)),
    }


def _uncovered(maps: AnnotationMaps, covered: Bool[np.ndarray, "h w"]) -> AnnotationMaps:
    """The maps without covered pixels."""
    if not covered.any():
        return maps
    mask = maps.mask & ~covered
    kept = mask[..., None]
    return AnnotationMaps(mask, *(np.where(kept, x, np.float32(np.nan)) for x in (maps.uv, maps.xyz, maps.normal)))


def sheet_of(film_print: FilmPrint) -> FilmMesh:
    """The flat mesh of a print: its grid corners are vertices, subdivided as far as the simulation can afford."""
    grid_u, grid_v = film_print.vertices[0, :, 0], film_print.vertices[:, 0, 1]
    intervals = max(len(base_lines(grid_u)), len(base_lines(grid_v))) - 1
    levels = max(1, int(np.log2(max(SIMULATION_VERTICES / intervals, 2.0))))
    return film_mesh(film_print.size_mm, grid_u, grid_v, levels)
