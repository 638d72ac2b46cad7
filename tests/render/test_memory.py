"""Memory does not grow with the number of scenes and frames."""

from __future__ import annotations

from pathlib import Path

import pytest
from processes import run_python

SCENES, FRAMES = 10, 30
MAX_GROWTH_MIB = 12.0
"""Chosen: exceeded by a leak of 0.06 MiB per frame, or of 2 MiB per scene, half the size of one."""

RUN = f"""
import gc, json
import numpy as np
from greenhouse import camera, cloudy_sky, greenhouse
from pepperscene.frame import DEFAULT_OUTPUTS
from pepperscene.render import Renderer
from pepperscene.scene import assemble_scene

def resident():
    gc.collect()
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 2**20

first = greenhouse()
sizes = []
for number in range({SCENES}):
    mesh = first.mesh.moved(np.eye(3), np.array([0.001 * number, 0.0, 0.0]))
    surfaces = dict(zip(mesh.surfaces, first.surfaces))
    renderer = Renderer(assemble_scene(mesh, surfaces, cloudy_sky(number)))
    for frame in range({FRAMES}):
        renderer.render(camera(frame % 3, columns=32, rows=24), DEFAULT_OUTPUTS, "draft", frame)
    del renderer
    sizes.append(resident())
print(json.dumps(sizes))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the system does not report memory sizes")
def test_memory_does_not_grow_with_frames_and_scenes():
    # One thread: with more, the memory that the allocator keeps for each varies by more than the bound.
    sizes = run_python(RUN, PEPPERSCENE_THREADS="1")
    # The first scenes fill the allocators' caches; from the third on memory must not grow.
    assert max(sizes[3:]) - sizes[2] < MAX_GROWTH_MIB, sizes
