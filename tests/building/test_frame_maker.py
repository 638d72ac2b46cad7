"""Frames are written in the background: in order, and completely or not at all."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
from data_sets import contents

from pepperscene.building.execution.job import BuildJob, BuildOptions, FrameMaker
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.errors import InputError, OutputError
from pepperscene.frame import Frame

pytestmark = pytest.mark.usefixtures("empty_scenes")
ATOMIC = sys.modules["pepperscene.atomic"]
OUTPUTS = ("class", "distance")


@pytest.fixture
def job(recipe, fake_renderer, tmp_path):
    return BuildJob.create(recipe, tmp_path / "set", OUTPUTS, BuildOptions(renderer=fake_renderer))


@pytest.fixture
def fill_disk(monkeypatch):
    """Makes the disk full after a number of files."""

    def install(count):
        write, written = ATOMIC._write_new, []

        def write_or_fail(path, content):
            written.append(path)
            if len(written) > count:
                write(path, b"half")
                raise OSError(28, "No space left on device", str(path))
            write(path, content)

        monkeypatch.setattr(ATOMIC, "_write_new", write_or_fail)

    return install


def assert_intact(folder, expected):
    """The expected frames exist, and are complete."""
    dataset = open_dataset(folder)
    assert dataset.indices() == expected
    assert all(set(dataset.intact(index).outputs) == set(OUTPUTS) for index in expected)


@pytest.mark.parametrize("eager", [False, True])
def test_next_frame_is_rendered_while_one_is_written(job, fake_renderer, monkeypatch, eager):
    write, is_writing, go = ATOMIC._write_new, threading.Event(), threading.Event()
    events, written = [], []

    class NotingRenderer(fake_renderer):
        def render(self, *args, **kwargs):
            events.append(f"render {len(self.calls)}")
            if len(self.calls) == 1:
                # The first frame is neither complete nor reported.
                assert is_writing.wait(60)
                assert not list(job.folder.glob("frames/*"))
                go.set()
            return super().render(*args, **kwargs)

    def write_later(path, content):
        written.append(path.name)
        is_writing.set()
        assert go.wait(60)
        write(path, content)

    def on_frame(done):
        in_caller = threading.current_thread() is threading.main_thread()
        events.append(("report", done.index, in_caller, len(list(job.folder.glob("frames/*.json")))))

    monkeypatch.setattr(ATOMIC, "_write_new", write_later)
    with FrameMaker(replace(job, renderer=NotingRenderer), eager=eager) as maker:
        maker.make([0, 1, 2], on_frame)
    reports = [event for event in events if event[0] == "report"]
    # Every frame is complete when it is reported, and the one after the next waits for that.
    assert reports == [("report", index, not eager, index + 1) for index in range(3)]
    assert events.index(reports[0]) < events.index("render 2")
    # dataset.json, and two images and the JSON of three frames.
    assert len(written) == 10


@pytest.mark.parametrize("fail_at", range(len(OUTPUTS)))
def test_full_disk_leaves_only_complete_frames(build_small, tmp_path, fill_disk, fail_at):
    build_small(frames="0:1", out="expected")
    reported = []
    # dataset.json, and images and JSON of the first frame fit.
    fill_disk(len(OUTPUTS) + 2 + fail_at)
    with pytest.raises(OutputError, match="No space left"):
        build_small(frames="0:4", on_frame=lambda progress: reported.append(progress.index))
    assert reported == [0]
    assert contents(tmp_path / "set") == contents(tmp_path / "expected")


def test_failed_rename_of_frame_json_leaves_nothing_of_the_frame(build_small, tmp_path, refuse_rename):
    build_small(frames="0:1")
    before = contents(tmp_path / "set")
    refuse_rename("000001.json")
    with pytest.raises(OutputError, match=r"000001\.json.*Input/output error"):
        build_small(frames="0:2")
    assert contents(tmp_path / "set") == before


def test_failure_in_the_first_frame_leaves_no_folder(build_small, tmp_path, fill_disk):
    fill_disk(1)
    with pytest.raises(OutputError):
        build_small(frames="0:3", out="a/b/set")
    assert list(tmp_path.iterdir()) == []


def test_metadata_that_is_not_json_leaves_nothing_of_the_frame(job, fake_renderer):
    class InvalidRenderer(fake_renderer):
        def render(self, *args, **kwargs):
            frame = super().render(*args, **kwargs)
            return Frame(frame.images, {**frame.metadata, "light": np.nan})

    with FrameMaker(replace(job, renderer=InvalidRenderer)) as maker, pytest.raises(ValueError, match="JSON"):
        maker.make([0], lambda done: None)
    assert set(contents(job.folder)) == {"dataset.json"}


def test_frame_being_written_is_finished_when_the_next_one_fails(build_small, fake_renderer, tmp_path):
    class FailingRenderer(fake_renderer):
        def render(self, *args, **kwargs):
            if len(self.calls) == 2:
                raise InputError("a", "no more", key="b", value=0)
            return super().render(*args, **kwargs)

    with pytest.raises(InputError):
        build_small(frames="0:4", renderer=FailingRenderer)
    assert_intact(tmp_path / "set", (0, 1))
