"""Renderers without Mitsuba that other processes can import too; images depend on view and seed alone.

Every renderer appends a line "process seed" to the file named by `STAND_IN_LOG` before a frame, and takes
`STAND_IN_S` seconds for it.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np

import pepperscene
from pepperscene.frame import OUTPUTS, Frame

SIZE = (6, 8)
PYTHONPATH = os.pathsep.join(
    str(path) for path in (Path(__file__).parent, Path(pepperscene.__file__).parents[1])
)
"""For other processes: this folder, and the package under test."""

_FREE_FRAMES = 3
_rendered = 0


class StandIn:
    def __init__(self, scene):
        self.triangles = len(scene.mesh.faces)

    def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
        _log(seed)
        time.sleep(float(os.environ.get("STAND_IN_S", "0")))
        instances = {"1": {"class": 1, "kind": "lamina", "plant": 0, "phytomer": 3, "parent": 0, "pixels": 5}}
        metadata = {"camera": camera.metadata(), "instances": instances, "triangles": self.triangles}
        return Frame({name: _image(name, camera, seed) for name in outputs}, metadata)


class Logged:
    """Mitsuba, with the log."""

    def __init__(self, scene):
        from pepperscene.render import Renderer

        self.renderer = Renderer(scene)

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        _log(seed)
        return self.renderer.render(camera, outputs, quality, seed, **others)


class Deadly(StandIn):
    """Kills its process at the frame whose seed is `DEADLY_SEED`, as a system does without memory."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        if str(seed) == os.environ.get("DEADLY_SEED") and not _exists_already("DEADLY_ONCE"):
            os.kill(os.getpid(), signal.SIGKILL)
        return super().render(camera, outputs, quality, seed, **others)


class Gated(StandIn):
    """Waits, after a process's third frame, until the file named by `GATE` exists."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        global _rendered
        frame = super().render(camera, outputs, quality, seed, **others)
        _rendered += 1
        while _rendered > _FREE_FRAMES and not Path(os.environ["GATE"]).exists():
            time.sleep(0.02)
        return frame


class Threaded(StandIn):
    """Adds the number of threads that Mitsuba would use."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        frame = super().render(camera, outputs, quality, seed, **others)
        return Frame(frame.images, {**frame.metadata, "threads": os.environ["PEPPERSCENE_THREADS"]})


class Hungry(StandIn):
    """Runs out of memory."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        raise MemoryError


def _log(seed):
    log = os.environ.get("STAND_IN_LOG")
    if log:
        with open(log, "a", encoding="utf-8") as file:
            file.write(f"{os.getpid()} {seed}\n")


def rendered(log):
    """Process and seed of every frame that was started, in that order."""
    return [tuple(map(int, line.split())) for line in log.read_text().splitlines()] if log.exists() else []


def wait_for(condition, patience_s=30.0):
    end = time.monotonic() + patience_s
    while not (result := condition()):
        assert time.monotonic() < end, "the condition did not become true"
        time.sleep(0.02)
    return result


def _exists_already(variable):
    """Whether the file that a variable names exists; it does from then on."""
    path = os.environ.get(variable)
    if not path:
        return False
    try:
        with open(path, "x", encoding="utf-8"):
            return False
    except FileExistsError:
        return True


def _image(name, camera, seed):
    output = OUTPUTS[name]
    rng = np.random.default_rng([list(OUTPUTS).index(name), int(camera.pose[2, 3] * 1e9), seed])
    shape = (*SIZE, *output.channels[-1:])
    if output.dtype.startswith("float"):
        return rng.uniform(0.1, 2.0, shape).astype(output.dtype)
    return rng.integers(0, 8 if name == "class" else 256, shape).astype(output.dtype)
