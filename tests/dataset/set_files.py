"""Data sets without plants, which build fast, and the files that two builds of one data set must share."""

from __future__ import annotations

import pytest

from pepperscene.dataset import BuildOptions, FrameRenderer, build, load_recipe
from pepperscene.dataset.scenes.frame_renderer import AssembledScene
from pepperscene.geometry import rectangle
from pepperscene.scene import assemble_scene

TABLES = frozenset({"manifest.parquet", "fruit.parquet", "journal.jsonl"})


def contents(folder):
    """Bytes of every file below a folder by relative path, except the tables, which hold timings.

    Unfinished files of a lost process are included.
    """
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in TABLES
    }


def set_without_plants(folder, frames, outputs, renderer, changes=None):
    """Frames of two sets, three rotations and four steps of a scene that holds one rectangle."""
    changes = {
        "plan.sets": 2, "plan.rotations": 3, "plan.frames": 4, "row.plants_front": 1, "row.plants_back": 0,
        "cultivar": "kaite_february", **(changes or {}),
    }  # fmt: skip
    scene = assemble_scene(rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FrameRenderer, "assemble", lambda *_args, **_kwargs: AssembledScene(scene, {}))
        recipe = load_recipe("barth2018", changes)
        return build(recipe, folder, list(frames), outputs, BuildOptions(renderer=renderer)).dataset
