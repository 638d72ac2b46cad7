"""Splits: every frame in one place, no plant in two where that can be."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepperscene.dataset.export import Splits, read_splits, split_by_sets
from pepperscene.errors import InputError

PLAN = {"sets": 6, "rotations": 7, "frames": 250}
NAMES = ("train", "val", "test", "spare")


@st.composite
def asked(draw):
    """A plan, the frames of it that are there, and shares."""
    plan = {key: draw(st.integers(1, 7)) for key in PLAN}
    count = plan["sets"] * plan["rotations"] * plan["frames"]
    there = sorted(draw(st.sets(st.integers(0, count - 1), min_size=1, max_size=60)))
    weights = draw(st.lists(st.integers(1, 20), min_size=1, max_size=min(4, len(there))))
    return plan, there, {name: one / sum(weights) for name, one in zip(NAMES, weights, strict=False)}


@given(asked())
def test_every_frame_has_one_split_and_plants_stay_together(case):
    plan, there, shares = case
    splits = split_by_sets(plan, shares, there)
    members = splits.members(there)
    assert list(members) == list(shares)
    assert sorted(index for of in members.values() for index in of) == there
    assert all(members.values())

    a_scene, a_set = plan["frames"], plan["frames"] * plan["rotations"]
    for size in (a_set, a_scene, 1):
        if len({index // size for index in there}) < len(shares):
            continue
        homes = {}
        for index in there:
            homes.setdefault(index // size, set()).add(splits.named(index))
        assert all(len(home) == 1 for home in homes.values())
        # A border lies as near to its share as whole units allow, unless a split would be left empty.
        most = max(sum(index // size == unit for index in there) for unit in homes)
        total = wanted = 0.0
        if len(homes) > 10 * len(shares):
            for name, share in shares.items():
                total, wanted = total + len(members[name]), wanted + share * len(there)
                slack = len(shares) * most
                assert abs(total - wanted) <= slack
        break


def test_whole_sets_go_to_one_split_though_shares_suffer():
    splits = split_by_sets(PLAN, {"train": 0.8, "val": 0.1, "test": 0.1})
    sizes = {name: len(of) for name, of in splits.members(range(10_500)).items()}
    assert sizes == {"train": 4 * 1750, "val": 1750, "test": 1750}
    many = split_by_sets({"sets": 40, "rotations": 5, "frames": 50}, {"train": 0.8, "val": 0.1, "test": 0.1})
    sizes = {name: len(of) for name, of in many.members(range(10_000)).items()}
    assert sizes == {"train": 8000, "val": 1000, "test": 1000}


def test_a_single_scene_is_cut_into_runs_of_the_path():
    splits = split_by_sets({"sets": 1, "rotations": 1, "frames": 100}, {"train": 0.75, "val": 0.25})
    assert splits.ranges == (("train", range(75)), ("val", range(75, 100)))


def test_ranges_are_half_open_and_leave_the_rest_out():
    text = " train = :100, val=100:150, train=200:"
    splits = read_splits(text, PLAN, range(10_500))
    assert splits.names == ("train", "val")
    named = [splits.named(index) for index in (0, 99, 100, 149, 150, 199, 200, 10_499)]
    assert named == ["train", "train", "val", "val", "", "", "train", "train"]
    assert len(splits.members(range(10_500))["train"]) == 100 + 10_300


def test_all_is_for_training_when_nothing_is_said():
    assert read_splits(None, PLAN, (3,)) == Splits()
    assert Splits().named(999_999) == "train"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "must be NAME=SHARE or NAME=A:B"),
        ("train", "must be NAME=SHARE or NAME=A:B"),
        ("Train=1", "lower-case"),
        ("../x=1", "lower-case"),
        ("train=.8,val=.1", "sum to 0.9"),
        ("train=.5,train=.5", "two shares"),
        ("train=0,val=1", "above 0"),
        ("train=.,val=1", "above 0"),
        ("train=nan", "above 0"),
        ("train=1e9", "above 0"),
        ("train=.5,val=0:5", "either shares or ranges"),
        ("train=0:10,val=9:20", "train and val overlap: frame 9"),
        ("val=5:6,train=0:10", "train and val overlap: frame 5"),
        ("train=5:5", "0 <= A < B <= 10500"),
        ("train=0:10501", "0 <= A < B <= 10500"),
        ("train=-1:5", "0 <= A < B <= 10500"),
        ("train=0:5,val=9000:9001", "val would hold none of the 20 frames"),
    ],
)
def test_what_makes_no_splits_is_told(text, told):
    with pytest.raises(InputError, match="split") as fault:
        read_splits(text, PLAN, range(20))
    assert told in str(fault.value)


def test_more_splits_than_frames_are_told():
    with pytest.raises(InputError, match="2 frames cannot make 3 splits"):
        read_splits("train=.8,val=.1,test=.1", PLAN, (4, 9))
    with pytest.raises(ValueError, match="cannot make"):
        split_by_sets(PLAN, {"train": 0.5, "val": 0.5}, [7])
    with pytest.raises(ValueError, match="sum to 1"):
        split_by_sets(PLAN, {"train": 0.5})
