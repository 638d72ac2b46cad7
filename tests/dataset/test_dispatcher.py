"""Which frames are made together, and which worker gets which."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.dataset.execution.executor import MAX_LOSSES, Dispatcher, work_units
from pepperscene.dataset.execution.job import FrameDone
from pepperscene.dataset.recipe.plan import Plan
from pepperscene.errors import WorkerError

PLAN = Plan(sets=3, rotations=2, frames=5)


def dispatcher_of(count, workers, on_frame=None, on_notice=None):
    units = work_units(PLAN, range(count), workers)
    return Dispatcher(units, on_frame or (lambda done: None), on_notice or (lambda text: None))


@given(st.sets(st.integers(0, 29), min_size=1), st.integers(1, 12))
def test_units_hold_every_frame_once_and_one_scene_each(indices, workers):
    units = work_units(PLAN, sorted(indices), workers)
    assert [index for unit in units for index in unit.indices] == sorted(indices)
    for unit in units:
        specs = [PLAN.frame(index) for index in unit.indices]
        assert len({(spec.set, spec.rotation) for spec in specs}) == 1
        assert {spec.set for spec in specs} == {unit.set}
    assert len(units) >= min(workers, len(indices))


def test_scenes_are_divided_only_where_workers_would_be_idle():
    assert [len(unit.indices) for unit in work_units(PLAN, range(30), 6)] == [5] * 6
    assert sorted(len(unit.indices) for unit in work_units(PLAN, range(5), 4)) == [1, 1, 1, 2]
    assert len(work_units(PLAN, range(2), 8)) == 2


@given(st.lists(st.integers(0, 2), min_size=1, max_size=60))
def test_every_unit_is_assigned_once(turns):
    units, assigned = work_units(PLAN, range(30), 9), []
    dispatcher = Dispatcher(units, lambda done: None, lambda text: None)
    for worker in turns:
        if worker in dispatcher.running:
            for index in dispatcher.running[worker].indices:
                dispatcher.report(FrameDone(index, True, {}))
            assert dispatcher.release(worker) == ()
        indices = dispatcher.assign(worker)
        assigned.extend([indices] if indices else [])
    assert len(set(assigned)) == len(assigned) == min(len(turns), len(units))
    assert dispatcher.pending == len(units) - len(assigned)


def test_workers_stay_with_their_set_and_then_help():
    dispatcher = dispatcher_of(30, 2)
    assert PLAN.frame(dispatcher.assign("a")[0]).set == 0
    assert PLAN.frame(dispatcher.assign("b")[0]).set == 1
    sets = []
    while True:
        for index in dispatcher.running["a"].indices:
            dispatcher.report(FrameDone(index, True, {}))
        dispatcher.release("a")
        if not (indices := dispatcher.assign("a")):
            break
        sets.append(PLAN.frame(indices[0]).set)
    # Its own set, then the one that nobody has started, at last the second worker's.
    assert sets == [0, 2, 2, 1]


def test_the_rest_of_a_lost_workers_unit_is_assigned_again():
    reported, notices = [], []
    dispatcher = dispatcher_of(5, 1, lambda done: reported.append(done.index), notices.append)
    assert dispatcher.assign("a") == (0, 1, 2, 3, 4)
    assert dispatcher.assign("b") == ()
    for index in (0, 1, 1):
        dispatcher.report(FrameDone(index, True, {}))
    assert reported == [0, 1]
    assert not dispatcher.is_complete("a")
    dispatcher.lose("a", "killed")
    assert "frame 000002 (killed)" in notices[0]
    assert dispatcher.assign("b") == (2, 3, 4)
    # The first worker was not lost after all.
    for index in (2, 3, 4):
        dispatcher.report(FrameDone(index, True, {}))
    assert dispatcher.is_complete("b")
    dispatcher.lose("b", "killed")
    assert (len(notices), bool(dispatcher)) == (1, False)


def test_a_frame_that_ends_three_workers_is_an_error():
    dispatcher = dispatcher_of(5, 1)
    for _ in range(MAX_LOSSES - 1):
        dispatcher.assign("a")
        dispatcher.lose("a", "killed")
    dispatcher.assign("a")
    with pytest.raises(WorkerError, match="frame 000000 ended 3 workers, the last one killed"):
        dispatcher.lose("a", "killed")
