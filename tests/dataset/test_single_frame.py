"""A single frame in a folder: the bytes of a build, all files or none."""

from __future__ import annotations

import json
import os
import sys

import numpy as np
import pytest

from pepperscene.dataset import BuildOptions, read_image, render_frame
from pepperscene.errors import InputError, OutputError, SetupError
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS

pytestmark = pytest.mark.usefixtures("empty_scenes")
ATOMIC = sys.modules["pepperscene.dataset.store.atomic"]


def contents(folder):
    """Bytes of every file below a folder by relative path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def take(recipe, fake_renderer, tmp_path):
    def run(index=5, out="one", outputs=DEFAULT_OUTPUTS, recipe=recipe, **options):
        options.setdefault("renderer", fake_renderer)
        return render_frame(recipe, tmp_path / out, index, outputs, BuildOptions(**options))

    return run


def test_returns_all_files_in_the_order_of_outputs(take, tmp_path):
    paths = take(outputs=("distance", "raw", "electrons", "colour"))
    names = ["colour.png", "raw.png", "electrons.exr", "distance.exr", "frame.json"]
    assert [path.name for path in paths] == names
    assert {path.parent for path in paths} == {tmp_path / "one"}
    assert set(contents(tmp_path / "one")) == set(names)
    assert [read_image(path).dtype for path in paths[1:3]] == [np.uint16, np.float32]


def test_bytes_are_those_of_a_build(take, build_small, fake_renderer, tmp_path):
    take(outputs=tuple(OUTPUTS))
    data = build_small("set", [5], tuple(OUTPUTS), renderer=fake_renderer).dataset
    for name, output in OUTPUTS.items():
        single = (tmp_path / "one" / f"{name}{output.suffix}").read_bytes()
        assert single == (tmp_path / "set" / name / f"000005{output.suffix}").read_bytes(), name
    metadata, built = json.loads((tmp_path / "one" / "frame.json").read_text()), data.metadata(5)
    for name, entry in metadata.pop("outputs").items():
        assert entry == built["outputs"][name] | {"file": f"{name}{OUTPUTS[name].suffix}"}
    del built["outputs"], built["checksum"]
    # What a frame shares with its data set is in `dataset.json`.
    assert metadata == {**data.info, **built, "format": "pepperscene frame 1"}


def test_default_is_the_first_selected_frame(take, recipe, tmp_path):
    plan = recipe.plan.model_copy(update={"select": (9, 4)})
    take(index=None, recipe=recipe.model_copy(update={"plan": plan}))
    assert json.loads((tmp_path / "one" / "frame.json").read_text())["index"] == 4
    take(index=None)
    assert json.loads((tmp_path / "one" / "frame.json").read_text())["index"] == 0


def test_replaces_its_own_images_and_keeps_other_files(take, tmp_path):
    folder = tmp_path / "one"
    take(index=5, outputs=("colour", "class", "normal"))
    (folder / "notes.txt").write_text("mine")
    # An image that was changed belongs to the user.
    (folder / "normal.exr").write_bytes(b"painted")
    take(index=6, outputs=("colour", "distance"))
    assert set(contents(folder)) == {"colour.png", "distance.exr", "frame.json", "normal.exr", "notes.txt"}
    for path in take(index=6, out="fresh", outputs=("colour", "distance")):
        assert (folder / path.name).read_bytes() == path.read_bytes()


def test_a_foreign_frame_json_removes_nothing(take, tmp_path):
    folder = tmp_path / "one"
    folder.mkdir()
    (folder / "class.png").write_text("mine")
    for text in ("{", "[]", '{"outputs": 3}', '{"outputs": {"class": {}}}', '{"outputs": {"class": 1}}'):
        (folder / "frame.json").write_text(text)
        take(outputs=("colour",))
        assert (folder / "class.png").read_text() == "mine"


def test_impossible_folders_are_refused_before_rendering(take, build_small, fake_renderer, tmp_path):
    build_small("set", [5], renderer=fake_renderer)
    (tmp_path / "one" / "class.png").mkdir(parents=True)
    (tmp_path / "file").write_text("mine")
    before, created = contents(tmp_path), len(fake_renderer.created)
    for out, message in (
        ("set", "data set"),
        ("set/colour", "data set"),
        ("one", r"class\.png"),
        ("file", "not a folder"),
        ("a\0b", "not a valid folder name"),
    ):
        with pytest.raises(OutputError, match=message):
            take(out=out)
    assert len(fake_renderer.created) == created
    assert contents(tmp_path) == before


@pytest.mark.parametrize("exists", [False, True])
@pytest.mark.parametrize("fail_at", range(1 + len(DEFAULT_OUTPUTS)))
def test_a_full_disk_leaves_everything_as_it_was(take, tmp_path, monkeypatch, fail_at, exists):
    if exists:
        take(index=4, out="a/one", outputs=("class", "normal"))
    before, fsync, flushed = contents(tmp_path), os.fsync, []

    def full(file):
        flushed.append(file)
        if len(flushed) > fail_at:
            raise OSError(28, "No space left on device")
        fsync(file)

    monkeypatch.setattr(ATOMIC.os, "fsync", full)
    with pytest.raises(OutputError, match="No space left"):
        take(out="a/one")
    assert contents(tmp_path) == before
    assert exists or list(tmp_path.iterdir()) == []


def test_a_failed_rename_leaves_no_frame(take, tmp_path, monkeypatch):
    take(index=4)
    replace = os.replace

    def refuse(source, target):
        if str(target).endswith("class.png"):
            raise OSError(5, "Input/output error", str(target))
        replace(source, target)

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OutputError, match=r"class\.png.*Input/output error"):
        take(index=5)
    assert contents(tmp_path / "one") == {}


@pytest.mark.parametrize(
    "arguments",
    [
        {"outputs": ("smell",)},
        {"outputs": ()},
        {"index": 24},
        {"index": -1},
        {"quality": "best"},
        {"seed": -1},
        {"recipe": "nothing"},
        {"workers": 2},
    ],
)
def test_wrong_arguments_are_refused_before_anything_is_written(take, tmp_path, arguments):
    with pytest.raises(InputError):
        take(**arguments)
    assert list(tmp_path.iterdir()) == []


def test_a_machine_that_cannot_render_leaves_nothing(take, tmp_path):
    def unable(_scene):
        raise SetupError("no variant")

    with pytest.raises(SetupError):
        take(out="a/one", renderer=unable)
    assert list(tmp_path.iterdir()) == []
