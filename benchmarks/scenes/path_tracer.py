"""A film scene for Mitsuba 3: the mesh, the thin sheet's BSDF, lamps, room and camera; and its linear radiance.

The BSDF is written a second time here, in Mitsuba's own terms (its microfacet distribution and Fresnel equations), so
that it shares only the equations with data_gen/render/shade.py. Needs the extra ``bench`` and LLVM 17 or newer, which
Mitsuba loads (15 fails on some processors: "Cannot select fminimum"); DRJIT_LIBLLVM_PATH names its library if need be.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from data_gen.light.gloss import ALBEDO_COSINES, gloss
from data_gen.light.lamps import Lamp
from data_gen.light.lighting import Material, room_from_film
from data_gen.light.rooms import Environment, sample_environment
from data_gen.render.shade import light_box_lamp
from data_gen.scene.scene import Scene
from hybrid.coords import film_centres, node_centres_1d
from hybrid.errors import ConfigError, describe, install_extra
from hybrid.mesh.camera import Camera
from hybrid.mesh.film import FilmMesh, lattice_triangles

MESH_VERTICES = 129
ENVIRONMENT = (512, 1024)
_TABLE = 256


@dataclass(frozen=True)
class TraceConfig:
    """samples: per pixel. max_depth: surfaces that light may meet, the lamp included (2: light straight from lamps).

    self_shadows: of the film; without them light comes straight from the lamps at any depth.
    """

    samples: int = 256
    max_depth: int = 2
    seed: int = 0
    self_shadows: bool = True


LEAST_LLVM = (17,)
"""The first version in which LLVM can compile Mitsuba's maximum of two numbers for x86."""


@lru_cache(maxsize=1)
def mitsuba(threads: int = 1) -> Any:
    """The module with its vectorised CPU variant set and the film's BSDF registered.

    Raises:
        ConfigError: Mitsuba is missing (it comes with the extra ``bench``), or LLVM is too old.
    """
    try:
        import drjit  # pyright: ignore[reportMissingImports]  (an extra, "bench")
        import mitsuba as mi  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError as error:
        raise ConfigError(describe(what="path tracer", got="no Mitsuba", do=install_extra("bench"))) from error

    mi.set_variant("llvm_ad_rgb")
    version = drjit.detail.llvm_version()
    if version < LEAST_LLVM:  # compiling the first scene would kill the process
        do = "Install a later LLVM, or let DRJIT_LIBLLVM_PATH name its libLLVM.so."
        raise ConfigError(describe(what="path tracer", got=f"LLVM {version}", allowed=f">= {LEAST_LLVM}", do=do))
    drjit.set_thread_count(threads)
    mi.register_bsdf("thin_sheet", _thin_sheet_class(mi, drjit))
    mi.register_integrator("unshadowed", _unshadowed_class(mi, drjit))
    return mi


def trace(
    film: FilmMesh, scene: Scene, room: Environment, grey: float, config: TraceConfig
) -> Float[np.ndarray, "h w 3"]:
    """Linear radiance of each pixel of the scene's camera (no lens distortion) for a print of one reflectance."""
    mi = mitsuba()
    sheet = {"film": _film(mi, film, scene.material, grey), "sensor": _sensor(mi, scene.camera)}
    lights = _lights(mi, film, scene, room)
    if config.self_shadows:
        integrator = mi.load_dict({"type": "path", "max_depth": config.max_depth, "rr_depth": 64})
        drawn = mi.load_dict({"type": "scene"} | sheet | lights)
    else:
        integrator = mi.load_dict({"type": "unshadowed"})
        integrator.lights = mi.load_dict({"type": "scene"} | lights)
        drawn = mi.load_dict({"type": "scene"} | sheet)
    picture = mi.render(drawn, integrator=integrator, spp=config.samples, seed=config.seed)
    return np.array(picture, dtype=np.float32)[..., :3]


def _lights(mi: Any, film: FilmMesh, scene: Scene, room: Environment) -> dict[str, Any]:
    """The room, the lamps and the light box."""
    camera_mm = scene.camera.centre_world
    lights = {f"lamp{k}": _lamp(mi, lamp.placed(camera_mm), None) for k, lamp in enumerate(scene.light.lamps)}
    if scene.light.box:
        lamp, box = light_box_lamp(scene.light.box, film, camera_mm)
        lights["box"] = _lamp(mi, lamp, box.brightness(film_centres((128, 128))))
    return {"room": _room(mi, room, scene)} | lights


def _film(mi: Any, film: FilmMesh, material: Material, grey: float) -> Any:
    """The smooth film as a fine mesh with the smooth film's normals."""
    n = MESH_VERTICES
    t = node_centres_1d(n)
    triangles = lattice_triangles(n, n)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_bsdf(material, grey))
    mesh = mi.Mesh("film", n * n, len(triangles), has_vertex_normals=True, props=properties)
    values = mi.traverse(mesh)
    values["vertex_positions"] = film.surface(t, t).astype(np.float32).ravel()
    values["vertex_normals"] = film.normals(t, t).astype(np.float32).ravel()
    values["faces"] = triangles.astype(np.uint32).ravel()
    values.update()
    return mesh


def _bsdf(material: Material, grey: float) -> dict[str, Any]:
    surface = gloss(material.roughness, material.ior, material.surfaces)
    table = np.interp(np.linspace(0, 1, _TABLE), ALBEDO_COSINES, surface.albedo)
    return {
        "type": "thin_sheet",
        "reflected": float(grey * material.diffuse + material.haze),
        "transmitted": float(grey * material.transmission + material.haze),
        "straight": float(grey * material.clear),
        "alpha": surface.alpha,
        "ior": material.ior,
        "surfaces": material.surfaces,
        "mean": surface.mean,
        "table": " ".join(f"{x:.7f}" for x in table),
    }


def _room(mi: Any, room: Environment, scene: Scene) -> dict[str, Any]:
    """The room's light by direction in the film's world: Mitsuba's rows run over polar angles from 0 to pi from +y,
    its columns' centres over azimuths from -z towards +x."""
    height, width = ENVIRONMENT
    polar = node_centres_1d(height)[:, None] * np.pi
    azimuth = film_centres((1, width))[0, :, 0] * (2 * np.pi)
    rays = np.stack(
        [np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0 * azimuth, -np.sin(polar) * np.cos(azimuth)], axis=-1
    )
    radiance = sample_environment(room, rays @ room_from_film(scene.light).T) * np.float32(scene.light.front)
    return {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(radiance))}


def _lamp(mi: Any, lamp: Lamp, pattern: np.ndarray | None) -> dict[str, Any]:
    """An area emitter that scatters no light itself; ``pattern``: of its brightness, rows along its second side."""
    if pattern is None:
        radiance: dict[str, Any] = {"type": "rgb", "value": [float(x) for x in lamp.radiance]}
    else:
        picture = pattern[..., None] * np.array(lamp.radiance, np.float32)
        bitmap = mi.Bitmap(np.ascontiguousarray(picture, dtype=np.float32))
        radiance = {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}
    if lamp.kind == "sphere":
        shape = {"type": "sphere", "center": list(lamp.centre_mm), "radius": lamp.half_mm[0]}
    else:
        across, axis = np.array(lamp.across), np.array(lamp.axis)
        matrix = np.eye(4)
        matrix[:3] = np.stack(
            [across * lamp.half_mm[0], np.cross(axis, across) * lamp.half_mm[1], axis, lamp.centre_mm], axis=1
        )
        name = "rectangle" if lamp.kind == "rectangle" else "disk"
        shape = {"type": name, "to_world": mi.ScalarTransform4f(matrix)}
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    return shape | {"bsdf": black, "emitter": {"type": "area", "radiance": radiance}}


def _sensor(mi: Any, camera: Camera) -> dict[str, Any]:
    """A pinhole; Mitsuba's camera looks along +z with x to the left and y up."""
    height, width = camera.size
    world_from_camera = np.linalg.inv(camera.camera_from_world) @ np.diag([-1.0, -1.0, 1.0, 1.0])
    return {
        "type": "perspective",
        "fov": float(np.rad2deg(2 * np.arctan(width / 2 / camera.intrinsics[0, 0]))),
        "fov_axis": "x",
        "near_clip": 1.0,
        "far_clip": 1e6,
        "to_world": mi.ScalarTransform4f(world_from_camera),
        "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent"},
    }


def _thin_sheet_class(mi: Any, dr: Any) -> type:
    """The BSDF of data_gen/render/shade.py as a Mitsuba plug-in (its base class exists once a variant is set)."""

    class ThinSheet(mi.BSDF):
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.shares = [float(props[name]) for name in ("reflected", "transmitted", "straight")]
            self.alpha, self.ior, self.mean = (float(props[name]) for name in ("alpha", "ior", "mean"))
            self.surfaces = int(props["surfaces"])
            self.table = mi.Float([float(x) for x in str(props["table"]).split()])
            both = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_components = [
                mi.BSDFFlags.GlossyReflection | both,
                mi.BSDFFlags.DiffuseReflection | both,
                mi.BSDFFlags.DiffuseTransmission | both,
                mi.BSDFFlags.Null | both,
            ]
            self.m_flags = self.m_components[0] | self.m_components[1] | self.m_components[2] | self.m_components[3]
            weights = np.array([0.1, *self.shares])
            self.chance = [float(x) for x in weights / weights.sum()]

        def albedo(self, cosine: Any) -> Any:
            at = cosine * (_TABLE - 1)
            low = dr.select(at < _TABLE - 2, mi.UInt32(at), _TABLE - 2)
            share = at - mi.Float(low)
            return dr.lerp(dr.gather(mi.Float, self.table, low), dr.gather(mi.Float, self.table, low + 1), share)

        def distribution(self) -> Any:
            return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, self.alpha, True)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            side = dr.select(si.wi.z < 0, mi.Float(-1), mi.Float(1))
            eye = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
            glossy = sample1 < self.chance[0]
            through = sample1 > 1 - self.chance[3]
            across = ~glossy & ~through & (sample1 > self.chance[0] + self.chance[1])
            half, _ = self.distribution().sample(eye, sample2)
            matt = mi.warp.square_to_cosine_hemisphere(sample2)
            matt.z = dr.select(across, -matt.z, matt.z)
            out = dr.select(glossy, mi.reflect(eye, half), matt)
            out.z *= side
            out = dr.select(through, -si.wi, out)
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.eta = out, 1.0
            bs.pdf = dr.select(through, self.chance[3], self.pdf(ctx, si, out, active))
            bs.sampled_type = dr.select(
                through, mi.UInt32(int(mi.BSDFFlags.Null)), mi.UInt32(int(mi.BSDFFlags.GlossyReflection))
            )
            bs.sampled_component = dr.select(through, mi.UInt32(3), mi.UInt32(0))
            straight = self.shares[2] * (1 - self.albedo(eye.z)) / max(self.chance[3], 1e-9)
            value = dr.select(through, mi.Color3f(straight), self.eval(ctx, si, out, active) / bs.pdf)
            return bs, dr.select(active & (bs.pdf > 0), value, 0)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            eye = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
            light = mi.Vector3f(wo.x, wo.y, wo.z * dr.select(si.wi.z < 0, mi.Float(-1), mi.Float(1)))
            same = light.z > 0
            enters = (1 - self.albedo(eye.z)) * (1 - self.albedo(dr.abs(light.z))) / (1 - self.mean)
            matt = dr.select(same, self.shares[0], self.shares[1]) * enters * dr.inv_pi * dr.abs(light.z)
            half = dr.normalize(eye + light)
            distribution = self.distribution()
            one = mi.fresnel(dr.dot(eye, half), self.ior)[0]
            mirror = self.surfaces * one / (1 + (self.surfaces - 1) * one)
            glossy = mirror * distribution.eval(half) * distribution.G(eye, light, half) / (4 * eye.z)
            return mi.Color3f(dr.select(active & (eye.z > 0), matt + dr.select(same, glossy, 0), 0))

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            eye = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
            light = mi.Vector3f(wo.x, wo.y, wo.z * dr.select(si.wi.z < 0, mi.Float(-1), mi.Float(1)))
            same = light.z > 0
            half = dr.normalize(eye + light)
            lobe = self.distribution().pdf(eye, half) / (4 * dr.dot(eye, half))
            matt = dr.select(same, self.chance[1], self.chance[2]) * dr.inv_pi * dr.abs(light.z)
            return dr.select(active & (eye.z > 0), matt + dr.select(same, self.chance[0] * lobe, 0), 0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    return ThinSheet


def _unshadowed_class(mi: Any, dr: Any) -> type:
    """Light straight from a second scene, ``lights``, as if the film hid none; lamps and BSDF are both sampled."""

    class Unshadowed(mi.SamplingIntegrator):
        lights: Any = None

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            context = mi.BSDFContext()
            si = scene.ray_intersect(ray, active)
            seen = active & si.is_valid()
            bsdf = si.bsdf(ray)
            ds, weight = self.lights.sample_emitter_direction(si, sampler.next_2d(), True, seen)
            value, pdf = bsdf.eval_pdf(context, si, si.to_local(ds.d), seen)
            total = dr.select(seen & (ds.pdf > 0), value * weight * balance(ds.pdf, pdf), 0)

            bs, weight = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), seen)
            hit = self.lights.ray_intersect(si.spawn_ray(si.to_world(bs.wo)), seen)
            emitter = hit.emitter(self.lights, seen)
            by_lamp = self.lights.pdf_emitter_direction(si, mi.DirectionSample3f(self.lights, hit, si), seen)
            straight = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
            weight *= dr.select(straight, 1.0, balance(bs.pdf, by_lamp))
            total += dr.select(seen, weight * emitter.eval(hit, seen), 0)
            return mi.Color3f(total), seen, []

    def balance(one: Any, other: Any) -> Any:
        return dr.select(one > 0, one / (one + other), 0)

    return Unshadowed
