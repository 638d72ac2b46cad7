"""What a build writes, keeps, repairs and refuses."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
import time

import numpy as np
import pytest
from set_files import contents

from pepperscene.dataset import open_dataset, read_image
from pepperscene.errors import InputError, OutputError, SetupError
from pepperscene.frame import DEFAULT_OUTPUTS, OUTPUTS

pytestmark = pytest.mark.usefixtures("empty_scenes")
STORE = sys.modules["pepperscene.dataset.store.dataset"]
ATOMIC = sys.modules["pepperscene.dataset.store.atomic"]


@pytest.fixture
def make(build_small, fake_renderer):
    def run(out="set", frames=None, outputs=DEFAULT_OUTPUTS, **arguments):
        arguments.setdefault("renderer", fake_renderer)
        return build_small(out, frames, outputs, **arguments)

    return run


def test_files_of_a_data_set(make, tmp_path):
    result = make(frames="5:7", outputs=tuple(OUTPUTS))
    assert result.made == (5, 6)
    names = {"dataset.json", "frames/000005.json", "frames/000006.json"}
    names |= {f"{o}/00000{i}{OUTPUTS[o].suffix}" for o in OUTPUTS for i in (5, 6)}
    assert set(contents(tmp_path / "set")) == names


def test_frame_json_describes_the_frame_and_its_files(make, recipe, tmp_path):
    make(frames="9:10")
    metadata = open_dataset(tmp_path / "set").metadata(9)
    assert (metadata["index"], metadata["set"], metadata["rotation"], metadata["step"]) == (9, 0, 2, 1)
    assert metadata["recipe_seed"] == recipe.seed
    assert sum(metadata["class_pixels"].values()) == 48
    assert metadata["camera"]["pose"][3] == [0, 0, 0, 1]
    assert metadata["instances"]["1"]["kind"] == "lamina"
    for output in DEFAULT_OUTPUTS:
        entry = metadata["outputs"][output]
        data = (tmp_path / "set" / entry["file"]).read_bytes()
        assert (entry["bytes"], entry["sha256"]) == (len(data), hashlib.sha256(data).hexdigest())


def test_dataset_json_holds_recipe_and_quality(make, recipe, tmp_path):
    make(frames="0:1", quality="draft", target_error=0.5)
    info = json.loads((tmp_path / "set" / "dataset.json").read_text())
    assert info["recipe"]["plan"] == {"sets": 2, "rotations": 3, "frames": 4}
    assert info["recipe_sha256"] == recipe.sha256()
    assert info["quality"] == "draft, target error 0.5"


def test_reports_progress_and_reads_images_back(make, tmp_path):
    frames = []
    result = make(frames="3:4", outputs=("colour", "distance"), on_frame=frames.append)
    assert (frames[0].index, frames[0].done, frames[0].total, frames[0].made) == (3, 1, 1, True)
    image = result.dataset.image(3, "distance")
    assert image.dtype == np.float32
    np.testing.assert_array_equal(image, read_image(tmp_path / "set" / "distance" / "000003.exr"))


def test_a_frames_bytes_do_not_depend_on_other_frames(make, tmp_path):
    make(out="whole")
    make(out="alone", frames=[17])
    make(out="again", frames="2:6")
    whole = contents(tmp_path / "whole")
    for part in (contents(tmp_path / "alone"), contents(tmp_path / "again")):
        assert len(whole) > len(part) > 5
        assert all(whole[name] == data for name, data in part.items())


def test_existing_frames_are_kept_and_missing_ones_made(make, fake_renderer, tmp_path):
    make(out="whole", frames="0:6")
    make(out="parts", frames="3:5")
    result = make(out="parts", frames="0:6")
    assert (result.made, result.kept) == ((0, 1, 2, 5), (3, 4))
    fake_renderer.created.clear()
    again = make(out="parts", frames="0:6")
    assert (again.made, again.kept) == ((), tuple(range(6)))
    assert not fake_renderer.created
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")


@pytest.mark.parametrize("order", [("colour", "class"), ("class", "colour"), ("distance", "colour", "class")])
def test_outputs_added_later_give_the_same_files(make, tmp_path, fake_renderer, order):
    make(out="whole", frames="1:3", outputs=order)
    for output in order:
        fake_renderer.created.clear()
        make(out="parts", frames="1:3", outputs=(output,))
        # Only what is missing is rendered.
        assert {view[1] for one in fake_renderer.created for view in one.views} == {(output,)}
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")


def test_missing_and_damaged_files_are_made_again(make, tmp_path):
    make(frames="0:2")
    before = contents(tmp_path / "set")
    (tmp_path / "set" / "class" / "000000.png").unlink()
    (tmp_path / "set" / "distance" / "000001.exr").write_bytes(b"short")
    assert make(frames="0:2").made == (0, 1)
    assert contents(tmp_path / "set") == before
    (tmp_path / "set" / "frames" / "000001.json").write_text("{")
    assert make(frames="0:2").made == (1,)
    assert contents(tmp_path / "set") == before


# --- failures -----------------------------------------------------------------------------------------------


def _fail_after(monkeypatch, count):
    """The disk is full after `count` images."""
    write, written = STORE.write_file, []

    def full(path, content):
        written.append(path)
        if len(written) > count:
            with ATOMIC.atomic_write(path) as temporary:
                temporary.write_bytes(b"half")
                raise OSError(28, "No space left on device", str(path))
        write(path, content)

    monkeypatch.setattr(STORE, "write_file", full)


@pytest.mark.parametrize("fail_at", range(len(DEFAULT_OUTPUTS)))
def test_a_failure_between_files_leaves_nothing_of_the_frame(make, tmp_path, monkeypatch, fail_at):
    make(frames="0:1")
    before = contents(tmp_path / "set")
    _fail_after(monkeypatch, fail_at)
    with pytest.raises(OutputError, match="No space left"):
        make(frames="0:3")
    assert contents(tmp_path / "set") == before


def test_a_failure_in_the_first_frame_leaves_nothing(make, tmp_path, monkeypatch):
    _fail_after(monkeypatch, 2)
    with pytest.raises(OutputError):
        make(out="a/b/set", frames="0:3")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_rename_of_frame_json_leaves_nothing_of_the_frame(make, tmp_path, monkeypatch):
    make(frames="0:1")
    before = contents(tmp_path / "set")
    replace = os.replace

    def refuse(source, target):
        if str(target).endswith("000001.json"):
            raise OSError(5, "Input/output error", str(target))
        replace(source, target)

    monkeypatch.setattr(ATOMIC.os, "replace", refuse)
    with pytest.raises(OutputError, match=r"000001\.json.*Input/output error"):
        make(frames="0:2")
    assert contents(tmp_path / "set") == before


def test_an_interrupt_keeps_complete_frames_only(make, tmp_path):
    def stop(progress):
        if progress.index == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(frames="0:4", on_frame=stop)
    assert open_dataset(tmp_path / "set").indices() == (0, 1)
    assert not [name for name in contents(tmp_path / "set") if name.endswith(".tmp")]


def test_a_machine_that_cannot_render_leaves_nothing(make, tmp_path):
    def unable(_scene):
        raise SetupError("no variant")

    with pytest.raises(SetupError):
        make(frames="0:1", renderer=unable)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        {"outputs": ("colour", "smell")},
        {"outputs": ()},
        {"frames": "5:2"},
        {"frames": [24]},
        {"quality": "best"},
        {"seed": -1},
        {"recipe": "nothing"},
        {"workers": 2, "slurm": "jobs.toml"},
    ],
)
def test_wrong_arguments_are_refused_before_anything_is_written(make, tmp_path, arguments):
    with pytest.raises(InputError):
        make(**arguments)
    assert list(tmp_path.iterdir()) == []


def test_another_recipe_is_refused_with_the_keys_that_differ(make, recipe, tmp_path):
    make(frames="0:1")
    before = contents(tmp_path / "set")
    other = recipe.model_copy(update={"row": recipe.row.model_copy(update={"gap_mm": 250.0})})
    with pytest.raises(OutputError, match=r"recipe\.row\.gap_mm is 200\.0 there and 250\.0 here"):
        make(recipe=other, frames="0:1")
    with pytest.raises(OutputError, match=r"recipe\.seed is 2018 there and 7 here"):
        make(seed=7, frames="0:1")
    with pytest.raises(OutputError, match="quality is 'standard' there and 'draft' here"):
        make(quality="draft", frames="0:1")
    assert contents(tmp_path / "set") == before


def test_another_version_or_cultivar_file_is_refused(make, tmp_path):
    make(frames="0:1")
    mark = tmp_path / "set" / "dataset.json"
    info = json.loads(mark.read_text())
    mark.write_text(json.dumps(info | {"version": "0.0.1"}))
    with pytest.raises(OutputError, match=r"version is '0\.0\.1' there"):
        make(frames="0:1")
    info["files"]["cultivar"]["sha256"] = "0" * 64
    mark.write_text(json.dumps(info))
    with pytest.raises(OutputError, match=r"files\.cultivar\.sha256"):
        make(frames="0:1")
    mark.write_text("{")
    with pytest.raises(OutputError, match="not valid JSON"):
        make(frames="0:1")


@pytest.mark.parametrize("foreign", ["notes.txt", "src/main.c"])
def test_a_folder_with_foreign_files_is_refused(make, tmp_path, foreign):
    path = tmp_path / "set" / foreign
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    with pytest.raises(OutputError, match=foreign.split("/")[0]):
        make(frames="0:1")
    assert contents(tmp_path / "set") == {foreign: b"mine"}
    make(out="ours", frames="0:1")
    (tmp_path / "ours" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt"):
        make(out="ours", frames="0:1")


def test_an_empty_folder_with_files_of_a_file_manager_is_accepted(make, tmp_path):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / ".DS_Store").write_text("")
    assert make(frames="0:1").made == (0,)


def test_impossible_folders_are_refused(make, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("mine")
    for out, message in (
        ("file", "is not a folder"),
        ("file/below", "is not a folder"),
        ("x" * 5000, "cannot be used"),
        ("a\0b", "not a valid folder name"),
    ):
        with pytest.raises(OutputError, match=message):
            make(out=out, frames="0:1")
    # The tests may run as a user who may write everywhere.
    monkeypatch.setattr(os, "access", lambda *_args, **_kwargs: False)
    with pytest.raises(OutputError, match="not writable"):
        make(frames="0:1")
    assert contents(tmp_path) == {"file": b"mine"}


def test_temporary_files_of_killed_builds_are_removed(make, tmp_path):
    make(frames="0:1")
    old, young = (tmp_path / "set" / "colour" / f".00000{k}.png.1.tmp" for k in (1, 2))
    for path in (old, young):
        path.write_bytes(b"half")
    os.utime(old, (time.time() - 7200,) * 2)
    make(frames="1:2")
    # A young one may belong to a build that runs at the same time.
    assert not old.exists()
    assert young.exists()


@pytest.mark.parametrize("free", [0, 10**15])
def test_warns_after_the_first_frame_if_the_disk_is_too_small(make, monkeypatch, free):
    notices, frames = [], []
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=free))
    result = make(
        frames="0:3", on_frame=frames.append, on_notice=lambda text: notices.append((len(frames), text))
    )
    assert result.made == (0, 1, 2)
    assert len(notices) == (1 if free == 0 else 0)
    for before, text in notices:
        assert before == 0
        assert "GB are free" in text
