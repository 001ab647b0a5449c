"""What a photo is taken of and how: pose, light, material, background and camera settings, drawn at random."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from hybrid.coords import node_centres_1d
from hybrid.mesh.camera import Camera, look_at
from hybrid.mesh.film import FilmMesh


@dataclass(frozen=True)
class SceneConfig:
    """Ranges from which scenes are drawn.

    light_box_share: films on a light box instead of in a room (PAPER: 20 %). fov_deg: across the photo's side.
    fill: longer side of the film's bounding box over the photo's side. leave_share: films that leave the frame.
    tilt_deg: spread (one sigma) of the view direction about the film's normal. roll_deg: likewise, about the axis.
    occluder_share: photos with fingers or clips over the film's rim. shadow_share: soft shadows on the film.
    """

    light_box_share: float = 0.2
    fov_deg: tuple[float, float] = (16.0, 68.0)
    fill: tuple[float, float] = (0.55, 0.97)
    leave_share: float = 0.06
    tilt_deg: float = 17.0
    roll_deg: float = 14.0
    occluder_share: float = 0.2
    shadow_share: float = 0.3


@dataclass(frozen=True)
class Material:
    """How the film answers to light.

    diffuse: share of the print's reflectance. transmission: share of light from behind that white lets through,
    scattered. clear: likewise unscattered. haze: grey that the sheet itself scatters. roughness: GGX. ior: of the
    surface. gloss: factor on the Fresnel reflection (1: one surface).
    """

    diffuse: float
    transmission: float
    clear: float
    haze: float
    roughness: float
    ior: float
    gloss: float


@dataclass(frozen=True)
class Light:
    """What lights the film besides the environment.

    light_box: True on a light box. box_radiance: its brightness, box_falloff: how it fades to its rim.
    front: factor on the environment's light. turn_deg: azimuth by which the room is turned, lying: film on its back.
    """

    light_box: bool
    box_radiance: float
    box_falloff: float
    front: float
    turn_deg: float
    lying: bool


@dataclass(frozen=True)
class Lens:
    """What the camera does to the light, all at random.

    exposure: linear level that the film's bright parts (95th percentile) reach. temperature: log2 red/blue gain.
    tint: log2 green gain. tone: 'srgb', 'filmic' or 'punchy'. vignette: loss in the corners. bloom: share of light
    scattered. defocus_px, motion_px: blur in pixels of a 1000 px photo. sharpen: unsharp amount.
    noise: of read and shot. jpeg: quality.
    """

    exposure: float
    temperature: float
    tint: float
    tone: str
    vignette: float
    bloom: float
    defocus_px: float
    motion_px: float
    sharpen: float
    noise: float
    jpeg: int


@dataclass(frozen=True, eq=False)
class Scene:
    """One photograph about to be taken. background: 'room', 'table', 'plain' or 'panel'."""

    camera: Camera
    material: Material
    light: Light
    lens: Lens
    background: str
    occluders: int
    shadow: bool

    def parameters(self) -> dict[str, Any]:
        """Everything but the camera, JSON-able."""
        rest = {"background": self.background, "occluders": self.occluders, "shadow": self.shadow}
        return {k: asdict(getattr(self, k)) for k in ("material", "light", "lens")} | rest


def sample_scene(film: FilmMesh, size: tuple[int, int], rng: np.random.Generator, config: SceneConfig) -> Scene:
    """A random scene for a bent film and a photo of ``size`` (height, width)."""
    camera = sample_camera(film, size, rng, config)
    light = _sample_light(rng, config)
    if light.light_box:
        background = str(rng.choice(["plain", "panel"], p=[0.6, 0.4]))
    else:
        background = str(rng.choice(["room", "table", "plain"], p=[0.5, 0.4, 0.1]))
    occluders = int(rng.integers(1, 4)) if rng.random() < config.occluder_share else 0
    shadow = bool(rng.random() < config.shadow_share)
    return Scene(camera, _sample_material(rng), light, _sample_lens(rng), background, occluders, shadow)


def sample_camera(film: FilmMesh, size: tuple[int, int], rng: np.random.Generator, config: SceneConfig) -> Camera:
    """A phone held in front of the film so that it fills the wanted part of the frame."""
    t = node_centres_1d(17)
    points = film.surface(t, t).reshape(-1, 3)
    normal = film.normals(t, t).reshape(-1, 3).mean(axis=0)
    normal /= np.linalg.norm(normal)
    focal = 0.5 / np.tan(np.deg2rad(rng.uniform(*config.fov_deg)) / 2)  # in units of the photo's side
    roll = rng.normal(0, np.deg2rad(config.roll_deg))
    fill = rng.uniform(*config.fill)
    leave = rng.random() < config.leave_share
    eye_direction = _tilted(normal, abs(rng.normal(0, np.deg2rad(config.tilt_deg))), rng)
    down = np.array([np.sin(roll), np.cos(roll), 0.0])
    distortion = (float(rng.normal(0, 0.02)), float(rng.normal(0, 0.005)))
    centre = (points.max(axis=0) + points.min(axis=0)) / 2
    distance = focal * max(film.size_mm) / fill
    intrinsics = np.array([[focal * size[1], 0, size[1] / 2], [0, focal * size[0], size[0] / 2], [0, 0, 1]])
    camera = Camera(intrinsics, look_at(centre + distance * eye_direction, centre, down), distortion, size)
    for _ in range(3):  # the bounding box follows the distance almost inversely, so a few corrections suffice
        low, high = _bounding_box(camera, points)
        distance *= float((high - low).max()) / fill
        camera = Camera(intrinsics, look_at(centre + distance * eye_direction, centre, down), distortion, size)
    low, high = _bounding_box(camera, points)
    slack = 0.5 - (high - low) / 2 + (0.25 if leave else -0.012)
    wanted = np.clip(rng.normal(0, 0.5, 2), -1, 1) * np.maximum(slack, 0.0)
    return _panned(camera, wanted - ((high + low) / 2 - 0.5))


def _bounding_box(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the projected points' bounding box, in units of the photo's sides."""
    relative = camera.photo_from_world(points) / np.array(camera.size[::-1])
    return relative.min(axis=0), relative.max(axis=0)


def _panned(camera: Camera, shift: np.ndarray) -> Camera:
    """The camera turned so that its picture moves by ``shift`` (units of the photo's sides)."""
    focal = camera.intrinsics[0, 0] / camera.size[1]
    ax, ay = np.arctan(shift[0] / focal), np.arctan(shift[1] / focal)
    yaw = np.array([[np.cos(ax), 0, np.sin(ax)], [0, 1, 0], [-np.sin(ax), 0, np.cos(ax)]])
    pitch = np.array([[1, 0, 0], [0, np.cos(ay), np.sin(ay)], [0, -np.sin(ay), np.cos(ay)]])
    pose = np.eye(4)
    pose[:3, :3] = yaw @ pitch
    return Camera(camera.intrinsics, pose @ camera.camera_from_world, camera.distortion, camera.size)


def _tilted(normal: np.ndarray, angle: float, rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """A unit vector at ``angle`` from ``normal``, in a random direction; at most 55 degrees away."""
    side = rng.normal(size=3)
    side -= side @ normal * normal
    side /= np.linalg.norm(side)
    angle = min(angle, np.deg2rad(55))
    return np.cos(angle) * normal + np.sin(angle) * side


def _sample_material(rng: np.random.Generator) -> Material:
    glossy = rng.random() < 0.65
    return Material(
        diffuse=float(rng.uniform(0.2, 1.0)),
        transmission=float(rng.uniform(0.1, 0.9)),
        clear=float(rng.uniform(0, 0.6)) if rng.random() < 0.4 else 0.0,
        haze=float(10 ** rng.uniform(-3, -1.4)),
        roughness=float(rng.uniform(0.05, 0.35) if glossy else rng.uniform(0.35, 0.95)),
        ior=float(rng.uniform(1.3, 1.6)),
        gloss=float(rng.uniform(0.5, 2.0) if glossy else rng.uniform(0.1, 1.0)),
    )


def _sample_light(rng: np.random.Generator, config: SceneConfig) -> Light:
    light_box = bool(rng.random() < config.light_box_share)
    dark_room = light_box and rng.random() < 0.7
    return Light(
        light_box=light_box,
        box_radiance=float(rng.uniform(1.0, 6.0)),
        box_falloff=float(rng.uniform(0.0, 0.8)),
        front=float(rng.uniform(0.0, 0.15)) if dark_room else 1.0,
        turn_deg=float(rng.uniform(0, 360)),
        lying=bool(rng.random() < 0.4),
    )


def _sample_lens(rng: np.random.Generator) -> Lens:
    return Lens(
        exposure=float(np.exp(rng.normal(np.log(0.7), 0.55))),
        temperature=float(rng.normal(0, 0.25)),
        tint=float(rng.normal(0, 0.08)),
        tone=str(rng.choice(["srgb", "filmic", "punchy"], p=[0.45, 0.35, 0.2])),
        vignette=float(rng.uniform(0, 0.4)),
        bloom=float(rng.uniform(0, 0.06)) if rng.random() < 0.4 else 0.0,
        defocus_px=float(abs(rng.normal(0, 1.2))),
        motion_px=float(rng.uniform(1, 5)) if rng.random() < 0.15 else 0.0,
        sharpen=float(rng.uniform(0, 1.0)) if rng.random() < 0.5 else 0.0,
        noise=float(10 ** rng.uniform(-3.2, -1.8)),
        jpeg=int(rng.integers(45, 97)),
    )
