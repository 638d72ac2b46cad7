"""What all exports share: a folder that is whole or not there, the same bytes, faults told early."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import tracemalloc

import pytest
from painted_set import FRAMES

from pepperscene.dataset.export import FORMATS, Splits, export_dataset, new_folder
from pepperscene.errors import InputError, OutputError, SetupError

OURS = ("published", "coco", "yolo")


@pytest.fixture(scope="module")
def made(painted):
    return painted


@pytest.fixture
def damaged(made, copied):
    """A copy, to be damaged at will."""
    return copied(made)


def contents(folder):
    """Digest of every file by its name."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.mark.parametrize("form", OURS)
def test_the_same_data_set_gives_the_same_bytes(form, made, tmp_path):
    told = []
    first = export_dataset(
        made.folder, form, tmp_path / "a", "train=.6,val=.4", on_frame=lambda *one: told.append(one)
    )
    # Read from elsewhere, and written into a folder that is there.
    moved = shutil.copytree(made.folder, tmp_path / "moved")
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / ".DS_Store").touch()
    second = export_dataset(moved, form, tmp_path / "b", "train=.6,val=.4")
    (tmp_path / "b" / ".DS_Store").unlink()
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    assert (first.frames, first.files) == (len(FRAMES), len(contents(tmp_path / "a")))
    assert second.splits == {"train": 4, "val": 2}
    assert told == [(index, done, len(FRAMES)) for done, index in enumerate(FRAMES, start=1)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "moved"]


@pytest.mark.parametrize("form", OURS)
def test_frames_can_be_chosen(form, made, tmp_path):
    done = export_dataset(made.folder, form, tmp_path / "a", "train=0:10,val=14:15", frames="3:20")
    assert done.splits == {"train": 3, "val": 1}
    assert done.frames == 4


@pytest.mark.parametrize("form", OURS)
def test_memory_does_not_grow_with_frames(form, made, tmp_path):
    peaks = []

    def step(_index, _done, _total):
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.reset_peak()

    tracemalloc.start()
    try:
        export_dataset(made.folder, form, tmp_path / "a", on_frame=step)
    finally:
        tracemalloc.stop()
    # The pictures' records of COCO are kept, a few hundred bytes each.
    assert peaks[-1] < peaks[1] + 100_000


@pytest.mark.parametrize("form", OURS)
@pytest.mark.parametrize("fault", [KeyboardInterrupt, ZeroDivisionError])
def test_an_export_that_ends_early_leaves_nothing(form, fault, made, tmp_path):
    def stop(_index, done, _total):
        if done == 2:
            raise fault

    with pytest.raises(fault):
        export_dataset(made.folder, form, tmp_path / "new" / "out", on_frame=stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("form", OURS)
@pytest.mark.parametrize("output", ["colour", "class", "instance"])
def test_a_damaged_file_ends_the_export_with_its_name(form, output, damaged, tmp_path):
    needed = {
        "published": ("colour", "class"),
        "coco": ("colour", "instance"),
        "yolo": ("colour", "instance"),
    }
    path = damaged.folder / output / "000009.png"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    if output in needed[form]:
        with pytest.raises(InputError, match=rf"{output}/000009\.png: is not what the build wrote"):
            export_dataset(damaged.folder, form, tmp_path / "out")
        assert not (tmp_path / "out").exists()
    else:
        export_dataset(damaged.folder, form, tmp_path / "out")


@pytest.mark.parametrize("form", OURS)
def test_a_missing_output_is_told_before_anything_is_written(form, damaged, tmp_path):
    (damaged.folder / "colour" / "000020.png").unlink()
    with pytest.raises(InputError, match=r"frame 000020 has no output 'colour'.*--outputs colour` adds it"):
        export_dataset(
            damaged.folder, form, tmp_path / "out", on_frame=lambda *_: pytest.fail("a frame was written")
        )


def test_an_instance_that_nobody_tells_of_is_told(damaged, tmp_path, monkeypatch):
    from pepperscene.dataset.export import source

    facts = damaged.metadata(9)
    value = sorted(facts["instances"])[0]
    del facts["instances"][value]
    monkeypatch.setattr(source.ExportSource, "facts", facts)
    with pytest.raises(InputError, match=f"instance {value} is not in the frame's JSON"):
        export_dataset(damaged.folder, "coco", tmp_path / "out", frames="9:10")


def test_the_folder_must_be_new_or_empty_and_outside(made, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").touch()
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(made.folder)
    for out, told in [
        (tmp_path / "full", "holds 'mine.txt'"),
        (tmp_path / "file", "is not a folder"),
        (tmp_path / "file" / "below", "is not a folder"),
        (made.folder, "inside the data set"),
        (made.folder / "coco", "inside the data set"),
        (tmp_path / "link" / "coco", "inside the data set"),
    ]:
        with pytest.raises(OutputError, match=told):
            export_dataset(made.folder, "yolo", out)
    assert sorted(path.name for path in (tmp_path / "full").iterdir()) == ["mine.txt"]


def test_what_fails_on_the_disk_is_told_and_swept(tmp_path):
    def fill():
        with new_folder(tmp_path / "deep" / "out", tmp_path / "set") as folder:
            (folder / "half").write_text("half")
            raise OSError(28, os.strerror(28))

    with pytest.raises(OutputError, match=r"out: cannot be written \(No space left on device\)"):
        fill()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_there_is_filled_not_replaced(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    inode = out.stat().st_ino
    with new_folder(out, tmp_path / "set") as folder:
        (folder / "a").mkdir()
        (folder / "a" / "b").write_text("b")
    assert out.stat().st_ino == inode
    assert contents(out).keys() == {"a/b"}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"form": "cocoa"}, "unknown format 'cocoa'; allowed are published, coco, yolo"),
        ({"frames": "1:3"}, "holds none of the data set's frames"),
        ({"frames": "x"}, "must be A:B"),
        ({"smallest_px": 0}, "must be at least 1"),
        ({"form": "published", "smallest_px": 5}, "published does not tell"),
    ],
)
def test_wrong_arguments_are_told(arguments, told, made, tmp_path):
    with pytest.raises(InputError) as fault:
        export_dataset(made.folder, arguments.pop("form", "coco"), tmp_path / "out", **arguments)
    assert told in str(fault.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("form", "module"), [("coco", "pycocotools.mask"), ("yolo", "cv2")])
def test_a_library_that_is_missing_is_told(form, module, made, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    name = module.partition(".")[0]
    with pytest.raises(SetupError, match=rf"needs {name}, .*pip install 'pepperscene\[export\]'"):
        export_dataset(made.folder, form, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_every_format_has_its_exporter():
    for name, form in FORMATS.items():
        assert form.name == name
        assert callable(form)
    assert Splits().names == ("train",)
