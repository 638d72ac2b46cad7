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
from pepperscene.frame import Frame
from pepperscene.outputs import OUTPUTS

SIZE = (6, 8)
PYTHONPATH = os.pathsep.join(
    str(path) for path in (Path(__file__).parent, Path(pepperscene.__file__).parents[1])
)
"""For other processes: this folder, and the package under test."""

_UNGATED_FRAMES = 3
_rendered = 0


class SceneStandIn:
    """What stand-ins for the renderer of a scene share."""

    def __init__(self, scene):
        self.scene = scene

    def visible_points(self, camera, points, normals=None, *, alone=None):
        raise NotImplementedError("a stand-in shows no random views")


class StandIn(SceneStandIn):
    """Renders noise."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
        _log(seed)
        time.sleep(float(os.environ.get("STAND_IN_S", "0")))
        # As of Mitsuba, only labels list instances.
        labelled = any(not OUTPUTS[name].traced for name in outputs)
        instance = {"class": 1, "kind": "lamina", "plant": 0, "phytomer": 3, "parent": 0, "pixels": 5}
        metadata = {
            "camera": camera.to_metadata(),
            "instances": {"1": instance} if labelled else {},
            "triangles": len(self.scene.mesh.faces),
        }
        return Frame({name: _image(name, camera, seed) for name in outputs}, metadata)


class LoggedRenderer(SceneStandIn):
    """Mitsuba, with the log."""

    def __init__(self, scene):
        from pepperscene.render import Renderer

        self.renderer = Renderer(scene)

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        _log(seed)
        return self.renderer.render(camera, outputs, quality, seed, **others)


class KilledRenderer(StandIn):
    """Kills its process at the frame whose seed is `KILL_SEED`, as a system does when memory runs out.

    With `KILL_ONCE`, the path of a file that does not exist yet, it does so only once.
    """

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        if str(seed) == os.environ.get("KILL_SEED") and _is_new(os.environ.get("KILL_ONCE")):
            os.kill(os.getpid(), signal.SIGKILL)
        return super().render(camera, outputs, quality, seed, **others)


class GatedRenderer(StandIn):
    """Waits, after a process's third frame, until the file named by `GATE` exists."""

    def render(self, *args, **kwargs):
        global _rendered
        frame = super().render(*args, **kwargs)
        _rendered += 1
        while _rendered > _UNGATED_FRAMES and not Path(os.environ["GATE"]).exists():
            time.sleep(0.02)
        return frame


class ThreadsRenderer(StandIn):
    """Adds the number of threads that Mitsuba would use to the metadata."""

    def render(self, *args, **kwargs):
        frame = super().render(*args, **kwargs)
        return Frame(frame.images, {**frame.metadata, "threads": os.environ["PEPPERSCENE_THREADS"]})


class OutOfMemoryRenderer(StandIn):
    def render(self, *args, **kwargs):
        raise MemoryError


def rendered(log):
    """Process and seed of every frame that was started, in that order."""
    return [tuple(map(int, line.split())) for line in log.read_text().splitlines()] if log.exists() else []


def wait_for(condition, timeout_s=300.0):
    """Wait until a condition is true, and return its value."""
    end = time.monotonic() + timeout_s
    while not (result := condition()):
        assert time.monotonic() < end, "the condition did not become true"
        time.sleep(0.02)
    return result


def process_fields():
    """Yield the id of every process on this machine with its state, parent, group and session."""
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, *numbers = status.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        yield int(status.parent.name), state, *map(int, numbers)


def _log(seed):
    log = os.environ.get("STAND_IN_LOG")
    if log:
        with open(log, "a", encoding="utf-8") as file:
            file.write(f"{os.getpid()} {seed}\n")


def _is_new(path):
    """Whether a file does not exist yet; it does from then on."""
    try:
        if path:
            open(path, "x", encoding="utf-8").close()
    except FileExistsError:
        return False
    return True


def _image(name, camera, seed):
    output = OUTPUTS[name]
    if name == "amodal":
        return {"format": "pepperscene amodal 1", "organs": []}
    if not output.is_image:
        return {"format": "pepperscene harvest 1", "fruit": [], "graph": {"nodes": [], "edges": []}}
    position = (int(abs(value) * 1e9) for value in camera.pose[:3, 3])
    rng = np.random.default_rng([list(OUTPUTS).index(name), *position, seed])
    shape = (*SIZE, *output.channels[-1:])
    if not output.dtype.startswith("float"):
        end = {"class": 8, "instance": 65536, "raw": 4096}.get(name, 256)
        return rng.integers(0, end, shape).astype(output.dtype)
    values = rng.uniform(0.1, 2.0, shape).astype(output.dtype)
    if name in ("distance", "depth_z"):
        values[0, 0] = np.inf
    return values
