"""A single frame in a folder: the bytes of a build, all files or none."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from data_sets import contents

from pepperscene.building.execution.job import BuildOptions
from pepperscene.building.execution.single_frame import render_frame
from pepperscene.dataset.store.images import read_image
from pepperscene.errors import InputError, OutputError
from pepperscene.outputs import BAND_OUTPUTS, DEFAULT_OUTPUTS, OUTPUTS
from pepperscene.recipe.resolve.load import load_recipe

pytestmark = pytest.mark.usefixtures("empty_scenes")


@pytest.fixture
def render(recipe, fake_renderer, tmp_path):
    def run(index=5, out="one", outputs=DEFAULT_OUTPUTS, recipe=recipe, **options):
        options.setdefault("renderer", fake_renderer)
        return render_frame(recipe, tmp_path / out, index, outputs, BuildOptions(**options))

    return run


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "one"


def test_returns_all_files_in_the_order_of_outputs(render, folder):
    paths = render(outputs=("distance", "raw", "electrons", "colour"))
    names = ["colour.png", "raw.png", "electrons.exr", "distance.exr", "frame.json"]
    assert paths == tuple(folder / name for name in names)
    assert set(contents(folder)) == set(names)
    assert [read_image(path).dtype for path in paths[1:3]] == [np.uint16, np.float32]


def test_bytes_are_those_of_a_build(render, recipe, build_small, fake_renderer, tmp_path, folder):
    recipe = recipe.model_copy(update={"depth_camera": load_recipe("realsense_depth").depth_camera})
    outputs = {name: output for name, output in OUTPUTS.items() if name not in BAND_OUTPUTS}
    render(outputs=tuple(outputs), recipe=recipe)
    dataset = build_small("set", [5], tuple(outputs), recipe=recipe, renderer=fake_renderer).dataset
    for name, output in outputs.items():
        content = (folder / f"{name}{output.suffix}").read_bytes()
        assert content == (tmp_path / "set" / name / f"000005{output.suffix}").read_bytes(), name
    metadata, expected = json.loads((folder / "frame.json").read_text()), dataset.metadata(5)
    for name, entry in metadata.pop("outputs").items():
        assert entry == expected["outputs"][name] | {"file": f"{name}{OUTPUTS[name].suffix}"}
    del expected["outputs"], expected["checksum"]
    # What a frame shares with its data set is in `dataset.json`.
    info = {key: value for key, value in dataset.info.items() if key != "checksum"}
    assert metadata == {**info, **expected, "format": "pepperscene frame 1"}


@pytest.mark.parametrize(("select", "expected"), [((9, 4), 4), (None, 0)])
def test_default_is_the_first_selected_frame(render, recipe, folder, select, expected):
    plan = recipe.plan.model_copy(update={"select": select})
    render(index=None, recipe=recipe.model_copy(update={"plan": plan}))
    assert json.loads((folder / "frame.json").read_text())["index"] == expected


def test_replaces_its_own_images_and_keeps_other_files(render, folder):
    render(index=5, outputs=("colour", "class", "normal"))
    (folder / "notes.txt").write_text("mine")
    # An image that was changed belongs to the user.
    (folder / "normal.exr").write_bytes(b"painted")
    render(index=6, outputs=("colour", "distance"))
    assert set(contents(folder)) == {"colour.png", "distance.exr", "frame.json", "normal.exr", "notes.txt"}
    for path in render(index=6, out="fresh", outputs=("colour", "distance")):
        assert (folder / path.name).read_bytes() == path.read_bytes()


def test_frame_json_of_another_program_removes_nothing(render, folder):
    folder.mkdir()
    (folder / "class.png").write_text("mine")
    for text in ("{", "[]", '{"outputs": 3}', '{"outputs": {"class": {}}}'):
        (folder / "frame.json").write_text(text)
        render(outputs=("colour",))
        assert (folder / "class.png").read_text() == "mine"


def test_rejects_folders_that_cannot_be_used_before_rendering(
    render, build_small, fake_renderer, tmp_path, folder
):
    build_small("set", [5], renderer=fake_renderer)
    (folder / "class.png").mkdir(parents=True)
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
            render(out=out)
    assert len(fake_renderer.created) == created
    assert contents(tmp_path) == before


@pytest.mark.parametrize("exists", [False, True])
@pytest.mark.parametrize("fail_at", [0, 1, len(DEFAULT_OUTPUTS)])
def test_full_disk_changes_nothing(render, tmp_path, monkeypatch, fail_at, exists):
    if exists:
        render(index=4, out="a/one", outputs=("class", "normal"))
    before, fsync, flushed = contents(tmp_path), os.fsync, []

    def fail(file):
        flushed.append(file)
        if len(flushed) > fail_at:
            raise OSError(28, "No space left on device")
        fsync(file)

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OutputError, match="No space left"):
        render(out="a/one")
    assert contents(tmp_path) == before
    assert exists or list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        {"outputs": ("smell",)}, {"outputs": ()}, {"index": 24}, {"index": -1}, {"seed": -1}, {"workers": 2},
    ],
)  # fmt: skip
def test_rejects_invalid_arguments_before_writing(render, tmp_path, arguments):
    with pytest.raises(InputError):
        render(**arguments)
    assert list(tmp_path.iterdir()) == []
