"""Worker processes make the same files as this process, whatever happens to a worker."""

from __future__ import annotations

import os
import signal
import sys
import threading
import types
from pathlib import Path

import pytest
from data_sets import contents
from stand_in import Deadly, Hungry, StandIn, Threaded

from pepperscene.dataset import open_dataset
from pepperscene.dataset.recipe.plan import frame_seed
from pepperscene.errors import InputError, OutputError, WorkerError

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals end processes here")


@pytest.fixture
def make(build_small):
    def run(out="set", renderer=StandIn, **arguments):
        return build_small(out, renderer=renderer, **arguments)

    return run


def workers_of_this_process():
    """Numbers of this process's living children that are workers."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
            command = (status.parent / "cmdline").read_bytes()
        except OSError:
            continue
        if int(fields[1]) == os.getpid() and fields[0] != "Z" and b"execution.local" in command:
            found.append(int(status.parent.name))
    return found


def test_workers_make_the_same_files(make, tmp_path):
    frames = []
    alone = make("alone")
    shared = make("shared", workers=2, on_frame=frames.append)
    assert contents(tmp_path / "alone") == contents(tmp_path / "shared")
    assert shared.made == alone.made == tuple(range(24))
    assert sorted(one.index for one in frames) == list(range(24))
    assert [one.done for one in frames] == list(range(1, 25))
    assert {one.picture.name for one in frames} == {f"{index:06d}.png" for index in range(24)}
    assert len({row["worker"] for row in shared.dataset.manifest().to_pylist()}) == 2
    assert not workers_of_this_process()
    again = make("shared", workers=3)
    assert (again.made, again.kept) == ((), tuple(range(24)))
    assert not workers_of_this_process()


def test_a_lost_worker_is_replaced(make, recipe, tmp_path, monkeypatch):
    make("whole")
    monkeypatch.setenv("DEADLY_SEED", str(frame_seed(recipe.seed, 6)))
    monkeypatch.setenv("DEADLY_ONCE", str(tmp_path / "once"))
    notices, frames = [], []
    result = make("set", Deadly, workers=2, on_notice=notices.append, on_frame=frames.append)
    assert contents(tmp_path / "whole") == contents(tmp_path / "set")
    assert len(notices) == 1
    assert "a worker was lost over frame 00000" in notices[0]
    assert "SIGKILL" in notices[0]
    assert sorted(one.index for one in frames) == sorted(result.made) == list(range(24))


def test_a_frame_that_ends_every_worker_is_named_and_others_are_kept(make, recipe, tmp_path, monkeypatch):
    monkeypatch.setenv("DEADLY_SEED", str(frame_seed(recipe.seed, 13)))
    with pytest.raises(WorkerError, match=r"frame 00001[0-3] ended 3 workers.*memory"):
        make("set", Deadly, workers=2)
    dataset = open_dataset(tmp_path / "set")
    assert 13 not in dataset.indices()
    assert all(dataset.intact(index).outputs for index in dataset.indices())
    monkeypatch.delenv("DEADLY_SEED")
    assert 13 in make("set", workers=2).made
    make("whole")
    assert contents(tmp_path / "whole") == contents(tmp_path / "set")


def test_out_of_memory_is_reported(make):
    with pytest.raises(WorkerError, match="out of memory"):
        make(renderer=Hungry, workers=1)


def test_a_worker_that_cannot_start_reports_why(make, monkeypatch):
    module = types.ModuleType("only_here")
    module.Renderer = type("Renderer", (StandIn,), {"__module__": "only_here"})
    monkeypatch.setitem(sys.modules, "only_here", module)
    with pytest.raises(WorkerError, match="No module named 'only_here'"):
        make(renderer=module.Renderer, workers=1)


def test_an_error_of_a_worker_is_raised_here(make, tmp_path):
    make(frames="0:1", workers=1)
    (tmp_path / "set" / "class" / "000001.png").mkdir()
    with pytest.raises(OutputError, match=r"000001\.png.*cannot be written"):
        make(frames="0:3", workers=1)
    assert 0 in open_dataset(tmp_path / "set").indices()


def test_an_interrupt_ends_the_workers_and_keeps_complete_frames(make, tmp_path, monkeypatch):
    monkeypatch.setenv("STAND_IN_S", "0.1")

    def stop(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make("set", workers=2, on_frame=stop)
    assert not workers_of_this_process()
    dataset = open_dataset(tmp_path / "set")
    assert len(dataset.indices()) >= 3
    assert [row["index"] for row in dataset.manifest().to_pylist()] == list(dataset.indices())
    make("set", workers=2)
    make("whole")
    assert contents(tmp_path / "whole") == contents(tmp_path / "set")


def test_workers_killed_from_outside_are_replaced(make, tmp_path, monkeypatch):
    monkeypatch.setenv("STAND_IN_S", "0.15")
    monkeypatch.setattr(sys.modules["pepperscene.dataset.execution.executor"], "MAX_LOSSES", 10)
    killed, over = [], threading.Event()

    def kill():
        while len(killed) < 3 and not over.wait(0.5):
            for process in workers_of_this_process()[:1]:
                os.kill(process, signal.SIGKILL)
                killed.append(process)

    thread = threading.Thread(target=kill, daemon=True)

    def begin(progress):
        if progress.done == 1:
            thread.start()

    result = make("set", workers=2, on_frame=begin)
    over.set()
    thread.join()
    assert killed
    assert result.made == tuple(range(24))
    make("whole")
    assert contents(tmp_path / "whole") == contents(tmp_path / "set")


@pytest.mark.parametrize("number", [0, -1, 2000])
def test_a_wrong_number_of_workers_is_refused(make, tmp_path, number):
    with pytest.raises(InputError, match="workers"):
        make(workers=number)
    assert not (tmp_path / "set").exists()


def test_only_one_executor_can_be_chosen(make):
    with pytest.raises(InputError, match="scheduler: cannot be combined with workers"):
        make(workers=2, scheduler="tcp://127.0.0.1:1")


@pytest.mark.parametrize(("variable", "threads"), [(None, "1"), ("3", "3")])
def test_workers_share_the_cores(make, monkeypatch, variable, threads):
    monkeypatch.setattr(sys.modules["pepperscene.dataset.execution.local"], "available_cores", lambda: 2)
    monkeypatch.delenv("PEPPERSCENE_THREADS", raising=False)
    if variable is not None:
        monkeypatch.setenv("PEPPERSCENE_THREADS", variable)
    result = make(renderer=Threaded, frames="0:1", workers=2)
    assert result.dataset.metadata(0)["threads"] == threads
