"""Render frames in a separate process and time them by stage, including what happens once per process.

Run as `python -P frames_child.py JSON`; it prints one line of JSON.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from time import perf_counter
from typing import Any, Final

import numpy as np

from pepperscene.geometry import Mesh

START: Final = perf_counter()

PLANT_STAGES: Final = ("grow", "mesh", "twine", "resolve contacts")
"""Stages of making plants, as far as this process makes them itself."""

LIGHT_STAGES: Final = ("trace", "denoise", "develop")
"""Stages of a photograph; the rest of a frame's time is for labels."""

Times = dict[str, float]


@dataclass(frozen=True)
class FramesTask:
    """The frames that a child process renders."""

    recipe: str  # name of a shipped recipe
    changes: dict[str, Any] = field(default_factory=dict)  # changed values of the recipe
    index: int = 0  # of the first frame; the next ones follow on the camera path
    size: tuple[int, int] | None = None  # of the image, or None for the camera's
    frames: int = 1  # number of frames after the first
    outputs: tuple[str, ...] = ("colour", "class", "instance", "distance", "distance_code")  # of each frame
    quality: str = "standard"  # of each frame
    divided: int = 0  # how often each triangle is divided into four, which does not change the image
    encode: bool = True  # whether images are written, as in a build


@contextmanager
def timed(times: Times, stage: str) -> Iterator[None]:
    """Add the seconds that the block takes to `times[stage]`."""
    start = perf_counter()
    yield
    times[stage] = times.get(stage, 0.0) + perf_counter() - start


def time_calls(times: Times, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, with the time of its calls added to `times[stage]`."""

    def call(*args: Any, **kwargs: Any) -> Any:
        with timed(times, stage):
            return function(*args, **kwargs)

    return call


def time_plants(times: Times) -> None:
    """Time the functions that make a plant; `resolve_contacts` of single plants only."""
    from pepperscene import geometry, scene
    from pepperscene.building.scenes import plants

    plants.grow_in_memory = time_calls(times, "grow", plants.grow_in_memory)
    geometry.mesh_plant = time_calls(times, "mesh", geometry.mesh_plant)
    scene.add_twine = time_calls(times, "twine", scene.add_twine)
    resolve = geometry.resolve_contacts

    def resolve_timed(*args: Any, between_plants: bool = False, **kwargs: Any) -> Any:
        if between_plants:
            return resolve(*args, between_plants=True, **kwargs)
        with timed(times, "resolve contacts"):
            return resolve(*args, **kwargs)

    geometry.resolve_contacts = resolve_timed


def time_light(times: Times) -> None:
    """Time the stages of a photograph, and the construction of Mitsuba's scene."""
    from pepperscene.render import kernel_scene, photographs
    from pepperscene.render.transport import strips

    stages = {
        "kernel scene": (kernel_scene, "light_scene"),
        "trace": (strips, "trace_rows"),
        "denoise": (strips, "denoised"),
        "develop": (photographs, "develop"),
    }
    for stage, (module, name) in stages.items():
        setattr(module, name, time_calls(times, stage, getattr(module, name)))


def render_frames(task: FramesTask) -> dict[str, Any]:
    """Render the frames; seconds by stage for the scene, the first frame and each of the next ones."""
    import tempfile
    from pathlib import Path

    scene_times: Times = {}
    plant_times: Times = {}
    with timed(scene_times, "import"):
        import pepperscene as ps
        from pepperscene.building.scenes.frame_renderer import FrameRenderer
        from pepperscene.outputs import OUTPUTS, check_outputs, needs_surfaces
        from pepperscene.render.variant import mitsuba_modules, variant_name
    with timed(scene_times, "start Mitsuba"):
        mitsuba_modules()
    # Imports of the benchmark itself are not part of a frame.
    from pepperscene.bench.records import peak_memory_mib
    from pepperscene.bench.scenes import resize_camera

    outputs = check_outputs(task.outputs)

    time_plants(plant_times)
    recipe = ps.load_recipe(task.recipe, task.changes)
    plan, frame_renderer = recipe.plan, FrameRenderer(recipe)
    first_frame = plan.frame(task.index)
    scene = _build_scene(frame_renderer, first_frame, needs_surfaces(outputs), task.divided, scene_times)

    times: Times = {}
    time_light(times)
    renderer = ps.Renderer(scene)
    first, frames, peaks = task.index - first_frame.step, [], []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(task.frames + 1):
            view = plan.frame(first + (first_frame.step + number) % plan.frames)
            camera = resize_camera(frame_renderer.camera(view), task.size)
            times.clear()
            with timed(times, "render"):
                frame = renderer.render(camera, outputs, task.quality, number)
            if task.encode:
                with timed(times, "encode"):
                    for name, image in frame.images.items():
                        ps.write_image(Path(folder) / f"{name}{OUTPUTS[name].suffix}", image, name)
            times["labels"] = times.pop("render") - sum(
                times.get(name, 0.0) for name in (*LIGHT_STAGES, "kernel scene")
            )
            if "kernel scene" in times:
                scene_times["kernel scene"] = times.pop("kernel scene")
            frames.append(dict(times))
            peaks.append(peak_memory_mib())
    return {
        "asked": asdict(task),
        "scene": scene_times,
        "plants": plant_times,
        "frames": frames,
        "peaks_mib": peaks,
        "whole_s": perf_counter() - START,
        "triangles": len(scene.mesh.faces),
        "size": [camera.width, camera.height],
        "variant": variant_name(),
    }


def _build_scene(frame_renderer: Any, frame: Any, traced: bool, divided: int, times: Times) -> Any:
    """Build the scene; making plants, placing them and culling are timed separately."""
    builder = frame_renderer.builder(frame)
    builder.plants = time_calls(times, "plants", builder.plants)
    builder.scene = time_calls(times, "place row and resolve contacts", builder.scene)
    culled_mesh = frame_renderer._culled_mesh
    frame_renderer._culled_mesh = time_calls(times, "cull hidden geometry", culled_mesh)
    with timed(times, "surfaces and sky"):
        scene = frame_renderer.scene(frame, traced=traced)
    times["surfaces and sky"] -= times["place row and resolve contacts"] + times["cull hidden geometry"]
    times["place row and resolve contacts"] -= times["plants"]
    for _ in range(divided):
        scene = replace(scene, mesh=subdivide_mesh(scene.mesh))
    return scene


def subdivide_mesh(mesh: Mesh) -> Mesh:
    """Divide each triangle into four at the midpoints of its edges, which does not change the image."""
    from trimesh.remesh import subdivide

    values = {"normals": mesh.normals, "uv": mesh.uv, "state": mesh.state[:, None]}
    vertices, faces, values = subdivide(mesh.vertices, mesh.faces, vertex_attributes=values)
    # Keep the vertices of each instance contiguous, as meshes of plants have them.
    face_instance = np.repeat(mesh.face_instance, 4)
    owner = np.empty(len(vertices), np.uint32)
    owner[faces] = face_instance[:, None]
    order = np.argsort(owner, kind="stable")
    position = np.empty_like(order)
    position[order] = np.arange(order.size)
    normals = values["normals"][order]
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(
        mesh,
        vertices=vertices[order].astype(np.float32),
        normals=(normals / np.maximum(lengths, 1e-12)).astype(np.float32),
        uv=values["uv"][order].astype(np.float32),
        state=values["state"][order, 0].astype(np.float32),
        faces=position[faces].astype(np.uint32),
        face_instance=face_instance,
        face_surface=np.repeat(mesh.face_surface, 4),
        face_appearance=np.repeat(mesh.face_appearance, 4),
    )


if __name__ == "__main__":
    arguments = json.loads(sys.argv[1])
    arguments["size"] = None if arguments["size"] is None else tuple(arguments["size"])
    arguments["outputs"] = tuple(arguments["outputs"])
    sys.stdout.write(json.dumps(render_frames(FramesTask(**arguments))) + "\n")
