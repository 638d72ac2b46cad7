"""Which frames are made together, and who gets which."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pepperscene.dataset.execution.executor import UnitQueue, work_units
from pepperscene.dataset.recipe.plan import Plan

PLAN = Plan(sets=3, rotations=2, frames=5)


@given(st.sets(st.integers(0, 29), min_size=1), st.integers(1, 12))
def test_units_hold_every_frame_once_and_keep_scenes_apart(indices, workers):
    units = work_units(PLAN, sorted(indices), workers)
    assert [index for unit in units for index in unit.indices] == sorted(indices)
    for unit in units:
        shots = [PLAN.frame(index) for index in unit.indices]
        assert {(shot.set, shot.rotation) for shot in shots} == {(unit.set, unit.rotation)}
    assert len(units) >= min(workers, len(indices))


def test_scenes_are_parted_only_where_somebody_would_stand_idle():
    assert [len(unit.indices) for unit in work_units(PLAN, range(30), 6)] == [5] * 6
    assert sorted(len(unit.indices) for unit in work_units(PLAN, range(5), 4)) == [1, 1, 1, 2]
    assert len(work_units(PLAN, range(2), 8)) == 2


@given(st.lists(st.integers(0, 2), min_size=1, max_size=60))
def test_the_queue_hands_out_every_unit_once(turns):
    units = work_units(PLAN, range(30), 9)
    waiting, last, given_out = UnitQueue(units), dict.fromkeys(range(3)), []
    for worker in turns:
        unit = waiting.next(last[worker])
        last[worker] = unit or last[worker]
        given_out.extend([unit] if unit else [])
    assert len(set(given_out)) == len(given_out) == min(len(turns), len(units))
    assert bool(waiting) == (len(given_out) < len(units))


def test_workers_stay_with_their_set_and_then_help():
    waiting = UnitQueue(work_units(PLAN, range(30), 2))
    first, second = waiting.next(None), waiting.next(None)
    assert (first.set, second.set) == (0, 1)
    sets = []
    while (unit := waiting.next(first)) is not None:
        first = unit
        sets.append(unit.set)
    # Its own set, then the one that nobody has grown yet, at last the second worker's.
    assert sets == [0, 2, 2, 1]


def test_what_is_put_back_comes_again():
    waiting = UnitQueue(work_units(PLAN, range(5), 1))
    unit = waiting.next(None)
    rest = unit.after({0, 1})
    assert rest.indices == (2, 3, 4)
    waiting.put_back(rest)
    assert waiting.next(unit) == rest
    waiting.put_back(rest.after({2, 3, 4}))
    assert not waiting
