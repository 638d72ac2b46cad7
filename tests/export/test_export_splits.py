"""Splits: every frame in one, and no plant in two if possible; sets with drawn values, twins and a rig."""

from __future__ import annotations

import json
import tarfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from label_set import load_coco
from varied_set import FRAMES, make_varied_set

from pepperscene.dataset.splits import shared_plants
from pepperscene.errors import InputError
from pepperscene.export import Splits, export_dataset, read_splits, split_by_sets
from pepperscene.recipe.plan import Plan, frames_of_moments, moments

PLAN = {"sets": 6, "rotations": 7, "frames": 250}
NAMES = ("train", "val", "test", "spare")


@st.composite
def split_cases(draw):
    """A plan, its existing frames, and fractions."""
    plan = {key: draw(st.integers(1, 7)) for key in PLAN}
    count = plan["sets"] * plan["rotations"] * plan["frames"]
    existing = sorted(draw(st.sets(st.integers(0, count - 1), min_size=1, max_size=60)))
    weights = draw(st.lists(st.integers(1, 20), min_size=1, max_size=min(4, len(existing))))
    return plan, existing, {name: weight / sum(weights) for name, weight in zip(NAMES, weights, strict=False)}


@given(split_cases())
def test_every_frame_has_one_split_and_plants_stay_together(case):
    plan, existing, fractions = case
    splits = split_by_sets(plan, fractions, existing)
    members = splits.members(existing)
    assert list(members) == list(fractions)
    assert sorted(index for indices in members.values() for index in indices) == existing
    assert all(members.values())

    # The largest units of which every split can get one are not divided.
    sizes = (plan["frames"] * plan["rotations"], plan["frames"], 1)
    size = next(size for size in sizes if len({index // size for index in existing}) >= len(fractions))
    splits_of = {}
    for index in existing:
        splits_of.setdefault(index // size, set()).add(splits.split_of(index))
    assert all(len(names) == 1 for names in splits_of.values())
    # Borders are as near to their fraction as whole units allow, unless a split would be empty.
    if len(splits_of) > 10 * len(fractions):
        largest = max(sum(index // size == unit for index in existing) for unit in splits_of)
        total = expected = 0.0
        for name, fraction in fractions.items():
            total, expected = total + len(members[name]), expected + fraction * len(existing)
            assert abs(total - expected) <= len(fractions) * largest


def test_whole_sets_go_to_one_split_although_fractions_differ():
    fractions = {"train": 0.8, "val": 0.1, "test": 0.1}
    splits = split_by_sets(PLAN, fractions)
    sizes = {name: len(indices) for name, indices in splits.members(range(10_500)).items()}
    assert sizes == {"train": 4 * 1750, "val": 1750, "test": 1750}
    many = split_by_sets({"sets": 40, "rotations": 5, "frames": 50}, fractions)
    sizes = {name: len(indices) for name, indices in many.members(range(10_000)).items()}
    assert sizes == {"train": 8000, "val": 1000, "test": 1000}


def test_single_scene_is_split_into_ranges_of_the_path():
    splits = split_by_sets({"sets": 1, "rotations": 1, "frames": 100}, {"train": 0.75, "val": 0.25})
    assert splits.ranges == (("train", range(75)), ("val", range(75, 100)))


def test_ranges_are_half_open_and_omit_the_rest():
    splits = read_splits(" train = :100, val=100:150, train=200:", PLAN, range(10_500))
    names = [splits.split_of(index) for index in (0, 99, 100, 149, 150, 199, 200, 10_499)]
    assert names == ["train", "train", "val", "val", "", "", "train", "train"]
    members = splits.members(range(10_500))
    assert list(members) == ["train", "val"]
    assert len(members["train"]) == 100 + 10_300


def test_default_split_is_train():
    assert read_splits(None, PLAN, (3,)) == Splits()
    assert Splits().split_of(999_999) == "train"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must be NAME=FRACTION or NAME=A:B"),
        ("train", "must be NAME=FRACTION or NAME=A:B"),
        ("../x=1", "lower-case"),
        ("train=.8,val=.1", "sum to 0.9"),
        ("train=.5,train=.5", "two fractions"),
        ("train=0,val=1", "above 0"),
        ("train=.,val=1", "above 0"),
        ("train=nan", "above 0"),
        ("train=1e9", "above 0"),
        ("train=.5,val=0:5", "either fractions or ranges"),
        ("train=0:10,val=9:20", "train and val overlap: frame 9"),
        ("val=5:6,train=0:10", "train and val overlap: frame 5"),
        ("train=5:5", "0 <= A < B <= 10500"),
        ("train=0:10501", "0 <= A < B <= 10500"),
        ("train=-1:5", "0 <= A < B <= 10500"),
        ("train=0:5,val=9000:9001", "val would hold none of the 20 frames"),
    ],
)
def test_rejects_invalid_text(text, message):
    with pytest.raises(InputError, match="split") as error:
        read_splits(text, PLAN, range(20))
    assert message in str(error.value)


def test_rejects_more_splits_than_frames_or_moments():
    with pytest.raises(InputError, match="2 frames cannot make 3 splits"):
        read_splits("train=.8,val=.1,test=.1", PLAN, (4, 9))
    with pytest.raises(ValueError, match="sum to 1"):
        split_by_sets(PLAN, {"train": 0.5})
    plan = {"sets": 1, "rotations": 1, "frames": 2, "twins": 2, "cameras": 2}
    with pytest.raises(InputError, match="8 frames of 2 moments cannot make 3 splits"):
        read_splits("train=.5,val=.3,test=.2", plan, range(8))
    with pytest.raises(InputError, match=r"frame 4 in val and frame 0 in train show the same moment"):
        read_splits("train=0:4,val=4:8", plan, range(8))
    # Only frames that exist count.
    assert read_splits("train=0:4,val=4:8", plan, [0, 1, 6, 7]).split_of(6) == "val"


@given(split_cases(), st.integers(1, 3), st.integers(1, 3))
def test_fractions_never_divide_a_moment_and_a_warning_names_shared_plants(case, twins, cameras):
    plan, moments, fractions = case
    plan = {**plan, "twins": twins, "cameras": cameras}
    # All frames of these moments exist; the twins of a scene follow each other, and the cameras of a frame.
    views = {}
    for moment in moments:
        scene, step = divmod(moment, plan["frames"])
        for twin in range(twins):
            first = ((scene * twins + twin) * plan["frames"] + step) * cameras
            views |= dict.fromkeys(range(first, first + cameras), moment)
    existing = sorted(views)
    text = ",".join(f"{name}={fraction:.9f}" for name, fraction in fractions.items())
    members = read_splits(text, plan, existing).members(existing)
    assert sorted(index for indices in members.values() for index in indices) == existing
    seen = {name: {views[index] for index in indices} for name, indices in members.items()}

    # The warning agrees with a count of its own: moments, scenes and sets of plants, by split.
    scenes = {name: {moment // plan["frames"] for moment in found} for name, found in seen.items()}
    sets = {name: {scene // plan["rotations"] for scene in found} for name, found in scenes.items()}

    def is_shared(units):
        return len(set().union(*units.values())) < sum(map(len, units.values()))

    assert not is_shared(seen)
    warning = shared_plants(members, plan)
    assert bool(warning) == is_shared(sets)
    assert ("from other places" in warning) == is_shared(scenes)
    if len(set().union(*sets.values())) >= len(fractions):
        assert warning == ""


@pytest.mark.parametrize(
    ("members", "warning"),
    [
        ({"train": range(500), "val": range(1750, 1800)}, ""),
        ({"train": range(1750)}, ""),
        (
            {"train": range(200), "val": range(200, 250)},
            "train and val show the same plants from other places: 2 splits have 1 set of plants;"
            " a plan with more sets keeps them apart",
        ),
        (
            {"train": range(250), "val": range(250, 500)},
            "train and val show the same plants in another order: 2 splits have 1 set of plants;"
            " a plan with more sets keeps them apart",
        ),
        (
            {"train": range(1750), "val": range(1700, 1760), "test": range(3500, 3600)},
            "train and val show the same plants from other places: 3 splits have 3 sets of plants;"
            " fractions keep them apart",
        ),
    ],
)
def test_warning_says_which_splits_share_plants_and_what_helps(members, warning):
    assert shared_plants(members, PLAN) == warning


# Moments of recipes with twins and a rig.

plans = st.builds(
    Plan, **{name: st.integers(1, 4) for name in ("sets", "rotations", "frames", "twins", "cameras")}
)


@given(plans)
def test_moments_are_those_of_the_plan(plan):
    expected = [plan.frame(index).moment for index in range(plan.count)]
    assert moments(plan, range(plan.count)).tolist() == expected


@given(plans, st.data())
def test_ranges_of_moments_hold_all_of_their_frames(plan, data):
    count = plan.sets * plan.rotations * plan.frames
    first = data.draw(st.integers(0, count))
    end = data.draw(st.integers(first, count))
    found = [index for indices in frames_of_moments(plan, first, end) for index in indices]
    assert found == [i for i in range(plan.count) if first <= plan.frame(i).moment < end]


def test_a_single_scene_is_split_by_moments_of_all_twins():
    plan = {"sets": 1, "rotations": 1, "frames": 10, "twins": 2, "cameras": 2}
    members = read_splits("train=.8,val=.2", plan, range(40)).members(range(40))
    assert members["val"] == (*range(16, 20), *range(36, 40))


# Records of drawn values.

KEYS = ("moment", "twin", "rig_camera", "drawn")


@pytest.fixture(scope="module")
def varied(tmp_path_factory):
    return make_varied_set(tmp_path_factory.mktemp("varied") / "set")


def test_coco_images_have_drawn_values(varied, tmp_path):
    export_dataset(varied.folder, "coco", tmp_path / "coco")
    images = load_coco(tmp_path / "coco")["images"]
    assert len(images) == FRAMES
    for image in images:
        metadata = varied.metadata(image["id"])
        assert {key: image[key] for key in KEYS} == {key: metadata[key] for key in KEYS}


def test_huggingface_rows_have_drawn_values(varied, tmp_path):
    from pyarrow import parquet

    export_dataset(varied.folder, "huggingface", tmp_path / "hf")
    rows = parquet.read_table(tmp_path / "hf/data").to_pylist()
    for index, row in enumerate(rows):
        metadata = varied.metadata(index)
        assert {key: row[key] for key in KEYS[:3]} == {key: metadata[key] for key in KEYS[:3]}
        assert json.loads(row["drawn"]) == metadata["drawn"]
    card = (tmp_path / "hf/README.md").read_text()
    assert all(f"| `{key}` |" in card for key in KEYS)


def test_webdataset_samples_have_drawn_values(varied, tmp_path):
    export_dataset(varied.folder, "webdataset", tmp_path / "wds")
    with tarfile.open(tmp_path / "wds/train-000000.tar") as shard:
        samples = [json.load(shard.extractfile(m)) for m in shard.getmembers() if m.name.endswith(".json")]
    assert len(samples) == FRAMES
    assert all(np.isfinite(sample["drawn"]["camera.exposure_us"]) for sample in samples)
    assert {sample["rig_camera"] for sample in samples} == {"main", "right"}


def test_cameras_of_a_rig_and_twins_are_sequences(varied, tmp_path):
    out = export_dataset(varied.folder, "rgbd", tmp_path / "out").folder
    assert len(list(out.iterdir())) == 2 * 2 * 2  # sets, twins, cameras
    files = sorted((out / "set_001_rotation_000_twin_1_camera_1" / "rgb").iterdir())
    assert len(files) == 3
    for file in files:
        metadata = varied.metadata(int(file.stem))
        assert (metadata["set"], metadata["twin"], metadata["rig_camera"]) == (1, 1, "right")
