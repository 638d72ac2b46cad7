"""A small recipe, and a renderer that needs no Mitsuba but obeys the same contract."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from pepperscene.dataset import FrameRenderer, Recipe, load_recipe, open_dataset
from pepperscene.frame import OUTPUTS, Frame, check_outputs
from pepperscene.geometry import rectangle
from pepperscene.scene import assemble_scene

SIZE = (6, 8)


class FakeRenderer:
    """Noise that depends on the view, the seed and the scene alone, like a real frame."""

    made: list = []  # noqa: RUF012 - the fixture empties it

    def __init__(self, scene):
        self.scene = scene
        self.views, self.others = [], []
        FakeRenderer.made.append(self)

    def render(self, camera, outputs=(), quality="standard", seed=0, others=None):
        names = check_outputs(outputs)
        self.views.append((camera, names, quality, seed))
        self.others.append(others)
        images = {name: self._image(name, camera, seed) for name in names}
        seen = {"1": {"class": 1, "kind": "lamina", "plant": 0, "phytomer": 3, "parent": 0}}
        labelled = any(not OUTPUTS[name].traced for name in names)
        facts = {
            "camera": camera.metadata(),
            "variant": "fake",
            "versions": {"fake": "1"},
            "instances": seen if labelled else {},
        }
        return Frame(images, facts)

    def _image(self, name, camera, seed):
        place = int(abs(camera.pose[0, 3]) * 1e9)
        rng = np.random.default_rng([list(OUTPUTS).index(name), place, seed])
        if name == "harvest":
            return {"format": "pepperscene harvest 1", "fruit": [], "graph": {"nodes": [], "edges": []}}
        shape = (*SIZE, *OUTPUTS[name].channels[-1:])
        if OUTPUTS[name].dtype.startswith("float"):
            values = rng.uniform(0.1, 2.0, shape).astype(OUTPUTS[name].dtype)
            if name in ("distance", "depth_z"):
                values[0, 0] = np.inf
            return values
        top = {"class": 8, "instance": 65536, "raw": 4096}.get(name, 256)
        return rng.integers(0, top, shape).astype(OUTPUTS[name].dtype)


@pytest.fixture
def fake_renderer():
    FakeRenderer.made.clear()
    return FakeRenderer


@pytest.fixture
def recipe() -> Recipe:
    """The shipped plan with few frames and a single plant, of the smallest stage."""
    whole = load_recipe("barth2018")
    plan = whole.plan.model_copy(update={"sets": 2, "rotations": 3, "frames": 4})
    row = whole.row.model_copy(update={"plants_front": 1, "plants_back": 0})
    camera = whole.camera.model_copy(update={"baseline_mm": 60.0})
    changes = {"name": "small", "plan": plan, "row": row, "camera": camera, "cultivar": "kaite_february"}
    return whole.model_copy(update=changes)


@pytest.fixture
def empty_scenes(monkeypatch):
    """Scenes without plants, where only files are examined."""
    scene = assemble_scene(rectangle((0, 0, 1), (1, 0, 0), (0, 0, 1)))
    monkeypatch.setattr(FrameRenderer, "scene", lambda *_args, **_kwargs: scene)


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """Nine tiny frames with all that exports carry; to be read, not changed."""
    from small_set import make_small_set

    return make_small_set(tmp_path_factory.mktemp("small") / "set")


@pytest.fixture(scope="session")
def painted(tmp_path_factory):
    """Six painted frames, with organs in pieces and with holes; to be read, not changed."""
    from painted_set import make_painted_set

    return make_painted_set(tmp_path_factory.mktemp("painted") / "set")


@pytest.fixture
def copied(tmp_path):
    """Copies a data set, to be damaged at will."""

    def copy(dataset):
        shutil.copytree(dataset.folder, tmp_path / "set")
        return open_dataset(tmp_path / "set")

    return copy
