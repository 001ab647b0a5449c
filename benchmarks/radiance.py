"""The shading against a path tracer: ``python -m benchmarks.radiance --json OUT [--hdri DIR] [--picture PNG]``.

For each scene the same bent film, lamps, room, camera and BSDF (benchmarks/scenes/path_tracer.py) are traced by Mitsuba
and shaded by data_gen. The benchmark compares linear RGB of the pixels well inside the film: the mean of |model -
traced| / traced. ``shading``: traced with light straight from lamps and room, as if the film cast no shadow on itself:
the error of the shading. ``shadows``: with the film's shadows on itself. ``full``: with light between parts of the film
too. ``noise``: the same figure between the means of two halves of the trace, to show how much of ``shading`` is noise.
Needs the extras ``data`` and ``bench``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import tyro
from jaxtyping import Bool, Float

from benchmarks.command import require_picture, run_command, write_figures, write_picture
from benchmarks.scenes.path_tracer import TraceConfig, mitsuba, trace
from data_gen.light.lamps import Lamp
from data_gen.light.lighting import Light, LightBox, Material
from data_gen.light.rooms import Environment, load_environments, prefilter, procedural_room
from data_gen.render.shade import film_light
from data_gen.scene.scene import Scene, SceneConfig, sample_scene
from data_gen.work import check_open3d
from hybrid.coords import pixel_from_film, sample_bilinear, srgb_from_linear
from hybrid.errors import ConfigError, describe, require_at_least
from hybrid.mesh.camera import Camera, look_at
from hybrid.mesh.film import FilmMesh, film_mesh
from hybrid.mesh.raycast import FilmCaster

SIZE_MM = (430.0, 350.0)
SUPERSAMPLE = 4
BOUND = 0.05
"""Largest mean relative difference that a scene may have."""


@dataclass(frozen=True)
class Options:
    """Compare the shading with a path tracer."""

    json_path: Annotated[Path, tyro.conf.arg(name="json")]
    """File for the figures."""
    hdri: Path | None = None
    """Folder of environments to use in place of procedural rooms."""
    picture: Path | None = None
    """File for a picture of both side by side."""
    side: int = 48
    """Side of the traced photo in pixels."""
    samples: int = 2048
    """Per pixel."""
    only: tuple[str, ...] = ()
    """Only scenes with one of these words in their names; all if none is given."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "side", "samples")
        require_picture(self, "picture")


@dataclass(frozen=True)
class Case:
    """One scene: bend (roll in rad across the sheet, wave in mm), camera angle, print's linear reflectance, light."""

    name: str
    material: Material
    light: Light
    roll: float = 0.0
    wave_mm: float = 0.0
    tilt_deg: float = 0.0
    room: int = 0
    grey: float = 0.3


def bent_film(roll: float, wave_mm: float) -> FilmMesh:
    """A film rolled about its height by ``roll`` rad in all (towards the reader where > 0), and waved."""
    lines = np.linspace(0.05, 0.95, 5)
    film = film_mesh(SIZE_MM, lines, lines, 2)
    x, y = film.vertices[..., 0], film.vertices[..., 1]
    angle = x / SIZE_MM[1] * roll
    radius = SIZE_MM[1] / roll if roll else 1.0
    across, depth = (radius * np.sin(angle), -radius * (1 - np.cos(angle))) if roll else (x, 0 * x)
    depth = depth + wave_mm * np.sin(2 * np.pi * (y / SIZE_MM[0] + 0.3 * x / SIZE_MM[1]))
    return film.bent(np.stack([across, y, depth], axis=-1))


def camera_at(tilt_deg: float, side: int) -> Camera:
    """A camera 700 mm away from the film's middle, ``tilt_deg`` to the side of its normal and half as much above."""
    t = np.deg2rad(tilt_deg)
    eye = 700 * np.array([np.sin(t), -np.sin(t / 2), -np.cos(t)])
    focal = 1.35 * side
    intrinsics = np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1]])
    return Camera(intrinsics, look_at(eye, np.zeros(3), np.array([0.0, 1, 0])), (0.0, 0.0), (side, side))


def cases() -> list[Case]:
    """Matt to mirror-like films, rooms, boxes and lamps of each kind, rolled and waved."""
    matt = Material(0.6, 0.3, 0.0, 0.005, 0.6, 1.5)
    satin, sleeve = replace(matt, roughness=0.3), replace(matt, roughness=0.1, surfaces=3)
    published = Material(0.25, 0.7, 0.0, 0.002, 0.95, 1.45)
    clear = Material(0.2, 0.2, 0.5, 0.005, 0.15, 1.5)
    room = Light(front=1.0, turn_deg=40.0, lying=False)
    box = LightBox((5.0, 5.2, 5.5), 0.4, (0.4, 0.6), 0.6, 3.0, True, (1.3, 1.2), 10.0)
    bulb = Lamp("sphere", (150.0, -250.0, -300.0), (0, 0, 1), (1, 0, 0), (35.0, 35.0), (250.0, 180.0, 110.0))
    tilted = (0.0, 0.6, 0.8)
    panel = Lamp("rectangle", (-80.0, -300.0, -420.0), tilted, (1, 0, 0), (120.0, 60.0), (40.0, 42.0, 45.0))
    disc = Lamp("disc", (0.0, -420.0, -560.0), tilted, (1, 0, 0), (70.0, 70.0), (60.0, 50.0, 40.0))
    flash = Lamp("sphere", (10.0, -8.0, 0.0), (0, 0, 1), (1, 0, 0), (3.0, 3.0), (4e4, 4e4, 4e4), at_camera=True)
    window = Lamp("rectangle", (-1200.0, 0.0, -300.0), (1, 0, 0), (0, 0, 1), (600.0, 800.0), (12.0, 13.0, 15.0))
    dim = replace(room, front=0.3)
    return [
        Case("matt, room, rolled", matt, room, roll=1.2, grey=0.5),
        Case("satin, room, waved", satin, room, wave_mm=25, tilt_deg=25, room=1, grey=0.03),
        Case(
            "satin, room, rolled, grazing", satin, replace(room, lying=True), roll=-0.8, tilt_deg=50, room=2, grey=0.03
        ),
        Case("mirror-like sleeve, room, waved", sleeve, room, wave_mm=15, tilt_deg=15, room=1, grey=0.03),
        Case("published material, room", published, room, roll=1.0, tilt_deg=20, room=2, grey=0.6),
        Case("clear film, room behind", clear, room, wave_mm=15, tilt_deg=20, room=0, grey=0.6),
        Case("light box, dark room", replace(clear, roughness=0.3), replace(room, front=0.05, box=box), roll=0.3),
        Case("bulb on satin", satin, replace(dim, lamps=(bulb,)), roll=0.6, room=1, grey=0.03),
        Case(
            "panel on glossy",
            replace(satin, roughness=0.15),
            replace(dim, lamps=(panel,)),
            wave_mm=20,
            tilt_deg=10,
            grey=0.03,
        ),
        Case("disc on matt", matt, replace(dim, lamps=(disc,)), roll=0.8, tilt_deg=-20, room=2),
        Case(
            "flash on glossy",
            replace(satin, roughness=0.2),
            replace(dim, lamps=(flash,)),
            wave_mm=25,
            room=2,
            grey=0.03,
        ),
        Case("window beside, matt", matt, replace(dim, lamps=(window,)), wave_mm=20, room=1),
    ]


def compare(case: Case, rooms: Sequence[Environment], options: Options) -> tuple[dict[str, Any], np.ndarray]:
    """A case's figures, and its picture: model, traced, difference."""
    film = bent_film(case.roll, case.wave_mm)
    room = rooms[case.room % len(rooms)]
    camera = camera_at(case.tilt_deg, options.side)
    scene = replace(
        sample_scene(film, camera.size, np.random.default_rng(0), SceneConfig()),
        camera=camera.resized((1024, 1024)),
        material=case.material,
        light=case.light,
        shadows=(),
    )
    model, inside = shaded(film, scene, room, camera, case.grey)
    scene = replace(scene, camera=camera)
    began = time.perf_counter()
    half = TraceConfig(options.samples // 2, self_shadows=False)
    first, second = (trace(film, scene, room, case.grey, replace(half, seed=seed)) for seed in (1, 2))
    shadowed = trace(film, scene, room, case.grey, TraceConfig(options.samples))
    full = trace(film, scene, room, case.grey, TraceConfig(options.samples, max_depth=8))
    direct = (first + second) / 2
    figures = {
        "name": case.name,
        "room": room.name,
        "shading": difference(model, direct, inside),
        "shadows": difference(model, shadowed, inside),
        "full": difference(model, full, inside),
        "noise": difference(first, second, inside) / 2,
        "bias": float((model - direct)[inside].mean() / direct[inside].mean()),
        "pixels": int(inside.sum()),
        "trace_s": round(time.perf_counter() - began, 1),
    }
    level = np.quantile(direct[inside], 0.95)
    pictures = (model, direct, full, np.abs(model - direct) * 5)
    return figures, np.concatenate([srgb_from_linear(p * inside[..., None] * 0.7 / level) for p in pictures], axis=1)


def shaded(
    film: FilmMesh, scene: Scene, room: Environment, camera: Camera, grey: float
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """The model's radiance averaged over each pixel, and the pixels with nothing but film within two pixels."""
    light = film_light(film, scene, prefilter(room))
    fine = camera.resized((camera.size[0] * SUPERSAMPLE, camera.size[1] * SUPERSAMPLE))
    mask, uv = FilmCaster(film).uv_map(fine)
    values = light.gain * np.float32(grey) + light.veil
    seen = sample_bilinear(values, pixel_from_film(np.where(mask[..., None], uv, 0.0), values.shape[:2]))
    picture = cv2.resize(seen, camera.size[::-1], interpolation=cv2.INTER_AREA)
    whole = cv2.resize(mask.astype(np.float32), camera.size[::-1], interpolation=cv2.INTER_AREA) > 0.999
    return picture, cv2.erode(whole.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0


def difference(model: np.ndarray, traced: np.ndarray, inside: np.ndarray) -> float:
    """Mean over pixels and channels of |model - traced| / traced."""
    a, b = model[inside], traced[inside]
    return float(np.mean(np.abs(a - b) / np.maximum(b, 1e-6)))


def measured(options: Options) -> dict[str, Any]:
    """The figures of every scene; also writes the pictures.

    Raises:
        ConfigError: no scene has such a name; Mitsuba, its LLVM or Open3D is missing.
    """
    check_open3d()
    mitsuba()
    if options.hdri:
        rooms = load_environments(options.hdri)
    else:
        rooms = [procedural_room(np.random.default_rng(seed)) for seed in (3, 5, 8)]
    figures, rows = [], []
    chosen = [case for case in cases() if not options.only or any(word in case.name for word in options.only)]
    if not chosen:
        do = f"Use words of these: {', '.join(case.name for case in cases())}."
        raise ConfigError(describe(what="--only", got=options.only, allowed="words in a scene's name", do=do))
    for case in chosen:
        one, picture = compare(case, rooms, options)
        figures.append(one)
        rows.append(picture)
        print(
            f"{one['name']:34s} {one['room'][:14]:14s} "
            + "  ".join(f"{key} {one[key]:6.2%}" for key in ("shading", "shadows", "full", "noise", "bias"))
            + f"  {one['trace_s']:5.1f} s",
            flush=True,
        )
    if options.picture:
        picture = cv2.resize(np.concatenate(rows), None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST)
        write_picture(options.picture, np.rint(picture * 255).astype(np.uint8))
    within = sum(one["shading"] <= BOUND for one in figures)
    return {
        "options": {"side": options.side, "samples": options.samples},
        "within_5_percent": within,
        "scenes": figures,
    }


def run(options: Options, command: list[str]) -> dict[str, Any]:
    """Measure, and write the figures."""
    figures = measured(options)
    write_figures(options.json_path, command, figures)
    return figures


def _verdict(figures: dict[str, Any]) -> int:
    return 0 if figures["within_5_percent"] == len(figures["scenes"]) else 2


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 if every scene is within the bound, 2 otherwise."""
    return run_command("benchmarks.radiance", Options, run, arguments, _verdict)


if __name__ == "__main__":
    sys.exit(main())
