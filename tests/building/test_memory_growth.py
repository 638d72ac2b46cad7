"""The memory of a build does not grow with its number of frames."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest
from stand_in import PYTHONPATH

from pepperscene.building.subprocess_rpc import THREADS

HAS_GLIBC = Path("/proc/self/statm").exists() and platform.libc_ver()[0] == "glibc"
MAX_GROWTH_MIB = 5.0
"""Chosen: twice the noise; eight scenes would be 100 MiB, the images of 240 frames 30 MiB."""

SCRIPT = """
import ctypes, gc, json, resource, tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.building.scenes.frame_renderer import AssembledScene
from pepperscene.geometry import sphere
from pepperscene.materials import lambertian_surface
from pepperscene.scene import assemble_scene

SCENES, FRAMES = 10, 30

def sphere_scene(renderer, spec, **_):
    # 80,000 triangles in front of the camera, different ones in every scene.
    rng = np.random.default_rng([spec.set, spec.rotation])
    mesh = sphere(rng.uniform(-0.02, 0.02, 3) + [0, 0, 0.3], 0.15, "matt", subdivisions=6)
    return AssembledScene(assemble_scene(mesh, {"matt": lambertian_surface("matt", 0.5)}), {})

def small_camera(renderer, spec, *arguments, **options):
    camera = camera_of(renderer, spec, *arguments, **options)
    sensor = camera.sensor
    return replace(camera, sensor=replace(sensor, columns=80, rows=60, binning=10 * sensor.binning))

def note_memory(progress):
    if progress.done % FRAMES == 0:
        gc.collect()
        # glibc keeps freed memory for later, up to 18 MiB at a random scene: it is returned first.
        ctypes.CDLL(None).malloc_trim(0)
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        sizes.append(pages * resource.getpagesize())

changes = {"plan.sets": 2, "plan.rotations": SCENES // 2, "plan.frames": FRAMES}
recipe = load_recipe("barth2018", {**changes, "cultivar": "kaite_february"})
camera_of, sizes = FrameRenderer.camera, []
FrameRenderer.assemble, FrameRenderer.camera = sphere_scene, small_camera
with tempfile.TemporaryDirectory() as folder:
    outputs = ("colour", "class", "instance", "distance", "normal")
    build(recipe, Path(folder) / "set", None, outputs, BuildOptions("draft"), note_memory)
print(json.dumps(sizes))
"""


@pytest.mark.long
@pytest.mark.skipif(not HAS_GLIBC, reason="only glibc reports and returns its memory in this way")
def test_300_frames_of_10_scenes_need_no_more_memory_than_60_frames_of_2():
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        capture_output=True,
        text=True,
        timeout=600,
        # `make test` limits the threads of tests; this build has a thread on each core, as for a user.
        env={name: value for name, value in os.environ.items() if name not in THREADS}
        | {"PYTHONPATH": PYTHONPATH},
    )
    assert result.returncode == 0, result.stderr
    sizes = json.loads(result.stdout.splitlines()[-1])
    assert len(sizes) == 10
    assert max(sizes[-5:]) - max(sizes[:2]) < MAX_GROWTH_MIB * 2**20, sizes
