"""A disk that is full at any moment of a build: one sentence, exit code 2, and nothing is lost."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from data_sets import contents
from stand_in import PYTHONPATH, rendered

from pepperscene.dataset.store.dataset import open_dataset

DISK_KIB = 16 * 1024
FILLER = "filler"
_SCRIPT = """
from data_sets import remove_plants
from disc_set import DiscRenderer
from pepperscene.cli import main
from pepperscene.building.scenes import frame_renderer
import pytest, stand_in, sys

class Logged(DiscRenderer):
    def render(self, camera, outputs=(), quality="standard", seed=0, **others):
        stand_in._log(seed)
        return super().render(camera, outputs, quality, seed, **others)

with pytest.MonkeyPatch.context() as patch:
    remove_plants(patch)
    patch.setattr(frame_renderer, "mitsuba_renderer", Logged)
    main()
"""
_OPTIONS = ("--frames", "0:12", "--outputs", "class,instance,distance,colour")
_CHANGES = ("plan.sets=3", "plan.rotations=1", "plan.frames=4", "cultivar=kaite_february")


@pytest.fixture
def disk(tmp_path):
    """A small disk of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_KIB}k", "tmpfs", str(folder)]
    if sys.platform != "linux" or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("this user cannot mount a small disk")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def build(folder, log):
    """Run the command line; returns exit code and the lines of standard error that are not progress."""
    changes = [part for change in _CHANGES for part in ("--set", change)]
    command = [sys.executable, "-c", _SCRIPT, "build", "barth2018", "--out", str(folder), *_OPTIONS, *changes]
    done = subprocess.run(
        command,
        env={**os.environ, "PYTHONPATH": PYTHONPATH, "STAND_IN_LOG": str(log)},
        capture_output=True,
        text=True,
    )
    lines = [line for line in done.stderr.splitlines() if not line.startswith(("frame ", "note: "))]
    return done.returncode, lines


@contextmanager
def filled(disk, free_kib):
    """The disk with a file that leaves so much space."""
    filler = disk / FILLER
    status = os.statvfs(disk)
    size = status.f_bavail * status.f_frsize - int(free_kib * 1024)
    filler.write_bytes(bytes(max(0, size)))
    yield
    filler.unlink()


@pytest.fixture
def expected(disk, tmp_path):
    """Files of the data set, and its frames."""
    assert build(disk / "set", tmp_path / "log") == (0, [])
    files, indices = contents(disk / "set"), list(open_dataset(disk / "set").indices())
    shutil.rmtree(disk / "set")
    return files, indices


@pytest.mark.long
def test_full_disk_at_30_moments(disk, tmp_path, expected):
    folder, log = disk / "set", tmp_path / "log"
    size_kib, rng, codes = sum(map(len, expected[0].values())) / 1024, np.random.default_rng(7), []
    for fraction in (0.0, 0.4, 1.0, *rng.uniform(0, 1.6, 27)):
        with filled(disk, fraction * size_kib):
            code, lines = build(folder, log)
        codes.append(code)
        if code:
            assert code == 2, lines
            (line,) = lines
            assert line.startswith(f"error: {folder}")
            assert "No space left on device" in line
        else:
            assert lines == []
        # What is there is complete, and is not made again.
        complete = set(open_dataset(folder).indices()) if (folder / "dataset.json").exists() else set()
        started = len(rendered(log))
        assert build(folder, log) == (0, [])
        assert len(rendered(log)) - started == len(expected[1]) - len(complete)
        assert contents(folder) == expected[0]
        assert open_dataset(folder).manifest()["index"].to_pylist() == expected[1]
        shutil.rmtree(folder)
    assert codes[:3] == [2, 2, 2]
    assert codes.count(2) > 10
