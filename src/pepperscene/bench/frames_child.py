"""Frames of a scene in a process of its own, stage by stage, with what a process does only once.

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
from numpy.typing import NDArray

from pepperscene.geometry import Mesh


def quartered(mesh: Mesh) -> Mesh:
    """The mesh with each triangle cut into four at the middles of its sides, which leaves all as it is seen.

    Instances keep their vertices together, as `Mesh.instance_vertices` asks for.
    """
    sides = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    sides, where = np.unique(sides, axis=0, return_inverse=True)
    owner = np.concatenate([mesh.vertex_instance, mesh.vertex_instance[sides[:, 0]]])
    order = np.argsort(owner, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(order.size)

    def halved(values: NDArray[np.float32]) -> NDArray[np.float32]:
        middles = values[sides].mean(axis=1, dtype=np.float32)
        return np.concatenate([values, middles])[order]

    corners: list[Any] = [place[column] for column in mesh.faces.T]
    middles: list[Any] = [place[column + len(mesh.vertices)] for column in where.reshape(-1, 3).T]
    (a, b, c), (ab, bc, ca) = corners, middles
    parts = np.array([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
    normals = halved(mesh.normals)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(
        mesh,
        vertices=halved(mesh.vertices),
        normals=(normals / np.maximum(lengths, 1e-12)).astype(np.float32),
        uv=halved(mesh.uv),
        state=halved(mesh.state),
        # The four parts of a triangle lie side by side, as what belongs to a face is repeated.
        faces=parts.transpose(2, 0, 1).reshape(-1, 3).astype(np.uint32),
        face_instance=np.repeat(mesh.face_instance, 4),
        face_surface=np.repeat(mesh.face_surface, 4),
    )


BEGAN: Final = perf_counter()

PLANT_STAGES: Final = ("grow", "mesh", "twine", "settle plants")
"""Of plants, where one process makes them all; of its share where two do."""

LIGHT_STAGES: Final = ("trace", "denoise", "develop")
"""Of a frame; what is left of its time are labels."""

Times = dict[str, float]


@dataclass(frozen=True)
class Asked:
    """What a child is to render.

    Attributes:
        recipe: shipped name.
        changes: of its values.
        index: of the first frame; the next ones follow on the path.
        size: of the picture, or None for the camera's own.
        frames: after the first.
        outputs: of each frame.
        quality: of each frame.
        divided: how often each triangle is cut into four, which leaves the picture as it is.
        encode: whether images are written, as a build does.
    """

    recipe: str
    changes: dict[str, Any] = field(default_factory=dict)
    index: int = 0
    size: tuple[int, int] | None = None
    frames: int = 1
    outputs: tuple[str, ...] = ("colour", "class", "instance", "distance", "distance_code")
    quality: str = "standard"
    divided: int = 0
    encode: bool = True


@contextmanager
def timed(times: Times, what: str) -> Iterator[None]:
    """Add the seconds that the block takes to `times[what]`."""
    start = perf_counter()
    yield
    times[what] = times.get(what, 0.0) + perf_counter() - start


def clocked(times: Times, what: str, inner: Callable[..., Any]) -> Callable[..., Any]:
    """The function, with its time added up."""

    def call(*args: Any, **kwargs: Any) -> Any:
        with timed(times, what):
            return inner(*args, **kwargs)

    return call


def clock_plants(times: Times) -> None:
    """Clock the functions that make a plant; `resolve_contacts` of single plants alone."""
    from pepperscene import geometry, grammar, scene

    grammar.grow = clocked(times, "grow", grammar.grow)
    geometry.mesh_plant = clocked(times, "mesh", geometry.mesh_plant)
    scene.add_twine = clocked(times, "twine", scene.add_twine)
    settle = geometry.resolve_contacts

    def settled(*args: Any, between_plants: bool = False, **kwargs: Any) -> Any:
        if between_plants:
            return settle(*args, between_plants=True, **kwargs)
        with timed(times, "settle plants"):
            return settle(*args, **kwargs)

    geometry.resolve_contacts = settled


def clock_light(times: Times) -> None:
    """Clock the steps of a photograph, and the making of the kernel's scene."""
    from pepperscene.render import renderer

    steps = {"kernel scene": "light_scene", "trace": "trace", "denoise": "denoised", "develop": "develop"}
    for what, name in steps.items():
        setattr(renderer, name, clocked(times, what, getattr(renderer, name)))


def frames(asked: Asked) -> dict[str, Any]:
    """Render them; seconds by stage for the scene, the first frame and each of the next ones."""
    import tempfile
    from pathlib import Path

    scene_times: Times = {}
    plant_times: Times = {}
    with timed(scene_times, "import"):
        import pepperscene as ps
        from pepperscene.dataset import FrameRenderer
        from pepperscene.frame import OUTPUTS, check_outputs
        from pepperscene.render.variant import mitsuba_modules, variant_name
    with timed(scene_times, "start Mitsuba"):
        mitsuba_modules()
    # The bench's own are no part of a frame.
    from pepperscene.bench.records import peak_mib
    from pepperscene.bench.scenes import resized

    outputs = check_outputs(asked.outputs)
    traced = any(OUTPUTS[name].traced for name in outputs)

    clock_plants(plant_times)
    recipe = ps.load_recipe(asked.recipe, asked.changes)
    plan, stage = recipe.plan, FrameRenderer(recipe)
    shot = plan.frame(asked.index)
    scene = _scene(stage, shot, traced, asked.divided, scene_times)

    steps: Times = {}
    clock_light(steps)
    renderer = ps.Renderer(scene)
    begin, found, peaks = asked.index - shot.step, [], []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(asked.frames + 1):
            view = plan.frame(begin + (shot.step + number) % plan.frames)
            camera = resized(stage.camera(view), asked.size)
            steps.clear()
            with timed(steps, "render"):
                frame = renderer.render(camera, outputs, asked.quality, number)
            if asked.encode:
                with timed(steps, "encode"):
                    for name, image in frame.images.items():
                        ps.write_image(Path(folder) / f"{name}{OUTPUTS[name].suffix}", image, name)
            steps["labels"] = steps.pop("render") - sum(
                steps.get(what, 0.0) for what in (*LIGHT_STAGES, "kernel scene")
            )
            if "kernel scene" in steps:
                scene_times["kernel scene"] = steps.pop("kernel scene")
            found.append(dict(steps))
            peaks.append(peak_mib())
    return {
        "asked": asdict(asked),
        "scene": scene_times,
        "plants": plant_times,
        "frames": found,
        "peaks_mib": peaks,
        "whole_s": perf_counter() - BEGAN,
        "triangles": len(scene.mesh.faces),
        "size": [camera.width, camera.height],
        "variant": variant_name(),
    }


def _scene(stage: Any, shot: Any, traced: bool, divided: int, times: Times) -> Any:
    """The scene; making plants, placing them and leaving out what is not seen are told apart."""
    from dataclasses import replace

    planting = stage._scene_builder
    planting.plants = clocked(times, "plants", planting.plants)
    planting.scene = clocked(times, "place and settle row", planting.scene)
    stage._cull = clocked(times, "leave out what is not seen", stage._cull)
    with timed(times, "surfaces and sky"):
        scene = stage.scene(shot, traced=traced)
    times["surfaces and sky"] -= times["place and settle row"] + times["leave out what is not seen"]
    times["place and settle row"] -= times["plants"]
    for _ in range(divided):
        scene = replace(scene, mesh=quartered(scene.mesh))
    return scene


if __name__ == "__main__":
    wanted = json.loads(sys.argv[1])
    wanted["size"] = None if wanted["size"] is None else tuple(wanted["size"])
    wanted["outputs"] = tuple(wanted["outputs"])
    sys.stdout.write(json.dumps(frames(Asked(**wanted))) + "\n")
