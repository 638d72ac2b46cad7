"""Files and folders that are removed while a build runs, and folders whose name is not text."""

from __future__ import annotations

import os
import shutil

import pytest

from pepperscene.dataset.store.dataset import Dataset, open_dataset
from pepperscene.errors import OutputError
from pepperscene.review.check import check_dataset

pytestmark = pytest.mark.usefixtures("empty_scenes")


@pytest.fixture
def make(build_small, tmp_path):
    def run(frames="0:5", **arguments):
        build_small("set", frames, ("class", "distance"), **arguments)
        return tmp_path / "set"

    return run


def assert_correct(folder, frames="0:5"):
    # Images of the stand-in renderer have another size than the camera.
    assert check_dataset(folder, workers=1, frames=frames).counts().keys() <= {"shape"}


def remover(*paths):
    """Callback that removes files once three frames are complete."""

    def remove(progress):
        if progress.done == 3:
            for path in paths:
                path.unlink()

    return remove


def test_what_is_removed_during_a_build_and_known_is_written_again(make, tmp_path):
    names = ("dataset.json", "journal.jsonl")
    assert_correct(make(on_frame=remover(*(tmp_path / "set" / name for name in names))))


@pytest.mark.parametrize("name", ["frames/000001.json", "class/000000.png"])
def test_frames_that_are_removed_during_a_build_are_named(make, tmp_path, name):
    with pytest.raises(OutputError, match=r"1 of 5 frames were removed during the build, the first is 00000"):
        make(on_frame=remover(tmp_path / "set" / name))
    # The same command repairs the set.
    assert_correct(make())


def test_folder_that_is_removed_during_a_build_is_an_error(make, tmp_path):
    with pytest.raises(OutputError):
        make(on_frame=lambda progress: shutil.rmtree(tmp_path / "set", ignore_errors=True))


def test_folders_that_another_interrupted_build_removes_are_made_again(make, monkeypatch, tmp_path):
    """A build that is interrupted before its first frame removes what it made, if there is no frame."""
    folder, commit, removed = tmp_path / "set", Dataset.commit, []

    def remove_once(self, *arguments):
        if not removed:
            removed.extend(path for path in folder.iterdir() if path.is_dir())
            for path in removed:
                path.rmdir()
        return commit(self, *arguments)

    monkeypatch.setattr(Dataset, "commit", remove_once)
    assert_correct(make("0:3"), "0:3")
    assert len(removed) == 3


def test_folder_whose_name_is_not_text(build_small):
    folder = build_small(os.fsdecode(b"caf\xe9"), "0:2").dataset.folder
    assert os.fsencode(folder.name) == b"caf\xe9"
    assert open_dataset(folder).manifest()["index"].to_pylist() == [0, 1]
    assert_correct(folder, "0:2")
