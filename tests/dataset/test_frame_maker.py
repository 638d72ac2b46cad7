"""Frames are written in the background: in order, completely or not at all, and one at a time."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace

import numpy as np
import pytest

from pepperscene.dataset import BuildOptions, open_dataset
from pepperscene.dataset.execution.job import BuildJob, FrameMaker
from pepperscene.errors import InputError, OutputError
from pepperscene.frame import Frame

pytestmark = pytest.mark.usefixtures("empty_scenes")
STORE = sys.modules["pepperscene.dataset.store.dataset"]
OUTPUTS = ("class", "distance")
FIRST = {"dataset.json", "frames/000000.json", "class/000000.png", "distance/000000.exr"}


@pytest.fixture
def job(recipe, fake_renderer, tmp_path):
    return BuildJob.create(recipe, tmp_path / "set", OUTPUTS, BuildOptions(renderer=fake_renderer))


def files(folder):
    return {str(path.relative_to(folder)) for path in folder.rglob("*.*")}


@pytest.mark.parametrize("eager", [False, True])
def test_the_next_frame_is_rendered_while_one_is_written(job, fake_renderer, monkeypatch, eager):
    write, first_is_rendered, go = STORE.write_file, threading.Event(), threading.Event()
    events, begun = [], []

    class Noting(fake_renderer):
        def render(self, camera, *args, **kwargs):
            events.append(f"render {len(self.views)}")
            if len(self.views) == 1:
                # The first frame is neither complete nor reported.
                assert not list(job.folder.glob("frames/*"))
                go.set()
            return super().render(camera, *args, **kwargs)

    def held(path, content):
        begun.append(path.name)
        first_is_rendered.set()
        assert go.wait(60)
        write(path, content)

    def on_frame(done):
        in_caller = threading.current_thread() is threading.main_thread()
        events.append(("report", done.index, in_caller, len(list(job.folder.glob("frames/*.json")))))

    monkeypatch.setattr(STORE, "write_file", held)
    with FrameMaker(replace(job, renderer=Noting), eager=eager) as maker:
        maker.make([0, 1, 2], on_frame)
    reports = [event for event in events if event[0] == "report"]
    # Every frame is complete when it is reported, and the one after the next waits for that.
    assert reports == [("report", index, not eager, index + 1) for index in range(3)]
    assert events.index(reports[0]) < events.index("render 2")
    assert len(begun) == 6


def test_a_frame_that_is_being_written_is_finished_when_the_caller_fails(job):
    def interrupt(done):
        if done.index == 0:
            raise KeyboardInterrupt

    def run():
        with FrameMaker(job) as maker:
            maker.make([0, 1, 2], interrupt)

    with pytest.raises(KeyboardInterrupt):
        run()
    dataset = open_dataset(job.folder)
    assert 0 in dataset.indices()
    assert all(set(dataset.intact(index).outputs) == set(OUTPUTS) for index in dataset.indices())


def test_a_failed_write_is_raised_and_leaves_nothing_of_its_frame(job, monkeypatch):
    write, reported = STORE.write_file, []

    def full(path, content):
        if path.name == "000001.exr":
            raise OSError(28, "No space left on device", str(path))
        write(path, content)

    monkeypatch.setattr(STORE, "write_file", full)
    with FrameMaker(job) as maker, pytest.raises(OutputError, match=r"distance.*No space left"):
        maker.make(range(4), lambda done: reported.append(done.index))
    assert reported == [0]
    assert files(job.folder) == FIRST


def test_metadata_that_is_not_json_leaves_nothing_of_the_frame(job, fake_renderer):
    class Wrong(fake_renderer):
        def render(self, camera, *args, **kwargs):
            frame = super().render(camera, *args, **kwargs)
            return Frame(frame.images, {**frame.metadata, "light": np.nan})

    with FrameMaker(replace(job, renderer=Wrong)) as maker, pytest.raises(ValueError, match="JSON"):
        maker.make([0], lambda done: None)
    assert files(job.folder) == {"dataset.json"}


def test_frames_before_a_failing_one_are_kept(build_small, fake_renderer, tmp_path):
    class Failing(fake_renderer):
        def render(self, camera, outputs=(), quality="standard", seed=0):
            if len(self.views) == 2:
                raise InputError("a", "no more", key="b", value=0)
            return super().render(camera, outputs, quality, seed)

    with pytest.raises(InputError):
        build_small(frames="0:4", renderer=Failing)
    dataset = open_dataset(tmp_path / "set")
    assert dataset.indices() == (0, 1)
    assert all(set(dataset.intact(index).outputs) == set(OUTPUTS) for index in (0, 1))
