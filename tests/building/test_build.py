"""What a build writes, keeps and repairs, how it reports progress, and what it rejects."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from data_sets import contents

from pepperscene.building.execution.build import Throughput
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.dataset.store.frame_json import checksum_of
from pepperscene.dataset.store.images import read_image
from pepperscene.errors import InputError, OutputError, SetupError
from pepperscene.outputs import BAND_OUTPUTS, DEFAULT_OUTPUTS, DEPTH_CAMERA_OUTPUTS, OUTPUTS
from pepperscene.review.check import check_dataset

pytestmark = pytest.mark.usefixtures("empty_scenes")


@pytest.fixture
def make(build_small, fake_renderer):
    def run(out="set", frames=None, outputs=DEFAULT_OUTPUTS, **arguments):
        arguments.setdefault("renderer", fake_renderer)
        return build_small(out, frames, outputs, **arguments)

    return run


def test_data_set_has_one_file_per_frame_and_output(make, tmp_path):
    # The recipe has no depth camera and no bands.
    outputs = [name for name in OUTPUTS if name not in DEPTH_CAMERA_OUTPUTS | BAND_OUTPUTS]
    result = make(frames="5:7", outputs=outputs)
    assert result.made == (5, 6)
    names = {"dataset.json", "frames/000005.json", "frames/000006.json"}
    names |= {f"{name}/00000{index}{OUTPUTS[name].suffix}" for name in outputs for index in (5, 6)}
    assert set(contents(tmp_path / "set")) == names
    image = result.dataset.image(5, "distance")
    np.testing.assert_array_equal(image, read_image(tmp_path / "set" / "distance" / "000005.exr"))


def test_frame_json_describes_the_frame_and_its_files(make, recipe, tmp_path):
    make(frames="9:10", quality="draft", target_error=0.5)
    info = json.loads((tmp_path / "set" / "dataset.json").read_text())
    assert info["recipe"]["plan"] == {"sets": 2, "rotations": 3, "frames": 4}
    assert info["recipe_sha256"] == recipe.sha256()
    assert info["quality"] == "draft, target error 0.5"
    metadata = open_dataset(tmp_path / "set").metadata(9)
    assert [metadata[key] for key in ("index", "set", "rotation", "step")] == [9, 0, 2, 1]
    assert metadata["recipe_seed"] == recipe.seed
    assert sum(metadata["class_pixels"].values()) == 48
    assert metadata["camera"]["pose"][3] == [0, 0, 0, 1]
    assert metadata["instances"]["1"]["kind"] == "lamina"
    for output in DEFAULT_OUTPUTS:
        entry = metadata["outputs"][output]
        data = (tmp_path / "set" / entry["file"]).read_bytes()
        assert (entry["bytes"], entry["sha256"]) == (len(data), hashlib.sha256(data).hexdigest())


def test_existing_frames_are_kept_and_missing_ones_made(make, fake_renderer, tmp_path):
    reports = []
    make(out="once", frames="0:6")
    make(out="parts", frames="3:5")
    result = make(out="parts", frames="0:6", on_frame=reports.append)
    assert [(one.index, one.made) for one in reports] == [(i, i not in (3, 4)) for i in range(6)]
    assert [(one.done, one.total) for one in reports] == [(i + 1, 6) for i in range(6)]
    assert (result.made, result.kept) == ((0, 1, 2, 5), (3, 4))
    fake_renderer.created.clear()
    result = make(out="parts", frames="0:6")
    assert (result.made, result.kept) == ((), tuple(range(6)))
    assert not fake_renderer.created
    assert contents(tmp_path / "parts") == contents(tmp_path / "once")


@pytest.mark.parametrize("order", [("class", "colour"), ("distance", "colour", "class")])
def test_outputs_added_later_give_the_same_files(make, tmp_path, fake_renderer, order):
    make(out="once", frames="1:3", outputs=order)
    for output in order:
        fake_renderer.created.clear()
        make(out="parts", frames="1:3", outputs=(output,))
        # Only what is missing is rendered.
        assert {call.outputs for one in fake_renderer.created for call in one.calls} == {(output,)}
    assert contents(tmp_path / "parts") == contents(tmp_path / "once")


def change_checksum(path):
    metadata = json.loads(path.read_text())
    path.write_text(json.dumps({**metadata, "checksum": "0" * 64}))


@pytest.mark.parametrize(
    ("name", "damage", "finding"),
    [
        ("class/000001.png", lambda path: path.unlink(), "missing"),
        ("distance/000001.exr", lambda path: path.write_bytes(b"short"), "checksum"),
        ("frames/000001.json", lambda path: path.write_text("{"), "damaged"),
        ("frames/000001.json", change_checksum, "damaged"),
    ],
)
def test_damaged_frame_is_found_by_check_and_made_again(make, tmp_path, name, damage, finding):
    make(frames="0:2")
    before = contents(tmp_path / "set")
    damage(tmp_path / "set" / name)
    findings = check_dataset(tmp_path / "set", workers=1).findings
    assert (finding, 1, name) in {(one.kind, one.index, one.file) for one in findings}
    result = make(frames="0:2")
    assert (result.made, result.kept) == ((1,), (0,))
    assert contents(tmp_path / "set") == before


def test_temporary_files_of_killed_builds_are_removed(make, tmp_path):
    make(frames="0:1")
    old, recent = (tmp_path / "set" / "colour" / f".00000{k}.png.1.tmp" for k in (1, 2))
    for path in (old, recent):
        path.write_bytes(b"half")
    os.utime(old, (time.time() - 7200,) * 2)
    make(frames="1:2")
    # A recent one may belong to a build that runs at the same time.
    assert not old.exists()
    assert recent.exists()


def test_interrupt_keeps_only_complete_frames(make, tmp_path):
    def stop(progress):
        if progress.index == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(frames="0:4", on_frame=stop)
    dataset = open_dataset(tmp_path / "set")
    assert dataset.indices() == (0, 1)
    assert all(set(dataset.intact(index).outputs) == set(DEFAULT_OUTPUTS) for index in (0, 1))
    assert not [name for name in contents(tmp_path / "set") if name.endswith(".tmp")]


def test_renderer_that_cannot_start_leaves_nothing(make, tmp_path):
    def fail(_scene):
        raise SetupError("no variant")

    with pytest.raises(SetupError):
        make(frames="0:1", renderer=fail)
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
        {"workers": 2, "scheduler": "tcp://127.0.0.1:1"},
    ],
)
def test_rejects_invalid_arguments_before_writing(make, tmp_path, arguments):
    with pytest.raises(InputError):
        make(**arguments)
    assert list(tmp_path.iterdir()) == []


def test_rejects_folder_of_another_data_set(make, recipe, tmp_path):
    make(frames="0:1")
    before = contents(tmp_path / "set")
    other = recipe.model_copy(update={"row": replace(recipe.row, gap_m=0.25)})
    for arguments, message in (
        ({"recipe": other}, r"recipe\.row\.gap_mm is 200\.0 there and 250\.0 here"),
        ({"seed": 7}, r"recipe\.seed is 2018 there and 7 here"),
        ({"quality": "draft"}, "quality is 'standard' there and 'draft' here"),
    ):
        with pytest.raises(OutputError, match=message):
            make(frames="0:1", **arguments)
    assert contents(tmp_path / "set") == before
    path = tmp_path / "set" / "dataset.json"
    info = json.loads(path.read_text())
    cultivar = {**info["files"], "cultivar": {**info["files"]["cultivar"], "sha256": "0" * 64}}
    for content, message in (
        (info | {"version": "0.0.1"}, r"version is '0\.0\.1' there"),
        (info | {"files": cultivar}, r"files\.cultivar\.sha256"),
        (None, "not valid JSON"),
    ):
        path.write_text("{" if content is None else json.dumps(content | {"checksum": checksum_of(content)}))
        with pytest.raises(OutputError, match=message):
            make(frames="0:1")


@pytest.mark.parametrize("name", ["notes.txt", "src/main.c"])
def test_rejects_folder_with_other_files(make, tmp_path, name):
    path = tmp_path / "set" / name
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    with pytest.raises(OutputError, match=name.split("/")[0]):
        make(frames="0:1")
    assert contents(tmp_path / "set") == {name: b"mine"}
    make(out="built", frames="0:1")
    (tmp_path / "built" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt"):
        make(out="built", frames="0:1")
    # Files of a file manager do not count.
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / ".DS_Store").write_text("")
    assert make(out="empty", frames="0:1").made == (0,)


def test_rejects_folders_that_cannot_be_used(make, tmp_path, monkeypatch):
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
    for frames_before, text in notices:
        assert frames_before == 0
        assert "GB are free" in text


@pytest.fixture
def clock():
    return SimpleNamespace(now=100.0)


def test_throughput_ignores_existing_frames(clock):
    throughput = Throughput(100, lambda: clock.now)
    for _ in range(50):
        clock.now += 0.01
        throughput.count(False)
    assert throughput.left_s is None
    clock.now += 2.0
    throughput.count(True)
    assert throughput.frames_per_s == pytest.approx(0.5)
    assert throughput.left_s == pytest.approx(49 / 0.5)


@pytest.mark.parametrize(("slow", "fast", "fast_s"), [(50, 3000, 0.1), (13, 100, 2.0)])
def test_throughput_follows_recent_frames(clock, slow, fast, fast_s):
    throughput = Throughput(10_000, lambda: clock.now)
    for step_s in [10.0] * slow + [fast_s] * fast:
        clock.now += step_s
        throughput.count(True)
    assert throughput.frames_per_s == pytest.approx(1 / fast_s)
