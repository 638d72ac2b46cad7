"""Evaluation of models whose predictions are known, its page and its JSON file."""

from __future__ import annotations

import base64
import io
import json
import re

import numpy as np
import pytest
from memory_set import MemorySet
from PIL import Image
from toy_models import ORGANS, Constant, ReadsRed, image_set, parse_page, random_masks

from pepperscene.classes import IGNORE_CLASS, IGNORE_COLOUR
from pepperscene.dataset.readers.image_set import LabelledImage
from pepperscene.errors import ArgumentError, InputError, OutputError
from pepperscene.learning.class_table import FRUIT_CLASSES, ClassTable
from pepperscene.learning.evaluation.evaluate import evaluate, fruit_class
from pepperscene.learning.evaluation.page import write_evaluation
from pepperscene.learning.pages import ranked_examples

MASKS = random_masks(6)
FRUIT = ClassTable.parse(FRUIT_CLASSES)


def values(estimates):
    return [estimate.value for estimate in estimates]


def test_a_constant_model_has_the_share_of_its_class_and_otherwise_zero():
    result = evaluate(Constant((0, 0, 1, 0, 0, 0, 0, 0)), image_set(*MASKS))
    labelled = np.concatenate([mask[mask != IGNORE_CLASS] for mask in MASKS])
    expected = [0.0] * 8
    expected[2] = np.mean(labelled == 2)
    assert values(result.measures.iou) == pytest.approx(expected)
    assert result.measures.precision[2].value == pytest.approx(expected[2])
    assert values(result.measures.recall) == [0, 0, 1, 0, 0, 0, 0, 0]
    assert result.measures.precision[0].why == "the class is not predicted"
    # Of equal probabilities the first class is predicted.
    assert evaluate(Constant((0.125,) * 8), image_set(*MASKS)).measures.recall[0].value == 1


def test_classes_are_merged_before_the_most_probable_is_chosen():
    # Pepper is the most probable of the eight classes, but less so than all others together.
    model = Constant((0.2, 0.2, 0.3, 0.1, 0.2, 0, 0, 0))
    assert evaluate(model, image_set(*MASKS)).measures.recall[2].value == 1
    result = evaluate(model, image_set(*MASKS), classes=FRUIT)
    assert result.classes == FRUIT
    assert values(result.measures.recall) == [1, 0, 0]
    assert evaluate(ReadsRed(), image_set(*MASKS), classes=FRUIT).measures.mean_iou.value == 1


def test_dropped_classes_are_neither_truth_nor_predicted():
    table = ClassTable.parse("pepper,peduncle")
    # The background, most probable everywhere, is no class here.
    result = evaluate(Constant((0.6, 0, 0.3, 0.1, 0, 0, 0, 0)), image_set(*MASKS), classes=table)
    peppers, peduncles = (sum((mask == value).sum() for mask in MASKS) for value in (2, 3))
    assert result.matrix.tolist() == [[peppers, 0], [peduncles, 0]]


def test_several_sets_are_one_sum_and_a_limit_takes_evenly_spaced_images():
    first, second = image_set(*MASKS[:4], name="first"), image_set(*MASKS[4:], name="second")
    done = []
    result = evaluate(ReadsRed(), [first, second], on_progress=lambda *count: done.append(count))
    assert done == [(k, 6) for k in range(1, 7)]
    assert [(image.set_number, image.position) for image in result.images] == [
        (0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1),
    ]  # fmt: skip
    np.testing.assert_array_equal(result.matrix, evaluate(ReadsRed(), image_set(*MASKS)).matrix)
    limited = evaluate(ReadsRed(), [first, second], limit=2)
    assert [(image.set_number, image.position) for image in limited.images] == [
        (0, 0), (0, 3), (1, 0), (1, 1),
    ]  # fmt: skip
    assert [(item.available, item.evaluated) for item in limited.sets] == [(4, 2), (2, 2)]


def test_images_without_masks_are_counted_and_left_out():
    result = evaluate(ReadsRed(), image_set(None, MASKS[0], None))
    assert (result.sets[0].available, result.sets[0].evaluated, result.sets[0].unlabelled) == (3, 1, 2)
    assert "toy: 2 images have no mask" in result.format()
    assert "a single image gives no intervals" in result.format()


def test_fruit_are_objects_by_instances_or_regions():
    ids = np.zeros((20, 40), np.uint8)
    ids[5:15, 5:25] = 2
    instances = np.where(ids == 2, 1 + (np.arange(40) >= 15), 0)
    regions = evaluate(ReadsRed(), image_set(ids))
    assert (regions.fruit.counts.matched, regions.fruit.counts.truth) == (1, 1)
    separate = evaluate(ReadsRed(), image_set(ids, instances=[instances]))
    assert (separate.fruit.counts.matched, separate.fruit.counts.truth) == (0, 2)
    assert "Fruit as objects" in separate.format()
    # The class of fruit holds nothing else; without one there are no objects.
    assert (fruit_class(ORGANS), fruit_class(FRUIT)) == (2, 1)
    merged = ClassTable.parse("plant=leaf+pepper,background")
    assert fruit_class(merged) is None
    result = evaluate(ReadsRed(), image_set(ids), classes=merged)
    assert result.fruit is None
    assert result.to_json()["fruit"] is None
    assert "Fruit" not in result.format()


def test_json_is_complete_and_finite():
    masks = [np.where(mask == 7, 0, mask) for mask in MASKS]
    result = evaluate(ReadsRed(changes={2: 3}), image_set(*masks))
    content = json.loads(json.dumps(result.to_json(), allow_nan=False))
    assert content["format"] == "pepperscene evaluation 1"
    assert [entry["name"] for entry in content["classes"]] == list(ORGANS.names)
    assert content["classes"][7]["iou"] == {
        "value": None, "low": None, "high": None, "why": "the class is neither in the masks nor predicted",
    }  # fmt: skip
    assert (
        np.sum([image["confusion"] for image in content["images"]], axis=0).tolist() == content["confusion"]
    )
    assert [image["name"] for image in content["images"]] == [f"image{k}" for k in range(6)]
    mean = content["mean_iou"]
    assert mean["low"] <= mean["value"] <= mean["high"]


def test_tables_state_measures_and_confusion():
    text = evaluate(ReadsRed(changes={2: 3}), image_set(*MASKS), classes=FRUIT).format()
    lines = text.splitlines()
    assert lines[0] == "IoU: toy, 6 of 6 images"
    assert lines[1].startswith("class     IoU, % [95 %]")
    assert lines[1].endswith("share of pixels, %")
    assert lines[2].startswith("other     100.0 [100.0, 100.0]  100.0 [100.0, 100.0]")
    assert lines[3].startswith("fruit     0.0 [0.0, 0.0]")
    assert any(line.split() == ["fruit", "0.0", "0.0", "100.0"] for line in lines)


def test_rejects_what_cannot_be_evaluated():
    model, images = ReadsRed(), image_set(*MASKS)
    blind = MemorySet(name="blind", items=(LabelledImage("a", None, MASKS[0]),))
    void, black = image_set(np.full((3, 4), IGNORE_CLASS)), image_set(np.zeros((3, 4)))
    parse = ClassTable.parse
    for error, message, arguments in (
        (ArgumentError, "sets: must hold at least one set", (model, [])),
        (InputError, "toy: holds no images", (model, image_set())),
        (InputError, "toy: holds no image with a mask", (model, image_set(None, None))),
        (InputError, "toy: has no labelled pixel of any of the classes background, leaf", (model, void)),
        (InputError, "has no labelled pixel .* pepper, peduncle", (model, black, parse("pepper,peduncle"))),
        (
            InputError,
            "classes: the model's class other is only partly in wire",
            (Constant((1, 0, 0), FRUIT), images, parse("pepper,wire,cut")),
        ),
        (InputError, "a: has no colours", (model, blind)),
        (InputError, r"probabilities of the shape \(7, 12, 16\), not \(8, 12", (Constant((1,) * 7), images)),
        (InputError, "not finite", (Constant((np.nan,) * 8), images)),
    ):
        classes = dict(zip(("classes",), arguments[2:], strict=False))
        with pytest.raises(error, match=message):
            evaluate(*arguments[:2], **classes)
    with pytest.raises(ArgumentError, match="limit: must be at least 1, not 0"):
        evaluate(model, images, limit=0)


def picture(source):
    kind, content = re.fullmatch(r"data:image/(png|jpeg);base64,([A-Za-z0-9+/=]+)", source).groups()
    image = Image.open(io.BytesIO(base64.b64decode(content)))
    assert image.format.lower() == kind
    return np.array(image.convert("RGB"))


def graded_set():
    """Five images, of which a model that confuses pepper and peduncle gets ever fewer pixels right."""
    masks = []
    for number in (3, 0, 4, 1, 2):
        mask = np.zeros((20, 30), np.uint8)
        mask[: 3 * number], mask[-4:] = 2, 3
        masks.append(mask)
    return image_set(*masks, name="graded <b>")


MODEL = ReadsRed(changes={2: 3})


def test_page_is_one_valid_file_with_tables_and_three_images(tmp_path):
    images = graded_set()
    evaluation = evaluate(MODEL, images)
    files = write_evaluation(evaluation, MODEL, images, tmp_path / "new" / "out")
    assert json.loads(files.data.read_bytes()) == evaluation.to_json()
    page = files.page.read_text(encoding="utf-8")
    root = parse_page(page)
    sources = [image.get("src") for image in root.iter("img")]
    # Names of sets are text, not elements.
    assert "graded &lt;b&gt;" in page
    assert [len(list(root.iter(name))) for name in ("b", "table", "img")] == [0, 3, 9]
    assert all(image.get("alt") for image in root.iter("img"))
    # Nothing but the embedded pictures is loaded.
    assert not re.search(r"(?:href|src)=\"(?!data:)", page)
    assert "http" not in re.sub(r"http-equiv", "", page)
    # Best, median and worst, with mask and prediction in the colours of the classes.
    headings = re.findall(r"<h3>(\w+): (\w+) of", page)
    assert headings == [("Best", "image1"), ("Median", "image4"), ("Worst", "image2")]
    colours = ORGANS.colours
    median = images[4].classes
    np.testing.assert_array_equal(picture(sources[4]), colours[median])
    np.testing.assert_array_equal(picture(sources[5]), colours[np.where(median == 2, 3, median)])


def test_ignored_pixels_are_grey_and_in_the_legend(tmp_path):
    images = image_set(*random_masks(1))
    table = ClassTable.parse(FRUIT_CLASSES)
    page = write_evaluation(evaluate(ReadsRed(), images, classes=table), ReadsRed(), images, tmp_path).page
    text = page.read_text(encoding="utf-8")
    sources = [image.get("src") for image in parse_page(text).iter("img")]
    mask = picture(sources[1])
    np.testing.assert_array_equal((mask == IGNORE_COLOUR).all(axis=-1), images[0].classes == 255)
    assert "no label" in text
    # One image is the best and the worst.
    assert len(sources) == 3


def test_examples_are_the_best_the_median_and_the_worst_image():
    for values, chosen in (
        ([], []),
        ([0.5], [("best", 0)]),
        ([0.2, np.nan, 0.5], [("best", 2), ("worst", 0)]),
        ([0.4, 0.5, 0.1, 0.3], [("best", 1), ("median", 3), ("worst", 2)]),
    ):
        assert ranked_examples(np.array(values)) == chosen


def test_writes_both_files_or_none(tmp_path):
    images = graded_set()
    evaluation = evaluate(MODEL, images)
    (tmp_path / "evaluation.html").mkdir()
    with pytest.raises(OutputError, match=r"evaluation.html: is a folder"):
        write_evaluation(evaluation, MODEL, images, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["evaluation.html"]
    with pytest.raises(InputError, match="must be the evaluated ones: graded"):
        write_evaluation(evaluation, MODEL, image_set(*random_masks(5)), tmp_path / "other")
    assert not (tmp_path / "other").exists()
