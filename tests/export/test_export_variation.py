"""Exports of data sets with drawn values, twins and a rig: columns, and splits of whole moments."""

from __future__ import annotations

import json
import tarfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from varied_set import FRAMES, make_varied_set

from pepperscene.errors import InputError
from pepperscene.export import export_dataset, read_splits, split_by_sets
from pepperscene.recipe.plan import Plan, frames_of_moments, moments

KEYS = ("moment", "twin", "rig_camera", "drawn")


@pytest.fixture(scope="module")
def varied(tmp_path_factory):
    return make_varied_set(tmp_path_factory.mktemp("varied") / "set")


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


@given(plans, st.data())
def test_no_split_separates_frames_of_a_moment(plan, data):
    existing = sorted(data.draw(st.sets(st.integers(0, plan.count - 1), min_size=1)))
    shown = moments(plan, existing)
    number = data.draw(st.integers(1, min(3, len(set(shown.tolist())))))
    fractions = dict.fromkeys(("train", "val", "test")[:number], 1 / number)
    members = split_by_sets(plan.model_dump(), fractions, existing).members(existing)
    assert sorted(index for indices in members.values() for index in indices) == existing
    assert all(members.values())
    per_split = [set(moments(plan, indices).tolist()) for indices in members.values()]
    assert sum(map(len, per_split)) == len(set.union(*per_split))


def test_a_single_scene_is_split_by_moments_of_all_twins():
    plan = {"sets": 1, "rotations": 1, "frames": 10, "twins": 2, "cameras": 2}
    members = read_splits("train=.8,val=.2", plan, range(40)).members(range(40))
    assert members["val"] == (*range(16, 20), *range(36, 40))


def test_fewer_moments_than_splits_and_ranges_through_a_moment_are_errors():
    plan = {"sets": 1, "rotations": 1, "frames": 2, "twins": 2, "cameras": 2}
    with pytest.raises(InputError, match="8 frames of 2 moments cannot make 3 splits"):
        read_splits("train=.5,val=.3,test=.2", plan, range(8))
    with pytest.raises(InputError, match=r"frame 4 in val and frame 0 in train show the same moment"):
        read_splits("train=0:4,val=4:8", plan, range(8))
    # Only frames that exist count.
    assert read_splits("train=0:4,val=4:8", plan, [0, 1, 6, 7]).split_of(6) == "val"


@pytest.mark.slow
def test_coco_images_have_drawn_values(varied, tmp_path):
    export_dataset(varied.folder, "coco", tmp_path / "coco")
    images = json.loads((tmp_path / "coco/annotations/instances_train.json").read_text())["images"]
    assert len(images) == FRAMES
    for image in images:
        metadata = varied.metadata(image["id"])
        assert {key: image[key] for key in KEYS} == {key: metadata[key] for key in KEYS}


@pytest.mark.slow
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


@pytest.mark.slow
def test_webdataset_samples_have_drawn_values(varied, tmp_path):
    export_dataset(varied.folder, "webdataset", tmp_path / "wds")
    with tarfile.open(tmp_path / "wds/train-000000.tar") as shard:
        samples = [json.load(shard.extractfile(m)) for m in shard.getmembers() if m.name.endswith(".json")]
    assert len(samples) == FRAMES
    assert all(np.isfinite(sample["drawn"]["camera.exposure_us"]) for sample in samples)
    assert {sample["rig_camera"] for sample in samples} == {"main", "right"}
