"""Scenes come and go, and so does their memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCENES, FRAMES = 10, 30
GROWTH_MIB = 12.0
"""Chosen: would be passed by a leak of 0.06 MiB a frame, or of 2 MiB, half of such a scene, a scene."""

RUN = f"""
import gc, json
import numpy as np
from greenhouse import camera, greenhouse
from pepperscene.frame import DEFAULT_OUTPUTS
from pepperscene.render import Renderer
from pepperscene.scene import assemble, partly_cloudy

def resident():
    gc.collect()
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 2**20

first = greenhouse()
told = []
for number in range({SCENES}):
    sky = partly_cloudy(
        np.random.default_rng(number), illuminance_lx=5500.0, sun_azimuth_rad=-0.5, sun_elevation_rad=0.7,
        sun_fraction=0.3, cloud_cover=0.5,
    )
    mesh = first.mesh.moved(np.eye(3), np.array([0.001 * number, 0.0, 0.0]))
    renderer = Renderer(assemble(mesh, dict(zip(mesh.surfaces, first.surfaces)), sky))
    for frame in range({FRAMES}):
        renderer.render(camera(frame % 3, columns=32, rows=24), DEFAULT_OUTPUTS, "draft", frame)
    del renderer
    told.append(resident())
print(json.dumps(told))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the system does not tell")
def test_memory_does_not_grow_with_frames_and_scenes():
    path = os.pathsep.join([str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    # The first scenes fill the caches of allocators; from the third on nothing may be added.
    assert max(told[3:]) - told[2] < GROWTH_MIB, told
