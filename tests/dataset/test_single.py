from __future__ import annotations

import json
import os
import sys

import numpy as np
import pytest

from pepperscene.dataset import build, read_image, render_frame
from pepperscene.errors import InputError, OutputError, SetupError
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS

pytestmark = pytest.mark.usefixtures("empty_scenes")
STORE = sys.modules["pepperscene.dataset.store.dataset"]


def contents(folder):
    """Bytes of every file below a folder by relative path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def take(recipe, fake_renderer, tmp_path):
    def run(index=5, out="one", **arguments):
        arguments.setdefault("recipe", recipe)
        return render_frame(out=tmp_path / out, index=index, renderer=fake_renderer, **arguments)

    return run


def test_the_files_lie_flat_and_are_told(take, tmp_path):
    paths = take(outputs=("distance", "raw", "colour"))
    assert [path.name for path in paths] == ["colour.png", "raw.png", "distance.exr", "frame.json"]
    assert {path.parent for path in paths} == {tmp_path / "one"}
    assert set(contents(tmp_path / "one")) == {path.name for path in paths}


def test_a_frame_has_the_bytes_that_a_build_gives_it(take, recipe, fake_renderer, tmp_path):
    take(outputs=tuple(OUTPUTS))
    data = build(recipe, tmp_path / "set", [5], tuple(OUTPUTS), renderer=fake_renderer).dataset
    for name, output in OUTPUTS.items():
        single = (tmp_path / "one" / f"{name}{output.suffix}").read_bytes()
        assert single == (tmp_path / "set" / name / f"000005{output.suffix}").read_bytes(), name
    told, built = json.loads((tmp_path / "one" / "frame.json").read_text()), data.metadata(5)
    for name, entry in told.pop("outputs").items():
        assert entry == built["outputs"][name] | {"file": f"{name}{OUTPUTS[name].suffix}"}
    del built["outputs"], built["checksum"]
    # What it shares with its data set stands there in `dataset.json`.
    assert told == {**data.info, **built, "format": "pepperscene frame 1"}


def test_without_an_index_it_is_the_first_selected_one(take, recipe, tmp_path):
    plan = recipe.plan.model_copy(update={"select": (9, 4)})
    take(index=None, recipe=recipe.model_copy(update={"plan": plan}))
    assert json.loads((tmp_path / "one" / "frame.json").read_text())["index"] == 4
    take(index=None)
    assert json.loads((tmp_path / "one" / "frame.json").read_text())["index"] == 0


def test_the_folder_shows_what_the_last_call_made_and_keeps_what_others_put_there(take, tmp_path):
    folder = tmp_path / "one"
    take(index=5, outputs=("colour", "class", "normal"))
    (folder / "notes.txt").write_text("mine")
    # An image that was painted over is nobody's but the painter's.
    (folder / "normal.exr").write_bytes(b"painted")
    take(index=6, outputs=("colour", "distance"))
    assert set(contents(folder)) == {"colour.png", "distance.exr", "frame.json", "normal.exr", "notes.txt"}
    fresh = take(index=6, out="fresh", outputs=("colour", "distance"))
    for path in fresh:
        assert (folder / path.name).read_bytes() == path.read_bytes()


def test_frame_json_of_others_does_no_harm(take, tmp_path):
    folder = tmp_path / "one"
    folder.mkdir()
    (folder / "class.png").write_text("mine")
    for text in ("{", "[]", '{"outputs": 3}', '{"outputs": {"class": {}}}', '{"outputs": {"class": 1}}'):
        (folder / "frame.json").write_text(text)
        take(outputs=("colour",))
        assert (folder / "class.png").read_text() == "mine"


@pytest.mark.parametrize("below", [".", "colour"])
def test_a_folder_of_a_data_set_is_refused(take, recipe, fake_renderer, tmp_path, below):
    build(recipe, tmp_path / "set", [5], renderer=fake_renderer)
    before, made = contents(tmp_path), len(fake_renderer.made)
    with pytest.raises(OutputError, match="data set"):
        take(out=f"set/{below}")
    assert contents(tmp_path) == before
    # It is told before the light is traced.
    assert len(fake_renderer.made) == made


def test_a_folder_or_file_in_the_way_is_refused_before_the_light_is_traced(take, tmp_path, fake_renderer):
    (tmp_path / "one" / "class.png").mkdir(parents=True)
    (tmp_path / "file").write_text("mine")
    for out, told in (("one", r"class\.png"), ("file", "not a folder"), ("a\0b", "possible name")):
        with pytest.raises(OutputError, match=told):
            take(out=out)
    assert not fake_renderer.made
    assert contents(tmp_path) == {"file": b"mine"}


@pytest.mark.parametrize("there", [False, True])
@pytest.mark.parametrize("fail_at", range(len(DEFAULT_OUTPUTS)))
def test_a_full_disk_leaves_all_as_it_was(take, tmp_path, monkeypatch, fail_at, there):
    if there:
        take(index=4, out="a/one", outputs=("class", "normal"))
    before, write, written = contents(tmp_path), STORE.write_image, []

    def full(path, image, output):
        written.append(path)
        if len(written) > fail_at:
            path.write_bytes(b"half")
            raise OSError(28, "No space left on device", str(path))
        write(path, image, output)

    monkeypatch.setattr(STORE, "write_image", full)
    with pytest.raises(OutputError, match="No space left"):
        take(out="a/one")
    assert contents(tmp_path) == before
    assert there or list(tmp_path.iterdir()) == []


def test_a_fault_between_renames_leaves_no_frame_json(take, tmp_path, monkeypatch):
    take(index=4)
    replace = os.replace

    def refuse(source, target):
        if str(target).endswith("class.png"):
            raise OSError(5, "Input/output error", str(target))
        replace(source, target)

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OutputError, match=r"class\.png.*Input/output error"):
        take(index=5)
    names = set(contents(tmp_path / "one"))
    assert "frame.json" not in names
    assert not [name for name in names if name.endswith(".tmp")]


def test_images_come_back(take, tmp_path):
    paths = take(outputs=("raw", "electrons"))
    assert [read_image(path).dtype for path in paths[:-1]] == [np.uint16, np.float32]


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
    ],
)
def test_wrong_arguments_are_refused_before_anything_is_written(take, tmp_path, arguments):
    with pytest.raises(InputError):
        take(**arguments)
    assert list(tmp_path.iterdir()) == []


def test_a_machine_that_cannot_render_leaves_nothing(recipe, tmp_path):
    def unable(_scene):
        raise SetupError("no variant")

    with pytest.raises(SetupError):
        render_frame(recipe, tmp_path / "a" / "one", 0, renderer=unable)
    assert list(tmp_path.iterdir()) == []
