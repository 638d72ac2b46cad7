"""Grouping of frames into units, and their assignment to workers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.dataset.execution.executor import MAX_LOSSES, Dispatcher, work_units
from pepperscene.dataset.execution.job import FrameDone
from pepperscene.dataset.recipe.plan import Plan
from pepperscene.errors import WorkerError

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
