"""Imports scenes that `pepperscene scene` wrote into Blender, and compares them with their JSON.

    python benchmarks/blender_import.py FILE.glb FILE.usd ...

It needs Blender's module in an environment of its own (`pip install bpy`), and nothing of this project.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import bpy
from mathutils import Matrix, Vector

TOLERANCE_M = 1e-3


def check(path: Path) -> None:
    """Import one file and compare the names, numbers, classes and poses of all organs."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    start = time.perf_counter()
    if path.suffix == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(path))
    else:
        bpy.ops.wm.usd_import(filepath=str(path))
    seconds = time.perf_counter() - start
    expected = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))["organs"]
    # Properties of a prim of USD may be on the object or on its mesh.
    found = {}
    for item in bpy.data.objects:
        properties = {**(dict(item.data.items()) if item.data else {}), **dict(item.items())}
        properties = {key.removeprefix("userProperties:"): value for key, value in properties.items()}
        if "instance" in properties:
            found[int(properties["instance"])] = item, properties
    farthest = 0.0
    for organ in expected:
        if "instance" not in organ:
            continue
        item, properties = found[organ["instance"]]
        assert item.name.startswith(organ["name"]), (item.name, organ["name"])
        assert int(properties["class_id"]) == organ["class_id"], organ["name"]
        place = item.matrix_world @ Vector((0.0, 0.0, 0.0))
        farthest = max(farthest, (place - Matrix(organ["pose"]).translation).length)
    assert farthest < TOLERANCE_M, f"{path}: a pose differs by {farthest:g} m"
    images = sum(image.size[0] > 0 for image in bpy.data.images)
    print(f"{path}: {len(found)} organs, {images} images, {farthest:.1e} m, {seconds:.1f} s")


if __name__ == "__main__":
    for name in sys.argv[1:]:
        check(Path(name))
