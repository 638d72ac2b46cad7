"""Data sets as files: one without plants, made in no time, and what two builds of one must have in common."""

from __future__ import annotations

import pytest

from pepperscene.dataset import BuildOptions, FrameRenderer, build, load_recipe
from pepperscene.dataset.scenes.frame_renderer import AssembledScene
from pepperscene.geometry import rectangle
from pepperscene.scene import assemble_scene

TABLES = frozenset({"manifest.parquet", "fruit.parquet", "journal.jsonl"})


def contents(folder):
    """Bytes of every file below a folder by relative path, but for the tables, which hold timings.

    What a lost process left half-written counts, too.
    """
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in TABLES
    }


def set_without_plants(folder, frames, outputs, renderer):
    """Frames out of two sets, three rotations and four steps of a scene that holds one card."""
    changes = {
        "plan.sets": 2, "plan.rotations": 3, "plan.frames": 4, "row.plants_front": 1, "row.plants_back": 0,
        "cultivar": "kaite_february",
    }  # fmt: skip
    scene = assemble_scene(rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FrameRenderer, "assemble", lambda *_args, **_kwargs: AssembledScene(scene, {}))
        recipe = load_recipe("barth2018", changes)
        return build(recipe, folder, list(frames), outputs, BuildOptions(renderer=renderer)).dataset
