"""A small recipe, small data sets, and a renderer that records its calls."""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest
import tomli_w
from data_sets import make_small_set, remove_plants
from disc_set import make_disc_set
from label_set import make_label_set
from painted_set import make_painted_set
from rendered_set import make_rendered_set
from stand_in import StandIn
from traced_set import make_traced_set

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildOptions
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.outputs import BAND_OUTPUTS, DEFAULT_OUTPUTS, OUTPUTS
from pepperscene.recipe.recipe import Recipe
from pepperscene.recipe.resolve.load import load_recipe


class FakeRenderer(StandIn):
    """Records its instances in `created`, and the arguments of each frame in `calls`."""

    created: list = []  # noqa: RUF012 - the fixture empties it

    def __init__(self, scene):
        super().__init__(scene)
        self.calls = []
        FakeRenderer.created.append(self)

    def render(self, camera, outputs=(), quality="standard", seed=0, *, partners=None, **_others):
        call = SimpleNamespace(camera=camera, outputs=outputs, quality=quality, seed=seed, partners=partners)
        self.calls.append(call)
        return super().render(camera, outputs, quality, seed)


@pytest.fixture
def fake_renderer():
    FakeRenderer.created.clear()
    return FakeRenderer


@pytest.fixture
def recipe() -> Recipe:
    """The shipped recipe with few frames and a single plant, of the smallest growth stage."""
    shipped = load_recipe("barth2018")
    plan = shipped.plan.model_copy(update={"sets": 2, "rotations": 3, "frames": 4})
    row = replace(shipped.row, plants_front=1, plants_back=0)
    camera = replace(shipped.camera, baseline_m=0.06)
    changes = {"name": "small", "plan": plan, "row": row, "camera": camera, "cultivar": "kaite_february"}
    return shipped.model_copy(update=changes)


@pytest.fixture
def build_small(recipe, tmp_path):
    """Builds the small recipe into a folder without Mitsuba; further keywords are build options."""

    def run(out="set", frames=None, outputs=("class", "distance"), on_frame=None, recipe=recipe, **options):
        options.setdefault("renderer", StandIn)
        return build(recipe, tmp_path / out, frames, outputs, BuildOptions(**options), on_frame)

    return run


@pytest.fixture
def local_renderer(tmp_path, monkeypatch):
    """A renderer in a module that other processes cannot import."""
    (tmp_path / "only_here.py").write_text("import stand_in\nclass Local(stand_in.StandIn): pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("only_here").Local
    del sys.modules["only_here"]


@pytest.fixture
def empty_scenes(monkeypatch):
    """Scenes without plants, where only files are examined."""
    remove_plants(monkeypatch)


@pytest.fixture
def write_recipe(tmp_path):
    """Writes a recipe file, which extends `barth2018` unless `extends` is given."""

    def write(file="mine.toml", /, **tables):
        path = tmp_path / file
        path.write_text(tomli_w.dumps({"extends": "barth2018", **tables}), encoding="utf-8")
        return path

    return write


@pytest.fixture
def refuse_rename(monkeypatch):
    """Makes renaming to a name fail."""
    replace = os.replace

    def install(name):
        def refuse(source, target):
            if str(target).endswith(name):
                raise OSError(5, "Input/output error", str(target))
            replace(source, target)

        monkeypatch.setattr(os, "replace", refuse)

    return install


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """Nine tiny frames with everything that exports contain; to be read, not changed."""
    return make_small_set(tmp_path_factory.mktemp("small") / "set")


@pytest.fixture(scope="session")
def grown_recipe():
    """Two scenes of a single plant, of the smallest growth stage, with three frames each."""
    changes = {
        "plan.sets": 1, "plan.rotations": 2, "plan.frames": 3, "row.plants_front": 1, "row.plants_back": 0,
        "cultivar": "kaite_february",
    }  # fmt: skip
    return load_recipe("barth2018", changes)


@pytest.fixture(scope="session")
def grown(grown_recipe, tmp_path_factory):
    """Four frames of plants that can be grown again; to be read, not changed."""
    folder, outputs = tmp_path_factory.mktemp("grown") / "set", ("colour", "class", "instance")
    return build(grown_recipe, folder, "0:4", outputs, BuildOptions(renderer=StandIn)).dataset


@pytest.fixture(scope="session")
def painted(tmp_path_factory):
    """Six painted frames, with organs in pieces and with holes; to be read, not changed."""
    return make_painted_set(tmp_path_factory.mktemp("painted") / "set")


@pytest.fixture(scope="session")
def traced(tmp_path_factory):
    """Makes data sets of known geometry by the name of a lens, each once; to be read, not changed."""
    made = {}

    def make(lens="pinhole"):
        if lens not in made:
            made[lens] = make_traced_set(tmp_path_factory.mktemp("traced") / lens, lens)
        return made[lens]

    return make


@pytest.fixture(scope="session")
def rendered(tmp_path_factory):
    """Three rendered frames of grown plants; to be read, not changed."""
    return make_rendered_set(tmp_path_factory.mktemp("rendered") / "set")


@pytest.fixture(scope="session")
def hub(tmp_path_factory):
    """Hugging Face's library `datasets`, without network and without the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("HF_HUB_OFFLINE", "HF_DATASETS_OFFLINE", "HF_HUB_DISABLE_TELEMETRY"):
            patch.setenv(name, "1")
        patch.setenv("HF_HOME", str(tmp_path_factory.mktemp("hub")))
        yield pytest.importorskip("datasets", reason="the extra `test` installs datasets")


@pytest.fixture(scope="module")
def labels(tmp_path_factory):
    """A painted data set for exports of labels; a module that damages it has its own."""
    return make_label_set(tmp_path_factory.mktemp("labels") / "set")


@pytest.fixture(scope="session")
def all_outputs(tmp_path_factory):
    """Folder of a correct data set with all outputs of a colour camera."""
    outputs = [name for name in OUTPUTS if name not in BAND_OUTPUTS]
    return make_disc_set(tmp_path_factory.mktemp("check") / "all", outputs)


@pytest.fixture(scope="session")
def default_outputs(tmp_path_factory):
    return make_disc_set(tmp_path_factory.mktemp("check") / "default", (*DEFAULT_OUTPUTS, "class_colour"))


@pytest.fixture
def folder(default_outputs, tmp_path):
    return shutil.copytree(default_outputs, tmp_path / "set")


@pytest.fixture
def full_folder(all_outputs, tmp_path):
    return shutil.copytree(all_outputs, tmp_path / "set")


@pytest.fixture
def copied(tmp_path):
    """Copies a data set, to be damaged at will."""

    def copy(dataset):
        shutil.copytree(dataset.folder, tmp_path / "set")
        return open_dataset(tmp_path / "set")

    return copy


@pytest.fixture
def started(monkeypatch):
    """The processes that are started."""
    processes, popen = [], subprocess.Popen

    def start(*args, **options):
        processes.append(popen(*args, **options))
        return processes[-1]

    monkeypatch.setattr(subprocess, "Popen", start)
    return processes
