"""COCO: pycocotools loads it, finds the masks again, and evaluates a perfect prediction to AP 1."""

from __future__ import annotations

import contextlib
import io
import json
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from painted_set import ALL, FRAMES, WIRE

from pepperscene.classes import OrganClass
from pepperscene.dataset import read_image
from pepperscene.dataset.export import export_dataset
from pepperscene.dataset.export.segments import all_run_lengths
from pepperscene.truth.encodings import decode_rle

mask_tools = pytest.importorskip("pycocotools.mask", reason="the extra `export` brings pycocotools")

# pycocotools 2.0.11 decodes masks in a way that NumPy 2 tolerates for now.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

from pycocotools.coco import COCO  # noqa: E402
from pycocotools.cocoeval import COCOeval  # noqa: E402


@pytest.fixture(scope="module")
def made(painted):
    return painted


@pytest.fixture(scope="module")
def out(made, tmp_path_factory):
    return export_dataset(
        made.folder, "coco", tmp_path_factory.mktemp("out") / "out", "train=.6,val=.4"
    ).folder


def loaded(path):
    with contextlib.redirect_stdout(io.StringIO()):
        return COCO(path)


@pytest.fixture(scope="module")
def truth(out):
    return loaded(out / "annotations" / "instances_train.json")


def organs(made, index):
    """What the frame's JSON tells of the organs of plants, by instance."""
    told = made.metadata(index)["instances"].items()
    return {int(value): one for value, one in told if one["class"] and one["plant"] >= 0}


def test_pycocotools_finds_every_organ_again(made, out, truth):
    assert sorted(truth.imgs) == list(FRAMES[:4])
    assert {one["id"]: one["name"] for one in truth.cats.values()} == {
        int(one): one.name.lower() for one in OrganClass if one
    }
    for index, image in truth.imgs.items():
        picture = read_image(out / "train" / image["file_name"])
        assert (picture == made.image(index, "colour")).all()
        assert (image["height"], image["width"]) == picture.shape[:2]
        instance, wanted = made.image(index, "instance"), organs(made, index)
        # More than a byte counts, which pycocotools 2.0 trips over under NumPy 2.
        assert len(wanted) > 255
        found = truth.imgToAnns[index]
        things = [one for one in found if not one["iscrowd"]]
        assert sorted(one["attributes"]["instance"] for one in things) == sorted(wanted)
        for one in things:
            told = wanted[one["attributes"]["instance"]]
            mask = truth.annToMask(one).astype(bool)
            assert (mask == (instance == one["attributes"]["instance"])).all()
            assert one["category_id"] == told["class"]
            assert {key: one["attributes"][key] for key in ("kind", "plant", "phytomer")} == {
                key: told[key] for key in ("kind", "plant", "phytomer")
            }
            assert one["area"] == mask.sum() == mask_tools.area(one["segmentation"])
            rows, columns = np.nonzero(mask)
            size = [np.ptp(columns) + 1, np.ptp(rows) + 1]
            assert one["bbox"] == [columns.min(), rows.min(), *size]


def test_a_parent_is_the_annotation_of_what_bears_the_organ(made, truth):
    parents = 0
    for one in truth.anns.values():
        if one["iscrowd"]:
            continue
        wanted = organs(made, one["image_id"])
        parent = wanted[one["attributes"]["instance"]]["parent"]
        if parent in wanted:
            above = truth.anns[one["attributes"]["parent"]]
            assert above["image_id"] == one["image_id"]
            assert above["attributes"]["instance"] == parent
            parents += 1
        else:
            assert one["attributes"]["parent"] is None
    assert parents > 20


def test_what_belongs_to_no_plant_is_a_crowd_or_background(made, truth):
    for index in truth.imgs:
        crowds = [one for one in truth.imgToAnns[index] if one["iscrowd"]]
        assert [one["category_id"] for one in crowds] == [int(OrganClass.WIRE)]
        assert (truth.annToMask(crowds[0]).astype(bool) == (made.image(index, "instance") == WIRE)).all()


def test_ids_are_unique_over_all_splits_and_above_0(out):
    both = [loaded(out / "annotations" / f"instances_{name}.json") for name in ("train", "val")]
    ids = [one["id"] for part in both for one in part.dataset["annotations"]]
    assert len(set(ids)) == len(ids)
    assert min(ids) > 0
    assert {tuple(sorted(part.imgs)) for part in both} == {FRAMES[:4], FRAMES[4:]}


def average_precision(truth, found, kind):
    """Mean over classes, overlaps from .5 to .95 and recalls, and the least of them."""
    with contextlib.redirect_stdout(io.StringIO()):
        evaluation = COCOeval(truth, truth.loadRes(found), kind)
        # Pictures hold more than the usual 100 organs of a class.
        evaluation.params.maxDets = [1, 100, 1000]
        evaluation.params.areaRng, evaluation.params.areaRngLbl = [[0, 1e10]], ["all"]
        evaluation.evaluate()
        evaluation.accumulate()
    precision = evaluation.eval["precision"][..., 0, -1]
    return precision[precision > -1]


def perfect(truth):
    kept = ("image_id", "category_id", "segmentation", "bbox")
    return [
        {**{key: one[key] for key in kept}, "score": 0.9} for one in truth.anns.values() if not one["iscrowd"]
    ]


@pytest.mark.parametrize("kind", ["segm", "bbox"])
def test_a_perfect_prediction_has_an_average_precision_of_1(truth, kind):
    # A precision is a / (a + 2e-16): 1 to the last bit or the one before.
    assert average_precision(truth, perfect(truth), kind) == pytest.approx(1, abs=1e-15)


@pytest.mark.parametrize("kind", ["segm", "bbox"])
def test_a_damaged_prediction_has_less(truth, kind):
    found = perfect(truth)
    assert average_precision(truth, found[::2], kind).mean() < 0.8
    for one in found:
        mask = np.roll(mask_tools.decode(one["segmentation"]), 3, axis=1)
        one["segmentation"] = mask_tools.encode(np.asfortranarray(mask))
        one["bbox"] = [one["bbox"][0] + 3, *one["bbox"][1:]]
    assert average_precision(truth, found, kind).mean() < 0.8


def test_who_finds_the_crowd_is_not_blamed(truth):
    crowd = [one for one in truth.anns.values() if one["iscrowd"]]
    extra = [
        {key: one[key] for key in ("image_id", "category_id", "segmentation", "bbox")} | {"score": 0.99}
        for one in crowd
    ]
    assert average_precision(truth, perfect(truth) + extra, "segm") == pytest.approx(1, abs=1e-15)


def test_fruit_tell_their_whole_masks_and_where_they_are_cut(made, truth):
    assert truth.cats[int(OrganClass.PEPPER)]["keypoints"] == ["cut"]
    seen = {0: 0, 1: 0, 2: 0}
    for index in truth.imgs:
        told = {fruit["instance"]: fruit for fruit in made.image(index, "harvest")["fruit"]}
        found = [one for one in truth.imgToAnns[index] if one["category_id"] == OrganClass.PEPPER]
        assert sorted(one["attributes"]["instance"] for one in found) == sorted(told)
        for one in found:
            fruit, known = told[one["attributes"]["instance"]], one["attributes"]
            amodal = mask_tools.decode(known["amodal"]["segmentation"]).astype(bool)
            assert (amodal == decode_rle(fruit["amodal"])).all()
            assert amodal.sum() == known["amodal"]["area"] == fruit["amodal_pixels"]
            # What is seen of a fruit is a part of the whole.
            assert (truth.annToMask(one).astype(bool) <= amodal).all()
            assert one["area"] / known["amodal"]["area"] == pytest.approx(known["visible_fraction"])
            x, y, flag = one["keypoints"]
            assert one["num_keypoints"] == int(flag > 0)
            seen[flag] += 1
            cut = (fruit["peduncle"] or {}).get("cut")
            if flag:
                assert [x + 0.5, y + 0.5] == pytest.approx(cut["px"], abs=0.006)
                assert (flag == 2) == cut["visible"]
            else:
                assert [x, y] == [0, 0]
                assert cut is None or cut["px"] is None
    assert all(seen.values())
    assert all("keypoints" not in one for one in truth.anns.values() if one["category_id"] != 2)


def test_without_harvest_there_are_no_keypoints(made, tmp_path):
    copy = shutil.copytree(made.folder, tmp_path / "set")
    (copy / "harvest" / "000003.json").unlink()
    export_dataset(copy, "coco", tmp_path / "out")
    truth = loaded(tmp_path / "out" / "annotations" / "instances_train.json")
    assert "keypoints" not in truth.cats[2]
    assert all("keypoints" not in one for one in truth.anns.values())
    assert "harvest" in ALL


def test_small_organs_join_the_crowd_of_their_class(made, tmp_path):
    export_dataset(made.folder, "coco", tmp_path / "out", smallest_px=100)
    truth = loaded(tmp_path / "out" / "annotations" / "instances_train.json")
    for index in truth.imgs:
        wanted, found = organs(made, index), truth.imgToAnns[index]
        large = sorted(value for value, one in wanted.items() if one["pixels"] >= 100)
        assert sorted(one["attributes"]["instance"] for one in found if not one["iscrowd"]) == large
        # Nothing is lost: what has an organ's class is in one annotation.
        assert sum(one["area"] for one in found) == np.count_nonzero(made.image(index, "class"))
        covered = sum(truth.annToMask(one).astype(int) for one in found)
        assert (covered == (made.image(index, "class") > 0)).all()


def test_files_tell_whence_they_come(made, out):
    content = json.loads((out / "annotations" / "instances_train.json").read_text())
    assert content["info"]["recipe_sha256"] == made.info["recipe_sha256"]
    assert [one["set"] for one in content["images"]] == [0] * 4


@settings(deadline=None)
@given(hnp.arrays(np.uint32, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(1, 5)))
def test_run_lengths_are_those_of_pycocotools(ids):
    counts = all_run_lengths(ids)
    assert list(counts) == sorted(set(ids.ravel().tolist()))
    for value, runs in counts.items():
        height, width = ids.shape
        mine = mask_tools.frPyObjects({"size": [height, width], "counts": runs}, height, width)
        assert mine["counts"] == mask_tools.encode(np.asfortranarray(ids == value, dtype=np.uint8))["counts"]
