"""What lights a film and how it answers: records of material and light, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from data_gen.light.lamps import Lamp, Shape, Vector, planckian, vector_irradiance
from hybrid.mesh.camera import Camera
from hybrid.mesh.film import FilmMesh

Vector3 = Float[np.ndarray, "3"]

LAMP_SHARE = 0.7
"""Share of photos in rooms with lamps near the film."""

FLASH_SHARE = 0.25
"""Share of those in which the phone's flash is one of them."""

MIRRORED_SHARE = 0.85
"""Share of lamps, except flashes and those behind the film, that are placed where some point of it mirrors them."""

FARTHER = tuple(np.geomspace(1.0, 4.0, 12).tolist())
"""Factors by which a lamp may be moved farther away than drawn, so that it does not stand between camera and film."""

_FLASH_AT_MM = 500.0
"""Distance at which a flash gives the irradiance that was drawn for it."""


@dataclass(frozen=True)
class Material:
    """How the film responds to light (the equations are in render/shade.py).

    diffuse: share that white scatters back, transmission: share let through scattered, clear: share passed straight.
    haze: share that the sheet itself scatters to each side, whatever is printed. Their sum, with haze twice, is at most
    1. roughness: GGX's, alpha = roughness^2. ior: refractive index. surfaces: 1, or 3 in a clear sleeve. tint: RGB
    share that the base lets through: films are clear or bluish.
    """

    diffuse: float
    transmission: float
    clear: float
    haze: float
    roughness: float
    ior: float
    surfaces: int = 1
    tint: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        shares = (self.diffuse, self.transmission, self.clear, self.haze)
        if min(shares) < 0 or self.diffuse + self.transmission + self.clear + 2 * self.haze > 1 + 1e-9:
            raise ValueError(f"Material: got shares {shares}; allowed: >= 0, with twice the haze at most 1 in all")


@dataclass(frozen=True)
class LightBox:
    """A bright panel behind the film.

    radiance: linear RGB where it is brightest. falloff: share lost far from ``centre``, over ``spread`` of its sides.
    tubes: waves of brightness across it (0: none); tubes run along its height if ``upright``. size: of its sides,
    relative to the film's. gap_mm: between it and the film. offset: of its middle from the film's, to the right and
    down as seen, relative to the film's sides; if it is large, the film hangs over.
    """

    radiance: Vector
    falloff: float
    centre: tuple[float, float]
    spread: float
    tubes: float
    upright: bool
    size: tuple[float, float]
    gap_mm: float
    offset: tuple[float, float] = (0.0, 0.0)

    def brightness(self, uv: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Relative brightness at points of the panel, (0, 0) to (1, 1) from corner to corner."""
        distance2 = ((uv - np.array(self.centre)) ** 2).sum(axis=-1)
        fade = 1 - self.falloff * (1 - np.exp(-distance2 / (2 * self.spread**2)))
        if self.tubes:
            fade = fade * (0.93 + 0.07 * np.cos(2 * np.pi * self.tubes * uv[..., 0 if self.upright else 1]))
        return fade.astype(np.float32)


@dataclass(frozen=True)
class Light:
    """What lights the film.

    box: a light box behind it, or None. front: factor on the environment's light. turn_deg: azimuth by which the room
    is turned, lying: the film lies on its back, or on its face if ``face_down``. lamps: near the film, in its world.
    """

    front: float
    turn_deg: float
    lying: bool
    box: LightBox | None = None
    lamps: tuple[Lamp, ...] = ()
    face_down: bool = False

    @property
    def light_box(self) -> bool:
        return self.box is not None

    @property
    def box_radiance(self) -> float:
        """Mean of the box's brightest radiance over RGB; 0 without a box."""
        return float(np.mean(self.box.radiance)) if self.box else 0.0

    @property
    def up(self) -> Float[np.ndarray, "3"]:
        """The room's upward direction in the film's world."""
        above = 1.0 if self.face_down else -1.0
        return np.array([0.0, 0.0, above] if self.lying else [0.0, -1.0, 0.0])


TURNED_OVER = np.diag([1.0, -1.0, -1.0])
"""Half a turn about the film's x axis."""


def room_from_film(light: Light) -> Float[np.ndarray, "3 3"]:
    """Rotation from the film's world (x right, y down, z away) to the room's (z up)."""
    upright = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # down is the floor, away is horizontal
    lying = np.eye(3) if light.face_down else TURNED_OVER  # away is the floor, or what is overhead
    turn = np.deg2rad(light.turn_deg)
    azimuth = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    return azimuth @ (lying if light.lying else upright)


# ---------------------------------------------------------------- at random


CLEAR_SHARE = 0.3
"""Usual share of films made as most are: with a clear base through which the background is seen. None in front of a
dark background, where they would show nothing."""

BLUE_SHARE = 0.4
"""Share of films with a bluish base."""

BLUE_BASE = (0.72, 0.88, 1.0)
"""RGB share that the bluest base lets through."""


def sample_material(rng: np.random.Generator, clear_share: float = CLEAR_SHARE) -> Material:
    """A random film: a tenth as published (PAPER code), over half with clear reflections, the rest between.

    clear_share: how often the film is one that hardly scatters.
    """
    kind = rng.random()
    if kind < 0.1:
        diffuse, transmission, clear, roughness = 0.25, 0.7, 0.0, 0.95
        ior, total = float(rng.uniform(1.1, 1.6)), 0.95
    else:
        diffuse, transmission = float(rng.uniform(0.2, 1.0)), float(rng.uniform(0.1, 0.9))
        clear = float(rng.uniform(0.05, 0.8)) if rng.random() < 0.4 else 0.0
        if clear_share and rng.random() < clear_share:
            diffuse, transmission, clear = float(rng.uniform(0, 0.12)), float(rng.uniform(0, 0.12)), 1.0
        roughness = float(rng.uniform(0.05, 0.3) if kind < 0.68 else rng.uniform(0.3, 0.95))
        ior, total = float(rng.uniform(1.3, 1.6)), float(rng.uniform(0.5, 0.95))
    scale = total / (diffuse + transmission + clear)
    return Material(
        diffuse=diffuse * scale,
        transmission=transmission * scale,
        clear=clear * scale,
        haze=float(10 ** rng.uniform(-3.3, -1.7)),
        roughness=roughness,
        ior=ior,
        surfaces=3 if kind >= 0.1 and rng.random() < 0.12 else 1,
        tint=_vector(np.array(BLUE_BASE) ** rng.random()) if rng.random() < BLUE_SHARE else (1.0, 1.0, 1.0),
    )


def sample_light(rng: np.random.Generator, light_box_share: float) -> Light:
    """Random light: a room with or without lamps, or a light box in a dark or a lit room."""
    boxed = bool(rng.random() < light_box_share)
    dark_room = boxed and rng.random() < 0.7
    light = Light(
        front=float(rng.uniform(0.0, 0.15)) if dark_room else float(rng.uniform(0.4, 1.0)) if boxed else 1.0,
        turn_deg=float(rng.uniform(0, 360)),
        lying=bool(rng.random() < (0.15 if boxed else 0.4)),
        box=_light_box(rng) if boxed else None,
    )
    if boxed or rng.random() >= LAMP_SHARE:
        return light
    lamps = [_flash(rng)] if rng.random() < FLASH_SHARE else []
    kinds = (_ceiling_lamp, _ceiling_lamp, _desk_lamp, _desk_lamp, _window, _window)
    for _ in range(int(rng.integers(0 if lamps else 1, 3))):
        lamps.append(kinds[int(rng.integers(len(kinds)))](rng, light.up))
    return replace(light, lamps=tuple(lamps))


def over_table(light: Light, camera_mm: Vector3) -> Light:
    """The light, with its room turned over if a lying film would be seen through the table: it then lies on its face.

    The phone's flash stays where it is.
    """
    if not light.lying or light.up @ camera_mm > 0:
        return light
    lamps = tuple(lamp if lamp.at_camera else _turned(lamp, TURNED_OVER) for lamp in light.lamps)
    return replace(light, lamps=lamps, face_down=not light.face_down)


def _turned(lamp: Lamp, turn: Float[np.ndarray, "3 3"]) -> Lamp:
    """The lamp turned about the world's origin."""
    centre, axis, across = np.array([lamp.centre_mm, lamp.axis, lamp.across]) @ turn.T
    return replace(lamp, centre_mm=_vector(centre), axis=_vector(axis), across=_vector(across))


def some_mirrored(light: Light, film: FilmMesh, camera: Camera, rng: np.random.Generator) -> Light:
    """The light with a share of its lamps turned about the film's middle to where the camera sees them in the film.

    Those behind the film stay there, as when a film is held up to a window. No lamp may stand in the photo in front of
    the film: it is moved farther away and enlarged as much, so that it lights the middle as before, or left out.
    """
    eye, lamps = camera.centre_world, []
    for lamp in light.lamps:
        places = [_farther(lamp, times) for times in FARTHER]
        if lamp.at_camera:
            places = [lamp]
        elif not _stands_behind(lamp, eye) and rng.random() < MIRRORED_SHARE:
            u, v = rng.uniform(0.15, 0.85, (2, 1))
            point, normal = film.surface(u, v)[0, 0], film.normals(u, v)[0, 0]
            places = [mirrored(place, point, normal, eye) for place in places]
        lamps.append(next((place for place in places if not _stands_before(place, film, camera)), None))
    return replace(light, lamps=tuple(lamp for lamp in lamps if lamp))


def _farther(lamp: Lamp, times: float) -> Lamp:
    """The lamp moved so many times as far from the world's origin, and enlarged as much."""
    half = (times * lamp.half_mm[0], times * lamp.half_mm[1])
    return replace(lamp, centre_mm=_vector(times * np.array(lamp.centre_mm)), half_mm=half)


def _stands_before(lamp: Lamp, film: FilmMesh, camera: Camera) -> bool:
    """Whether part of a lamp is in the photo and nearer than the film; never so for the phone's flash."""
    depth = camera.camera_points(film.vertices.reshape(-1, 3))[:, 2].max()
    centre = camera.camera_points(np.array([lamp.centre_mm]))
    if lamp.at_camera or centre[0, 2] > depth:
        return False
    outline, reach = (centre, lamp.half_mm[0]) if lamp.kind == "sphere" else (camera.camera_points(lamp.corners), 0.0)
    (fx, _, x), (_, fy, y), _ = camera.intrinsics
    height, width = camera.size
    sides = np.array([[fx, 0, x], [-fx, 0, width - x], [0, fy, y], [0, -fy, height - y], [0, 0, 1.0]])
    inside = outline @ (sides / np.linalg.norm(sides, axis=1, keepdims=True)).T
    return bool((inside.max(axis=0) > -reach).all())


def _stands_behind(lamp: Lamp, camera_mm: Vector3) -> bool:
    """Whether a lamp is within 60 degrees of the ray from the camera through the film's middle, the world's origin."""
    centre = np.array(lamp.centre_mm)
    return bool(centre @ camera_mm < -0.5 * np.linalg.norm(centre) * np.linalg.norm(camera_mm))


def mirrored(lamp: Lamp, point: Vector3, normal: Vector3, camera_mm: Vector3) -> Lamp:
    """The lamp turned about the world's origin, the film's middle, until a mirror at ``point`` shows it to the camera.

    It lights the film's middle as before. A lamp that is nearer to the origin than the point is moved away.
    """
    view = (camera_mm - point) / np.linalg.norm(camera_mm - point)
    towards = 2 * (view @ normal) * normal - view
    old = np.array(lamp.centre_mm)
    reach = max(float(old @ old), 1.2 * float(point @ point))
    along = float(point @ towards)
    centre = point + (np.sqrt(along**2 - point @ point + reach) - along) * towards
    turn = smallest_rotation(old / np.linalg.norm(old), centre / np.linalg.norm(centre))
    axis, across = np.array([lamp.axis, lamp.across]) @ turn.T
    return replace(lamp, centre_mm=_vector(centre), axis=_vector(axis), across=_vector(across))


def smallest_rotation(start: Vector3, stop: Vector3) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation that takes one unit vector to another (any half turn between opposite ones)."""
    both = start + stop
    if both @ both < 1e-12:
        both = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])
        return 2 * np.outer(both, both) / (both @ both) - np.eye(3)
    first = 2 * np.outer(start, start) - np.eye(3)
    return (2 * np.outer(both, both) / (both @ both) - np.eye(3)) @ first


def _light_box(rng: np.random.Generator) -> LightBox:
    colour = planckian(float(rng.uniform(4000, 10200)))
    size = float(rng.uniform(0.85, 2.2)), float(rng.uniform(0.85, 1.5))
    return LightBox(
        radiance=_vector(colour * rng.uniform(1.5, 7.0)),
        falloff=float(rng.uniform(0.0, 0.7)),
        centre=(float(rng.uniform(0.25, 0.75)), float(rng.uniform(0.25, 0.75))),
        spread=float(rng.uniform(0.3, 1.0)),
        tubes=float(rng.uniform(2, 6)) if rng.random() < 0.3 else 0.0,
        upright=bool(rng.random() < 0.5),
        size=size,
        gap_mm=float(rng.uniform(1, 20)),
        offset=(_box_offset(rng, size[0]), _box_offset(rng, size[1])),
    )


def _box_offset(rng: np.random.Generator, size: float) -> float:
    """Offset of a box's middle from the film's along one side: the film lies anywhere on it, or hangs over a little."""
    beyond = min(abs(rng.normal(0, 0.08)), 0.25)
    return float(rng.uniform(-1, 1) * (max(size - 1, 0.0) / 2 + beyond))


def _ceiling_lamp(rng: np.random.Generator, up: Float[np.ndarray, "3"]) -> Lamp:
    """A panel, a tube, a disc or a bare bulb overhead."""
    side = _aside(rng, up)
    centre = up * rng.uniform(900, 2200) + side * abs(rng.normal(0, 900))
    radius = float(rng.uniform(80, 250))
    shapes: list[tuple[Shape, tuple[float, float]]] = [
        ("rectangle", (300.0, 300.0)),
        ("rectangle", (radius / 4, 600.0)),
        ("disc", (radius, radius)),
        ("sphere", (radius / 3, radius / 3)),
    ]
    kind, half = shapes[int(rng.integers(4))]
    lamp = Lamp(kind, _vector(centre), _vector(-up), _vector(_aside(rng, up)), half, (1.0, 1.0, 1.0))
    return _bright(rng, lamp, (2700.0, 6500.0))


def _desk_lamp(rng: np.random.Generator, up: Float[np.ndarray, "3"]) -> Lamp:
    """A bulb, or a reflector aimed near the film, within arm's reach; one in five behind the film."""
    towards = rng.normal(0, 1, 3) + 0.8 * up
    towards[2] = (abs(towards[2]) + 0.3) * (1 if rng.random() < 0.2 else -1)
    centre = towards / np.linalg.norm(towards) * rng.uniform(280, 900)
    aim = centre + rng.normal(0, 60, 3)
    axis = -aim / np.linalg.norm(aim)
    kind, radius = (
        ("sphere", float(rng.uniform(20, 50))) if rng.random() < 0.5 else ("disc", float(rng.uniform(30, 90)))
    )
    lamp = Lamp(kind, _vector(centre), _vector(axis), _vector(_aside(rng, axis)), (radius, radius), (1.0, 1.0, 1.0))
    return _bright(rng, lamp, (2700.0, 6500.0))


def _window(rng: np.random.Generator, up: Float[np.ndarray, "3"]) -> Lamp:
    """A window or balcony door as a flat source of daylight."""
    towards = _aside(rng, up)
    centre = towards * rng.uniform(900, 3500) + up * rng.uniform(-200, 700)
    half = (float(rng.uniform(350, 900)), float(rng.uniform(450, 1000)))
    lamp = Lamp("rectangle", _vector(centre), _vector(-towards), _vector(np.cross(up, towards)), half, (1.0, 1.0, 1.0))
    return _bright(rng, lamp, (5000.0, 10200.0))


def _flash(rng: np.random.Generator) -> Lamp:
    """The phone's flash: a small bright disc, taken as a ball, beside the camera's centre."""
    centre, radius = np.append(rng.normal(0, 10, 2), 0.0), float(rng.uniform(1.5, 3.0))
    strength = float(np.exp(rng.uniform(np.log(0.3), np.log(3.0)))) * _FLASH_AT_MM**2 / radius**2
    colour = planckian(float(rng.uniform(5000, 6500)))
    return Lamp(
        "sphere", _vector(centre), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (radius, radius), _vector(colour * strength), True
    )


BRIGHTEST = {"rectangle": 120.0, "disc": 300.0, "sphere": 2000.0}
"""Peak radiance over the environment's mean, about 100 cd/m^2 in a room: panels, tubes, windows; reflectors; bulbs."""


def _bright(rng: np.random.Generator, lamp: Lamp, kelvin: tuple[float, float]) -> Lamp:
    """The lamp in a random colour, lighting the film's middle 0.4 to 6 times as much as an even room, if it can."""
    strength = np.exp(rng.uniform(np.log(0.4), np.log(6.0))) * np.pi
    received = float(np.linalg.norm(vector_irradiance(lamp, np.zeros((1, 3)))))
    level = min(strength / received, BRIGHTEST[lamp.kind])
    return replace(lamp, radiance=_vector(planckian(float(rng.uniform(*kelvin))) * level))


def _aside(rng: np.random.Generator, axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """A random unit vector at right angles to ``axis``."""
    vector = np.cross(axis, rng.normal(0, 1, 3))
    return vector / np.linalg.norm(vector)


def _vector(values: np.ndarray) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z
