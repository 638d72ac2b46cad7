"""Memory does not grow with the number of scenes and frames."""

from __future__ import annotations

import platform
from pathlib import Path

import pytest
from processes import run_python

HAS_GLIBC = Path("/proc/self/statm").exists() and platform.libc_ver()[0] == "glibc"
SCENES, FRAMES = 10, 30
MAX_GROWTH_MIB = 2.0
"""Chosen: exceeded by a leak of 0.01 MiB per frame, or of 0.3 MiB per scene, a tenth of the size of one."""

RUN = f"""
import ctypes, gc, json
import numpy as np
from greenhouse import camera, cloudy_sky, greenhouse
from pepperscene.outputs import DEFAULT_OUTPUTS
from pepperscene.render import Renderer
from pepperscene.render.transport.denoise import open_image_denoise
from pepperscene.scene import assemble_scene

def resident():
    gc.collect()
    # Give back what the allocator keeps for later; it varies by more than a leak that matters.
    ctypes.CDLL(None).malloc_trim(0)
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 2**20

# Both filters of the denoiser, which are loaded when a frame first needs them.
image = np.ones((48, 64, 3), np.float32)
for clean in (False, True):
    open_image_denoise().denoise(image, image, image, hdr=True, clean_aux=clean)

first = greenhouse()
sizes = []
for number in range({SCENES}):
    mesh = first.mesh.moved(np.eye(3), np.array([0.001 * number, 0.0, 0.0]))
    surfaces = dict(zip(mesh.surfaces, first.surfaces))
    renderer = Renderer(assemble_scene(mesh, surfaces, cloudy_sky(number)))
    for frame in range({FRAMES}):
        # A new camera each time, of which nothing may be kept.
        view = camera.__wrapped__(frame % 3, columns=32, rows=24)
        renderer.render(view, DEFAULT_OUTPUTS, "draft", frame)
    del renderer
    sizes.append(resident())
print(json.dumps(sizes))
"""


@pytest.mark.long
@pytest.mark.skipif(not HAS_GLIBC, reason="only glibc reports and returns its memory in this way")
def test_memory_does_not_grow_with_frames_and_scenes():
    sizes = run_python(RUN)
    # The first scenes fill the allocators' caches; from the third on memory must not grow.
    assert max(sizes[3:]) - sizes[2] < MAX_GROWTH_MIB, sizes
