"""COCO panoptic: every pixel in one segment, whose quality against itself is 1."""

from __future__ import annotations

import json

import numpy as np
import pytest
from painted_set import WIRE

from pepperscene.classes import CLASS_COLOURS, OrganClass
from pepperscene.dataset import read_image
from pepperscene.dataset.export import export_dataset

mask_tools = pytest.importorskip("pycocotools.mask", reason="the extra `export` brings pycocotools")

# pycocotools 2.0.11 decodes masks in a way that NumPy 2 tolerates for now.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

from pycocotools.coco import COCO  # noqa: E402

REST = 65536


@pytest.fixture(scope="module")
def made(painted):
    return painted


@pytest.fixture(scope="module")
def out(made, tmp_path_factory):
    return export_dataset(made.folder, "coco", tmp_path_factory.mktemp("out") / "out").folder / "annotations"


@pytest.fixture(scope="module")
def told(out):
    return json.loads((out / "panoptic_train.json").read_text())


def decoded(out, annotation):
    """The ids of a picture, as the format defines them."""
    red, green, blue = np.moveaxis(
        read_image(out / "panoptic_train" / annotation["file_name"]).astype(int), 2, 0
    )
    return red + 256 * green + 65536 * blue


def quality(truth, truth_info, found, found_info, kinds):
    """Panoptic quality of each category (Kirillov et al. 2019): overlaps of matches over the mean number."""
    kind_of = [{one["id"]: one["category_id"] for one in info} for info in (truth_info, found_info)]
    crowd = {one["id"] for one in truth_info if one["iscrowd"]}
    areas = [dict(zip(*np.unique(ids, return_counts=True), strict=True)) for ids in (truth, found)]
    pairs, counts = np.unique(np.stack([truth.ravel(), found.ravel()]), axis=1, return_counts=True)
    matched, overlaps = set(), {kind: [] for kind in kinds}
    ignored = {}
    for (one, other), count in zip(pairs.T.tolist(), counts.tolist(), strict=True):
        if one in crowd:
            ignored[other] = ignored.get(other, 0) + count
            continue
        overlap = count / (areas[0][one] + areas[1][other] - count)
        if overlap > 0.5 and kind_of[0][one] == kind_of[1].get(other):
            overlaps[kind_of[0][one]].append(overlap)
            matched |= {("truth", one), ("found", other)}
    scores = {}
    for kind in kinds:
        missed = sum(
            k == kind and i not in crowd and ("truth", i) not in matched for i, k in kind_of[0].items()
        )
        wrong = sum(
            k == kind and ("found", i) not in matched and ignored.get(i, 0) <= 0.5 * areas[1][i]
            for i, k in kind_of[1].items()
        )
        if overlaps[kind] or missed or wrong:
            scores[kind] = sum(overlaps[kind]) / (len(overlaps[kind]) + 0.5 * (missed + wrong))
    return scores


def test_every_pixel_belongs_to_a_segment_that_is_told(made, out, told):
    for annotation in told["annotations"]:
        ids, info = decoded(out, annotation), annotation["segments_info"]
        values, counts = np.unique(ids, return_counts=True)
        assert {one["id"]: one["area"] for one in info} == dict(
            zip(values.tolist(), counts.tolist(), strict=True)
        )
        # 0 is what the format has no label for.
        assert values[0] > 0
        for one in info:
            rows, columns = np.nonzero(ids == one["id"])
            size = [np.ptp(columns) + 1, np.ptp(rows) + 1]
            assert one["bbox"] == [columns.min(), rows.min(), *size]
        kinds = {one["id"]: one["category_id"] for one in info}
        assert (np.vectorize(kinds.get)(ids) == made.image(annotation["image_id"], "class")).all()


def test_organs_are_things_and_the_rest_is_stuff_or_a_crowd(made, out, told):
    isthing = {one["id"]: one["isthing"] for one in told["categories"]}
    assert isthing == {int(one): int(one > 0) for one in OrganClass}
    assert [tuple(one["color"]) for one in told["categories"]] == list(CLASS_COLOURS)
    for annotation in told["annotations"]:
        instance = made.image(annotation["image_id"], "instance")
        ids = decoded(out, annotation)
        for one in annotation["segments_info"]:
            if one["id"] < REST:
                assert not one["iscrowd"]
                assert ((ids == one["id"]) == (instance == one["id"])).all()
        rest = {one["id"]: one["iscrowd"] for one in annotation["segments_info"] if one["id"] >= REST}
        assert rest == {REST: 0, REST + OrganClass.WIRE: 1}
        assert ((ids == REST + OrganClass.WIRE) == (instance == WIRE)).all()


def test_the_quality_of_a_picture_against_itself_is_1(out, told):
    kinds = [one["id"] for one in told["categories"]]
    for annotation in told["annotations"]:
        ids, info = decoded(out, annotation), annotation["segments_info"]
        assert set(quality(ids, info, ids, info, kinds).values()) == {1.0}
        # Moved by a pixel, and the more so with every second segment away, it is worse.
        moved = np.roll(ids, 1, axis=0)
        assert max(quality(ids, info, moved, info, kinds).values()) < 1
    whole = [one for one in info if not one["iscrowd"]]
    half = {one["id"] for one in whole[::2]} | {one["id"] for one in info if one["iscrowd"]}
    scores = quality(ids, info, np.where(np.isin(ids, list(half)), ids, 0), whole[::2], kinds)
    assert np.mean(list(scores.values())) < 0.9


def test_its_segments_are_the_instances_for_pycocotools(out, told):
    """Segments made annotations, as COCO's own converter from panoptic to detection does."""
    instances = COCO(out / "instances_train.json")
    segments = COCO()
    records = []
    for annotation in told["annotations"]:
        ids = decoded(out, annotation)
        for one in annotation["segments_info"]:
            if one["category_id"] == OrganClass.BACKGROUND:
                continue
            mask = mask_tools.encode(np.asfortranarray(ids == one["id"], dtype=np.uint8))
            records.append({
                **one, "id": len(records) + 1, "image_id": annotation["image_id"], "segmentation": mask,
            })  # fmt: skip
            assert mask_tools.area(mask) == one["area"]
            assert mask_tools.toBbox(mask).tolist() == one["bbox"]
    segments.dataset = {**told, "annotations": records}
    segments.createIndex()
    for index in instances.imgs:
        pairs = [
            sorted(
                (one["category_id"], one["iscrowd"], one["area"], tuple(one["bbox"]))
                for one in part.imgToAnns[index]
            )
            for part in (instances, segments)
        ]
        assert pairs[0] == pairs[1]
