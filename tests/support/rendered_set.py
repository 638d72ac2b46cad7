"""A small row of plants that is grown, with the labels that Mitsuba renders and with colours of noise.

The lens has no distortion, which BOP does not have, and `position` holds the true world point of every pixel.
"""

from __future__ import annotations

import numpy as np
from stand_in import SceneStandIn

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.recipe.resolve.load import load_recipe

STEPS = 12
FRAMES = (5, 6, 17)  # two of the first rotation, one of the second
OUTPUTS = ("colour", "class", "instance", "distance", "depth_z", "position", "harvest")
RECIPE = {
    "plan.sets": 1, "plan.rotations": 2, "plan.frames": STEPS, "row.plants_front": 2, "row.plants_back": 0,
    "cultivar": "kaite", "camera.lens": "none", "camera.width": 320, "camera.height": 240,
    "camera.fx": 210.0, "camera.fy": 212.0, "camera.cx": 158.3, "camera.cy": 121.2,
}  # fmt: skip


class LabelRenderer(SceneStandIn):
    """Mitsuba for labels; tracing light would take most of the time."""

    def __init__(self, scene):
        from pepperscene.render import Renderer

        self.renderer = Renderer(scene)

    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        labels = tuple(name for name in outputs if name != "colour")
        frame = self.renderer.render(camera, labels, quality, seed, **others)
        shape = (*frame.images["instance"].shape, 3)
        frame.images["colour"] = np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)
        return frame


def make_rendered_set(folder):
    """Frames of two plants."""
    recipe = load_recipe("barth2018", RECIPE)
    options = BuildOptions(quality="draft", renderer=LabelRenderer)
    return build(recipe, folder, list(FRAMES), OUTPUTS, options).dataset
