from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.dataset.recipe.plan import Plan, Stream, frame_seed, random_generator, rotated
from pepperscene.errors import InputError

PAPER = Plan(sets=6, rotations=7, frames=250)
small = st.integers(1, 12)


@given(small, small, small)
def test_every_frame_of_the_plan_has_exactly_one_index(sets, rotations, frames):
    plan = Plan(sets=sets, rotations=rotations, frames=frames)
    shots = [plan.frame(index) for index in range(plan.count)]
    addresses = [(shot.set, shot.rotation, shot.step) for shot in shots]
    # Ascending indices go through the steps first, then the rotations, then the sets.
    assert addresses == [(s, r, f) for s in range(sets) for r in range(rotations) for f in range(frames)]
    assert [shot.index for shot in shots] == list(range(plan.count))


def test_the_papers_plan_has_10500_frames():
    assert PAPER.count == 10_500
    shot = PAPER.frame(6137)
    assert (shot.set * 7 + shot.rotation) * 250 + shot.step == 6137
    assert (shot.set, shot.rotation, shot.step) == (3, 3, 137)


@pytest.mark.parametrize("index", [-1, 10_500])
def test_an_index_outside_the_plan_is_refused(index):
    with pytest.raises(ValueError, match="outside"):
        PAPER.frame(index)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("0:3", (0, 1, 2)), (":2", (0, 1)), ("10498:", (10498, 10499)), ("6137:6138", (6137,))],
)
def test_ranges(text, expected):
    assert PAPER.select_indices(text) == expected


@pytest.mark.parametrize(
    "text",
    ["", "5", "3:3", "4:2", "-1:2", "0:10501", "a:b", "1:2:3", "1.5:2", "٣:٤", "1:" + "9" * 30, "0 : 2"],
)
def test_wrong_ranges_are_refused(text):
    with pytest.raises(InputError, match="frames"):
        PAPER.select_indices(text)


def test_lists_of_indices_are_sorted_and_checked():
    assert PAPER.select_indices([7, 3, 7]) == (3, 7)
    for wrong in ([], [10_500], [-1]):
        with pytest.raises(InputError):
            PAPER.select_indices(wrong)


def test_default_frames_are_the_selected_ones_or_all():
    assert PAPER.select_indices(None) == tuple(range(10_500))
    assert Plan(sets=1, rotations=1, frames=9, select=(8, 2)).select_indices(None) == (2, 8)


@given(st.integers(1, 9), st.integers(0, 20))
def test_position_p_holds_plant_p_minus_rotation(count, rotation):
    row = rotated(list(range(count)), rotation)
    assert sorted(row) == list(range(count))
    assert all(row[(plant + rotation) % count] == plant for plant in range(count))


def test_an_empty_row_stays_empty():
    assert rotated([], 3) == []


def test_streams_are_repeatable_and_apart():
    first = random_generator(1, Stream.PLANT, 2, 3).random(8)
    np.testing.assert_array_equal(first, random_generator(1, Stream.PLANT, 2, 3).random(8))
    others = [
        random_generator(2, Stream.PLANT, 2, 3),
        random_generator(1, Stream.TWINE, 2, 3),
        random_generator(1, Stream.PLANT, 3, 2),
        random_generator(1, Stream.SKY, 2),
    ]
    assert all(not np.isclose(first, other.random(8)).any() for other in others)


def test_frame_seeds_are_32_bit_and_differ_between_neighbours_and_recipes():
    seeds = [frame_seed(2018, index) for index in range(500)]
    assert len(set(seeds)) == 500
    assert all(0 <= seed < 2**32 for seed in seeds)
    assert frame_seed(2019, 0) != seeds[0]
