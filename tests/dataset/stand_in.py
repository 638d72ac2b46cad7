"""A renderer without Mitsuba that other processes can import too: its pictures depend on view and seed alone.

It notes the seed of every frame that it renders in the file named by `STAND_IN_LOG`, and takes `STAND_IN_S`
seconds for each.
"""

from __future__ import annotations

import os
import signal
import time

import numpy as np

from pepperscene.frame import OUTPUTS, Frame

SIZE = (6, 8)


class StandIn:
    def __init__(self, scene):
        self.triangles = len(scene.mesh.faces)

    def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
        _note(seed)
        time.sleep(float(os.environ.get("STAND_IN_S", "0")))
        seen = {"1": {"class": 1, "kind": "lamina", "plant": 0, "phytomer": 3, "parent": 0, "pixels": 5}}
        facts = {"camera": camera.metadata(), "instances": seen, "triangles": self.triangles}
        return Frame({name: _image(name, camera, seed) for name in outputs}, facts)


class Logged:
    """Mitsuba, noting what it renders."""

    def __init__(self, scene):
        from pepperscene.render import Renderer

        self.renderer = Renderer(scene)

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        _note(seed)
        return self.renderer.render(camera, outputs, quality, seed, **others)


class Deadly(StandIn):
    """Ends its process at the frame whose seed is `DEADLY_SEED`, as a system does without memory."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        if str(seed) == os.environ.get("DEADLY_SEED") and not _once("DEADLY_ONCE"):
            os.kill(os.getpid(), signal.SIGKILL)
        return super().render(camera, outputs, quality, seed, **others)


class Threaded(StandIn):
    """Tells with how many threads Mitsuba would work."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        frame = super().render(camera, outputs, quality, seed, **others)
        return Frame(frame.images, {**frame.metadata, "threads": os.environ["PEPPERSCENE_THREADS"]})


class Hungry(StandIn):
    """Asks for more memory than there is."""

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        raise MemoryError


def _note(seed):
    log = os.environ.get("STAND_IN_LOG")
    if log:
        with open(log, "a", encoding="utf-8") as file:
            file.write(f"{seed}\n")


def _once(variable):
    """Whether the file that a variable names is there already; it is from then on."""
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
