"""Worker processes make the same files as this process, also if workers are lost."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path

import pytest
from data_sets import contents
from stand_in import KilledRenderer, OutOfMemoryRenderer, StandIn, ThreadsRenderer, process_fields

from pepperscene.dataset import open_dataset
from pepperscene.dataset.recipe.plan import frame_seed
from pepperscene.errors import InputError, OutputError, WorkerError

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs signals")


@pytest.fixture
def make(build_small):
    def run(out="set", renderer=StandIn, **arguments):
        return build_small(out, renderer=renderer, **arguments)

    return run


@pytest.fixture(scope="module")
def cache():
    return {}


@pytest.fixture
def expected(cache, make, tmp_path):
    """The files of a build in this process."""
    if not cache:
        assert make("serial").made == tuple(range(24))
        cache.update(contents(tmp_path / "serial"))
    return cache


def running_workers():
    """Ids of this process's workers that have not ended."""
    children = (pid for pid, state, parent, *_ in process_fields() if parent == os.getpid() and state != "Z")
    return [pid for pid in children if b"execution.local" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def test_workers_make_the_same_files(make, expected, tmp_path):
    reports = []
    result = make("set", workers=2, on_frame=reports.append)
    assert contents(tmp_path / "set") == expected
    assert result.made == tuple(range(24))
    assert sorted(report.index for report in reports) == list(range(24))
    assert [report.done for report in reports] == list(range(1, 25))
    assert {report.picture.name for report in reports} == {f"{index:06d}.png" for index in range(24)}
    assert len({row["worker"] for row in result.dataset.manifest().to_pylist()}) == 2
    assert not running_workers()
    result = make("set", workers=3)
    assert (result.made, result.kept) == ((), tuple(range(24)))
    assert not running_workers()


def test_lost_worker_is_replaced(make, recipe, expected, tmp_path, monkeypatch):
    monkeypatch.setenv("KILL_SEED", str(frame_seed(recipe.seed, 6)))
    monkeypatch.setenv("KILL_ONCE", str(tmp_path / "once"))
    notices, reports = [], []
    result = make("set", KilledRenderer, workers=2, on_notice=notices.append, on_frame=reports.append)
    assert contents(tmp_path / "set") == expected
    (notice,) = notices
    assert "a worker was lost over frame 00000" in notice
    assert "SIGKILL" in notice
    assert sorted(report.index for report in reports) == sorted(result.made) == list(range(24))


def test_frame_that_ends_every_worker_is_named_and_others_are_kept(
    make, recipe, expected, tmp_path, monkeypatch
):
    monkeypatch.setenv("KILL_SEED", str(frame_seed(recipe.seed, 13)))
    with pytest.raises(WorkerError, match=r"frame 00001[0-3] ended 3 workers.*memory"):
        make("set", KilledRenderer, workers=2)
    dataset = open_dataset(tmp_path / "set")
    assert 13 not in dataset.indices()
    assert all(dataset.intact(index).outputs for index in dataset.indices())
    monkeypatch.delenv("KILL_SEED")
    assert 13 in make("set", workers=2).made
    assert contents(tmp_path / "set") == expected


def test_workers_killed_from_outside_are_replaced(make, expected, tmp_path, monkeypatch):
    monkeypatch.setenv("STAND_IN_S", "0.15")
    monkeypatch.setattr(sys.modules["pepperscene.dataset.execution.executor"], "MAX_LOSSES", 10)
    killed, finished = [], threading.Event()

    def kill_workers():
        while len(killed) < 3 and not finished.wait(0.5):
            for process in running_workers()[:1]:
                os.kill(process, signal.SIGKILL)
                killed.append(process)

    thread = threading.Thread(target=kill_workers, daemon=True)

    def on_frame(progress):
        if progress.done == 1:
            thread.start()

    result = make("set", workers=2, on_frame=on_frame)
    finished.set()
    thread.join()
    assert killed
    assert result.made == tuple(range(24))
    assert contents(tmp_path / "set") == expected


def test_interrupt_ends_the_workers_and_keeps_complete_frames(make, expected, tmp_path, monkeypatch):
    monkeypatch.setenv("STAND_IN_S", "0.1")

    def stop(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make("set", workers=2, on_frame=stop)
    assert not running_workers()
    dataset = open_dataset(tmp_path / "set")
    assert len(dataset.indices()) >= 3
    assert dataset.manifest()["index"].to_pylist() == list(dataset.indices())
    make("set", workers=2)
    assert contents(tmp_path / "set") == expected


def test_out_of_memory_is_reported(make):
    with pytest.raises(WorkerError, match="out of memory"):
        make(renderer=OutOfMemoryRenderer, workers=1)


def test_worker_that_cannot_start_reports_why(make, local_renderer, monkeypatch):
    # Workers import from the same folders.
    monkeypatch.setattr(sys, "path", sys.path[1:])
    with pytest.raises(WorkerError, match="No module named 'only_here'"):
        make(renderer=local_renderer, workers=1)


def test_error_of_a_worker_is_raised_here(make, tmp_path):
    make(frames="0:1", workers=1)
    (tmp_path / "set" / "class" / "000001.png").mkdir()
    with pytest.raises(OutputError, match=r"000001\.png.*cannot be written"):
        make(frames="0:3", workers=1)
    assert 0 in open_dataset(tmp_path / "set").indices()


@pytest.mark.parametrize("number", [0, -1, 2000])
def test_rejects_invalid_number_of_workers(make, tmp_path, number):
    with pytest.raises(InputError, match="workers"):
        make(workers=number)
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(("variable", "threads"), [(None, "1"), ("3", "3")])
def test_workers_share_the_cores(make, monkeypatch, variable, threads):
    monkeypatch.setattr(sys.modules["pepperscene.dataset.execution.local"], "available_cores", lambda: 2)
    monkeypatch.delenv("PEPPERSCENE_THREADS", raising=False)
    if variable is not None:
        monkeypatch.setenv("PEPPERSCENE_THREADS", variable)
    result = make(renderer=ThreadsRenderer, frames="0:1", workers=2)
    assert result.dataset.metadata(0)["threads"] == threads
