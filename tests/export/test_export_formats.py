"""What all formats share: the folder is complete or missing, bytes are reproducible, errors come early."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tracemalloc
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest
from data_sets import contents

from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.errors import ArgumentError, InputError, OutputError, SetupError
from pepperscene.export import FORMATS, export_dataset, run
from pepperscene.export.run import new_folder
from pepperscene.recipe.resolve.load import resolve_recipe

LEFT_OUT = {"bop", "envi", "npy"} | (set() if find_spec("rerun") else {"rerun"})
PAINTED = [name for name in FORMATS if name not in LEFT_OUT]
"""Formats that painted sets can have; `bop` needs plants, two need bands, and `rerun` a large package."""
READ = {name: {output for outputs in FORMATS[name].required for output in outputs} for name in PAINTED}
READ["webdataset"] |= {"instance"}
READ["huggingface"] |= {"instance"}
"""The outputs that a format reads, where the data set has them."""


def test_the_page_lists_every_format():
    page = Path("docs/how-to/export.md").read_text(encoding="utf-8")
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| [`")]
    listed = {row[0].split("`")[1]: row[1:3] for row in rows}
    expected = {}
    for name, one in FORMATS.items():
        outputs = ", ".join(" or ".join(f"`{output}`" for output in outputs) for outputs in one.required)
        expected[name] = [one.description, "; ".join(part for part in (outputs, one.also) if part)]
    assert listed == expected
    assert list(listed) == list(FORMATS)


@pytest.mark.parametrize("format_name", [name for name in PAINTED if name != "rerun"])
def test_same_data_set_gives_the_same_bytes(format_name, painted, tmp_path):
    progress = []
    options = {"split": "train=.5,val=.5", "frames": "6:20"}
    first = export_dataset(
        painted.folder, format_name, tmp_path / "a", **options, on_frame=lambda *step: progress.append(step)
    )
    # From another folder, and into a folder that exists.
    moved = shutil.copytree(painted.folder, tmp_path / "moved")
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / ".DS_Store").touch()
    second = export_dataset(moved, format_name, tmp_path / "b", **options)
    (tmp_path / "b" / ".DS_Store").unlink()
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    assert (first.frames, first.files) == (2, len(contents(tmp_path / "a")))
    assert second.splits == {"train": 1, "val": 1}
    assert sorted(index for index, _, _ in progress) == [9, 14]
    assert [step[1:] for step in progress] == [(1, 2), (2, 2)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "moved"]


# Formats that write by the same function are left out, and those that keep the points of a scene in memory.
@pytest.mark.parametrize(
    "format_name", ["published", "coco", "yolo_detect", "semantic", "webdataset", "ply", "rgbd"]
)
def test_memory_does_not_grow_with_frames(format_name, painted, tmp_path):
    peaks = []

    def record_peak(_index, _done, _total):
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.reset_peak()

    tracemalloc.start()
    try:
        export_dataset(painted.folder, format_name, tmp_path / "a", frames="0:6", on_frame=record_peak)
    finally:
        tracemalloc.stop()
    # A photograph has 130 kB; COCO's records of images stay in memory, a few hundred bytes each.
    assert len(peaks) == 3
    assert peaks[-1] < peaks[1] + 100_000


@pytest.mark.parametrize("format_name", ["webdataset", "huggingface", "nerfstudio"])
def test_interrupted_export_leaves_nothing(format_name, painted, tmp_path):
    def stop(_index, done, _total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_dataset(painted.folder, format_name, tmp_path / "new" / "out", on_frame=stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("format_name", PAINTED)
def test_damaged_file_ends_the_export(format_name, painted, copied, tmp_path):
    folder = copied(painted).folder
    for output in sorted(READ[format_name] & {"colour", "class", "instance"}):
        path = folder / output / "000009.png"
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        original = path.read_bytes()
        path.write_bytes(content)
        with pytest.raises(InputError, match=rf"{output}/000009\.png: is not what the build wrote"):
            export_dataset(folder, format_name, tmp_path / "out", frames="9:10")
        assert not (tmp_path / "out").exists()
        path.write_bytes(original)


@pytest.mark.parametrize(
    ("format_name", "output", "suffix"),
    [("coco", "colour", "png"), ("huggingface", "colour", "png"), ("rgbd", "distance", "exr")],
)
def test_missing_output_is_an_error_before_the_first_frame(
    format_name, output, suffix, painted, copied, tmp_path
):
    folder = copied(painted).folder
    (folder / output / f"000020.{suffix}").unlink()
    message = f"frame 000020 has no output '{output}', .*build RECIPE .*--outputs {output}` adds it, with the"
    with pytest.raises(InputError, match=message):
        export_dataset(
            folder, format_name, tmp_path / "out", on_frame=lambda *_: pytest.fail("a frame was written")
        )


def test_unlisted_instance_is_an_error(painted, tmp_path, monkeypatch):
    metadata = painted.metadata(9)
    value = sorted(metadata["instances"])[0]
    del metadata["instances"][value]
    monkeypatch.setattr(DatasetFrame, "metadata", metadata)
    with pytest.raises(InputError, match=f"instance {value} is not in the frame's JSON"):
        export_dataset(painted.folder, "coco", tmp_path / "out", frames="9:10")


def test_folder_must_be_new_or_empty_and_outside(painted, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").touch()
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(painted.folder)
    for out, message in [
        (tmp_path / "full", "holds 'mine.txt'"),
        (tmp_path / "file", "is not a folder"),
        (tmp_path / "file" / "below", "is not a folder"),
        (painted.folder, "inside the data set"),
        (painted.folder / "coco", "inside the data set"),
        (tmp_path / "link" / "coco", "inside the data set"),
    ]:
        with pytest.raises(OutputError, match=message):
            export_dataset(painted.folder, "yolo", out)
    assert sorted(path.name for path in (tmp_path / "full").iterdir()) == ["mine.txt"]


def test_full_disk_is_an_output_error_and_leaves_nothing(tmp_path):
    def fill_disk():
        with new_folder(tmp_path / "deep" / "out", tmp_path / "set") as folder:
            (folder / "half").write_text("half")
            raise OSError(28, os.strerror(28))

    with pytest.raises(OutputError, match=r"out: cannot be written \(No space left on device\)"):
        fill_disk()
    assert list(tmp_path.iterdir()) == []


def test_existing_folder_is_filled_not_replaced(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    inode = out.stat().st_ino
    with new_folder(out, tmp_path / "set") as folder:
        (folder / "a").mkdir()
        (folder / "a" / "b").write_text("b")
    assert out.stat().st_ino == inode
    assert contents(out).keys() == {"a/b"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"format_name": "cocoa"}, "unknown format 'cocoa'; allowed are published, coco, yolo"),
        ({"frames": "1:3"}, "holds none of the data set's frames"),
        ({"frames": "x"}, "must be A:B"),
        ({"smallest_px": 0}, "must be at least 1"),
        ({"least_visible": 1.5}, "least_visible: 1.5 must be 0 to 1"),
        ({"ripe_from": -0.1}, "ripe_from: -0.1 must be 0 to 1"),
        ({"format_name": "published", "smallest_px": 5}, "published has no objects"),
        ({"format_name": "colmap", "classes": "pepper"}, "colmap has no objects"),
        ({"format_name": "ply", "least_visible": 0.5}, "ply has no objects"),
        ({"format_name": "rgbd", "ripe_from": 0.5}, "rgbd has no objects"),
        # Splits cannot have names that a format uses otherwise.
        ({"split": "annotations=0:2"}, "split: annotations is not allowed in the format coco"),
        ({"format_name": "yolo", "split": "names=0:2"}, "split: names is not allowed in the format yolo"),
        ({"format_name": "yolo", "split": "nc=0:2"}, "split: nc is not allowed in the format yolo"),
        ({"format_name": "yolo", "split": "path=0:2"}, "split: path is not allowed in the format yolo"),
    ],
)
def test_rejects_invalid_arguments(arguments, message, painted, tmp_path):
    with pytest.raises(ArgumentError, match=message):
        export_dataset(painted.folder, out=tmp_path / "out", **{"format_name": "coco", **arguments})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("format_name", "module"), [("coco", "pycocotools.mask"), ("yolo", "cv2")])
def test_missing_library_is_a_setup_error(format_name, module, painted, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    name = module.partition(".")[0]
    with pytest.raises(SetupError, match=rf"needs {name}, .*pip install 'pepperscene\[export\]'"):
        export_dataset(painted.folder, format_name, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


# What a killed export leaves.


def kill_export(folder, out):
    """Export in a copy of this process, which is killed after its first frame."""
    child = os.fork()
    if child == 0:
        try:
            export_dataset(folder, "semantic", out, on_frame=lambda *_: os.kill(os.getpid(), signal.SIGKILL))
        finally:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("exists", [True, False])
def test_the_leftovers_of_a_killed_export_are_removed(painted, tmp_path, exists):
    out = tmp_path / "out"
    if exists:
        out.mkdir()
    kill_export(painted.folder, out)
    (left,) = (out if exists else tmp_path).glob(".*.tmp")
    export_dataset(painted.folder, "semantic", out, frames="0:1")
    assert not left.exists()
    assert not list(out.glob(".*"))


def test_the_files_of_a_running_export_are_kept(painted, tmp_path):
    out = tmp_path / "out"
    out.mkdir()

    def start_another(*_):
        with pytest.raises(OutputError, match="choose an empty or a new folder"):
            export_dataset(painted.folder, "semantic", out)

    export_dataset(painted.folder, "semantic", out, frames="0:1", on_frame=start_another)
    assert not list(out.glob(".*"))


# The command that adds a missing output.


def test_the_hint_names_the_recipe_only_where_it_would_add_to_the_set(tmp_path):
    def hint(recipe, quality="standard"):
        info = {"recipe": dict(recipe.identity)["recipe"], "quality": quality}
        return run._adding_command(SimpleNamespace(info=info, folder=Path("my set")), "depth_z")

    demo = resolve_recipe("demo")
    assert hint(demo) == "`pepperscene build demo --out 'my set' --outputs depth_z` adds it"
    own = tmp_path / "mine.toml"
    own.write_text('extends = "demo"\nname = "demo"\nseed = 7\n')
    for text in (hint(resolve_recipe(own)), hint(resolve_recipe("demo", {"seed": 9})), hint(demo, "draft")):
        assert text.startswith(
            "`pepperscene build RECIPE --out 'my set' --outputs depth_z` adds it, with the recipe and the"
        )
