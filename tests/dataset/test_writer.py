"""Writing behind the caller's back: in order, whole or not at all, and never two frames at a time."""

from __future__ import annotations

import sys
import threading

import numpy as np
import pytest

from pepperscene.dataset import build, open_dataset
from pepperscene.dataset.execution.job import Addition, FrameWriter
from pepperscene.dataset.store.dataset import FORMAT
from pepperscene.dataset.store.folder import OutputFolder
from pepperscene.errors import InputError, OutputError

STORE = sys.modules["pepperscene.dataset.store.dataset"]
IMAGES = {"class": np.zeros((4, 5), np.uint8), "distance": np.ones((4, 5), np.float32)}


def addition(index, **facts):
    return Addition(index, IMAGES, lambda: {"index": index, **facts}, {})


@pytest.fixture
def folder(tmp_path):
    about = {"format": FORMAT, "quality": "draft", "version": "0", "recipe": {}, "files": {}}
    return OutputFolder(tmp_path / "set", about)


def held_writes(monkeypatch):
    """Writing goes on when the event is set."""
    write, go, begun = STORE.write_image, threading.Event(), []

    def held(path, image, output):
        begun.append(path.name)
        assert go.wait(60)
        write(path, image, output)

    monkeypatch.setattr(STORE, "write_image", held)
    return go, begun


def test_the_caller_goes_on_while_a_frame_is_written_and_is_told_when_it_is_whole(folder, monkeypatch):
    go, begun = held_writes(monkeypatch)
    told = []
    with FrameWriter(folder) as writer:
        writer.start(addition(3), lambda _: told.append(folder.dataset.indices()))
        # Here the caller renders: nothing is whole, and nothing has been told.
        assert (folder.dataset.indices(), told) == ((), [])
        go.set()
        writer.finish()
        assert told == [(3,)]
        writer.finish()
        assert told == [(3,)]
    # Both images were under way at once.
    assert len(begun) == 2


def test_the_next_frame_begins_when_the_last_one_is_whole(folder):
    told = []
    with FrameWriter(folder) as writer:
        for index in range(5):
            then = lambda _, index=index: told.append((index, folder.dataset.indices()))  # noqa: E731
            writer.start(addition(index), then)
            assert len(told) == index
    # The last frame is whole although nobody asked for it, and its news went nowhere.
    assert told == [(index, tuple(range(index + 1))) for index in range(4)]
    assert folder.dataset.indices() == (0, 1, 2, 3, 4)


def test_a_frame_under_way_is_finished_when_the_caller_fails(folder, monkeypatch):
    go, _ = held_writes(monkeypatch)

    def interrupted():
        with FrameWriter(folder) as writer:
            writer.start(addition(0), lambda _: None)
            threading.Timer(0.05, go.set).start()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert folder.dataset.indices() == (0,)
    assert set(folder.dataset.intact(0).outputs) == set(IMAGES)


def test_a_fault_is_told_once_and_leaves_nothing_of_its_frame(folder, monkeypatch):
    write = STORE.write_image

    def full(path, image, output):
        if output == "distance":
            path.write_bytes(b"half")
            raise OSError(28, "No space left on device", str(path))
        write(path, image, output)

    told = []
    with FrameWriter(folder) as writer:
        writer.start(addition(0), lambda _: told.append(0))
        writer.finish()
        monkeypatch.setattr(STORE, "write_image", full)
        writer.start(addition(1), lambda _: told.append(1))
        with pytest.raises(OutputError, match=r"distance.*No space left"):
            writer.finish()
        writer.finish()
    assert (told, folder.dataset.indices()) == ([0], (0,))
    files = {str(path.relative_to(folder.dataset.folder)) for path in folder.dataset.folder.rglob("*.*")}
    assert files == {"dataset.json", "frames/000000.json", "class/000000.png", "distance/000000.exr"}


def test_facts_that_are_no_json_leave_nothing_of_the_frame(folder):
    with FrameWriter(folder) as writer:
        writer.start(addition(0, light=float("nan")), lambda: None)
        with pytest.raises(ValueError, match="JSON"):
            writer.finish()
    assert not list(folder.dataset.folder.rglob("*.png"))
    assert folder.dataset.indices() == ()


@pytest.mark.usefixtures("empty_scenes")
def test_a_renderer_that_fails_later_keeps_the_frames_before(recipe, fake_renderer, tmp_path):
    class Failing(fake_renderer):
        def render(self, camera, outputs=(), quality="standard", seed=0):
            if len(self.views) == 2:
                raise InputError("a", "no more", key="b", value=0)
            return super().render(camera, outputs, quality, seed)

    with pytest.raises(InputError):
        build(recipe, tmp_path / "set", frames="0:4", renderer=Failing)
    dataset = open_dataset(tmp_path / "set")
    assert dataset.indices() == (0, 1)
    assert all(
        set(dataset.intact(index).outputs) == set(dataset.metadata(index)["outputs"]) for index in (0, 1)
    )
