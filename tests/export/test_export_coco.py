"""COCO: pycocotools loads the instances, decodes their masks, and evaluates them to a precision of 1."""

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
from label_set import box_of
from painted_set import FRAMES, WIRE

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset.store.images import read_image
from pepperscene.export import export_dataset
from pepperscene.export.coco import segment_run_lengths

mask_tools = pytest.importorskip("pycocotools.mask", reason="the extra `export` installs pycocotools")

# pycocotools 2.0.11 decodes masks in a way that NumPy 2 tolerates for now.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

from pycocotools.coco import COCO  # noqa: E402
from pycocotools.cocoeval import COCOeval  # noqa: E402

REST = 65536


@pytest.fixture(scope="module")
def out(painted, tmp_path_factory):
    folder = tmp_path_factory.mktemp("out") / "out"
    return export_dataset(painted.folder, "coco", folder, "train=.6,val=.4").folder


def load(path):
    with contextlib.redirect_stdout(io.StringIO()):
        return COCO(path)


@pytest.fixture(scope="module")
def truth(out):
    return load(out / "annotations" / "instances_train.json")


def organ_entries(dataset, index):
    """Entries of the organs of plants in the frame's JSON, by instance."""
    entries = dataset.metadata(index)["instances"].items()
    return {int(value): entry for value, entry in entries if entry["class"] and entry["plant"] >= 0}


def test_every_organ_has_its_mask_and_attributes(painted, out, truth):
    assert sorted(truth.imgs) == list(FRAMES[:4])
    assert {category["id"]: category["name"] for category in truth.cats.values()} == {
        int(organ): organ.name.lower() for organ in OrganClass if organ
    }
    for index, record in truth.imgs.items():
        colour = read_image(out / "train" / record["file_name"])
        assert (colour == painted.image(index, "colour")).all()
        assert (record["height"], record["width"]) == colour.shape[:2]
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


def test_parent_is_the_annotation_of_the_parent_organ(painted, truth):
    parents = 0
    for annotation in truth.anns.values():
        if annotation["iscrowd"]:
            continue
        entries = organ_entries(painted, annotation["image_id"])
        parent = entries[annotation["attributes"]["instance"]]["parent"]
        if parent in entries:
            parent_annotation = truth.anns[annotation["attributes"]["parent"]]
            assert parent_annotation["image_id"] == annotation["image_id"]
            assert parent_annotation["attributes"]["instance"] == parent
            parents += 1
        else:
            assert annotation["attributes"]["parent"] is None
    assert parents > 20


def test_instances_of_no_plant_are_a_crowd(painted, truth):
    for index in truth.imgs:
        crowds = [annotation for annotation in truth.imgToAnns[index] if annotation["iscrowd"]]
        assert [crowd["category_id"] for crowd in crowds] == [int(OrganClass.WIRE)]
        assert (truth.annToMask(crowds[0]).astype(bool) == (painted.image(index, "instance") == WIRE)).all()


def test_annotation_ids_are_unique_in_all_splits_and_positive(out):
    parts = [load(out / "annotations" / f"instances_{name}.json") for name in ("train", "val")]
    ids = [annotation["id"] for part in parts for annotation in part.dataset["annotations"]]
    assert len(set(ids)) == len(ids)
    assert min(ids) > 0
    assert {tuple(sorted(part.imgs)) for part in parts} == {FRAMES[:4], FRAMES[4:]}


def average_precision(truth, predictions):
    """Precisions of all classes, overlaps from .5 to .95, and recalls."""
    with contextlib.redirect_stdout(io.StringIO()):
        evaluation = COCOeval(truth, truth.loadRes(predictions), "segm")
        # Images contain more than the default limit of 100 organs of a class.
        evaluation.params.maxDets = [1, 100, 1000]
        evaluation.params.areaRng, evaluation.params.areaRngLbl = [[0, 1e10]], ["all"]
        evaluation.evaluate()
        evaluation.accumulate()
    precision = evaluation.eval["precision"][..., 0, -1]
    return precision[precision > -1]


def predictions_of(truth, crowd):
    keys = ("image_id", "category_id", "segmentation", "bbox")
    annotations = [annotation for annotation in truth.anns.values() if annotation["iscrowd"] == crowd]
    return [{**{key: annotation[key] for key in keys}, "score": 0.9} for annotation in annotations]


def test_average_precision_of_perfect_and_damaged_predictions(truth):
    predictions = predictions_of(truth, crowd=False)
    # A precision is a / (a + 2e-16): 1, or the number before it.
    assert average_precision(truth, predictions) == pytest.approx(1, abs=1e-15)
    assert average_precision(truth, predictions[::2]).mean() < 0.8
    for prediction in predictions:
        mask = np.roll(mask_tools.decode(prediction["segmentation"]), 3, axis=1)
        prediction["segmentation"] = mask_tools.encode(np.asfortranarray(mask))
    assert average_precision(truth, predictions).mean() < 0.8


def test_predictions_of_the_crowd_are_ignored(truth):
    predictions = predictions_of(truth, crowd=False) + predictions_of(truth, crowd=True)
    assert average_precision(truth, predictions) == pytest.approx(1, abs=1e-15)


def test_without_harvest_there_are_no_keypoints(painted, tmp_path):
    copy = shutil.copytree(painted.folder, tmp_path / "set")
    (copy / "harvest" / "000003.json").unlink()
    export_dataset(copy, "coco", tmp_path / "out")
    truth = load(tmp_path / "out" / "annotations" / "instances_train.json")
    assert "keypoints" not in truth.cats[2]
    assert all("keypoints" not in annotation for annotation in truth.anns.values())


def test_small_organs_join_the_crowd_of_their_class(painted, tmp_path):
    export_dataset(painted.folder, "coco", tmp_path / "out", smallest_px=100)
    truth = load(tmp_path / "out" / "annotations" / "instances_train.json")
    for index in truth.imgs:
        entries, annotations = organ_entries(painted, index), truth.imgToAnns[index]
        large = sorted(value for value, entry in entries.items() if entry["pixels"] >= 100)
        things = [annotation for annotation in annotations if not annotation["iscrowd"]]
        assert sorted(thing["attributes"]["instance"] for thing in things) == large
        # Every pixel of an organ's class is in one annotation.
        covered = sum(truth.annToMask(annotation).astype(int) for annotation in annotations)
        assert (covered == (painted.image(index, "class") > 0)).all()


def test_files_name_their_data_set(painted, out):
    content = json.loads((out / "annotations" / "instances_train.json").read_text())
    assert content["info"]["recipe_sha256"] == painted.info["recipe_sha256"]
    assert [image["set"] for image in content["images"]] == [0] * 4


@settings(deadline=None)
@given(hnp.arrays(np.uint32, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(1, 5)))
def test_run_lengths_are_those_of_pycocotools(ids):
    lengths = segment_run_lengths(ids)
    assert list(lengths) == sorted(set(ids.ravel().tolist()))
    for value, runs in lengths.items():
        mask = mask_tools.frPyObjects({"size": list(ids.shape), "counts": runs}, *ids.shape)
        assert mask["counts"] == mask_tools.encode(np.asfortranarray(ids == value, dtype=np.uint8))["counts"]


@pytest.fixture(scope="module")
def panoptic(out):
    return json.loads((out / "annotations" / "panoptic_train.json").read_text())


def decode_ids(out, annotation):
    """Segment ids of an image, as the format defines them."""
    path = out / "annotations" / "panoptic_train" / annotation["file_name"]
    red, green, blue = np.moveaxis(read_image(path).astype(int), 2, 0)
    return red + 256 * green + 65536 * blue


def test_every_pixel_belongs_to_a_described_segment(painted, out, panoptic):
    categories = {category["id"]: category for category in panoptic["categories"]}
    assert {id_: category["isthing"] for id_, category in categories.items()} == {
        int(organ): int(organ > 0) for organ in OrganClass
    }
    colours = [tuple(category["color"]) for category in panoptic["categories"]]
    assert colours == list(CLASS_COLOURS)
    for annotation in panoptic["annotations"]:
        ids, infos = decode_ids(out, annotation), annotation["segments_info"]
        index = annotation["image_id"]
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
