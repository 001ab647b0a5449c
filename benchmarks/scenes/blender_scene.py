"""Bend and photograph one film in Blender: ``PYTHON blender_scene.py JOB.json``, with a Python that has ``bpy``.

Nothing of the project is imported, since bpy needs a NumPy of its own. benchmarks/blender_photos.py writes the job; its
``Job`` documents the fields. The sheet lies in the xy plane, x to its right, y up, its longer side 2 units.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import bpy  # pyright: ignore[reportMissingImports]
import numpy as np
from mathutils import Matrix, Vector  # pyright: ignore[reportMissingImports]

FINE = 3
"""Levels by which the simulated quads are subdivided smoothly (Catmull-Clark)."""

CLEARANCE = 0.02
"""Least distance between the film and the desk, where a flat film is about 2 long."""

LAST_FRAME = 80
METERING_PX = 96


def flat_sheet(job: dict[str, Any]) -> Any:
    """The flat film of (cuts + 1) squared quads, its uv from the lower left, and its pinned vertices as a group."""
    n = job["cuts"] + 2
    height, width = job["size"]
    across, up = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    points = np.stack([(across - 0.5) * width, (up - 0.5) * height, 0 * up], axis=-1).reshape(-1, 3)
    first = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    quads = np.stack([first, first + 1, first + n + 1, first + n], axis=-1)
    mesh = bpy.data.meshes.new("film")
    mesh.from_pydata(points.tolist(), [], quads.tolist())
    layer = mesh.uv_layers.new(name="uv")
    uv = np.stack([across, up], axis=-1).reshape(-1, 2)
    layer.data.foreach_set("uv", uv[quads.ravel()].astype(np.float32).ravel())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(quads), bool))
    film = bpy.data.objects.new("film", mesh)
    bpy.context.collection.objects.link(film)
    pins = film.vertex_groups.new(name="pins")
    pins.add([int(k) for k in job["pins"]], 1.0, "REPLACE")
    return film


def bend(film: Any, job: dict[str, Any]) -> dict[str, float]:
    """Simulate until a normal of the sheet is ``max_angle`` degrees from the mean normal, or until the last frame.

    The film gets the shape of that frame. Returns what came out: the angle, the frame, the strain of the edges.
    """
    scene = bpy.context.scene
    scene.gravity = (0, 0, -9.81 * job["gravity"])
    field_object = bpy.data.objects.new("field", None)
    bpy.context.collection.objects.link(field_object)
    field_object.location = job["field_at"]
    bpy.context.view_layer.objects.active = field_object
    bpy.ops.object.forcefield_toggle()
    field = field_object.field
    field.type, field.strength, field.noise, field.seed = "FORCE", job["strength"], job["noise"], job["seed"] % 128
    if job["kind"] == "soft":
        soft = film.modifiers.new("bend", "SOFT_BODY").settings
        soft.vertex_group_goal, soft.goal_default, soft.goal_spring = "pins", 0.0, 0.9
        soft.pull = soft.push = 0.95
        soft.bend, soft.friction, soft.use_stiff_quads, soft.shear = job["stiffness"], 2.0, True, 1.0
        soft.damping = 5.0
    else:
        cloth = film.modifiers.new("bend", "CLOTH").settings
        cloth.vertex_group_mass, cloth.quality, cloth.mass = "pins", 12, 0.3
        cloth.tension_stiffness = cloth.compression_stiffness = cloth.shear_stiffness = 80.0
        cloth.bending_stiffness = job["stiffness"]
    flat = points_of(film)
    for frame in range(1, LAST_FRAME + 1):
        scene.frame_set(frame)
        points = points_of(film)
        angle = largest_angle(points)
        if angle >= job["max_angle"]:
            break
    film.modifiers.clear()
    points -= points.mean(axis=0)  # lamps and desk stand around the origin; the pushing force may move a sheet away
    film.data.vertices.foreach_set("co", points.astype(np.float32).ravel())
    field.type = "NONE"
    scene.frame_set(1)
    smooth = film.modifiers.new("smooth", "SUBSURF")
    smooth.levels = smooth.render_levels = FINE
    smooth.boundary_smooth, smooth.uv_smooth = "PRESERVE_CORNERS", "NONE"
    return {"frame": frame, "angle": angle, "strain": strain(points, flat)}


def evaluated(film: Any) -> Any:
    """The film's mesh after its modifiers."""
    return film.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()


def points_of(film: Any) -> np.ndarray:
    """(n, 3) points of the film's mesh after its modifiers."""
    return vertices_of(evaluated(film))


def vertices_of(mesh: Any) -> np.ndarray:
    """(n, 3) points of a mesh."""
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    return points.reshape(-1, 3).astype(np.float64)


def lattice_of(film: Any, intervals: int) -> np.ndarray:
    """(n, n, 3) points of a regular lattice of the film, row 0 its top, by the uv of the vertices."""
    mesh = evaluated(film)
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    uv = np.empty(2 * len(mesh.loops), np.float32)
    mesh.uv_layers[0].data.foreach_get("uv", uv)
    place = np.rint(uv.reshape(-1, 2) * intervals)
    if np.abs(uv.reshape(-1, 2) * intervals - place).max() > 0.01:
        raise RuntimeError("the film's vertices are no regular lattice")
    column, row = place.astype(int).T
    lattice = np.full((intervals + 1, intervals + 1, 3), np.nan)
    lattice[intervals - row, column] = vertices_of(mesh)[corners]
    if not np.isfinite(lattice).all():
        raise RuntimeError("the film's lattice has holes")
    return lattice


def normals_of(lattice: np.ndarray) -> np.ndarray:
    """Unit normals of a lattice's quads."""
    along, down = np.diff(lattice[:-1], axis=1), np.diff(lattice[:, :-1], axis=0)
    normals = np.cross(along, down)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def largest_angle(points: np.ndarray) -> float:
    """Degrees between the mean normal of the simulated sheet and the one furthest from it."""
    n = math.isqrt(len(points))
    normals = normals_of(points.reshape(n, n, 3)).reshape(-1, 3)
    mean = normals.mean(axis=0)
    return float(np.degrees(np.arccos(np.clip(normals @ mean / np.linalg.norm(mean), -1, 1))).max())


def strain(points: np.ndarray, flat: np.ndarray) -> float:
    """Root mean square strain of the simulated sheet's edges."""
    n = math.isqrt(len(points))
    lengths = [
        np.concatenate([np.linalg.norm(np.diff(p.reshape(n, n, 3), axis=k), axis=-1).ravel() for k in (0, 1)])
        for p in (points, flat)
    ]
    return float(np.sqrt(np.mean((lengths[0] / lengths[1] - 1) ** 2)))


def material(film: Any, job: dict[str, Any]) -> None:
    """The print's grey on plastic; a film lit from behind lets some light through."""
    made = bpy.data.materials.new("film")
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    plastic = nodes["Principled BSDF"]
    picture = nodes.new("ShaderNodeTexImage")
    picture.image = bpy.data.images.load(job["texture"])
    picture.extension = "EXTEND"
    picture.interpolation = "Cubic"
    links.new(picture.outputs["Color"], plastic.inputs["Base Color"])
    plastic.inputs["Roughness"].default_value = job["roughness"]
    if job["through"] > 0:
        through, both = nodes.new("ShaderNodeBsdfTranslucent"), nodes.new("ShaderNodeMixShader")
        links.new(picture.outputs["Color"], through.inputs["Color"])
        both.inputs["Fac"].default_value = job["through"]
        links.new(plastic.outputs["BSDF"], both.inputs[1])
        links.new(through.outputs["BSDF"], both.inputs[2])
        links.new(both.outputs["Shader"], nodes["Material Output"].inputs["Surface"])
    film.data.materials.append(made)


def light(job: dict[str, Any], lattice: np.ndarray, normal: np.ndarray) -> None:
    """The room, the lamps, and what stands behind the film: no part of ``lattice`` sinks into it."""
    world = bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    background = nodes["Background"]
    if job["room"]:
        where, turned, room = (nodes.new(f"ShaderNode{n}") for n in ("TexCoord", "Mapping", "TexEnvironment"))
        turned.inputs["Rotation"].default_value = job["room_turn"]
        room.image = bpy.data.images.load(job["room"])
        links.new(where.outputs["Generated"], turned.inputs["Vector"])
        links.new(turned.outputs["Vector"], room.inputs["Vector"])
        links.new(room.outputs["Color"], background.inputs["Color"])
    else:
        background.inputs["Color"].default_value = (*job["room_colour"], 1)
    for k, lamp in enumerate(job["lamps"]):
        data = bpy.data.lights.new(f"lamp{k}", "AREA")
        data.shape, data.size, data.energy, data.color = "DISK", lamp["size"], lamp["watts"], lamp["colour"]
        made = bpy.data.objects.new(f"lamp{k}", data)
        made.location = lamp["at"]
        made.rotation_euler = (-Vector(lamp["at"])).to_track_quat("-Z", "Y").to_euler()
        bpy.context.collection.objects.link(made)
    if job["desk"]:
        desk = bpy.data.materials.new("desk")
        desk.use_nodes = True
        nodes, links = desk.node_tree.nodes, desk.node_tree.links
        noise, ramp = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeValToRGB")
        noise.inputs["Scale"].default_value = job["desk"]["scale"]
        noise.inputs["Detail"].default_value = 8
        for stop, colour in zip(ramp.color_ramp.elements, job["desk"]["colours"], strict=True):
            stop.color = (*colour, 1)
        links.new(noise.outputs[0], ramp.inputs[0])
        links.new(ramp.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
        nodes["Principled BSDF"].inputs["Roughness"].default_value = job["desk"]["roughness"]
        behind = max(job["desk"]["behind"], CLEARANCE - (lattice @ normal).min())
        bpy.ops.mesh.primitive_plane_add(size=12, location=-behind * normal)
        plane = bpy.context.active_object
        plane.rotation_euler = Vector(normal).to_track_quat("Z", "Y").to_euler()
        plane.data.materials.append(desk)


def camera_for(lattice: np.ndarray, job: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, float]:
    """A camera in front of the film that sees it at the requested size; its eye, axes (right, up, back) and f."""
    side, f_px = job["side"], job["focal"] * job["side"]
    points = lattice.reshape(-1, 3)
    middle = points.mean(axis=0)
    normals = normals_of(lattice).reshape(-1, 3).mean(axis=0)
    normal = -normals / np.linalg.norm(normals)  # rows go down: the cross product looks away from the print
    upright = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
    upright /= np.linalg.norm(upright)
    beside = np.cross(upright, normal)
    tilt, bearing = math.radians(job["tilt"]), math.radians(job["tilt_to"])
    back = math.cos(tilt) * normal + math.sin(tilt) * (math.cos(bearing) * beside + math.sin(bearing) * upright)
    right = np.cross(upright, back)
    right /= np.linalg.norm(right)
    above = np.cross(back, right)
    roll = math.radians(job["roll"])
    right, above = math.cos(roll) * right + math.sin(roll) * above, math.cos(roll) * above - math.sin(roll) * right
    axes = np.stack([right, above, back], axis=-1)
    near, far = 0.1, 60.0
    shift = np.array(job["off_centre"])
    for _ in range(50):  # the nearest distance at which the whole film lies within its share of the photo
        distance = math.sqrt(near * far)
        inside = (points - middle) @ axes
        depth = distance - inside[:, 2]
        seen = np.abs(f_px * inside[:, :2] / np.maximum(depth, 1e-3)[:, None]).max() * 2 / side
        near, far = (near, distance) if seen <= job["fill"] and depth.min() > 0.2 else (distance, far)
    free = (1 - job["fill"]) / 2 * side
    eye = middle + far * back + axes[:, :2] @ (shift * free * far / f_px)
    data = bpy.data.cameras.new("camera")
    data.sensor_fit, data.sensor_width, data.lens = "HORIZONTAL", 36.0, 36.0 * job["focal"]
    made = bpy.data.objects.new("camera", data)
    made.matrix_world = Matrix.Translation(Vector(eye)) @ Matrix(axes.tolist()).to_4x4()
    bpy.context.collection.objects.link(made)
    bpy.context.scene.camera = made
    return eye, axes, f_px


def projected(points: np.ndarray, eye: np.ndarray, axes: np.ndarray, f_px: float, side: int) -> np.ndarray:
    """(..., 2) photo points in pixels, centres at +0.5."""
    inside = (points - eye) @ axes
    return side / 2 + f_px * inside[..., :2] * np.array([1.0, -1.0]) / -inside[..., 2:]


def expose(job: dict[str, Any]) -> float:
    """Stops of exposure that bring the photo's usual brightness to ``brightness``, measured on a small rendering."""
    scene = bpy.context.scene
    render = scene.render
    with tempfile.TemporaryDirectory() as folder:
        small = str(Path(folder) / "small.exr")
        render.resolution_x = render.resolution_y = METERING_PX
        scene.cycles.samples = 8
        render.image_settings.file_format, render.filepath = "OPEN_EXR", small
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(small)
        pixels = np.array(image.pixels[:]).reshape(-1, 4)[:, :3]
    level = float(np.minimum(pixels, 6 * np.median(pixels) + 1e-6).mean())
    return math.log2(job["brightness"] / max(level, 1e-6))


def photograph(job: dict[str, Any]) -> None:
    """Bend the film, render the photo, and write the truth beside it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    film = flat_sheet(job)
    bent = bend(film, job)
    lattice = lattice_of(film, (job["cuts"] + 1) * 2**FINE)
    eye, axes, f_px = camera_for(lattice, job)
    material(film, job)
    light(job, lattice, axes[:, 2])
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.use_denoising, scene.cycles.denoiser = "CPU", True, "OPENIMAGEDENOISE"
    scene.cycles.max_bounces, scene.cycles.adaptive_threshold = 4, 0.03
    stops = expose(job)
    scene.view_settings.view_transform, scene.view_settings.exposure = job["tone"], stops
    scene.cycles.samples = job["samples"]
    scene.render.resolution_x = scene.render.resolution_y = job["side"]
    scene.render.image_settings.file_format, scene.render.image_settings.quality = "JPEG", job["quality"]
    scene.render.filepath = job["photo"]
    bpy.ops.render.render(write_still=True)
    simulated = {**job, **bent, "stops": stops, "texture": Path(job["texture"]).name, "photo": Path(job["photo"]).name}
    simulated["room"] = Path(job["room"]).name if job["room"] else ""
    truth = Path(job["photo"]).with_suffix(".npz")
    part = truth.with_suffix(".part")  # a run that is stopped leaves no partial truth
    with part.open("wb") as file:
        np.savez_compressed(
            file,
            lattice=projected(lattice, eye, axes, f_px, job["side"]).astype(np.float32),
            xyz=lattice.astype(np.float32),
            eye=eye.astype(np.float32),
            R=axes.astype(np.float32),
            f_px=np.float32(f_px),
            texture=Path(job["texture"]).name,
            meta=json.dumps(simulated),
        )
    part.replace(truth)


if __name__ == "__main__":
    photograph(json.loads(Path(sys.argv[-1]).read_text()))
