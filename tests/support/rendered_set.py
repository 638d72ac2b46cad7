"""A small row of plants that is grown and rendered, with every output that exports use.

The lens has no distortion, which BOP does not have, and `position` holds the true world point of every pixel.
"""

from __future__ import annotations

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


def make_rendered_set(folder, frames=FRAMES, changes=None):
    """Draft frames of two plants; all frames of the plan for None."""
    recipe = load_recipe("barth2018", {**RECIPE, **(changes or {})})
    return build(recipe, folder, frames and list(frames), OUTPUTS, BuildOptions(quality="draft")).dataset
