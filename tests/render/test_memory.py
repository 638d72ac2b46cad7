"""Memory does not grow with the number of scenes and frames."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCENES, FRAMES = 10, 30
MAX_GROWTH_MIB = 12.0
"""Chosen: exceeded by a leak of 0.06 MiB per frame, or of 2 MiB per scene, half the size of one."""

RUN = f"""
import gc, json
import numpy as np
from greenhouse import camera, greenhouse
from pepperscene.frame import DEFAULT_OUTPUTS
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene, partly_cloudy_sky

def resident():
    gc.collect()
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 2**20

first = greenhouse()
sizes = []
for number in range({SCENES}):
    sky = partly_cloudy_sky(
        np.random.default_rng(number), illuminance_lx=5500.0, sun_azimuth_rad=-0.5, sun_elevation_rad=0.7,
        sun_fraction=0.3, cloud_cover=0.5,
    )
    mesh = first.mesh.moved(np.eye(3), np.array([0.001 * number, 0.0, 0.0]))
    renderer = Renderer(assemble_scene(mesh, dict(zip(mesh.surfaces, first.surfaces)), sky))
    for frame in range({FRAMES}):
        renderer.render(camera(frame % 3, columns=32, rows=24), DEFAULT_OUTPUTS, "draft", frame)
    del renderer
    sizes.append(resident())
print(json.dumps(sizes))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the system does not report memory sizes")
def test_memory_does_not_grow_with_frames_and_scenes():
    path = os.pathsep.join([str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])])
    process = subprocess.run(
        [sys.executable, "-c", RUN],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert process.returncode == 0, process.stderr
    sizes = json.loads(process.stdout.splitlines()[-1])
    # The first scenes fill the allocators' caches; from the third on nothing may be added.
    assert max(sizes[3:]) - sizes[2] < MAX_GROWTH_MIB, sizes
