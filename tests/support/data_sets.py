"""Data sets without plants, which build fast, and the files that two builds of one data set must share."""

from __future__ import annotations

import numpy as np
import pytest
from stand_in import StandIn

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.building.scenes.frame_renderer import AssembledScene, FrameRenderer
from pepperscene.dataset.readers.image_set import ImageSet, LabelledImage
from pepperscene.geometry import rectangle
from pepperscene.recipe.resolve.load import load_recipe
from pepperscene.scene import assemble_scene

TABLES = frozenset({"manifest.parquet", "fruit.parquet", "journal.jsonl"})

D435 = {
    "depth_camera.sensor": "realsense_d435_infrared",
    "depth_camera.lens": "realsense_d435_infrared",
    "depth_camera.projector": "realsense_d435",
    "depth_camera.width": 424,
    "depth_camera.height": 240,
    "depth_camera.baseline_mm": 50,
    "depth_camera.position_mm": [15, 0, 0],
}
"""Changes of a recipe that give it a depth camera."""

OUTPUTS = ("colour", "class", "instance", "distance", "harvest")
FRAMES = 9
CUT = {"camera_m": [0.1, 0.0, 0.4], "world_m": [0.0, 0.0, 1.0], "px": [3.5, 1.25], "visible": True}
FRUIT = {
    "instance": 412, "plant": 3, "phytomer": 17, "kind": "fruit", "ripeness": 0.75, "ripeness_spread": 0.1,
    "length_m": 0.08, "diameter_m": 0.075, "pose": np.eye(4).tolist(),
    "box": [1, 2, 5, 4], "amodal_box": [0, 2, 6, 5], "visible_pixels": 7, "amodal_pixels": 14,
    "visible_fraction": 0.5, "truncated": False, "occluders": [{"instance": 88, "pixels": 7}],
    "amodal": {"size": [6, 8], "counts": [0, 14, 34]},
    "peduncle": {"instance": 411, "attachment": CUT, "cut": CUT},
    "approach": {"camera": [0.0, 0.0, 1.0], "world": [0.0, 1.0, 0.0]},
}  # fmt: skip
HIDDEN = {
    **FRUIT, "instance": 500, "box": None, "visible_pixels": 0, "visible_fraction": 0.0, "peduncle": None,
}  # fmt: skip
HARVEST = {"format": "pepperscene harvest 1", "fruit": [FRUIT, HIDDEN], "graph": {"nodes": [], "edges": []}}


def contents(folder):
    """Bytes of every file below a folder by relative path, except the tables, which hold timings.

    Unfinished files of a lost process are included.
    """
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in TABLES
    }


def remove_plants(monkeypatch):
    """Make all scenes consist of one rectangle."""
    scene = assemble_scene(rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)))
    monkeypatch.setattr(FrameRenderer, "assemble", lambda *_args, **_kwargs: AssembledScene(scene, {}))


def set_without_plants(
    folder, frames, outputs, renderer=StandIn, changes=None, on_notice=None, recipe="barth2018"
):
    """Build frames of two sets, three rotations and four steps of a scene that holds one rectangle."""
    changes = {
        "plan.sets": 2, "plan.rotations": 3, "plan.frames": 4, "row.plants_front": 1, "row.plants_back": 0,
        "cultivar": "kaite_february", **(changes or {}),
    }  # fmt: skip
    with pytest.MonkeyPatch.context() as monkeypatch:
        remove_plants(monkeypatch)
        recipe = load_recipe(recipe, changes)
        options = BuildOptions(renderer=renderer, on_notice=on_notice)
        return build(recipe, folder, frames and list(frames), outputs, options).dataset


class HarvestRenderer(StandIn):
    """Renders the same two fruit in every frame."""

    def render(self, *args, **kwargs):
        frame = super().render(*args, **kwargs)
        frame.images["harvest"] = HARVEST
        return frame


def make_small_set(folder):
    """Nine tiny frames of three scenes with all outputs that exports use."""
    return set_without_plants(folder, range(FRAMES), OUTPUTS, HarvestRenderer)


class RandomImages(ImageSet):
    """Photographs of noise, the upper half labelled as fruit, generated on access."""

    def names(self):
        return tuple(f"random{item}" for item in self.items)

    def read(self, item):
        rng = np.random.default_rng(item)
        colour = rng.integers(0, 256, (30, 40, 3)).astype(np.uint8) if "colour" in self.fields else None
        classes = np.full((30, 40), 255, np.uint8)
        classes[:15] = 2
        return LabelledImage(f"random{item}", colour, classes if "classes" in self.fields else None)
