"""Dispatch of frames to workers, and worker processes, which make the same files as this process."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from data_sets import contents
from hypothesis import given
from hypothesis import strategies as st
from stand_in import KilledRenderer, OutOfMemoryRenderer, ThreadsRenderer, process_fields

from pepperscene.building.execution.executor import MAX_LOSSES, Dispatcher, work_units
from pepperscene.building.execution.job import FrameDone
from pepperscene.dataset.store.dataset import open_dataset
from pepperscene.errors import InputError, OutputError, WorkerError
from pepperscene.recipe.plan import Plan, frame_seed

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs signals")
PLAN = Plan(sets=3, rotations=2, frames=5)


def dispatcher_of(count, workers, on_frame=lambda done: None, on_notice=lambda text: None):
    return Dispatcher(work_units(PLAN, range(count), workers), on_frame, on_notice)


def report(dispatcher, indices):
    for index in indices:
        dispatcher.report(FrameDone(index, True, {}))


def finish(dispatcher, worker):
    report(dispatcher, dispatcher.running[worker].indices)
    assert dispatcher.release(worker) == ()


@given(st.sets(st.integers(0, 29), min_size=1), st.integers(1, 12))
def test_every_frame_is_in_one_unit_of_one_scene(indices, workers):
    units = work_units(PLAN, sorted(indices), workers)
    assert [index for unit in units for index in unit.indices] == sorted(indices)
    for unit in units:
        specs = [PLAN.frame(index) for index in unit.indices]
        assert len({(spec.set, spec.rotation) for spec in specs}) == 1
        assert {spec.set for spec in specs} == {unit.set}
    assert len(units) >= min(workers, len(indices))


@pytest.mark.parametrize(
    ("frames", "workers", "sizes"), [(30, 6, [5] * 6), (5, 4, [1, 1, 1, 2]), (2, 8, [1, 1])]
)
def test_scenes_are_divided_only_if_workers_would_be_idle(frames, workers, sizes):
    assert sorted(len(unit.indices) for unit in work_units(PLAN, range(frames), workers)) == sizes


@given(st.lists(st.integers(0, 2), min_size=1, max_size=60))
def test_every_unit_is_assigned_once(workers):
    dispatcher, assigned = dispatcher_of(30, 9), []
    count = dispatcher.pending
    for worker in workers:
        if worker in dispatcher.running:
            finish(dispatcher, worker)
        indices = dispatcher.assign(worker)
        assigned.extend([indices] if indices else [])
    assert len(set(assigned)) == len(assigned) == min(len(workers), count)
    assert dispatcher.pending == count - len(assigned)


def test_workers_finish_their_set_before_they_help_with_others():
    dispatcher = dispatcher_of(30, 2)
    assert PLAN.frame(dispatcher.assign("a")[0]).set == 0
    assert PLAN.frame(dispatcher.assign("b")[0]).set == 1
    sets = []
    finish(dispatcher, "a")
    while indices := dispatcher.assign("a"):
        sets.append(PLAN.frame(indices[0]).set)
        finish(dispatcher, "a")
    # The first set, then the one that no worker has started, then the second worker's.
    assert sets == [0, 2, 2, 1]


def test_unfinished_frames_of_a_lost_worker_are_assigned_again():
    reported, notices = [], []
    dispatcher = dispatcher_of(5, 1, lambda done: reported.append(done.index), notices.append)
    assert dispatcher.assign("a") == (0, 1, 2, 3, 4)
    assert dispatcher.assign("b") == ()
    report(dispatcher, (0, 1, 1))
    assert reported == [0, 1]
    assert not dispatcher.is_complete("a")
    dispatcher.lose("a", "killed")
    assert "frame 000002 (killed)" in notices[0]
    assert dispatcher.assign("b") == (2, 3, 4)
    # The first worker was not lost after all.
    report(dispatcher, (2, 3, 4))
    assert dispatcher.is_complete("b")
    dispatcher.lose("b", "killed")
    assert (len(notices), bool(dispatcher)) == (1, False)


def test_frame_that_ends_three_workers_is_an_error():
    dispatcher = dispatcher_of(5, 1)
    for _ in range(MAX_LOSSES - 1):
        dispatcher.assign("a")
        dispatcher.lose("a", "killed")
    dispatcher.assign("a")
    with pytest.raises(WorkerError, match="frame 000000 ended 3 workers, the last one killed"):
        dispatcher.lose("a", "killed")


@pytest.fixture(scope="module")
def cache():
    return {}


@pytest.fixture
def expected(cache, build_small, tmp_path):
    """The files of a build in this process."""
    if not cache:
        assert build_small("serial").made == tuple(range(24))
        cache.update(contents(tmp_path / "serial"))
    return cache


def running_workers():
    """Ids of this process's workers that have not ended."""
    children = (pid for pid, state, parent, *_ in process_fields() if parent == os.getpid() and state != "Z")
    return [pid for pid in children if b"execution.local" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def test_workers_make_the_same_files(build_small, expected, tmp_path):
    reports = []
    result = build_small(workers=2, on_frame=reports.append)
    assert contents(tmp_path / "set") == expected
    assert result.made == tuple(range(24))
    assert sorted(report.index for report in reports) == list(range(24))
    assert [report.done for report in reports] == list(range(1, 25))
    assert {report.picture.name for report in reports} == {f"{index:06d}.png" for index in range(24)}
    assert len({row["worker"] for row in result.dataset.manifest().to_pylist()}) == 2
    assert not running_workers()
    result = build_small(workers=3)
    assert (result.made, result.kept) == ((), tuple(range(24)))
    assert not running_workers()


def test_lost_worker_is_replaced(build_small, recipe, expected, tmp_path, monkeypatch):
    monkeypatch.setenv("KILL_SEED", str(frame_seed(recipe.seed, 6)))
    monkeypatch.setenv("KILL_ONCE", str(tmp_path / "once"))
    notices, reports = [], []
    result = build_small(
        "set", renderer=KilledRenderer, workers=2, on_notice=notices.append, on_frame=reports.append
    )
    assert contents(tmp_path / "set") == expected
    (notice,) = notices
    assert "a worker was lost over frame 00000" in notice
    assert "SIGKILL" in notice
    assert sorted(report.index for report in reports) == sorted(result.made) == list(range(24))


@pytest.mark.long
def test_frame_that_ends_every_worker_is_named_and_others_are_kept(
    build_small, recipe, expected, tmp_path, monkeypatch
):
    monkeypatch.setenv("KILL_SEED", str(frame_seed(recipe.seed, 13)))
    with pytest.raises(WorkerError, match=r"frame 00001[0-3] ended 3 workers.*memory"):
        build_small(renderer=KilledRenderer, workers=2)
    dataset = open_dataset(tmp_path / "set")
    assert 13 not in dataset.indices()
    assert all(dataset.intact(index).outputs for index in dataset.indices())
    monkeypatch.delenv("KILL_SEED")
    assert 13 in build_small(workers=2).made
    assert contents(tmp_path / "set") == expected


@pytest.mark.long
def test_interrupt_ends_the_workers_and_keeps_complete_frames(build_small, expected, tmp_path, monkeypatch):
    monkeypatch.setenv("STAND_IN_S", "0.1")

    def stop(progress):
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_small(workers=2, on_frame=stop)
    assert not running_workers()
    dataset = open_dataset(tmp_path / "set")
    assert len(dataset.indices()) >= 3
    assert dataset.manifest()["index"].to_pylist() == list(dataset.indices())
    build_small()
    assert contents(tmp_path / "set") == expected


def test_out_of_memory_is_reported(build_small):
    with pytest.raises(WorkerError, match="out of memory"):
        build_small(renderer=OutOfMemoryRenderer, workers=1)


def test_worker_that_cannot_start_reports_why(build_small, local_renderer, monkeypatch):
    # Workers import from the same folders.
    monkeypatch.setattr(sys, "path", sys.path[1:])
    with pytest.raises(WorkerError, match="No module named 'only_here'"):
        build_small(renderer=local_renderer, workers=1)


def test_error_of_a_worker_is_raised_here(build_small, tmp_path):
    build_small(frames="0:1")
    (tmp_path / "set" / "class" / "000001.png").mkdir()
    with pytest.raises(OutputError, match=r"000001\.png.*cannot be written"):
        build_small(frames="0:3", workers=1)
    assert 0 in open_dataset(tmp_path / "set").indices()


def test_rejects_invalid_number_of_workers(build_small, tmp_path):
    for number in (0, -1, 2000):
        with pytest.raises(InputError, match="workers"):
            build_small(workers=number)
    assert not (tmp_path / "set").exists()


@pytest.mark.long
@pytest.mark.parametrize(("variable", "threads"), [(None, "1"), ("3", "3")])
def test_workers_share_the_cores(build_small, monkeypatch, variable, threads):
    monkeypatch.setattr(sys.modules["pepperscene.building.execution.executor"], "available_cores", lambda: 2)
    monkeypatch.delenv("PEPPERSCENE_THREADS", raising=False)
    if variable is not None:
        monkeypatch.setenv("PEPPERSCENE_THREADS", variable)
    result = build_small(renderer=ThreadsRenderer, frames="0:1", workers=2)
    assert result.dataset.metadata(0)["threads"] == threads
