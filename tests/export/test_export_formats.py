"""What all formats share: the folder is complete or missing, bytes are reproducible, errors come early."""

from __future__ import annotations

import os
import shutil
import sys
import tracemalloc
from importlib.util import find_spec
from pathlib import Path

import pytest
from data_sets import contents
from painted_set import FRAMES

from pepperscene.dataset.dataset_frame import DatasetFrame
from pepperscene.errors import InputError, OutputError, SetupError
from pepperscene.export import FORMATS, export_dataset
from pepperscene.export.run import new_folder

LEFT_OUT = {"bop", "envi", "npy"} | (set() if find_spec("rerun") else {"rerun"})
PAINTED = [name for name in FORMATS if name not in LEFT_OUT]
"""Formats that painted sets can have; `bop` needs plants, two need bands, and `rerun` a large package."""

every_format = pytest.mark.parametrize("format_name", PAINTED)
READ = {name: {output for outputs in FORMATS[name].required for output in outputs} for name in PAINTED}
READ["webdataset"] |= {"instance"}
READ["huggingface"] |= {"instance"}
"""The outputs that a format reads, where the data set has them."""
WITH_POINTS = ("nerfstudio", "colmap")
"""The points of a scene stay in memory, 40 bytes each, and 12 more for each frame that shows one."""


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
    first = export_dataset(
        painted.folder,
        format_name,
        tmp_path / "a",
        "train=.6,val=.4",
        on_frame=lambda *step: progress.append(step),
    )
    # From another folder, and into a folder that exists.
    moved = shutil.copytree(painted.folder, tmp_path / "moved")
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / ".DS_Store").touch()
    second = export_dataset(moved, format_name, tmp_path / "b", "train=.6,val=.4")
    (tmp_path / "b" / ".DS_Store").unlink()
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    assert (first.frames, first.files) == (len(FRAMES), len(contents(tmp_path / "a")))
    assert second.splits == {"train": 4, "val": 2}
    assert sorted(index for index, _, _ in progress) == list(FRAMES)
    assert [step[1:] for step in progress] == [(done, len(FRAMES)) for done in range(1, len(FRAMES) + 1)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "moved"]


@every_format
def test_exports_selected_frames(format_name, painted, tmp_path):
    split = "train=0:10,val=14:15"
    result = export_dataset(painted.folder, format_name, tmp_path / "a", split, frames="3:20")
    assert (result.frames, result.splits) == (4, {"train": 3, "val": 1})


@pytest.mark.parametrize(
    "format_name", [name for name in PAINTED if name not in ("huggingface", *WITH_POINTS)]
)
def test_memory_does_not_grow_with_frames(format_name, painted, tmp_path):
    peaks = []

    def record_peak(_index, _done, _total):
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.reset_peak()

    tracemalloc.start()
    try:
        export_dataset(painted.folder, format_name, tmp_path / "a", on_frame=record_peak)
    finally:
        tracemalloc.stop()
    # COCO's records of images stay in memory, a few hundred bytes each.
    assert peaks[-1] < peaks[1] + 100_000


@every_format
def test_interrupted_export_leaves_nothing(format_name, painted, tmp_path):
    def stop(_index, done, _total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_dataset(painted.folder, format_name, tmp_path / "new" / "out", on_frame=stop)
    assert list(tmp_path.iterdir()) == []


@every_format
@pytest.mark.parametrize("output", ["colour", "class", "instance"])
def test_damaged_file_ends_the_export(format_name, output, painted, copied, tmp_path):
    folder = copied(painted).folder
    path = folder / output / "000009.png"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    if output in READ[format_name]:
        with pytest.raises(InputError, match=rf"{output}/000009\.png: is not what the build wrote"):
            export_dataset(folder, format_name, tmp_path / "out")
        assert not (tmp_path / "out").exists()
    else:
        export_dataset(folder, format_name, tmp_path / "out")


@every_format
def test_missing_output_is_an_error_before_the_first_frame(format_name, painted, copied, tmp_path):
    folder = copied(painted).folder
    (folder / "colour" / "000020.png").unlink()
    with pytest.raises(InputError, match=r"frame 000020 has no output 'colour'.*--outputs colour` adds it"):
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
        ({"format_name": "published", "smallest_px": 5}, "published has no objects"),
        ({"format_name": "nerfstudio", "smallest_px": 5}, "nerfstudio has no objects"),
        ({"format_name": "colmap", "classes": "pepper"}, "colmap has no objects"),
        ({"format_name": "ply", "least_visible": 0.5}, "ply has no objects"),
        ({"format_name": "rgbd", "ripe_from": 0.5}, "rgbd has no objects"),
        ({"format_name": "bop", "smallest_px": 5}, "bop has no objects"),
    ],
)
def test_rejects_invalid_arguments(arguments, message, painted, tmp_path):
    with pytest.raises(InputError, match=message):
        export_dataset(painted.folder, out=tmp_path / "out", **{"format_name": "coco", **arguments})
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("format_name", "module"), [("coco", "pycocotools.mask"), ("yolo", "cv2")])
def test_missing_library_is_a_setup_error(format_name, module, painted, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    name = module.partition(".")[0]
    with pytest.raises(SetupError, match=rf"needs {name}, .*pip install 'pepperscene\[export\]'"):
        export_dataset(painted.folder, format_name, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
