"""Small data sets for benchmark tasks, with images that a function paints in place of a renderer."""

from __future__ import annotations

import data_sets
import numpy as np
from stand_in import SceneStandIn

from pepperscene.frame import Frame

SIZE = (24, 32)
SMALL = {
    "plan.sets": 2, "plan.rotations": 1, "plan.frames": 2, "camera.width": SIZE[1], "camera.height": SIZE[0],
}  # fmt: skip
D435 = data_sets.D435 | {"depth_camera.width": 212, "depth_camera.height": 120}


def painted_set(folder, outputs, paint, changes=None, recipe="barth2018"):
    """Build a data set of a scene without plants whose images are those that `paint(seed)` returns."""

    class Painter(SceneStandIn):
        def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
            images = paint(seed, (camera.height, camera.width))
            size = {"width": camera.width, "height": camera.height}
            metadata = {"camera": {**camera.to_metadata(), **size}, "instances": {}}
            return Frame({name: images[name] for name in outputs}, metadata)

    changes = SMALL | (changes or {})
    return data_sets.set_without_plants(folder, None, outputs, Painter, changes, recipe=recipe)


def paint_depth(seed, size):
    """Two planes, the right one nearer and of another colour and organ, with holes in the measured depth."""
    rng = np.random.default_rng(seed)
    middle = int(rng.integers(size[1] // 3, size[1] // 2))
    right = np.arange(size[1])[None, :] >= middle
    right = np.broadcast_to(right, size)
    depth = np.where(right, 0.5, 0.8).astype(np.float32)
    depth[0] = np.inf
    sensor = depth.copy()
    sensor[~np.isfinite(depth)] = np.nan
    sensor[8:16, middle - 4 : middle + 4] = np.nan
    colour = np.zeros((*size, 3), np.uint8)
    colour[right] = (200, 30, 30)
    return {
        "colour": colour,
        "instance": np.where(right, 2, 1).astype(np.uint16),
        "depth_z": depth,
        "depth_sensor": sensor,
    }
