"""Small data sets for benchmark tasks, with images that a function paints in place of a renderer."""

from __future__ import annotations

import numpy as np
import pytest
from stand_in import SceneStandIn

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.building.scenes.frame_renderer import AssembledScene, FrameRenderer
from pepperscene.frame import Frame
from pepperscene.geometry import rectangle
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.scene import assemble_scene

SIZE = (24, 32)
SMALL = {
    "plan.sets": 2, "plan.rotations": 1, "plan.frames": 2, "row.plants_front": 1, "row.plants_back": 0,
    "cultivar": "kaite_february", "camera.width": SIZE[1], "camera.height": SIZE[0],
}  # fmt: skip
D435 = {
    "depth_camera.sensor": "realsense_d435_infrared",
    "depth_camera.lens": "realsense_d435_infrared",
    "depth_camera.projector": "realsense_d435",
    "depth_camera.width": 212,
    "depth_camera.height": 120,
    "depth_camera.baseline_mm": 50,
}


def painted_set(folder, outputs, paint, changes=None, recipe="barth2018", frames=None):
    """Build a data set of a scene without plants whose images are those that `paint(seed)` returns."""

    class Painter(SceneStandIn):
        def render(self, camera, outputs=(), quality="standard", seed=0, **_others):
            images = paint(seed, (camera.height, camera.width))
            size = {"width": camera.width, "height": camera.height}
            metadata = {"camera": {**camera.to_metadata(), **size}, "instances": {}}
            return Frame({name: images[name] for name in outputs}, metadata)

    scene = assemble_scene(rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)))
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(FrameRenderer, "assemble", lambda *_args, **_kwargs: AssembledScene(scene, {}))
        resolved = load_recipe(recipe, {**SMALL, **(changes or {})})
        return build(resolved, folder, frames, outputs, BuildOptions(renderer=Painter)).dataset


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
