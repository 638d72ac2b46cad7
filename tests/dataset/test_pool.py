"""Workers: the same files as without them, whatever becomes of a worker."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path

import pytest
from set_files import contents
from stand_in import Deadly, Hungry, StandIn, Threaded

from pepperscene.dataset import build, open_dataset
from pepperscene.dataset.recipe.plan import frame_seed
from pepperscene.errors import InputError, OutputError, WorkerError

OUTPUTS = ("class", "distance")

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals end processes here")


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    """Workers find the stand-in as well."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))


@pytest.fixture
def make(recipe, tmp_path):
    def run(out="set", renderer=StandIn, **arguments):
        arguments.setdefault("outputs", OUTPUTS)
        return build(recipe, tmp_path / out, renderer=renderer, **arguments)

    return run


def test_workers_make_the_same_files(make, tmp_path):
    told = []
    alone = make("alone")
    shared = make("shared", workers=2, on_frame=told.append)
    assert contents(tmp_path / "alone") == contents(tmp_path / "shared")
    assert shared.made == alone.made == tuple(range(24))
    assert sorted(one.index for one in told) == list(range(24))
    assert [one.done for one in told] == list(range(1, 25))
    assert {one.picture.name for one in told} == {f"{index:06d}.png" for index in range(24)}
    workers = {row["worker"] for row in shared.dataset.manifest().to_pylist()}
    assert len(workers) == 2
    again = make("shared", workers=2)
    assert (again.made, again.kept) == ((), tuple(range(24)))


def test_a_lost_worker_is_replaced(make, recipe, tmp_path, monkeypatch):
    make("whole")
    monkeypatch.setenv("DEADLY_SEED", str(frame_seed(recipe.seed, 6)))
    monkeypatch.setenv("DEADLY_ONCE", str(tmp_path / "once"))
    notices, told = [], []
    done = make("set", Deadly, workers=2, on_notice=notices.append, on_frame=told.append)
    assert contents(tmp_path / "whole") == contents(tmp_path / "set")
    assert len(notices) == 1
    assert "a worker was lost over frame 00000" in notices[0]
    assert "SIGKILL" in notices[0]
    assert sorted(one.index for one in told) == sorted(done.made) == list(range(24))


def test_a_frame_that_ends_every_worker_is_named_and_the_rest_is_kept(make, recipe, tmp_path, monkeypatch):
    monkeypatch.setenv("DEADLY_SEED", str(frame_seed(recipe.seed, 13)))
    with pytest.raises(WorkerError, match=r"frame 00001[0-3] ended 3 workers.*memory"):
        make("set", Deadly, workers=2)
    dataset = open_dataset(tmp_path / "set")
    assert 13 not in dataset.indices()
    assert all(dataset.intact(index).outputs for index in dataset.indices())
    monkeypatch.delenv("DEADLY_SEED")
    done = make("set", workers=2)
    assert 13 in done.made
    make("whole")
    assert contents(tmp_path / "whole") == contents(tmp_path / "set")


def test_out_of_memory_is_told(make):
    with pytest.raises(WorkerError, match="out of memory"):
        make(renderer=Hungry, workers=1)


def test_a_worker_that_cannot_begin_tells_why(make, monkeypatch):
    monkeypatch.delenv("PYTHONPATH")
    with pytest.raises(WorkerError, match="No module named 'stand_in'"):
        make(workers=1)


def test_a_fault_of_a_worker_is_the_fault_it_found(make, tmp_path, monkeypatch):
    make(frames="0:1", workers=1)
    os.chmod(tmp_path / "set" / "class", 0o500)
    try:
        if os.access(tmp_path / "set" / "class", os.W_OK):
            pytest.skip("this user may write anywhere")
        with pytest.raises(OutputError, match=r"class.*cannot be written"):
            make(workers=2)
    finally:
        os.chmod(tmp_path / "set" / "class", 0o700)


def test_a_folder_in_the_way_is_told_by_the_worker(make, tmp_path):
    make(frames="0:1", workers=1)
    (tmp_path / "set" / "class" / "000001.png").mkdir()
    with pytest.raises(OutputError, match=r"000001\.png.*cannot be written"):
        make(frames="0:3", workers=1)
    assert 0 in open_dataset(tmp_path / "set").indices()


def test_an_interrupt_ends_the_workers_and_keeps_whole_frames(make, tmp_path, monkeypatch):
    monkeypatch.setenv("STAND_IN_S", "0.1")

    def stop(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make("set", workers=2, on_frame=stop)
    assert not _children()
    dataset = open_dataset(tmp_path / "set")
    assert len(dataset.indices()) >= 3
    assert [row["index"] for row in dataset.manifest().to_pylist()] == list(dataset.indices())
    make("set", workers=2)
    make("whole")
    assert contents(tmp_path / "whole") == contents(tmp_path / "set")


def test_workers_end_with_the_build(make):
    make(frames="0:4", workers=3)
    assert not _children()


def test_a_worker_killed_from_outside(make, tmp_path, monkeypatch):
    monkeypatch.setenv("STAND_IN_S", "0.3")
    killed, over = [], threading.Event()

    def kill():
        while len(killed) < 3 and not over.wait(0.7):
            for process in _children()[:1]:
                os.kill(process, signal.SIGKILL)
                killed.append(process)

    thread = threading.Thread(target=kill, daemon=True)

    def begin(progress):
        if progress.done == 1:
            thread.start()

    monkeypatch.setattr(sys.modules["pepperscene.dataset.execution.executor"], "MOST_LOSSES", 10)
    done = make("set", workers=2, on_frame=begin)
    over.set()
    thread.join()
    assert killed
    assert done.made == tuple(range(24))
    make("whole")
    assert contents(tmp_path / "whole") == contents(tmp_path / "set")


@pytest.mark.parametrize("number", [0, -1, 2000])
def test_a_number_of_workers_is_between_one_and_many(make, tmp_path, number):
    with pytest.raises(InputError, match="workers"):
        make(workers=number)
    assert not (tmp_path / "set").exists()


def test_one_way_at_a_time(make):
    with pytest.raises(InputError, match="scheduler: cannot be combined with workers"):
        make(workers=2, scheduler="tcp://127.0.0.1:1")


def _children():
    """Process numbers of this process's living children that are workers."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
            words = (status.parent / "cmdline").read_bytes()
        except OSError:
            continue
        if int(fields[1]) == os.getpid() and fields[0] != "Z" and b"execution.local" in words:
            found.append(int(status.parent.name))
    return found


@pytest.mark.parametrize(("said", "threads"), [(None, "1"), ("3", "3")])
def test_a_worker_keeps_to_its_cores(make, tmp_path, monkeypatch, said, threads):
    monkeypatch.setattr(sys.modules["pepperscene.dataset.execution.local"], "available_cores", lambda: 2)
    monkeypatch.delenv("PEPPERSCENE_THREADS", raising=False)
    if said is not None:
        monkeypatch.setenv("PEPPERSCENE_THREADS", said)
    done = make(renderer=Threaded, frames="0:1", workers=2)
    assert done.dataset.metadata(0)["threads"] == threads
