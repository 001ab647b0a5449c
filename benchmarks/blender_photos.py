"""Photos by another renderer, other physics: ``python -m benchmarks.blender_photos --out DIR --python PYTHON``.

Blender bends sheets as soft bodies or cloth, which stretch and twist as the mass-spring films of data_gen do not, and
traces their light with Cycles (benchmarks/scenes/blender_scene.py). The result is a folder for benchmarks.photos.truth;
every benchmark takes it by ``--photos DIR``, and no network was trained on its like. The prints are data_gen's.

PYTHON is one that has ``bpy`` (Python 3.11, ``pip install bpy==5.0.1``), which cannot share an environment with this
project, as it needs an older NumPy. A photo takes half a minute on two cores. Photos that already exist are kept, so a
run that was stopped can be continued.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from benchmarks.command import GOES_ON, run_command
from data_gen.manifest import deciding, describe_dataset, described_sources, generator_digest
from data_gen.prints.prints import FilmPrint, make_print
from data_gen.sources import SourceConfig, draw_volume, loaded
from data_gen.work import source_names
from hybrid.errors import ConfigError, DataError, describe, require_at_least
from hybrid.files import make_folder
from hybrid.image_io import write_rgb

SCENE = Path(__file__).parent / "scenes" / "blender_scene.py"


@dataclass(frozen=True)
class Options:
    """Make check photos with Blender."""

    out: Path
    """Folder of the photos."""
    python: Path
    """A Python that has bpy."""
    count: int = 48
    """How many photos."""
    seed: int = 0
    """Seed of all random choices."""
    side: int = 1080
    """Side of the photos in pixels."""
    samples: int = 24
    """Light samples per pixel, before denoising."""
    hard_shadows: bool = False
    """Put each film in front of a desk, in the light of a small lamp that casts its shadow beside it."""
    sources: tyro.conf.OmitArgPrefixes[SourceConfig] = field(default_factory=SourceConfig)
    """CT volumes and environments; without environments the light is plain."""

    def __post_init__(self) -> None:
        require_at_least(self, 1, "count", "samples")
        require_at_least(self, 64, "side")
        require_at_least(self, 0, "seed")


@dataclass(frozen=True)
class Job:
    """One photo, as benchmarks/scenes/blender_scene.py reads it. Lengths in units of half the film's longer side.

    photo, texture: files. size: (height, width) of the film. cuts: of each side, between simulated quads.
    kind: soft or cloth. pins: vertices held. strength, noise, field_at: of the force that pushes (< 0 pulls) from a
    place. stiffness: against bending. gravity: in parts of the Earth's. max_angle: the simulation ends when a normal is
    this many degrees from the mean normal.
    roughness: of the surface. through: share of the light that is let through.
    room: file of the environment, or "" for ``room_colour``. room_turn: its Euler angles in rad.
    lamps: discs of ``size`` that shine at the film's middle. desk: a plane ``behind`` the film's middle, if any.
    focal: in parts of the photo's side. tilt, tilt_to, roll: degrees off the normal, towards where, and about the axis.
    fill: share of the photo's side that the film takes. off_centre: in parts of the free space that is left.
    tone: Blender's view transform. brightness: of the photo's mean radiance. quality: of the JPEG.
    """

    photo: str
    texture: str
    size: tuple[float, float]
    cuts: int
    kind: str
    pins: tuple[int, ...]
    strength: float
    noise: float
    field_at: tuple[float, float, float]
    stiffness: float
    gravity: float
    max_angle: float
    roughness: float
    through: float
    room: str
    room_colour: tuple[float, float, float]
    room_turn: tuple[float, float, float]
    lamps: tuple[dict[str, Any], ...]
    desk: dict[str, Any] | None
    focal: float
    tilt: float
    tilt_to: float
    roll: float
    fill: float
    off_centre: tuple[float, float]
    tone: str
    brightness: float
    quality: int
    side: int
    samples: int
    seed: int


def draw_job(rng: np.random.Generator, film_print: FilmPrint, rooms: Sequence[Path], options: Options) -> Job:
    """A film, its bend, its light and its camera; the files and the seed are still to be set."""
    height, width = film_print.size_mm
    scale = 2 / max(height, width)
    cuts = int(rng.integers(8, 20))
    soft = bool(rng.random() < 0.6)
    lit_from_behind = bool(rng.random() < 0.25)
    desk = not lit_from_behind and bool(rng.random() < 0.3)
    glossy = bool(rng.random() < 0.5)
    from_side = float(rng.choice([-1, 1]) * rng.uniform(0.2, 1))
    force = rng.uniform(5, 20) if soft else rng.uniform(1000, 5000)
    room = "" if lit_from_behind or not rooms else str(rooms[int(rng.integers(len(rooms)))].resolve())
    job = Job(
        photo="",
        texture="",
        size=(height * scale, width * scale),
        cuts=cuts,
        kind="soft" if soft else "cloth",
        pins=tuple(rng.choice((cuts + 2) ** 2, int(rng.integers(4, 13)), replace=False).tolist()),
        strength=float(rng.choice([-1, 1]) * force),
        noise=float(rng.uniform(0, 0.3) * force),
        field_at=(*rng.uniform(-1, 1, 2).tolist(), from_side),
        stiffness=float(rng.uniform(2, 10) if soft else 10 ** rng.uniform(0, 2)),
        gravity=float(rng.uniform(0, 0.2) if rng.random() < 0.3 else 0.0),
        max_angle=float(rng.uniform(4, 50)),
        roughness=float(rng.uniform(0.1, 0.35) if glossy else rng.uniform(0.4, 0.95)),
        through=float(rng.uniform(0.4, 0.9) if lit_from_behind else 0.0),
        room=room,
        room_colour=tuple((rng.uniform(0.01, 0.3) * rng.uniform(0.9, 1, 3)).tolist()),
        room_turn=tuple(rng.uniform(-np.pi, np.pi, 3).tolist()),
        lamps=_lamps(rng, lit_from_behind, bool(room)),
        desk=_desk(rng) if desk else None,
        focal=float(rng.uniform(0.8, 1.6)),
        tilt=float(abs(rng.normal(0, 14))),
        tilt_to=float(rng.uniform(-180, 180)),
        roll=float(rng.normal(0, 12)),
        fill=float(rng.uniform(0.55, 0.95)),
        off_centre=tuple(rng.uniform(-0.9, 0.9, 2).tolist()),
        tone=str(rng.choice(["Standard", "AgX", "Filmic"])),
        brightness=float(np.exp(rng.uniform(np.log(0.12), np.log(0.5)))),
        quality=int(rng.integers(80, 97)),
        side=options.side,
        samples=options.samples,
        seed=0,
    )
    if options.hard_shadows:
        strength, size = float(rng.uniform(150, 600)), float(rng.uniform(0.02, 0.2))
        job = replace(job, through=0.0, lamps=(_lamp(rng, 1.0, 2.5, size, strength),), desk=_desk(rng))
    return job


def _lamps(rng: np.random.Generator, behind: bool, room: bool) -> tuple[dict[str, Any], ...]:
    """Discs behind the film, or in front of it: always some where no room lights it."""
    if behind:
        return (_lamp(rng, -1.0, 0.3, float(rng.uniform(2, 4)), 300.0),)
    if room and rng.random() < 0.6:
        return ()
    return tuple(
        _lamp(rng, 1.0, 2.5, float(rng.uniform(0.1, 1.5)), float(rng.uniform(30, 150)))
        for _ in range(int(rng.integers(1, 3)))
    )


def _lamp(rng: np.random.Generator, side: float, at: float, size: float, watts: float) -> dict[str, Any]:
    """A disc on one side of the film, up to ``at`` off its middle."""
    place = (float(rng.uniform(-at, at)), float(rng.uniform(-at, at)), side * float(rng.uniform(2, 4)))
    return {"at": place, "size": size, "watts": watts, "colour": rng.uniform(0.75, 1, 3).tolist()}


def _desk(rng: np.random.Generator) -> dict[str, Any]:
    """A plane behind the film, at least as far from its middle as this says, mottled in two colours."""
    base = rng.uniform(0.02, 0.7) * rng.uniform(0.6, 1, 3)
    return {
        "behind": float(rng.uniform(0.5, 1.2)),
        "scale": float(rng.uniform(1, 20)),
        "roughness": float(rng.uniform(0.2, 0.9)),
        "colours": [base.tolist(), (base * rng.uniform(0.3, 1.2, 3)).clip(0, 1).tolist()],
    }


def write_print(folder: Path, number: int, film_print: FilmPrint) -> Path:
    """Write the print among the textures, under a name that benchmarks.photos.truth can read."""
    margin = round(max(film_print.parameters["margins_px"]))
    name = f"film_{number:03d}_{film_print.rows}x{film_print.cols}_{film_print.style}_m{margin}.png"
    grey = np.rint(film_print.image * 255).astype(np.uint8)
    path = folder / "textures" / name
    write_rgb(path, np.repeat(grey[..., None], 3, axis=-1))
    return path


def make_photo(number: int, rooms: Sequence[Path], options: Options) -> None:
    """Make photo ``number``, unless it exists. The same seed and number draw the same job, but Blender bends a sheet a
    little differently each time; the truth is that of the photo.

    Raises:
        DataError: Blender made no photo.
    """
    photo = options.out / f"film_{number:03d}.jpg"
    truth = photo.with_suffix(".npz")
    if photo.exists() and truth.exists():
        return
    rng = np.random.default_rng([options.seed, number])
    film_print = make_print(draw_volume(options.sources, rng), rng)
    job = draw_job(rng, film_print, rooms, options)
    texture = write_print(options.out, number, film_print)
    job = replace(job, photo=str(photo.resolve()), texture=str(texture.resolve()), seed=options.seed + number)
    with tempfile.TemporaryDirectory() as folder:
        words = Path(folder) / "job.json"
        words.write_text(json.dumps(asdict(job)))
        got = _told([str(options.python), str(SCENE), str(words)])
    if not truth.exists():
        do = "Name a Python 3.11 with bpy==5.0.1 by --python, and add the system libraries that it misses."
        raise DataError(describe(what="Blender made no photo", where=photo.name, got=got, do=do))


def _told(command: Sequence[str]) -> str:
    """The last line that a command printed."""
    try:
        ended = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        return str(error)
    return (ended.stderr.strip() or ended.stdout.strip() or f"exit code {ended.returncode}").splitlines()[-1]


def room_files(sources: SourceConfig) -> list[Path]:
    """The files of the environments that the options choose, by name; none where no folder is given."""
    if sources.hdri is None:
        return []
    files = {path.stem: path for path in sorted(sources.hdri.rglob("*.hdr"))}
    return [files[room.name] for room in loaded(sources)[1]]


def run(options: Options, command: list[str]) -> int:
    """Make the photos; return how many there are.

    Raises:
        ConfigError: the folder holds photos that were made with other options.
    """
    make_folder(options.out / "textures", "--out")
    _keep_options(options)
    rooms = room_files(options.sources)
    for number in tqdm(range(options.count), unit="photo"):
        make_photo(number, rooms, options)
    return options.count


def _keep_options(options: Options) -> None:
    """Write dataset.json with what determines the photos, or check that the existing ones were made alike."""
    photos = sum(1 for _ in options.out.glob("film_*.npz"))
    if photos and not (options.out / "dataset.json").exists():
        do = "Choose another --out."
        raise ConfigError(describe(what="--out", where=options.out, got="photos without dataset.json", do=do))
    sources = described_sources(options.sources, source_names(options.sources))
    drawn = {name: getattr(options, name) for name in ("seed", "side", "samples", "hard_shadows")}
    decided = deciding(generator=_makers(), sources=sources, **drawn)
    describe_dataset(options.out, decided, max(options.count, photos))


def _makers() -> str:
    """A digest of the sources that make prints, draw jobs and set up the scene."""
    scene = b"".join(path.read_bytes() for path in (Path(__file__), SCENE))
    return hashlib.sha256(generator_digest().encode() + scene).hexdigest()[:16]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; 0 when all photos are there."""
    return run_command("benchmarks.blender_photos", Options, run, arguments, stopped=GOES_ON)


if __name__ == "__main__":
    sys.exit(main())
