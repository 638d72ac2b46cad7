"""COCO: pycocotools loads and evaluates what is written; images are those of the panoptic format."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from label_set import CORNERS, MAPPING, POINTS, box_of, expected_points, export, fruit_truth, load_coco
from painted_set import FRAMES, SIZE, WIRE

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.store.images import read_image
from pepperscene.export.coco import segment_run_lengths
from pepperscene.truth.encodings import decode_rle

mask_tools = pytest.importorskip("pycocotools.mask", reason="the extra `export` installs pycocotools")

# pycocotools 2.0.11 decodes masks in a way that NumPy 2 tolerates for now.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

from pycocotools.coco import COCO  # noqa: E402
from pycocotools.cocoeval import COCOeval  # noqa: E402

REST = 65536


@pytest.fixture(scope="module")
def out(painted, tmp_path_factory):
    return export(painted, "coco", tmp_path_factory.mktemp("out") / "out", split="train=.6,val=.4")


def load(folder, split="train"):
    with contextlib.redirect_stdout(io.StringIO()):
        return COCO(folder / "annotations" / f"instances_{split}.json")


@pytest.fixture(scope="module")
def truth(out):
    return load(out)


def organ_entries(dataset, index):
    """Entries of the organs of plants in the frame's JSON, by instance."""
    entries = dataset.metadata(index)["instances"].items()
    return {int(value): entry for value, entry in entries if entry["class"] and entry["plant"] >= 0}


def test_every_organ_has_its_mask_and_attributes(painted, out, truth):
    assert sorted(truth.imgs) == list(FRAMES[:4])
    assert truth.dataset["info"]["recipe_sha256"] == painted.info["recipe_sha256"]
    assert {category["id"]: category["name"] for category in truth.cats.values()} == {
        int(organ): organ.name.lower() for organ in OrganClass if organ
    }
    parents = 0
    for index, record in truth.imgs.items():
        colour = read_image(out / "train" / record["file_name"])
        assert (colour == painted.image(index, "colour")).all()
        assert (record["height"], record["width"], record["set"]) == (*colour.shape[:2], 0)
        instance, entries = painted.image(index, "instance"), organ_entries(painted, index)
        # More than fit into a byte, where pycocotools 2.0 fails under NumPy 2.
        assert len(entries) > 255
        things = [annotation for annotation in truth.imgToAnns[index] if not annotation["iscrowd"]]
        assert sorted(thing["attributes"]["instance"] for thing in things) == sorted(entries)
        for thing in things:
            attributes = thing["attributes"]
            entry = entries[attributes["instance"]]
            mask = truth.annToMask(thing).astype(bool)
            assert (mask == (instance == attributes["instance"])).all()
            assert thing["category_id"] == entry["class"]
            assert all(attributes[key] == entry[key] for key in ("kind", "plant", "phytomer"))
            assert thing["area"] == mask.sum() == mask_tools.area(thing["segmentation"])
            assert thing["bbox"] == box_of(mask)
            if entry["parent"] in entries:
                parent = truth.anns[attributes["parent"]]
                assert (parent["image_id"], parent["attributes"]["instance"]) == (index, entry["parent"])
                parents += 1
            else:
                assert attributes["parent"] is None
        # What belongs to no plant is a crowd.
        (crowd,) = (annotation for annotation in truth.imgToAnns[index] if annotation["iscrowd"])
        assert crowd["category_id"] == OrganClass.WIRE
        assert (truth.annToMask(crowd).astype(bool) == (instance == WIRE)).all()
    assert parents > 20


def test_annotation_ids_are_unique_in_all_splits_and_positive(out, truth):
    parts = [truth, load(out, "val")]
    ids = [annotation["id"] for part in parts for annotation in part.dataset["annotations"]]
    assert len(set(ids)) == len(ids)
    assert min(ids) > 0
    # Each image has a range of its own, for organs and for the rest of each class.
    assert all(
        annotation["id"] // (2 * REST) == annotation["image_id"]
        for part in parts
        for annotation in part.dataset["annotations"]
    )
    assert {tuple(sorted(part.imgs)) for part in parts} == {FRAMES[:4], FRAMES[4:]}


def test_without_harvest_there_are_no_keypoints(painted, copied, tmp_path):
    dataset = copied(painted)
    (dataset.folder / "harvest" / "000003.json").unlink()
    content = load_coco(export(dataset, "coco", tmp_path / "out", frames="0:5"))
    assert not any("keypoints" in one for one in (*content["categories"], *content["annotations"]))


def test_small_organs_join_the_crowd_of_their_class(painted, tmp_path):
    truth = load(export(painted, "coco", tmp_path / "out", smallest_px=100, frames="0:5"))
    for index in truth.imgs:
        entries, annotations = organ_entries(painted, index), truth.imgToAnns[index]
        large = sorted(value for value, entry in entries.items() if entry["pixels"] >= 100)
        things = [annotation for annotation in annotations if not annotation["iscrowd"]]
        assert sorted(thing["attributes"]["instance"] for thing in things) == large
        # Every pixel of an organ's class is in one annotation.
        covered = sum(truth.annToMask(annotation).astype(int) for annotation in annotations)
        assert (covered == (painted.image(index, "class") > 0)).all()


@given(hnp.arrays(np.uint32, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(1, 5)))
def test_run_lengths_are_those_of_pycocotools(ids):
    lengths = segment_run_lengths(ids)
    assert list(lengths) == sorted(set(ids.ravel().tolist()))
    for value, runs in lengths.items():
        mask = mask_tools.frPyObjects({"size": list(ids.shape), "counts": runs}, *ids.shape)
        assert mask["counts"] == mask_tools.encode(np.asfortranarray(ids == value, dtype=np.uint8))["counts"]


def test_every_pixel_belongs_to_a_described_segment(painted, out):
    panoptic = load_coco(out, "panoptic")
    assert [(one["id"], one["isthing"], tuple(one["color"])) for one in panoptic["categories"]] == [
        (int(organ), int(organ > 0), colour) for organ, colour in zip(OrganClass, CLASS_COLOURS, strict=True)
    ]
    for annotation in panoptic["annotations"]:
        index, infos = annotation["image_id"], annotation["segments_info"]
        image = read_image(out / "annotations" / "panoptic_train" / annotation["file_name"])
        ids = image.astype(int) @ [1, 256, 65536]
        values, counts = np.unique(ids, return_counts=True)
        assert {info["id"]: info["area"] for info in infos} == dict(zip(values, counts, strict=True))
        # 0 means unlabelled in this format.
        assert values[0] > 0
        category_of = {info["id"]: info["category_id"] for info in infos}
        assert (np.vectorize(category_of.get)(ids) == painted.image(index, "class")).all()
        instance = painted.image(index, "instance")
        for info in infos:
            assert info["bbox"] == box_of(ids == info["id"])
            if info["id"] < REST:
                assert not info["iscrowd"]
                assert ((ids == info["id"]) == (instance == info["id"])).all()
        rest = {info["id"]: info["iscrowd"] for info in infos if info["id"] >= REST}
        assert rest == {REST: 0, REST + OrganClass.WIRE: 1}
        assert ((ids == REST + OrganClass.WIRE) == (instance == WIRE)).all()


def test_fruit_has_its_keypoints_pose_and_amodal_mask(labels, tmp_path):
    truth = load(export(labels, "coco", tmp_path / "out", classes=MAPPING))
    for category in truth.cats.values():
        if category["name"] in ("ripe", "green"):
            assert tuple(category["keypoints"]) == POINTS
            assert category["skeleton"] == [[1, 2], [2, 3]]
        else:
            assert "keypoints" not in category
    visibilities = set()
    for one in truth.anns.values():
        if "keypoints" not in truth.cats[one["category_id"]]:
            assert "keypoints" not in one
            continue
        found = np.array(one["keypoints"], float).reshape(3, 3)
        assert one["num_keypoints"] == np.count_nonzero(found[:, 2])
        if one["iscrowd"]:
            assert not found.any()
            continue
        attributes = one["attributes"]
        fruit = fruit_truth(labels, one["image_id"])[attributes["instance"]]
        expected = expected_points(fruit)
        assert (found[:, 2] == expected[:, 2]).all()
        # Centres of first pixels are at 0 in COCO, at 0.5 in the data set.
        known = expected[:, 2] > 0
        np.testing.assert_allclose(found[known, :2] + 0.5, expected[known, :2], rtol=0, atol=0.035)
        assert not found[~known].any()
        assert attributes["pose"] == fruit["pose"]
        assert attributes["distance_m"] == pytest.approx(np.linalg.norm(fruit["box_3d"]["centre"]), abs=1e-6)
        assert attributes["visible_fraction"] == fruit["visible_fraction"]
        amodal = mask_tools.decode(attributes["amodal"]["segmentation"])
        assert (amodal == decode_rle(fruit["amodal"])).all()
        visibilities.update(found[:, 2])
    assert visibilities == {0, 1, 2}


def test_keypoints_at_the_border_are_inside_the_picture(borders, tmp_path):
    truth = load(export(borders, "coco", tmp_path / "out"))
    known = [one for one in truth.anns.values() if one.get("num_keypoints")]
    assert known
    for one in known:
        points = np.reshape(one["keypoints"], (3, 3))
        shown = points[points[:, 2] > 0, :2]
        assert (shown >= 0).all()
        assert (shown <= [SIZE[1] - 1, SIZE[0] - 1]).all()
        # No point moves by more than half a pixel.
        assert points[1:, 2].tolist() == [2, 2]
        assert np.abs(points[1:, :2] + 0.5 - CORNERS).max() <= 0.5


def test_pycocotools_evaluates_masks_and_keypoints_to_a_precision_of_1(labels, tmp_path):
    truth = load(export(labels, "coco", tmp_path / "out", classes="pepper", frames="0:3"))
    keys = ("image_id", "category_id", "keypoints", "segmentation", "bbox")
    detections = [
        {key: one[key] for key in keys} | {"score": 1.0}
        for one in truth.anns.values()
        if not one["iscrowd"] and one["num_keypoints"]
    ]
    with contextlib.redirect_stdout(io.StringIO()):
        evaluation = COCOeval(truth, truth.loadRes(detections), "keypoints")
        evaluation.params.kpt_oks_sigmas = np.full(len(POINTS), 0.05)
        evaluation.params.areaRng, evaluation.params.areaRngLbl = [[0, 1e10]], ["all"]
        evaluation.evaluate()
        evaluation.accumulate()
    values = evaluation.eval["precision"]
    assert values[values > -1] == pytest.approx(1, abs=1e-12)
