"""A long build holds no more memory than a short one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from stand_in import PYTHONPATH

STATM = Path("/proc/self/statm")

BUILD = """
    import gc, json, resource, tempfile
    from dataclasses import replace
    from pathlib import Path

    import numpy as np
    import trimesh

    from pepperscene.classes import Instance, OrganClass
    from pepperscene.dataset import BuildOptions, FrameRenderer, build, load_recipe
    from pepperscene.dataset.scenes.frame_renderer import AssembledScene
    from pepperscene.geometry import Mesh
    from pepperscene.materials import lambertian_surface
    from pepperscene.scene import assemble_scene

    SCENES, FRAMES = 10, 30

    def sphere_scene(renderer, spec, **_):
        # 80,000 triangles in front of the camera, different ones in every scene.
        rng = np.random.default_rng([spec.set, spec.rotation])
        sphere = trimesh.creation.icosphere(subdivisions=6, radius=0.15)
        vertices = (sphere.vertices + rng.uniform(-0.02, 0.02, 3) + [0, 0, 0.3]).astype(np.float32)
        mesh = Mesh(
            vertices=vertices,
            normals=np.asarray(sphere.vertex_normals, np.float32),
            uv=np.full((len(vertices), 2), 0.5, np.float32),
            state=np.full(len(vertices), 0.5, np.float32),
            faces=sphere.faces.astype(np.uint32),
            face_instance=np.zeros(len(sphere.faces), np.uint32),
            face_surface=np.zeros(len(sphere.faces), np.uint8),
            surfaces=("matt",),
            instances=(Instance(OrganClass.PEPPER, "sphere"),),
        )
        return AssembledScene(assemble_scene(mesh, {"matt": lambertian_surface("matt", 0.5)}), {})

    def held():
        gc.collect()
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    recipe = load_recipe("barth2018", {"plan.sets": 2, "plan.rotations": SCENES // 2, "plan.frames": FRAMES,
                                       "cultivar": "kaite_february"})
    camera_of = FrameRenderer.camera

    def small_camera(renderer, spec):
        camera = camera_of(renderer, spec)
        sensor = camera.sensor
        return replace(camera, sensor=replace(sensor, columns=80, rows=60, binning=10 * sensor.binning))

    def note(progress):
        if progress.done % FRAMES == 0:
            sizes.append(held())

    FrameRenderer.assemble, FrameRenderer.camera = sphere_scene, small_camera
    sizes = []
    with tempfile.TemporaryDirectory() as folder:
        outputs = ("colour", "class", "instance", "distance", "normal")
        build(recipe, Path(folder) / "set", None, outputs, BuildOptions("draft"), note)
    print(json.dumps(sizes))
"""


@pytest.mark.skipif(not STATM.exists(), reason="only Linux tells how much memory a process holds now")
def test_300_frames_of_10_scenes_hold_no_more_than_60_frames_of_2():
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(BUILD)],
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, "PYTHONPATH": PYTHONPATH},
    )
    assert done.returncode == 0, done.stderr
    held = json.loads(done.stdout.splitlines()[-1])
    assert len(held) == 10
    # Eight scenes that stayed would be 100 MiB, the images of 240 frames 30 MiB; the allocator's
    # reserve varies by 15 MiB.
    assert max(held[-5:]) - max(held[:2]) < 16 * 2**20
