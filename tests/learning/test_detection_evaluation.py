"""Average precision of detectors: hand-made cases, pycocotools itself, and what is ignored."""

from __future__ import annotations

import contextlib
import io
import json
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from memory_set import MemorySet
from object_set import object_set, paint_objects
from painted_bands import bands_set

from pepperscene.classes import IGNORE_CLASS
from pepperscene.errors import InputError
from pepperscene.learning.options import parse_classes

torch = pytest.importorskip("torch", reason="the extra `learn` installs torch")
coder = pytest.importorskip("pycocotools.mask", reason="the extra `export` installs pycocotools")
from pycocotools.coco import COCO  # noqa: E402
from pycocotools.cocoeval import COCOeval  # noqa: E402

from pepperscene.learning.evaluation.average_precision import average_precision, object_record  # noqa: E402
from pepperscene.learning.evaluation.detection import evaluate_detector  # noqa: E402

FRUIT = parse_classes("detect", None)


@dataclass
class Listed:
    """Detections that a test lists: boxes, scores, labels and masks."""

    boxes: np.ndarray
    scores: np.ndarray
    labels: np.ndarray
    masks: list

    def mask(self, number):
        return self.masks[number]


@dataclass
class Finds:
    """A detector whose objects a function lists for the colours of an image."""

    find: object
    classes: object = FRUIT
    width: int | None = None
    task: str = "detect"
    training: dict = field(default_factory=lambda: {"options": {"least_area": 20}})

    def check_task(self, task):
        assert task == self.task

    def detections(self, colour):
        return self.find(colour)


def listed(entries):
    """Detections of (score, label, mask)."""
    entries = sorted(entries, key=lambda entry: -entry[0])
    boxes = []
    for _, _, mask in entries:
        rows, columns = np.nonzero(mask)
        boxes.append((columns.min(), rows.min(), columns.max() + 1, rows.max() + 1))
    scores, labels = np.array([entry[0] for entry in entries]), np.array([entry[1] for entry in entries], int)
    return Listed(np.array(boxes, float).reshape(-1, 4), scores, labels, [entry[2] for entry in entries])


def rectangle(left, top, right, bottom, size=(40, 60)):
    mask = np.zeros(size, bool)
    mask[top:bottom, left:right] = True
    return mask


def image_of(*objects, name="image", size=(40, 60), void=None):
    """An image of (class id, mask); instances are numbered from 1."""
    image = paint_objects(0, size=size)
    classes, instances = np.zeros(size, np.uint8), np.zeros(size, np.uint16)
    for number, (class_id, mask) in enumerate(objects, start=1):
        classes[mask], instances[mask] = class_id, number
    if void is not None:
        classes[void] = IGNORE_CLASS
    return replace(image, name=name, classes=classes, instances=instances)


def evaluate_one(objects, found, void=None, **options):
    image = image_of(*objects, void=void)
    images = MemorySet(name="hand", items=(image,))
    return evaluate_detector(Finds(lambda _: listed(found)), images, **options)


FIRST, SECOND, THIRD = rectangle(2, 2, 22, 12), rectangle(30, 2, 50, 12), rectangle(2, 20, 22, 30)


def test_average_precision_of_hand_made_cases():
    """Precisions at 101 recalls by hand."""
    fruit = [(2, FIRST), (2, SECOND)]
    for found, ap50 in (
        ([(0.9, 0, FIRST), (0.8, 0, SECOND)], 1.0),
        ([(0.9, 0, FIRST)], 51 / 101),  # recalls 0 to .5
        ([(0.9, 0, THIRD), (0.8, 0, FIRST), (0.7, 0, SECOND)], 2 / 3),
        # The first half has a precision of 1, the second one of two thirds.
        ([(0.9, 0, FIRST), (0.8, 0, THIRD), (0.7, 0, SECOND)], (51 + 50 * 2 / 3) / 101),
        ([(0.9, 1, FIRST), (0.8, 1, SECOND)], 0.0),  # of another class
        ([], 0.0),
    ):
        result = evaluate_one(fruit, found)
        fruits, peduncles = result.classes
        assert fruits.boxes.ap50 == pytest.approx(ap50, abs=1e-9), found
        assert fruits.masks.ap50 == pytest.approx(ap50, abs=1e-9), found
        assert (peduncles.boxes.ap50, peduncles.masks.ap) == (None, None)
        assert result.mean_ap50 == pytest.approx(ap50)
        json.dumps(result.to_json(), allow_nan=False)


def test_the_overlap_decides_at_each_threshold():
    """A mask with an IoU of 17/20 = .85 counts at 8 of the 10 thresholds."""
    found = rectangle(2, 2, 19, 12)
    fruits = evaluate_one([(2, FIRST)], [(0.9, 0, found)]).classes[0]
    assert (fruits.boxes.ap50, fruits.masks.ap50) == pytest.approx((1.0, 1.0))
    assert fruits.boxes.ap == pytest.approx(0.8)
    # Half of the pixels in the whole box.
    half = FIRST & (np.indices(FIRST.shape).sum(0) % 2 == 0)
    fruits = evaluate_one([(2, FIRST)], [(0.9, 0, half)]).classes[0]
    assert fruits.boxes.ap > 0.5
    assert fruits.masks.ap == pytest.approx(0.1)


def test_precision_and_recall_count_from_the_score_on():
    fruit = [(2, FIRST), (2, SECOND)]
    found = [(0.9, 0, FIRST), (0.5, 0, THIRD), (0.2, 0, SECOND)]
    decided = evaluate_one(fruit, found).classes[0].decided
    assert (decided.counts.matched, decided.counts.predicted, decided.counts.truth) == (1, 2, 2)
    assert (decided.precision.value, decided.recall.value) == (0.5, 0.5)
    decided = evaluate_one(fruit, found, least_score=0.1).classes[0].decided
    assert (decided.counts.matched, decided.counts.predicted) == (2, 3)
    decided = evaluate_one(fruit, found, least_score=0.95).classes[0].decided
    assert (decided.precision.value, decided.recall.value) == (None, 0.0)


def test_fragments_and_void_pixels_count_neither_for_nor_against():
    fragment = rectangle(50, 34, 53, 38)  # 12 pixels of 20
    objects = [(2, FIRST), (2, fragment)]
    perfect = [(0.8, 0, FIRST)]
    for extra in (fragment, rectangle(50, 33, 53, 38), rectangle(30, 2, 50, 12)):
        result = evaluate_one(objects, [*perfect, (0.9, 0, extra)], void=rectangle(30, 0, 50, 15))
        fruits = result.classes[0]
        assert fruits.decided.counts.truth == 1
        assert (fruits.boxes.ap50, fruits.masks.ap50) == pytest.approx((1.0, 1.0))
    # Mostly beside void pixels, it is wrong.
    result = evaluate_one(
        objects, [*perfect, (0.9, 0, rectangle(30, 10, 50, 28))], void=rectangle(30, 0, 50, 15)
    )
    assert result.classes[0].masks.ap50 == pytest.approx(0.5)
    # A labelled object that is partly void still matches.
    result = evaluate_one([(2, FIRST)], [(0.9, 0, FIRST)], void=rectangle(2, 2, 11, 12))
    assert result.classes[0].decided.counts.truth == 1


def test_least_areas_are_those_of_the_scaled_image():
    """12 pixels at twice the network's width are 3 pixels there."""
    image = MemorySet(name="hand", items=(image_of((2, FIRST), (2, rectangle(30, 2, 38, 12))),))
    for width, count in ((60, 2), (30, 2), (15, 0), (240, 2)):
        model = Finds(lambda _: listed([]), width=width)
        decided = evaluate_detector(model, image).classes[0].decided
        # Of 200 and 80 pixels; 20 pixels at a width of 30 are 80 here, at 15 they are 320.
        assert decided.counts.truth == count, width


def random_objects(rng, size=(40, 60)):
    masks = []
    for _ in range(rng.integers(0, 5)):
        left, top = rng.integers(0, 40), rng.integers(0, 25)
        masks.append(rectangle(left, top, left + rng.integers(5, 20), top + rng.integers(5, 15), size))
    return masks


def test_average_precision_is_that_of_pycocotools():
    """Random objects, loaded from files in COCO's formats instead of our records."""
    rng = np.random.default_rng(5)
    truth, found = [], []
    for image in range(12):
        masks = random_objects(rng)
        # Some are found nearly where they are, with others.
        moved = [np.roll(mask, rng.integers(0, 3), axis=1) for mask in masks if rng.random() < 0.8]
        for records, own in ((truth, masks), (found, moved + random_objects(rng))):
            for mask in own:
                rows, columns = np.nonzero(mask)
                box = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
                score = {"score": float(rng.random())} if records is found else {}
                label = int(columns.min() + rows.min() > 30)
                records.append(object_record(image, label, box, mask, **score))
    dataset = {
        "images": [{"id": number, "height": 40, "width": 60} for number in range(12)],
        "categories": [{"id": 0, "name": "a"}, {"id": 1, "name": "b"}],
        "annotations": [{**item, "id": number, "iscrowd": 0} for number, item in enumerate(truth, start=1)],
        "info": {},
    }
    for kind in ("bbox", "segm"):
        with contextlib.redirect_stdout(io.StringIO()):
            reference = COCO()
            reference.dataset = dataset
            reference.createIndex()
            # Their boxes come from the masks.
            results = [{key: item[key] for key in item if key not in ("area", "bbox")} for item in found]
            expected = COCOeval(reference, reference.loadRes(results), kind)
            expected.evaluate()
            expected.accumulate()
            expected.summarize()
        measured, counts = average_precision(truth, found, 12, 2, kind, 0.0)
        assert np.mean([item.ap for item in measured]) == pytest.approx(expected.stats[0])
        assert np.mean([item.ap50 for item in measured]) == pytest.approx(expected.stats[1])
        assert 0 < expected.stats[1] < 1
        assert sum(item.truth for own in counts for item in own) == len(truth)
        assert sum(item.predicted for own in counts for item in own) == len(found)


def test_classes_are_merged_and_left_out():
    objects, found = [(2, FIRST), (3, SECOND)], [(0.9, 0, FIRST), (0.8, 1, SECOND)]
    merged = evaluate_one(objects, found, classes=parse_classes("detect", "both=pepper+peduncle"))
    assert [(item.name, item.masks.ap50) for item in merged.classes] == [("both", 1.0)]
    assert merged.classes[0].decided.counts.truth == 2
    single = evaluate_one(objects, found, classes=parse_classes("detect", "peduncle"))
    assert [(item.name, item.decided.counts.predicted) for item in single.classes] == [("peduncle", 1)]


def test_sets_without_instances_need_regions():
    image = replace(image_of((2, FIRST), (2, SECOND), (3, THIRD)), instances=None)
    images = MemorySet(name="masks", items=(image, replace(image, name="unlabelled", classes=None)))
    model = Finds(lambda _: listed([(0.9, 0, FIRST), (0.8, 0, SECOND), (0.7, 1, THIRD)]))
    message = "masks: image has a mask without numbers of instances.*; --regions takes connected regions"
    with pytest.raises(InputError, match=message):
        evaluate_detector(model, images)
    result = evaluate_detector(model, images, regions=True)
    assert [item.decided.counts.truth for item in result.classes] == [2, 1]
    assert result.mean_ap50 == pytest.approx(1)
    assert [vars(item) for item in result.sets] == [
        {"name": "masks", "available": 2, "evaluated": 1, "unlabelled": 1}
    ]
    with pytest.raises(InputError, match="masks: holds no image with a mask"):
        evaluate_detector(model, images[1:])
    with pytest.raises(InputError, match="bands: image0 has a mask without numbers of instances"):
        evaluate_detector(model, bands_set(1))


def test_results_of_several_images_and_their_table():
    model, images = Finds(lambda _: listed([])), object_set(3)
    result = evaluate_detector(model, [images, images[:1]], limit=2)
    assert [item.evaluated for item in result.sets] == [2, 1]
    assert result.mean_ap50 == 0
    text = result.format()
    assert text.startswith("Objects, %: objects, 2 of 3 images; objects, 1 of 1 images\n")
    assert "objects below 20 pixels at the model's width are ignored" in text
