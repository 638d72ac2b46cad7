"""The plan numbers every frame; seeds and random generators follow from these numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.errors import InputError
from pepperscene.recipe.plan import Plan, Stream, frame_seed, random_generator, rotate_row

PAPER = Plan(sets=6, rotations=7, frames=250)
COUNTS = st.integers(1, 12)


@given(COUNTS, COUNTS, COUNTS)
def test_indices_count_steps_then_rotations_then_sets(sets, rotations, frames):
    plan = Plan(sets=sets, rotations=rotations, frames=frames)
    specs = [plan.frame(index) for index in range(plan.count)]
    assert [(spec.set, spec.rotation, spec.step) for spec in specs] == [
        (s, r, f) for s in range(sets) for r in range(rotations) for f in range(frames)
    ]
    assert [spec.index for spec in specs] == list(range(plan.count))


def test_published_plan_has_10500_frames():
    assert PAPER.count == 10_500
    spec = PAPER.frame(6137)
    assert (spec.set, spec.rotation, spec.step) == (3, 3, 137)
    for index in (-1, 10_500):
        with pytest.raises(ValueError, match="must be between 0 and 10499"):
            PAPER.frame(index)


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        ("0:3", (0, 1, 2)), (":2", (0, 1)), ("10498:", (10498, 10499)), ("6137:6138", (6137,)),
        ([7, 3, 7], (3, 7)), (None, tuple(range(10_500))),
    ],
)  # fmt: skip
def test_selects_ranges_lists_or_all_frames(frames, expected):
    assert PAPER.select_indices(frames) == expected


@pytest.mark.parametrize(
    "frames",
    ["", "5", "3:3", "4:2", "-1:2", "0:10501", "a:b", "1:2:3", "٣:٤", [], [10_500], [-1]],
)  # fmt: skip
def test_rejects_invalid_selection(frames):
    with pytest.raises(InputError, match="frames"):
        PAPER.select_indices(frames)


def test_default_frames_are_those_of_the_plan():
    assert Plan(sets=1, rotations=1, frames=9, select=(8, 2)).select_indices(None) == (2, 8)


@given(st.integers(0, 9), st.integers(0, 20))
def test_rotation_moves_every_plant_by_its_number(count, rotation):
    row = rotate_row(list(range(count)), rotation)
    assert sorted(row) == list(range(count))
    assert all(row[(plant + rotation) % count] == plant for plant in range(count))


def test_random_streams_are_reproducible_and_independent():
    first = random_generator(1, Stream.PLANT, 2, 3).random(8)
    np.testing.assert_array_equal(first, random_generator(1, Stream.PLANT, 2, 3).random(8))
    for seed, *address in (
        (2, Stream.PLANT, 2, 3), (1, Stream.TWINE, 2, 3), (1, Stream.PLANT, 3, 2), (1, Stream.SKY, 2),
    ):  # fmt: skip
        assert not np.isclose(first, random_generator(seed, *address).random(8)).any()


def test_frame_seeds_have_32_bits_and_differ_between_frames_and_recipes():
    seeds = [frame_seed(2018, index) for index in range(500)]
    assert len(set(seeds)) == 500
    assert all(0 <= seed < 2**32 for seed in seeds)
    assert frame_seed(2019, 0) != seeds[0]
