"""Code of recipes: it runs only where the user allows it, and never by reading, planning or checking."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from stand_in import SceneStandIn

from pepperscene.building.execution.build import build
from pepperscene.building.execution.job import BuildJob, BuildOptions
from pepperscene.building.execution.single_frame import render_frame
from pepperscene.building.scenes.frame_renderer import FrameRenderer
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.errors import InputError
from pepperscene.recipe.resolve.load import resolve_recipe

SENTENCE = "runs only with --allow-code (in Python, allow_code=True)"
RECIPE = """
extends = "demo"
plan = { sets = 1, rotations = 1, frames = 2 }
cultivar = "kaite_february"
row = { plants_front = 1, plants_back = 0 }
[views]
kind = "function"
file = "views.py"
"""
POSES = """
import numpy as np
def poses(scene, rng):
    {first}
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, 2, 3] = -2
    poses[:, 0, 3] = rng.random(2)
    return poses
"""
MARK = "open({marker!r}, 'w').close()"
VARIANTS = {
    "function": lambda mark: POSES.format(first=mark),
    "module": lambda mark: mark + POSES.format(first="pass"),
    "decorator": lambda mark: f"def mark(f): {mark}; return f\n@mark" + POSES.format(first="pass").replace(
        "import numpy as np", ""
    ),
    "default value": lambda mark: POSES.format(first="pass").replace(
        "(scene, rng)", f"(scene, rng, trap={mark})"
    ),
    "exit": lambda mark: f"{mark}\nraise SystemExit(0)" + POSES.format(first="pass"),
}  # fmt: skip
OUTPUTS = ("--outputs", "class,distance")
COMMANDS = {
    "build": ("build", "mine.toml", "--out", "out", *OUTPUTS),
    "build with workers": ("build", "mine.toml", "--out", "out", "--workers", 2, *OUTPUTS),
    "dry run": ("build", "mine.toml", "--out", "out", "--dry-run", *OUTPUTS),
    "render": ("render", "mine.toml", "--out", "out", *OUTPUTS),
    "drawing": ("build", "mine.toml", "--dry-run", "--drawing", "plan.png", *OUTPUTS),
    "poses": ("build", "mine.toml", "--dry-run", "--poses", "poses.txt", *OUTPUTS),
    "visibility": ("visibility", "mine.toml", "--out", "table.parquet", "--samples", 64),
    "another recipe on it": ("render", "child.toml", "--out", "out", *OUTPUTS),
    "values of the command line": (
        "render", "demo", "--out", "out", *OUTPUTS, "--set", "plan.frames=2", "--set",
        'views={kind="function", file="views.py"}',
    ),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a recipe that has code; and the file that this code writes."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(RECIPE)
    (tmp_path / "child.toml").write_text('extends = "mine.toml"\nseed = 4\n')
    marker = tmp_path / "marker"
    (tmp_path / "views.py").write_text(VARIANTS["function"](MARK.format(marker=str(marker))))
    return tmp_path, marker


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_that_need_poses_refuse_code_in_one_sentence(folder, command, name):
    path, marker = folder
    before = sorted(path.iterdir())
    result = command(*COMMANDS[name])
    assert not marker.exists()
    assert result.exit_code == 2, result.output
    assert result.stderr.count("\n") == 1
    assert "views.kind = 'function': the code of " in result.stderr
    assert f"views.py {SENTENCE}" in result.stderr
    assert sorted(path.iterdir()) == before


@pytest.mark.parametrize("variant", VARIANTS)
def test_no_part_of_the_file_runs_unasked(folder, command, variant):
    path, marker = folder
    (path / "views.py").write_text(VARIANTS[variant](MARK.format(marker=str(marker))))
    assert command("build", "mine.toml", "--dry-run", "--no-probe", "--drawing", "plan.png").exit_code == 0
    assert command("build", "mine.toml", "--dry-run", *OUTPUTS).exit_code == 2
    assert command("render", "mine.toml", "--out", "out", *OUTPUTS).exit_code == 2
    assert not marker.exists()


def test_with_the_permission_the_code_runs_and_no_file_holds_the_permission(folder, command):
    path, marker = folder
    result = command("build", "mine.toml", "--out", "set", "--allow-code", *OUTPUTS)
    assert result.exit_code == 0, result.output
    assert marker.exists()
    poses = [open_dataset(path / "set").metadata(index)["camera"]["pose"] for index in (0, 1)]
    assert poses[0] != poses[1]
    assert command("build", "mine.toml", "--dry-run", "--allow-code", *OUTPUTS).exit_code == 0
    for file in (path / "set").rglob("*.json*"):
        assert "allow_code" not in file.read_text()
    free, bound = (resolve_recipe("mine.toml", allow_code=allowed) for allowed in (True, False))
    assert free.identity == bound.identity


def test_a_data_set_with_recorded_code_runs_none_of_it(folder, command):
    """Its `dataset.json` can name any file, here the one in the current folder."""
    path, marker = folder
    outputs = ("--outputs", "colour,class,instance,harvest,distance")
    assert command("build", "mine.toml", "--out", "set", "--allow-code", *outputs).exit_code == 0
    marker.unlink()
    record = json.loads((path / "set" / "dataset.json").read_bytes())
    record["recipe"]["views"]["file"] = "views.py"
    (path / "set" / "dataset.json").write_text(json.dumps(record))
    for arguments in (
        ("check", "set"), ("report", "set"), ("export", "set", "--format", "coco", "--out", "coco"),
        ("export", "set", "--format", "bop", "--out", "bop"), ("view", "set", "--program", "browser"),
    ):  # fmt: skip
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("webbrowser.open", lambda _: False)
            command(*arguments)
        assert not marker.exists(), arguments


def test_python_needs_the_permission_too(folder, monkeypatch):
    path, marker = folder
    for call in (
        lambda: build("mine.toml", "out", outputs=("class",)),
        lambda: render_frame("mine.toml", "out", outputs=("class",)),
        lambda: build(resolve_recipe("mine.toml"), "out", outputs=("class",)),
    ):
        with pytest.raises(InputError, match="allow_code=True"):
            call()
    renderer = FrameRenderer("mine.toml", SceneStandIn)
    with pytest.raises(InputError, match="allow_code=True"):
        renderer.camera(renderer.recipe.plan.frame(0))
    assert not marker.exists()
    assert not (path / "out").exists()
    renderer = FrameRenderer("mine.toml", SceneStandIn, allow_code=True)
    assert np.isfinite(renderer.camera(renderer.recipe.plan.frame(0)).pose).all()
    assert marker.exists()


@pytest.mark.parametrize("allowed", [False, True])
def test_workers_get_the_permission_of_their_build(folder, allowed):
    """A job is sent to processes, and to the workers of a cluster, as a pickle."""
    job = BuildJob.create("mine.toml", "out", ("class",), BuildOptions(allow_code=allowed))
    sent = pickle.loads(pickle.dumps(job, protocol=5))
    renderer = FrameRenderer(sent.recipe, SceneStandIn)
    spec = renderer.recipe.plan.frame(1)
    if allowed:
        assert renderer.camera(spec).pose.shape == (4, 4)
    else:
        with pytest.raises(InputError, match="allow_code=True"):
            renderer.camera(spec)
    assert folder[1].exists() is allowed
    # Once allowed, it stays so.
    assert resolve_recipe(sent.recipe, seed=3).allow_code is allowed
